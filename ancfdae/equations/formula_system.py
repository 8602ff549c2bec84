"""Mechanical systems of a user, given by formulas for M, Q, Phi and the start.

The formulas run once, on tracers, and become lists of operations that a kernel evaluates with all
their derivatives (`ancfdae.equations.formulas`). M or Q that needs a number where a tracer has none
is called in complex numbers instead: its first derivatives are complex steps.
"""

from __future__ import annotations

import abc
import warnings
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import replace
from functools import cache, cached_property, wraps
from typing import Any

import numpy as np

from ancfdae.equations.analytic import require_analytic
from ancfdae.equations.complex_steps import FORGOTTEN
from ancfdae.equations.formulas import Formulas, Value
from ancfdae.equations.motion import StateDirection
from ancfdae.equations.system import DesignPartials, Linearisation, ListedSystem, SystemProperties
from ancfdae.errors.kinds import InvalidInputError, NotTracedWarning
from ancfdae.kernels import Csr, ListPlan, OperationList
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.extrapolation import scaled_derivative
from ancfdae.numerics.operations import Operations
from ancfdae.numerics.patterns import SparsityPattern

# What a motion consists of.
_RATES = ("q", "v", "a", "j")
# Kinds of systems whose formulas are being traced.
_TRACING: ContextVar[frozenset[type]] = ContextVar("_TRACING", default=frozenset())
# Formulas of the system whose `with_values` runs.
_HANDED: ContextVar[Formulas | None] = ContextVar("_HANDED", default=None)
# Largest difference between values of a list and of the functions, relative to the largest value.
_SAME = 1e-9


class FormulaSystem(ListedSystem):
    """A system that is given by formulas for M, Q, Phi and its start.

    Subclasses set `n_q`, `n_lam` and `design_names`, implement `mass_matrix`, `force`,
    `position_constraint`, `start` and `with_values`, and call ``super().__init__(b)`` at the end
    of their own constructor. The first three are smooth functions of q, v, t and ``self.b`` in
    functions of NumPy. They are called once, with arrays of symbols in place of numbers, and
    become lists of operations that are evaluated at compiled speed. If M or Q needs a number (`if`,
    a table, `np.linalg.solve`), a warning (`NotTracedWarning`) names the line, and it is called
    with complex numbers at each evaluation: a run takes some hundred times as long. `start` is
    called with complex ``self.b``. Any partial may be overridden by a formula of the user;
    `check_system` compares.

    Whether M is constant, Phi linear and Q independent of v is found from the formulas and added
    to `traits`.

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

    def __init_subclass__(cls, **named: Any) -> None:
        """Hand formulas on from a system to the one that its `with_values` returns."""
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
        if self.b.dtype == object:
            return  # Its formulas are being traced.
        self.b = self.b * 1.0
        if self.b.shape != (self.n_b,):
            rule = f"must have shape ({self.n_b},)"
            raise InvalidInputError(f"{where}.b", rule, self.b.shape, "Name all in `design_names`.")
        self.pattern = _full(self.n_q, self.n_q)
        self.constraint_pattern = _full(self.n_lam, self.n_q)
        handed = _HANDED.get()
        if handed is not None and handed.kind is type(self):
            self._formulas = handed
        else:
            self._trace()
        self.traits = self._found()
        # In place of the method of the same name, which is the formula.
        vars(self)["force"] = self._force
        self.weights = self.coordinate_weights()
        if not np.all(self.weights > 0):
            repair = "Override `coordinate_weights`."
            raise InvalidInputError(f"{where}.weights", "must be positive", self.weights, repair)

    def _trace(self) -> None:
        """Trace the formulas; those that need numbers are tried with complex ones."""
        kind, tracing = type(self), _TRACING.get()
        if kind in tracing:
            raise InvalidInputError(f"{kind.__name__}.with_values", *FORGOTTEN)
        token = _TRACING.set(tracing | {kind})
        try:
            self._formulas = Formulas(self)
        finally:
            _TRACING.reset(token)
        require_analytic(self, ["start"])
        self._require_the_same()
        called = self._formulas.called
        if not called:
            return
        message = (
            f"{kind.__name__}: each evaluation calls {' and '.join(called)}, which takes a hundred "
            f"times as long as a list of operations: {' '.join(called.values())}"
        )
        try:
            require_analytic(self, called)
        except InvalidInputError as error:
            error.add_note(message)
            raise
        warnings.warn(message, NotTracedWarning, stacklevel=4)

    # -- what a user writes ----------------------------------------------------------------------

    @abc.abstractmethod
    def mass_matrix(self, q: Array) -> Array:
        """Return M, shape (n_q, n_q)."""

    @abc.abstractmethod
    def position_constraint(self, t: float, q: Array) -> Array:
        """Return Phi, shape (n_lam,)."""

    def coordinate_weights(self) -> Array:
        """Return `weights`; by default the diagonal of M at the start."""
        M = np.asarray(self.mass_matrix(self.start()[0]))
        if M.shape != (self.n_q, self.n_q):
            where, rule = f"{type(self).__name__}.mass_matrix", f"must have shape {(self.n_q,) * 2}"
            raise InvalidInputError(where, rule, M.shape, "Return it as an array, (n_q, n_q).")
        return np.diagonal(M).real.astype(float)

    def _require_the_same(self) -> None:
        """Refuse a function that returns other values than its list, at the start and beside it.

        At the start alone Phi is round-off.
        """
        (q, v), kind, n = self.start(), type(self), np.arange(1.0, self.n_q + 1)
        shares = np.array([0.0, 1e-2, -1e-2])
        Q = q + np.outer(shares, np.cos(n) * (np.max(np.abs(q), initial=0.0) or 1.0))
        V = v + np.outer(shares, np.sin(n) * (np.max(np.abs(v), initial=0.0) or 1.0))
        states = list(zip(shares.tolist(), Q, V, strict=True))
        functions: dict[str, tuple[Value, tuple[int, ...], Callable[..., Any]]] = {
            "mass_matrix": (Formulas.mass, (), lambda t, x, u: self.mass_matrix(x)),
            "force": (Formulas.force, (), lambda t, x, u: kind.force(self, t, x, u)),
            "position_constraint": (
                Formulas.constraint,
                (0,),
                lambda t, x, u: self.position_constraint(t, x),
            ),
        }
        for name in functions.keys() - self._formulas.called.keys():
            of, which, function = functions[name]
            with np.errstate(all="ignore"):
                called = np.array([np.ravel(function(*state)) for state in states])
            listed = self._values(of, *which, rows=len(Q), t=shares[:, None], q=Q, v=V)[0]
            known = np.isfinite(called)
            gap = np.max(np.abs(listed.reshape(called.shape) - called)[known], initial=0.0)
            if not gap <= _SAME * np.max(np.abs(called[known]), initial=0.0):
                raise InvalidInputError(
                    f"{kind.__name__}.{name}",
                    "must return values that follow from t, q, v and b alone",
                    f"other values for numbers than for symbols, by {gap:.1e}",
                    "Keep no state in the system, and convert no arguments.",
                )

    def _found(self) -> SystemProperties:
        """Return the traits with what the formulas show."""
        traits, depends, called = self.traits, self._formulas.depends, self._formulas.called
        linear = traits.linear_constraints or not depends(Formulas.constraint_q, 0, on="q")
        return replace(
            traits,
            constant_mass=traits.constant_mass
            or not ("mass_matrix" in called or depends(Formulas.mass, on="q")),
            linear_constraints=linear,
            velocity_forces=traits.velocity_forces
            and ("force" in called or depends(Formulas.force, on="v")),
        )

    # -- members of the protocol -----------------------------------------------------------------

    def _values(self, of: Value, *which: Any, rows: int | None = None, **at: Any) -> list[Array]:
        return self._formulas.values(of, *which, rows=rows, b=self.b, **at)

    @staticmethod
    def _motion(motion: tuple[Array, ...], sign: str = "") -> dict[str, Any]:
        """Return the parts of a motion by their names."""
        return {f"{sign}{name}": x for name, x in zip(_RATES, motion, strict=False)}

    @property
    def called(self) -> frozenset[str]:
        """Names of the functions that are called at each evaluation, because they need numbers."""
        return frozenset(self._formulas.called)

    def right_side(self) -> tuple[Operations, list[Array], dict[str, Array]]:
        """Return the list, numbers of Q, M, Phi_q and the side of Phi'', and numbers of inputs."""
        return self._formulas.right_side()

    @property
    def index_1(self) -> tuple[OperationList, ...] | None:
        """The lists from which a kernel finds accelerations; None where functions are called."""
        return None if self._formulas.called else self._formulas.index_1

    @cached_property
    def list_plan(self) -> ListPlan | None:
        """The lists that a kernel integrates; None where functions are called, or b is complex."""
        if self._formulas.called or np.iscomplexobj(self.b):
            return None
        velocity = self.traits.velocity_forces
        B, K = (_csr(pattern) for pattern in (self.constraint_pattern, self.pattern))
        weights = self.weights, 1 / self.weights
        return ListPlan(self._formulas.march(velocity), self.b, *weights, B, K, velocity)

    def mass(self, q: Array) -> Array:
        """Return the entries of M row by row."""
        if "mass_matrix" in self._formulas.called:
            return np.asarray(self.mass_matrix(q)).ravel()
        return self._values(Formulas.mass, q=q)[0].ravel()

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Differentiate M along dq."""
        if "mass_matrix" not in self._formulas.called:
            return self._values(Formulas.mass_along, q=q, dq=dq)[0].ravel()
        return self._called_along(lambda system, x: system.mass(x), (q, dq))

    def _force(self, t: float, q: Array, v: Array) -> Array:
        if "force" in self._formulas.called:
            return np.asarray(type(self).force(self, t, q, v))
        return self._values(Formulas.force, t=[t], q=q, v=v)[0]

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Differentiate Q along a direction."""
        dt, dq, dv = direction
        if "force" not in self._formulas.called:
            return self._values(Formulas.force_along, t=[t], q=q, v=v, dt=[dt], dq=dq, dv=dv)[0]
        instant = np.array([t]), np.array([dt])
        return self._called_along(
            lambda system, s, x, u: system.force(s[0], x, u), instant, (q, dq), (v, dv)
        )

    def _called_along(self, value: Callable[..., Array], *pairs: tuple[Array, Array]) -> Array:
        """Differentiate a function that is called, along changes of its arguments.

        Derivatives are linear in the changes, each part of which is a complex step. What is
        imaginary in b or an argument x, a perturbation, adds the difference of its own derivative.
        """
        moving = any(np.iscomplexobj(x) for x in (self.b, *(x for x, _ in pairs)))
        base = self.with_values(self.b.real.copy()) if np.iscomplexobj(self.b) else self

        def step(part: Callable[[Array], Array]) -> Array:
            moved = (np.real(x) + 1j * STEP * part(dx) for x, dx in pairs)
            return np.asarray(np.imag(value(base, *moved)) / STEP)

        along = step(np.real)
        if any(np.iscomplexobj(dx) for _, dx in pairs):
            along = along + 1j * step(np.imag)
        if not moving:
            return along
        changes = scaled_derivative(
            lambda s: np.imag(value(self, *(x + s * np.real(dx) for x, dx in pairs)))
        )
        return np.asarray(along + 1j * changes)

    def force_and_total(self, t: float, q_rows: Array, v_rows: Array) -> Array:
        """Return Q above its total derivatives with respect to the design."""
        if "force" in self._formulas.called:
            return super().force_and_total(t, q_rows, v_rows)
        q, v = q_rows[0], v_rows[0]
        moved = {"dq": q_rows[1:], "dv": v_rows[1:], "db": np.eye(self.n_b)}
        of = Formulas.force_total
        total = self._values(of, rows=self.n_b, t=[t], q=q, v=v, **moved)[0]
        return np.concatenate([self._force(t, q, v)[None], total])

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi or its time derivative."""
        at = self._motion(motion)
        return self._values(Formulas.constraint, len(motion) - 1, t=[t], **at)[0]

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return Phi_q or its time derivative."""
        at = self._motion(motion)
        return self._values(Formulas.constraint_q, len(motion) - 1, t=[t], **at)[0].ravel()

    def constraints_q(self, t: Array, q: Array) -> Array:
        """Return Phi_q at k time points, shape (k, n_lam n_q)."""
        k = len(t)
        return self._values(Formulas.constraint_q, 0, rows=k, t=t[:, None], q=q)[0].reshape(k, -1)

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None = None
    ) -> Array:
        """Return the total derivative of `constraint` with respect to the design."""
        at: dict[str, Any] = {"t": [t], "db": np.eye(self.n_b)}
        at |= {f"d{name}": np.zeros(self.n_q) for name in _RATES[: len(motion)]}
        at |= self._motion(motion)
        if motion_b is not None:
            at |= self._motion(tuple(x_b.T for x_b in motion_b), "d")
        of, order = Formulas.constraint_total, len(motion) - 1
        return self._values(of, order, rows=self.n_b, **at)[0].T

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return the Jacobians of f and Phi at k time points."""
        if self._formulas.called:
            return super().linearise(t, q, v, a, lam)
        with_v = v is not None and self.traits.velocity_forces
        at = {"q": q, "a": a, "lam": lam} | ({} if v is None else {"v": v})
        of, k = Formulas.linearised, len(t)
        found = self._values(of, v is not None, with_v, rows=k, t=t[:, None], **at)
        M, f_q, *f_v, Phi_q = (x.reshape(k, -1) for x in found)
        M = M[:1] if self.traits.constant_mass else M
        return Linearisation(M, f_q, f_v[0] if with_v else None, Phi_q)

    def design_partials(
        self, t: Array, q: Array, v: Array | None, a: Array, lam: Array
    ) -> DesignPartials:
        """Return the partials of f and Phi with respect to the design at k time points."""
        if self._formulas.called:
            return super().design_partials(t, q, v, a, lam)
        at = {"q": q, "a": a, "lam": lam} | ({} if v is None else {"v": v})
        of = Formulas.partials
        return DesignPartials(*self._values(of, v is not None, rows=len(t), t=t[:, None], **at))


@cache
def _full(rows: int, columns: int) -> SparsityPattern:
    return SparsityPattern.full((rows, columns))


def _csr(pattern: SparsityPattern) -> Csr:
    """Return the places of a full pattern, with values of one."""
    rows, columns = pattern.shape
    first = np.arange(rows + 1, dtype=np.int32) * np.int32(columns)
    return first, pattern.columns.astype(np.int32), np.ones(pattern.size)
