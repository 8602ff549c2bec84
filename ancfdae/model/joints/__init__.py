"""Joints: holonomic constraints between points of beams, and to ground; one a file."""

from ancfdae.model.joints.clamp import Clamp
from ancfdae.model.joints.cylindrical import Cylindrical
from ancfdae.model.joints.distance import Distance
from ancfdae.model.joints.drive import Drive
from ancfdae.model.joints.guide import Guide
from ancfdae.model.joints.joint import DrivenJoint, Equations, Joint, RightAngle
from ancfdae.model.joints.moving_base import MovingBase
from ancfdae.model.joints.pin import Pin, Spherical
from ancfdae.model.joints.planar_joint import PlanarJoint
from ancfdae.model.joints.point_on_line import PointOnLine
from ancfdae.model.joints.prismatic import Prismatic
from ancfdae.model.joints.revolute import Revolute
from ancfdae.model.joints.universal import Universal
from ancfdae.model.joints.weld import Weld
