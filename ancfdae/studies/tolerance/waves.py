"""Waves that numerical damping takes away from a run, and what its numbers miss without them.

A wave of the frequency omega is damped by rho(omega h) < 1 in a step of HHT-I3, by (1 + alpha)/(1 -
alpha) where omega h >> 1. Runs that have lost it agree with each other. What is left of it is its
beginning: in the accelerations it has its true amplitude for the first steps, whatever these are,
and the largest second differences s hold it (the least of four in a row counts: a kink makes two or
three). From s follow the amplitude x of the wave, its frequency and its physical decay c,

    K x + Phi_q^T mu = M s/(2 sin^2(theta/2)),   tan(theta/2) = omega h/2,
    omega^2 = x^T K x / x^T M x,                 c = x^T D x / 2 x^T M x

(twice what a single wave has). The wave is x cos(omega t) e^(-c t); a run has x cos(omega t)
rho^(t/h) of it, rho(omega h, c h) with the physical damping in the recurrence. Each is added to the
states of the run: by what the numbers of the two differ is what the run may miss. A wave that
physical damping takes away faster than the recurrence does changes little. The derivative of the
phase, omega t / 2, comes from another frequency.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.states import States, states_of

# Second differences in a row of which the least counts.
_ROW = 4
# Amplitude in the accelerations over that of a single wave with these second differences.
_AT_MOST = 2.0
# Waves of less than this angle per step are part of the smooth motion.
_SMOOTH = 0.05
# Waves of less than this angle per step are followed; the recurrence is close to a double root.
_FINE = 1e-3
# Share of a wave whose loss does not count.
_KEPT = 0.02
# Phases at which a wave is tried, its angle per step in integrals, where the steps sample it, and
# the change of its phase at the end of the run in another frequency.
_PHASES, _ANGLE, _TURN = (0.3, 0.3 + math.pi / 2), 1.9, 1e-2
# Logarithmic derivative of a frequency in a design variable: 1/2 for moduli and densities, 1 for
# heights.
_POWER = 1.0

# Waves of derivatives are tried as changes of the motion of this size, over that of q.
_SMALL = 1e-6

# Numbers of states: a vector for each objective, or observable.
Numbers = Callable[[States], Sequence[Array]]


@final
class Wave(NamedTuple):
    """A wave from an instant on: amplitudes of q and lam, frequency and damping c, 1/s."""

    begin: float
    q: Array
    lam: Array
    speed: float
    damping: float

    @property
    def decay(self) -> float:
        """Rate of decay; an overdamped motion has that of the slower one of its two; 1/s."""
        c = self.damping
        if c <= self.speed:
            return c
        return self.speed**2 / (c + math.sqrt(c**2 - self.speed**2))

    def kept(self, h: float, alpha: float) -> float:
        """Return the rate of decay in a run of HHT-I3 with the step h, 1/s."""
        rho = radius(self.speed * h, alpha, 2 * self.damping * h)
        return max(-math.log(rho), 0.0) / h

    def missed(self, t_end: float, steps: float, alpha: float) -> float:
        """Return the largest share of the amplitude by which a run errs at any time."""
        kept = self.kept(t_end / steps, alpha)
        t = np.geomspace(1e-3 * min(1 / max(self.decay, kept, 1 / t_end), t_end), t_end, 50)
        return float(np.abs(np.exp(-self.decay * t) - np.exp(-kept * t)).max())

    def turned(self, t_end: float, steps: float) -> float:
        """Return about how far the phase of a run of HHT-I3 is off while the wave lasts.

        It is omega^3 h^2 t (1/12 - alpha/4 - ...): chapter 13 of the theory.
        """
        lasts = min(t_end, 1 / self.decay) if self.decay else t_end
        return self.speed * lasts * (self.speed * t_end / steps) ** 2 / 10

    def added(self, states: States, angle: float, phase: float, decay: float) -> States:
        """Return the states with the wave as one of another frequency, `angle`, and decay."""
        t = states.t - self.begin
        # The beginning is part of the run.
        size = (t > 0) * np.exp(-decay * np.maximum(t, 0.0))
        cos, sin = (size * f(angle * t + phase) for f in (np.cos, np.sin))
        q, lam = states.q + np.outer(cos, self.q), states.lam + np.outer(cos, self.lam)
        v = states.v - self.speed * np.outer(sin, self.q)
        return replace(states, q=q, v=v, lam=lam)


class Missed(NamedTuple):
    """Possible errors by a wave: of a number and of its logarithmic derivatives."""

    value: Array
    slope: Array


class Lost(NamedTuple):
    """What numbers may miss by waves.

    `parts` is what a run misses by its numerical damping, `whole` is all that the waves which it
    does not resolve change, and `waves` are those that it damps more than physics does.
    """

    parts: list[Missed]
    whole: list[Missed]
    waves: list[Wave]


def _rows(run: Solution) -> list[Array]:
    """Return accelerations, and their derivatives in each variable if the run has them."""
    if run.sensitivities is None:
        return [run.a]
    return [run.a, *np.moveaxis(run.sensitivities.a_b, 2, 0)]


def _lasting(a: Array, weights: Array) -> Array:
    """Return the least of second differences in a row, beginning at every instant."""
    sizes = np.sqrt(np.diff(a, n=2, axis=0) ** 2 @ weights)
    if len(sizes) < _ROW:
        return np.zeros(0)
    return np.min(np.lib.stride_tricks.sliding_window_view(sizes, _ROW), axis=1)


def radius(angle: float, alpha: float, damped: float = 0.0) -> float:
    """Return by what HHT-I3 multiplies a wave of omega h = `angle`, 2 c h = `damped` in a step.

    The largest eigenvalue in size of the recurrence of (q, h v, h^2 a) of q'' + 2 c q' + omega^2 q
    = 0.
    """
    gamma, beta, W, D = 0.5 - alpha, (1 - alpha) ** 2 / 4, angle**2, damped
    # q' = q + v + (1/2 - beta) a + beta a', v' = v + (1 - gamma) a + gamma a',
    # a' + (1 + alpha) (W q' + D v') - alpha (W q + D v) = 0; all in powers of h.
    left = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 + alpha) * W, (1 + alpha) * D, 1]])
    right = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [alpha * W, alpha * D, 0]])
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(left, right))).max())


def wave_of(system: MechanicalSystem, run: Solution, a: Array) -> Wave | None:
    """Return the largest wave in accelerations, or in derivatives of them; None if unknown."""
    lasting = _lasting(a, system.weights)
    if not lasting.size or not lasting.max() > 0:
        return None
    n = int(np.argmax(lasting))
    s = a[n] - 2 * a[n + 1] + a[n + 2]
    states = (x[n + 1 : n + 2] for x in (run.q, run.v, run.a, run.lam))
    h, dot = float(run.t[n + 1] - run.t[n]), system.pattern.dot
    try:
        at = system.linearise(run.t[n + 1 : n + 2], *states)
        M, K, Phi_q = at.M[0], at.f_q[0], at.Phi_q[0]
        saddle = saddle_point(system, float(run.t[n + 1]), run.q[n + 1])
        factors = saddle.factor(K + (_SMOOTH / h) ** 2 * M, Phi_q)
    except AncfdaeError:
        return None
    both = factors.solve(np.append(dot(M, s), np.zeros(system.n_lam)))
    x, mu = both[: system.n_q], both[system.n_q :]
    inertia = float(x @ dot(M, x))
    if not inertia > 0:
        return None
    speed = math.sqrt(max(float(x @ dot(K, x)) / inertia, (_SMOOTH / h) ** 2))
    size = _AT_MOST / 4 * (1 + (2 / (speed * h)) ** 2)
    damping = 0.0 if at.f_v is None else float(x @ dot(at.f_v[0], x)) / (2 * inertia)
    return Wave(float(run.t[n]), size * x, size * mu, speed, max(damping, 0.0))


def followed(waves: Sequence[Wave], t_end: float, alpha: float, at_least: float) -> float:
    """Return the steps, `at_least` times a power of 1.4, that keep waves as long as they last."""
    steps = at_least
    while any(
        wave.speed * t_end / steps > _FINE and wave.missed(t_end, steps, alpha) > _KEPT
        for wave in waves
    ):
        steps *= 1.4
    return steps


def missed(
    system: MechanicalSystem,
    run: Solution,
    alpha: float,
    numbers: Numbers,
    integrated: Sequence[bool],
    phases: bool,
) -> Lost:
    """Return possible errors of numbers by the waves of a run; infinite if they are unknown.

    Where a number is `integrated` over the instants, it sees the mean of a wave. With `phases`
    waves count as unresolved whose phases are off, too.
    """
    states, T, steps = states_of(run), float(run.t[-1]), len(run.t) - 1
    plain, lost = numbers(states), Lost([], [], [])
    for parts in (lost.parts, lost.whole):
        parts += [Missed(np.zeros(x.shape), np.zeros(system.n_b)) for x in plain]
    for j, a in enumerate(_rows(run), -1):
        wave = wave_of(system, run, a)
        if wave is None:
            continue
        share, kept = wave.missed(T, steps, alpha), wave.kept(T / steps, alpha)
        if share <= _KEPT and not (phases and wave.turned(T, steps) > _KEPT):
            continue
        # One that lasts longer than it should shows in the differences of runs.
        if share > _KEPT and kept > wave.decay:
            lost.waves.append(wave)
        if j < 0:
            _of_the_motion(wave, kept, states, (numbers, plain, integrated), lost)
        else:
            scale = abs(float(system.b[j])) or 1.0
            _of_a_derivative(wave, kept, states, (numbers, plain), lost, (j, scale))
    return lost


def _of_the_motion(
    wave: Wave,
    kept: float,
    states: States,
    asked: tuple[Numbers, Sequence[Array], Sequence[bool]],
    lost: Lost,
) -> None:
    """Add what numbers and their derivatives miss by a wave of the motion."""
    numbers, plain, integrated = asked
    h, T = float(states.t[1] - states.t[0]), float(states.t[-1])
    angle = min(wave.speed, _ANGLE / h)
    angles = angle, angle + _TURN / T
    for phase in _PHASES:
        true, detuned = (numbers(wave.added(states, x, phase, wave.decay)) for x in angles)
        left, moved = (numbers(wave.added(states, x, phase, kept)) for x in angles)
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
    wave: Wave,
    kept: float,
    states: States,
    asked: tuple[Numbers, Sequence[Array]],
    lost: Lost,
    of: tuple[int, float],
) -> None:
    """Add what derivatives of numbers miss by a wave of a derivative of the motion."""
    (numbers, plain), (j, scale) = asked, of
    h = float(states.t[1] - states.t[0])
    small = _SMALL * (float(np.abs(states.q).max()) or 1.0) / (float(np.abs(wave.q).max()) or 1.0)
    scaled = wave._replace(q=small * wave.q, lam=small * wave.lam)
    angle, sizes = min(wave.speed, _ANGLE / h), np.zeros((2, len(plain)))
    for phase in _PHASES:
        true, left = (numbers(scaled.added(states, angle, phase, x)) for x in (wave.decay, kept))
        for k, x in enumerate(true):
            for row, y in zip(sizes, (left[k], plain[k]), strict=True):
                row[k] = max(row[k], float(np.abs(x - y).max()) / small)
    for row, parts in zip(sizes, (lost.parts, lost.whole), strict=True):
        for size, part in zip(row, parts, strict=True):
            part.slope[j] += scale * size
