"""Energies and momenta of a scene and of its parts; instants are rows."""

from collections.abc import Callable
from typing import final

import numpy as np

from ancfdae.assembly.elastic_forces import ElasticForces
from ancfdae.assembly.inertia import Inertia
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.numbering import Numbering
from ancfdae.numerics.arrays import Array


@final
class Energies:
    """Strain and kinetic energy of everything, or of one owner: a beam, a body, a point mass.

    The layout knows the owners by name. `places`, shape (n_q / d,), is one for vectors that are
    positions, zero for slopes. `centrifugal` is the potential of a turning frame.
    """

    def __init__(
        self,
        elastic: ElasticForces,
        inertia: Inertia,
        numbering: Numbering,
        layout: Layout,
        centrifugal: Callable[[Array], Array] | None = None,
    ) -> None:
        self._centrifugal, self._of_states = centrifugal, numbering.d * len(numbering.masses)
        self._elastic, self._inertia = elastic, inertia
        self._owners, self._layout, self.places = numbering.owners, layout, inertia.positions

    def strain(self, q: Array, owner: str | None = None) -> Array:
        """Return the strain energy, shape (k,)."""
        return self._elastic.energies(q) @ self._chosen(owner)

    def strain_q(self, q: Array, owner: str | None = None) -> Array:
        """Return the gradient of `strain`, shape (k, n_q)."""
        return self._elastic.energy_q(q, self._chosen(owner))

    def strain_b(self, q: Array, owner: str | None = None) -> Array:
        """Return the design partial of `strain`, shape (k, n_b)."""
        return self._elastic.energy_b(q, self._chosen(owner))

    def kinetic(self, v: Array, owner: str | None = None) -> Array:
        """Return the kinetic energy (eq. 9), shape (k,)."""
        return 0.5 * np.sum(v * self.momenta(v, owner), axis=1)

    def momenta(self, v: Array, owner: str | None = None) -> Array:
        """Return M v, the gradient of `kinetic`, shape (k, n_q)."""
        if owner is None:
            p = self._inertia.times(v.T).T
            p[:, len(p.T) - self._of_states :] = 0.0  # Their masses are no masses of bodies.
            return p
        return self._inertia.owner_times(v, self._layout.owner(owner))

    def kinetic_b(self, v: Array, owner: str | None = None) -> Array:
        """Return the design partial of `kinetic`, shape (k, n_b)."""
        number = None if owner is None else self._layout.owner(owner)
        return 0.5 * self._inertia.quadratic_b(v, number)

    def gravity(self, q: Array) -> Array:
        """Return the potential of gravity, zero at q = 0, shape (k,)."""
        return -np.asarray(q @ self._inertia.gravity)

    def gravity_b(self, q: Array) -> Array:
        """Return the design derivatives of the potential of gravity, shape (k, n_b)."""
        return -np.asarray(q @ self._inertia.gravity_b)

    def total(self, q: Array, v: Array) -> Array:
        """Return kinetic and strain energy and the potentials together, shape (k,)."""
        total = self.kinetic(v) + self.strain(q) + self.gravity(q)
        return total if self._centrifugal is None else total + self._centrifugal(q)

    def _chosen(self, owner: str | None) -> Array:
        """One for the elements of an owner, or for all, that deform, shape (n,)."""
        if owner is None:
            return np.ones(len(self._owners))
        return np.asarray(self._owners == self._layout.owner(owner), dtype=float)
