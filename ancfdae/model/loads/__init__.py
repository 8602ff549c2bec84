"""Loads: forces and moments on points of beams; a family a file."""

from ancfdae.model.loads.forces import DistributedForce, FollowerForce, PointForce
from ancfdae.model.loads.friction import JointFriction, SlideFriction
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.springs import Bushing, SpringDamper
from ancfdae.model.loads.torques import Moment, Torque, TorsionSpring
from ancfdae.model.parts import CentreLine
