"""Mechanical systems of a user, given by formulas for M, Q, Phi and the start.

The formulas run once, on tracers, and become lists of operations that a kernel evaluates with all
their derivatives (`ancfdae.equations.formulas`). Formulas that need a number where a tracer has
none are called in complex numbers instead (`ancfdae.equations.called_back`).
"""

from __future__ import annotations

import traceback
import warnings
from contextvars import ContextVar
from dataclasses import replace
from functools import cached_property, wraps
from pathlib import Path
from typing import Any

import numpy as np

from ancfdae.equations.analytic import require_analytic, require_start
from ancfdae.equations.called_back import CalledBack
from ancfdae.equations.complex_steps import FORGOTTEN
from ancfdae.equations.formulas import Formulas, Value
from ancfdae.equations.motion import Direction
from ancfdae.equations.system import DesignPartials, Linearisation, Traits
from ancfdae.errors import InvalidInput, NotTraced
from ancfdae.kernels import Csr, ListPlan, OperationList
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.operations import NotTraceable
from ancfdae.numerics.patterns import Pattern

# What a motion consists of.
_RATES = ("q", "v", "a", "j")
# Kinds of systems whose formulas are being traced.
_TRACING: ContextVar[frozenset[type]] = ContextVar("_TRACING", default=frozenset())
# Kind and formulas of the system whose `with_values` runs; formulas are None if not traceable.
_HANDED: ContextVar[tuple[type, Formulas | None] | None] = ContextVar("_HANDED", default=None)
# Largest difference between values of a list and of the functions, relative to the largest value.
_SAME = 1e-9


class FormulaSystem(CalledBack):
    """A system that is given by formulas for M, Q, Phi and its start.

    Subclasses set `n_q`, `n_lam` and `design_names`, implement `mass_matrix`, `force`,
    `position_constraint`, `start` and `with_values`, and call ``super().__init__(b)`` at the end
    of their own constructor. The first three are smooth functions of q, v, t and ``self.b`` in
    functions of NumPy. They are called once, with arrays of symbols in place of numbers, and
    become lists of operations that are evaluated at compiled speed. If one of them needs a number
    (`if`, a table, `np.linalg.solve`), a warning (`NotTraced`) names the line, and all three are
    called with complex numbers at each evaluation: some hundred times slower. `start` is called
    with complex ``self.b``. Any partial may be overridden by a formula of the user; `check_system`
    compares.

    Whether M is constant, Phi linear and Q independent of v is found from the formulas and added
    to `traits`.

    Parameters
    ----------
    b : sequence of number, shape (n_b,)
        Values of the design variables.

    Raises
    ------
    InvalidInput
        If a method returns another shape, if a method that is called with complex numbers does not
        accept them or drops an imaginary part, or if a weight is not positive.
    """

    _formulas: Formulas | None = None

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
            token = _HANDED.set((type(self), self._formulas))
            try:
                return written(self, b)
            finally:
                _HANDED.reset(token)

        cls.with_values = with_values  # type: ignore[assignment]

    def __init__(self, b: Array | tuple[complex, ...]) -> None:
        if np.asarray(b).dtype == object:
            self.b = np.asarray(b)  # Its formulas are being traced.
        else:
            super().__init__(b)

    def _prepare(self) -> None:
        """Trace the formulas, or require that complex numbers can replace tracers."""
        handed, kind = _HANDED.get(), type(self)
        if handed is not None and handed[0] is kind:
            self._formulas = handed[1]
        else:
            self._trace()
        if self._formulas is not None:
            self.traits = self._found()
        # In place of the method of the same name, which is the formula.
        vars(self)["force"] = self._force

    def _trace(self) -> None:
        """Trace the formulas; without success say why, and try complex numbers."""
        kind, tracing = type(self), _TRACING.get()
        if kind in tracing:
            raise InvalidInput(f"{kind.__name__}.with_values", *FORGOTTEN)
        token = _TRACING.set(tracing | {kind})
        self._formulas, why = None, ""
        try:
            require_start(self)
            self._formulas = Formulas(self)
            self._require_the_same()
        except InvalidInput:
            raise
        except (NotTraceable, TypeError, ValueError, AttributeError, ArithmeticError) as error:
            why = _told(error)
        finally:
            _TRACING.reset(token)
        if not why:
            return
        self._formulas = None
        message = (
            f"{kind.__name__} is evaluated in Python, some hundred times slower than a list of "
            f"operations: {why}"
        )
        try:
            require_analytic(self)
        except InvalidInput as error:
            error.add_note(message)
            raise
        warnings.warn(message, NotTraced, stacklevel=5)

    def _require_the_same(self) -> None:
        """Refuse a function that returns other values than its list, near the start."""
        (q, v), kind = self.start(), type(self)
        n = np.arange(1.0, self.n_q + 1)
        for t in (0.0, 1e-2, -1e-2):
            x = q + t * np.cos(n) * (np.max(np.abs(q), initial=0.0) or 1.0)
            u = v + t * np.sin(n) * (np.max(np.abs(v), initial=0.0) or 1.0)
            with np.errstate(all="ignore"):
                pairs = {
                    "mass_matrix": (self.mass(x), self.mass_matrix(x)),
                    "force": (self._force(t, x, u), kind.force(self, t, x, u)),
                    "position_constraint": (self.constraint(t, x), self.position_constraint(t, x)),
                }
            for name, (listed, value) in pairs.items():
                called = np.ravel(value)
                known = np.isfinite(called)
                gap = np.max(np.abs(listed - called)[known], initial=0.0)
                if not gap <= _SAME * np.max(np.abs(called[known]), initial=0.0):
                    raise InvalidInput(
                        f"{kind.__name__}.{name}",
                        "must return values that follow from t, q, v and b alone",
                        f"other values for numbers than for symbols, by {gap:.1e}",
                        "Keep no state in the system, and convert no arguments.",
                    )

    def _found(self) -> Traits:
        """Return the traits with what the formulas show."""
        formulas, traits = self._formulas, self.traits
        assert formulas is not None
        depends = formulas.depends
        linear = traits.linear_constraints or not depends(Formulas.constraint_q, 0, on="q")
        return replace(
            traits,
            constant_mass=traits.constant_mass or not depends(Formulas.mass, on="q"),
            linear_constraints=linear,
            velocity_forces=traits.velocity_forces and depends(Formulas.force, on="v"),
        )

    # -- members of the protocol -----------------------------------------------------------------

    def _values(self, of: Value, *which: Any, rows: int | None = None, **at: Any) -> list[Array]:
        assert self._formulas is not None
        return self._formulas.values(of, *which, rows=rows, b=self.b, **at)

    @staticmethod
    def _motion(motion: tuple[Array, ...], sign: str = "") -> dict[str, Any]:
        """Return the parts of a motion by their names."""
        return {f"{sign}{name}": x for name, x in zip(_RATES, motion, strict=False)}

    @property
    def index_1(self) -> tuple[OperationList, ...] | None:
        """What accelerations follow from; None where functions are called."""
        return None if self._formulas is None else self._formulas.index_1

    @cached_property
    def list_plan(self) -> ListPlan | None:
        """What a kernel marches; None where functions are called, or b is complex."""
        if self._formulas is None or np.iscomplexobj(self.b):
            return None
        velocity = self.traits.velocity_forces
        B, K = (_csr(pattern) for pattern in (self.constraint_pattern, self.pattern))
        weights = self.weights, 1 / self.weights
        return ListPlan(self._formulas.march(velocity), self.b, *weights, B, K, velocity)

    def mass(self, q: Array) -> Array:
        """Return the entries of M row by row."""
        if self._formulas is None:
            return super().mass(q)
        return self._values(Formulas.mass, q=q)[0].ravel()

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Differentiate M along dq."""
        if self._formulas is None:
            return super().mass_along(q, dq)
        return self._values(Formulas.mass_along, q=q, dq=dq)[0].ravel()

    def _force(self, t: float, q: Array, v: Array) -> Array:
        if self._formulas is None:
            return np.asarray(type(self).force(self, t, q, v))
        return self._values(Formulas.force, t=[t], q=q, v=v)[0]

    def force_along(self, t: float, q: Array, v: Array, direction: Direction) -> Array:
        """Differentiate Q along a direction."""
        if self._formulas is None:
            return super().force_along(t, q, v, direction)
        dt, dq, dv = direction
        return self._values(Formulas.force_along, t=[t], q=q, v=v, dt=[dt], dq=dq, dv=dv)[0]

    def force_and_total(self, t: float, q_rows: Array, v_rows: Array) -> Array:
        """Return Q above its total derivatives with respect to the design."""
        if self._formulas is None:
            return super().force_and_total(t, q_rows, v_rows)
        q, v = q_rows[0], v_rows[0]
        moved = {"dq": q_rows[1:], "dv": v_rows[1:], "db": np.eye(self.n_b)}
        of = Formulas.force_total
        total = self._values(of, rows=self.n_b, t=[t], q=q, v=v, **moved)[0]
        return np.concatenate([self._force(t, q, v)[None], total])

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi or its time derivative."""
        if self._formulas is None:
            return super().constraint(t, *motion)
        at = self._motion(motion)
        return self._values(Formulas.constraint, len(motion) - 1, t=[t], **at)[0]

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return Phi_q or its time derivative."""
        if self._formulas is None:
            return super().constraint_q(t, *motion)
        at = self._motion(motion)
        return self._values(Formulas.constraint_q, len(motion) - 1, t=[t], **at)[0].ravel()

    def constraints_q(self, t: Array, q: Array) -> Array:
        """Return Phi_q at k instants, shape (k, n_lam n_q)."""
        if self._formulas is None:
            return super().constraints_q(t, q)
        k = len(t)
        return self._values(Formulas.constraint_q, 0, rows=k, t=t[:, None], q=q)[0].reshape(k, -1)

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None = None
    ) -> Array:
        """Return the total derivative of `constraint` with respect to the design."""
        if self._formulas is None:
            return super().constraint_total(t, motion, motion_b)
        at: dict[str, Any] = {"t": [t], "db": np.eye(self.n_b)}
        at |= {f"d{name}": np.zeros(self.n_q) for name in _RATES[: len(motion)]}
        at |= self._motion(motion)
        if motion_b is not None:
            at |= self._motion(tuple(x_b.T for x_b in motion_b), "d")
        of, order = Formulas.constraint_total, len(motion) - 1
        return self._values(of, order, rows=self.n_b, **at)[0].T

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return the Jacobians of f and Phi at k instants."""
        if self._formulas is None:
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
        """Return the partials of f and Phi with respect to the design at k instants."""
        if self._formulas is None:
            return super().design_partials(t, q, v, a, lam)
        at = {"q": q, "a": a, "lam": lam} | ({} if v is None else {"v": v})
        of = Formulas.partials
        return DesignPartials(*self._values(of, v is not None, rows=len(t), t=t[:, None], **at))


def _csr(pattern: Pattern) -> Csr:
    """Return the places of a full pattern, with values of one."""
    rows, columns = pattern.shape
    first = np.arange(rows + 1, dtype=np.int32) * np.int32(columns)
    return first, pattern.columns.astype(np.int32), np.ones(pattern.size)


def _told(error: Exception) -> str:
    """Return the line of a user's code at which tracing ended, and why."""
    own = str(Path(np.__file__).parent), str(Path(__file__).parents[1])
    frames = traceback.extract_tb(error.__traceback__)
    lines = [x for x in frames if not x.filename.startswith(own)]
    known = isinstance(error, NotTraceable)
    why = f"asks for {error}" if known else f"fails on symbols ({type(error).__name__}: {error})"
    if not lines:
        return why
    last = lines[-1]
    return f"line {last.lineno} of {Path(last.filename).name}, `{last.line}`, {why}."
