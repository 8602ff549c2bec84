"""Collects nodes of a run into a solution."""

from __future__ import annotations

import time
from typing import final

import numpy as np

from ancfdae.errors import Outcome
from ancfdae.numerics.arrays import Array
from ancfdae.solution import Solution, Statistics
from ancfdae.system import MechanicalSystem


@final
class Recorder:
    """Arrays that a run fills row by row, and the counters of its cost.

    Parameters
    ----------
    system : MechanicalSystem
    rows : int
        Number of instants, the start included.
    """

    def __init__(self, system: MechanicalSystem, rows: int) -> None:
        self._system = system
        dtype = np.result_type(system.b, system.start()[0], float)
        sizes = (system.n_q, system.n_q, system.n_q, system.n_lam)
        self._t = np.zeros(rows)
        self._state = [np.zeros((rows, n), dtype=dtype) for n in sizes]
        self._rows = 0
        self.iterations = self.factorisations = self.residuals = 0
        self.round_off_steps = 0
        self._started = time.perf_counter()

    @property
    def steps(self) -> int:
        """Steps recorded, the start not counted."""
        return max(self._rows - 1, 0)

    def record(self, t: float, q: Array, v: Array, a: Array, lam: Array) -> None:
        """Store a state.

        The row counts only when all of it is stored, so that an interrupt leaves whole rows.
        """
        row = self._rows
        self._t[row] = t
        for array, value in zip(self._state, (q, v, a, lam), strict=True):
            array[row] = value
        self._rows = row + 1

    def solution(self, outcome: Outcome) -> Solution:
        """Return what was recorded."""
        rows, system = self._rows, self._system
        q, v, a, lam = (array[:rows] for array in self._state)
        return Solution(
            t=self._t[:rows],
            q=q,
            v=v,
            a=a,
            lam=lam,
            statistics=Statistics(
                steps=self.steps,
                iterations=self.iterations,
                factorisations=self.factorisations,
                residuals=self.residuals,
                round_off_steps=self.round_off_steps,
                wall_seconds=time.perf_counter() - self._started,
            ),
            outcome=outcome,
            naming=system.naming,
        )
