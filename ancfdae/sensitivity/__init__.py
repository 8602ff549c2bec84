"""Design sensitivities of whole runs by several independent methods."""

from ancfdae.sensitivity.adjoint import Adjoint
from ancfdae.sensitivity.complex_step import ComplexStep
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.direct import Direct
from ancfdae.sensitivity.finite_difference import FiniteDifference
from ancfdae.sensitivity.method import Gradient, GradientMethod, Method, UnfinishedRun

__all__ = [
    "Adjoint",
    "ComplexStep",
    "ContinuousAdjoint",
    "Direct",
    "FiniteDifference",
    "Gradient",
    "GradientMethod",
    "Method",
    "UnfinishedRun",
]
