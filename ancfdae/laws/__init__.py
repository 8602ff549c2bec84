"""Laws of time: numbers as functions of time that drive joints and scale loads; one a file."""

from ancfdae.laws.constant import Constant
from ancfdae.laws.harmonic import Harmonic
from ancfdae.laws.law import Law
from ancfdae.laws.ramp import Ramp
from ancfdae.laws.spline import Spline
from ancfdae.laws.uniform import Uniform
from ancfdae.laws.user_law import UserLaw
