"""Phases of a run with events, reduced to some of their states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ancfdae.events.phases import Phase
from ancfdae.numerics.arrays import Array

_ARRAYS = ("t", "q", "v", "a", "lam")


def only_ends(phase: Phase) -> Phase:
    """Return a phase with its first and its last state only."""
    return _with_states(phase, {name: getattr(phase.run, name)[_ends(phase)] for name in _ARRAYS})


def _ends(phase: Phase) -> list[int]:
    last = len(phase.run.t) - 1
    return [0, last] if last else [0]


def _with_states(phase: Phase, arrays: dict[str, Array]) -> Phase:
    run: Any = replace(phase.run, **arrays, degree=1, control=())  # type: ignore[arg-type]
    return replace(phase, run=run)


def thinned(keep: int | Array) -> Callable[[Phase], Phase]:
    """Return a function that reduces a phase to the states at its ends, and some between them.

    An int k keeps every k-th step; an array of times of the run, ascending, s, keeps states
    interpolated at these.
    """

    def thin(phase: Phase) -> Phase:
        run = phase.run
        last = len(run.t) - 1
        if isinstance(keep, int):
            # Every k-th step and the end.
            rows = np.append(np.arange(0, last, min(keep, last + 1) * run.degree), last)
            arrays = {name: getattr(run, name)[rows] for name in _ARRAYS}
        else:
            times = keep - phase.t_0
            times = times[(times > 0) & (times < run.t[-1])]
            arrays = {name: getattr(run, name)[_ends(phase)] for name in _ARRAYS}
            if len(times):
                between = run.at(times)
                arrays = {
                    name: np.insert(x, 1, getattr(between, name), axis=0)
                    for name, x in arrays.items()
                }
        return _with_states(phase, arrays)

    return thin
