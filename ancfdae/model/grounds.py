"""Grounds of joints that were left out: the place of the point in the reference configuration."""

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import numpy as np

from ancfdae.model.bodies import BeamBody, Point, RigidBody
from ancfdae.model.parts import Part
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import rotation

#: Returns the beam or rigid body of a name.
_Member: TypeAlias = Callable[[str], BeamBody | RigidBody]
_Any = TypeVar("_Any", bound=Part)

#: Targets of the place on the ground.
TARGETS = ("ground_x", "ground_y", "ground_z")


def reference_place(point: Point, member: _Member) -> Array:
    """Return where a point stands in the reference configuration as declared, shape (d,)."""
    body = member(point.beam)
    place, attached = body.place, body.attached
    start = np.asarray(place) if attached is None else reference_place(attached, member)
    arm = rotation(np.asarray(body.turn, float), body.dimension) @ body.at_origin(point)
    result: Array = start + arm
    return result


def on_ground(part: _Any, member: _Member) -> _Any:
    """Return a part with its ground written where it was left out."""
    point = part.stands_at
    return part if point is None else part.on_ground(reference_place(point, member).tolist())
