"""Joints: holonomic constraints between points of beams, and to ground; one a file."""

from ancfdae.joints.clamp import Clamp
from ancfdae.joints.cylindrical import Cylindrical
from ancfdae.joints.distance import Distance
from ancfdae.joints.drive import Drive, Guide
from ancfdae.joints.joint import Equations, Joint
from ancfdae.joints.pin import Pin, Spherical
from ancfdae.joints.point_on_line import PointOnLine
from ancfdae.joints.revolute import Revolute
