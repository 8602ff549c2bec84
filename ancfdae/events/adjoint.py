"""The adjoint of runs with events, with all states of the run or within a limit of memory.

With a limit the run stores the end states of all phases, and all states of as many phases as fit
beside these and the longest phase, which the backward pass needs. The backward pass integrates each
other phase once more, with the same steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.events.derivatives import BackwardPass, require_one_time
from ancfdae.events.objectives import FollowedObjective, PhaseStates
from ancfdae.events.phases import Phase, PhasedRun, integrated
from ancfdae.events.thinning import only_ends
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.adjoint import COPIES
from ancfdae.sensitivity.method import finished
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import States

_NUMBER = np.dtype(float).itemsize


@final
class PhaseAdjoint:
    """Values of objectives along the phases of a run, and their gradients by a backward pass.

    `memory` is the limit in bytes; infinite without one.
    """

    def __init__(self, objectives: Sequence[Objective], memory: float) -> None:
        self._followed = [FollowedObjective(objective) for objective in objectives]
        self._memory, self._count = memory, 0
        # Whole phases by number, and bytes: of these, of ends and values, and of the longest phase.
        self._held = dict[int, Phase]()
        self._whole = self._least = self._longest = 0

    def leave(self, phase: Phase) -> Phase:
        """Evaluate the objectives along a phase; return it with the states that are stored."""
        for followed in self._followed:
            followed.follow(states_in(phase))
        if math.isinf(self._memory):
            self._held[self._count] = phase
            self._count += 1
            return phase
        row = _NUMBER * (3 * phase.run.q.shape[1] + phase.run.lam.shape[1] + 1)
        values = 1 + sum(followed.count for followed in self._followed)
        self._least += 2 * row + _NUMBER * values * len(phase.run.t)
        self._longest = max(self._longest, COPIES * row * len(phase.run.t))
        self._hold(phase, row)
        return only_ends(phase)

    def _hold(self, phase: Phase, row: int) -> None:
        """Store a whole phase; drop others until the limit is kept."""
        least = self._least + self._longest
        if least > self._memory:
            rule = (
                f"must be {least / 1e6:.3g} MB or more for the phases up to t = {phase.t_end:.6g}"
            )
            repair = "A phase is held whole. Omit it to store the whole run."
            raise InvalidInputError("memory", rule, f"{self._memory / 1e6:.3g} MB", repair)
        self._held[self._count] = phase
        self._count += 1
        self._whole += row * len(phase.run.t)
        while least + self._whole > self._memory:
            _, dropped = self._held.popitem()
            self._whole -= row * len(dropped.run.t)

    def gradients(self, run: PhasedRun) -> list[tuple[float, Array, float]]:
        """Return each value, its gradient, (n_b,), and its derivative in the end of the run."""
        system, count = run.phases[0].mode.system, len(run.phases)
        require_one_time(run, (self._all_of(run, k) for k in range(count)))
        values = [followed.close() for followed in self._followed]
        passes = [BackwardPass(system) for _ in values]
        for k in reversed(range(count)):
            phase = self._all_of(run, k)
            self._held.pop(k, None)
            for followed, back in zip(self._followed, passes, strict=True):
                back.through(phase, followed.partials(k, states_in(phase)))
        return [
            (value, back.to_start(system, run.before), back.in_end)
            for value, back in zip(values, passes, strict=True)
        ]

    def _all_of(self, run: PhasedRun, k: int) -> Phase:
        """Return phase k with all its states, integrated again if the run keeps its ends only."""
        if k in self._held:
            return self._held[k]
        phase = integrated(run.phases[k])
        finished(phase.run)
        return phase


def states_in(phase: Phase) -> PhaseStates:
    """Return the states of a phase, at times of the run."""
    x = phase.run
    states = States(phase.times, x.q, x.v, x.lam, x.degree)
    return PhaseStates(phase.mode.system, states, phase.t_0, phase.duration)
