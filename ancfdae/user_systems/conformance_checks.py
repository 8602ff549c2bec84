"""The single comparisons behind `check_system`.

Each takes ``add(name, error, tolerance)`` and a `Probe`. With F' the derivative of F along a
change of all its arguments, each partial is judged by its product with the change.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ancfdae.kernels import norm
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.protocol.motion import Motion
from ancfdae.protocol.system import MechanicalSystem
from ancfdae.user_systems.conformance_members import Add, accepted, call, unasked
from ancfdae.user_systems.probe import Probe, gap

Value: TypeAlias = Callable[[MechanicalSystem, Motion], Array]

# Sums in another order; extrapolated differences, whose own error is up to 1e-8 where values
# carry the round-off of terms much larger than they are.
_SAME, _DIFFERENCES = 1e-10, 1e-6
# As in ancfdae.integrators.start: the violation that a declared start may have.
_CONSISTENT = 1e-8


def start(add: Add, p: Probe) -> None:
    """Check the start against the constraints, and its partials."""
    s = p.system
    q, v = s.start()
    if not s.project_start:
        values, pattern = s.constraint_q(q, 0.0), s.constraint_pattern
        rows = np.bincount(pattern.rows, values**2 / s.weights[pattern.columns], s.n_lam)
        lengths = np.sqrt(np.where(rows > 0, rows, 1.0))
        defect = pattern.dot(values, v) - s.velocity_side(q, 0.0)
        for what, phi, x in (("q", s.constraint(q, 0.0), q), ("v", defect, v)):
            # A velocity that vanishes leaves nothing to compare with but the time of motion.
            size = norm(x, s.weights) or 1e-3 * norm(q, s.weights) / p.time or 1.0
            ratio = np.max(np.abs(phi) / lengths, initial=0.0) / size
            add(f"start, {what} on the constraints", ratio, _CONSISTENT)
    for k, name in enumerate("qv"):
        found = p.by_design(lambda x, m, k=k: x.start()[k], False)  # type: ignore[misc]
        claimed = s.start_b()[k] * p.b_sizes
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
    if s.constant_constraints:
        other, q, t = s.with_values(s.b * 1.01 + 1e-3 * (s.b == 0)), m.q + d.q, m.t + p.time
        B = s.constraint_q(m.q, m.t)
        add("constant_constraints, Phi_q", gap(other.constraint_q(q, t), B, 0.0), _SAME)
        Phi = s.constraint(m.q, m.t) + s.constraint_pattern.dot(B, d.q)
        size = np.max(np.abs(s.constraint_pattern.dot(np.abs(B), np.abs(m.q))), initial=0.0)
        add("constant_constraints", gap(other.constraint(q, t), Phi, size), _SAME)
    if not s.velocity_forces:
        Q = s.force(m.q, m.v, m.t)
        add("velocity_forces", gap(s.force(m.q, m.v + d.v, m.t), Q, 0.0), _SAME)
    if s.symmetric:
        matrices = [s.force_q(m.q, m.v, m.t)]
        if s.velocity_forces:
            matrices.append(s.force_v(m.q, m.v, m.t))
        if not s.linear_constraints:
            matrices.append(s.constraint_force_q(m.q, m.lam, m.t))
        if not s.constant_mass:
            matrices.append(s.inertia_q(m.q, m.a))
        error = max(gap(K, K.T, 0.0) for K in map(s.pattern.dense, matrices))
        add("symmetric", error, _SAME)


def products(add: Add, p: Probe) -> None:
    """Check the mass matrix, and products against the matrices they stand for."""
    s, m, d = p.system, p.m, p.d
    M, dot_t = s.pattern.dense(s.mass(m.q)), s.constraint_pattern.dot_transposed
    add("mass: symmetric", gap(M, M.T, 0.0), _SAME)
    add("mass: not negative", float(d.v @ M @ d.v < 0), 0.0)
    both = np.stack([m.a, d.a], axis=1)
    add("mass_times: M x", gap(s.mass_times(m.q, m.a), M @ m.a, 0.0), _SAME)
    add("mass_times: M x, columns", gap(s.mass_times(m.q, both), M @ both, 0.0), _SAME)
    rows = [np.concatenate([x[None], p.arguments[y].T]) for x, y in ((m.q, "q_b"), (m.v, "v_b"))]
    expected = np.concatenate(
        [call(s, "force", p.arguments)[None], call(s, "force_total", p.arguments).T]
    )
    error = gap(s.force_and_total(rows[0], rows[1], m.t), expected, 0.0)
    add("force_and_total: force, force_total", error, _SAME)
    reaction = s.constraint_force(m.q, m.lam, m.t)
    expected = dot_t(s.constraint_q(m.q, m.t), m.lam)
    add("constraint_force: Phi_q^T lam", gap(reaction, expected, 0.0), _SAME)
    expected = dot_t(s.constraint_q_rate(m.q, m.v, m.t), m.lam)
    error = gap(s.constraint_force_rate(m.q, m.v, m.lam, m.t), expected, reaction / p.time)
    add("constraint_force_rate: (dPhi_q/dt)^T lam", error, _SAME)


def partials(add: Add, p: Probe) -> None:
    """Check the partials in q and v."""
    known = _values(p)
    for name, value, part in (
        ("inertia_q", "mass_times", "q"),
        ("force_q", "force", "q"),
        ("force_v", "force", "v"),
        ("following_load_q", "following_load", "q"),
        ("constraint_q", "constraint", "q"),
        ("constraint_force_q", "constraint_force", "q"),
    ):
        if name in unasked(p.system):
            continue
        of, size = known[value]
        pattern = p.system.constraint_pattern if name == "constraint_q" else p.system.pattern
        change = p.d.q if part == "q" else p.d.v
        claimed = pattern.dot(call(p.system, name, p.arguments), change)
        found = p.along(lambda m, of=of: of(p.system, m), part)  # type: ignore[misc]
        add(f"{name}: differences of {value}", gap(claimed, found, size), _DIFFERENCES)


def design_derivatives(add: Add, p: Probe) -> None:
    """Check the partials in b, and the totals along changes of all arguments."""
    known = _values(p)
    rows = [(f"{value}_b", value, False) for value in ("force", "constraint", "constraint_force")]
    rows += [("mass_b_times", "mass_times", False), ("inertia_rate_total", "inertia_rate", True)]
    rows += [("constraint_q_times_total", "constraint_q", True)]
    rows += [
        (f"{value}_total", value, True)
        for value in (
            "force",
            "force_rate",
            "constraint_force_rate",
            "velocity_side",
            "acceleration_side",
            "jerk_side",
        )
    ]
    for name, value, moving in rows:
        if name in unasked(p.system):
            continue
        of, size = known[value]
        claimed = call(p.system, name, p.arguments) * p.b_sizes
        error = gap(claimed, p.by_design(of, moving), size)
        add(f"{name}: differences of {value}", error, _DIFFERENCES)


def forces_at_rest(add: Add, p: Probe) -> None:
    """Check Q_q x at v = 0 and its derivatives."""
    s, m, x = p.system, p.m, p.d.q
    rest = np.zeros(s.n_q)
    value, size = s.force_q_times(m.q, x, m.t), np.abs(s.force(m.q, rest, m.t))
    claimed = s.pattern.dot(s.force_q(m.q, rest, m.t), x)
    add("force_q_times: Q_q x", gap(value, claimed, size), _SAME)
    found = p.by_design(lambda system, m: system.force_q_times(m.q, x, p.m.t), True)
    claimed = s.force_q_times_total(m.q, x, m.t, p.arguments["q_b"]) * p.b_sizes
    size = size + np.abs(value)
    add("force_q_times_total: differences", gap(claimed, found, size), _DIFFERENCES)
    found = p.along(lambda state: s.force_q_times(state.q, x, m.t), "q")
    claimed = s.pattern.dot(s.force_q_times_q(m.q, x, m.t), x)
    add("force_q_times_q: differences", gap(claimed, found, size), _DIFFERENCES)
    mu = x * s.weights
    pulled = s.pull_back_force_q_times(m.q, x, m.t, mu) * p.b_sizes
    own = s.force_q_times_total(m.q, x, m.t, np.zeros((s.n_q, s.n_b))) * p.b_sizes
    error = gap(pulled, mu @ own, np.abs(mu) @ np.abs(own))
    add("pull_back_force_q_times: mu^T (Q_q x)_b", error, _SAME)


def time_derivatives(add: Add, p: Probe) -> None:
    """Check rates, and the right sides nu, gamma and S, by differences along motions."""
    s, m, T = p.system, p.m, p.time
    dot, size = s.constraint_pattern.dot, _values(p)["constraint"][1] / T
    Phi_q = s.constraint_q(m.q, m.t)

    def speed(x: Motion) -> Array:
        return np.asarray(dot(s.constraint_q(x.q, x.t), x.v) - s.velocity_side(x.q, x.t))

    def acceleration(x: Motion) -> Array:
        gamma = s.acceleration_side(x.q, x.v, x.t)
        return np.asarray(dot(s.constraint_q(x.q, x.t), m.a) - gamma)

    checks: list[tuple[str, str, Callable[[Motion], Array], Array | float, Array]] = [
        ("force_rate", "Q", lambda x: s.force(x.q, x.v, x.t), 0.0, s.force(m.q, m.v, m.t) / T),
        ("constraint_q_rate", "Phi_q", lambda x: s.constraint_q(x.q, x.t), 0.0, Phi_q / T),
        (
            "constraint_q_second_rate",
            "the rate",
            lambda x: s.constraint_q_rate(x.q, x.v, x.t),
            0.0,
            Phi_q / T**2,
        ),
        ("velocity_side", "Phi", lambda x: s.constraint(x.q, x.t), dot(Phi_q, m.v), size),
        ("acceleration_side", "Phi_q v - nu", speed, dot(Phi_q, m.a), size / T),
        ("jerk_side", "gamma - Phi_q a", acceleration, 0.0, size / T**2),
    ]
    for name, of, value, whole, scale in checks:
        claimed, found = call(s, name, p.arguments), p.in_time(value)
        # A side is what the highest derivative leaves of a rate.
        found = whole - found if name.endswith("side") else found
        add(f"{name}: differences of {of}", gap(claimed, found, scale), _DIFFERENCES)


def bulk(add: Add, p: Probe) -> None:
    """Check what handles many instants at once against the single methods."""
    s = p.system
    states = [p.m.plus(0.1 * k, p.d) for k in range(3)]
    q, v, a, lam, t = (np.array(x) for x in zip(*states, strict=True))

    def each(name: str) -> Array:
        return np.array([call(s, name, m._asdict()) for m in states])

    local, partials = s.linearise(t, q, v, a, lam), s.design_partials(t, q, v, a, lam)
    f_q = -each("force_q")
    for name in {"constraint_force_q", "inertia_q"} - unasked(s):
        f_q = f_q + each(name)
    f_b = each("mass_b_times") + each("constraint_force_b") - each("force_b")
    f_b, Phi_b = f_b * p.b_sizes, each("constraint_b") * p.b_sizes
    rows = [
        ("linearise: M", local.M, each("mass")[: len(local.M)]),
        ("linearise: f_q", local.f_q, f_q),
        ("linearise: Phi_q", local.Phi_q, each("constraint_q")),
        ("design_partials: f_b", partials.f_b * p.b_sizes, f_b),
        ("design_partials: Phi_b", partials.Phi_b * p.b_sizes, Phi_b),
    ]
    if s.velocity_forces and local.f_v is not None:
        rows.append(("linearise: f_v", local.f_v, -each("force_v")))
    for name, claimed, expected in rows:
        same = claimed.shape == expected.shape
        add(name, gap(claimed, expected, 0.0) if same else np.inf, _SAME)
    add("linearise: f_v is there", float((local.f_v is None) == s.velocity_forces), 0.0)
    # Covectors that bring both terms to one size.
    mu = np.cos(np.arange(q.size)).reshape(q.shape) / (np.max(np.abs(f_b), initial=0.0) or 1.0)
    zeta = np.sin(1.0 + np.arange(lam.size)).reshape(lam.shape)
    zeta = zeta / (np.max(np.abs(Phi_b), initial=0.0) or 1.0)
    expected = np.einsum("knb,kn->b", f_b, mu) + np.einsum("knb,kn->b", Phi_b, zeta)
    pulled = s.pull_back(t, (q, v, a, lam), (mu, zeta)) * p.b_sizes
    add("pull_back: f_b^T mu + Phi_b^T zeta", gap(pulled, expected, 1.0), _SAME)


def complex_steps(add: Add, p: Probe) -> None:
    """Compare complex steps of values, along all changes at once, with sums of differences.

    A value that refuses complex numbers passes: the system is integrated in real ones.
    """
    db, still = np.cos(0.3 + np.arange(p.system.n_b)), p.d._replace(t=0.0)
    for name, (value, size) in _values(p).items():
        if name in unasked(p.system):
            continue

        def moved(e: complex, value: Value = value) -> Array:
            return np.asarray(value(p.at(e * db), p.m.plus(e, still)))

        claimed = accepted(lambda moved=moved: np.imag(moved(1j * STEP)) / STEP)  # type: ignore[misc]
        if claimed is not None:
            error = gap(claimed, p.differences(moved), size)
            add(f"complex step of {name}: differences", error, _DIFFERENCES)


def _values(p: Probe) -> dict[str, tuple[Value, Array]]:
    """Return the values that others differentiate, and the size of their terms.

    The values themselves may vanish.
    """
    s, m, x, t, T = p.system, p.m, p.d.q, p.m.t, p.time
    M_a, Q = s.mass_times(m.q, m.a), s.force(m.q, m.v, t)
    reaction = s.constraint_force(m.q, m.lam, t)
    turned = s.constraint_pattern.dot(s.constraint_q(m.q, t), x)
    Phi = np.abs(s.constraint(m.q, t)) + np.abs(turned)
    members: dict[str, tuple[Value, Array]] = {
        "start": (lambda s, m: np.concatenate(s.start()), np.zeros(1)),
        "mass": (lambda s, m: s.mass(m.q), s.mass(m.q)),
        "mass_times": (lambda s, m: s.mass_times(m.q, p.m.a), M_a),
        "force": (lambda s, m: s.force(m.q, m.v, t), Q),
        "following_load": (lambda s, m: s.following_load(m.q, t), Q),
        "force_rate": (lambda s, m: s.force_rate(m.q, m.v, m.a, t), Q / T),
        "force_q_times": (lambda s, m: s.force_q_times(m.q, x, t), Q),
        "constraint": (lambda s, m: s.constraint(m.q, t), Phi),
        # Patterns may depend on b: a joint's axis that turns out of a plane fills entries.
        "constraint_q": (lambda s, m: s.constraint_pattern.dot(s.constraint_q(m.q, t), x), turned),
        "constraint_force": (lambda s, m: s.constraint_force(m.q, p.m.lam, t), reaction),
        "constraint_force_rate": (
            lambda s, m: s.constraint_force_rate(m.q, m.v, m.lam, t),
            reaction / T,
        ),
        "velocity_side": (lambda s, m: s.velocity_side(m.q, t), Phi / T),
        "acceleration_side": (lambda s, m: s.acceleration_side(m.q, m.v, t), Phi / T**2),
        "jerk_side": (lambda s, m: s.jerk_side(m.q, m.v, m.a, t), Phi / T**3),
    }
    if not s.constant_mass:
        rate: Value = lambda s, m: s.pattern.dot(s.inertia_q(m.q, m.a), m.v)  # noqa: E731
        members["inertia_rate"] = rate, M_a / T
    return members


# Every check, in the order of the report.
CHECKS: tuple[Callable[[Add, Probe], None], ...] = (
    start,
    values,
    declarations,
    products,
    partials,
    design_derivatives,
    forces_at_rest,
    time_derivatives,
    bulk,
    complex_steps,
)
