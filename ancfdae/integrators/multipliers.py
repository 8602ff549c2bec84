"""Multipliers beside a motion, for integrals: solved for at steps, interpolated in between.

A solve in every point would cost as much as the steps. For a wave of frequency omega polynomials
through eight nodes, every other step, err by 1e-3 (2 omega h)^8, which is less than what a method
of order five leaves in a step, (omega h)^6/6, wherever waves are resolved. What no step sees is
looked for: a force that reactions balance at once moves nothing, however fast it changes.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from ancfdae.integrators.index_1 import Accelerations, stacked
from ancfdae.numerics.arrays import Array

# Nodes of a polynomial, and steps from one to the next.
_NODES, _STRIDE = 8, 2
# Nodes for each point that is tried, by a solve without derivatives.
_TRIED = 8


class Trajectory(NamedTuple):
    """States at k instants, with their design derivatives or None; shapes as in `Points`.

    At steps, a are the accelerations of the solver.
    """

    t: Array
    q: Array
    v: Array
    q_b: Array | None = None
    v_b: Array | None = None
    a: Array | None = None

    def taken(self, k: slice | Array) -> Trajectory:
        """Return some of the instants."""
        q_b, v_b, a = (None if x is None else x[k] for x in (self.q_b, self.v_b, self.a))
        return Trajectory(self.t[k], self.q[k], self.v[k], q_b, v_b, a)


@final
class Multipliers:
    """Finds the multipliers of a run part by part: lam and lam_b, shape (k, n_lam, 1 + n_b).

    Reactions that err by less than `accepted`, relative, or than what the solver's own
    accelerations leave in the equations of motion, are good enough.
    """

    def __init__(self, accelerations: Accelerations, accepted: float) -> None:
        self._accelerations, self._accepted = accelerations, accepted
        self._following: Trajectory | None = None
        self._t, self._solved = np.zeros(0), np.zeros((0, 0, 0))
        self._smooth = False

    def follow(self, steps: Trajectory | None) -> None:
        """Begin a part of the run, with its steps, start and end included, if they are known."""
        self._following, self._smooth = steps, False

    def at(self, motion: Trajectory) -> Array:
        """Return the multipliers at instants of the part."""
        if self._following is not None:
            left = self._take_in(self._following)
            self._smooth = len(self._t) >= _NODES and self._is_smooth(motion, left)
            self._following = None
        return self._between(motion.t) if self._smooth else self._solve(motion)[0]

    def _take_in(self, steps: Trajectory) -> float:
        """Solve at nodes; return the mean force that the solver's accelerations leave there.

        The first polynomials go through nodes of the part before.
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
        """Try the interpolation at the instants that are farthest from nodes."""
        t, after = self._t, self._after(motion.t)
        share = (motion.t - t[after - 1]) / (t[after] - t[after - 1])
        tried = np.argsort(np.abs(share - 0.5))[: 1 + len(t) // _TRIED]
        chosen = motion.taken(tried)._replace(q_b=None, v_b=None)
        exact = self._solve(chosen)[0][..., 0]
        error = self._mean_size(chosen, exact - self._between(chosen.t)[..., 0])
        return error <= self._accepted * self._mean_size(chosen, exact) + left

    def _mean_size(self, motion: Trajectory, lam: Array) -> float:
        """Mean of the sizes of reactions; weighted, so that no unit of a multiplier matters."""
        size = self._accelerations.reaction_size
        instants = zip(motion.t, motion.q, lam, strict=True)
        return float(np.mean([size(float(t), q, x) for t, q, x in instants]))

    def _after(self, times: Array) -> Array:
        """Index of the node behind each time."""
        return np.clip(np.searchsorted(self._t, times, side="right"), 1, len(self._t) - 1)

    def _between(self, times: Array) -> Array:
        """Lagrange's polynomials through the nodes around each time."""
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
        """Return multipliers and accelerations, one instant after the other."""
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
