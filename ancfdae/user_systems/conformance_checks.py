"""The single comparisons behind `check_system`.

Each takes ``add(name, error, tolerance)`` and a `Probe`. With F' the derivative of F along a
change of all its arguments, each partial is judged by its product with the change.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.protocol.motion import Motion
from ancfdae.protocol.system import MechanicalSystem
from ancfdae.user_systems.probe import Probe, gap

Add: TypeAlias = Callable[[str, float, float], None]
Value: TypeAlias = Callable[[MechanicalSystem, Motion], Array]

# Sums in another order; extrapolated differences, whose own error is up to 1e-8 where values
# carry the round-off of terms much larger than they are.
_SAME, _DIFFERENCES = 1e-10, 1e-6
# As in ancfdae.integrators.start: the violation that a declared start may have.
_CONSISTENT = 1e-8


def start(add: Add, p: Probe) -> None:
    """Check the start against the constraints, and its partials."""
    system, s = p.system, p.system
    q, v = s.start()
    if not s.project_start:
        values, pattern = s.constraint_q(q, 0.0), s.constraint_pattern
        rows = np.bincount(pattern.rows, values**2 / s.weights[pattern.columns], s.n_lam)
        lengths = np.sqrt(np.where(rows > 0, rows, 1.0))
        defect = pattern.dot(values, v) - s.velocity_side(q, 0.0)
        for what, phi, x in (("q", s.constraint(q, 0.0), q), ("v", defect, v)):
            # A velocity that vanishes leaves nothing to compare with but the time of motion.
            size = np.sqrt(s.weights @ x**2) or 1e-3 * np.sqrt(s.weights @ q**2) / p.time
            ratio = np.max(np.abs(phi) / lengths, initial=0.0) / (size or 1.0)
            add(f"start, {what} on the constraints", ratio, _CONSISTENT)
    for name, k in (("q", 0), ("v", 1)):
        found = p.by_design(lambda x, m, k=k: x.start()[k], False)  # type: ignore[misc]
        claimed = system.start_b()[k] * p.b_sizes
        add(f"start_b, {name}: differences of start", gap(claimed, found, (q, v)[k]), _DIFFERENCES)
    on_q, on_v = p.d.q * s.weights, p.d.v * s.weights
    q_b, v_b = (x * p.b_sizes for x in s.start_b())
    pulled = s.start_pull_back(on_q, on_v) * p.b_sizes
    size = np.abs(on_q) @ np.abs(q_b) + np.abs(on_v) @ np.abs(v_b)
    error = gap(pulled, on_q @ q_b + on_v @ v_b, size)
    add("start_pull_back: q_b^T x + v_b^T y", error, _SAME)


def values(add: Add, p: Probe) -> None:
    """Check that `with_values` takes other design values and leaves the system unchanged."""

    def all_of(x: MechanicalSystem) -> Array:
        m = p.m
        parts = [*x.start(), x.mass(m.q), x.force(m.q, m.v, m.t), x.constraint(m.q, m.t)]
        return np.concatenate(parts)

    system, before = p.system, all_of(p.system)
    b = system.b.copy()
    other = system.with_values(b * 1.01 + 1e-3 * (b == 0))
    add("with_values, there and back", gap(all_of(other.with_values(b)), before, 0.0), _SAME)
    add("with_values leaves the system alone", gap(all_of(system), before, 0.0), 0.0)
    add("with_values sets b", float(not np.array_equal(system.with_values(b).b, b)), 0.0)


def declarations(add: Add, p: Probe) -> None:
    """Check what is declared constant, linear or independent."""
    s, m, d = p.system, p.m, p.d
    if s.constant_mass:
        add("constant_mass", gap(s.mass(m.q + d.q), s.mass(m.q), 0.0), _SAME)
    if s.linear_constraints:
        bent = s.constraint_q(m.q + d.q, m.t)
        add("linear_constraints", gap(bent, s.constraint_q(m.q, m.t), 0.0), _SAME)
    if not s.velocity_forces:
        Q = s.force(m.q, m.v, m.t)
        add("velocity_forces", gap(s.force(m.q, m.v + d.v, m.t), Q, 0.0), _SAME)


def inertia(add: Add, p: Probe) -> None:
    """Check everything that is derived from M."""
    s, m, d = p.system, p.m, p.d
    M = s.pattern.dense(s.mass(m.q))
    add("mass: symmetric", gap(M, M.T, 0.0), _SAME)
    add("mass: not negative", float(d.v @ M @ d.v < 0), 0.0)
    both = np.stack([m.a, d.a], axis=1)
    add("mass_times: M x", gap(s.mass_times(m.q, m.a), M @ m.a, 0.0), _SAME)
    add("mass_times: M x, columns", gap(s.mass_times(m.q, both), M @ both, 0.0), _SAME)
    value = s.mass_times(m.q, m.a)
    found = p.by_design(lambda x, m: x.mass_times(m.q, m.a), False)
    claimed = s.mass_b_times(m.q, m.a) * p.b_sizes
    add("mass_b_times: differences of M a", gap(claimed, found, value), _DIFFERENCES)
    if s.constant_mass:
        return
    found = p.along(lambda x: s.mass_times(x.q, m.a))
    claimed = s.pattern.dot(s.inertia_q(m.q, m.a), d.q)
    add("inertia_q: differences of M a", gap(claimed, found, value), _DIFFERENCES)
    rate = s.pattern.dot(s.inertia_q(m.q, m.a), m.v)
    found = p.by_design(lambda x, m: x.pattern.dot(x.inertia_q(m.q, m.a), m.v), True)
    claimed = s.inertia_rate_total(m.q, m.v, m.a, p.columns("q"), p.columns("v"), p.columns("a"))
    error = gap(claimed * p.b_sizes, found, np.abs(rate) + np.abs(value) / p.time)
    add("inertia_rate_total: differences of (M a)_q v", error, _DIFFERENCES)


def forces(add: Add, p: Probe) -> None:
    """Check everything that is derived from Q."""
    s, m, d = p.system, p.m, p.d
    value = s.force(m.q, m.v, m.t)
    found = p.along(lambda x: s.force(x.q, m.v, m.t))
    claimed = s.pattern.dot(s.force_q(m.q, m.v, m.t), d.q)
    add("force_q: differences of Q", gap(claimed, found, value), _DIFFERENCES)
    found = p.along(lambda x: s.following_load(x.q, m.t))
    claimed = s.pattern.dot(s.following_load_q(m.q, m.t), d.q)
    error = gap(claimed, found, value)
    add("following_load_q: differences of following_load", error, _DIFFERENCES)
    if s.velocity_forces:
        found = p.along(lambda x: s.force(m.q, x.v, m.t))
        claimed = s.pattern.dot(s.force_v(m.q, m.v, m.t), d.v)
        add("force_v: differences of Q", gap(claimed, found, value), _DIFFERENCES)
    found = p.by_design(lambda x, m: x.force(m.q, m.v, m.t), False)
    claimed = s.force_b(m.q, m.v, m.t) * p.b_sizes
    add("force_b: differences of Q", gap(claimed, found, value), _DIFFERENCES)
    found = p.by_design(lambda x, m: x.force(m.q, m.v, p.m.t), True)
    claimed = s.force_total(m.q, m.v, m.t, p.columns("q"), p.columns("v")) * p.b_sizes
    add("force_total: differences of Q", gap(claimed, found, value), _DIFFERENCES)
    rate = s.force_rate(m.q, m.v, m.a, m.t)
    found = p.in_time(lambda x: s.force(x.q, x.v, x.t))
    error = gap(rate, found, value / p.time)
    add("force_rate: differences of Q along a motion", error, _DIFFERENCES)
    found = p.by_design(lambda x, m: x.force_rate(m.q, m.v, m.a, m.t), True)
    columns = p.columns("q"), p.columns("v"), p.columns("a")
    claimed = s.force_rate_total(m.q, m.v, m.a, m.t, *columns) * p.b_sizes
    error = gap(claimed, found, np.abs(rate) + np.abs(value) / p.time)
    add("force_rate_total: differences of force_rate", error, _DIFFERENCES)


def forces_at_rest(add: Add, p: Probe) -> None:
    """Check Q_q x at v = 0 and its derivatives."""
    s, m, x = p.system, p.m, p.d.q
    rest = np.zeros(s.n_q)
    value, size = s.force_q_times(m.q, x, m.t), np.abs(s.force(m.q, rest, m.t))
    claimed = s.pattern.dot(s.force_q(m.q, rest, m.t), x)
    add("force_q_times: Q_q x", gap(value, claimed, size), _SAME)
    found = p.by_design(lambda system, m: system.force_q_times(m.q, x, p.m.t), True)
    claimed = s.force_q_times_total(m.q, x, m.t, p.columns("q")) * p.b_sizes
    size = size + np.abs(value)
    add("force_q_times_total: differences", gap(claimed, found, size), _DIFFERENCES)
    found = p.along(lambda state: s.force_q_times(state.q, x, m.t))
    claimed = s.pattern.dot(s.force_q_times_q(m.q, x, m.t), x)
    add("force_q_times_q: differences", gap(claimed, found, size), _DIFFERENCES)
    mu = x * s.weights
    pulled = s.pull_back_force_q_times(m.q, x, m.t, mu) * p.b_sizes
    own = s.force_q_times_total(m.q, x, m.t, np.zeros((s.n_q, s.n_b))) * p.b_sizes
    error = gap(pulled, mu @ own, np.abs(mu) @ np.abs(own))
    add("pull_back_force_q_times: mu^T (Q_q x)_b", error, _SAME)


def constraints(add: Add, p: Probe) -> None:
    """Check everything that is derived from Phi, but the sides."""
    s, m, d = p.system, p.m, p.d
    dot, dot_t = s.constraint_pattern.dot, s.constraint_pattern.dot_transposed
    value, Phi_q = s.constraint(m.q, m.t), s.constraint_q(m.q, m.t)
    size = np.abs(value) + np.abs(dot(Phi_q, d.q))
    found = p.along(lambda x: s.constraint(x.q, m.t))
    add("constraint_q: differences of Phi", gap(dot(Phi_q, d.q), found, size), _DIFFERENCES)
    found = p.by_design(lambda x, m: x.constraint(m.q, m.t), False)
    error = gap(s.constraint_b(m.q, m.t) * p.b_sizes, found, size)
    add("constraint_b: differences of Phi", error, _DIFFERENCES)
    reaction = s.constraint_force(m.q, m.lam, m.t)
    add("constraint_force: Phi_q^T lam", gap(reaction, dot_t(Phi_q, m.lam), 0.0), _SAME)
    if not s.linear_constraints:
        found = p.along(lambda x: s.constraint_force(x.q, m.lam, m.t))
        claimed = s.pattern.dot(s.constraint_force_q(m.q, m.lam, m.t), d.q)
        error = gap(claimed, found, reaction)
        add("constraint_force_q: differences of Phi_q^T lam", error, _DIFFERENCES)
    found = p.by_design(lambda x, m: x.constraint_force(m.q, m.lam, m.t), False)
    claimed = s.constraint_force_b(m.q, m.lam, m.t) * p.b_sizes
    error = gap(claimed, found, reaction)
    add("constraint_force_b: differences of Phi_q^T lam", error, _DIFFERENCES)
    # The pattern may depend on b: a joint's axis that turns out of a plane fills entries.
    found = p.by_design(lambda x, m: x.constraint_pattern.dot(x.constraint_q(m.q, m.t), d.q), True)
    claimed = s.constraint_q_times_total(m.q, d.q, m.t, p.columns("q")) * p.b_sizes
    error = gap(claimed, found, dot(Phi_q, d.q))
    add("constraint_q_times_total: differences of Phi_q x", error, _DIFFERENCES)


def constraint_rates(add: Add, p: Probe) -> None:
    """Check the time derivatives of Phi_q."""
    s, m = p.system, p.m
    Phi_q = s.constraint_q(m.q, m.t)
    rate = s.constraint_q_rate(m.q, m.v, m.t)
    found = p.in_time(lambda x: s.constraint_q(x.q, x.t))
    error = gap(rate, found, Phi_q / p.time)
    add("constraint_q_rate: differences of Phi_q along a motion", error, _DIFFERENCES)
    second = s.constraint_q_second_rate(m.q, m.v, m.a, m.t)
    found = p.in_time(lambda x: s.constraint_q_rate(x.q, x.v, x.t))
    error = gap(second, found, Phi_q / p.time**2)
    add("constraint_q_second_rate: differences of the rate", error, _DIFFERENCES)
    value = s.constraint_force_rate(m.q, m.v, m.lam, m.t)
    expected = s.constraint_pattern.dot_transposed(rate, m.lam)
    reaction = s.constraint_force(m.q, m.lam, m.t)
    error = gap(value, expected, reaction / p.time)
    add("constraint_force_rate: (dPhi_q/dt)^T lam", error, _SAME)
    found = p.by_design(lambda x, m: x.constraint_force_rate(m.q, m.v, m.lam, m.t), True)
    columns = p.columns("q"), p.columns("v"), p.columns("lam")
    claimed = s.constraint_force_rate_total(m.q, m.v, m.lam, m.t, *columns) * p.b_sizes
    error = gap(claimed, found, reaction / p.time)
    add("constraint_force_rate_total: differences", error, _DIFFERENCES)


def sides(add: Add, p: Probe) -> None:
    """Check the right sides nu, gamma and S by differences along motions."""
    s, m = p.system, p.m
    dot = s.constraint_pattern.dot
    Phi_q = s.constraint_q(m.q, m.t)
    # Of the size of the terms, also where the constraints do not depend on time.
    size = np.abs(dot(Phi_q, p.d.q)) / p.time
    nu = s.velocity_side(m.q, m.t)
    found = dot(Phi_q, m.v) - p.in_time(lambda x: s.constraint(x.q, x.t))
    add("velocity_side: differences of Phi", gap(nu, found, size), _DIFFERENCES)

    def speed(x: Motion) -> Array:
        return np.asarray(dot(s.constraint_q(x.q, x.t), x.v) - s.velocity_side(x.q, x.t))

    gamma = s.acceleration_side(m.q, m.v, m.t)
    found = dot(Phi_q, m.a) - p.in_time(speed)
    error = gap(gamma, found, size / p.time)
    add("acceleration_side: differences of Phi_q v - nu", error, _DIFFERENCES)

    def acceleration(x: Motion) -> Array:
        gamma = s.acceleration_side(x.q, x.v, x.t)
        return np.asarray(gamma - dot(s.constraint_q(x.q, x.t), m.a))

    S, found = s.jerk_side(m.q, m.v, m.a, m.t), p.in_time(acceleration)
    error = gap(S, found, size / p.time**2)
    add("jerk_side: differences of gamma - Phi_q a", error, _DIFFERENCES)
    q_b, v_b, a_b = p.columns("q"), p.columns("v"), p.columns("a")
    totals: list[tuple[str, Value, Array, Array]] = [
        (
            "velocity_side_total",
            lambda x, m: x.velocity_side(m.q, m.t),
            s.velocity_side_total(m.q, m.t, q_b),
            size,
        ),
        (
            "acceleration_side_total",
            lambda x, m: x.acceleration_side(m.q, m.v, m.t),
            s.acceleration_side_total(m.q, m.v, m.t, q_b, v_b),
            size / p.time,
        ),
        (
            "jerk_side_total",
            lambda x, m: x.jerk_side(m.q, m.v, m.a, m.t),
            s.jerk_side_total(m.q, m.v, m.a, m.t, q_b, v_b, a_b),
            size / p.time**2,
        ),
    ]
    for name, value, claimed, scale in totals:
        error = gap(claimed * p.b_sizes, p.by_design(value, True), scale)
        add(f"{name}: differences", error, _DIFFERENCES)


# Every check, in the order of the report.
CHECKS: tuple[Callable[[Add, Probe], None], ...] = (
    start,
    values,
    declarations,
    inertia,
    forces,
    forces_at_rest,
    constraints,
    constraint_rates,
    sides,
)
