"""Waves that numerical damping takes away from a run, and what its numbers miss without them.

A wave of the frequency omega is damped by rho(omega h) < 1 in a step of HHT-I3, by (1 + alpha)/(1 -
alpha) where omega h >> 1. Runs that have lost it agree with each other. What is left of it is its
beginning: in the accelerations it has its true amplitude for the first steps, whatever these are,
and the largest second differences s hold it (the least of four in a row counts: a kink makes two or
three). From s follow the amplitude x of the wave, its frequency and its physical decay c,

    K x + Phi_q^T mu = M s/(2 sin^2(theta/2)),   tan(theta/2) = omega h/2,
    omega^2 = x^T K x / x^T M x,                 c = x^T D x / 2 x^T M x

(twice what a single wave has). It is lost by the share 1 - rho^n of a run of n steps. Then
x cos(omega t) e^(-c t) is added to the states of the run: what that changes, times the share, is
what the run may miss. The derivative of the phase, omega t / 2, comes from another frequency.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors import AncfdaeError
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables import States, states_of

# Second differences in a row of which the least counts.
_ROW = 4
# Amplitude in the accelerations over that of a single wave with these second differences.
_AT_MOST = 2.0
# Waves of less than this angle per step are part of the smooth motion.
_SMOOTH = 0.05
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
    """A wave from an instant on: amplitudes of q and lam, frequency and decay, 1/s."""

    begin: float
    q: Array
    lam: Array
    speed: float
    decay: float

    def added(self, states: States, angle: float, phase: float) -> States:
        """Return the states with the wave as one of another frequency, `angle`."""
        t = states.t - self.begin
        size = (t >= 0) * np.exp(-self.decay * np.maximum(t, 0.0))
        cos, sin = (size * f(angle * t + phase) for f in (np.cos, np.sin))
        q, lam = states.q + np.outer(cos, self.q), states.lam + np.outer(cos, self.lam)
        v = states.v - self.speed * np.outer(sin, self.q)
        return replace(states, q=q, v=v, lam=lam)


class Missed(NamedTuple):
    """Possible errors by a wave: of a number and of its logarithmic derivatives."""

    value: Array
    slope: Array


class Lost(NamedTuple):
    """Possible errors of numbers by waves, and the frequency of the waves of the motion; 1/s."""

    parts: list[Missed]
    speed: float


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


def radius(angle: float, alpha: float) -> float:
    """Return by what HHT-I3 multiplies a wave of omega h = `angle` in a step.

    The largest eigenvalue in size of the recurrence of (q, h v, h^2 a) of q'' + omega^2 q = 0.
    """
    gamma, beta, W = 0.5 - alpha, (1 - alpha) ** 2 / 4, angle**2
    # q' = q + v + (1/2 - beta) a + beta a', v' = v + (1 - gamma) a + gamma a',
    # a' + (1 + alpha) W q' - alpha W q = 0; all in powers of h.
    left = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 + alpha) * W, 0, 1]])
    right = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [alpha * W, 0, 0]])
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
    decay = 0.0 if at.f_v is None else float(x @ dot(at.f_v[0], x)) / (2 * inertia)
    # Overdamped motions relax at omega^2 / 2c.
    decay = min(max(decay, 0.0), speed**2 / (2 * decay) if decay > speed else math.inf)
    return Wave(float(run.t[n]), size * x, size * mu, speed, decay)


def followed(speed: float, t_end: float, alpha: float, at_least: float) -> float:
    """Return the steps, `at_least` times a power of 1.4, that keep a wave to the end."""
    steps = at_least
    while _share(speed, t_end, steps, alpha) > _KEPT:
        steps *= 1.4
    return steps


def _share(speed: float, t_end: float, steps: float, alpha: float) -> float:
    """Return the share of a wave's amplitude that a run loses."""
    rho = min(radius(speed * t_end / steps, alpha), 1.0)
    return -math.expm1(steps * math.log(rho))


def missed(
    system: MechanicalSystem,
    run: Solution,
    alpha: float,
    numbers: Numbers,
    integrated: Sequence[bool],
) -> Lost:
    """Return possible errors of numbers by the waves of a run; infinite if they are unknown.

    Where a number is `integrated` over the instants, it sees the mean of a wave.
    """
    states, T, steps = states_of(run), float(run.t[-1]), len(run.t) - 1
    waves = [wave_of(system, run, a) for a in _rows(run)]
    shares = [x and _share(x.speed, T, steps, alpha) for x in waves]
    plain, lost = numbers(states), Lost([], 0.0)
    for x in plain:
        lost.parts.append(Missed(np.zeros(x.shape), np.zeros(system.n_b)))
    if waves[0] and shares[0] and shares[0] > _KEPT:
        lost = lost._replace(speed=waves[0].speed)
        _of_the_motion(waves[0], shares[0], states, (numbers, plain, integrated), lost.parts)
    for j, (wave, share) in enumerate(zip(waves[1:], shares[1:], strict=True)):
        if wave and share and share > _KEPT:
            lost = lost._replace(speed=max(lost.speed, wave.speed))
            scale = share * (abs(float(system.b[j])) or 1.0)
            for each, size in zip(
                lost.parts, _of_a_derivative(wave, states, numbers, plain), strict=True
            ):
                each.slope[j] += scale * size
    return lost


def _of_the_motion(
    wave: Wave,
    share: float,
    states: States,
    asked: tuple[Numbers, Sequence[Array], Sequence[bool]],
    parts: list[Missed],
) -> None:
    """Add what numbers and their derivatives miss by a wave of the motion."""
    numbers, plain, integrated = asked
    h, T = float(states.t[1] - states.t[0]), float(states.t[-1])
    for phase in _PHASES:
        angle = min(wave.speed, _ANGLE / h)
        first = numbers(wave.added(states, angle, phase))
        detuned = numbers(wave.added(states, angle + _TURN / T, phase))
        for k, (x, y, z) in enumerate(zip(plain, first, detuned, strict=True)):
            speed = angle if integrated[k] else wave.speed
            value = share * np.abs(y - x)
            turned = share * float(np.abs(z - y).max()) * speed * T / _TURN
            np.maximum(parts[k].value, value, out=parts[k].value)
            slope = _POWER * turned + float(value.max())
            np.maximum(parts[k].slope, slope, out=parts[k].slope)


def _of_a_derivative(
    wave: Wave, states: States, numbers: Numbers, plain: Sequence[Array]
) -> list[float]:
    """Return errors of derivatives of numbers by a wave in a derivative of the motion."""
    h = float(states.t[1] - states.t[0])
    small = _SMALL * (float(np.abs(states.q).max()) or 1.0) / (float(np.abs(wave.q).max()) or 1.0)
    scaled = wave._replace(q=small * wave.q, lam=small * wave.lam)
    sizes = [0.0 for _ in plain]
    for phase in _PHASES:
        changed = numbers(scaled.added(states, min(wave.speed, _ANGLE / h), phase))
        for k, (x, y) in enumerate(zip(plain, changed, strict=True)):
            sizes[k] = max(sizes[k], float(np.abs(y - x).max()) / small)
    return sizes
