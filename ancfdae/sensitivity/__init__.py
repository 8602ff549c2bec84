"""Design sensitivities of whole runs, by several independent methods, and their checks."""

from ancfdae.sensitivity.adjoint import Adjoint
from ancfdae.sensitivity.adjoint_error import AdjointError, adjoint_error
from ancfdae.sensitivity.complex_step import ComplexStep
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.contract import Gradient, GradientMethod, Method, UnfinishedRun
from ancfdae.sensitivity.direct import Direct
from ancfdae.sensitivity.error_bars import ErrorBars, error_bars
from ancfdae.sensitivity.finite_difference import FiniteDifference
from ancfdae.sensitivity.run import (
    as_system,
    cheapest,
    differentiate,
    gradient,
    gradients,
    simulate,
)
from ancfdae.sensitivity.taylor import TaylorTest, taylor_test

__all__ = [
    "Adjoint",
    "AdjointError",
    "ComplexStep",
    "ContinuousAdjoint",
    "Direct",
    "ErrorBars",
    "FiniteDifference",
    "Gradient",
    "GradientMethod",
    "Method",
    "TaylorTest",
    "UnfinishedRun",
    "adjoint_error",
    "as_system",
    "cheapest",
    "differentiate",
    "error_bars",
    "gradient",
    "gradients",
    "simulate",
    "taylor_test",
]
