"""Chains of rigid bodies in minimal coordinates: d'Alembert's principle and Newton-Euler.

Shares nothing with the package. The places of all bodies are functions of coordinates s and time t,
written with analytic functions; their time derivatives along a motion s + s' tau + s'' tau^2/2 are
Cauchy's integrals over a small circle of complex tau, exact to round-off.
"""

from dataclasses import dataclass

import numpy as np

# The eighth derivative is taken for zero: the circle is small against the time of any motion.
_RADIUS, _POINTS = 0.02, 8


def rotation(axis, angle):
    """Matrix of a turn about an axis by Rodrigues; analytic in the angle."""
    n = np.asarray(axis, float) / np.linalg.norm(axis)
    N = np.cross(np.eye(3), n)
    return np.eye(3) + np.sin(angle) * N + (1 - np.cos(angle)) * N @ N


@dataclass
class Body:
    """Mass, tensor of inertia about the centre of mass and the centre, in the axes of the body."""

    mass: float
    inertia: np.ndarray
    centre: np.ndarray


@dataclass
class Motion:
    """Place r and turn R of a body with their rates: velocity, spin and accelerations."""

    r: np.ndarray
    R: np.ndarray
    v: np.ndarray
    omega: np.ndarray
    a: np.ndarray
    alpha: np.ndarray

    def at(self, x):
        """Place, velocity and acceleration of the point x in the axes of the body."""
        arm = self.R @ x
        turning = np.cross(self.omega, arm)
        bend = np.cross(self.alpha, arm) + np.cross(self.omega, turning)
        return self.r + arm, self.v + turning, self.a + bend


@dataclass
class Action:
    """A force at a place, and a moment, on a body by its number."""

    body: int
    force: np.ndarray
    place: np.ndarray
    moment: np.ndarray

    def power(self, motions):
        """F . v + M . omega."""
        m = motions[self.body]
        velocity = m.v + np.cross(m.omega, self.place - m.r)
        return self.force @ velocity + self.moment @ m.omega


def _axial(M):
    return np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]]) / 2


def motions(places, s, ds, dds, t):
    """Motions of all bodies; `places(s, t)` returns pairs r, R, the reference point and turn."""
    circle = np.exp(2j * np.pi * np.arange(_POINTS) / _POINTS)
    samples = []
    for tau in _RADIUS * circle:
        pairs = places(s + ds * tau + dds * tau**2 / 2, t + tau)
        samples.append([np.concatenate([r[None], R]) for r, R in pairs])
    x, rate, second = (
        np.real(np.tensordot(circle**-k, np.array(samples), 1)) / _POINTS / _RADIUS**k * max(k, 1)
        for k in range(3)
    )
    out = []
    for X, V, A in zip(x, rate, second, strict=True):
        R, W = X[1:], V[1:] @ X[1:].T
        out.append(Motion(X[0], R, V[0], _axial(W), A[0], _axial(A[1:] @ R.T + V[1:] @ V[1:].T)))
    return out


def rate_of_momentum(body, motion):
    """m a of the centre of mass, and the rate of the angular momentum about it."""
    J, spin = motion.R @ body.inertia @ motion.R.T, motion.omega
    return body.mass * motion.at(body.centre)[2], J @ motion.alpha + np.cross(spin, J @ spin)


def accelerations(bodies, places, actions, s, ds, t):
    """s'' from sum (F - m a) . dv/ds' + (T - dL/dt) . domega/ds' = 0 for every coordinate.

    `actions(motions)` are all but those of ideal joints, as `Action`.
    """
    zero = np.zeros(len(s))
    still = motions(places, s, ds, zero, t)
    applied = np.array(wrenches(bodies, still, actions(still)))

    def unbalanced(dds):
        moving = motions(places, s, ds, dds, t)
        rates = [rate_of_momentum(*pair) for pair in zip(bodies, moving, strict=True)]
        return applied - np.array(rates)

    def velocities(rates):
        moving = motions(places, s, rates, zero, t)
        return np.array([(m.at(b.centre)[1], m.omega) for b, m in zip(bodies, moving, strict=True)])

    partial = np.array([velocities(ds + e) - velocities(ds) for e in np.eye(len(s))])
    work = [np.einsum("ibkx,bkx->i", partial, unbalanced(dds)) for dds in (zero, *np.eye(len(s)))]
    return np.linalg.solve(np.array([work[0] - w for w in work[1:]]).T, work[0])


def wrenches(bodies, moving, actions):
    """Force and moment about the centre of mass on every body."""
    total = [[np.zeros(3), np.zeros(3)] for _ in bodies]
    for each in actions:
        arm = each.place - moving[each.body].at(bodies[each.body].centre)[0]
        total[each.body][0] = total[each.body][0] + each.force
        total[each.body][1] = total[each.body][1] + each.moment + np.cross(arm, each.force)
    return total


def joint_wrenches(bodies, moving, actions, joints):
    """Force, and moment about the joint, on each body of a chain by the one before it.

    `joints` are the places of the joints in the axes of their bodies, from the base on.
    """
    applied, found = wrenches(bodies, moving, actions), []
    F, T, place = np.zeros(3), np.zeros(3), np.zeros(3)
    for body, m, (F_a, T_a), x in reversed(list(zip(bodies, moving, applied, joints, strict=True))):
        p_rate, L_rate = rate_of_momentum(body, m)
        centre, own = m.at(body.centre)[0], m.at(x)[0]
        # The body after it acts with -F at `place` and -T.
        force = p_rate - F_a + F
        T = L_rate - T_a + T + np.cross(place - centre, F) - np.cross(own - centre, force)
        F, place = force, own
        found.append((F, T))
    return found[::-1]
