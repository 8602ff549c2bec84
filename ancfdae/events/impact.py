"""Impacts of one or several gaps at one time, with friction, and their derivatives.

G = g_q are the gradients of the gaps, u = G v + g_t their rates; rough contacts have one or
two sliding velocities s = H v + s_t each, with H = s_v. W stacks G and H. The velocity v before
the impact is first moved onto the constraints, to v_p:

    M (v_p - v) + Phi_q^T sigma = 0,   Phi_q v_p = nu.

Then it is struck by impulses P along normals and T along lines, or in planes, of sliding:

    M (v+ - v) + Phi_q^T mu - W^T (P, T) = 0,   Phi_q v+ = nu.

With M X + Phi_q^T Y = W^T and Phi_q X = 0 the contacts see the inverse mass W X, and
v+ = v_p + X (P, T). Impulses follow from `complementarity`: by Newton's law in one stage with
u+ + e u in the place of u+; by Poisson's law in two, compression and expansion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.saddle_points import saddle_point, solve
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.events.complementarity import Branch, Contacts
from ancfdae.events.contact_rows import (
    coefficient,
    contact_rows,
    of_state,
    rows_of_contacts,
)
from ancfdae.events.functions import rows_along
from ancfdae.events.kinds import Impact, ImpactLaw
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization
from ancfdae.sensitivity.observables.observable import Observable

# Inverse masses count as zero below these fractions of the largest possible one: for a gap that
# joints fix, and for a gap whose rate follows from the rates of other gaps.
_FIXED, _DEPENDENT = 1e-12, 1e-10
# A sliding velocity counts as zero below this fraction of its terms.
_STANDS = 1e-12
# The branch of an expansion with a smaller restitution, or none, is the one for this restitution.
_LITTLE = 1e-8
# Gaps are uncoupled if the impulse of one changes the rate of another by less than this, relative
# to its own.
_UNCOUPLED = 1e-12


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
    """A velocity w on the constraints, with the multipliers and impulses that lead to it from v.

    M (w - v) + Phi_q^T multiplier - W^T impulses = 0, Phi_q w = nu.
    """

    value: Array
    multiplier: Array
    impulses: Array


class _Stage(NamedTuple):
    """A stage of an impact: its branch and impulses, and the velocity at its end.

    `tie` is the index of an impact that lies between two branches, or None.
    """

    branch: Branch
    impulses: Array
    after: _Velocity
    tie: int | None


@final
@dataclass(frozen=True)
class Struck:
    """Solved impacts at one time.

    `impacts` are those that push, with the restitutions e, (m,); `contacts` hold the inverse mass
    and the coefficients of friction. `before` is the velocity moved onto the constraints; the last
    of `stages` ends with the velocity after the impact. X is as in the module. `tie` names an
    impact that lies between two branches.
    """

    system: MechanicalSystem
    impacts: tuple[Impact, ...]
    plastic: bool
    state: tuple[complex, Array, Array]
    before: _Velocity
    stages: tuple[_Stage, ...]
    restitution: Array
    contacts: Contacts
    rows: tuple[Array, Array]
    X: Array
    factors: Factorization
    tie: str | None

    @property
    def after(self) -> _Velocity:
        """The velocity of the system after the impact, with the total impulses."""
        return self.stages[-1].after

    def impulses(self) -> list[tuple[Impact, int, list[int]]]:
        """Return each impact that pushes, with the index of its P and the indices of its T."""
        m, rough = len(self.impacts), self.contacts.rough
        places = [(m + np.flatnonzero(rough == i)).tolist() for i in range(m)]
        return list(zip(self.impacts, range(m), places, strict=True))

    def slides(self, impact: Impact) -> float:
        """Return the sign of the sliding velocity at the end of an impact; 0 if it sticks.

        In a plane every direction of sliding counts as positive.
        """
        (W, w_t), w = self.rows, self.after.value
        for each, _, places in self.impulses():
            if each is impact and places:
                terms = np.abs(W[places]) @ np.abs(w) + np.abs(w_t[places])
                rates = np.real(W[places] @ w + w_t[places])
                moves = bool(np.any(np.abs(rates) > _STANDS * np.max(terms)))
                sign = float(np.sign(rates[0])) if len(places) == 1 else 1.0
                return sign if moves else 0.0
        return 0.0

    def require_branch(self) -> None:
        """Raise InvalidInputError for impacts between sticking, sliding and opening.

        Such impacts have no derivative.
        """
        if self.tie is not None:
            where = f"impact {self.tie!r} at t = {np.real(self.state[0]):.6g}"
            rule = "must stick, slide or open clearly to have derivatives"
            got = "a contact between two of these, which neighbouring designs leave to either side"
            repair = "Change the design or the coefficient of friction, or use FiniteDifference()."
            raise InvalidInputError(where, rule, got, repair)

    def along(self, moved: Directions) -> tuple[Array, Array]:
        """Return derivatives of v+, (n_q, d), and of (P, T), (m + k, d), along d directions."""
        self.require_branch()
        m, (W, w_t), (t, q, _) = len(self.impacts), self.rows, self.state
        directions = moved.t, moved.q, moved.b
        rows_b = [
            rows_along(self.system, rows_of, float(np.real(t)), q, directions)
            for rows_of in rows_of_contacts(self.impacts)
        ]

        def rates_b(w: _Velocity) -> tuple[Array, Array]:
            """Return derivatives of a velocity and of its rates, at fixed impulses."""
            turned = np.zeros_like(moved.q)
            for impulse, (dW, _) in zip(w.impulses, rows_b, strict=True):
                turned = turned + impulse * dW
            held = self._held(w, moved, turned)
            on_rows = [w.value @ dW + dw_t for dW, dw_t in rows_b]
            return held, W @ held + np.array(on_rows).reshape(len(W), -1)

        e, (e_b, mu_b) = self.restitution[:, None], self._coefficients_along(moved)
        u, (_, u_b) = (W @ self.before.value + w_t)[:m, None], rates_b(self.before)
        total_b, stage_b = np.zeros((2, len(W), len(moved.t)), dtype=u_b.dtype)
        least_b, held_b = np.zeros((m, len(moved.t))), np.zeros_like(moved.v)
        for number, stage in enumerate(self.stages):
            held_b, change = rates_b(stage.after)
            change = change + self.contacts.inverse_mass @ total_b
            if number > 0:
                first = self.stages[0].impulses[:m, None]
                least_b = e_b * first + e * stage_b[:m]
            elif not self._in_two_stages:
                change[:m] += e * u_b[:m] + e_b * u
            state = stage.impulses, (W @ stage.after.value + w_t)[m:]
            stage_b = self._branch_along(stage.branch, state, (change, least_b, mu_b))
            total_b = total_b + stage_b
        return held_b + self.X @ total_b, total_b

    def _branch_along(
        self, branch: Branch, state: tuple[Array, Array], changes: tuple[Array, Array, Array]
    ) -> Array:
        try:
            return branch.along(self.contacts, state, changes)
        except ArithmeticError as error:
            names = ", ".join(repr(x.name) for x in self.impacts)
            where = f"impacts {names} at t = {np.real(self.state[0]):.6g}"
            rule = "must not depend on each other at this design only"
            got, repair = "contacts that hold the same motion", "Use FiniteDifference()."
            raise InvalidInputError(where, rule, got, repair) from error

    @property
    def _in_two_stages(self) -> bool:
        """Whether compression and expansion are separate stages (Poisson's law)."""
        return len(self.stages) > 1

    def _held(self, w: _Velocity, moved: Directions, extra: Array | float) -> Array:
        """Return derivatives of a velocity w, (n_q, k), at fixed impulses; `extra` is W_b^T p."""
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

    def _coefficients_along(self, moved: Directions) -> tuple[Array, Array]:
        """Return the derivatives of restitutions, (m, d), and of frictions, (k, d)."""
        restitutions = [0.0 if self.plastic else x.restitution for x in self.impacts]
        frictions = [x.friction for x in self.impacts for _ in x.lines]
        found = []
        for numbers in (restitutions, frictions):
            rows = np.zeros((len(numbers), len(moved.t)))
            for row, number in zip(rows, numbers, strict=True):
                if isinstance(number, Observable):
                    p = of_state(self.system, number, self.state)[1]
                    row += p.t * moved.t + p.q @ moved.q + p.v @ moved.v + p.b @ moved.b
            found.append(rows)
        return found[0], found[1]


def struck(
    system: MechanicalSystem,
    impacts: Sequence[Impact],
    plastic: bool,
    state: tuple[complex, Array, Array],
) -> Struck:
    """Return the solution of impacts at a state (t, q, v); `plastic` sets all restitutions to 0."""
    t, q, v = state
    local, factors = _factored(system, state)
    moved, multiplier = solve(factors, np.zeros_like(v), local.constraint(0.0, q, v))
    before = _Velocity(v - moved, -multiplier, np.zeros(0))
    active = _independent(system, factors, impacts, t, q)
    return _Impulses(system, active, plastic, state, before, factors).solved()


@final
class _Impulses:
    """Equations for the impulses of impacts with independent gaps, from a consistent velocity."""

    def __init__(
        self,
        system: MechanicalSystem,
        impacts: tuple[Impact, ...],
        plastic: bool,
        state: tuple[complex, Array, Array],
        before: _Velocity,
        factors: Factorization,
    ) -> None:
        self._system, self._impacts, self._plastic = system, impacts, plastic
        self._state, self._factors = state, factors
        self._rows = W, w_t = contact_rows(system, impacts, *state[:2])
        no_side = np.zeros((system.n_lam, len(W)), dtype=W.dtype)
        self._X, self._Y = solve(factors, W.T, no_side)
        self._before = before._replace(impulses=np.zeros(len(W)))
        e = [0.0 if plastic else x.restitution for x in impacts]
        self._e = np.array([
            coefficient(system, own, f"restitution of {x.name!r}", state)
            for own, x in zip(e, impacts, strict=True)
        ])  # fmt: skip
        rough = [i for i, x in enumerate(impacts) for _ in x.lines]
        mu = [
            coefficient(system, x.friction, f"friction of {x.name!r}", state)
            for x in impacts
            for _ in x.lines
        ]
        noise = np.finfo(float).eps * (np.abs(W) @ np.abs(before.value) + np.abs(w_t))
        self._contacts = Contacts(W @ self._X, np.array(rough, dtype=int), np.array(mu), noise)
        self._rates = W @ before.value + w_t

    def solved(self) -> Struck:
        """Return the solved impacts, without the contacts that do not push."""
        stages, m = self._stages(), len(self._impacts)
        total = stages[-1].after.impulses
        pushing = np.flatnonzero(total[:m].real > 0)
        if len(pushing) < m:
            kept = tuple(self._impacts[i] for i in (pushing.tolist() or [0]))
            if len(kept) < m:
                tie = self._tie(stages)
                reduced = struck(self._system, kept, self._plastic, self._state)
                return reduced if tie is None else replace(reduced, tie=tie)
        return Struck(
            self._system, self._impacts, self._plastic, self._state, self._before, stages, self._e,
            self._contacts, self._rows, self._X, self._factors, self._tie(stages),
        )  # fmt: skip

    def _stages(self) -> tuple[_Stage, ...]:
        """Return the stages of the impact: one (Newton), or compression and expansion (Poisson)."""
        laws, m = {x.law for x in self._impacts}, len(self._impacts)
        if len(laws) > 1:
            names = ", ".join(repr(x.name) for x in self._impacts)
            repair = "Give all impacts that may happen together the same law."
            raise InvalidInputError(f"impacts {names}", "must follow one law", "two", repair)
        zero, shift = np.zeros(m), np.zeros_like(self._rates)
        if laws == {ImpactLaw.NEWTON} or self._plastic:
            shift[:m] = self._e * self._rates[:m]
            return (self._stage(self._before, shift, (zero, zero)),)
        first = self._stage(self._before, shift, (zero, zero))
        e, P = np.maximum(self._e.real, _LITTLE), first.impulses[:m]
        return first, self._stage(first.after, shift, (self._e * P, e * P.real))

    def _stage(self, before: _Velocity, shift: Array, least: tuple[Array, Array]) -> _Stage:
        """Return a stage from the velocity before it and a shift of the rates after it.

        `least` are N_0, and the N_0 that give the branch: without expansion a state is between two
        branches, of which restitutions, which are not negative, have one.
        """
        W, w_t = self._rows
        contacts, rates = self._contacts, W @ before.value + w_t + shift
        try:
            branch = contacts.branch(rates, least[1])
            slow = len(self._impacts) == 1 and not branch.pushes[0] and not np.any(least[1])
            if slow:
                # A gap that closes with a rate of round-off gets the rate of the law.
                branch = replace(branch, pushes=np.array([True]))
            tie = contacts.tie(branch, rates, least[1])
            branch = branch.with_least(contacts, *least)
            impulses = branch.impulses(contacts, rates, least[0])
            if tie is None:
                tie = contacts.stands(branch, contacts.inverse_mass @ impulses + rates)
            if not slow and not contacts.keep_law(impulses, rates, least[0]):
                raise ArithmeticError
        except ArithmeticError as error:
            names = ", ".join(repr(x.name) for x in self._impacts)
            where = f"impacts {names} at t = {np.real(self._state[0]):.6g}"
            rule = "must have impulses within the cones of friction"
            repair = "Give fewer contacts or less friction."
            raise InvalidInputError(where, rule, "none", repair) from error
        value = before.value + self._X @ impulses
        multiplier, total = before.multiplier + self._Y @ impulses, before.impulses + impulses
        return _Stage(branch, impulses, _Velocity(value, multiplier, total), tie)

    def _tie(self, stages: Sequence[_Stage]) -> str | None:
        """Return the name of an impact that lies between two branches of a stage, or None."""
        return next((self._impacts[x.tie].name for x in stages if x.tie is not None), None)


def uncoupled(
    system: MechanicalSystem, impacts: Sequence[Impact], state: tuple[float, Array, Array]
) -> list[tuple[Impact, ...]]:
    """Return the impacts in groups whose impulses do not change rates of other groups' gaps."""
    t, q, _ = state
    W, _ = contact_rows(system, impacts, t, q)
    X, _ = solve(_factored(system, state)[1], W.T, np.zeros((system.n_lam, len(W))))
    C = W @ X
    sizes = np.sqrt(np.abs(np.diag(C)))
    coupled = np.abs(C) > _UNCOUPLED * np.outer(sizes, sizes)
    rough = [i for i, x in enumerate(impacts) for _ in x.lines]
    for row, i in enumerate(rough, len(impacts)):
        coupled[row, i] = True
    _, group = scipy.sparse.csgraph.connected_components(coupled, directed=False)
    return [
        tuple(x for x, own in zip(impacts, group, strict=False) if own == which)
        for which in dict.fromkeys(group[: len(impacts)].tolist())
    ]


def _factored(
    system: MechanicalSystem, state: tuple[complex, Array, Array]
) -> tuple[PhaseSystem, Factorization]:
    """Return the system from a state on, and the factors of [M Phi_q^T; Phi_q 0] there."""
    t, q, v = state
    # The time may have an imaginary part, which constraints of a phase that begins here accept.
    local = PhaseSystem(system, PhaseStart.held(t, q, v, system.n_b), 1.0, first=False)
    matrices = saddle_point(system, float(np.real(t)), q.real)
    return local, matrices.factor(system.mass(q), local.constraint_q(0.0, q))


def _independent(
    system: MechanicalSystem,
    factors: Factorization,
    impacts: Sequence[Impact],
    t: complex,
    q: Array,
) -> tuple[Impact, ...]:
    """Return the impacts, in their order, without gaps whose rates follow from earlier ones.

    Two gaps of one pair of points close together, and one impulse opens both. Raises
    InvalidInputError if no motion that the joints allow changes a gap.
    """
    chosen: list[Impact] = []
    for impact in impacts:
        G, _ = contact_rows(system, [*chosen, impact], t, q, smooth=True)
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
