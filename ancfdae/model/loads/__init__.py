"""Loads: forces and moments on points of beams; one a file."""

from ancfdae.model.loads.bushing import Bushing
from ancfdae.model.loads.distributed_force import DistributedForce
from ancfdae.model.loads.follower_force import FollowerForce
from ancfdae.model.loads.joint_friction import JointFriction
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.moment import Moment
from ancfdae.model.loads.point_force import PointForce
from ancfdae.model.loads.slide_friction import SlideFriction
from ancfdae.model.loads.spring_damper import SpringDamper
from ancfdae.model.loads.torque import Torque
from ancfdae.model.loads.torsion_spring import TorsionSpring
from ancfdae.model.parts import CentreLine
