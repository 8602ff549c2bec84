"""Laws: functions of time that drives, loads and supports follow."""

from ancfdae.model.laws.b_spline import BSpline
from ancfdae.model.laws.elementary import Constant, ConstantAcceleration, Harmonic
from ancfdae.model.laws.passages import RunUp, SmoothStep, Transition
from ancfdae.model.laws.spline import Spline
from ancfdae.model.laws.user_law import UserLaw

__all__ = [
    "BSpline",
    "Constant",
    "ConstantAcceleration",
    "Harmonic",
    "RunUp",
    "SmoothStep",
    "Spline",
    "Transition",
    "UserLaw",
]
