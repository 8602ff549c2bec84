"""What the external systems share: constant mass, constraints that do not name the time."""

import numpy as np
import numpy.typing as npt

from ancfdae import OneByOneSystem
from ancfdae.numerics.patterns import Pattern

__all__ = ["Array", "Scleronomic"]

Array = npt.NDArray[np.float64]


class Scleronomic(OneByOneSystem):
    """A mass matrix that nothing changes, constraints Phi(q, b) = 0, forces Q(q, v, b).

    Parameters
    ----------
    mass_matrix : array, shape (n_q, n_q)
        Symmetric; no design variable changes it.
    constraint_names : tuple of str
        One per constraint.
    design_names : tuple of str
    b : array_like, shape (n_b,)
        Values of the design variables.
    """

    constant_mass = True
    linear_constraints = False
    force_round_off = 0.0
    project_start = False
    naming = None

    def __init__(
        self,
        mass_matrix: Array,
        constraint_names: tuple[str, ...],
        design_names: tuple[str, ...],
        b: npt.ArrayLike,
    ) -> None:
        self._M = mass_matrix
        self.n_q, self.n_lam, self.n_b = len(mass_matrix), len(constraint_names), len(design_names)
        self.constraint_names, self.design_names = constraint_names, design_names
        self.b = np.asarray(b)
        self.weights = np.diag(mass_matrix).copy()
        self.pattern = Pattern.full((self.n_q, self.n_q))
        self.constraint_pattern = Pattern.full((self.n_lam, self.n_q))

    def mass(self, q: Array) -> Array:
        """Return M."""
        return self._M.ravel()

    def mass_times(self, q: Array, x: Array) -> Array:
        """Return M x."""
        product: Array = self._M @ x
        return product

    def mass_b_times(self, q: Array, a: Array) -> Array:
        """Return zero."""
        return np.zeros((self.n_q, self.n_b))

    def inertia_q(self, q: Array, a: Array) -> Array:
        """Return zero."""
        return np.zeros(self.n_q**2)

    def inertia_rate_total(
        self, q: Array, v: Array, a: Array, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return zero."""
        return np.zeros((self.n_q, self.n_b))

    def velocity_side(self, q: Array, t: float) -> Array:
        """Return zero."""
        return np.zeros(self.n_lam)

    def velocity_side_total(self, q: Array, t: float, q_b: Array) -> Array:
        """Return zero."""
        return np.zeros((self.n_lam, self.n_b))

    def constraint_force_b(self, q: Array, lam: Array, t: float) -> Array:
        """Return zero: no design variable stands in Phi_q."""
        return np.zeros((self.n_q, self.n_b))
