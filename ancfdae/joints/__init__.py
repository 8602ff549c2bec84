"""Joints: holonomic constraints between points of beams, and to ground."""

from ancfdae.joints.clamp import Clamp
from ancfdae.joints.contract import Equation, Joint, Term
from ancfdae.joints.pin import Pin, Spherical

__all__ = ["Clamp", "Equation", "Joint", "Pin", "Spherical", "Term"]
