"""Check of a mechanical system: every member against the values that determine it.

Comparisons are made at random states near the start. Each takes ``add(name, error, tolerance)``,
which records a finding, and a `Probe`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from inspect import Parameter, signature
from types import FunctionType, MethodType
from typing import Any, TypeAlias, final

import numpy as np

from ancfdae.equations.derived import (
    Derived,
    Generic,
    Related,
    Sizes,
    coordinate_sizes,
    design_sizes,
    is_value,
    is_written,
    members,
)
from ancfdae.equations.solution_parts import pandas
from ancfdae.equations.system import MechanicalSystem, Motion, StateDirection, reaction
from ancfdae.errors.checks import require_count, require_index, require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import listed, page
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import STEP, Array

# Value given to design variables that are zero and must not be negative; steps are at most half of
# it.
_AWAY = 0.1


@final
@dataclass(frozen=True)
class Finding:
    """Largest relative error of one method or property of a system, and its tolerance."""

    name: str
    error: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether the error is within its tolerance."""
        return self.error <= self.tolerance

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "WRONG"
        return f"{self.name:<58} {self.error:9.1e} {self.tolerance:9.1e}  {verdict}"


@final
@dataclass(frozen=True)
class SystemCheck:
    """Findings of `check_system` on a system of the class `name`; ``print`` it for a table."""

    name: str
    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Whether the errors of all findings are within their tolerances."""
        return not self.wrong

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """Findings whose error exceeds their tolerance."""
        return tuple(finding for finding in self.findings if not finding.passed)

    def raise_if_wrong(self) -> None:
        """Raise InvalidInputError that names the system's methods with errors above tolerance."""
        if self.wrong:
            names = "; ".join(f"{x.name} (error {x.error:.1e})" for x in self.wrong)
            raise InvalidInputError(
                self.name,
                "must agree with its own values and their differences",
                f"{len(self.wrong)} of {len(self.findings)} that do not: {names}",
                "Correct these methods; print the report for all of them.",
            )

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each finding: name, error, tolerance, passed."""
        rows = [(x.name, x.error, x.tolerance, x.passed) for x in self.findings]
        return pandas().DataFrame(rows, columns=["finding", "error", "tolerance", "passed"])

    def _repr_html_(self) -> str:
        first = sorted(self.findings, key=lambda x: x.passed)
        rows = [(x.name, f"{x.error:.1e}", f"{x.tolerance:.1e}") for x in first]
        return page(repr(self), [("finding", "error", "tolerance"), *rows])

    def __repr__(self) -> str:
        wrong = f"wrong: {listed(x.name for x in self.wrong)}" if self.wrong else "all ok"
        return f"{self.name}: {len(self.findings)} checks, {wrong}"

    def __str__(self) -> str:
        head = f"{self.name:<58} {'error':>9} {'tolerance':>9}"
        lines = [head, "-" * len(head), *(str(finding) for finding in self.findings)]
        wrong = f"{len(self.wrong)} wrong" if self.wrong else "all ok"
        return "\n".join([*lines, f"{len(self.findings)} checks, {wrong}."])


def check_system(system: MechanicalSystem, *, samples: int = 2, seed: int = 0) -> SystemCheck:
    """Check every member of a mechanical system against its values.

    Every member that a system may override is compared with what the base class derives from the
    values, by differences of real numbers, extrapolated to about 1e-10, and the values with each
    other; shapes, declarations and the start are checked. A wrong sign or factor is an error of
    order one. A value that refuses complex numbers is named if other members are complex steps of
    it; where they are accepted, the steps are compared too. States are random, beside the start;
    they need not lie on the constraints.

    Parameters
    ----------
    system : MechanicalSystem
    samples : int
        Number of random states; the largest error of all is reported.
    seed : int
        Seed of the random states.

    Returns
    -------
    SystemCheck
        ``print`` it, read whether it ``passed``, or call ``raise_if_wrong()``.

    Raises
    ------
    InvalidInputError
        If `system` is no MechanicalSystem or its design values are complex.
    """
    require_kind("system", system, (MechanicalSystem,), "Assemble a scene first.")
    require_count("samples", samples, "2 is plenty.")
    require_index("seed", seed, 2**32, "For example 0.")
    if np.asarray(system.b).dtype.kind != "f":
        raise InvalidInputError(
            "system.b", "must be real", system.b.dtype, "Check with real values."
        )
    rng = np.random.default_rng(seed)
    findings, system = dict[str, Finding](), _inside(system)

    def add(name: str, error: float, tolerance: float) -> None:
        before = findings[name].error if name in findings else 0.0
        findings[name] = Finding(name, max(before, float(error)), tolerance)

    with np.errstate(all="ignore"):
        for _ in range(samples):
            probe = Probe(system, rng)
            for check in (shapes, refusals, start, other_values, declarations, prove):
                check(add, probe)
                # With wrong shapes or missing derivatives later checks would be meaningless.
                if check in (shapes, refusals) and not all(x.passed for x in findings.values()):
                    return SystemCheck(type(system).__name__, tuple(findings.values()))
    return SystemCheck(type(system).__name__, tuple(findings.values()))


def _inside(system: MechanicalSystem) -> MechanicalSystem:
    """Return the system at design values away from zero where these must not become negative."""
    b = system.b.copy()
    for i in np.flatnonzero(b == 0):
        less = system.b.copy()
        less[i] = -_AWAY
        try:
            system.with_values(less)
        except InvalidInputError:
            b[i] = _AWAY
    return system if np.array_equal(b, system.b) else system.with_values(b)


# Values of arguments of system methods, by name of the argument.
Given: TypeAlias = dict[str, Any]
# Distance of a random state from the start, relative to its size.
_BESIDE = 0.05
# Number of time points for methods that take many.
_INSTANTS = 3


@final
class Probe:
    """Random states of a system, and random changes of the magnitude of the state itself.

    In the time `time`, s, the system moves by its own size.
    """

    def __init__(self, system: MechanicalSystem, rng: np.random.Generator) -> None:
        self.system, self._rng = system, rng
        q, v = system.start()
        self._q_sizes = coordinate_sizes(q, system.weights)
        self.time, self._lam_size = self._natural_sizes(q, v)
        self._v_sizes = np.maximum(self._q_sizes / self.time, np.abs(v))
        d, t = self.change(), _BESIDE * self.time * (1 + rng.uniform())
        self.m = Motion(q + _BESIDE * d.q, v + (_BESIDE + 0.5) * d.v, d.a, d.lam, t)
        self.d = self.change()
        self.sizes = self._sizes_of_terms()

    def change(self) -> Motion:
        """Return a random change with the magnitude of the state, over a natural time."""
        random = self._rng.uniform
        q, v, a = random(-1, 1, (3, self.system.n_q))
        lam = random(-1, 1, self.system.n_lam) * self._lam_size
        speeds = self._v_sizes
        return Motion(q * self._q_sizes, v * speeds, a * speeds / self.time, lam, self.time)

    def one(self) -> list[Given]:
        """Return arguments at one time, for all orders and along two directions.

        They hold the state, adjoint vectors, and design derivatives.
        """
        m, d, T, w = self.m, self.d, self.time, self.system.weights
        rates = m.q, m.v, m.a, d.a / T
        given: Given = {**m._asdict(), "x": d.q, "dq": d.v, "mu": self.change().q, "states": m[:4]}
        given |= {"on_q": w * d.q, "on_v": w * d.v * T**2}
        changes = [self.change() for _ in range(self.system.n_b)]
        for name in ("q", "v", "a", "lam"):
            rows = np.array([getattr(change, name) for change in changes])
            columns = rows.reshape(len(changes), len(given[name])).T
            given[f"{name}_b"] = columns / design_sizes(self.system)
            given[f"{name}_rows"] = np.concatenate([given[name][None], given[f"{name}_b"].T])
        given["states_b"] = tuple(given[f"{name}_b"] for name in ("q", "v", "a", "lam"))
        given["direction_b"] = given["v_b"], given["a_b"]
        rates_b = *given["states_b"][:3], given["a_b"] / T
        time, still = StateDirection(1.0, m.v, d.a), StateDirection(0.0, d.v, d.a)
        return [
            given
            | {"motion": rates[:order], "direction": time if order % 2 else still}
            | {"motion_b": rates_b[:order] if held is None else None}
            for order in (1, 2, 3, 4)
            for held in (None, order)
        ]

    def many(self) -> list[Given]:
        """Return arguments at several times, for three orders of motion, with and without v."""
        states = [self.m.plus(0.1 * k, self.d) for k in range(_INSTANTS)]
        given = {name: np.array([x._asdict()[name] for x in states]) for name in Motion._fields}
        changes = [self.change() for _ in range(_INSTANTS)]
        covectors = np.array([x.q for x in changes]), np.array([x.lam for x in changes])
        return [
            given
            | {"v": v, "states": (given["q"], v, given["a"], given["lam"])}
            | {"covectors": covectors, "motion": (given["q"], given["v"], given["a"])[:order]}
            for order, v in ((1, None), (2, given["v"]), (3, given["v"]))
        ]

    def _sizes_of_terms(self) -> Sizes:
        s, m, q, v = self.system, self.m, self._q_sizes, self._v_sizes
        terms = [s.force(m.t, m.q, m.v), s.mass_times(m.q, m.a), reaction(s, m.t, m.q, m.lam)]
        B, Phi = s.constraint_q(m.t, m.q), s.constraint(m.t, m.q)
        C = np.abs(Phi) + s.constraint_pattern.dot(np.abs(B), q)
        return Sizes(q, v, design_sizes(s), self.time, np.abs(terms).sum(axis=0), C)

    def _natural_sizes(self, q: Array, v: Array) -> tuple[float, float]:
        """Return the time, s, in which the system moves by its size, and a size of multipliers."""
        system, w = self.system, self.system.weights
        Q = system.force(0.0, q, v)
        size, pull = norm(q, w) or 1.0, norm(Q, 1 / w)
        times = [np.sqrt(size / pull)] if pull > 0 else []
        times += [size / norm(v, w)] if norm(v, w) > 0 else []
        slope = np.max(np.abs(system.constraint_q(0.0, q)), initial=0.0)
        return float(min(times, default=1.0)), float((np.max(np.abs(Q)) or 1.0) / (slope or 1.0))


def arguments(member: FunctionType, one: list[Given], many: list[Given]) -> list[list[Any]]:
    """Return all distinct lists of arguments to check a method with, at one time or at many."""
    _, *parameters = signature(member).parameters.values()
    instants = any(p.name == "t" and p.annotation != "float" for p in parameters)
    rows: dict[tuple[Any, ...], list[Any]] = {}
    for given in many if instants else one:
        row: list[Any] = []
        for p in parameters:
            value = given[p.name]
            row += value if p.kind is Parameter.VAR_POSITIONAL else (value,)
        rows[tuple(map(_identity, row))] = row
    return list(rows.values())


def _identity(x: Any) -> Any:
    return tuple(map(id, x)) if isinstance(x, tuple) else id(x)


Add: TypeAlias = Callable[[str, float, float], None]

# Sums in another order; extrapolated differences, good to 1e-10 or better.
_SAME, _DIFFERENCES = 1e-10, 1e-6
# As in ancfdae.integrators.start: the violation that a declared start may have.
_CONSISTENT = 1e-8
# Fraction of the magnitude expected of an entry below which it is compared with that magnitude.
_SMALL = 1e-3


def shapes(add: Add, p: Probe) -> None:
    """Check names and weights of a system, and the shapes of M, Q, Phi and the start."""
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
    """Find methods, complex-step derivatives by default, whose values reject complex numbers."""
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
    """Compare every member with `Derived`, and the values with each other.

    The default of an overridden method is also compared as computed by complex steps, unless the
    system rejects complex numbers there and so is integrated in real ones.
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
            return  # With a wrong shape the following formulas would fail.
        if value or getattr(type(s), name) is formula:
            continue
        stepped = accepted(lambda: _results(MethodType(formula, s), rows))  # noqa: B023
        if stepped is not None:
            add(f"{name}, by complex steps", _largest_gap(stepped, expected, guess), _DIFFERENCES)
    # No default formula takes complex steps of these in q.
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
    """Check that the start and its design derivatives satisfy the constraints."""
    s = p.system
    q, v = s.start()
    if s.traits.project_start:
        return
    values, pattern = s.constraint_q(0.0, q), s.constraint_pattern
    rows = np.bincount(pattern.rows, values**2 / s.weights[pattern.columns], s.n_lam)
    lengths = np.sqrt(np.where(rows > 0, rows, 1.0))
    for what, phi, x in (("q", s.constraint(0.0, q), q), ("v", s.constraint(0.0, q, v), v)):
        # Zero velocity is compared with the size of q over the natural time.
        size = norm(x, s.weights) or 1e-3 * norm(q, s.weights) / p.time or 1.0
        ratio = np.max(np.abs(phi) / lengths, initial=0.0) / size
        add(f"start, {what} on the constraints", ratio, _CONSISTENT)
    # The same for design derivatives. A term that is nearly zero is compared with the state.
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
    """Check that M is symmetric and positive, and the declared properties of the system."""
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
    """Return the largest change over the largest magnitude of an array; zero without change."""
    most = float(np.max(np.abs(change), initial=0.0))
    return most / (float(np.max(np.abs(size), initial=0.0)) or most) if most else 0.0


def gap(claimed: Any, expected: Any, guess: Any = 0.0) -> float:
    """Return the largest relative error of `claimed` entries; infinite for wrong shape or type."""
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
    """Return the value of `evaluate`, or None if it rejects complex numbers."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            return evaluate()
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        return None


def _results(member: Callable[..., Any], rows: list[list[Any]]) -> list[Any]:
    """Return the arrays that a method returns for each row of arguments; None if it omits one."""
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
    """Return the methods that the integrators do not use, given the declared traits."""
    return {MechanicalSystem.mass_along} if system.traits.constant_mass else set()


def _imaginary(given: Given) -> Given:
    """Return the arguments with an imaginary part added to the states."""
    moved = {name: given[name] + 1j * STEP for name in ("q", "v", "a")}
    return {**given, **moved, "motion": tuple(x + 1j * STEP for x in given["motion"])}
