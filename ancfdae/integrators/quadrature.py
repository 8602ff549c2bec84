"""Integrals during a run, refined until their own error is within the tolerance.

**Multipliers** are solved for at steps and interpolated in between; a solve at every quadrature
point would cost as much as the steps. For a wave of frequency omega polynomials through eight
nodes, every other step, err by 1e-3 (2 omega h)^8, which is less than the error of a step by a
method of order five, (omega h)^6/6, wherever waves are resolved. The interpolation is tested away
from the nodes, because a force that reactions balance at once moves nothing, however fast it
changes, and so no step resolves it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from ancfdae.integrators.integrator import Integrand, PartialIntegral, Points, Rule
from ancfdae.integrators.problem import Accelerations, stacked
from ancfdae.numerics.arrays import Array

# Number of nodes of an interpolation polynomial, and steps from one node to the next.
_NODES, _STRIDE = 8, 2
# Number of nodes per point at which the interpolation is tested by a solve without derivatives.
_TRIED = 8


class Trajectory(NamedTuple):
    """States at k times t, with their design derivatives or None; shapes as in `Points`.

    `a`, (k, n_q), are the accelerations of the solver if the times are ends of steps.
    """

    t: Array
    q: Array
    v: Array
    q_b: Array | None = None
    v_b: Array | None = None
    a: Array | None = None

    def taken(self, k: slice | Array) -> Trajectory:
        """Return the trajectory at the times with indices k only."""
        q_b, v_b, a = (None if x is None else x[k] for x in (self.q_b, self.v_b, self.a))
        return Trajectory(self.t[k], self.q[k], self.v[k], q_b, v_b, a)


@final
class Multipliers:
    """Computes the multipliers of a run part by part: lam and lam_b, shape (k, n_lam, 1 + n_b).

    Interpolated reactions are accepted if their error is below `accepted` times their mean norm
    plus the residual force that the solver's own accelerations leave in the equations of motion.
    """

    def __init__(self, accelerations: Accelerations, accepted: float) -> None:
        self._accelerations, self._accepted = accelerations, accepted
        self._following: Trajectory | None = None
        self._t, self._solved = np.zeros(0), np.zeros((0, 0, 0))
        self._smooth = False

    def follow(self, steps: Trajectory | None) -> None:
        """Start a part of the run with its steps, both ends included; None if not known."""
        self._following, self._smooth = steps, False

    def at(self, motion: Trajectory) -> Array:
        """Return lam and lam_b at the times of a part of the run, shape (k, n_lam, 1 + n_b)."""
        if self._following is not None:
            left = self._take_in(self._following)
            self._smooth = len(self._t) >= _NODES and self._is_smooth(motion, left)
            self._following = None
        return self._between(motion.t) if self._smooth else self._solve(motion)[0]

    def _take_in(self, steps: Trajectory) -> float:
        """Store multipliers at every `_STRIDE`-th step; return the mean residual force there.

        The residual is that of the solver's own accelerations, in the norm of the weights. The last
        nodes of the previous part are kept: the first polynomials of this part pass through them.
        """
        last = len(steps.t) - 1
        nodes = np.append(np.arange(0, last, _STRIDE), last)
        follows = len(self._t) > 0 and self._t[-1] == steps.t[0]
        chosen = steps.taken(nodes[1:] if follows else nodes)
        solved, a = self._solve(chosen)
        if follows:
            solved = np.concatenate([self._solved[1 - _NODES :], solved])
        self._t = np.append(self._t[1 - _NODES :] if follows else [], chosen.t)
        self._solved = solved
        if chosen.a is None:
            return 0.0
        left = (a - chosen.a) * np.sqrt(self._accelerations.weights)
        return float(np.mean(np.linalg.norm(left, axis=1)))

    def _is_smooth(self, motion: Trajectory, left: float) -> bool:
        """Return whether interpolated multipliers are accurate at the times farthest from nodes."""
        t, after = self._t, self._after(motion.t)
        share = (motion.t - t[after - 1]) / (t[after] - t[after - 1])
        tried = np.argsort(np.abs(share - 0.5))[: 1 + len(t) // _TRIED]
        chosen = motion.taken(tried)._replace(q_b=None, v_b=None)
        exact = self._solve(chosen)[0][..., 0]
        error = self._mean_size(chosen, exact - self._between(chosen.t)[..., 0])
        return error <= self._accepted * self._mean_size(chosen, exact) + left

    def _mean_size(self, motion: Trajectory, lam: Array) -> float:
        """Return the mean weighted norm of reactions Phi_q^T lam, free of units of lam."""
        size = self._accelerations.reaction_size
        instants = zip(motion.t, motion.q, lam, strict=True)
        return float(np.mean([size(float(t), q, x) for t, q, x in instants]))

    def _after(self, times: Array) -> Array:
        """Return the index of the interpolation node after each time."""
        return np.clip(np.searchsorted(self._t, times, side="right"), 1, len(self._t) - 1)

    def _between(self, times: Array) -> Array:
        """Return lam and lam_b at `times`, (k, n_lam, 1 + n_b), by Lagrange polynomials."""
        t = self._t
        first = np.clip(self._after(times) - _NODES // 2, 0, len(t) - _NODES)
        places = first[:, None] + np.arange(_NODES)
        gaps = times[:, None] - t[places]
        total = np.zeros((len(times), *self._solved.shape[1:]))
        for k in range(_NODES):
            others = [j for j in range(_NODES) if j != k]
            apart = t[places[:, [k]]] - t[places[:, others]]
            weight = np.prod(gaps[:, others] / apart, axis=1)
            total += weight[:, None, None] * self._solved[places[:, k]]
        return total

    def _solve(self, motion: Trajectory) -> tuple[Array, Array]:
        """Return lam and lam_b, (k, n_lam, 1 + n_b), and a, (k, n_q), by a solve per time."""
        multipliers, rates = list[Array](), list[Array]()
        for k, t in enumerate(motion.t):
            if k and t == motion.t[k - 1]:  # Where two panels meet.
                multipliers.append(multipliers[-1])
                rates.append(rates[-1])
                continue
            derivatives = (
                () if motion.q_b is None or motion.v_b is None else (motion.q_b[k], motion.v_b[k])
            )
            x = self._accelerations.rows(float(t), *stacked(motion.q[k], motion.v[k], *derivatives))
            n_q = motion.q.shape[1]
            multipliers.append(x[:, n_q:].T)
            rates.append(x[0, :n_q])
        return np.array(multipliers), np.array(rates)


# Gauss-Lobatto rule of four points with its Kronrod extension of seven, of degrees 5 and 9
# (Gander & Gautschi, BIT 40, 2000), moved from [-1, 1] to [0, 1].
_X = np.sqrt([1.0, 2 / 3, 1 / 5, 0.0])
SHARES = 0.5 + 0.5 * np.array([-_X[0], -_X[1], -_X[2], 0.0, _X[2], _X[1], _X[0]])
_W = 0.5 * np.array([11 / 210, 72 / 245, 125 / 294, 16 / 35, 125 / 294, 72 / 245, 11 / 210])
_LOBATTO = 0.5 * np.array([1 / 6, 0.0, 5 / 6, 0.0, 5 / 6, 0.0, 1 / 6])
_SIMPSON = np.array([1 / 6, 0.0, 0.0, 4 / 6, 0.0, 0.0, 1 / 6])
KRONROD = Rule(_W, _W - _LOBATTO, _W - _SIMPSON)
# Accepted estimate of the error of an integral, in tolerances: the integral of a run is then right
# to one to ten tolerances (measured against a thousand panels), less than the error of the states.
_ACCEPTED = 10.0


@final
class Quadrature:
    """Adds the integrals of integrands over a run, part by part.

    Points without multipliers are first given to an integrand as they are: if its value is then
    NaN, the integrand reads multipliers, and from then on `Multipliers` computes them for it.
    """

    def __init__(
        self, integrands: Sequence[Integrand], accelerations: Accelerations, rtol: float
    ) -> None:
        self._integrands = tuple(integrands)
        self._multipliers = Multipliers(accelerations, _ACCEPTED * rtol)
        self._largest, self._readers = _ACCEPTED * rtol, set[Integrand]()

    @property
    def wanted(self) -> bool:
        """Whether the run has integrands, so that quadrature points are needed."""
        return bool(self._integrands)

    def add(self, choices: Iterable[Points], steps: Trajectory | None = None) -> None:
        """Add the next part of the run; multipliers are interpolated between its `steps`.

        `choices` are quadrature points of the same part on ever finer panels; each integrand uses
        the first choice on which its error is accepted, or the last.
        """
        self._multipliers.follow(steps)
        pending, unfinished = self._integrands, list[tuple[Integrand, PartialIntegral]]()
        for choice in choices:
            unfinished = []
            for integrand, part in self._parts(choice, pending):
                if part.error <= self._largest:
                    integrand.add(part)
                else:
                    unfinished.append((integrand, part))
            pending = tuple(integrand for integrand, _ in unfinished)
            if not pending:
                return
        for integrand, part in unfinished:
            integrand.add(part)

    def _parts(
        self, points: Points, integrands: Sequence[Integrand]
    ) -> list[tuple[Integrand, PartialIntegral]]:
        """Return the integrals over the points; only integrands that read multipliers get these."""
        parts = [(x, x.part(points)) for x in integrands if x not in self._readers]
        if points.lam is None:
            self._readers.update(x for x, part in parts if part.not_finite is not None)
        readers = [x for x in integrands if x in self._readers]
        if not readers:
            return parts
        completed = self._completed(points)
        others = [(x, part) for x, part in parts if x not in self._readers]
        return others + [(x, x.part(completed)) for x in readers]

    def _completed(self, points: Points) -> Points:
        """Return the points with multipliers, computed if they are missing."""
        if points.lam is not None:
            return points
        multipliers = self._multipliers.at(
            Trajectory(points.t, points.q, points.v, points.q_b, points.v_b)
        )
        lam_b = None if points.q_b is None else multipliers[..., 1:]
        return replace(points, lam=multipliers[..., 0], lam_b=lam_b)
