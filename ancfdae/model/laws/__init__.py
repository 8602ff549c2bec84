"""Laws of time: numbers as functions of time that drive joints and scale loads; one a file."""

from ancfdae.model.laws.change import Change
from ancfdae.model.laws.constant import Constant
from ancfdae.model.laws.harmonic import Harmonic
from ancfdae.model.laws.law import Law
from ancfdae.model.laws.ramp import Ramp
from ancfdae.model.laws.run_up import RunUp
from ancfdae.model.laws.spline import Spline
from ancfdae.model.laws.uniform import Uniform
from ancfdae.model.laws.user_law import UserLaw
