"""Collects nodes of a run into a solution."""

from __future__ import annotations

import time
from typing import final

import numpy as np

from ancfdae.errors import Outcome
from ancfdae.numerics.arrays import Array
from ancfdae.solution import Sensitivities, Solution, Statistics
from ancfdae.system import MechanicalSystem


@final
class Recorder:
    """Arrays that a run fills row by row, and the counters of its cost.

    Parameters
    ----------
    system : MechanicalSystem
    rows : int
        Number of instants, the start included.
    sensitivities : bool
        Whether design derivatives are recorded.
    """

    def __init__(self, system: MechanicalSystem, rows: int, sensitivities: bool) -> None:
        self._system = system
        dtype = np.result_type(system.b, system.start()[0], float)
        n_q, n_lam, n_b = system.n_q, system.n_lam, system.n_b
        self._t = np.zeros(rows)
        self._state = [np.zeros((rows, n), dtype=dtype) for n in (n_q, n_q, n_q, n_lam)]
        self._state_b: list[Array] | None = None
        if sensitivities:
            self._state_b = [np.zeros((rows, n, n_b)) for n in (n_q, n_q, n_q, n_lam)]
        self._rows = 0
        self.iterations = self.factorisations = self.residuals = 0
        self.round_off_steps = 0
        self._started = time.perf_counter()

    @property
    def steps(self) -> int:
        """Steps recorded, the start not counted."""
        return max(self._rows - 1, 0)

    def record(self, t: float, state: tuple[Array, ...], state_b: tuple[Array, ...] | None) -> None:
        """Store (q, v, a, lam) at t and, where asked for, their design derivatives.

        The row counts only when all of it is stored, so that an interrupt leaves whole rows.
        """
        row = self._rows
        self._t[row] = t
        for array, value in zip(self._state, state, strict=True):
            array[row] = value
        if self._state_b is not None and state_b is not None:
            for array, value in zip(self._state_b, state_b, strict=True):
                array[row] = value
        self._rows = row + 1

    def solution(self, outcome: Outcome) -> Solution:
        """Return what was recorded."""
        rows, system = self._rows, self._system
        q, v, a, lam = (array[:rows] for array in self._state)
        sensitivities = None
        if self._state_b is not None:
            q_b, v_b, a_b, lam_b = (array[:rows] for array in self._state_b)
            sensitivities = Sensitivities(system.design_names, system.b, q_b, v_b, a_b, lam_b)
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
            sensitivities=sensitivities,
        )
