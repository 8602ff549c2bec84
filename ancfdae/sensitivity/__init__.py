"""Design sensitivities of whole runs by several independent methods."""

from ancfdae.sensitivity.adjoint import Adjoint, Direct
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.method import (
    Accuracy,
    Gradient,
    GradientMethod,
    Method,
    Run,
    Searched,
    Trial,
    UnfinishedRun,
)
from ancfdae.sensitivity.perturbation import ComplexStep, FiniteDifference
