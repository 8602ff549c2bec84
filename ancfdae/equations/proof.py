"""The single comparisons behind `check_system`.

Each takes ``add(name, error, tolerance)`` and a `Probe`.
"""

import warnings
from collections.abc import Callable
from types import FunctionType, MethodType
from typing import Any, TypeAlias

import numpy as np

from ancfdae.equations.derived import Derived, Related, design_sizes, is_value, is_written, members
from ancfdae.equations.generic import Generic
from ancfdae.equations.probe import Given, Probe, arguments
from ancfdae.equations.system import MechanicalSystem
from ancfdae.errors.text import listed
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import STEP, Array

Add: TypeAlias = Callable[[str, float, float], None]

# Sums in another order; extrapolated differences, good to 1e-10 or better.
_SAME, _DIFFERENCES = 1e-10, 1e-6
# As in ancfdae.integrators.start: the violation that a declared start may have.
_CONSISTENT = 1e-8
# Part of the size that an entry would have at a guess, below which it is compared with that.
_SMALL = 1e-3


def shapes(add: Add, p: Probe) -> None:
    """Check names, weights, and the shapes of the values that nothing else determines."""
    s, m = p.system, p.m
    n_q, n_lam, n_b = s.n_q, s.n_lam, s.n_b
    for name, array, size in (
        ("b", s.b, n_b),
        ("weights", s.weights, n_q),
        ("start, q", s.start()[0], n_q),
        ("start, v", s.start()[1], n_q),
        ("mass", s.mass(m.q), s.pattern.size),
        ("force", s.force(m.t, m.q, m.v), n_q),
        ("constraint", s.constraint(m.t, m.q), n_lam),
    ):
        good = np.shape(array) == (size,) and np.asarray(array).dtype.kind == "f"
        add(f"{name}: shape and kind", float(not good), 0.0)
    add("weights are positive", float(not np.all(np.asarray(s.weights) > 0)), 0.0)
    add("names of design variables", float(len(s.design_names) != n_b), 0.0)
    add("names of constraints", float(len(s.constraint_names) != n_lam), 0.0)
    add("shape of pattern", float(s.pattern.shape != (n_q, n_q)), 0.0)
    add("shape of constraint_pattern", float(s.constraint_pattern.shape != (n_lam, n_q)), 0.0)


def refusals(add: Add, p: Probe) -> None:
    """Find members that are complex steps of values which refuse complex numbers."""
    s, one, many = p.system, p.one(), p.many()
    moved = s.with_values(s.b + 1j * STEP)
    imaginary = [_imaginary(given) for given in one]

    def refuses(system: MechanicalSystem, name: str, f: FunctionType, given: list[Given]) -> bool:
        rows = arguments(f, given, many)
        return accepted(lambda: [getattr(system, name)(*row) for row in rows]) is None

    written = {name: f for name, f in members().items() if is_written(name)}
    refused = [name for name, f in written.items() if refuses(moved, name, f, imaginary)]
    for name, f in members().items() if refused else ():
        if getattr(type(s), name) is f and f not in _unasked(s) and refuses(s, name, f, one):
            add(f"{name}: complex numbers, refused by {listed(refused)}", np.inf, 0.0)


def prove(add: Add, p: Probe) -> None:
    """Compare every member with what `Derived` makes of the values, and these with each other.

    A formula that is overridden is also compared as it would be derived by complex steps, unless
    the system refuses complex numbers there: it is integrated in real ones.
    """
    s, one, many = p.system, p.one(), p.many()
    derived, related = Derived(s, p.time), Related(s, p.time)
    generic = Generic(s, p.m, p.sizes, s.b)
    for name, formula in members().items():
        value = is_value(name)
        if formula in _unasked(s) or (value and name not in vars(Related)):
            continue
        rows, source = arguments(formula, one, many), related if value else derived
        expected, guess = (_results(getattr(x, name), rows) for x in (source, generic))
        error = _largest_gap(_results(getattr(s, name), rows), expected, guess)
        add(name, error, _DIFFERENCES)
        if not np.isfinite(error):
            return  # What has another shape fails in the formulas that follow.
        if value or getattr(type(s), name) is formula:
            continue
        stepped = accepted(lambda: _results(MethodType(formula, s), rows))  # noqa: B023
        if stepped is not None:
            add(f"{name}, by complex steps", _largest_gap(stepped, expected, guess), _DIFFERENCES)
    # No formula takes complex steps of these in q.
    products: dict[str, Callable[..., Array]] = {
        "mass": lambda x, q: x.mass_times(q, p.m.a),
        "constraint": lambda x, q: x.constraint(p.m.t, q),
    }
    for name, product in products.items():
        along = (product, (one[0]["q"], one[0]["q_b"]))
        stepped = accepted(lambda: s._total(*along))  # noqa: B023
        if stepped is not None:
            error = gap(stepped, derived._total(*along), generic._total(*along))
            add(f"{name}, by complex steps", error, _DIFFERENCES)


def start(add: Add, p: Probe) -> None:
    """Check the start against the constraints."""
    s = p.system
    q, v = s.start()
    if s.traits.project_start:
        return
    values, pattern = s.constraint_q(0.0, q), s.constraint_pattern
    rows = np.bincount(pattern.rows, values**2 / s.weights[pattern.columns], s.n_lam)
    lengths = np.sqrt(np.where(rows > 0, rows, 1.0))
    for what, phi, x in (("q", s.constraint(0.0, q), q), ("v", s.constraint(0.0, q, v), v)):
        # A velocity that vanishes leaves nothing to compare with but the time of motion.
        size = norm(x, s.weights) or 1e-3 * norm(q, s.weights) / p.time or 1.0
        ratio = np.max(np.abs(phi) / lengths, initial=0.0) / size
        add(f"start, {what} on the constraints", ratio, _CONSISTENT)
    # The same at neighbouring designs. A term that is nearly zero is compared with the state.
    (q_b, v_b), b = s.start_b(), design_sizes(s)
    still = np.zeros_like(q_b)
    for what, motion, motion_b in (("q", (q,), (q_b,)), ("v", (q, v), (q_b, v_b))):
        held = s.constraint_total(0.0, motion, (still, still)[: len(motion)])
        total = s.constraint_total(0.0, motion, motion_b)
        motion_size = norm(q, s.weights) * (1.0 if what == "q" else 1.0 / p.time)
        least = _SMALL * motion_size * lengths[:, None] / b
        sizes = np.maximum(np.abs(held), np.abs(total - held)) + least
        gaps = np.abs(total) / np.where(sizes > 0, sizes, 1.0)
        name = f"start, {what}_b on the constraints"
        add(name, np.max(gaps, initial=0.0), _DIFFERENCES)


def other_values(add: Add, p: Probe) -> None:
    """Check that `with_values` takes other design values and leaves the system unchanged."""

    def all_of(x: MechanicalSystem) -> Array:
        m = p.m
        parts = [*x.start(), x.mass(m.q), x.force(m.t, m.q, m.v), x.constraint(m.t, m.q)]
        return np.concatenate(parts)

    system, before, b = p.system, all_of(p.system), p.system.b.copy()
    other = system.with_values(b * 1.01 + 1e-3 * (b == 0))
    add("with_values, there and back", gap(all_of(other.with_values(b)), before), _SAME)
    add("with_values leaves the system alone", gap(all_of(system), before), 0.0)
    add("with_values sets b", float(not np.array_equal(system.with_values(b).b, b)), 0.0)


def declarations(add: Add, p: Probe) -> None:
    """Check M, and what is declared constant, linear or independent."""
    s, m, d = p.system, p.m, p.d
    M, B, both = s.pattern.dense(s.mass(m.q)), s.constraint_q(m.t, m.q), np.stack([m.a, d.a], 1)
    add("mass: symmetric", relative(M - M.T, M), _SAME)
    add("mass: not negative", float(d.v @ M @ d.v < 0), 0.0)
    add("mass_times of columns", relative(s.mass_times(m.q, both) - M @ both, M @ both), _SAME)
    if s.traits.constant_mass:
        add("constant_mass", relative(s.mass(m.q + d.q) - s.mass(m.q), M), _SAME)
    if s.traits.linear_constraints:
        add("linear_constraints", relative(s.constraint_q(m.t, m.q + d.q) - B, B), _SAME)
    if s.traits.constant_constraints:
        other, q, t = s.with_values(s.b * 1.01 + 1e-3 * (s.b == 0)), m.q + d.q, m.t + p.time
        add("constant_constraints, Phi_q", relative(other.constraint_q(t, q) - B, B), _SAME)
        Phi = s.constraint(m.t, m.q) + s.constraint_pattern.dot(B, d.q)
        size = s.constraint_pattern.dot(np.abs(B), np.abs(m.q))
        add("constant_constraints", relative(other.constraint(t, q) - Phi, size), _SAME)
    if not s.traits.velocity_forces:
        Q = s.force(m.t, m.q, m.v)
        add("velocity_forces", relative(s.force(m.t, m.q, m.v + d.v) - Q, Q), _SAME)
    if s.traits.symmetric:
        local = s.linearise(*(np.asarray(x)[None] for x in (m.t, m.q, m.v, m.a, m.lam)))
        matrices = [local.f_q] if local.f_v is None else [local.f_q, local.f_v]
        dense = [s.pattern.dense(K[0]) for K in matrices]
        add("symmetric", max(relative(K - K.T, K) for K in dense), _SAME)


def relative(change: Array, size: Array) -> float:
    """Largest change against the largest size, zero where nothing changes."""
    most = float(np.max(np.abs(change), initial=0.0))
    return most / (float(np.max(np.abs(size), initial=0.0)) or most) if most else 0.0


def gap(claimed: Any, expected: Any, guess: Any = 0.0) -> float:
    """Largest difference, entry by entry against its size; infinite of another shape or kind."""
    if claimed is None or expected is None:
        return 0.0 if claimed is expected else np.inf
    claimed = np.asarray(claimed)
    if claimed.shape != np.shape(expected) or claimed.dtype.kind != "f":
        return np.inf
    sizes = np.maximum(np.abs(claimed), np.abs(expected)) + _SMALL * np.abs(guess)
    errors = np.where(claimed == expected, 0.0, np.abs(claimed - expected) / sizes)
    worst = float(np.max(errors, initial=0.0))
    return worst if np.isfinite(worst) else np.inf


def accepted(evaluate: Callable[[], Any]) -> Any:
    """Return the value; None if it refuses complex numbers."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            return evaluate()
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        return None


def _results(member: Callable[..., Any], rows: list[list[Any]]) -> list[Any]:
    """Return all arrays that a member returns for each row of arguments; None if it omits one."""
    results: list[Any] = []
    for row in rows:
        value = member(*row)
        if isinstance(value, np.ndarray):
            value = (value,)
        results += value if isinstance(value, tuple) else vars(value).values()
    return results


def _largest_gap(claimed: list[Any], expected: list[Any], guess: list[Any]) -> float:
    return max(map(gap, claimed, expected, guess))


def _unasked(system: MechanicalSystem) -> set[Any]:
    """Return the members that nobody asks for, by what the system declares."""
    return {MechanicalSystem.mass_along} if system.traits.constant_mass else set()


def _imaginary(given: Given) -> Given:
    """Return the arguments with states that have an imaginary part."""
    moved = {name: given[name] + 1j * STEP for name in ("q", "v", "a")}
    return {**given, **moved, "motion": tuple(x + 1j * STEP for x in given["motion"])}
