"""What the external systems share: constant mass, constraints that do not name the time."""

import numpy as np
import numpy.typing as npt

from ancfdae.extend import MechanicalSystem, SystemProperties
from ancfdae.numerics.arrays import Array


class Scleronomic(MechanicalSystem):
    """A mass matrix that nothing changes, constraints Phi(q, b) = 0, forces Q(q, v, b).

    The mass matrix is symmetric, shape (n_q, n_q); each constraint and each design variable has a
    name; `b` holds the values of the design variables.
    """

    traits = SystemProperties(constant_mass=True)

    def __init__(
        self,
        mass_matrix: Array,
        constraint_names: tuple[str, ...],
        design_names: tuple[str, ...],
        b: npt.ArrayLike,
    ) -> None:
        self._M = mass_matrix
        self.n_q, self.n_lam = len(mass_matrix), len(constraint_names)
        self.constraint_names, self.design_names = constraint_names, design_names
        self.b = np.asarray(b)

    def mass(self, q: Array) -> Array:
        """Return the mass matrix M, shape (n_q, n_q)."""
        return self._M.ravel()
