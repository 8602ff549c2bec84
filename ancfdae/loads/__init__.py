"""Loads: forces and moments on points of beams; one a file."""

from ancfdae.loads.distributed_force import DistributedForce
from ancfdae.loads.follower_force import FollowerForce
from ancfdae.loads.load import Load
from ancfdae.loads.moment import Moment
from ancfdae.loads.point_force import PointForce
from ancfdae.loads.spring_damper import SpringDamper
from ancfdae.parts import CentreLine
