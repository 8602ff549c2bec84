"""Loads: forces on points of beams; one a file."""

from ancfdae.loads.distributed_force import DistributedForce
from ancfdae.loads.follower_force import FollowerForce
from ancfdae.loads.load import CentreLine, Load
from ancfdae.loads.point_force import PointForce
from ancfdae.loads.spring_damper import SpringDamper

__all__ = [
    "CentreLine",
    "DistributedForce",
    "FollowerForce",
    "Load",
    "PointForce",
    "SpringDamper",
]
