"""Loads: forces and moments on points of beams; one a file."""

from ancfdae.loads.bushing import Bushing
from ancfdae.loads.distributed_force import DistributedForce
from ancfdae.loads.follower_force import FollowerForce
from ancfdae.loads.joint_friction import JointFriction
from ancfdae.loads.load import Load
from ancfdae.loads.moment import Moment
from ancfdae.loads.point_force import PointForce
from ancfdae.loads.slide_friction import SlideFriction
from ancfdae.loads.spring_damper import SpringDamper
from ancfdae.loads.torque import Torque
from ancfdae.loads.torsion_spring import TorsionSpring
from ancfdae.parts import CentreLine
