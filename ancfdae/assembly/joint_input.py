"""The numeric data of one joint, and the equations of a `FormulaJoint` as lists of operations.

Such equations are called once, with symbols for the vectors U and the inputs z: parameters,
reference vectors and values of laws. `kernels/constraint_plan.h` says which lists follow from
Phi(U, z).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import OperationList
from ancfdae.model.joints.joint import FormulaJoint, Joint, JointEquations
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.operations import TRACE_FAILURES, Operations, Traced, told


@final
@dataclass(frozen=True)
class JointInput:
    """One joint with its parameters, (n_p,), reference vectors, (n_vectors, d), and partials.

    `reference_b` holds the design derivatives of the reference vectors by design variable. The
    equations `dropped` are left out. `alike` caches the equations of joints of one kind with the
    same numbers.
    """

    joint: Joint
    p: Array
    p_b: Array
    reference: Array
    reference_b: dict[int, Array]
    dropped: tuple[int, ...] = ()
    alike: dict[object, tuple[Joint, list[JointEquations]]] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def kind(self) -> tuple[object, ...]:
        """Cache key of a joint's coefficients: equal for joints of one class with equal numbers."""
        joint, p, numbers = self.joint, self.p, self.reference
        which: tuple[object, ...] = (joint.name,)
        if joint.by_slopes:
            places = {(x.beam, x.fraction, x.before) for x in joint.points}
            which, numbers = (type(joint), len(places)), numbers[len(joint.points) :]
        return (*which, p.dtype, p.tobytes(), numbers.dtype, numbers.tobytes(), self.dropped)

    @cached_property
    def parts(self) -> list[JointEquations]:
        """Joint coefficients constant in time, then those multiplied by each factor of time."""
        joint, p, reference = self.joint, self.p, self.reference
        if self.kind in self.alike:
            other, parts = self.alike[self.kind]
            if other is not joint and any(c.shapes for c in parts):
                parts = [c.at_points(other.points, joint.points) for c in parts]
            return parts
        if self.dropped:
            parts = [c.without(self.dropped) for c in replace(self, dropped=()).parts]
        else:
            parts = [joint.checked_coefficients(p, reference), *joint.moving(p, reference)]
        self.alike[self.kind] = joint, parts
        return parts

    @property
    def input_count(self) -> int:
        """Number of inputs of formulas: parameters, reference vectors, and laws; 0 without.

        A joint by formulas from which an equation is left out has no other.
        """
        if not isinstance(self.joint, FormulaJoint) or self.dropped:
            return 0
        return len(self.p) + self.reference.size + len(self.joint.laws)

    def inputs(self) -> Array:
        """Return the inputs of all parts, (n_parts, input_count); a law is 1 in its own part."""
        laws, count = len(self.parts) - 1, self.input_count
        inputs = np.zeros((1 + laws, count), np.result_type(self.p, self.reference))
        if count:
            inputs[0, : count - laws] = np.concatenate([self.p, self.reference.ravel()])
            inputs[1:, count - laws :] = np.eye(laws)
        return inputs

    @property
    def active(self) -> set[int]:
        """Design variables on which the coefficients may depend."""
        return {*np.flatnonzero(np.any(self.p_b, axis=0)).tolist(), *self.reference_b}

    def moved(self, i: int) -> JointInput:
        """Return the joint with design variable i perturbed by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        return replace(self, p=p, reference=reference, alike={})

    def structure(self) -> JointEquations:
        """Return joint coefficients whose zeros are zero for all parameters and times."""
        # Generic parameters: a coefficient that is not zero by structure is nonzero here.
        p = self.p * (1 + 1j * STEP) + 1j * STEP * np.sqrt(1.0 + np.arange(len(self.p)))
        reference = self.reference + 1j * STEP * sum(self.reference_b.values())
        parts = [*self.parts, *replace(self, p=p, reference=reference).parts]
        linear, bilinear = (
            np.asarray(sum(np.abs(x.real) + np.abs(x.imag) for x in coefficients))
            for coefficients in ([c.linear for c in parts], [c.bilinear for c in parts])
        )
        return JointEquations(linear, bilinear, parts[0].offset)


# Orders of time derivatives of Phi and Phi_U, and of Phi_z and the curvature.
_ORDERS, _FIRST_ORDERS = 4, 2
# Relative change of design values (absolute for zeros) under which a formula must stay the same.
_OTHER = 2.0**-20
# Largest difference between a list and the formula, relative to the largest term.
_SAME = 1e-9


@final
class FormulaTrace:
    """Recorder of the equations of one joint as operations; inputs are U, z, rates, and lam."""

    def __init__(self, item: JointInput) -> None:
        joint = item.joint
        assert isinstance(joint, FormulaJoint)
        self._joint, self._item, self._n_u = joint, item, item.reference.size
        self._size, self._rows = (
            self._n_u + item.input_count,
            joint.row_count(item.reference.shape[1]),
        )
        ahead = _ORDERS * self._size
        self._operations = Operations(ahead + self._rows)
        self._states = np.arange(ahead).reshape(_ORDERS, self._size)
        self._lam = ahead + np.arange(self._rows)
        # Parameters and vectors of the reference have no rates.
        moving = np.r_[: self._n_u, self._size - len(joint.laws) : self._size]
        self._motion = {
            int(x): int(rate)
            for before, after in pairwise(self._states[:, moving])
            for x, rate in zip(before, after, strict=True)
        }

    def lists(self, known: dict[object, tuple[OperationList, ...]]) -> tuple[OperationList, ...]:
        """Return the lists of Phi, Phi_U, Phi_z and (Phi_U^T lam)_U, with time derivatives.

        Joints with the same operations on the same inputs share the lists in `known`.
        """
        Phi = self._numbers(self._joint)
        self._require_parameters(Phi)
        key: object = self  # Functions that are called are not compared.
        if not self._operations.calls(Phi):
            inputs = self._states.shape, self._item.reference.shape, *self._motion
            key = inputs, *(x.tobytes() for x in self._operations.arrays(Phi))
        made = known.get(key) or known.setdefault(key, self._made(Phi))
        self._require_the_same(made[0])
        return made

    def _made(self, Phi: Array) -> tuple[OperationList, ...]:
        n, by_all = self._n_u, self._by(Phi, self._states[0])
        gradient = Traced.numbers(
            self._operations, self._traced(self._lam) @ self._traced(by_all[:, :n])
        )
        curvature = self._by(gradient, self._states[0, :n])
        # Symmetric to the last bit.
        lower = np.tril_indices(n)
        curvature[lower] = curvature.T[lower]
        return (
            *self._rates(Phi, _ORDERS),
            *self._rates(by_all[:, :n], _ORDERS),
            *self._rates(by_all[:, n:], _FIRST_ORDERS),
            *self._rates(curvature, _FIRST_ORDERS, lam=True),
        )

    def _rates(self, values: Array, orders: int, lam: bool = False) -> list[OperationList]:
        """Return the lists of `values` and of their time derivatives up to orders - 1."""
        made, more = list[OperationList](), self._lam.tolist() if lam else []
        for order in range(orders):
            inputs = self._states[: order + 1].ravel().tolist() + more
            made.append(self._operations.compiled(values.ravel(), inputs))
            if order + 1 < orders:
                values = self._operations.along(values, self._motion)[0]
        return made

    def _by(self, values: Array, inputs: Array) -> Array:
        """Return operations for partials of `values` in `inputs`, (len(values), len(inputs))."""
        zero = self._operations.constant(0.0)
        each = (self._operations.partials(x) for x in values.tolist())
        rows = [[partials.get(x, zero) for x in inputs.tolist()] for partials in each]
        return np.array(rows, dtype=np.int64).reshape(len(values), len(inputs))

    def _numbers(self, joint: FormulaJoint) -> Array:
        """Return the recorded operations of the equations of a joint, shape (n_rows,)."""
        reference, (U, z) = self._item.reference, self._parts(self._traced(self._states[0]))
        n_p, where = len(self._item.p), f"equations of joint {joint.name!r}"
        parts = z[:n_p], z[n_p : n_p + self._n_u].reshape(reference.shape), z[n_p + self._n_u :]
        try:
            found = joint.equations(U, *parts)
            numbers = Traced.numbers(self._operations, found).ravel()
        except InvalidInputError:
            raise
        except TRACE_FAILURES as error:
            raise InvalidInputError(
                where,
                "must be smooth functions of NumPy, which are called with symbols",
                f"code that cannot be: {told(error)}".rstrip("."),
                "Call what needs numbers as an ExternalFunction.",
            ) from error
        if len(numbers) != self._rows:
            rule = f"must be as many as `equation_count`, {self._rows}"
            repair = "Set `equation_count` of the class."
            raise InvalidInputError(where, rule, len(numbers), repair)
        return numbers

    def _parts(self, state: Array) -> tuple[Array, Array]:
        """Return the vectors U, (n_vectors, d), and the inputs z of a state."""
        return state[: self._n_u].reshape(self._item.reference.shape), state[self._n_u :]

    def _traced(self, numbers: Array) -> Array:
        return Traced.array(self._operations, numbers)

    def _require_parameters(self, Phi: Array) -> None:
        """Raise InvalidInputError for equations that read design fields of the joint itself.

        These would keep their values when the design changes. Also for equations that differ from
        call to call.
        """
        joint = self._joint
        if not np.array_equal(self._numbers(joint), Phi):
            raise self._no_function("other equations at the second call")
        moved = {x: y + _OTHER * (abs(y) or 1.0) for x, y in joint.parameters().items()}
        try:
            other = joint.with_parameters(moved)
        except InvalidInputError:
            return  # The joint does not admit these values.
        if not np.array_equal(self._numbers(other), Phi):
            raise InvalidInputError(
                f"equations of joint {joint.name!r}",
                "must take the values of design fields from p and `laws`",
                "equations that change with fields of the joint at the same p",
                "Write, for example, `radius, _ = self.split(p)`.",
            )

    def _require_the_same(self, Phi: OperationList) -> None:
        """Raise InvalidInputError if recorded equations and direct calls give different values."""
        item, joint = self._item, self._joint
        p, reference, laws = (
            item.p.real,
            item.reference.real,
            item.joint.factors(item.p, np.zeros(1), 0).real,
        )
        with np.errstate(all="ignore"):
            called = joint.equations(reference.copy(), p.copy(), reference.copy(), laws[:, 0])
        state = np.concatenate([reference.ravel(), p, reference.ravel(), laws[:, 0]])
        listed, called = Phi.values(state), np.ravel(np.asarray(called, dtype=float))
        beside = Phi.values(state * (1 + _OTHER))
        known = np.isfinite(called) & np.isfinite(beside)
        # Equations that hold leave round-off; their size is their change with the state.
        gap, size = np.abs(listed - called)[known], np.abs(called)[known]
        size = np.max(np.maximum(size, np.abs(beside[known] - listed[known]) / _OTHER), initial=0.0)
        if np.any(gap > _SAME * size):
            got = f"other values for numbers than for symbols, by {np.max(gap):.1e}"
            raise self._no_function(got)

    def _no_function(self, got: str) -> InvalidInputError:
        where = f"equations of joint {self._joint.name!r}"
        rule = "must follow from U, p, reference and laws alone"
        return InvalidInputError(
            where, rule, got, "Keep no state in the joint, and convert no arguments."
        )
