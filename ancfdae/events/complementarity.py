"""Impulses of contacts with Coulomb's friction: a complementarity problem and its branch.

m contacts have impulses N >= 0 along their normals. Contacts with friction also have impulses T
along one line of sliding, or along two lines at a right angle in a plane. With r the rates of gaps
and the sliding velocities before the impact, g' and s the same after it, and the inverse mass A,

    (g', s) = A (N, T) + r,   0 <= N - N_0  complementary to  g' >= 0,
    |T| <= mu N,   T = -mu N s/|s| where s is not zero.

N_0 is zero, or the least impulse of the expansion (Poisson's law). Lemke's method solves the
problem of lines in the form of D. E. Stewart and J. C. Trinkle (Int. J. Numer. Meth. Eng. 39,
1996). Its matrix is copositive; ties are broken by a lexicographic rule. Lemke's method replaces a
cone by a pyramid; Newton's method on the cone starts from its solution (`friction_cones`).

The solution lies on a *branch*: which contacts push, which stick, and which slide in what
direction. On a branch the equations are smooth; the direction of sliding in a plane is their only
nonlinear term. They are solved once more, so that complex numbers and derivatives follow from them,
too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from ancfdae.events.friction_cones import Cones, keep_law, on_cones, swept
from ancfdae.events.lemke import ROUND_OFF, solution
from ancfdae.numerics.arrays import Array

# Impulses and rates below this fraction of the largest ones are zero: the branch ends there.
_TIE = 1e-9
# Singular values below this fraction of the largest one belong to impulses that move nothing.
_MOVES_NOTHING = 1e-12
# Numbers of sides of the pyramids, tried in turn until Newton's method converges on the cones.
_SIDES = (8, 12, 24, 48, 96)
# Attempts of Newton's method after sweeps of Gauss-Seidel's, from the solution for pyramids.
_ATTEMPTS = 20
# Newton iterations for the impulses on a branch, which bring a solution to about round-off.
_CORRECTIONS = 3


@final
@dataclass(frozen=True)
class Contacts:
    """Contacts of an impact: inverse mass A, (m + k, m + k), and contact and mu of k friction rows.

    A contact that slides along a line has one row in `rough` and `friction`, (k,) each; a contact
    that slides in a plane has two. `noise` is the round-off of rates, (m + k,).
    """

    inverse_mass: Array
    rough: Array
    friction: Array
    noise: Array | float = 0.0

    @property
    def count(self) -> int:
        """Number m of contacts in the impact."""
        return len(self.inverse_mass) - len(self.rough)

    @property
    def same(self) -> Array:
        """Whether two friction rows belong to one contact, (k, k)."""
        return self.rough[:, None] == self.rough

    @property
    def has_planes(self) -> bool:
        """Whether a contact slides in a plane."""
        return len(set(self.rough.tolist())) < len(self.rough)

    def length(self, x: Array) -> Array:
        """Return for each friction row the length of the vector x, (k,), of its contact, (k,)."""
        squares = self.same @ (x * x)
        return np.sqrt(squares)

    def sizes(self) -> Array:
        """Return square roots of the diagonal of A, (m + k,); 1 where an impulse moves nothing.

        Both rows of a contact that slides in a plane have the larger one.
        """
        own = np.diag(self.inverse_mass).real.copy()
        own[self.count :] = np.max(self.same * own[self.count :], axis=1, initial=0.0)
        own[own <= ROUND_OFF**2 * np.max(own, initial=0.0)] = 1.0
        return np.sqrt(own)

    def branch(self, rates: Array, least: Array) -> Branch:
        """Return the branch of the solution for real rates r, (m + k,), and N_0, (m,).

        ArithmeticError if there is no solution.
        """
        m, size, problem = self.count, self.sizes(), self.problem(rates, least)
        pushes, P, slack = self._on_pyramids(problem, _SIDES[0])
        scale = (
            float(np.max(np.abs(problem.r + problem.A[:, :m] @ problem.low), initial=0.0)) or 1.0
        )
        if not self.has_planes:
            loaded = P[self.rough] > ROUND_OFF * scale
            slides = np.where(loaded & (slack > ROUND_OFF * scale), np.sign(-P[m:]), 0.0)
            return Branch(pushes, loaded & (slides == 0), slides, P / size)
        for sides in _SIDES:
            found = on_cones(problem, P)
            if found is not None:
                return Branch(*found[:3], found[3] / size)
            _, P, _ = self._on_pyramids(problem, sides)
        for _ in range(_ATTEMPTS):
            P = swept(problem, P)
            found = on_cones(problem, P)
            if found is not None:
                return Branch(*found[:3], found[3] / size)
        raise ArithmeticError

    def keep_law(self, impulses: Array, rates: Array, least: Array) -> bool:
        """Return whether N and T, (m + k,), solve the problem for r, (m + k,), and N_0, (m,)."""
        return keep_law(self.problem(rates, least), impulses.real * self.sizes())

    def problem(self, rates: Array, least: Array) -> Cones:
        """Return the real problem in units in which A has a unit diagonal."""
        size, m = self.sizes(), self.count
        A, ratio = self.inverse_mass.real / np.outer(size, size), size[m:] / size[self.rough]
        r, low = rates.real / size, least.real * size[:m]
        noise = float(np.max(self.noise / size, initial=0.0))
        return Cones(A, self.rough, self.friction.real * ratio, r, low, noise)

    def _on_pyramids(self, problem: Cones, sides: int) -> tuple[Array, Array, Array]:
        """Solve the complementarity problem with pyramids in place of the cones, in scaled units.

        Return which contacts push beyond N_0, (m,), impulses N and T, (m + k,), and the sliding
        speed of each friction row, (k,).
        """
        m, (A, _, mu, r, low, _) = self.count, problem
        shifted = r + A[:, :m] @ low
        scale = float(np.max(np.abs(shifted), initial=0.0)) or 1.0
        D, of = self._directions(sides)
        rough, first = np.unique(self.rough, return_index=True)
        n, belongs = len(of), (of[:, None] == rough).astype(float)
        M, q = np.zeros((m + n + len(rough),) * 2), np.zeros(m + n + len(rough))
        along, slide = slice(m, m + n), slice(m + n, None)
        M[:m, :m], M[:m, along] = A[:m, :m], A[:m, m:] @ D
        M[along, :m], M[along, along] = D.T @ A[m:, :m], D.T @ A[m:, m:] @ D
        M[along, slide], M[slide, along] = belongs, -belongs.T
        M[np.arange(m + n, len(M)), rough] = mu[first]
        q[:m], q[along], q[slide] = shifted[:m], D.T @ shifted[m:], mu[first] * low[rough]
        x = solution(M, q / scale) * scale
        slack = x[slide][np.searchsorted(rough, self.rough)]
        return x[:m] > ROUND_OFF * scale, np.append(x[:m] + low, D @ x[along]), slack

    def _directions(self, sides: int) -> tuple[Array, Array]:
        """Return unit vectors of sliding, (k, n), and the contact of each, (n,).

        A line has two vectors, a plane one for each side of its pyramid.
        """
        found, of = list[Array](), list[int]()
        for number in range(sides):
            for contact in dict.fromkeys(self.rough.tolist()):
                rows = np.flatnonzero(self.rough == contact)
                count, vector = (2 if len(rows) == 1 else sides), np.zeros(len(self.rough))
                if number < count:
                    angle = 2 * np.pi * number / count
                    in_plane = [np.cos(angle), np.sin(angle)]
                    vector[rows] = in_plane if len(rows) > 1 else [1.0 - 2 * number]
                    found.append(vector)
                    of.append(contact)
        return np.reshape(found, (len(of), len(self.rough))).T, np.array(of, dtype=int)

    def tie(self, branch: Branch, rates: Array, least: Array) -> int | None:
        """Return the index of a contact on two branches for r, (m + k,), and N_0, (m,); or None."""
        size, m, problem = self.sizes(), self.count, self.problem(rates, least)
        P, mu = branch.impulses(self, rates.real, least.real).real * size, problem.mu
        y = problem.A @ P + problem.r
        # In these units an impulse is the change of a rate.
        small = _TIE * np.max(np.abs(P), initial=0.0)
        slow = max(small, _TIE * np.max(np.abs(y), initial=0.0))
        more = P[:m] - problem.low
        # An impact of one gap always pushes, however slowly the gap closes.
        tied = np.where(branch.pushes, more <= small, y[:m] <= slow) & (m > 1)
        sliding, friction = self.length(y[m:]), self.length(P[m:])
        held = friction >= mu * P[self.rough] - small
        on_edge = (branch.sticks & held) | ((self.length(branch.slides) > 0) & (sliding <= slow))
        on_edge &= np.diag(self.inverse_mass).real[m:] > 0
        np.logical_or.at(tied, self.rough, on_edge)
        return int(np.argmax(tied)) if np.any(tied) else None

    def stands(self, branch: Branch, rates: Array) -> int | None:
        """Return the index of a contact that slides on a branch, with s of round-off; or None.

        `rates` are g' and s after the impact, (m + k,).
        """
        small = self.problem(rates, np.zeros(self.count)).small(0.0)
        speed = self.length(rates.real[self.count :] / self.sizes()[self.count :])
        still = (self.length(branch.slides) > 0) & (speed <= small)
        return int(self.rough[np.argmax(still)]) if np.any(still) else None


class _Slip(NamedTuple):
    """Directions d of sliding and a = mu N/|z| of the k friction rows, zero in rows that stick.

    In scaled units z = T - s = -|z| d, and a solution has T = a z. Other than s/|s|, d and a stay
    determined where the sliding velocity goes to zero; a is zero on lines, where d is constant.
    """

    direction: Array
    share: Array

    def across(self, contacts: Contacts) -> Array:
        """Return a (I - d d^T), (k, k)."""
        d = self.direction
        return self.share[:, None] * (np.eye(len(d)) - np.outer(d, d) * contacts.same)


@final
@dataclass(frozen=True)
class Branch:
    """Which contacts push beyond N_0, (m,), and which friction rows stick or slide.

    `sticks` and the unit vectors `slides`, (k,) each, have one row for a line and two for a plane.
    `near` are the impulses N and T, (m + k,), of a solution. If contacts depend on each other the
    impulses are not unique; those nearest to `near` are taken, which lie within the cones of
    friction.
    """

    pushes: Array
    sticks: Array
    slides: Array
    near: Array

    def with_least(self, contacts: Contacts, least: Array, sought: Array) -> Branch:
        """Return the branch for the least impulses N_0, (m,), after a search with larger ones.

        Impulses of friction between contacts that stick get smaller with the cones.
        """
        smaller = sought > 0
        if not np.any(smaller):
            return self
        shrink = least.real / np.where(smaller, sought, 1.0)
        shrink = np.where(smaller, shrink, np.max(shrink[smaller]))
        return replace(self, near=self.near * np.append(shrink, shrink[contacts.rough]))

    def impulses(self, contacts: Contacts, rates: Array, least: Array) -> Array:
        """Return N and T, (m + k,), on the branch, for real or complex rates r and N_0."""
        m, P = contacts.count, self.near
        own = contacts.sizes()[m:]
        for _ in range(_CORRECTIONS if contacts.has_planes else 1):
            s = contacts.inverse_mass[m:] @ P + rates[m:]
            slip = self._slip(contacts, P, s)
            slid = -slip.across(contacts) @ (rates[m:] / own**2)
            side = np.concatenate([
                np.where(self.pushes, -rates[:m], least),
                np.where(self.sticks, -rates[m:], slid),
            ])  # fmt: skip
            small = contacts.problem(rates, least).small(_TIE)
            P = self._solved(contacts, slip, (side[:, None], P[:, None]), small)[:, 0]
        return P

    def along(
        self, contacts: Contacts, state: tuple[Array, Array], changes: tuple[Array, Array, Array]
    ) -> Array:
        """Return derivatives of N and T, (m + k, d), along d directions.

        `state` are N and T, (m + k,), and the sliding velocities s, (k,); `changes` are the
        derivatives of rates with impulses held, of N_0, and of mu. ArithmeticError if no impulses
        on the branch fit them.
        """
        rates_b, least_b, mu_b = changes
        m, (P, s) = contacts.count, state
        own, slip = contacts.sizes()[m:, None], self._slip(contacts, P, s)
        slid = -(slip.direction * P[contacts.rough])[:, None] * mu_b
        slid = slid - slip.across(contacts) @ (rates_b[m:] / own**2)
        side = np.vstack([
            np.where(self.pushes[:, None], -rates_b[:m], least_b),
            np.where(self.sticks[:, None], -rates_b[m:], slid),
        ])  # fmt: skip
        return self._solved(contacts, slip, (side, np.zeros_like(side)), 0.0)

    def _slip(self, contacts: Contacts, P: Array, s: Array) -> _Slip:
        """Return how contacts slide with impulses N and T, (m + k,), and velocities s, (k,)."""
        in_plane = (np.sum(contacts.same, axis=1) > 1) & (contacts.length(self.slides) > 0)
        m, own = contacts.count, contacts.sizes()[contacts.count :]
        z = P[m:] - s / own**2
        # Without impulses and sliding the branch knows the direction.
        z = np.where(in_plane & (contacts.length(z) != 0), z, -self.slides)
        length = np.where(in_plane, contacts.length(z), 1.0)
        share = contacts.friction * P[contacts.rough] / length
        return _Slip(-z / length, np.where(in_plane, share, 0.0))

    def _solved(
        self, contacts: Contacts, slip: _Slip, given: tuple[Array, Array], small: float
    ) -> Array:
        """Return the impulses that solve the branch for a right side, nearest to a first guess.

        `given` are the right side and the first guess, (m + k, d) each. ArithmeticError if the side
        is missed by more than `small` and round-off.
        """
        side, near = given
        m, rough, size = contacts.count, contacts.rough, contacts.sizes()
        scaled = contacts.inverse_mass / np.outer(size, size)
        kind = np.result_type(scaled, contacts.friction, slip.direction, slip.share)
        K = np.eye(len(size), dtype=kind)
        # T + mu N d - a (I - d d^T) (T - s) = 0 where a contact slides
        K[m:] -= slip.across(contacts) @ (K[m:] - scaled[m:])
        held = np.concatenate([self.pushes, self.sticks])
        K[held] = scaled[held]
        for j in np.flatnonzero(contacts.length(self.slides)).tolist():
            ratio = size[m + j] / size[rough[j]]
            K[m + j, rough[j]] += slip.direction[j] * contacts.friction[j] * ratio
        factor = np.where(held, 1 / size, size)
        right, begin = side * factor[:, None], near * size[:, None]
        miss = right - K @ begin
        found = begin + np.linalg.lstsq(K, miss, rcond=_MOVES_NOTHING)[0]
        off = np.abs(K @ found - right)
        if np.any(off > np.maximum(small, _TIE * np.max(np.abs(right), axis=0, initial=0.0))):
            raise ArithmeticError
        return found / size[:, None]
