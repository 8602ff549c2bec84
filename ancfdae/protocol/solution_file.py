"""File of a solution: a NumPy archive without pickled objects, its plain numbers as JSON."""

from __future__ import annotations

import json
import os
import uuid
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ancfdae.errors import InvalidInput, Outcome, Verdict
from ancfdae.naming import BeamLayout, BodyLayout, JointLayout, Layout, Naming, RigidNodes
from ancfdae.numerics.arrays import Array
from ancfdae.protocol.solution_parts import EstimatedErrors, Sensitivities, Statistics

_FORMAT = "ancfdae solution 5"
_STATES = ("t", "q", "v", "a", "lam")
_DERIVATIVES = ("values", "q_b", "v_b", "a_b", "lam_b")
# Exceptions raised on reading a file that is damaged or not an archive.
_DAMAGED = (EOFError, zipfile.BadZipFile, zlib.error, RuntimeError)


def write(path: Path, fields: Mapping[str, Any]) -> Path:
    """Write the fields of a solution to a temporary file, and move it to `path` when complete."""
    arrays, meta = _packed(fields)
    for name, array in arrays.items():
        # `np.savez` would pickle them, and knows how to refuse from NumPy 2.1 on only.
        if array.dtype.hasobject:
            rule, got = "must hold numbers to be saved", f"objects in {name}"
            raise InvalidInput("solution", rule, got, "Give arrays of numbers.")
    # Settings may be numbers of NumPy, which JSON does not know.
    arrays["meta"] = np.array(json.dumps(meta, default=np.generic.item))
    # Not a file of `tempfile`: those are readable by their owner only, and would stay so.
    if not path.parent.is_dir():
        rule, repair = "must lie in a folder that exists", "Create the folder, or correct the path."
        raise InvalidInput("solution file", rule, repr(os.fspath(path)), repair)
    temporary = path.parent / f"{path.name}.{uuid.uuid4().hex}.part"
    try:
        with temporary.open("xb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # of a later NumPy: a flag
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    return path


def read(path: Path) -> dict[str, Any]:
    """Return the fields of a solution; InvalidInput if the file is not one written by `write`."""
    try:
        # Opened here, because np.load does not close a file that is not a complete archive.
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        meta = json.loads(str(arrays["meta"]))
        if meta["format"] != _FORMAT:
            raise ValueError(f"the format {meta['format']!r}")
        return _unpacked(arrays, meta)
    except FileNotFoundError:
        where, repair = "solution file", "Check the path, and that Solution.save was called."
        raise InvalidInput(where, "must exist", repr(os.fspath(path)), repair) from None
    except (OSError, KeyError, ValueError, TypeError, *_DAMAGED) as error:
        raise InvalidInput(
            f"solution file {os.fspath(path)!r}",
            f"must be a file written by Solution.save ({_FORMAT})",
            f"{type(error).__name__}: {error}",
            "Choose another file.",
        ) from error


def _packed(fields: Mapping[str, Any]) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return the arrays and everything else."""
    arrays = {name: fields[name] for name in _STATES}
    naming, own, errors = (fields[x] for x in ("naming", "sensitivities", "estimated_errors"))
    outcome = fields["outcome"]
    meta = {
        "format": _FORMAT,
        "statistics": asdict(fields["statistics"]),
        "outcome": {**asdict(outcome), "verdict": outcome.verdict.name},
        "degree": fields["degree"],
        "estimated_errors": errors and asdict(errors),
        "layout": naming and asdict(naming.layout),
        "names": own and list(own.names),
    }
    if naming is not None:
        arrays |= {"lengths": naming.lengths, "lengths_b": naming.lengths_b}
    if own is not None:
        arrays |= {f"sensitivity_{name}": getattr(own, name) for name in _DERIVATIVES}
    return arrays, meta


def _unpacked(arrays: Mapping[str, Array], meta: Mapping[str, Any]) -> dict[str, Any]:
    outcome = {**meta["outcome"], "verdict": Verdict[meta["outcome"]["verdict"]]}
    fields: dict[str, Any] = {name: arrays[name] for name in _STATES} | {
        "statistics": Statistics(**meta["statistics"]),
        "outcome": Outcome(**outcome),
        "naming": None,
        "degree": int(meta["degree"]),
    }
    if meta["layout"] is not None:
        layout = _layout(meta["layout"])
        fields["naming"] = Naming(layout, arrays["lengths"], arrays["lengths_b"])
    if meta["names"] is not None:
        own = (arrays[f"sensitivity_{name}"] for name in _DERIVATIVES)
        fields["sensitivities"] = Sensitivities(tuple(meta["names"]), *own)
    if meta["estimated_errors"] is not None:
        motion, derivatives = (meta["estimated_errors"][x] for x in ("motion", "derivatives"))
        derivatives = None if derivatives is None else tuple(derivatives)
        fields["estimated_errors"] = EstimatedErrors(motion, derivatives)
    return fields


def _layout(meta: Mapping[str, Any]) -> Layout:
    return Layout(
        element_name=meta["element_name"],
        bodies=tuple(BodyLayout(**x) for x in meta["bodies"]),
        beams=tuple(_beam(x) for x in meta["beams"]),
        masses=tuple(meta["masses"]),
        joints=tuple(JointLayout(**x) for x in meta["joints"]),
    )


def _beam(meta: Mapping[str, Any]) -> BeamLayout:
    rigid = meta["rigid"] and RigidNodes(**{x: _tuples(y) for x, y in meta["rigid"].items()})
    return BeamLayout(**{**meta, "fractions": tuple(meta["fractions"]), "rigid": rigid})


def _tuples(nested: Any) -> Any:
    """Return nested lists of numbers as tuples."""
    return tuple(map(_tuples, nested)) if isinstance(nested, list) else nested
