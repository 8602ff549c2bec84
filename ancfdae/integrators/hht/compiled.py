"""Steps taken by kernels, for a system that is a plan of arrays (`march.h`, `passes.h`).

The kernels solve the equations of `newton.py` and `linear_passes.py` by the same rules. What they
do not solve they leave to these, which find out why, so that failures, hard steps and singular
matrices are as ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem, planned
from ancfdae.integrators.hht.equations import Node
from ancfdae.integrators.hht.small_steps import PLACES
from ancfdae.integrators.recorder import SolutionRecorder, StateRows
from ancfdae.kernels import (
    INDEFINITE,
    NEEDS_GAUSS,
    RULES,
    ListPlan,
    MatrixLayout,
    Model,
    Plan,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint

# Seconds after which a packet ends, so that interrupts and progress come through.
_PATIENCE = 0.1
# Sizes of steps, q, v and lam after them, factors of joints and of loads there, and matrices of the
# recurrence.
Packet: TypeAlias = tuple[Array, Array, Array, Array, Array, Array, Array]
# Covectors of an objective on q, v and lam.
OnStates: TypeAlias = tuple[Array | None, Array | None, Array | None]


@final
class Prepared:
    """A plan and the matrices of a run as kernels take them; the rules are `StepSolver.rules`."""

    def __init__(
        self, plan: Plan | ListPlan, layout: MatrixLayout, matrices: SaddlePoint, rules: Array
    ) -> None:
        self.plan, self._matrices, self._rules = plan, matrices, rules
        self.model = Model(plan, layout, rules)

    @classmethod
    def of(cls, system: MechanicalSystem, matrices: SaddlePoint, rules: Array) -> Prepared | None:
        """Return None for a system that is no plan, or whose matrices need another solver."""
        plan = planned(system)
        layout = matrices.layout(band=False) or matrices.layout_in_fronts()
        return plan and layout and cls(plan, layout, matrices, rules)

    def add_band(self) -> None:
        """Prepare for matrices that are not positive definite, too."""
        layout = self._matrices.layout(band=True)
        assert layout is not None
        self.model = Model(self.plan, layout, self._rules)


@final
@dataclass(frozen=True)
class CompiledPasses:
    """Linearised steps of a finished run in the compiled kernel, for derivatives and adjoints."""

    kernel: Prepared

    @classmethod
    def of(
        cls, system: MechanicalSystem, matrices: SaddlePoint, alpha: float
    ) -> CompiledPasses | None:
        """Return the passes of a system; None if it has no plan for the kernel."""
        rules = np.zeros(RULES)
        rules[0] = alpha
        if isinstance(planned(system), ListPlan):
            return None  # Its passes take matrices of many steps together.
        prepared = Prepared.of(system, matrices, rules)
        return prepared and cls(prepared)

    def packet(self, h: Array, t: Array, states: tuple[Array, ...], matrices: Array) -> Packet:
        """Return the kernel's data for steps with these states q, v and lam at their ends."""
        plan = self.kernel.plan
        of_joints = plan.joint_factors(t, 1)[0] if plan.joint_factors else np.ones((1, 1))
        q, v, lam, of_joints, of_loads = (
            np.ascontiguousarray(x) for x in (*states, of_joints, plan.load_factors(t))
        )
        return h, q, v, lam, of_joints, of_loads, matrices

    def forward(self, steps: Packet, right: Array, z: Array, states: Array, lam_b: Array) -> int:
        """Take steps of direct differentiation; see `Model`."""
        taken, why = self.kernel.model.differentiate_steps(steps, right, z, states, lam_b)
        if why != INDEFINITE:
            return taken
        self.kernel.add_band()
        rest = slice(taken, None)
        return taken + self.forward(_part(steps, rest), right[rest], z, states[rest], lam_b[rest])

    def backward(self, steps: Packet, seeds: OnStates, on: Array, mu: Array, zeta: Array) -> int:
        """Take transposed steps back from the last; see `Model`."""
        taken, why = self.kernel.model.pull_back_steps(steps, seeds, on, mu, zeta)
        if why != INDEFINITE:
            return taken
        self.kernel.add_band()
        rest = slice(len(mu) - taken)
        q, v, lam = (x if x is None else x[rest] for x in seeds)
        return taken + self.backward(_part(steps, rest), (q, v, lam), on, mu[rest], zeta[rest])


def _part(steps: Packet, part: slice) -> Packet:
    h, q, v, lam, of_joints, of_loads, matrices = steps
    of_joints = of_joints if len(of_joints) < len(h) else of_joints[part]
    return h[part], q[part], v[part], lam[part], of_joints, of_loads[part], matrices[part]


@final
class CompiledSteps:
    """Takes steps of one run, which the recorder counts."""

    def __init__(self, prepared: Prepared, recorder: SolutionRecorder) -> None:
        self._kernel, self._recorder, self._small = prepared, recorder, False

    @classmethod
    def of(
        cls,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        rules: Array,
        recorder: SolutionRecorder,
    ) -> CompiledSteps | None:
        """Return None for a system that is no plan."""
        prepared = Prepared.of(system, matrices, rules)
        return prepared and cls(prepared, recorder)

    def march(self, before: Node, h: Array, ends: Array, rows: StateRows) -> tuple[int, Node]:
        """Take steps until one needs Python; write the states to rows of q, v, A and lam."""
        t, q, v, a, lam, A, motion = before
        starts = np.concatenate([[t], ends[:-1]])
        of_loads = self._kernel.plan.load_factors
        loads = np.stack([of_loads(ends), of_loads(starts)], axis=1)
        tables = self._joint_factors(starts, ends, h), loads
        taken, why, motion, a, counts = self._kernel.model.march(
            (q, v, a, lam, A), motion, h, *tables, _PATIENCE, rows
        )
        if why == NEEDS_GAUSS:
            self._small = True
        elif why == INDEFINITE:
            self._kernel.add_band()
        iterations, factorisations, round_off_steps = counts
        recorder = self._recorder
        recorder.iterations += iterations
        recorder.residuals += iterations
        recorder.factorisations += factorisations
        recorder.round_off_steps += round_off_steps
        if taken:
            # Copies: a node that is kept must not keep the rows of a whole part.
            q, v, A, lam = (row[taken - 1].copy() for row in rows)
            return taken, Node(float(ends[taken - 1]), q, v, a, lam, A, motion)
        again = why in (NEEDS_GAUSS, INDEFINITE)
        return self.march(before, h, ends, rows) if again else (0, before)

    def _joint_factors(self, starts: Array, ends: Array, h: Array) -> Array:
        """Factors at ends and beginnings of steps, and where they are small at Gauss points."""
        of = self._kernel.plan.joint_factors
        if of is None:
            return np.ones((1, 2, 1))
        instants = [ends, starts]
        if self._small:
            instants += [starts + place * h for place in PLACES]
        t = np.stack(instants, axis=1)
        values, rates = of(t.ravel(), 1)[0], of(t[:, 2:].ravel(), 2)[1]
        tables = [x.reshape(len(h), -1, x.shape[1]) for x in (values, rates)]
        return np.concatenate(tables, axis=1)
