"""File format of a run with events: numbered arrays of all phases, other data as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ancfdae.equations.solution_file import Unpack, packed, restored, store, unpacked
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.numerics.arrays import Array

_FORMAT = "ancfdae event solution 1"
# Fields of a record that may be arrays, the last one where friction has a cone.
_ARRAYS = ("time_b", "impulse_b", "sliding_impulse_b", "sliding_impulse")


def write(
    path: Path, phases: Sequence[Mapping[str, Any]], events: Sequence[Any], outcome: RunOutcome
) -> Path:
    """Write all phases, the records of events and the outcome to a file; return its path."""
    arrays: dict[str, Array] = {}
    metas = []
    for k, fields in enumerate(phases):
        own, meta = packed(fields)
        arrays |= {_name(k, name): array for name, array in own.items()}
        metas.append(meta)
    records = []
    for k, event in enumerate(events):
        own = {x: vars(event)[x] for x in _ARRAYS if isinstance(vars(event)[x], np.ndarray)}
        arrays |= {f"event{k}_{x}": value for x, value in own.items()}
        records.append({x: value for x, value in vars(event).items() if x not in own})
    ended = {**asdict(outcome), "verdict": outcome.verdict.name}
    meta = {"format": _FORMAT, "phases": metas, "events": records, "outcome": ended}
    return store(path, arrays, meta)


def read(
    path: Path, naming: Unpack
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], RunOutcome]:
    """Return the fields of all phases, the records of events, and the outcome from a file."""

    def parts(
        arrays: Mapping[str, Array], meta: Mapping[str, Any]
    ) -> tuple[list[dict[str, Any]], list[dict[str, Any]], RunOutcome]:
        if meta["format"] != _FORMAT:
            raise ValueError(f"the format {meta['format']!r}")
        phases = []
        for k, own in enumerate(meta["phases"]):
            before = _name(k, "")
            mine = {x.removeprefix(before): a for x, a in arrays.items() if x.startswith(before)}
            phases.append(unpacked(mine, own, naming))
        records = []
        for k, record in enumerate(meta["events"]):
            own = {x: arrays[f"event{k}_{x}"] for x in _ARRAYS if f"event{k}_{x}" in arrays}
            records.append({**record, **own})
        ended = {**meta["outcome"], "verdict": Verdict[meta["outcome"]["verdict"]]}
        return phases, records, RunOutcome(**ended)

    return restored(path, "EventSolution.save", parts)


def _name(k: int, name: str) -> str:
    return f"phase{k}_{name}"
