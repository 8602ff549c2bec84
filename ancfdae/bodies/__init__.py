"""Beams, rigid bodies and points on them."""

from ancfdae.bodies.beam import Beam
from ancfdae.bodies.body import BeamBody, ReferenceShape
from ancfdae.bodies.curved_beam import CurvedBeam
from ancfdae.bodies.point import (
    Point,
    locate,
    require_fraction,
    require_in_section,
    require_point,
)
from ancfdae.bodies.rigid_body import RigidBody
from ancfdae.bodies.shapes import BodyShape, RigidBox, RigidCylinder, RigidSphere
from ancfdae.elements import Quantity
