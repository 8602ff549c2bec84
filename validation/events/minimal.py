"""Linkages in minimal coordinates with their own impacts, by SciPy: references of report `events`.

Bars have angles phi, and all points are sums of e_j = exp(i phi_j) in the complex plane. In a
closed loop the last angles follow from the free ones. Nothing of the package is used here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

Array = np.ndarray[Any, Any]

# Most corrections of a loop, and most impacts.
_CORRECTIONS, _MOST = 30, 60
# Least steps of a run: events of SciPy that change their sign twice in a step are not seen.
_STEPS = 200


@dataclass
class Linkage:
    """Bars with point masses and a loop.

    Points z = offset + B e have masses m; angles have inertias J; the loop is C e = closed, from
    which the angles after the first `free` ones follow. Gaps are Re(alpha e) + gamma; the contact
    points of rough gaps slide by the rate of Re(beta e), with the coefficient of friction mu.
    """

    B: Array
    m: Array
    J: Array
    gravity: complex
    gaps: Sequence[tuple[Array, float]]
    restitution: float
    start: Array
    speed: Array
    C: Array | None = None
    closed: complex = 0.0
    free: int = 0
    mu: float = 0.0
    beta: Sequence[Array] = ()
    impacts: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Take all angles as free where there is no loop."""
        self.free = self.free or len(self.start)
        self._guess = self.start.copy()

    def angles(self, theta: Array) -> Array:
        """Return all angles from the free ones."""
        if self.C is None:
            return theta
        phi = np.concatenate([theta, self._guess[self.free :]])
        for _ in range(_CORRECTIONS):
            e = np.exp(1j * phi)
            miss = self.C @ e - self.closed
            A = _rows(self.C * 1j * e)[:, self.free :]
            change = np.linalg.solve(A, -_rows(np.array([miss]))[:, 0])
            phi[self.free :] += change
            if np.max(np.abs(change)) < 1e-15:
                break
        self._guess = phi.copy()
        return phi

    def kinematics(self, theta: Array, speed: Array) -> tuple[Array, Array, Array, Array]:
        """Return phi, R with phi' = R theta', phi', and s with phi'' = R theta'' + s."""
        phi = self.angles(theta)
        if self.C is None:
            return phi, np.eye(len(phi)), speed, np.zeros(len(phi))
        e, k = np.exp(1j * phi), self.free
        A = _rows(self.C * 1j * e)
        R = np.vstack([np.eye(k), -np.linalg.solve(A[:, k:], A[:, :k])])
        rates = R @ speed
        right = _rows((self.C * e * rates**2).sum(keepdims=True))[:, 0]
        return phi, R, rates, np.concatenate([np.zeros(k), np.linalg.solve(A[:, k:], right)])

    def dynamics(self, theta: Array, speed: Array) -> tuple[Array, Array]:
        """Return M and theta''."""
        phi, R, rates, s = self.kinematics(theta, speed)
        e = np.exp(1j * phi)
        K = self.B * (1j * e)
        mass = np.real(K.conj().T @ (self.m[:, None] * K)) + np.diag(self.J)
        turning = -self.B @ (e * rates**2)
        force = np.real(K.conj().T @ (self.m * (self.gravity - turning))) - mass @ s
        M = R.T @ mass @ R
        return M, np.linalg.solve(M, R.T @ force)

    def gap(self, n: int, theta: Array) -> float:
        """Return gap n."""
        alpha, gamma = self.gaps[n]
        return float(np.real(alpha @ np.exp(1j * self.angles(theta))) + gamma)

    def struck(self, n: int, theta: Array, speed: Array) -> tuple[Array, float]:
        """Return the speeds after an impact of gap n, and its impulse."""
        phi, R, _, _ = self.kinematics(theta, speed)
        M, _ = self.dynamics(theta, speed)
        G = np.real(self.gaps[n][0] * 1j * np.exp(1j * phi)) @ R
        if not self.mu:
            X = np.linalg.solve(M, G)
            P = -(1 + self.restitution) * (G @ speed) / (G @ X)
            return speed + X * P, float(P)
        W = np.array([G, np.real(self.beta[n] * 1j * np.exp(1j * phi)) @ R])
        impulses = self._with_friction(W @ np.linalg.solve(M, W.T), W @ speed)
        return speed + np.linalg.solve(M, W.T @ impulses), float(impulses[0])

    def _with_friction(self, A: Array, rates: Array) -> Array:
        """Return the impulses along normal and line of sliding, by trial: stick, slide + or -."""
        closing = (1 + self.restitution) * rates[0]
        stuck = np.linalg.solve(A, [-closing, -rates[1]])
        if abs(stuck[1]) <= self.mu * stuck[0]:
            return stuck
        for side in (1, -1):
            N = -closing / (A[0, 0] - side * self.mu * A[0, 1])
            P = np.array([N, -side * self.mu * N])
            if side * (rates[1] + A[1] @ P) >= 0:
                return P
        raise ArithmeticError("no branch fits")

    def run(self, t_end: float) -> tuple[Array, Array]:
        """Return phi and phi' at the end; `impacts` then has times and impulses."""
        k = self.free
        y, t = np.concatenate([self.start[:k], self.speed[:k]]), 0.0
        self.impacts.clear()
        events = [self._event(n) for n in range(len(self.gaps))]

        def rates(_: float, y: Array) -> Array:
            return np.concatenate([y[k:], self.dynamics(y[:k], y[k:])[1]])

        while len(self.impacts) < _MOST:
            run = scipy.integrate.solve_ivp(
                rates,
                (t, t_end),
                y,
                events=events,
                method="DOP853",
                rtol=1e-12,
                atol=1e-13,
                max_step=t_end / _STEPS,
            )
            t, y = float(run.t[-1]), run.y[:, -1]
            if run.status == 0:
                break
            n = next(i for i, times in enumerate(run.t_events) if len(times))
            speed, P = self.struck(n, y[:k], y[k:])
            self.impacts.append((t, P))
            y = np.concatenate([y[:k], speed])
        phi, _, phi_t, _ = self.kinematics(y[:k], y[k:])
        return phi, phi_t

    def _event(self, n: int) -> Callable[[float, Array], float]:
        def gap(_: float, y: Array) -> float:
            return self.gap(n, y[: self.free])

        gap.terminal, gap.direction = True, -1  # type: ignore[attr-defined]
        return gap


def differences(value: Callable[[Array], float], b: Array, part: float = 1e-3) -> Array:
    """Return the gradient of a function by central differences of two widths, extrapolated."""
    slopes = []
    for i, x in enumerate(b.tolist()):
        h = part * (abs(x) or 1.0)
        unit = np.eye(len(b))[i]
        near, far = (
            (value(b + s * h * unit) - value(b - s * h * unit)) / (2 * s * h) for s in (1, 2)
        )
        slopes.append((4 * near - far) / 3)
    return np.array(slopes)


def _rows(z: Array) -> Array:
    """Return real and imaginary parts as two rows."""
    return np.array([np.real(z), np.imag(z)])
