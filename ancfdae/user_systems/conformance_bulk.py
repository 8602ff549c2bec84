"""Comparisons of members that handle many instants, and of complex steps."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.protocol.motion import Motion
from ancfdae.protocol.system import MechanicalSystem
from ancfdae.user_systems.probe import Probe, gap

Add: TypeAlias = Callable[[str, float, float], None]
Value: TypeAlias = Callable[[MechanicalSystem, Motion], Array]

_SAME, _DIFFERENCES = 1e-10, 1e-6
_STEP = 1e-40
_REFUSED = (TypeError, ValueError, np.exceptions.ComplexWarning)


def linearise(add: Add, p: Probe) -> None:
    """Check `linearise` against the single methods."""
    s, (t, q, v, a, lam) = p.system, _instants(p)
    local = s.linearise(t, q, v, a, lam)
    rows = range(len(t))
    M = np.array([s.mass(q[k]) for k in (rows if len(local.M) > 1 else range(1))])
    add("linearise: M", _rows_gap(local.M, M), _SAME)
    f_q = -np.array([s.force_q(q[k], v[k], t[k]) for k in rows])
    if not s.linear_constraints:
        f_q = f_q + np.array([s.constraint_force_q(q[k], lam[k], t[k]) for k in rows])
    if not s.constant_mass:
        f_q = f_q + np.array([s.inertia_q(q[k], a[k]) for k in rows])
    add("linearise: f_q", _rows_gap(local.f_q, f_q), _SAME)
    if s.velocity_forces and local.f_v is not None:
        f_v = -np.array([s.force_v(q[k], v[k], t[k]) for k in rows])
        add("linearise: f_v", _rows_gap(local.f_v, f_v), _SAME)
    add("linearise: f_v is there", float((local.f_v is None) == s.velocity_forces), 0.0)
    Phi_q = np.array([s.constraint_q(q[k], t[k]) for k in rows])
    add("linearise: Phi_q", _rows_gap(local.Phi_q, Phi_q), _SAME)


def design_partials(add: Add, p: Probe) -> None:
    """Check `design_partials` and `pull_back` against the single methods."""
    s, (t, q, v, a, lam) = p.system, _instants(p)
    partials = s.design_partials(t, q, v, a, lam)
    f_b, Phi_b = [], []
    for k in range(len(t)):
        reaction_b = s.constraint_force_b(q[k], lam[k], t[k])
        f_b.append(s.mass_b_times(q[k], a[k]) + reaction_b - s.force_b(q[k], v[k], t[k]))
        Phi_b.append(s.constraint_b(q[k], t[k]))
    f, Phi = np.array(f_b) * p.b_sizes, np.array(Phi_b) * p.b_sizes
    add("design_partials: f_b", _rows_gap(partials.f_b * p.b_sizes, f), _SAME)
    add("design_partials: Phi_b", _rows_gap(partials.Phi_b * p.b_sizes, Phi), _SAME)
    # Covectors that bring both terms to one size.
    mu = np.cos(np.arange(q.size)).reshape(q.shape) / (np.max(np.abs(f), initial=0.0) or 1.0)
    zeta = np.sin(1.0 + np.arange(lam.size)).reshape(lam.shape)
    zeta = zeta / (np.max(np.abs(Phi), initial=0.0) or 1.0)
    expected = np.einsum("knb,kn->b", f, mu) + np.einsum("knb,kn->b", Phi, zeta)
    pulled = s.pull_back(t, (q, v, a, lam), (mu, zeta)) * p.b_sizes
    add("pull_back: f_b^T mu + Phi_b^T zeta", gap(pulled, expected, 1.0), _SAME)


def complex_steps(add: Add, p: Probe) -> None:
    """Check the complex steps of all values that a complex-step run asks for.

    A system that refuses complex numbers passes: it is integrated in real ones.
    """
    s, m, T = p.system, p.m, p.time
    t = m.t
    # Of the size of the terms, where the values themselves may vanish.
    Q, Phi = s.force(m.q, m.v, t), s.constraint_pattern.dot(s.constraint_q(m.q, t), p.d.q)
    members: list[tuple[str, Value, Array]] = [
        ("start", lambda x, m: np.concatenate(x.start()), np.zeros(1)),
        ("mass", lambda x, m: x.mass(m.q), np.zeros(1)),
        ("mass_times", lambda x, m: x.mass_times(m.q, m.a), np.zeros(1)),
        ("force", lambda x, m: x.force(m.q, m.v, t), np.zeros(1)),
        ("force_rate", lambda x, m: x.force_rate(m.q, m.v, m.a, t), Q / T),
        ("force_q_times", lambda x, m: x.force_q_times(m.q, p.d.q, t), Q),
        ("constraint", lambda x, m: x.constraint(m.q, t), Phi),
        (
            "constraint_q",
            # Its pattern may depend on b.
            lambda x, m: x.constraint_pattern.dot(x.constraint_q(m.q, t), p.d.q),
            np.zeros(1),
        ),
        ("constraint_force", lambda x, m: x.constraint_force(m.q, m.lam, t), Q),
        (
            "constraint_force_rate",
            lambda x, m: x.constraint_force_rate(m.q, m.v, m.lam, t),
            s.constraint_force(m.q, m.lam, t) / T,
        ),
        ("velocity_side", lambda x, m: x.velocity_side(m.q, t), Phi / T),
        ("acceleration_side", lambda x, m: x.acceleration_side(m.q, m.v, t), Phi / T**2),
        ("jerk_side", lambda x, m: x.jerk_side(m.q, m.v, m.a, t), Phi / T**3),
    ]
    if not s.constant_mass:

        def inertia(x: MechanicalSystem, m: Motion) -> Array:
            return np.asarray(x.pattern.dot(x.inertia_q(m.q, m.a), p.d.q))

        members.append(("inertia_q", inertia, s.mass_times(m.q, m.a)))
    for name, value, size in members:
        _complex_step(add, p, name, value, size)


def _complex_step(add: Add, p: Probe, name: str, value: Value, size: Array) -> None:
    """Compare the complex step along all changes at once with the sum of the differences."""
    db = np.cos(0.3 + np.arange(p.system.n_b))
    # The protocol's time is real.
    d = replace(p.d, t=0.0)

    def moved(e: complex) -> Array:
        return np.asarray(value(p.at(e * db), p.m.plus(e, d)))

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            claimed = np.imag(moved(1j * _STEP)) / _STEP
    except _REFUSED:
        return
    scale = max(float(np.max(np.abs(x), initial=0.0)) for x in (moved(0.0), size))
    error = gap(claimed, p.differences(moved), scale)
    add(f"complex step of {name}: differences", error, _DIFFERENCES)


def _instants(p: Probe) -> tuple[Array, Array, Array, Array, Array]:
    """States of three instants as rows, and their times."""
    states = [p.m.plus(0.1 * k, p.d) for k in range(3)]
    columns = [np.array([getattr(m, x) for m in states]) for x in ("t", "q", "v", "a", "lam")]
    return columns[0], columns[1], columns[2], columns[3], columns[4]


def _rows_gap(claimed: Array, expected: Array) -> float:
    return gap(claimed, expected, 0.0) if claimed.shape == expected.shape else np.inf


BULK_CHECKS: tuple[Callable[[Add, Probe], None], ...] = (
    linearise,
    design_partials,
    complex_steps,
)
