"""Natural frequencies and shapes, where `modes` linearises, and a step that follows them."""

import abc
from collections.abc import Sequence
from functools import cached_property
from typing import TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.held import (
    acceleration_side,
    force_total,
    held_pull_back,
    held_q,
    held_total,
)
from ancfdae.equations.saddle_points import saddle_point, solve, solve_transposed
from ancfdae.errors.checks import require_count, require_flag, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.start import (
    Covectors,
    at_rest,
    pull_back_start,
    start_and_mass,
    start_sensitivity,
)
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.modes.analysis import modes_about
from ancfdae.modes.configuration import LinearisationPoint
from ancfdae.modes.periods import StepSuggestion, suggestion
from ancfdae.modes.result import Modes
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.threads import in_one_thread
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.statics.derivatives import Tangent
from ancfdae.statics.equilibrium import Equilibrium
from ancfdae.studies.calls import as_system


@in_one_thread
def modes(
    model: Scene | MechanicalSystem,
    count: int = 6,
    *,
    at: LinearisationPoint | Equilibrium | None = None,
    design: Sequence[str | DesignVariable] | None = None,
    damped: bool | None = None,
    highest: bool = False,
    method: DirectDifferentiation | Adjoint | None = None,
) -> Modes:
    """Return natural frequencies and shapes of small motions about a configuration at rest.

    Joints are kept exactly; those that are driven are held. Lowest first: growing motions (of an
    unstable equilibrium), rigid ones (s = 0), vibrations by |s|, then motions that only decay, by
    |s|. With damping vibrations are counted by the argument principle: all below the last one are
    returned, or NoModes is raised. Large damped systems (more than 120 independent motions and
    3 `count` + 40) are searched for real exponents next to their undamped frequencies only.

    Parameters
    ----------
    count : int
        How many. Modes that coincide to round-off are not separated if that adds eight at most, as
        of a square bar; of a larger group, as of motions that creep in an overdamped body, those
        that were asked for are returned, and `Modes.cut` names them.
    at : Equilibrium or LinearisationPoint, optional
        Where: what `equilibrium` found, or coordinates and multipliers, for example
        ``LinearisationPoint.of(solution, instant)`` of a motion that has come to rest. By default
        the start of the model, at rest, with the multipliers that hold it best; if forces there are
        not in balance these are the modes of a motion that is held there, and the result says so.
    design : sequence of str or DesignVariable, optional
        Design variables of a scene to differentiate in; a mechanical system has its own.
    damped : bool, optional
        Whether velocity forces count; by default if there are any. False leaves out all of them,
        gyroscopic forces in a `RotatingFrame` included: centrifugal forces alone remain there, and
        the frequencies are not those of the rotor.
    highest : bool
        Whether the highest modes are wanted instead of the lowest.
    method : DirectDifferentiation or Adjoint, optional
        How frequencies are differentiated: `DirectDifferentiation` (default) with the shapes,
        `Adjoint` by one transposed solve for each mode, independent of the number of design
        variables.
    """
    require_count("count", count, "Ask for one or more modes.")
    require_flag("highest", highest)
    if method is not None:
        require_kind("method", method, (DirectDifferentiation, Adjoint), "Direct() or Adjoint().")
    system = as_system(model, design)
    where = place(system, at)
    back = where.pull_back if system.n_b and isinstance(method, Adjoint) else None
    configuration = where.configuration(system.n_b > 0 and back is None)
    known = where.matrices, where.mass
    return modes_about(system, configuration, count, highest, damped, back, *known)


@in_one_thread
def suggest_step(
    model: Scene | MechanicalSystem,
    per_period: float = 20.0,
    *,
    follow: int | None = 6,
    at: LinearisationPoint | Equilibrium | None = None,
) -> StepSuggestion:
    """Return a step that resolves the vibrations of a model, and its shortest and longest period.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    per_period : float
        Steps in the shortest period that counts; HHT-I3 errs by about (2 pi / per_period)^2 / 8 of
        a turn in each, / 12 with ``hht_alpha=0``.
    follow : int, optional
        How many motions count, from the slowest; None for all of them. Waves through the sections
        of stiff beams are thousands of times faster than what one wants to see.
    at : LinearisationPoint, optional
        As in `modes`.
    """
    require_positive("per_period", per_period)
    if follow is not None:
        require_count("follow", follow, "Follow one motion or more, or None for all.")
    system = as_system(model)
    return suggestion(system, place(system, at).configuration(False), per_period, follow)


At: TypeAlias = LinearisationPoint | Equilibrium | None


class DesignedConfiguration(abc.ABC):
    """A configuration that depends on the design.

    Its saddle-point matrices and the factorised mass, where it has some.
    """

    matrices: SaddlePoint | None = None
    mass: Factorization | None = None

    @abc.abstractmethod
    def configuration(self, differentiated: bool) -> LinearisationPoint:
        """Return q and lam, with their design derivatives if asked for."""

    @abc.abstractmethod
    def pull_back(self, on_q: Array, on_lam: Array, on_b: Array) -> Array:
        """Return q_b^T on_q + lam_b^T on_lam + on_b, shape (n_b,)."""


def place(system: MechanicalSystem, at: At) -> DesignedConfiguration:
    """Return the place that a user means; InvalidInputError if it is none."""
    if at is None:
        return _Start(system)
    require_kind("at", at, (LinearisationPoint, Equilibrium), "Pass what `equilibrium` returned.")
    return _Given(at) if isinstance(at, LinearisationPoint) else _Balanced(system, at)


@final
class _Given(DesignedConfiguration):
    """A configuration as it is, with the derivatives it brings."""

    def __init__(self, at: LinearisationPoint) -> None:
        self._at = at

    def configuration(self, differentiated: bool) -> LinearisationPoint:
        return self._at

    def pull_back(self, on_q: Array, on_lam: Array, on_b: Array) -> Array:
        total = on_b
        if self._at.q_b is not None:
            total = total + on_q @ self._at.q_b
        return total if self._at.lam_b is None else total + on_lam @ self._at.lam_b


@final
class _Balanced(DesignedConfiguration):
    """An equilibrium; its derivatives are those of this system, whatever it was found with."""

    def __init__(self, system: MechanicalSystem, at: Equilibrium) -> None:
        self._system, self._at = system, at
        LinearisationPoint(at.q, at.lam, t=self._t).check(system)

    @cached_property
    def _tangent(self) -> Tangent:
        if not self._at.outcome.success:
            raise InvalidInputError(
                "at",
                "must be an equilibrium under the full load to be differentiated",
                str(self._at.outcome),
                "Leave out the design variables.",
            )
        return Tangent(self._system, self._t, self._at.q, self._at.lam)

    @property
    def _t(self) -> float:
        return float(self._at.solution.t[0])

    def configuration(self, differentiated: bool) -> LinearisationPoint:
        at = self._at
        if not differentiated:
            return LinearisationPoint(at.q, at.lam, t=self._t)
        return LinearisationPoint(at.q, at.lam, *self._tangent.sensitivities(), self._t)

    def pull_back(self, on_q: Array, on_lam: Array, on_b: Array) -> Array:
        total: Array = on_b + self._tangent.pull_back(on_q, on_lam)
        return total


@final
class _Start(DesignedConfiguration):
    """The start with the multipliers of a motion that sets out from rest, joints held.

    M a + Phi_q^T lam = Q, Phi_q a = 0: of all multipliers these leave the least unbalanced force
    M a in the norm of M^-1, and none in an equilibrium.
    """

    def __init__(self, system: MechanicalSystem) -> None:
        self._system = system
        self.matrices: SaddlePoint = saddle_point(system, 0.0)
        self._state, self._factors = start_and_mass(system, self.matrices, 0.0)
        self.mass = self._factors
        _, q, v, self._a, self._lam = self._state
        self._q, self._rest = q, np.zeros(system.n_q)
        if not at_rest(v, acceleration_side(system, 0.0, q, v)):
            force = system.force(0.0, q, self._rest)
            self._a, self._lam = solve(self._factors, force, np.zeros(system.n_lam))

    def configuration(self, differentiated: bool) -> LinearisationPoint:
        if not differentiated:
            return LinearisationPoint(self._q, self._lam)
        system, q, a = self._system, self._q, self._a
        q_b = start_sensitivity(system, self.matrices, self._state).q_b
        held = np.zeros_like(q_b)
        force = force_total(system, 0.0, q, self._rest, q_b, held)
        force = force - held_total(system, 0.0, q, a, self._lam, q_b)
        # Phi_q a = Phi'(q, a) - Phi'(q, 0)
        side = system.constraint_total(0.0, (q, self._rest), (q_b, held))
        side = side - system.constraint_total(0.0, (q, a), (q_b, held))
        return LinearisationPoint(q, self._lam, q_b, solve(self._factors, force, side)[1])

    def pull_back(self, on_q: Array, on_lam: Array, on_b: Array) -> Array:
        """With [m, z] the transposed solution: what is left of on_lam moves q and b."""
        system, q, a, lam, rest = self._system, self._q, self._a, self._lam, self._rest
        m, z = solve_transposed(self._factors, rest, on_lam)
        at, none = np.zeros(1), np.zeros_like(lam)
        states = (q[None], rest[None], a[None], lam[None])
        on_q = on_q - system.pattern.dot_transposed(system.linearise(at, *states).f_q[0], m)
        on_q = on_q - system.pattern.dot(held_q(system, 0.0, q, rest, z), a)
        on_b = on_b - system.pull_back(at, states, (m[None], none[None]))
        on_b = on_b - held_pull_back(system, 0.0, q, rest, z, a)
        on = Covectors(on_q, rest, rest, none, on_b)
        return pull_back_start(system, self.matrices, self._state, on)
