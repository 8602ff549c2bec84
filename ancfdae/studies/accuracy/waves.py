"""Waves that numerical damping removes from a run, and the errors of numbers that this causes.

A wave of frequency omega is damped by rho(omega h) < 1 in a step of HHT-I3, by (1 + alpha)/(1 -
alpha) where omega h >> 1. Runs that have lost it agree with each other. Only its beginning remains:
in the accelerations it has its true amplitude for the first steps, of whatever size, and the
largest second differences s contain it (the least of four in a row counts: a kink makes two or
three). From s follow the amplitude x of the wave, its frequency and its physical decay c,

    K x + Phi_q^T mu = M s/(2 sin^2(theta/2)),   tan(theta/2) = omega h/2,
    omega^2 = x^T K x / x^T M x,                 c = x^T D x / 2 x^T M x

(twice the amplitude of a single wave). The wave is x cos(omega t) e^(-c t); a run contains x
cos(omega t) rho^(t/h), with rho(omega h, c h) of the recurrence with physical damping. Each is
added to the states of the run: the difference of the numbers computed from the two is the possible
error of the run. A wave that physical damping removes faster than numerical damping changes little.
The derivative of the phase, omega t / 2, comes from another frequency.

**Motions that fade.** A method that damps waves may be used where physics damps them too, and does
so faster. The waves of a run show the largest one only; the eigenvalues s of M s^2 + D s + K on the
motions that constraints permit, about the start of a run, show all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.objectives.objective import ObjectivePartials
from ancfdae.sensitivity.observables.observable import States, states_of

# Number of second differences in a row of which the least counts.
_ROW = 4
# Assumed amplitude over the amplitude of a single wave with these second differences.
_AT_MOST = 2.0
# Waves of less than this angle per step, rad, are part of the smooth motion.
_SMOOTH = 0.05
# Waves of less than this angle per step, rad, count as resolved; the recurrence has nearly a double
# root there.
_FINE = 1e-3
# Largest fraction of a wave, or phase error in rad, whose loss does not count.
_KEPT = 0.02
# Phases of a wave that are tried, rad; largest angle per step of a sampled wave, rad; and phase
# difference at the end of the run that a perturbed frequency makes, rad.
_PHASES, _ANGLE, _TURN = (0.3, 0.3 + math.pi / 2), 1.9, 1e-2
# Logarithmic derivative of a frequency in a design variable: 1/2 for moduli and densities, 1 for
# heights.
_POWER = 1.0

# Numbers of states: a vector for each objective, or observable; and the partials of objectives.
Numbers = Callable[[States], Sequence[Array]]
Partials = Callable[[States], Sequence[ObjectivePartials]]


@final
class Wave(NamedTuple):
    """A wave from the time `begin` on: amplitudes of q and lam, frequency and damping c, 1/s."""

    begin: float
    q: Array
    lam: Array
    speed: float
    damping: float

    @property
    def decay(self) -> float:
        """Rate of decay, 1/s; of an overdamped motion the slower one of its two rates."""
        c = self.damping
        if c <= self.speed:
            return c
        return self.speed**2 / (c + math.sqrt(c**2 - self.speed**2))

    def kept(self, h: float, alpha: float) -> float:
        """Return the rate of decay in a run of HHT-I3 with the step h, 1/s."""
        rho = radius(self.speed * h, alpha, 2 * self.damping * h)
        return max(-math.log(rho), 0.0) / h

    def missed(self, t_end: float, steps: float, alpha: float) -> float:
        """Return the largest fraction of the amplitude by which a run errs at any time."""
        kept = self.kept(t_end / steps, alpha)
        t = np.geomspace(1e-3 * min(1 / max(self.decay, kept, 1 / t_end), t_end), t_end, 50)
        return float(np.abs(np.exp(-self.decay * t) - np.exp(-kept * t)).max())

    def turned(self, t_end: float, steps: float) -> float:
        """Return the approximate phase error of a run of HHT-I3, rad, while the wave lasts.

        It is omega^3 h^2 t (1/12 - alpha/4 - ...): chapter 13 of the theory.
        """
        lasts = min(t_end, 1 / self.decay) if self.decay else t_end
        return self.speed * lasts * (self.speed * t_end / steps) ** 2 / 10

    def over(self, t: Array, angle: float, phase: float, decay: float) -> tuple[Array, Array]:
        """Return cosine and sine at times t of a wave of frequency `angle`, rad/s, with decay."""
        t = t - self.begin
        # The beginning of the wave is part of the run.
        size = (t > 0) * np.exp(-decay * np.maximum(t, 0.0))
        return size * np.cos(angle * t + phase), size * np.sin(angle * t + phase)

    def added(self, states: States, angle: float, phase: float, decay: float) -> States:
        """Return the states with this wave added, at the frequency `angle`, rad/s, and decay."""
        cos, sin = self.over(states.t, angle, phase, decay)
        q, lam = states.q + np.outer(cos, self.q), states.lam + np.outer(cos, self.lam)
        v = states.v - self.speed * np.outer(sin, self.q)
        return replace(states, q=q, v=v, lam=lam)


class Missed(NamedTuple):
    """Possible errors by a wave: of a number and of its logarithmic design derivatives."""

    value: Array
    slope: Array


class Lost(NamedTuple):
    """Possible errors of numbers by waves that steps do not resolve.

    `parts` are errors from numerical damping, `whole` the entire effect of the unresolved waves.
    """

    parts: list[Missed]
    whole: list[Missed]


class Unresolved(NamedTuple):
    """A wave that a run does not resolve, of the motion or of its derivative in a variable.

    The variable is -1 for the motion. `kept` is the rate of decay in the run, 1/s; `lost` says that
    the run has another amplitude of it, `damped` that the run damps it faster than physics does. A
    wave that lasts longer than it should shows in the differences of runs.
    """

    variable: int
    wave: Wave
    kept: float
    lost: bool

    @property
    def damped(self) -> bool:
        """Whether the run damps the wave, and faster than physics does."""
        return self.lost and self.kept > self.wave.decay


def _rows(run: Solution) -> list[Array]:
    """Return accelerations, (n_t, n_q), and their derivatives in each variable if present."""
    if run.sensitivities is None:
        return [run.a]
    return [run.a, *np.moveaxis(run.sensitivities.a_b, 2, 0)]


def _lasting(a: Array, weights: Array) -> Array:
    """Return the least norm of _ROW successive second differences of a, at each time point."""
    sizes = np.sqrt(np.diff(a, n=2, axis=0) ** 2 @ weights)
    if len(sizes) < _ROW:
        return np.zeros(0)
    return np.min(np.lib.stride_tricks.sliding_window_view(sizes, _ROW), axis=1)


def radius(angle: float, alpha: float, damped: float = 0.0) -> float:
    """Return the factor of HHT-I3 per step on a wave of omega h = `angle`, 2 c h = `damped`.

    It is the largest eigenvalue in magnitude of the recurrence of (q, h v, h^2 a) of q'' + 2 c q' +
    omega^2 q = 0.
    """
    gamma, beta, W, D = 0.5 - alpha, (1 - alpha) ** 2 / 4, angle**2, damped
    # q' = q + v + (1/2 - beta) a + beta a', v' = v + (1 - gamma) a + gamma a',
    # a' + (1 + alpha) (W q' + D v') - alpha (W q + D v) = 0; all in powers of h.
    left = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 + alpha) * W, (1 + alpha) * D, 1]])
    right = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [alpha * W, alpha * D, 0]])
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(left, right))).max())


def waves_of(problem: InitialValueProblem, run: Solution) -> dict[int, Wave]:
    """Return the largest waves in the accelerations and in their derivatives, by variable.

    The motion has the number -1. Waves that cannot be computed are left out.
    """
    rows, places = _rows(run), dict[int, int]()
    for j, a in enumerate(rows, -1):
        lasting = _lasting(a, problem.system.weights)
        if lasting.size and lasting.max() > 0:
            places[j] = int(np.argmax(lasting))
    if not places:
        return {}
    n = np.array(list(places.values())) + 1
    try:
        at = problem.system.linearise(*(x[n] for x in (run.t, run.q, run.v, run.a, run.lam)))
    except AncfdaeError:
        return {}
    masses = np.broadcast_to(at.M, (len(n), at.M.shape[1]))
    dampings = [None] * len(n) if at.f_v is None else list(at.f_v)
    found = dict[int, Wave]()
    for j, M, K, D, Phi_q in zip(places, masses, at.f_q, dampings, at.Phi_q, strict=True):
        k = places[j]
        s, h = np.diff(rows[j + 1][k : k + 3], n=2, axis=0)[0], float(run.t[k + 1] - run.t[k])
        wave = _wave(problem, (M, K, D, Phi_q), s, (float(run.t[k]), h))
        if wave is not None:
            found[j] = wave
    return found


def _wave(
    problem: InitialValueProblem,
    matrices: tuple[Array, Array, Array | None, Array],
    s: Array,
    step: tuple[float, float],
) -> Wave | None:
    """Return the wave of second differences s in a step (t, h); None if it cannot be computed."""
    (M, K, D, Phi_q), (t, h), n_q = matrices, step, problem.system.n_q
    dot = problem.system.pattern.dot
    try:
        factors = problem.matrices.factor(K + (_SMOOTH / h) ** 2 * M, Phi_q)
    except AncfdaeError:
        return None
    both = factors.solve(np.append(dot(M, s), np.zeros(problem.system.n_lam)))
    x, mu = both[:n_q], both[n_q:]
    inertia = float(x @ dot(M, x))
    if not inertia > 0:
        return None
    speed = math.sqrt(max(float(x @ dot(K, x)) / inertia, (_SMOOTH / h) ** 2))
    size = _AT_MOST / 4 * (1 + (2 / (speed * h)) ** 2)
    damping = 0.0 if D is None else float(x @ dot(D, x)) / (2 * inertia)
    return Wave(t, size * x, size * mu, speed, max(damping, 0.0))


def followed(waves: Sequence[Wave], t_end: float, alpha: float, at_least: float) -> float:
    """Return a number of steps, `at_least` times 1.4^n, that keeps waves as long as they last."""
    steps = at_least
    while any(
        wave.speed * t_end / steps > _FINE and wave.missed(t_end, steps, alpha) > _KEPT
        for wave in waves
    ):
        steps *= 1.4
    return steps


def unresolved(
    problem: InitialValueProblem, run: Solution, alpha: float, phases: bool
) -> list[Unresolved]:
    """Return the waves that a run does not resolve; with `phases` also those of wrong phase."""
    T, steps = float(run.t[-1]), len(run.t) - 1
    found = list[Unresolved]()
    for j, wave in waves_of(problem, run).items():
        lost = wave.missed(T, steps, alpha) > _KEPT
        if lost or (phases and wave.turned(T, steps) > _KEPT):
            found.append(Unresolved(j, wave, wave.kept(T / steps, alpha), lost))
    return found


def missed(
    problem: InitialValueProblem,
    run: Solution,
    waves: Sequence[Unresolved],
    asked: tuple[Numbers, Sequence[bool], Partials | None],
) -> Lost:
    """Return possible errors of numbers by waves that a run does not resolve.

    `asked` holds the numbers, whether each is an integral over time, in which a wave averages out,
    and the partials of the numbers, which weigh waves of derivatives.
    """
    numbers, integrated, partials = asked
    states = states_of(run)
    plain = numbers(states) if waves else []
    slopes = [] if partials is None or all(x.variable < 0 for x in waves) else partials(states)
    sizes = [x.shape for x in plain] if waves else [(1,)] * len(integrated)
    lost = Lost(*([Missed(np.zeros(x), np.zeros(problem.system.n_b)) for x in sizes] for _ in "pw"))
    for x in waves:
        if x.variable < 0:
            _of_the_motion(x, states, (numbers, plain, integrated), lost)
        else:
            scale = abs(float(problem.system.b[x.variable])) or 1.0
            _of_a_derivative(x, states, slopes, scale, lost)
    return lost


def _of_the_motion(
    found: Unresolved,
    states: States,
    asked: tuple[Numbers, Sequence[Array], Sequence[bool]],
    lost: Lost,
) -> None:
    """Add possible errors of numbers and their derivatives by a wave of the motion to `lost`."""
    (numbers, plain, integrated), wave = asked, found.wave
    h, T = float(states.t[1] - states.t[0]), float(states.t[-1])
    angle = min(wave.speed, _ANGLE / h)
    angles = angle, angle + _TURN / T
    for phase in _PHASES:
        true, detuned = (numbers(wave.added(states, x, phase, wave.decay)) for x in angles)
        left, moved = (numbers(wave.added(states, x, phase, found.kept)) for x in angles)
        for k, x in enumerate(true):
            speed = angle if integrated[k] else wave.speed
            kinds = (lost.parts[k], left[k], moved[k]), (lost.whole[k], plain[k], plain[k])
            for part, y, z in kinds:
                value = np.abs(x - y)
                np.maximum(part.value, value, out=part.value)
                turned = float(np.abs(detuned[k] - z - x + y).max()) * speed * T / _TURN
                slope = _POWER * turned + float(value.max())
                np.maximum(part.slope, slope, out=part.slope)


def _of_a_derivative(
    found: Unresolved,
    states: States,
    partials: Sequence[ObjectivePartials],
    scale: float,
    lost: Lost,
) -> None:
    """Add to `lost` the possible errors by a wave in a design derivative of the motion."""
    wave, j = found.wave, found.variable
    angle = min(wave.speed, _ANGLE / float(states.t[1] - states.t[0]))
    for k, each in enumerate(partials):
        on_q, on_v, on_lam = (
            0.0 if weights is None else weights @ x
            for weights, x in (
                (each.q, wave.q),
                (each.v, -wave.speed * wave.q),
                (each.lam, wave.lam),
            )
        )
        largest = np.zeros(2)
        for phase in _PHASES:
            true, left = (
                float(np.sum(cos * (on_q + on_lam) + sin * on_v))
                for cos, sin in (
                    wave.over(states.t, angle, phase, x) for x in (wave.decay, found.kept)
                )
            )
            largest = np.maximum(largest, [abs(true - left), abs(true)])
        lost.parts[k].slope[j] += scale * largest[0]
        lost.whole[k].slope[j] += scale * largest[1]


# -- motions that fade -------------------------------------------------------------------------


# Most coordinates with which dense matrices take milliseconds.
_DENSE: Final = 60
# Largest |s| h of motions that steps of HHT-I3 resolve.
_RESOLVED: Final = 0.5
# Number of times at which the spectrum of a run is computed.
_PLACES: Final = 7
# Logarithm of the largest remaining amplitude of a motion that has faded at the end of a run.
_FADED: Final = -5.0


def fades(system: MechanicalSystem, run: Solution) -> bool:
    """Return whether all motions about the start that steps do not resolve die out in the run.

    False if there are none, or more than _DENSE coordinates.
    """
    spectra = _spectra(system, run, 1) if len(run.t) > 2 else []
    if not spectra:
        return False
    s = spectra[0]
    fast = s[np.abs(s) * (run.t[2] - run.t[1]) > _RESOLVED]
    return bool(fast.size) and bool(np.all(fast.real * run.t[-1] < _FADED))


def speed(problem: InitialValueProblem) -> float:
    """Return the largest |s| of motions e^(s t) about the start, 1/s; zero without vibration."""
    from ancfdae.modes.analysis import fastest
    from ancfdae.modes.linearised import LinearisationPoint

    initial = problem.initial
    try:
        at = LinearisationPoint(initial.q, initial.lam, t=initial.t)
        return fastest(problem.system, at)
    except AncfdaeError:
        return 0.0


def pace(system: MechanicalSystem, run: Solution) -> float | None:
    """Return the mean over a run of the largest |s| of motions e^(s t) about its states, 1/s.

    None if the spectra are not known (`_spectra`).
    """
    spectra = _spectra(system, run, *np.linspace(0, len(run.t) - 1, _PLACES + 2)[1:-1].astype(int))
    return float(np.mean([np.abs(s).max() for s in spectra])) if spectra else None


def _spectra(system: MechanicalSystem, run: Solution, *places: int) -> list[Array]:
    """Return the eigenvalues about the states with indices `places`; empty if unknown."""
    if system.n_q > _DENSE:
        return []
    rows = np.array(places)
    try:
        at = system.linearise(*(x[rows] for x in (run.t, run.q, run.v, run.a, run.lam)))
    except AncfdaeError:
        return []
    if at.f_v is None:
        return []
    masses = np.broadcast_to(at.M, (len(rows), at.M.shape[1]))
    parts = zip(masses, at.f_v, at.f_q, at.Phi_q, strict=True)
    return [_spectrum(system, *x) for x in parts]


def _spectrum(system: MechanicalSystem, M: Array, D: Array, K: Array, Phi_q: Array) -> Array:
    """Return eigenvalues s of M s^2 + D s + K, 1/s, for motions that Phi_q permits, (2 n,)."""
    Z = np.eye(system.n_q)
    if system.n_lam:
        Z = scipy.linalg.null_space(system.constraint_pattern.dense(Phi_q))
    m, d, k = (Z.T @ system.pattern.dense(x) @ Z for x in (M, D, K))
    none, one = np.zeros_like(m), np.eye(len(m))
    left = np.block([[none, one], [-np.linalg.solve(m, k), -np.linalg.solve(m, d)]])
    return np.asarray(np.linalg.eigvals(left))
