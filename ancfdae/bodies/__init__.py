"""Beams and points on them."""

from ancfdae.bodies.beam import Beam
from ancfdae.bodies.body import BeamBody, ReferenceShape
from ancfdae.bodies.curved_beam import CurvedBeam
from ancfdae.bodies.point import Point, require_point
from ancfdae.elements import Quantity

__all__ = [
    "Beam",
    "BeamBody",
    "CurvedBeam",
    "Point",
    "Quantity",
    "ReferenceShape",
    "require_point",
]
