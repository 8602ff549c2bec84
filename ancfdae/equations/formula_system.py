"""User-defined mechanical systems, given by formulas for M, Q, Phi and the start.

The formulas are called once, on symbols, and become lists of operations that a kernel evaluates
with all their derivatives (`ancfdae.equations.formulas`). A formula for M, Q or Phi that needs a
number in place of a symbol is called at each evaluation, in complex numbers: its first derivatives
are complex steps.
"""

from __future__ import annotations

import abc
import warnings
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import replace
from functools import cached_property, wraps
from typing import Any, ClassVar

import numpy as np

from ancfdae.equations.complex_steps import FORGOTTEN, at_values
from ancfdae.equations.formulas import Formulas, Value, bare, is_bare, wrong_shape
from ancfdae.equations.plans import ListPlan
from ancfdae.equations.system import (
    DesignPartials,
    Linearisation,
    ListedSystem,
    StateDirection,
    SystemProperties,
)
from ancfdae.errors.kinds import InvalidInputError, NotTracedWarning, StabilityWarning
from ancfdae.kernels import OperationList
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.complex_step import require_derivative
from ancfdae.numerics.operations import Operations, line_of
from ancfdae.numerics.patterns import Csr, SparsityPattern

# Names of coordinates and their rates in a motion.
_RATES = ("q", "v", "a", "j")
# Classes of systems whose formulas are being traced.
_TRACING: ContextVar[frozenset[type]] = ContextVar("_TRACING", default=frozenset())
# Formulas of the system whose `with_values` is being executed.
_HANDED: ContextVar[Formulas | None] = ContextVar("_HANDED", default=None)
# Distances of trial states from the start, relative to its size: near it, where every system is
# defined, and farther away on both sides, where velocities have either sign.
_BESIDE, _BEYOND = 1e-2, (0.4, -0.4)
# Largest difference between values of a list and of the functions, relative to the largest value.
_SAME = 1e-9
# Relative steps at which second differences over the step are compared: for a differentiable
# function they fall by more than the factor; differences below the round-off level are not judged.
_KINK_STEPS, _FALLING, _ROUND_OFF = (1e-5, 1e-8), 0.2, 1e-14
# Methods that a user writes, with the corresponding values of `Formulas`.
_FORMULAS: tuple[tuple[str, Value, tuple[int, ...]], ...] = (
    ("mass_matrix", Formulas.mass, ()),
    ("force", Formulas.force, ()),
    ("position_constraint", Formulas.constraint, (0,)),
)


class FormulaSystem(ListedSystem):
    """A user-defined system, given by formulas for M, Q, Phi and its start.

    Subclasses set `n_q`, `n_lam` and `design_names`, implement `mass_matrix`, `force`,
    `position_constraint`, `start` and `with_values`, and call ``super().__init__(b)`` at the end
    of their own constructor. The first three are smooth functions of q, v, t and ``self.b`` in
    functions of NumPy. They are called once, with arrays of symbols in place of numbers, and
    become lists of operations that are evaluated at compiled speed. If a formula needs a number
    (`if`, a table, `np.linalg.solve`), a warning (`NotTracedWarning`) names the line, and the
    formula is called with complex numbers at each evaluation: a run takes about a hundred times as
    long. An `ExternalFunction` in a formula, such as a table with its derivative, is called alone.
    `start` is called with complex ``self.b``. Any partial may be overridden by a formula of the
    user; `check_system` compares them.

    Whether M is constant, whether Phi is linear and the same at all times and designs, and whether
    Q is independent of v is found from the formulas and added to `traits`.

    Parameters
    ----------
    b : sequence of number, shape (n_b,)
        Values of the design variables.

    Raises
    ------
    InvalidInputError
        If a method returns another shape, if a method that is called with complex numbers does not
        accept them or drops an imaginary part, or if a weight is not positive.
    """

    _formulas: Formulas
    #: Formulas of the last system of the class that were traced and checked.
    _checked: ClassVar[Formulas | None] = None

    def __init_subclass__(cls, **named: Any) -> None:
        """Make `with_values` of the class pass the traced formulas on to the system it returns."""
        super().__init_subclass__(**named)
        written = vars(cls).get("with_values")
        if written is None:
            return

        @wraps(written)
        def with_values(self: FormulaSystem, b: Array) -> FormulaSystem:
            if "_formulas" not in vars(self):
                return written(self, b)
            token = _HANDED.set(self._formulas)
            try:
                return written(self, b)
            finally:
                _HANDED.reset(token)

        cls.with_values = with_values  # type: ignore[assignment]

    def __init__(self, b: Array | tuple[complex, ...]) -> None:
        self.b, where = np.asarray(b), type(self).__name__
        if self.b.dtype == object or is_bare():
            return  # The formulas are being traced, or called from a list of operations.
        self.b = self.b * 1.0
        if self.b.shape != (self.n_b,):
            rule = f"must have shape ({self.n_b},)"
            raise InvalidInputError(f"{where}.b", rule, self.b.shape, "Name all in `design_names`.")
        handed = _HANDED.get()
        if handed is not None and handed.kind is type(self):
            self._formulas = handed
        else:
            self._trace()
        self.pattern, self.constraint_pattern = self._formulas.patterns
        if self._formulas is not handed:
            self._require_declared()
        self.called_functions = tuple(self._formulas.called)
        self.scleronomic = self._formulas.scleronomic
        self.traits = self._found()
        # The attribute replaces the method of the same name, which is the user's formula.
        vars(self)["force"] = self._force
        self.weights = self.coordinate_weights()
        if not np.all(self.weights > 0):
            repair = "Override `coordinate_weights`."
            raise InvalidInputError(f"{where}.weights", "must be positive", self.weights, repair)

    def _trace(self) -> None:
        """Trace the formulas; formulas that need numbers are tried with complex ones."""
        kind, tracing = type(self), _TRACING.get()
        if kind in tracing:
            raise InvalidInputError(f"{kind.__name__}.with_values", *FORGOTTEN)
        token = _TRACING.set(tracing | {kind})
        try:
            self._formulas = Formulas(self)
        finally:
            _TRACING.reset(token)
        checked, content = kind._checked, self._formulas.content
        if checked and checked.kind is kind and content and checked.content == content:
            # The same operations as before: their lists and derivatives are there.
            self._formulas = checked
            self._declared_start()
            self._warn_of_kinks()
            return
        called = self._formulas.called
        message = (
            f"{kind.__name__}: each evaluation calls {' and '.join(called)}, which takes a hundred "
            f"times as long as a list of operations: {' '.join(dict.fromkeys(called.values()))} "
            "Call only what needs numbers, as an ExternalFunction (docs/own-systems.md)."
        )
        try:
            self._require_the_same()
        except InvalidInputError as error:
            if called:
                error.add_note(message)
            raise
        self._warn_of_kinks()
        if called:
            warnings.warn(message, NotTracedWarning, stacklevel=4)
        kind._checked = self._formulas

    # -- what a user writes ----------------------------------------------------------------------

    @abc.abstractmethod
    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (n_q, n_q)."""

    @abc.abstractmethod
    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the constraints Phi, shape (n_lam,), which vanish on admissible positions."""

    def coordinate_weights(self) -> Array:
        """Return the `weights`, shape (n_q,); by default the diagonal of M at the start."""
        M = np.asarray(self.mass_matrix(self.start()[0]))
        if M.shape != (shape := (self.n_q, self.n_q)):
            raise wrong_shape(f"{type(self).__name__}.mass_matrix", shape, M.shape)
        return np.diagonal(M).real.astype(float)

    def _require_the_same(self) -> None:
        """Raise InvalidInputError if recorded operations and called formulas give different values.

        Values and derivatives are compared at the start and near it, because at the start itself
        Phi is round-off.
        """
        (q, v), (times, Q, V) = self._declared_start(), self._samples()
        kind, of_M = type(self), self._formulas.patterns[0]
        on = of_M.rows, of_M.columns
        states = list(zip(times.tolist(), Q, V, strict=True))
        changes = self._changes(q, v)
        functions: dict[str, tuple[Value, tuple[int, ...], Callable[..., Any]]] = {
            "mass_matrix": (
                Formulas.mass,
                (),
                lambda t, x, u: np.asarray(self.mass_matrix(x))[*on],
            ),
            "force": (Formulas.force, (), lambda t, x, u: kind.force(self, t, x, u)),
            "position_constraint": (
                Formulas.constraint,
                (0,),
                lambda t, x, u: self.position_constraint(t, x),
            ),
        }
        for name, (of, which, function) in functions.items():
            where = f"{kind.__name__}.{name}"
            if self._formulas.calls(of, *which):
                self._require_derivatives(where, of, which, (q, v), changes)
            if name in self._formulas.called:
                continue
            with np.errstate(all="ignore"):
                called = np.array([np.ravel(function(*state)) for state in states])
            listed = self._values(of, *which, rows=len(Q), t=times[:, None], q=Q, v=V)[0]
            known = np.isfinite(called)
            gap = np.max(np.abs(listed.reshape(called.shape) - called)[known], initial=0.0)
            if not gap <= _SAME * np.max(np.abs(called[known]), initial=0.0):
                raise InvalidInputError(
                    where,
                    "must return values that follow from t, q, v and b alone",
                    f"other values for numbers than for symbols, by {gap:.1e}",
                    "Keep no state in the system, and convert no arguments.",
                )

    def _declared_start(self) -> tuple[Array, Array]:
        """Return q and v at the start; InvalidInputError for wrong shapes or lost derivatives."""
        where, shape = f"{type(self).__name__}.start", (self.n_q,)
        q, v = (np.asarray(x) for x in self.start())
        for x in (q, v):
            if x.shape != shape:
                raise wrong_shape(where, shape, x.shape)
        if self.n_b and self._formulas.moving_start:
            b = self.b.real
            *_, db = self._changes(q.real, v.real)

            def start(b: Array) -> Array:
                with bare():
                    return np.concatenate(at_values(self, b).start())

            require_derivative(where, start, [b], [db])
        return q.real, v.real

    def _require_derivatives(
        self,
        where: str,
        of: Value,
        which: tuple[int, ...],
        start: tuple[Array, Array],
        changes: tuple[Array, ...],
    ) -> None:
        """Raise InvalidInputError if complex steps of a called formula are not its derivatives."""

        def value(t: Array, q: Array, v: Array, b: Array) -> Array:
            return self._formulas.values(of, *which, t=t, q=q, v=v, b=b)[0].ravel()

        for away in (_BESIDE, *_BEYOND):
            q, v = (x + away * dx for x, dx in zip(start, changes, strict=False))
            x = np.array([0.01]), q, v, self.b.real
            try:
                value(*x)
            except (ArithmeticError, ValueError):
                if away == _BESIDE:
                    raise
                continue  # The formula is not defined there.
            require_derivative(where, value, x, [np.ones(1), *changes])

    def require_derivatives_at(self, t: float, q: Array, v: Array) -> None:
        """Raise InvalidInputError if complex steps of called formulas at a state are wrong."""
        changes = self._changes(q, v)
        for name, of, which in _FORMULAS:
            if self._formulas.calls(of, *which):

                def value(
                    t: Array,
                    q: Array,
                    v: Array,
                    b: Array,
                    of: Value = of,
                    which: tuple[int, ...] = which,
                ) -> Array:
                    return self._formulas.values(of, *which, t=t, q=q, v=v, b=b)[0].ravel()

                where = f"{type(self).__name__}.{name}, at t = {t:.6g} s of the run"
                x = np.array([t]), q, v, self.b.real
                require_derivative(where, value, x, [np.ones(1), *changes])

    def _samples(self) -> tuple[Array, Array, Array]:
        """Return times, coordinates and velocities of three states: the start, and two near it.

        Shapes (3,), (3, n_q) and (3, n_q).
        """
        shares, (q, v) = np.array([0.0, 1e-2, -1e-2]), (x.real for x in self.start())
        dq, dv, _ = self._changes(q, v)
        return shares, q + np.outer(shares, dq), v + np.outer(shares, dv)

    def _changes(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return changes of q, v and b for differences: of their size, all entries different."""
        n, b = np.arange(1.0, self.n_q + 1), self.b.real
        db = np.where(b == 0, 1.0, b) * np.cos(0.5 + np.arange(self.n_b))
        return np.cos(n) * _size(q), np.sin(n) * _size(v), db

    def _warn_of_kinks(self) -> None:
        """Warn if a root is zero at the start, so that M, Q or Phi has no derivative there.

        If f has a derivative, (f(s) - 2 f(0) + f(-s)) / s vanishes with s; for |s| it is 2.
        """
        formulas, (q, v) = self._formulas, self.start()
        if not formulas.root_lines:
            return
        roots = self._values(Formulas.roots, t=[0.0], q=q, v=v)[0]
        if not np.any(roots == 0):
            return
        steps, (dq, dv, _) = np.array(_KINK_STEPS), self._changes(q, v)
        s = np.concatenate([[0.0], steps, -steps])
        Q, V = q + np.outer(s, dq), v + np.outer(s, dv)
        for name, of, which in _FORMULAS:
            if name in formulas.called:
                continue
            with np.errstate(all="ignore"):
                f = self._values(of, *which, rows=len(s), t=s[:, None], q=Q, v=V)[0]
            f = f.reshape(len(s), -1)
            bends = np.max(np.abs(f[1:3] - 2 * f[0] + f[3:]), axis=1, initial=0.0) / steps
            round_off = _ROUND_OFF * np.max(np.abs(f[0]), initial=0.0) / steps[1]
            if not bends[1] <= max(_FALLING * bends[0], round_off):
                at = zip(formulas.root_lines, roots, strict=True)
                lines = [line_of(x) for x, z in at if z == 0]
                warnings.warn(
                    f"{type(self).__name__}.{name} has no derivative at the start, where a root is "
                    f"zero: {'; '.join(lines)}. There the derivative of the root is taken as "
                    "zero, the mean of both sides. Write it smooth, for example "
                    "sqrt(x @ x + eps**2) for the norm of x.",
                    StabilityWarning,
                    stacklevel=5,
                )

    def _require_declared(self) -> None:
        """Raise InvalidInputError if values at the sample states contradict declared traits."""
        traits, constant = self.traits, self.traits.constant_constraints
        if not (traits.constant_mass or traits.linear_constraints or constant) and (
            traits.velocity_forces
        ):
            return
        times, Q, V = self._samples()
        other = self.with_values(self.b * 1.01 + 1e-3 * (self.b == 0)) if constant else self
        states = list(zip(times.tolist(), Q, V, strict=True))
        declared: list[tuple[bool, str, str, Callable[[], list[Array]]]] = [
            (traits.constant_mass, "constant_mass=True", "M changes with q", lambda: [
                self.mass(x) for x in Q
            ]),
            (traits.linear_constraints or constant, "linear_constraints=True",
             "Phi_q changes with q", lambda: [self.constraint_q(0.0, x) for x in Q]),
            (constant, "constant_constraints=True", "Phi_q changes with t, q or b", lambda: [
                *(self.constraint_q(t, x) for t, x, _ in states), other.constraint_q(0.0, Q[0])
            ]),
            (constant, "constant_constraints=True", "dPhi/dt at v = 0 is not zero", lambda: [
                np.ones(self.n_lam), *(1 + self.constraint(t, x, 0 * x) for t, x, _ in states)
            ]),
            (not traits.velocity_forces, "velocity_forces=False", "Q changes with v", lambda: [
                self._force(0.0, Q[0], x) for x in V
            ]),
        ]  # fmt: skip
        for claimed, what, contradiction, values in declared:
            if not claimed:
                continue
            with np.errstate(all="ignore"):
                first, *others = values()
                sizes = [np.max(np.abs(x)[np.isfinite(x)], initial=0.0) for x in (first, *others)]
                changes = [(x - first)[np.isfinite(x - first)] for x in others]
            most = max(np.max(np.abs(x), initial=0.0) for x in changes)
            if most > _SAME * max(sizes):
                raise InvalidInputError(
                    f"{type(self).__name__}.traits, {what}",
                    "must hold for the formulas",
                    f"formulas for which {contradiction}, by {most:.1e}",
                    "Remove the declaration: what holds is found from the formulas.",
                )

    def _found(self) -> SystemProperties:
        """Return the traits of the system: those declared, and those found from the formulas."""
        traits, shown = self.traits, self._formulas.shown
        linear = traits.linear_constraints or shown.linear_constraints
        constant = traits.constant_constraints or (linear and shown.constant_constraints)
        return replace(
            traits,
            constant_mass=traits.constant_mass or shown.constant_mass,
            linear_constraints=linear,
            constant_constraints=constant,
            velocity_forces=traits.velocity_forces and shown.velocity_forces,
        )

    # -- members of the protocol -----------------------------------------------------------------

    def _values(self, of: Value, *which: Any, rows: int | None = None, **at: Any) -> list[Array]:
        return self._formulas.values(of, *which, rows=rows, b=self.b, **at)

    @staticmethod
    def _motion(motion: tuple[Array, ...], sign: str = "") -> dict[str, Any]:
        """Return the coordinates and time derivatives q, v, a, j of a motion by name."""
        return {f"{sign}{name}": x for name, x in zip(_RATES, motion, strict=False)}

    def index_1(self, derivatives: bool) -> tuple[OperationList, ...]:
        """Return the lists for accelerations (index 1) in a kernel, with derivatives if asked."""
        lists = self._formulas.accelerations
        return lists + self._formulas.differentiated if derivatives else lists

    def right_side(self) -> tuple[Operations, dict[str, Array], dict[str, Array]]:
        """Return operations for accelerations, numbers of Q, M, Phi_q, Phi'', and of inputs."""
        return self._formulas.right_side()

    @property
    def divides(self) -> bool:  # type: ignore[override]  # computed where it is asked for
        """Whether M, Q or Phi have divisors that depend on the state."""
        return any(x.size for x in self._formulas.divisors())

    def divisors(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Return the divisors in M, Q and Phi in k states, (k, n) by the name of the method."""
        at = {"t": t[:, None], "q": q, "v": v, "b": self.b.real}
        found = self._formulas.values(Formulas.divisors, rows=len(t), **at)
        return {name: x for (name, *_), x in zip(_FORMULAS, found, strict=True)}

    @cached_property
    def list_plan(self) -> ListPlan:
        """Operation lists with which a kernel evaluates the equations of motion in a time step."""
        velocity = self.traits.velocity_forces
        B, K = (_csr(pattern) for pattern in (self.constraint_pattern, self.pattern))
        weights = self.weights, 1 / self.weights
        return ListPlan(self._formulas.march(velocity), self.b, *weights, B, K, velocity)

    def start_b(self) -> tuple[Array, Array]:
        """Return the design derivatives of the start, shape (n_q, n_b) each."""
        if self._formulas.moving_start:
            return super().start_b()
        return np.zeros((self.n_q, self.n_b)), np.zeros((self.n_q, self.n_b))

    def mass(self, q: Array) -> Array:
        """Return the values of M on its pattern, shape (nnz,)."""
        return self._values(Formulas.mass, q=q)[0]

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return the derivative of M along dq, values on its pattern, shape (nnz,)."""
        return self._values(Formulas.mass_along, q=q, dq=dq)[0]

    def _force(self, t: float, q: Array, v: Array) -> Array:
        return self._values(Formulas.force, t=[t], q=q, v=v)[0]

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of Q along (dt, dq, dv), shape (n_q,)."""
        dt, dq, dv = direction
        return self._values(Formulas.force_along, t=[t], q=q, v=v, dt=[dt], dq=dq, dv=dv)[0]

    def force_and_total(self, t: float, q_rows: Array, v_rows: Array) -> Array:
        """Return Q and its total design derivatives as rows, shape (1 + n_b, n_q)."""
        q, v = q_rows[0], v_rows[0]
        moved = {"dq": q_rows[1:], "dv": v_rows[1:], "db": np.eye(self.n_b)}
        of = Formulas.force_total
        total = self._values(of, rows=self.n_b, t=[t], q=q, v=v, **moved)[0]
        return np.concatenate([self._force(t, q, v)[None], total])

    def over_time(self, t: Array) -> Array:
        """Return forces and constraints at times t in the state of the start, shape (k, n)."""
        if self._formulas.called:
            return super().over_time(t)
        q, v = self.start()
        Q = self._values(Formulas.force, rows=len(t), t=t[:, None], q=q, v=v)[0]
        Phi = self._values(Formulas.constraint, 0, rows=len(t), t=t[:, None], q=q)[0]
        return np.concatenate([Q, Phi], axis=1)

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi, or its time derivative of the order of the rates in `motion`, (n_lam,)."""
        at = self._motion(motion)
        return self._values(Formulas.constraint, len(motion) - 1, t=[t], **at)[0]

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return the values of Phi_q, or of its time derivative, on its pattern, shape (nnz,)."""
        at = self._motion(motion)
        return self._values(Formulas.constraint_q, len(motion) - 1, t=[t], **at)[0]

    def constraints_q(self, t: Array, *motion: Array) -> Array:
        """Return the values of Phi_q, or of its time derivative, at k times, shape (k, nnz)."""
        at = self._motion(motion)
        orders = len(motion) - 1
        return self._values(Formulas.constraint_q, orders, rows=len(t), t=t[:, None], **at)[0]

    def constraint_partials(self, t: Array, *motion: Array) -> Array:
        """Return the design derivatives of `constraint` at k times, shape (k, n_lam, n_b)."""
        k, n_b = len(t), self.n_b
        at: dict[str, Any] = {"t": np.repeat(t, n_b)[:, None], "db": np.tile(np.eye(n_b), (k, 1))}
        at |= {f"d{name}": np.zeros(self.n_q) for name in _RATES[: len(motion)]}
        at |= self._motion(tuple(np.repeat(x, n_b, axis=0) for x in motion))
        of, order = Formulas.constraint_total, len(motion) - 1
        rows = self._values(of, order, rows=k * n_b, **at)[0]
        return rows.reshape(k, n_b, self.n_lam).mT

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None = None
    ) -> Array:
        """Return the total design derivative of `constraint`, shape (n_lam, n_b)."""
        at: dict[str, Any] = {"t": [t], "db": np.eye(self.n_b)}
        at |= {f"d{name}": np.zeros(self.n_q) for name in _RATES[: len(motion)]}
        at |= self._motion(motion)
        if motion_b is not None:
            at |= self._motion(tuple(x_b.T for x_b in motion_b), "d")
        of, order = Formulas.constraint_total, len(motion) - 1
        return self._values(of, order, rows=self.n_b, **at)[0].T

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return M, f_q, f_v and Phi_q at k time points as a `Linearisation`."""
        with_v = v is not None and self.traits.velocity_forces
        at = {"q": q, "a": a, "lam": lam} | ({} if v is None else {"v": v})
        of = Formulas.linearised
        found = self._values(of, v is not None, with_v, rows=len(t), t=t[:, None], **at)
        M, f_q, *f_v, Phi_q = found
        M = M[:1] if self.traits.constant_mass else M
        return Linearisation(M, f_q, f_v[0] if with_v else None, Phi_q)

    def design_partials(
        self, t: Array, q: Array, v: Array | None, a: Array, lam: Array
    ) -> DesignPartials:
        """Return the design partials of f and Phi at k time points."""
        at = {"q": q, "a": a, "lam": lam} | ({} if v is None else {"v": v})
        of = Formulas.partials
        return DesignPartials(*self._values(of, v is not None, rows=len(t), t=t[:, None], **at))


def _size(x: Array) -> float:
    return float(np.max(np.abs(x), initial=0.0)) or 1.0


def _csr(pattern: SparsityPattern) -> Csr:
    """Return a pattern as a sparse matrix of ones: row starts, columns and values."""
    return *pattern.places, np.ones(pattern.size)
