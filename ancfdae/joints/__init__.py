"""Joints: holonomic constraints between points of beams, and to ground; one a file."""

from ancfdae.joints.clamp import Clamp
from ancfdae.joints.cylindrical import Cylindrical
from ancfdae.joints.distance import Distance
from ancfdae.joints.drive import Drive
from ancfdae.joints.guide import Guide
from ancfdae.joints.joint import DrivenJoint, Equations, Joint, RightAngle
from ancfdae.joints.moving_base import MovingBase
from ancfdae.joints.pin import Pin, Spherical
from ancfdae.joints.planar_joint import PlanarJoint
from ancfdae.joints.point_on_line import PointOnLine
from ancfdae.joints.prismatic import Prismatic
from ancfdae.joints.revolute import Revolute
from ancfdae.joints.universal import Universal
from ancfdae.joints.weld import Weld
