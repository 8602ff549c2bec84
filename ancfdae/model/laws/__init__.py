"""Laws of time: numbers as functions of time that drive joints and scale loads; a family a file."""

from ancfdae.model.laws.elementary import Constant, Harmonic, Uniform
from ancfdae.model.laws.law import Law
from ancfdae.model.laws.passages import Change, Ramp, RunUp
from ancfdae.model.laws.spline import Spline
from ancfdae.model.laws.user_law import UserLaw
