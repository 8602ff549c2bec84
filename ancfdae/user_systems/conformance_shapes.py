"""Names, weights, shape and kind of every array of a system, and whether complex numbers pass."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.protocol.system import MechanicalSystem

Add: TypeAlias = Callable[[str, float, float], None]

_STEP = 1e-40
# What the protocol derives by a complex step of each value, unless it is overridden.
_BY_STEPS = {
    "start": ("start_b",),
    "mass": ("mass_b_times",),
    "inertia_q": ("inertia_rate_total",),
    "force": ("force_q", "force_v", "force_b", "force_total"),
    "force_rate": ("force_rate_total",),
    "force_q_times": ("force_q_times_q", "force_q_times_total"),
    "constraint": ("constraint_b",),
    "constraint_q": (
        "constraint_force_q",
        "constraint_force_b",
        "constraint_q_times_total",
        "constraint_q_second_rate",
    ),
    "constraint_q_rate": ("constraint_force_rate_total",),
    "velocity_side": ("velocity_side_total",),
    "acceleration_side": ("acceleration_side_total", "constraint_q_second_rate"),
    "jerk_side": ("jerk_side_total",),
}


def complex_numbers(add: Add, system: MechanicalSystem) -> None:
    """Find values that refuse complex numbers although other members are complex steps of them."""
    x = np.asarray(system.start()[0]) + 1j * _STEP
    arguments: dict[str, tuple[Any, ...]] = {"start": (), "mass": (x,), "inertia_q": (x, x)}
    arguments |= dict.fromkeys(("constraint", "constraint_q", "velocity_side"), (x, 0.0))
    names = ("force", "force_q_times", "constraint_q_rate", "acceleration_side")
    arguments |= dict.fromkeys(names, (x, x, 0.0))
    arguments |= dict.fromkeys(("force_rate", "jerk_side"), (x, x, x, 0.0))
    for name, derived in _BY_STEPS.items():
        kept = [y for y in derived if getattr(type(system), y) is getattr(MechanicalSystem, y)]
        if not kept or (name == "inertia_q" and system.constant_mass):
            continue

        def call(name: str = name) -> None:
            getattr(system.with_values(system.b + 1j * _STEP), name)(*arguments[name])

        if _refuses(call):
            add(f"{name} accepts complex numbers, as {', '.join(kept)} need", 1.0, 0.0)


def _refuses(call: Callable[[], None]) -> bool:
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            call()
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        return True
    return False


def shapes(add: Add, system: MechanicalSystem) -> None:
    """Check names, weights, and the shape and kind of every array."""
    n_q, n_lam, n_b = system.n_q, system.n_lam, system.n_b
    nnz, constrained = system.pattern.size, system.constraint_pattern.size
    q, v, lam = np.zeros(n_q), np.zeros(n_q), np.zeros(n_lam)
    q = q + system.start()[0]
    q_b, lam_b = np.zeros((n_q, n_b)), np.zeros((n_lam, n_b))
    _expect(add, "b", system.b, (n_b,))
    _expect(add, "weights", system.weights, (n_q,))
    add("weights are positive", float(not np.all(np.asarray(system.weights) > 0)), 0.0)
    add("names of design variables", float(len(system.design_names) != n_b), 0.0)
    add("names of constraints", float(len(system.constraint_names) != n_lam), 0.0)
    add("shape of pattern", float(system.pattern.shape != (n_q, n_q)), 0.0)
    wrong = system.constraint_pattern.shape != (n_lam, n_q)
    add("shape of constraint_pattern", float(wrong), 0.0)
    for name, array in zip(("q", "v"), system.start(), strict=True):
        _expect(add, f"start, {name}", array, (n_q,))
    for name, array in zip(("q_b", "v_b"), system.start_b(), strict=True):
        _expect(add, f"start_b, {name}", array, (n_q, n_b))
    _expect(add, "start_pull_back", system.start_pull_back(q, v), (n_b,))
    _expect(add, "mass", system.mass(q), (nnz,))
    _expect(add, "mass_times", system.mass_times(q, v), (n_q,))
    _expect(add, "mass_times of columns", system.mass_times(q, q_b), (n_q, n_b))
    _expect(add, "mass_b_times", system.mass_b_times(q, v), (n_q, n_b))
    if not system.constant_mass:
        _expect(add, "inertia_q", system.inertia_q(q, v), (nnz,))
        total = system.inertia_rate_total(q, v, v, q_b, q_b, q_b)
        _expect(add, "inertia_rate_total", total, (n_q, n_b))
    _force_shapes(add, system, q, v, q_b)
    t = 0.0
    matrices = {
        "constraint_q": system.constraint_q(q, t),
        "constraint_q_rate": system.constraint_q_rate(q, v, t),
        "constraint_q_second_rate": system.constraint_q_second_rate(q, v, v, t),
    }
    for name, array in matrices.items():
        _expect(add, name, array, (constrained,))
    if not system.linear_constraints:
        _expect(add, "constraint_force_q", system.constraint_force_q(q, lam, t), (nnz,))
    _constraint_shapes(add, system, q, v, lam, q_b, lam_b)


def _force_shapes(add: Add, system: MechanicalSystem, q: Array, v: Array, q_b: Array) -> None:
    n_q, n_b, nnz, t = system.n_q, system.n_b, system.pattern.size, 0.0
    _expect(add, "force", system.force(q, v, t), (n_q,))
    _expect(add, "force_q", system.force_q(q, v, t), (nnz,))
    _expect(add, "following_load", system.following_load(q, t), (n_q,))
    _expect(add, "following_load_q", system.following_load_q(q, t), (nnz,))
    if system.velocity_forces:
        _expect(add, "force_v", system.force_v(q, v, t), (nnz,))
    _expect(add, "force_b", system.force_b(q, v, t), (n_q, n_b))
    _expect(add, "force_total", system.force_total(q, v, t, q_b, q_b), (n_q, n_b))
    _expect(add, "force_rate", system.force_rate(q, v, v, t), (n_q,))
    total = system.force_rate_total(q, v, v, t, q_b, q_b, q_b)
    _expect(add, "force_rate_total", total, (n_q, n_b))
    _expect(add, "force_q_times", system.force_q_times(q, v, t), (n_q,))
    _expect(add, "force_q_times_total", system.force_q_times_total(q, v, t, q_b), (n_q, n_b))
    _expect(add, "force_q_times_q", system.force_q_times_q(q, v, t), (nnz,))
    pulled = system.pull_back_force_q_times(q, v, t, v)
    _expect(add, "pull_back_force_q_times", pulled, (n_b,))


def _constraint_shapes(
    add: Add, system: MechanicalSystem, q: Array, v: Array, lam: Array, q_b: Array, lam_b: Array
) -> None:
    n_q, n_lam, n_b, t = system.n_q, system.n_lam, system.n_b, 0.0
    vectors = {
        "constraint": system.constraint(q, t),
        "velocity_side": system.velocity_side(q, t),
        "acceleration_side": system.acceleration_side(q, v, t),
        "jerk_side": system.jerk_side(q, v, v, t),
    }
    columns = {
        "constraint_b": system.constraint_b(q, t),
        "constraint_q_times_total": system.constraint_q_times_total(q, v, t, q_b),
        "velocity_side_total": system.velocity_side_total(q, t, q_b),
        "acceleration_side_total": system.acceleration_side_total(q, v, t, q_b, q_b),
        "jerk_side_total": system.jerk_side_total(q, v, v, t, q_b, q_b, q_b),
    }
    reactions = {
        "constraint_force_b": system.constraint_force_b(q, lam, t),
        "constraint_force_rate_total": system.constraint_force_rate_total(
            q, v, lam, t, q_b, q_b, lam_b
        ),
    }
    for name, array in vectors.items():
        _expect(add, name, array, (n_lam,))
    for name, array in columns.items():
        _expect(add, name, array, (n_lam, n_b))
    for name, array in reactions.items():
        _expect(add, name, array, (n_q, n_b))
    _expect(add, "constraint_force", system.constraint_force(q, lam, t), (n_q,))
    rate = system.constraint_force_rate(q, v, lam, t)
    _expect(add, "constraint_force_rate", rate, (n_q,))


def _expect(add: Add, name: str, array: Array, shape: tuple[int, ...]) -> None:
    good = np.shape(array) == shape and np.asarray(array).dtype.kind == "f"
    add(f"shape and kind of {name}", float(not good), 0.0)
