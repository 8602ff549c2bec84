"""Joints whose equations are any smooth functions of vectors of points, parameters and time."""

import abc
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.model.joints.joint import Joint, JointEquations, empty_equations
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array


class FormulaJoint(Joint):
    """A joint that is given by formulas, Phi(U, p, reference, laws) = 0.

    Its `equations` are called with arrays of symbols in place of numbers when equations of motion
    are assembled, and become lists of operations; all derivatives that statics, integrators and
    gradients need are taken of these. They may be any functions of NumPy that are smooth where the
    mechanism moves, and call an `ExternalFunction`, for example of a table with its derivative.
    """

    #: Number of equations.
    equation_count: ClassVar[int] = 1

    @abc.abstractmethod
    def equations(self, U: Array, p: Array, reference: Array, laws: Array) -> Any:
        """Return the equations, `equation_count` numbers that vanish where the joint is closed.

        U are the vectors, (n_vectors, d), and `reference` the same in the reference configuration.
        p has the values of `parameters`, as `split` takes them. `laws` are the values of those
        design fields that hold a `Law`, in their order, at the time at which U is met.
        """

    def row_count(self, d: int) -> int:
        """Return the number of equations in d dimensions; `equation_count` by default."""
        return self.equation_count

    @final
    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return coefficients of zero: all stands in the formulas."""
        return empty_equations(self.row_count(reference.shape[1]), p, reference)

    @final
    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return coefficients of zero for each law."""
        return (self.coefficients(p, reference),) * len(self.laws)

    @final
    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the laws, or their time derivatives, (n_laws, k)."""
        values = [law.derivative(p[at], t, order) for law, at in self.laws]
        return np.array(values).reshape(len(values), len(t))

    @property
    def laws(self) -> list[tuple[Law, slice]]:
        """Fields of the design that hold a law, with places of their numbers in p."""
        values, (places, _) = self._design_values(), self.design_places
        pairs = zip(values, places, strict=True)
        return [(x, at) for (_, x), at in pairs if isinstance(x, Law) and isinstance(at, slice)]

    @property
    def driven(self) -> bool:
        """Whether a law moves the joint."""
        return len(self.laws) > 0
