"""Modes of a system about a configuration, periods of its motions, and a step from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem, Solution, reaction
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError
from ancfdae.errors.outcomes import Verdict
from ancfdae.modes.damped import damped
from ancfdae.modes.derivatives import PullBack, differentiate, differentiate_back
from ancfdae.modes.eigenpairs import Eigenpairs, coincident, without_idle
from ancfdae.modes.linearised import LinearisationPoint, Linearised
from ancfdae.modes.precise import NoModes
from ancfdae.modes.result import ModeDerivatives, ModeKind, Modes
from ancfdae.modes.undamped import undamped
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.inertia import WHOLE
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.threads import in_one_thread
from ancfdae.statics.controlled import about_states
from ancfdae.statics.outcome import motions_in_words

# A group of coinciding modes, such as a pair of a square bar, is completed by at most GROUP modes
# beyond the requested number; a larger group is cut. If modes are differentiated the end of the
# group is searched up to _CROWD modes, which takes a minute.
GROUP, _CROWD = 8, 800


def solve(small: Linearised, count: int, highest: bool, whole: bool = False) -> Eigenpairs:
    """Return the lowest modes, growing ones first, or the highest, by decreasing frequency.

    A group of coinciding modes is complete if `whole`, or if it ends within GROUP further modes.
    InvalidInputError if no motion is free, or a motion has no inertia; NoModes if ARPACK finds
    none, or the end of a whole group is more than _CROWD modes away.
    """
    asked, n = min(count, small.n_modes), small.n_modes
    if n <= 0:
        raise InvalidInputError(
            "modes", "need a motion that the joints leave free", "none", "Remove a joint or clamp."
        )
    wanted = min(asked + 2, n)
    while True:
        method = partial(undamped, asked=asked) if small.D is None else damped
        try:
            pairs = method(small, wanted, highest)
        except scipy.sparse.linalg.ArpackError as error:
            raise NoModes(f"{wanted} modes: {error}. Ask for another number.") from error
        first = pairs.first(asked)
        if len(first.z) < len(pairs.z) or wanted == n:
            return first
        # All rigid motions are searched: if they do not end, the other modes are below round-off.
        if not whole and wanted > asked + GROUP and first.z[-1] != 0:
            return first
        wanted = min(max(2 * wanted, asked + GROUP + 1), n)
        if wanted > asked + _CROWD:
            _refuse_crowd(small, first)


def _refuse_crowd(small: Linearised, pairs: Eigenpairs) -> None:
    """Raise NoModes for a last group of coinciding modes that is too large."""
    alone = coincident(pairs)[-1][0]
    repairs = [f"ask for {alone} modes or fewer"] if alone else []
    repairs += ["pass damped=False"] if np.iscomplexobj(pairs.z) else []
    raise NoModes(
        f"mode {alone}: more than {len(pairs.z) - alone - 1} others coincide with it to round-off"
        + small.words(
            ", as motions that creep do next to -1 over the retardation time. Leave out the design "
            "variables, use fewer elements",
            ". Change the design so that they differ by more than a millionth of themselves",
        )
        + f"{''.join(f', or {repair}' for repair in repairs)}."
    )


def modes_about(
    system: MechanicalSystem,
    at: LinearisationPoint,
    count: int,
    highest: bool,
    damped: bool | None,
    pull_back: PullBack | None,
    saddle: SaddlePoint | None,
    mass: Factorization | None,
) -> Modes:
    """Return modes about a configuration; InvalidInputError if it does not fit the system.

    Also if a motion has no inertia. Velocity forces are included if `damped`, by default if there
    are any. `pull_back` maps derivatives in q, lam and b to the design (adjoint); without it modes
    are differentiated directly, along the derivatives of the configuration.
    """
    small = Linearised.of(system, at, damped, saddle, mass)
    # The integrals of states come among the lowest motions.
    more = 0 if highest else len(small.idle)
    pairs = solve(small, count + more, highest, whole=system.n_b > 0)
    if len(small.idle):
        pairs = without_idle(small, pairs)
    mu = small.multipliers(pairs.z, pairs.X)
    groups = coincident(pairs)
    s, derivatives = exponents(small, pairs.z), None
    shown = len(s) if len(s) <= count + GROUP else count
    if system.n_b:
        parts = small, pairs, mu, groups
        back = pull_back
        z_b, X_b = differentiate(*parts) if back is None else differentiate_back(*parts, back)
        s_b = _exponents_b(small, s, z_b)
        derivatives = ModeDerivatives(system.design_names, s_b[:shown], X_b[:shown])
    s, X = s[:shown], pairs.X[:, :shown]
    rigid = X[:, s == 0].real
    within = [tuple(j for j in group if j < shown) for group in groups]
    cut = [part for group, part in zip(groups, within, strict=True) if 0 < len(part) < len(group)]
    return Modes(
        s,
        X,
        mu[:, :shown],
        tuple(map(_kind, s)),
        tuple(part for part in within if len(part) > 1),
        cut[0] if cut else (),
        small.at,
        small.unbalanced,
        motions_in_words(system.naming, at.q, rigid) if rigid.size else "",
        derivatives,
    )


def growth(system: MechanicalSystem, at: LinearisationPoint) -> tuple[bool, complex | None]:
    """Return whether growing motions were searched about a configuration, and the exponent of one.

    Damping, controllers and gyroscopic forces count. They can make an equilibrium unstable beside
    forces without a potential only: where K is symmetric nothing is searched, nor in systems of
    more than 1,500 independent motions. The exponent is None if no motion grows.
    """
    small = Linearised.of(system, at, None)
    stable = small.D is None or (not len(small.idle) and small.is_symmetric(small.K))
    if stable or small.n_free > WHOLE:
        return False, None
    pairs = solve(small, 1 + len(small.idle), False)
    first = complex(pairs.z[np.argmax(pairs.z.real)])
    return True, first if first.real > 0 else None


def exponents(small: Linearised, z: Array) -> Array:
    """Return the exponents s with Im s >= 0, or s > 0 if z = -s^2 is negative, shape (count,)."""
    if small.D is not None:
        return z
    s = np.sqrt(-z.astype(complex))
    return np.asarray(np.where(s.imag < 0, -s, s)) + 0.0  # Adding zero turns -0 into 0.


def _exponents_b(small: Linearised, s: Array, z_b: Array) -> Array:
    """Return the design derivatives s_b, shape (count, n_b); zero for rigid motions."""
    if small.D is not None:
        return z_b
    s, infinite = s[:, None], np.isinf(z_b)
    s_b = -0.5 * np.where(infinite, 0.0, z_b) / np.where(s == 0, 1.0, s)
    return np.where(infinite, np.inf, np.where(s == 0, 0.0, s_b))


def _kind(s: complex) -> ModeKind:
    if s == 0:
        return ModeKind.RIGID
    if s.real > 0:
        return ModeKind.GROWING
    return ModeKind.VIBRATION if s.imag else ModeKind.DECAYING


@final
@dataclass(frozen=True)
class StepSuggestion:
    """A suggested step and the periods that it comes from; returned by `suggest_step`.

    Attributes
    ----------
    step : float
        Suggested step, `resolved` / `per_period`; s.
    fastest, slowest : float
        Shortest and longest period, 2 pi / |s|, of motions that vibrate or grow; s.
    resolved : float
        Period of the fastest mode that the step resolves; s.
    per_period : float
        Number of steps in the period `resolved`; dimensionless.
    """

    step: float
    fastest: float
    slowest: float
    resolved: float
    per_period: float

    def __str__(self) -> str:
        return (
            f"A step of {self.step:.3g} takes {self.per_period:.6g} steps in a period of "
            f"{self.resolved:.3g}; periods range from {self.fastest:.3g} to {self.slowest:.3g}."
        )


def suggestion(
    system: MechanicalSystem, at: LinearisationPoint, per_period: float, follow: int | None
) -> StepSuggestion:
    """Return a step that follows the `follow` slowest motions, or all; see `suggest_step`."""
    small = Linearised.of(system, at, False)
    turning = _turning(small, 1 if follow is None else follow)
    slow = 2 * np.pi / _speeds(small, 1 if follow is None else follow, False, turning)
    fastest = 2 * np.pi / _speeds(small, 1, True, turning)[-1]
    resolved = fastest if follow is None else float(slow[min(follow, len(slow)) - 1])
    return StepSuggestion(
        resolved / per_period, float(fastest), float(slow[0]), float(resolved), per_period
    )


def fastest(system: MechanicalSystem, at: LinearisationPoint) -> float:
    """Return the largest |s| of small motions x e^{st}, estimated if damped; 1/s.

    With damping it is the larger |s| of s^2 + (x^T D x) s + omega^2 = 0 for the fastest undamped
    motion x.
    """
    small = Linearised.of(system, at, None)
    pairs = solve(replace(small, D=None), 1, True)
    x, speed = pairs.X[:, -1], float(np.sqrt(np.abs(pairs.z[-1])))
    if small.D is None:
        return speed
    half = abs(float(x @ system.pattern.dot(small.D, x[:, None])[:, 0])) / 2
    return half + float(np.sqrt(half**2 - speed**2)) if half > speed else speed


# Largest number of coordinates for which dense methods find all modes in a fraction of a second.
_QUICK = 120
_CURED_BY_STEP = (Verdict.NO_CONVERGENCE, Verdict.NOT_FINITE, Verdict.STEP_LIMIT)


@in_one_thread
def advice(system: MechanicalSystem, t: float, q: Array, v: Array, lam: Array) -> str:
    """Return advice on the step: periods of small motions about a state; empty without any.

    Of the velocities v states of controllers count, which forces depend on.

    The text is empty for systems of more than _QUICK coordinates, too: a message must not take
    longer than the run that ends with it.
    """
    if system.n_q > _QUICK:
        return ""
    system = about_states(system, q, v)
    try:
        with np.errstate(all="ignore"):
            near = suggestion(system, LinearisationPoint(q, lam, t=t), 1.0, None)
    except (AncfdaeError, scipy.linalg.LinAlgError):
        return ""
    return (
        f"Small motions there have periods from {near.fastest:.3g} to {near.slowest:.3g}; the "
        "step decides which of them are followed (`suggest_step`)."
    )


def advised(system: MechanicalSystem, run: Solution) -> Solution:
    """Return a run with periods of small motions in its outcome if another step may help."""
    outcome = run.outcome
    if outcome.verdict not in _CURED_BY_STEP or not len(run.t) or np.iscomplexobj(run.q):
        return run
    periods = advice(system, float(run.t[-1]), run.q[-1], run.v[-1], run.lam[-1])
    if not periods or periods in outcome.advice:  # as in a run that failed in its first step
        return run
    return replace(run, outcome=replace(outcome, advice=f"{outcome.advice} {periods}".lstrip()))


def _turning(small: Linearised, follow: int) -> float:
    """Return the rotation rate of slow motions driven by unbalanced forces; 1/s.

    For an acceleration a from zero velocity the joints add a' with Phi_q a' = -Phi_qq[a, a]: a^2/l
    for a pendulum of length l, so |a'|/|a| is the square of the rate, g/l for a horizontal
    pendulum, which has no stiffness. Zero in an equilibrium and where all joints are linear.
    """
    system, at = small.system, small.at
    if small.unbalanced == 0 or not system.n_lam:
        return 0.0
    force = system.force(at.t, at.q, np.zeros(system.n_q)) - reaction(system, at.t, at.q, at.lam)
    X = solve(small, follow, False).X
    a = X @ (X.T @ force)
    size = float(small.squares(a[:, None])[0]) ** 0.5
    if size == 0:
        return 0.0
    # With a of unit length neither its size nor that of q matters.
    a = a / size
    slope = np.imag(system.constraint_q(at.t, at.q + 1j * STEP * a)) / STEP
    turned = system.constraint_pattern.dot(slope, a)
    change = small.mass_factors.solve(np.concatenate([0 * a, -turned]))[: len(a)]
    return float((size * small.squares(change[:, None])[0] ** 0.5) ** 0.5)


def _speeds(small: Linearised, count: int, highest: bool, turning: float) -> Array:
    """Return |s| of the given number of motions that are not rigid, in increasing order; 1/s.

    No value is less than `turning`, the rotation rate due to unbalanced forces.
    """
    asked = count
    while True:
        z = solve(small, asked, highest).z
        speeds = np.sqrt(np.sort(np.abs(z[z != 0])))
        if len(speeds) >= count or asked >= small.n_free:
            break
        asked = min(2 * asked + 6, small.n_free)
    if not len(speeds) and turning:
        return np.array([turning])
    if not len(speeds):
        raise InvalidInputError(
            "suggest_step",
            "needs a motion that vibrates",
            "rigid motions only",
            "Choose the step from the speed of the motion.",
        )
    return np.asarray(np.maximum(speeds, turning))
