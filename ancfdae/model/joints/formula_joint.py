"""Joints whose equations are any smooth functions of vectors of points, parameters and time."""

import abc
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.model.joints.joint import Joint, JointEquations, empty_equations
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array


class FormulaJoint(Joint):
    """A joint given by formulas, Phi(U, p, reference, laws) = 0.

    When equations of motion are assembled, `equations` is called with arrays of symbols instead of
    numbers and recorded as a list of operations; all derivatives that statics, integrators and
    gradients need are derived from the list. The formulas may use all functions of NumPy that are
    smooth where the mechanism moves, and call an `ExternalFunction`, for example a table with its
    derivative.
    """

    #: Number of equations.
    equation_count: ClassVar[int] = 1

    @abc.abstractmethod
    def equations(self, U: Array, p: Array, reference: Array, laws: Array) -> Any:
        """Return the `equation_count` residuals, which vanish where the joint is closed.

        U are the vectors, (n_vectors, d), and `reference` the same vectors in the reference
        configuration. p holds the values of `parameters`, as `split` takes them. `laws` are the
        values, at the time of U, of the design fields that hold a `Law`, in their order.
        """

    def row_count(self, d: int) -> int:
        """Return the number of equations in d dimensions, `equation_count` by default."""
        return self.equation_count

    @final
    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return zero coefficients: the formulas are the whole equations."""
        return empty_equations(self.row_count(reference.shape[1]), p, reference)

    @final
    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return zero coefficients for each law: the formulas are the whole equations."""
        return (self.coefficients(p, reference),) * len(self.laws)

    @final
    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the laws at times t, or a time derivative of them, shape (n_laws, k)."""
        values = [law.derivative(p[at], t, order) for law, at in self.laws]
        return np.array(values).reshape(len(values), len(t))

    @property
    def laws(self) -> list[tuple[Law, slice]]:
        """Laws among the design fields, each with the slice of its numbers in p."""
        values, (places, _) = self._design_values(), self.design_places
        pairs = zip(values, places, strict=True)
        return [(x, at) for (_, x), at in pairs if isinstance(x, Law) and isinstance(at, slice)]

    @property
    def driven(self) -> bool:
        """Whether the joint has a law of time."""
        return len(self.laws) > 0
