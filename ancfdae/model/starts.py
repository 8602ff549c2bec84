"""Initial conditions: rigid-body motions, nodal states, static equilibrium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeAlias, final

import numpy as np

from ancfdae.errors.checks import (
    require_array,
    require_axial,
    require_each,
    require_text,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import BeamBody, Quantity, RigidBody
from ancfdae.model.design import Designable
from ancfdae.model.loads.load import Load
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class InitialVelocity(Designable):
    """Initial velocity of a beam or a rigid body: a rigid-body motion.

    v = velocity + angular_velocity x (r - about); slopes rotate with it. Design targets, under the
    name of the body: ``angular_velocity`` (in space ``angular_velocity_x`` ...), ``about_x`` ...,
    and ``velocity_x`` ... where it is given.

    Parameters
    ----------
    body : str
        Name of the beam or the rigid body.
    angular_velocity : float or sequence of float
        A number in the plane, three components in space; rad/s.
    about : sequence of float
        Reference point; m.
    velocity : sequence of float, optional
        Velocity of the reference point, zero by default; m/s.
    """

    body: str
    angular_velocity: float | Sequence[float]
    about: Sequence[float]
    velocity: Sequence[float] | None = None

    design_fields = (
        ("angular_velocity", require_axial),
        ("about", require_vector),
        ("velocity", require_vector),
    )
    vector_words: ClassVar[Mapping[str, str]] = {"angular_velocity": "angular_velocity"}

    def __post_init__(self) -> None:
        require_text("InitialVelocity.body", self.body)
        self.check_fields(f"start of {self.body!r}")


@final
@dataclass(frozen=True)
class NodalState:
    """Initial coordinates and velocities of a flexible beam, node by node.

    Parameters
    ----------
    body : str
        Name of the beam.
    coordinates : array, shape (n + 1, n_s, d) or (n, 2, n_s, d)
        Position, m, and slopes of every node, or of both ends of every element as `Solution.ends`
        returns them, where the slope along the beam differs on both sides of a node (`Beam`,
        kinks).
    velocities : array, optional
        Rates of the coordinates, in the same shape; m/s, slopes 1/s. Zero by default.
    """

    body: str
    coordinates: Array
    velocities: Array | None = None


@final
@dataclass(frozen=True)
class EquilibriumStart:
    """Start from static equilibrium, for example of a hanging or pre-stressed mechanism.

    The search for the equilibrium starts from the reference configuration, or from the `NodalState`
    of a beam. Design derivatives of the motion include those of the equilibrium. States of
    controllers among `loads` are in equilibrium, too; other states start as declared. An unstable
    equilibrium raises a `StabilityWarning`, except with controllers, whose stability is not judged.

    Parameters
    ----------
    loads : sequence of Load, optional
        Loads in equilibrium; by default the loads of the scene. A load that also acts during the
        motion must be the same object; the numbers of all loads are design targets.
    gravity : sequence of float, optional
        Gravity in equilibrium, by default the gravity of the scene; m/s^2.
    """

    loads: Sequence[Load] | None = None
    gravity: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Check the loads and store them as a tuple."""
        if self.loads is not None:
            loads = require_each("EquilibriumStart.loads", self.loads, (Load,), "Add a PointForce.")
            object.__setattr__(self, "loads", loads)
        if self.gravity is not None:
            require_vector("EquilibriumStart.gravity", self.gravity)

    def with_loads(self, changed: Sequence[Load]) -> EquilibriumStart:
        """Return the start with its loads replaced by the loads of the same names in `changed`."""
        if self.loads is None:
            return self
        by_name = {load.name: load for load in changed}
        return replace(self, loads=tuple(by_name[load.name] for load in self.loads))


Start: TypeAlias = InitialVelocity | NodalState | EquilibriumStart


def checked_start(
    start: InitialVelocity | NodalState, beam: BeamBody | RigidBody, d: int, kinks: tuple[int, ...]
) -> InitialVelocity | NodalState:
    """Return the checked start of a beam with kinks at these nodes, its sequences as arrays.

    InvalidInputError if vectors have another size, a rigid body has nodal states, or elements do
    not meet.
    """
    where = f"start of {beam.name!r}"
    if isinstance(start, InitialVelocity):
        require_vector(f"{where}, about", start.about, (d,))
        if start.velocity is not None:
            require_vector(f"{where}, velocity", start.velocity, (d,))
        require_axial(f"{where}, angular_velocity", start.angular_velocity, d)
        return start
    if isinstance(beam, RigidBody) or beam.rigid:
        rule, repair = "a rigid body has no nodes", "Give it a InitialVelocity."
        raise InvalidInputError(where, rule, "a NodalState", repair)
    coordinates = _of_nodes(f"{where}, coordinates", start.coordinates, beam, kinks)
    _require_sections(f"{where}, coordinates", coordinates)
    velocities = None
    if start.velocities is not None:
        velocities = _of_nodes(f"{where}, velocities", start.velocities, beam, kinks)
    return replace(start, coordinates=coordinates, velocities=velocities)


def _of_nodes(where: str, given: Array, beam: BeamBody, kinks: tuple[int, ...]) -> Array:
    """Return the checked vectors of nodes, or of both ends of elements that meet at nodes."""
    n, vectors = beam.element_count, (beam.element.n_s, beam.dimension)
    if np.ndim(given) != 4:
        return require_array(where, given, (n + 1, *vectors))
    ends = require_array(where, given, (n, 2, *vectors))
    differ = np.any(ends[:-1, 1] != ends[1:, 0], axis=-1)
    differ[np.array(kinks, dtype=np.int64) - 1, Quantity.SLOPE_X] = False
    if np.any(differ):
        raise InvalidInputError(
            where,
            "elements must meet with the same vectors, except the slope along the beam at kinks",
            f"others at node {1 + int(np.argmax(np.any(differ, axis=1)))}",
            "Declare Beam(..., kinks=[...]) where it jumps.",
        )
    return ends


def _require_sections(where: str, coordinates: Array) -> None:
    """Raise InvalidInputError unless slopes at each node span a right-handed section."""
    slopes = coordinates[..., 1:, :]
    sizes = np.linalg.norm(slopes, axis=-1)
    flat = np.any(sizes == 0, axis=-1)
    if slopes.shape[-2] == slopes.shape[-1]:
        # The round-off of a determinant is about 1e-16 of the product of the norms.
        flat |= np.linalg.det(slopes) <= 1e-12 * np.prod(sizes, axis=-1)
    if np.any(flat):
        raise InvalidInputError(
            where,
            "slopes must span the body with the turning sense of the axes",
            f"{slopes[flat][0].tolist()} at node {np.argwhere(flat)[0].sum()}",
            "A node holds its position, then its slopes, as solution.nodes returns them.",
        )
