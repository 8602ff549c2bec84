"""Beams, rigid bodies and points on them."""

from ancfdae.model.bodies.beam import Beam, CurvedBeam
from ancfdae.model.bodies.body import BeamBody, ReferenceShape
from ancfdae.model.bodies.point import (
    MaterialPoint,
    locate,
    require_fraction,
    require_in_section,
    require_point,
)
from ancfdae.model.bodies.rigid_body import (
    BodyShape,
    RigidBody,
    RigidBox,
    RigidCylinder,
    RigidSphere,
)
from ancfdae.model.elements import Quantity
