"""Laws: functions of time that drives, loads and supports follow."""

from ancfdae.model.laws.law import (
    Constant,
    ConstantAcceleration,
    Harmonic,
    RunUp,
    SmoothStep,
    Transition,
    UserLaw,
)
from ancfdae.model.laws.splines import BSpline, Spline

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
