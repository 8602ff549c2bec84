"""Newton's impact of one or several gaps at one time, and its derivatives.

G = g_q are the gradients of the gaps, u = G v + g_t their rates, and e is the diagonal matrix of
the restitutions. The velocity v before the impact is first moved onto the constraints, to v_p:

    M (v_p - v) + Phi_q^T sigma = 0,   Phi_q v_p = nu.

Then it is struck:

    M (v+ - v) + Phi_q^T mu - G^T P = 0,   Phi_q v+ = nu,   G v+ + g_t + e (G v_p + g_t) = 0.

With M X + Phi_q^T Y = G^T and Phi_q X = 0 the gaps see the inverse mass G X. The impulses follow
from G X P = -(1 + e) u, and v+ = v_p + X P. Gaps whose impulse would pull are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.complex_steps import at_values
from ancfdae.equations.saddle_points import saddle_point, solve
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.events.functions import Partials, gap_rows, gap_rows_along, partials
from ancfdae.events.kinds import Impact
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization
from ancfdae.sensitivity.observables.observable import Observable, States

# Inverse masses below this part of the largest possible one are round-off: of a gap that joints
# hold, and of a gap whose rate follows from the rates of other gaps.
_FIXED, _DEPENDENT = 1e-12, 1e-10


class Directions(NamedTuple):
    """k directions in which a state moves: t (k,), q and v (n_q, k), and the design (n_b, k)."""

    t: Array
    q: Array
    v: Array
    b: Array

    @staticmethod
    def all_of(system: MechanicalSystem) -> Directions:
        """Return unit directions of the time, q, v and the design, one after the other."""
        n, n_b = system.n_q, system.n_b
        unit = np.eye(1 + 2 * n + n_b)
        return Directions(unit[0], unit[1 : n + 1], unit[n + 1 : 2 * n + 1], unit[2 * n + 1 :])


class _Velocity(NamedTuple):
    """A velocity w on the constraints, and the multipliers that lead there from v.

    M (w - v) + Phi_q^T multiplier - G^T impulses = 0, Phi_q w = nu.
    """

    value: Array
    multiplier: Array
    impulses: Array


@final
@dataclass(frozen=True)
class Struck:
    """Impacts at one time, solved: velocities moved onto the constraints, and after the impact.

    `impulses` are P of `impacts`, those that push, with the restitutions e; X as above.
    """

    system: MechanicalSystem
    impacts: tuple[Impact, ...]
    plastic: bool
    state: tuple[complex, Array, Array]
    before: _Velocity
    after: _Velocity
    restitution: Array
    rows: tuple[Array, Array]
    X: Array
    factors: Factorization

    @property
    def impulses(self) -> dict[str, complex]:
        """Impulse of each impact that pushes, by its name."""
        names = (impact.name for impact in self.impacts)
        return dict(zip(names, self.after.impulses.tolist(), strict=True))

    def along(self, moved: Directions) -> tuple[Array, Array]:
        """Return the derivatives of v+, (n_q, k), and of the impulses, (m, k), along directions."""
        (G, g_t), e, (t, q, _) = self.rows, self.restitution, self.state
        rows_b = [
            gap_rows_along(self.system, x.gap, float(np.real(t)), q, (moved.t, moved.q, moved.b))
            for x in self.impacts
        ]
        turned = np.zeros_like(moved.q)
        for impulse, (dG, _) in zip(self.after.impulses, rows_b, strict=True):
            turned = turned + impulse * dG
        before_b, held_b = (
            self._held(w, moved, extra) for w, extra in ((self.before, 0.0), (self.after, turned))
        )

        def rate_b(w: Array) -> Array:
            return np.array([w @ dG + dg_t for dG, dg_t in rows_b]).reshape(len(G), -1)

        u, e_b = G @ self.before.value + g_t, self._restitution_along(moved)
        w, w_before = self.after.value, self.before.value
        gap = G @ held_b + rate_b(w) + e[:, None] * (G @ before_b + rate_b(w_before))
        P_b = -np.linalg.solve(G @ self.X, gap + e_b * u[:, None])
        return held_b + self.X @ P_b, P_b

    def _held(self, w: _Velocity, moved: Directions, extra: Array | float) -> Array:
        """Return derivatives of a velocity, (n_q, k), impulses held; `extra` is (G^T P)_b."""
        system, (t, q, v) = self.system, self.state
        time, change = float(np.real(t)), w.value - v
        at = np.array([time]), q[None], None, change[None], w.multiplier[None]
        own, f_q = system.design_partials(*at), only(system.linearise(*at).f_q)
        still = np.zeros_like(q)
        Phi_qt, B = system.constraint_q(time, q, still), system.constraint_pattern
        force_t = B.dot_transposed(Phi_qt, w.multiplier)
        force_b = system.pattern.dot(f_q, moved.q) + only(own.f_b) @ moved.b
        force_b = force_b + np.outer(force_t, moved.t) - system.mass_times(q, moved.v)
        side_t = B.dot(Phi_qt, w.value) + system.constraint(time, q, still, still)
        side = B.dot(system.constraint_q(time, q, w.value), moved.q) + np.outer(side_t, moved.t)
        side = side + system.constraint_total(time, (q, w.value)) @ moved.b
        return solve(self.factors, extra - force_b, -side)[0]

    def _restitution_along(self, moved: Directions) -> Array:
        """Return the derivatives of the restitutions along directions, (m, k)."""
        rows = np.zeros((len(self.impacts), len(moved.t)))
        for row, impact in zip(rows, self.impacts, strict=True):
            if isinstance(impact.restitution, Observable) and not self.plastic:
                p = _of_state(self.system, impact.restitution, self.state)[1]
                row += p.t * moved.t + p.q @ moved.q + p.v @ moved.v + p.b @ moved.b
        return rows


def struck(
    system: MechanicalSystem,
    impacts: Sequence[Impact],
    plastic: bool,
    state: tuple[complex, Array, Array],
) -> Struck:
    """Solve impacts that happen at (t, q, v); plastic ones have no restitution."""
    t, q, v = state
    # The time may have an imaginary part, which constraints of a phase that begins here accept.
    local = PhaseSystem(system, PhaseStart.held(t, q, v, system.n_b), 1.0, first=False)
    matrices = saddle_point(system, float(np.real(t)), q.real)
    factors = matrices.factor(system.mass(q), local.constraint_q(0.0, q))
    moved, multiplier = solve(factors, np.zeros_like(v), local.constraint(0.0, q, v))
    before = _Velocity(v - moved, -multiplier, np.zeros(0))
    active = _independent(system, factors, impacts, t, q)
    while True:
        G, g_t = _rows(system, active, t, q)
        X, Y = solve(factors, G.T, np.zeros((system.n_lam, len(active)), dtype=G.dtype))
        e = np.array([0.0 if plastic else _restitution(system, x, state) for x in active])
        P = -np.linalg.solve(G @ X, (1 + e) * (G @ before.value + g_t))
        pulls = P.real < 0
        if not np.any(pulls) or len(active) == 1:
            break
        weakest = int(np.argmin(P.real))
        active = active[:weakest] + active[weakest + 1 :]
    after = _Velocity(before.value + X @ P, before.multiplier + Y @ P, P)
    return Struck(system, active, plastic, state, before, after, e, (G, g_t), X, factors)


def _independent(
    system: MechanicalSystem,
    factors: Factorization,
    impacts: Sequence[Impact],
    t: complex,
    q: Array,
) -> tuple[Impact, ...]:
    """Return the impacts, in their order, without gaps whose rates follow from those before.

    Two gaps of one pair of points close together, and one impulse opens both. InvalidInputError if
    no motion that the joints allow changes a gap.
    """
    chosen: list[Impact] = []
    for impact in impacts:
        G, _ = _rows(system, [*chosen, impact], t, q)
        X, _ = solve(factors, G.T, np.zeros((system.n_lam, len(G)), dtype=G.dtype))
        inverse_mass = (G @ X).real
        own = inverse_mass[-1, -1]
        if not own > _FIXED * np.sum(G[-1].real ** 2 / system.weights):
            where = f"Impact.gap of {impact.name!r} at t = {np.real(t):.6g}"
            rule = "must depend on coordinates that joints leave free"
            raise InvalidInputError(where, rule, "a gap that no impulse changes")
        rest = inverse_mass[-1, :-1]
        left = own - rest @ np.linalg.solve(inverse_mass[:-1, :-1], rest) if chosen else own
        if left > _DEPENDENT * own:
            chosen.append(impact)
    return tuple(chosen)


def _rows(
    system: MechanicalSystem, impacts: Sequence[Impact], t: complex, q: Array
) -> tuple[Array, Array]:
    """Return G, (m, n_q), and g_t, (m,), also at a state or design with small imaginary parts."""
    real = system
    if np.iscomplexobj(system.b):
        real = at_values(system, system.b.real)
    time = float(np.real(t))
    pairs = [gap_rows(real, x.gap, np.array([time]), q.real[None]) for x in impacts]
    G, g_t = np.array([x[0] for x, _ in pairs]), np.array([x[0] for _, x in pairs])
    if not (np.iscomplexobj(q) or np.iscomplexobj(system.b) or np.iscomplexobj(t)):
        return G, g_t
    along = np.array([np.imag(t)]), np.imag(q)[:, None], np.imag(system.b)[:, None]
    turned = [gap_rows_along(real, x.gap, time, q.real, along) for x in impacts]
    G = G + 1j * np.array([x[:, 0] for x, _ in turned])
    return G, g_t + 1j * np.array([x[0] for _, x in turned])


def _restitution(
    system: MechanicalSystem, impact: Impact, state: tuple[complex, Array, Array]
) -> complex:
    """Return e of an impact; refuse a negative one."""
    e = impact.restitution
    if not isinstance(e, Observable):
        return e
    t, q, v = state
    at = States(np.array([t]), q[None], v[None], np.zeros((1, system.n_lam)))
    value = complex(e.value(system, at)[0])
    if not value.real >= 0:
        where = f"Impact.restitution of {impact.name!r} at t = {np.real(t):.6g}"
        raise InvalidInputError(where, "must not be negative", value.real)
    return value if np.iscomplexobj(q) or np.iscomplexobj(system.b) else value.real


def _of_state(
    system: MechanicalSystem, function: Observable, state: tuple[complex, Array, Array]
) -> tuple[float, Partials]:
    """Return value and partials of an observable at a real state."""
    t, q, v = state
    at = States(np.array([np.real(t)]), q[None], v[None], np.zeros((1, system.n_lam)))
    return partials(system, function, at)
