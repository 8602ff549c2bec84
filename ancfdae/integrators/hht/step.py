"""A step of HHT-I3: of the motion and, where they go along, of its design derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.equations import (
    Coefficients,
    Node,
    NodeSensitivity,
    rescaled,
    rescaled_sensitivity,
)
from ancfdae.integrators.hht.newton import StepSolver
from ancfdae.integrators.hht.small_steps import ConstraintRow
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.start import InitialSensitivity, InitialState
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.protocol import MechanicalSystem

# Time, q, v, A, lam and, where they go along, q_b, v_b, A_b, lam_b.
Record = tuple[float, Array, Array, Array, Array, tuple[Array, ...]]


@final
@dataclass(frozen=True)
class Instant:
    """What the recurrence knows at an instant.

    Attributes
    ----------
    node : Node
    node_b : NodeSensitivity or None
        Where the derivatives go along.
    """

    node: Node
    node_b: NodeSensitivity | None = None

    def recorded(self) -> Record:
        """Return what a solution keeps of it."""
        node, b = self.node, self.node_b
        derivatives = () if b is None else (b.q_b, b.v_b, b.A_b, b.lam_b)
        return node.t, node.q, node.v, node.A, node.lam, derivatives

    def rescaled(self, ratio: float) -> Instant:
        """Return the instant for a step whose size is `ratio` times that of the step before."""
        node_b = None if self.node_b is None else rescaled_sensitivity(self.node_b, ratio)
        return Instant(rescaled(self.node, ratio), node_b)


@final
@dataclass(frozen=True)
class Stepper:
    """Takes steps from instant to instant.

    Attributes
    ----------
    system : MechanicalSystem
    matrices : SaddlePoint
    solver : StepSolver
    initial : InitialState
    derivative : InitialSensitivity or None
        Where the derivatives go along.
    recorder : Recorder
        Whose counters go on.
    """

    system: MechanicalSystem
    matrices: SaddlePoint
    solver: StepSolver
    initial: InitialState
    derivative: InitialSensitivity | None
    recorder: Recorder

    @staticmethod
    def of(
        system: MechanicalSystem,
        matrices: SaddlePoint,
        initial: InitialState,
        derivative: InitialSensitivity | None,
        newton: tuple[float, int],
        recorder: Recorder,
    ) -> Stepper:
        """Return a stepper; `newton` is the tolerance and the most iterations of its solver."""
        solver = StepSolver(system, matrices, *newton, recorder)
        return Stepper(system, matrices, solver, initial, derivative, recorder)

    def consistent(self) -> Record:
        """Return what a solution keeps of the start, which is the consistent one."""
        x, b = self.initial, self.derivative
        derivatives = () if b is None else (b.q_b, b.v_b, b.a_b, b.lam_b)
        return x.t, x.q, x.v, x.a, x.lam, derivatives

    def start(self, c: Coefficients) -> Instant:
        """Return the start of a run whose first step has the given coefficients."""
        start = RecurrenceStart.of(self.system, self.matrices, c, self.initial)
        node_b = None if self.derivative is None else start.sensitivity(self.derivative)
        return Instant(start.node, node_b)

    def advance(self, c: Coefficients, before: Instant, t: float) -> Instant | None:
        """Solve the equations at t; None if Newton's method fails.

        Raises
        ------
        SingularMatrix
        """
        node, node_b = self.solver.advance(c, before.node, t), before.node_b
        if node is not None and node_b is not None:
            self.recorder.factorisations += 1
            row = ConstraintRow.of(self.system, c, before.node, node)
            node_b = linear_passes.advance(self.system, self.matrices, c, node_b, node, row)
        return None if node is None else Instant(node, node_b)
