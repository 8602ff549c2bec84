"""Beams and points on them."""

from ancfdae.bodies.beam import Beam
from ancfdae.bodies.body import PARAMETER_NAMES, BeamBody, ReferenceShape
from ancfdae.bodies.curved_beam import CurvedBeam
from ancfdae.bodies.point import Point, Quantity, name_at, require_point

__all__ = [
    "PARAMETER_NAMES",
    "Beam",
    "BeamBody",
    "CurvedBeam",
    "Point",
    "Quantity",
    "ReferenceShape",
    "name_at",
    "require_point",
]
