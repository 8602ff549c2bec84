"""Laws: functions of time that drives, loads and supports follow."""

from ancfdae.model.laws.law import (
    Constant,
    ConstantAcceleration,
    Harmonic,
    RunUp,
    SmoothStep,
    Transition,
)
from ancfdae.model.laws.splines import BSpline, Spline
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
