"""Natural frequencies and shapes, a step that resolves them, and a Campbell diagram."""

from __future__ import annotations

import abc
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, final

import numpy as np
import scipy

from ancfdae.assembly.system import assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.meshes import warn_of_mesh
from ancfdae.equations.saddle_points import (
    acceleration_side,
    force_total,
    held_pull_back,
    held_q,
    held_total,
    saddle_point,
    solve,
    solve_transposed,
)
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import (
    require_array,
    require_count,
    require_flag,
    require_kind,
    require_positive,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText
from ancfdae.integrators.start import (
    Covectors,
    at_rest,
    consistent_start,
    pull_back_start,
    start_sensitivity,
)
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.scene import Scene
from ancfdae.model.turning_frame import RotatingFrame
from ancfdae.modes.analysis import StepSuggestion, modes_about, suggestion
from ancfdae.modes.linearised import EPS, LinearisationPoint
from ancfdae.modes.result import ModeKind, Modes
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.timing import progress_bar
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.statics.controlled import about_states
from ancfdae.statics.equilibrium import (
    Equilibrium,
    NoEquilibriumError,
    Tangent,
)
from ancfdae.studies.calls import as_system
from ancfdae.studies.statics import equilibrium

if TYPE_CHECKING:
    from ancfdae.plotting import Panel

# Size of the vibration, relative to the configuration, in which elements are checked.
_SMALL = 1e-5


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
    """Return natural frequencies and shapes of small motions about a configuration.

    Joints are satisfied exactly; driven joints are fixed. Modes are ordered with the lowest first:
    growing motions (of an unstable equilibrium), rigid motions (s = 0), vibrations by |s|, then
    motions that only decay, by |s|. With damping, vibrations are counted by the argument principle:
    all below the last one are returned, or NoModes is raised. Undamped modes of large systems are
    counted by Sylvester's law of inertia. Large damped systems (more than 120 independent motions
    and 3 `count` + 40) are searched for real exponents near their undamped frequencies only.

    With controllers the exponents are the poles of the closed loop, about their states in `at`. A
    shape x e^{st} holds the states' integrals, so that the states of a mode are s times their rows.

    Warns of beams with too few elements for the curvature of the configuration, or for the lowest
    vibration about it (`CoarseMeshWarning`).

    Parameters
    ----------
    count : int
        Number of modes. Modes that coincide to round-off, as of a square bar, are not separated if
        that adds at most eight; a larger group, as of creeping motions in an overdamped body, is
        cut, and `Modes.cut` names its modes.
    at : Equilibrium or LinearisationPoint, optional
        Configuration: a result of `equilibrium`, or coordinates and multipliers, for example
        ``LinearisationPoint.of(solution, instant)`` of a motion that has come to rest. By default
        the start of the model at zero velocity, with the multipliers that leave the smallest
        unbalanced force; if it is not zero, modes are those of the model held there by a constant
        force, and the result says so.
    design : sequence of str or DesignVariable, optional
        Design variables of a scene to differentiate in; a mechanical system has its own.
    damped : bool, optional
        Whether to include velocity forces; by default if there are any. False leaves out all of
        them, also the gyroscopic forces in a `RotatingFrame`: only centrifugal forces remain, and
        the frequencies are not those of the rotor.
    highest : bool
        Whether to return the highest modes instead of the lowest.
    method : DirectDifferentiation or Adjoint, optional
        How frequencies are differentiated: `DirectDifferentiation` (default) with the shapes,
        `Adjoint` by one transposed solve for each mode, independent of the number of design
        variables.
    """
    require_count("count", count, "Ask for one or more modes.")
    require_flag("highest", highest)
    if method is not None:
        require_kind("method", method, (DirectDifferentiation, Adjoint), "Direct() or Adjoint().")
    system = as_system(model, design).in_all_states()
    if at is not None:
        require_kind("at", at, (LinearisationPoint, Equilibrium), "Pass what equilibrium returned.")
    if system.controllers:
        if damped is False:
            raise InvalidInputError(
                "modes, damped",
                "must be left out for scenes with controllers, whose states are velocities",
                damped,
                "Leave out the controllers for the modes of the mechanism alone.",
            )
        system = about_states(system, *_states_of(system, at))
    where = place(system, at)
    back = where.pull_back if system.n_b and isinstance(method, Adjoint) else None
    configuration = where.configuration(system.n_b > 0 and back is None)
    known = where.matrices, where.mass
    found = modes_about(system, configuration, count, highest, damped, back, *known)
    _warn_of_mesh(system, configuration.q, found)
    return found


def _warn_of_mesh(system: MechanicalSystem, q: Array, found: Modes) -> None:
    """Warn of beams with too few elements for the configuration or for its lowest vibration."""
    w, states = system.weights, [q]
    elastic = np.flatnonzero(found.exponents != 0)
    if len(elastic):
        shape = found.shapes[:, elastic[0]].real
        sizes = [np.sqrt(w @ x**2) for x in (system.centred(q), shape)]
        states.append(q + _SMALL * sizes[0] / sizes[1] * shape)
    warn_of_mesh("modes", system, np.stack(states), stacklevel=5)


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
        Steps in the shortest period to be resolved; the phase error of HHT-I3 is about
        (2 pi / per_period)^2 / 8 of a turn in each period, / 12 with ``hht_alpha=0``.
    follow : int, optional
        Number of vibrations to be resolved, from the slowest; None for all. Waves through
        the sections of stiff beams are thousands of times faster than the motion of interest.
    at : LinearisationPoint, optional
        As in `modes`.
    """
    require_positive("per_period", per_period)
    if follow is not None:
        require_count("follow", follow, "Follow one motion or more, or None for all.")
    system = as_system(model).in_all_states()
    if system.controllers:
        system = about_states(system, *_states_of(system, at))
    return suggestion(system, place(system, at).configuration(False), per_period, follow)


At: TypeAlias = LinearisationPoint | Equilibrium | None


def _states_of(system: MechanicalSystem, at: At) -> tuple[Array, Array | None, Array | None]:
    """Return q and v of a configuration, and design derivatives of v, for states in v."""
    if at is None:
        return *system.start(), system.start_b()[1] if system.n_b else None
    if isinstance(at, LinearisationPoint):
        return at.q, at.v, at.v_b
    if not (system.n_b and at.outcome.success):
        return at.q, at.solution.v[0], None
    return at.q, at.solution.v[0], Tangent.of(system, at.solution).sensitivities()[0]


class DesignedConfiguration(abc.ABC):
    """Base class of configurations about which modes are taken, with their design derivatives.

    Saddle-point matrices and the factorised mass are set if they are known.
    """

    matrices: SaddlePoint | None = None
    mass: Factorization | None = None

    @abc.abstractmethod
    def configuration(self, differentiated: bool) -> LinearisationPoint:
        """Return a static configuration q and lam, if `differentiated` with design derivatives."""

    @abc.abstractmethod
    def pull_back(self, on_q: Array, on_lam: Array, on_b: Array) -> Array:
        """Return q_b^T on_q + lam_b^T on_lam + on_b of a static configuration, shape (n_b,)."""


def place(system: MechanicalSystem, at: At) -> DesignedConfiguration:
    """Return the static configuration declared by `at`; InvalidInputError for other objects."""
    if at is None:
        return _Start(system)
    require_kind("at", at, (LinearisationPoint, Equilibrium), "Pass what `equilibrium` returned.")
    return _Given(at) if isinstance(at, LinearisationPoint) else _Balanced(system, at)


@final
class _Given(DesignedConfiguration):
    """A given configuration, with the design derivatives that it holds."""

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
    """An equilibrium, with derivatives in the design variables of this system."""

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
        return Tangent.of(self._system, self._at.solution)

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
    """The start of a model, with the multipliers of a motion from zero velocity, drivers fixed.

    M a + Phi_q^T lam = Q, Phi_q a = 0: of all multipliers these leave the smallest unbalanced force
    M a in the norm of M^-1, and zero in an equilibrium.
    """

    def __init__(self, system: MechanicalSystem) -> None:
        self._system = system
        self.matrices: SaddlePoint = saddle_point(system, 0.0)
        self._state, self._factors = consistent_start(system, self.matrices, 0.0)
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
        """Return q_b^T on_q + lam_b^T on_lam + on_b by one transposed solve, shape (n_b,)."""
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


# -- Campbell diagram --------------------------------------------------------------------------


# Design target of the rate of the frame, the first of all design variables.
_RATE = "scene.rate"
# Weight of decay relative to distance in matching modes at neighbouring rates.
_FALLS = 1e-3
# Magnitude of whirl, from 0 to 1, above which a motion counts as circular.
_CIRCLES = 0.5


@final
@dataclass(frozen=True, repr=False)
class Campbell(PrintedTable):
    """Modes of a scene at several rates of its rotating frame, each mode followed over the rates.

    Attributes
    ----------
    rates : array, shape (k,)
        Rates of the frame; rad/s.
    exponents : array, shape (k, count), complex
        Exponents s as in `Modes`, in the rotating frame. A mode keeps its column; if it does not
        vibrate, as between the critical speeds of a shaft that is not round, s is the real exponent
        of the motion which decays least or grows.
    exponents_b : array, shape (k, count, n_b), complex
        Design derivatives of `exponents`, with the change of the equilibrium; 1/s per unit of
        the variable.
    names : tuple of str
        Names of the design variables, ``"scene.rate"`` first.
    whirl : array, shape (k, count)
        Sense of the motion about the axis in the frame, dimensionless: 1 for circular motion in the
        sense of the rate, -1 for circular motion against it, zero for motion along a line.
    equilibria : tuple of Equilibrium
    """

    rates: Array
    exponents: Array
    exponents_b: Array
    names: tuple[str, ...]
    whirl: Array
    equilibria: tuple[Equilibrium, ...]

    @property
    def frequencies(self) -> Array:
        """Circular frequencies in the rotating frame, shape (k, count); rad/s."""
        return self.exponents.imag

    @property
    def frequencies_b(self) -> Array:
        """Design derivatives of `frequencies`, shape (k, count, n_b); rad/s per unit of each."""
        return self.exponents_b.imag

    @property
    def whirl_speeds(self) -> Array:
        """Angular speeds of circular motions in an inertial frame, shape (k, count); rad/s.

        Positive forward, in the sense of the axis, negative backward. For motions along a line,
        |whirl| below 1/2, the frequency in the rotating frame is returned, as is right for torsion
        about the axis and stretch along it; a lateral motion along a line, as of a shaft that is
        not the same in all directions, has two frequencies in an inertial frame, which differ from
        it by the rate.
        """
        circles = np.abs(self.whirl) >= _CIRCLES
        turned = self.rates[:, None] + np.sign(self.whirl) * self.frequencies
        return np.where(circles, turned, self.frequencies)

    @property
    def critical_speeds(self) -> Array:
        """Rates at which a mode has zero frequency in the rotating frame, ascending, (n,); rad/s.

        A load that rotates with the frame, such as an unbalance, then acts at the frequency of the
        mode. The rates are found between neighbouring `rates` by cubics through the exponents and
        their derivatives. A shaft that is not the same in all directions has two for each mode,
        between which it is unstable.
        """
        found = list[float]()
        for k in range(len(self.rates) - 1):
            both = slice(k, k + 2)
            circles = np.all(np.abs(self.whirl[both]) >= _CIRCLES, axis=0)
            s, s_b = self.exponents[both], self.exponents_b[both, :, 0]
            sense = np.sign(self.whirl[both])
            # For circular motions the frequency changes its sense; for others s^2 its sign.
            values = np.where(circles, sense * s.imag, (s * s).real)
            slopes = np.where(circles, sense * s_b.imag, 2 * (s * s_b).real)
            for j in np.flatnonzero(np.sign(values[0]) * np.sign(values[1]) < 0):
                ends = self.rates[both], values[:, j], slopes[:, j]
                line = scipy.interpolate.CubicHermiteSpline(*ends)
                found += line.roots(extrapolate=False).tolist()
        return np.array(sorted(found))

    def plot(self, path: str | os.PathLike[str]) -> tuple[Path, ...]:
        """Draw the Campbell diagram of `panels` and save it; return the paths of the files."""
        from ancfdae import plotting

        return plotting.save(plotting.draw(self.panels()), path)

    def panels(self) -> list[Panel]:
        """Return the panel of `plot`: whirl speeds over the rate of the frame, and the rate."""
        from ancfdae.plotting import Panel, Series

        speeds = np.abs(self.whirl_speeds).T
        lines = [Series(f"mode {j}", self.rates, line) for j, line in enumerate(speeds)]
        lines.append(Series("rate of the frame", self.rates, self.rates, dashed=True))
        axes = "rate of the frame [rad/s]", "speed of whirl seen at rest [rad/s]"
        return [Panel("Campbell diagram", *axes, lines)]

    def to_dataframe(self) -> Any:
        """Return `frequencies` as a pandas table: a row for each rate, a column for each mode."""
        index = pandas().Index(self.rates, name="rate")
        names = [f"mode {j}" for j in range(self.exponents.shape[1])]
        return pandas().DataFrame(self.frequencies, index=index, columns=names)

    def _printed(self) -> TableText:
        head = ["rate", *(f"mode {j}" for j in range(self.exponents.shape[1]))]
        values = np.column_stack([self.rates, self.frequencies])
        rows = [[f"{x:.6g}" for x in row] for row in values]
        return "Frequencies in the rotating frame, rad/s", [head, *rows], ""


def campbell(
    scene: Scene,
    rates: Numbers,
    count: int = 6,
    *,
    design: Sequence[str | DesignVariable] = (),
    progress: bool = False,
) -> Campbell:
    """Return the lowest modes about steady rotation at several rates (Campbell diagram).

    Every equilibrium is searched from the equilibrium at the rate before. Modes are followed by
    their exponents and the derivatives of these in the rate, so that crossings are kept.

    Parameters
    ----------
    scene : Scene
        A scene with a `RotatingFrame`, whose rate is replaced.
    rates : sequence of float
        Ascending rates; rad/s. They must be so close that the exponents are nearly linear between.
    count : int
        Number of modes, the lowest at the first rate; modes that coincide there are not separated,
        so there may be a few more.
    design : sequence of str or DesignVariable
        Design variables to differentiate in, besides the rate.
    progress : bool
        Whether to show a progress bar, which counts the rates.
    """
    frame = _frame_of(scene)
    require_flag("progress", progress)
    require_count("count", count, "Ask for one or more modes.")
    rates = require_array("rates", rates)
    if rates.ndim != 1 or not len(rates) or not np.all(np.diff(rates) > 0):
        rule = "must be a sequence that ascends"
        raise InvalidInputError("rates", rule, rates.tolist(), "For example [0, 50, 100].")
    variables, equilibria, lines = (_RATE, *design), list[Equilibrium](), list[_Lines]()
    for rate in progress_bar(progress, rates.tolist(), desc="campbell", unit="rate"):
        turned = replace(scene, frame=replace(frame, rate=rate))
        at = equilibrium(turned, start=equilibria[-1] if equilibria else None)
        if not at.outcome.success:
            raise NoEquilibriumError(at)
        # Twice as many, so that lines which leave the lowest ones are not lost.
        modes_there = modes(turned, 2 * count, at=at, design=variables, damped=True)
        all_lines = _Lines.of(modes_there, turned)
        if lines:
            which = lines[-1].matched(all_lines, rate - rates[len(lines) - 1])
        else:
            which = _lowest(modes_there, count)
        equilibria.append(at)
        lines.append(all_lines.chosen(which))
    s, s_b = np.array([x.s for x in lines]), np.array([x.s_b for x in lines])
    whirl = np.array([x.whirl for x in lines])
    names = tuple(x.name for x in as_design(variables))
    return Campbell(rates, s, s_b, names, whirl, tuple(equilibria))


@final
@dataclass(frozen=True)
class _Lines:
    """Modes at one rate of a rotating frame: exponents s, derivatives s_b, and sense of whirl."""

    s: Array
    s_b: Array
    whirl: Array

    @staticmethod
    def of(modes: Modes, scene: Scene) -> _Lines:
        assert modes.derivatives is not None
        assert scene.frame is not None
        numbers = np.array(list(scene.frame.parameters().values()))
        J, X = scene.frame.turn(numbers, scene.dimension)[1], modes.shapes.astype(complex)
        turned = np.einsum("ij,vjm->vim", J, X.reshape(-1, len(J), X.shape[1])).reshape(X.shape)
        M_turned = assemble(scene).mass_times(modes.configuration.q, turned)
        along = (X.conj().T @ M_turned - M_turned.conj().T @ X) / 2j
        sizes = turned.conj().T @ M_turned
        size = np.real(np.diagonal(sizes))
        whirl = np.real(np.diagonal(along)) / np.where(size == 0, 1.0, size)
        s_b = modes.derivatives.exponents_b
        for group in map(np.array, modes.coincide):
            # Any combination of coinciding modes is a mode. Circular motions separate as the rate
            # grows: the forward frequency falls in the frame, because no polar inertia exceeds the
            # sum of the two others.
            within = np.ix_(group, group)
            circles = _quotients(along[within], sizes[within])
            if len(circles) == len(group):
                whirl[group[np.argsort(-s_b[group, 0].imag)]] = circles
        return _Lines(modes.exponents, s_b, whirl)

    def chosen(self, which: Array) -> _Lines:
        return _Lines(self.s[which], self.s_b[which], self.whirl[which])

    def matched(self, following: _Lines, step: float) -> Array:
        """Return for each mode its index among the modes at the next rate.

        A smooth curve has the slopes of both ends at the middle. s^2 is smooth where a motion
        ceases to vibrate; of its two real exponents the greater one is followed.
        """
        here, there = self._squares(step / 2), following._squares(-step / 2)
        falls = -_FALLS * following.s.real * np.abs(following.s)
        apart = np.abs(here[:, None] - there) + falls
        return np.asarray(scipy.optimize.linear_sum_assignment(apart)[1])

    def _squares(self, step: float) -> Array:
        """Return s^2 of the modes at a rotation rate larger by `step`, to first order."""
        slopes = 2 * self.s * self.s_b[:, 0]
        # The derivative is infinite where two exponents separate.
        return self.s**2 + step * np.where(np.isfinite(slopes), slopes, 0.0)


def _quotients(A: Array, B: Array) -> Array:
    """Return the eigenvalues w of A - w B, ascending, where B is above round-off."""
    squares, V = np.linalg.eigh(B)
    kept = squares > EPS**0.5 * squares[-1]
    V = V[:, kept] / np.sqrt(squares[kept])
    return np.asarray(np.linalg.eigvalsh(V.conj().T @ A @ V))


def _lowest(modes: Modes, count: int) -> Array:
    """Return the indices of the lowest modes that do not only decay, with whole groups."""
    moving = [j for j, kind in enumerate(modes.kinds) if kind is not ModeKind.DECAYING]
    last = moving[:count][-1:]
    groups = [group for group in modes.coincide if last and last[0] in group]
    return np.array(moving[:count] + [j for group in groups for j in group if j > last[0]])


def _frame_of(scene: Scene) -> RotatingFrame:
    require_kind("scene", scene, (Scene,), "Call Scene(...).")
    if scene.frame is None:
        rule, repair = "must have a RotatingFrame", "Write Scene(..., frame=RotatingFrame(0.0))."
        raise InvalidInputError("campbell, scene", rule, "a scene in a frame at rest", repair)
    return scene.frame
