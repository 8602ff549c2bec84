"""Steps taken by a kernel, for a system that is a plan of arrays (`march.h`).

The kernel solves the equations of `newton.py` by the same rules. What it does not solve it leaves
to that, which finds out why, so that failures, hard steps and singular matrices are as ever.
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.integrators.hht.equations import Node
from ancfdae.integrators.hht.small_steps import PLACES
from ancfdae.integrators.recorder import Recorder, Rows
from ancfdae.kernels import INDEFINITE, NEEDS_GAUSS, Layout, Plan, march, prepare
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint

# Seconds after which a packet ends, so that interrupts and progress come through.
_PATIENCE = 0.1


@final
class CompiledSteps:
    """Takes steps of one run, which the recorder counts."""

    def __init__(
        self,
        plan: Plan,
        layout: Layout,
        matrices: SaddlePoint,
        rules: Array,
        recorder: Recorder,
    ) -> None:
        self._plan, self._matrices, self._rules, self._recorder = plan, matrices, rules, recorder
        self._prepared, self._small = prepare(plan, layout, rules), False

    @classmethod
    def of(
        cls, system: MechanicalSystem, matrices: SaddlePoint, rules: Array, recorder: Recorder
    ) -> CompiledSteps | None:
        """Return None for a system that is no plan, or whose matrices need another solver."""
        plan, layout = system.plan, matrices.layout(band=False)
        return plan and layout and cls(plan, layout, matrices, rules, recorder)

    def march(self, before: Node, h: Array, ends: Array, rows: Rows) -> tuple[int, Node]:
        """Take as many steps as go; states are written to rows of q, v, A and lam."""
        t, q, v, a, lam, A, motion = before
        starts = np.concatenate([[t], ends[:-1]])
        tables = self._joint_factors(starts, ends, h), self._load_factors(starts, ends)
        taken, why, motion, a, counts = march(
            self._prepared, (q, v, a, lam, A), motion, h, *tables, _PATIENCE, rows
        )
        if why == NEEDS_GAUSS:
            self._small = True
        elif why == INDEFINITE and (layout := self._matrices.layout(band=True)):
            self._prepared = prepare(self._plan, layout, self._rules)
        self._count(counts)
        if taken:
            q, v, A, lam = (row[taken - 1] for row in rows)
            return taken, Node(float(ends[taken - 1]), q, v, a, lam, A, motion)
        again = why in (NEEDS_GAUSS, INDEFINITE)
        return self.march(before, h, ends, rows) if again else (0, before)

    def _count(self, counts: tuple[int, int, int]) -> None:
        iterations, factorisations, round_off_steps = counts
        recorder = self._recorder
        recorder.iterations += iterations
        recorder.residuals += iterations
        recorder.factorisations += factorisations
        recorder.round_off_steps += round_off_steps

    def _joint_factors(self, starts: Array, ends: Array, h: Array) -> Array:
        """Factors at ends and beginnings of steps, and where they are small at Gauss points."""
        of = self._plan.joint_factors
        if of is None:
            return np.ones((1, 2, 1))
        instants = [ends, starts]
        if self._small:
            instants += [starts + place * h for place in PLACES]
        t = np.stack(instants, axis=1)
        values, rates = of(t.ravel(), 1)[0], of(t[:, 2:].ravel(), 2)[1]
        tables = [x.reshape(len(h), -1, x.shape[1]) for x in (values, rates)]
        return np.concatenate(tables, axis=1)

    def _load_factors(self, starts: Array, ends: Array) -> Array:
        of = self._plan.load_factors
        return np.stack([of(ends), of(starts)], axis=1)
