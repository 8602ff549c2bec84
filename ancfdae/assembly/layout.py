"""Indices of the coordinates of bodies in q, and of the multipliers of joints in lam.

The classes hold plain numbers only, so that a saved solution can be read without its scene.
"""

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import named
from ancfdae.errors.kinds import UnknownNameError
from ancfdae.model.bodies import locate, require_fraction
from ancfdae.model.elements import BeamElement, Quantity
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class BodyLayout:
    """Vectors of a beam or rigid body in q: `count` consecutive ones from `first_vector`.

    Every `stride`-th vector is a position, the others are directions: per node of a beam, or for
    the one frame of a rigid body. `kinks` are the inner nodes where the slope along the beam may
    jump: the slope of the element which ends there is stored after all nodes. Vector k has the
    coordinates d k to d k + d - 1. `size` is the length of a beam or the radius of gyration of a
    body, as declared; m.
    """

    name: str
    first_vector: int
    count: int
    stride: int
    size: float
    kinks: tuple[int, ...] = ()

    @cached_property
    def vectors(self) -> Array:
        """Indices of the vectors of this body, shape (count,)."""
        return self.first_vector + np.arange(self.count)

    @cached_property
    def nodes(self) -> Array:
        """Indices of the vectors of every node, shape (n_nodes, stride).

        At a kink the table holds the slope vector of the element that begins there.
        """
        return self.vectors[: self.count - len(self.kinks)].reshape(-1, self.stride)

    @property
    def positions(self) -> Array:
        """Indices of the vectors that are positions, shape (n_nodes,)."""
        return self.nodes[:, 0]

    @cached_property
    def ends(self) -> Array:
        """Indices of the vectors of both ends of every element, shape (n, 2 stride)."""
        nodes = self.nodes
        ends = np.concatenate([nodes[:-1], nodes[1:]], axis=1)
        kinks = np.array(self.kinks, dtype=np.int64)
        ends[kinks - 1, self.stride + Quantity.SLOPE_X] = self.vectors[nodes.size :]
        return ends


@final
@dataclass(frozen=True)
class RigidNodes:
    """Nodes of a rigid beam in its own axes.

    `chords` are chords over lengths of elements, (n, d), `slopes` the slopes of nodes, (n + 1, d,
    d).
    """

    chords: tuple[tuple[float, ...], ...]
    slopes: tuple[tuple[tuple[float, ...], ...], ...]

    def weights(self, lengths: Array, n_s: int) -> Array:
        """Return W, (n + 1, n_s, d + 1): node vectors as combinations of r and the directions."""
        chords, slopes = np.asarray(self.chords), np.asarray(self.slopes)
        n, d = chords.shape
        W = np.zeros((n + 1, n_s, d + 1), dtype=np.result_type(lengths, float))
        W[:, 0, 0] = 1.0
        W[1:, 0, 1:] = np.cumsum(lengths[:, None] * chords, axis=0)
        W[:, 1:, 1:] = slopes[:, : n_s - 1]
        return W

    def positions_b(self, lengths_b: Array) -> Array:
        """Return the design derivative of W[:, 0, 1:], shape (n + 1, d, n_b), due to lengths."""
        moved = np.cumsum(np.asarray(self.chords)[..., None] * lengths_b[:, None], axis=0)
        return np.concatenate([np.zeros((1, *moved.shape[1:])), moved])


@final
@dataclass(frozen=True)
class BeamLayout:
    """Element, index of the first element, and arc-length fractions of nodes of a beam.

    `rigid` holds the nodes of a rigid beam in its own axes; None for a flexible beam.
    """

    name: str
    element: BeamElement
    first_element: int
    fractions: tuple[float, ...]
    rigid: RigidNodes | None

    @property
    def element_count(self) -> int:
        """Number of elements of the beam."""
        return len(self.fractions) - 1

    @property
    def elements(self) -> slice:
        """Slice of the elements of this beam in arrays over all elements of the scene."""
        return slice(self.first_element, self.first_element + self.element_count)

    def locate(self, fraction: float | None, before: bool = False) -> tuple[int, float]:
        """Return the element of the beam and its xi at an arc-length fraction in [0, 1]."""
        fraction = require_fraction(f"point of {self.name!r}", fraction)
        return locate(np.asarray(self.fractions), fraction, before)


@final
@dataclass(frozen=True)
class JointLayout:
    """Multipliers of a joint in lam: `rows` of them from `first_row` on.

    `holds_position`: whether the first d of them are minus the force on its first point.
    """

    name: str
    first_row: int
    rows: int
    holds_position: bool


@final
@dataclass(frozen=True)
class StatesLayout:
    """Vectors of the states of a controller or joint in q, from `first_vector` on.

    Component 0 of the rate of a vector is the state of a controller, component 0 of the vector the
    coordinate of a joint; the other components are zero.
    """

    name: str
    first_vector: int
    states: tuple[str, ...]


@final
@dataclass(frozen=True)
class Layout:
    """Indices of all bodies, joints and states of a scene in q and lam; `d` is its dimension.

    `bodies` are beams and rigid bodies in the order of their coordinates, `masses` the names of the
    point masses. `controllers` are loads that have states. `sliders` are joints with additional
    coordinates, whose vectors precede the vectors of controllers.
    """

    d: int
    bodies: tuple[BodyLayout, ...]
    beams: tuple[BeamLayout, ...]
    masses: tuple[str, ...]
    joints: tuple[JointLayout, ...]
    controllers: tuple[StatesLayout, ...] = ()
    sliders: tuple[StatesLayout, ...] = ()

    @property
    def owners(self) -> tuple[str, ...]:
        """Names of everything with a mass: bodies, then point masses."""
        return (*(body.name for body in self.bodies), *self.masses)

    def owner(self, name: str) -> int:
        """Return the index of a name among `owners`; UnknownNameError if it is not there."""
        if name not in self.owners:
            raise UnknownNameError("beam or body", name, self.owners)
        return self.owners.index(name)

    def body(self, name: str) -> BodyLayout:
        """Return the layout of the beam or rigid body `name`; UnknownNameError if it is missing."""
        return self._bodies.get(name) or named("beam or body", name, self.bodies)

    def beam(self, name: str) -> BeamLayout:
        """Return the layout of the beam `name`; UnknownNameError if it is missing."""
        return self.beams_by_name.get(name) or named("beam", name, self.beams)

    @cached_property
    def _bodies(self) -> dict[str, BodyLayout]:
        return {body.name: body for body in self.bodies}

    @cached_property
    def beams_by_name(self) -> dict[str, BeamLayout]:
        """Layouts of the beams by name."""
        return {beam.name: beam for beam in self.beams}

    def joint(self, name: str) -> JointLayout:
        """Return the layout of the joint `name`; UnknownNameError if it is missing."""
        return named("joint", name, self.joints)

    def controller(self, name: str) -> StatesLayout:
        """Return the states of the controller `name`; UnknownNameError if it is missing."""
        return named("controller with states", name, self.controllers)

    def slider(self, name: str) -> StatesLayout:
        """Return the coordinate of the sliding joint `name`; UnknownNameError if it is missing."""
        return named("sliding joint", name, self.sliders)

    def plain(self) -> dict[str, Any]:
        """Return the layout as data for JSON, with the names of elements."""
        named = [replace(beam, element=beam.element.name) for beam in self.beams]  # type: ignore[arg-type]
        return asdict(replace(self, beams=tuple(named)))

    def coordinate_names(self) -> list[str]:
        """Return a name for each coordinate, n_q in all.

        ``rod[2].y`` is the position of node 2, counted from 0, ``rod[2].slope_x.y`` its slope along
        the beam. At a kink this is the slope behind it, ``rod[2].slope_x before.y`` the slope
        before it. ``box.y`` is the reference point of a rigid body and ``box.axis_1.y`` its first
        direction. ``guide.travel.x`` is the coordinate `travel` of a joint. The rate of
        ``motor.current integral.x`` is the state `current` of a controller.
        """
        soft = [beam for beam in self.beams if beam.rigid is None]
        words = {beam.name: [x.name.lower() for x in beam.element.quantities] for beam in soft}
        axes, names = "xyz"[: self.d], []
        for body in self.bodies:
            slopes = words.get(body.name)
            for k in range(body.nodes.size):
                node, which = divmod(k, body.stride)
                owner = f"{body.name}[{node}]" if slopes else body.name
                word = slopes[which] if slopes else f"axis_{which}"
                vector = owner if which == 0 else f"{owner}.{word}"
                names += [f"{vector}.{axis}" for axis in axes]
            kinks = [f"{body.name}[{k}].slope_x before" for k in body.kinks]
            names += [f"{vector}.{axis}" for vector in kinks for axis in axes]
        vectors = [f"{each.name}.{state}" for each in self.sliders for state in each.states]
        vectors += [
            f"{each.name}.{state} integral" for each in self.controllers for state in each.states
        ]
        return names + [f"{vector}.{axis}" for vector in vectors for axis in axes]
