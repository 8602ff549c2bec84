"""Joints: holonomic constraints between points of beams, and to ground; a family a file."""

from ancfdae.model.joints.axis_joint import Cylindrical, PlanarJoint, Revolute
from ancfdae.model.joints.drive import Drive
from ancfdae.model.joints.guide import Guide
from ancfdae.model.joints.held_sections import Clamp, MovingBase, Weld
from ancfdae.model.joints.joint import DrivenJoint, Equations, Joint, RightAngle
from ancfdae.model.joints.point_joints import Distance, Pin, PointOnLine, Spherical
from ancfdae.model.joints.prismatic import Prismatic
from ancfdae.model.joints.universal import Universal
