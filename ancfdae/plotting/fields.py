"""Fields that colour a mechanism: numbers at the points of its meshes at every time."""

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.section_results import StressPoints
from ancfdae.equations import Solution
from ancfdae.errors.checks import require_text
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.elements import ElementParameter, elastic
from ancfdae.model.elements.invariants import prepare
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.shapes import BeamMesh, Mesh

# Of the forces and moments in a section, as `SectionLaw.forces` has them.
_AXIAL, _TORQUE = 0, 3


class Field(abc.ABC):
    """A number at every point of a mesh: the base of what pictures are coloured by.

    Attributes
    ----------
    label : str
        Quantity and unit.
    signed : bool
        Whether its sign counts, so that colours part at zero.
    """

    signed = False

    @property
    @abc.abstractmethod
    def label(self) -> str:
        """Quantity with its unit, for the colour bar."""

    @abc.abstractmethod
    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Return the values at the instants of a solution, shape (k, n); NaN where there are none.

        Raises
        ------
        InvalidInputError
            If the solution or the element lacks what the field is made of.
        """


class _OfBeams(Field):
    """A field that only beams that deform have."""

    @final
    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Values of `on_beam` at the points of a mesh, (k, n points); NaN for rigid bodies."""
        if not isinstance(mesh, BeamMesh) or mesh.elements is None:
            return np.full(mesh.places(motion.q).shape[:2], np.nan)
        values = np.broadcast_to(self.on_beam(mesh, motion), (len(motion.t), *mesh.shape))
        return values.reshape(len(motion.t), -1)

    @abc.abstractmethod
    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Return the field, shape (k, n elements, n stations, n fibres) or broadcast to it."""


@final
@dataclass(frozen=True)
class StrainEnergyDensity(_OfBeams):
    """Strain energy over volume, the mean over each element; J/m^3."""

    label = "strain energy density [J/m³]"

    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Energy of each element over its volume."""
        elements = mesh.elements
        assert elements is not None
        law = prepare(elements.element, elements.batch)
        Y = elements.relative(motion.q[:, elements.coordinates])
        energy = elastic.energy(law.A, law.g_o, Y, law.bending)
        # m holds the mass of an element as what moves with both of its positions.
        positions = slice(None, None, elements.element.n_s)
        mass = law.m[:, positions, positions].sum(axis=(1, 2))
        density: Array = energy * elements.batch.parameters[:, ElementParameter.DENSITY] / mass
        return density[..., None, None]


@final
@dataclass(frozen=True)
class VonMisesStress(_OfBeams):
    """Von Mises' stress as the observable `von_mises` has it; Pa."""

    label = "von Mises stress [Pa]"

    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Stresses at all points."""
        elements = mesh.elements
        assert elements is not None
        points = StressPoints(elements, mesh.xi, lambda _: (mesh.y, mesh.z))
        n, n_xi, n_f = mesh.shape
        stress = points.value(motion.q, motion.v).reshape(len(motion.t), n, n_f, n_xi)
        return stress.swapaxes(2, 3)


class _SectionForce(_OfBeams):
    """A force or moment of the section."""

    signed = True

    @property
    @abc.abstractmethod
    def component(self) -> int:
        """Index of the component in the vector of section forces."""

    @final
    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Return the section force, the same at all fibres of a section."""
        return section_forces(mesh, motion)[..., [self.component]]


@final
@dataclass(frozen=True)
class AxialForce(_SectionForce):
    """Axial force, positive in tension, as the observable `axial_force`; N."""

    component = _AXIAL
    label = "axial force [N]"


@final
@dataclass(frozen=True)
class BendingMoment(_SectionForce):
    """Bending moment, as the observable `bending_moment`; N m.

    Parameters
    ----------
    about : int
        2 for the width of the section, the z axis of a planar scene, and 1 for its height.
    """

    about: int = 2

    def __post_init__(self) -> None:
        if self.about not in (1, 2):
            raise InvalidInputError(
                "BendingMoment, about", "must be 1 or 2", repr(self.about), "2 is the width."
            )

    @property
    def component(self) -> int:
        """Index of M_y or M_z in the vector of section forces."""
        return _TORQUE + self.about

    label = "bending moment [N m]"


@final
@dataclass(frozen=True)
class Speed(Field):
    """Size of the velocity; m/s."""

    label = "speed [m/s]"

    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Size of the velocity of every point."""
        return np.asarray(np.linalg.norm(mesh.velocities(motion.q, motion.v), axis=-1))


@final
@dataclass(frozen=True)
class Sensitivity(Field):
    """How far a change of a design variable moves each point: |dr/db|, of a material point.

    Parameters
    ----------
    variable : str
        Name of a design variable of the solution, which must come from `differentiate`.
    """

    variable: str

    def __post_init__(self) -> None:
        require_text("Sensitivity, variable", self.variable)

    @property
    def label(self) -> str:
        """Quantity with its unit, for the colour bar."""
        return f"|dr/db|, b = {self.variable} [m per unit of b]"

    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Size of the derivative of every place."""
        number = motion.design_index(self.variable)
        assert motion.sensitivities is not None  # as was just seen
        q_b = motion.sensitivities.q_b[..., number]
        return np.asarray(np.linalg.norm(mesh.sensitivities(motion.q, q_b, number), axis=-1))


def section_forces(mesh: BeamMesh, motion: Solution) -> Array:
    """Return N, V_y, V_z, T, M_y and M_z of a beam that deforms, shape (k, n, n_xi, 6)."""
    places = ((k, xi) for k in range(mesh.shape[0]) for xi in mesh.xi.tolist())
    laws = (mesh.sections.forces_in(mesh.name, *place) for place in places)
    forces = np.stack([law.values(motion.q, motion.v) for law in laws], axis=1)
    return forces.reshape(len(forces), *mesh.shape[:2], 6)
