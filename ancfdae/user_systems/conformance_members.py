"""Arguments, shape and kind of the arrays of a system, and whether complex numbers pass."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from ancfdae.numerics.arrays import STEP, Array
from ancfdae.protocol.system import MechanicalSystem

Add: TypeAlias = Callable[[str, float, float], None]

# Arguments and shape of every array: q, l and b stand for n_q, n_lam and n_b, K and B for the sizes
# of the patterns.
MEMBERS = {
    "mass": ("q", "K"),
    "mass_times": ("q a", "q"),
    "mass_b_times": ("q a", "qb"),
    "inertia_q": ("q a", "K"),
    "inertia_rate_total": ("q v a q_b v_b a_b", "qb"),
    "force": ("q v t", "q"),
    "force_q": ("q v t", "K"),
    "force_v": ("q v t", "K"),
    "following_load": ("q t", "q"),
    "following_load_q": ("q t", "K"),
    "force_b": ("q v t", "qb"),
    "force_total": ("q v t q_b v_b", "qb"),
    "force_rate": ("q v a t", "q"),
    "force_rate_total": ("q v a t q_b v_b a_b", "qb"),
    "force_q_times": ("q x t", "q"),
    "force_q_times_total": ("q x t q_b", "qb"),
    "force_q_times_q": ("q x t", "K"),
    "pull_back_force_q_times": ("q x t mu", "b"),
    "constraint": ("q t", "l"),
    "constraint_q": ("q t", "B"),
    "constraint_b": ("q t", "lb"),
    "constraint_force": ("q lam t", "q"),
    "constraint_force_q": ("q lam t", "K"),
    "constraint_force_b": ("q lam t", "qb"),
    "constraint_q_times_total": ("q x t q_b", "lb"),
    "constraint_q_rate": ("q v t", "B"),
    "constraint_q_second_rate": ("q v a t", "B"),
    "velocity_side": ("q t", "l"),
    "velocity_side_total": ("q t q_b", "lb"),
    "acceleration_side": ("q v t", "l"),
    "acceleration_side_total": ("q v t q_b v_b", "lb"),
    "jerk_side": ("q v a t", "l"),
    "jerk_side_total": ("q v a t q_b v_b a_b", "lb"),
    "constraint_force_rate": ("q v lam t", "q"),
    "constraint_force_rate_total": ("q v lam t q_b v_b lam_b", "qb"),
}
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


def unasked(system: MechanicalSystem) -> set[str]:
    """Return the members that nobody asks for, by what the system declares."""
    names = {"inertia_q", "inertia_rate_total"} if system.traits.constant_mass else set()
    names |= {"constraint_force_q"} if system.traits.linear_constraints else set()
    return names if system.traits.velocity_forces else names | {"force_v"}


def call(system: MechanicalSystem, name: str, given: dict[str, Any]) -> Array:
    """Evaluate a member at given arguments."""
    value: Array = getattr(system, name)(*(given[x] for x in MEMBERS[name][0].split()))
    return value


def complex_numbers(add: Add, system: MechanicalSystem) -> None:
    """Find values that refuse complex numbers although other members are complex steps of them."""
    x = np.asarray(system.start()[0]) + 1j * STEP
    given = {"q": x, "v": x, "a": x, "x": x, "t": 0.0}
    for name, derived in _BY_STEPS.items():
        kept = [y for y in derived if getattr(type(system), y) is getattr(MechanicalSystem, y)]
        if not kept or name in unasked(system):
            continue

        def evaluate(name: str = name) -> Any:
            moved = system.with_values(system.b + 1j * STEP)
            return moved.start() if name == "start" else call(moved, name, given)

        if accepted(evaluate) is None:
            add(f"{name} accepts complex numbers, as {', '.join(kept)} need", 1.0, 0.0)


def accepted(evaluate: Callable[[], Any]) -> Any:
    """Return the value; None if it refuses complex numbers."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            return evaluate()
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        return None


def shapes(add: Add, system: MechanicalSystem) -> None:
    """Check names, weights, and the shape and kind of every array."""
    n_q, n_lam, n_b = system.n_q, system.n_lam, system.n_b
    sizes = {"q": n_q, "l": n_lam, "b": n_b}
    sizes |= {"K": system.pattern.size, "B": system.constraint_pattern.size}

    def expect(name: str, array: Array, shape: str) -> None:
        good = np.shape(array) == tuple(sizes[x] for x in shape)
        good = good and np.asarray(array).dtype.kind == "f"
        add(f"shape and kind of {name}", float(not good), 0.0)

    expect("b", system.b, "b")
    expect("weights", system.weights, "q")
    add("weights are positive", float(not np.all(np.asarray(system.weights) > 0)), 0.0)
    add("names of design variables", float(len(system.design_names) != n_b), 0.0)
    add("names of constraints", float(len(system.constraint_names) != n_lam), 0.0)
    for name, pattern, rows in (
        ("pattern", system.pattern, n_q),
        ("constraint_pattern", system.constraint_pattern, n_lam),
    ):
        add(f"shape of {name}", float(pattern.shape != (rows, n_q)), 0.0)
    for k, name in enumerate("qv"):
        expect(f"start, {name}", system.start()[k], "q")
        expect(f"start_b, {name}_b", system.start_b()[k], "qb")
    x, q_b = np.zeros(n_q), np.zeros((n_q, n_b))
    q = x + system.start()[0]
    expect("start_pull_back", system.start_pull_back(q, x), "b")
    expect("mass_times of columns", system.mass_times(q, q_b), "qb")
    given = {"q": q, "v": x, "a": x, "x": x, "mu": x, "lam": np.zeros(n_lam), "t": 0.0}
    given |= {"q_b": q_b, "v_b": q_b, "a_b": q_b, "lam_b": np.zeros((n_lam, n_b))}
    for name, (_, shape) in MEMBERS.items():
        if name not in unasked(system):
            expect(name, call(system, name, given), shape)
