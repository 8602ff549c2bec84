"""Design sensitivities of whole runs by several independent methods."""

from ancfdae.sensitivity.accuracy import Accuracy, Searched, Trial
from ancfdae.sensitivity.adjoint import Adjoint
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.direct import Direct
from ancfdae.sensitivity.method import Gradient, GradientMethod, Method, Run, UnfinishedRun
from ancfdae.sensitivity.perturbation import ComplexStep, FiniteDifference
