"""File format of a solution: arrays by name, other data as JSON; no pickle (docs/results.md).

The file is a NumPy archive, or HDF5 if its name ends in ``.h5`` or ``.hdf5``.

The file of a run with events holds the arrays of all phases, numbered, and the records of events.
"""

from __future__ import annotations

import importlib
import io
import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, TypeAlias, TypeVar

import numpy as np

from ancfdae.equations.files import replacing
from ancfdae.equations.naming import Naming
from ancfdae.equations.solution_parts import ErrorEstimates, Sensitivities, Statistics
from ancfdae.errors.kinds import InvalidInputError, MissingPackageError
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.numerics.arrays import Array

# Name and version written, and oldest version read. Version 5 lacks `control`, 6 the kinks of
# bodies; before 8 all beams have the element of the layout; before 10 HDF5 files do not end with a
# checksum, and version 9 holds one that is not read.
_FORMAT, _VERSION, _OLDEST = "ancfdae solution", 10, 5
_CHECKED, _CHECKSUM = 10, "checksum"
# Bytes after the HDF5 data, before the CRC-32 of all its bytes; HDF5 does not read that far.
_SEAL, _CRC, _PIECE = b"\x89CRC-32\n", 4, 1 << 20
_HDF5, _SIGNATURE = (".h5", ".hdf5"), b"\x89HDF\r\n\x1a\n"
# Largest size of arrays that are not compressed; bytes.
_SMALL = 10_000
_STATES = ("t", "q", "v", "a", "lam")
_DERIVATIVES = ("values", "q_b", "v_b", "a_b", "lam_b")
T = TypeVar("T")
#: Function that restores a `Naming` from the arrays and JSON data of `Naming.packed`.
Unpack: TypeAlias = Callable[[Mapping[str, Array], Mapping[str, Any]], Naming]
# Exceptions raised on reading a file that is damaged or not an archive.
_DAMAGED = (EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, AttributeError, MemoryError)


def write(path: Path, fields: Mapping[str, Any]) -> Path:
    """Write the fields of a solution to a file, completely or not at all; return its path."""
    return store(path, *packed(fields))


def store(path: Path, arrays: Mapping[str, Array], meta: Mapping[str, Any]) -> Path:
    """Write arrays and JSON data to a file, completely or not at all; return its path."""
    for name, array in arrays.items():
        # `np.savez` would pickle objects, and can reject them from NumPy 2.1 on only.
        if array.dtype.hasobject:
            rule, got = "must hold numbers to be saved", f"objects in {name}"
            raise InvalidInputError("solution", rule, got, "Give arrays of numbers.")
    # Settings may be numbers of NumPy, which JSON does not know.
    text = json.dumps(meta, default=np.generic.item)
    put = _put_hdf5 if path.suffix.lower() in _HDF5 else _put_npz
    with replacing("solution file", path) as file:
        put(file, arrays, text)
    return path


def read(path: Path, naming: Unpack) -> dict[str, Any]:
    """Return the fields of a solution in a file; InvalidInputError unless `write` wrote it."""

    def fields(arrays: Mapping[str, Array], meta: Mapping[str, Any]) -> dict[str, Any]:
        _require_version(path, meta["format"])
        return unpacked(arrays, meta, naming)

    return restored(path, "Solution.save", fields)


def restored(
    path: Path, writer: str, of: Callable[[Mapping[str, Array], Mapping[str, Any]], T]
) -> T:
    """Return `of(arrays, meta)` for the arrays and JSON data of a file that `writer` wrote."""
    try:
        # Opened here, because np.load does not close a file that is not a complete archive.
        with path.open("rb") as raw:
            is_hdf5 = raw.read(len(_SIGNATURE)) == _SIGNATURE
            raw.seek(0)
            arrays, text = (_get_hdf5 if is_hdf5 else _get_npz)(raw)
        return of(arrays, json.loads(text))
    except InvalidInputError:
        raise
    except FileNotFoundError:
        where, repair = "solution file", f"Check the path, and that {writer} was called."
        raise InvalidInputError(where, "must exist", repr(os.fspath(path)), repair) from None
    except (OSError, KeyError, ValueError, TypeError, *_DAMAGED) as error:
        raise InvalidInputError(
            f"solution file {os.fspath(path)!r}",
            f"must be a whole file written by {writer}",
            f"{type(error).__name__}: {error}",
            "The file is damaged or of another kind.",
        ) from error


def _put_npz(file: IO[bytes], arrays: Mapping[str, Array], text: str) -> None:
    np.savez(file, meta=np.array(text), **arrays)  # type: ignore[arg-type]  # of a later NumPy: a flag


def _get_npz(raw: IO[bytes]) -> tuple[dict[str, Array], str]:
    with np.load(raw, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    return arrays, str(arrays.pop("meta"))


def _put_hdf5(file: IO[bytes], arrays: Mapping[str, Array], text: str) -> None:
    # HDF5 (1.14 and 2.0) ends the process if writing fails, to a path as to a Python file: it
    # writes to memory, which takes the size of the compressed file.
    memory = io.BytesIO()
    with _h5py().File(memory, "w") as hdf5:
        for name, array in arrays.items():
            packed = {"compression": "gzip", "shuffle": True} if array.nbytes > _SMALL else {}
            hdf5.create_dataset(name, data=array, **packed)
        hdf5.create_dataset("meta", data=text)
    file.write(memory.getbuffer())
    file.write(_SEAL + zlib.crc32(memory.getbuffer()).to_bytes(_CRC, "little"))


def _get_hdf5(raw: IO[bytes]) -> tuple[dict[str, Array], str]:
    sealed = _require_unharmed(raw)
    with _h5py().File(raw, "r") as hdf5:
        text = hdf5["meta"].asstr()[()]
        arrays = {name: hdf5[name][()] for name in hdf5 if name not in ("meta", _CHECKSUM)}
    # Files of earlier versions have no checksum.
    if not sealed and int(json.loads(text)["format"].rpartition(" ")[2]) >= _CHECKED:
        raise ValueError("no checksum")
    return arrays, text


def _require_unharmed(raw: IO[bytes]) -> bool:
    """Return whether a file ends with a checksum; ValueError if it does not match.

    This is checked before HDF5 reads the file: HDF5 2.0 may end the process on damaged tables.
    """
    left, total = raw.seek(0, io.SEEK_END) - len(_SEAL) - _CRC, 0
    raw.seek(max(left, 0))
    seal = raw.read()
    raw.seek(0)
    if not seal.startswith(_SEAL):
        return False
    while left > 0:
        piece = raw.read(min(left, _PIECE))
        total, left = zlib.crc32(piece, total), left - len(piece)
    if seal[len(_SEAL) :] != total.to_bytes(_CRC, "little"):
        raise ValueError("the checksum does not match")
    raw.seek(0)
    return True


def _h5py() -> Any:
    try:
        return importlib.import_module("h5py")
    except ImportError as error:
        raise MissingPackageError(
            "HDF5 files: need the package h5py; got none. Install it: "
            'python3 -m pip install "ancfdae[hdf5]", or save under a name that ends in .npz.'
        ) from error


def _require_version(path: Path, told: str) -> None:
    """Raise an error for a format or version that this package does not read."""
    kind, _, version = told.rpartition(" ")
    if kind != _FORMAT:
        raise ValueError(f"the format {told!r}")
    if not _OLDEST <= int(version) <= _VERSION:
        newer = int(version) > _VERSION
        raise InvalidInputError(
            f"solution file {os.fspath(path)!r}",
            f"must be written by Solution.save in a format from {_OLDEST} to {_VERSION}",
            f"format {version}, of {'a newer' if newer else 'an older'} ancfdae",
            "Install a newer ancfdae." if newer else "Run again, and save anew.",
        )


def packed(fields: Mapping[str, Any]) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return the arrays of a solution by name, and its other data for JSON."""
    arrays = {name: fields[name] for name in _STATES}
    naming, sensitivities, errors = (
        fields[x] for x in ("naming", "sensitivities", "estimated_errors")
    )
    outcome = fields["outcome"]
    meta = {
        "format": f"{_FORMAT} {_VERSION}",
        "control": list(fields["control"]),
        "statistics": asdict(fields["statistics"]),
        "outcome": {**asdict(outcome), "verdict": outcome.verdict.name},
        "degree": fields["degree"],
        "estimated_errors": errors and asdict(errors),
        "layout": None,
        "names": sensitivities and list(sensitivities.names),
    }
    if naming is not None:
        named, meta["layout"] = naming.packed()
        arrays |= named
    if sensitivities is not None:
        arrays |= {f"sensitivity_{name}": getattr(sensitivities, name) for name in _DERIVATIVES}
    return arrays, meta


def _require_shapes(arrays: Mapping[str, Array], names: Sequence[str] | None) -> None:
    """Raise ValueError unless states and derivatives are numbers of consistent shapes."""
    n_t, n_q, n_lam = (np.atleast_1d(arrays[name]).shape[-1] for name in ("t", "q", "lam"))
    shapes = {"t": (n_t,), "q": (n_t, n_q), "v": (n_t, n_q), "a": (n_t, n_q), "lam": (n_t, n_lam)}
    if names is not None:
        n_b = len(names)
        shapes["sensitivity_values"] = (n_b,)
        shapes |= {f"sensitivity_{x}_b": (n_t, n_q, n_b) for x in "qva"}
        shapes["sensitivity_lam_b"] = (n_t, n_lam, n_b)
    for name, shape in shapes.items():
        array = arrays[name]
        if array.shape != shape or not n_t:
            raise ValueError(f"{name} of shape {array.shape}, not {shape}")
    for name, array in arrays.items():
        if array.dtype.kind not in ("f" if name == "t" else "fc"):
            raise ValueError(f"{name} of type {array.dtype}")
    if not np.all(np.diff(arrays["t"]) > 0):
        raise ValueError("instants that do not ascend")


def unpacked(
    arrays: Mapping[str, Array], meta: Mapping[str, Any], naming: Unpack
) -> dict[str, Any]:
    """Return the fields of a solution from the arrays and data that `packed` made."""
    outcome = {**meta["outcome"], "verdict": Verdict[meta["outcome"]["verdict"]]}
    _require_shapes(arrays, meta["names"])
    fields: dict[str, Any] = {name: arrays[name] for name in _STATES} | {
        "statistics": Statistics(**meta["statistics"]),
        "outcome": RunOutcome(**outcome),
        "naming": None,
        "degree": int(meta["degree"]),
        "control": tuple(map(float, meta.get("control", ()))),
    }
    if meta["layout"] is not None:
        fields["naming"] = naming(arrays, meta["layout"])
    if meta["names"] is not None:
        sensitivities = (arrays[f"sensitivity_{name}"] for name in _DERIVATIVES)
        fields["sensitivities"] = Sensitivities(tuple(meta["names"]), *sensitivities)
    if meta["estimated_errors"] is not None:
        motion, derivatives = (meta["estimated_errors"][x] for x in ("motion", "derivatives"))
        derivatives = None if derivatives is None else tuple(derivatives)
        fields["estimated_errors"] = ErrorEstimates(motion, derivatives)
    return fields


# -- runs with events --------------------------------------------------------------------------


_EVENT_FORMAT = "ancfdae event solution 1"
# Fields of a record that may be arrays, the last one where friction has a cone.
_EVENT_ARRAYS = ("time_b", "impulse_b", "sliding_impulse_b", "sliding_impulse")


def write_phases(
    path: Path, phases: Sequence[Mapping[str, Any]], events: Sequence[Any], outcome: RunOutcome
) -> Path:
    """Write all phases, the records of events and the outcome to a file; return its path."""
    arrays: dict[str, Array] = {}
    metas = []
    for k, fields in enumerate(phases):
        own, meta = packed(fields)
        arrays |= {_of_phase(k, name): array for name, array in own.items()}
        metas.append(meta)
    records = []
    for k, event in enumerate(events):
        own = {x: vars(event)[x] for x in _EVENT_ARRAYS if isinstance(vars(event)[x], np.ndarray)}
        arrays |= {f"event{k}_{x}": value for x, value in own.items()}
        records.append({x: value for x, value in vars(event).items() if x not in own})
    ended = {**asdict(outcome), "verdict": outcome.verdict.name}
    meta = {"format": _EVENT_FORMAT, "phases": metas, "events": records, "outcome": ended}
    return store(path, arrays, meta)


def read_phases(
    path: Path, naming: Unpack
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], RunOutcome]:
    """Return the fields of all phases, the records of events, and the outcome from a file."""

    def parts(
        arrays: Mapping[str, Array], meta: Mapping[str, Any]
    ) -> tuple[list[dict[str, Any]], list[dict[str, Any]], RunOutcome]:
        if meta["format"] != _EVENT_FORMAT:
            raise ValueError(f"the format {meta['format']!r}")
        phases = []
        for k, own in enumerate(meta["phases"]):
            before = _of_phase(k, "")
            mine = {x.removeprefix(before): a for x, a in arrays.items() if x.startswith(before)}
            phases.append(unpacked(mine, own, naming))
        records = []
        for k, record in enumerate(meta["events"]):
            own = {x: arrays[f"event{k}_{x}"] for x in _EVENT_ARRAYS if f"event{k}_{x}" in arrays}
            records.append({**record, **own})
        ended = {**meta["outcome"], "verdict": Verdict[meta["outcome"]["verdict"]]}
        return phases, records, RunOutcome(**ended)

    return restored(path, "EventSolution.save", parts)


def _of_phase(k: int, name: str) -> str:
    return f"phase{k}_{name}"
