"""The woodpecker toy in minimal coordinates, with events and complementarity of its own.

Equations and data: Ch. Glocker, Dynamik von Starrkoerpersystemen mit Reibung und Stoessen
(dissertation, TU Muenchen, 1995), as in R. I. Leine, Ch. Glocker and D. H. van Campen, Nonlinear
dynamics of the woodpecker toy (ASME DETC2001/VIB-21608). A sleeve with clearance on a pole carries
a bird on a torsional spring. Coordinates are the height of the sleeve and the angles of sleeve and
bird. Contacts: the beak, and the lower and the upper end of the sleeve, on the pole.

Nothing of the package is used here. Branches of impulses and of contact forces are tried in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import scipy

__all__ = ["DATA", "Toy"]

Array = np.ndarray[Any, Any]

#: m_M, J_M, m_S, J_S, c, g, r_0, r_M, h_M, l_M, l_G, h_S, l_S in SI units.
DATA = (
    0.0003, 5e-9, 0.0045, 7e-7, 0.0056, 9.81, 0.0025, 0.0031, 0.0058, 0.01, 0.015, 0.02, 0.0201,
)  # fmt: skip

# Gaps and rates below these are zero: m, and m/s.
_CLOSED, _STANDS = 1e-11, 1e-9
# Complementary numbers below this part of the largest one are zero.
_ZERO = 1e-9
# Most events of a run.
_MOST = 400
# Least steps of a phase: events of SciPy that change their sign twice in a step are not seen.
_STEP = 1e-3


class Contact(NamedTuple):
    """A closed contact: its number, and 0 if it sticks, else the sign of its sliding velocity."""

    number: int
    slides: int


@dataclass
class Toy:
    """The toy with friction mu, restitutions of its three contacts, and one of two impact laws."""

    data: Sequence[float] = DATA
    mu: float = 0.3
    restitution: Sequence[float] = (0.5, 0.0, 0.0)
    poisson: bool = False

    def __post_init__(self) -> None:
        m_M, J_M, m_S, J_S, c, g, r_0, r_M, h_M, l_M, l_G, h_S, l_S = self.data
        self.M = np.array([
            [m_S + m_M, m_S * l_M, m_S * l_G],
            [m_S * l_M, J_M + m_S * l_M**2, m_S * l_M * l_G],
            [m_S * l_G, m_S * l_M * l_G, J_S + m_S * l_G**2],
        ])  # fmt: skip
        self.inverse = np.linalg.inv(self.M)
        self.weight = -g * np.array([m_S + m_M, m_S * l_M, m_S * l_G])
        self.K = c * np.array([[0, 0, 0], [0, 1, -1], [0, -1, 1]])
        self.normal = np.array([[0, 0, -h_S], [0, h_M, 0], [0, -h_M, 0]])
        self.clearance = np.array([l_M + l_G - l_S - r_0, r_M - r_0, r_M - r_0])
        self.tangent = np.array([[1, l_M, l_G - l_S], [1, r_M, 0], [1, r_M, 0]])
        self.events: list[tuple[float, str]] = []

    # -- complementarity ---------------------------------------------------------------------------

    def _solved(
        self, known: Sequence[tuple[int, int | None]], rates: Array, least: Array
    ) -> tuple[list[str], Array]:
        """Return the branch and the forces or impulses of contacts, by trial of all branches.

        `known` are contacts with the sign of their sliding, None where it is to be found.
        """
        which = [i for i, _ in known]
        n, W = len(which), np.vstack([self.normal[which], self.tangent[which]])
        A = W @ self.inverse @ W.T
        choices = [
            ("open", "stick", "+", "-") if how is None else ("open", "+" if how > 0 else "-")
            for _, how in known
        ]
        for branch in product(*choices):
            K, side = np.eye(2 * n), np.zeros(2 * n)
            for i, how in enumerate(branch):
                if how == "open":
                    side[i] = least[i]
                else:
                    K[i], side[i] = A[i], -rates[i]
                K[n + i, i] = {"+": self.mu, "-": -self.mu}.get(how, 0.0)
                if how == "stick":
                    K[n + i], side[n + i] = A[n + i], -rates[n + i]
            P = np.linalg.solve(K, side)
            if self._fits(known, branch, P, A @ P + rates, least):
                return list(branch), P
        raise ArithmeticError("no branch fits")

    def _fits(
        self,
        known: Sequence[tuple[int, int | None]],
        branch: Sequence[str],
        P: Array,
        rates: Array,
        least: Array,
    ) -> bool:
        """Whether a trial satisfies all inequalities."""
        n = len(known)
        small, slow = (_ZERO * (np.max(np.abs(x)) or 1.0) for x in (P, rates))
        for i, how in enumerate(branch):
            N, T, after, sliding = P[i], P[n + i], rates[i], rates[n + i]
            if how == "open":
                good = after >= -slow
            else:
                good = least[i] - small <= N
                if how == "stick":
                    good &= abs(T) <= self.mu * N + small
                elif known[i][1] is None:
                    good &= sliding * (1 if how == "+" else -1) >= -slow
            if not good:
                return False
        return True

    def struck(self, q: Array, u: Array) -> Array:
        """Return the velocities after an impact of all closed contacts."""
        which = np.flatnonzero(self.gaps(q) <= _CLOSED)
        known, n = [(int(i), None) for i in which], len(which)
        W = np.vstack([self.normal[which], self.tangent[which]])
        e, zero = np.array(self.restitution)[which], np.zeros(n)
        shift = np.concatenate([np.zeros(n) if self.poisson else e * (W @ u)[:n], zero])
        _, P = self._solved(known, W @ u + shift, zero)
        u = u + self.inverse @ W.T @ P
        if self.poisson and np.any(e * P[:n] > 0):
            # Only contacts that are loaded expand: no branch lacks a friction force here.
            given = e * P[:n]
            _, more = self._expanded(which, W @ u, given)
            u = u + self.inverse @ W.T @ more
        return u

    def _expanded(self, which: Array, rates: Array, given: Array) -> tuple[str, Array]:
        """Return the impulses of expansion of a single contact with at least `given`."""
        W = np.vstack([self.normal[which], self.tangent[which]])
        A = W @ self.inverse @ W.T
        for how in ("stick", "+", "-"):
            for extra in (False, True):
                K, side = np.eye(2), np.array([given[0], 0.0])
                if extra:
                    K[0], side[0] = A[0], -rates[0]
                if how == "stick":
                    K[1], side[1] = A[1], -rates[1]
                else:
                    K[1, 0] = self.mu if how == "+" else -self.mu
                P = np.linalg.solve(K, side)
                y = A @ P + rates
                good = P[0] >= given[0] * (1 - _ZERO) and y[0] >= -_ZERO
                if how == "stick":
                    good &= abs(P[1]) <= self.mu * P[0]
                else:
                    good &= y[1] * (1 if how == "+" else -1) >= 0
                if good:
                    return how, P
        raise ArithmeticError("no branch fits")

    # -- motion ------------------------------------------------------------------------------------

    def gaps(self, q: Array) -> Array:
        """Return the three gaps."""
        return self.clearance + self.normal @ q

    def _force(self, q: Array) -> Array:
        return self.weight - self.K @ q

    def _contacts(self, q: Array, u: Array, event: str) -> list[Contact]:
        """Return the contacts that push in a state after an event, by their accelerations."""
        closed = (self.gaps(q) <= _CLOSED) & (np.abs(self.normal @ u) <= _STANDS)
        which, sliding = np.flatnonzero(closed).tolist(), self.tangent @ u
        if not which:
            return []
        known = [
            (i, None if abs(sliding[i]) <= _STANDS else int(np.sign(sliding[i]))) for i in which
        ]
        if event.startswith("slip"):
            # The friction has reached its limit: the contact slides, its velocity still zero.
            begins = int(event.split()[1]), 1 if event[4] == "+" else -1
            known = [begins if i == begins[0] else (i, how) for i, how in known]
        W = np.vstack([self.normal[which], self.tangent[which]])
        free = W @ self.inverse @ self._force(q)
        branch, _ = self._solved(known, free, np.zeros(len(which)))
        signs = {"stick": 0, "+": 1, "-": -1}
        return [
            Contact(i, signs[how]) for i, how in zip(which, branch, strict=True) if how != "open"
        ]

    def _dynamics(self, q: Array, contacts: Sequence[Contact]) -> tuple[Array, Array, Array]:
        """Return accelerations, and normal and friction forces of the contacts."""
        n, h = len(contacts), self._force(q)
        K, side = np.zeros((3 + 2 * n, 3 + 2 * n)), np.concatenate([h, np.zeros(2 * n)])
        K[:3, :3] = self.M
        for i, (number, slides) in enumerate(contacts):
            N, T = 3 + i, 3 + n + i
            K[:3, N], K[:3, T] = -self.normal[number], -self.tangent[number]
            K[N, :3] = self.normal[number]
            if slides == 0:
                K[T, :3] = self.tangent[number]
            else:
                K[T, T], K[T, N] = 1.0, slides * self.mu
        x = np.linalg.solve(K, side)
        return x[:3], x[3 : 3 + n], x[3 + n :]

    def _ends(
        self, contacts: Sequence[Contact]
    ) -> Sequence[tuple[str, int, Callable[[Array], float]]]:
        """Return the functions that end a phase: what happens, the direction, the function."""

        def gap(y: Array, i: int) -> float:
            return float(self.gaps(y[:3])[i])

        def force(y: Array, k: int, side: int | None) -> float:
            _, N, T = self._dynamics(y[:3], contacts)
            return float(N[k] if side is None else self.mu * N[k] + side * T[k])

        def sliding(y: Array, i: int) -> float:
            return float(self.tangent[i] @ y[3:])

        closed = {x.number for x in contacts}
        found = [(f"hit {i}", -1, partial(gap, i=i)) for i in {0, 1, 2} - closed]
        for k, (i, slides) in enumerate(contacts):
            found.append((f"open {i}", -1, partial(force, k=k, side=None)))
            if slides:
                found.append((f"stick {i}", -slides, partial(sliding, i=i)))
            else:
                signs = (1, "+"), (-1, "-")
                found += [(f"slip{x} {i}", -1, partial(force, k=k, side=s)) for s, x in signs]
        return found

    def run(self, q: Array, u: Array, t_end: float) -> tuple[Array, Array]:
        """Return coordinates and velocities at the end; `events` then has times and names."""
        t, y, name = 0.0, np.concatenate([q, u]), ""
        self.events.clear()
        for _ in range(_MOST):
            contacts = self._contacts(y[:3], y[3:], name)
            ends = self._ends(contacts)
            run = scipy.integrate.solve_ivp(
                lambda _, y, c=contacts: np.concatenate([y[3:], self._dynamics(y[:3], c)[0]]),
                (t, t_end), y, events=[_event(each[1], each[2]) for each in ends],
                method="DOP853", rtol=1e-12, atol=1e-14, max_step=_STEP,
            )  # fmt: skip
            t, y = float(run.t[-1]), run.y[:, -1]
            if run.status == 0:
                break
            name = next(ends[k][0] for k, times in enumerate(run.t_events) if len(times))
            self.events.append((t, name))
            y = self._after(name, y)
        return y[:3], y[3:]

    def _after(self, name: str, y: Array) -> Array:
        """Return the state after an event."""
        what, number = name.split()
        q, u, i = y[:3], y[3:], int(number)
        if what == "hit":
            u = self.struck(q, u)
        elif what == "stick":
            # The sliding velocity is zero there up to the location of the event.
            w = self.tangent[i]
            u = u - self.inverse @ w * (w @ u) / (w @ self.inverse @ w)
        return np.concatenate([q, u])


def _event(direction: int, function: Callable[[Array], float]) -> Callable[[float, Array], float]:
    def event(_: float, y: Array) -> float:
        return function(y)

    event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
    return event
