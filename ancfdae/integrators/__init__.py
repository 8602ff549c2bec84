"""Integrators, and the consistent start that all of them share."""

from ancfdae.integrators.explicit import Explicit
from ancfdae.integrators.hht.method import HHT
from ancfdae.integrators.integrand import Density, Integrand, PartialIntegral, Points
from ancfdae.integrators.integrator import (
    AdjointIntegrator,
    DefectIntegrator,
    Integrator,
    PartwiseIntegrator,
    QuadratureIntegrator,
    RunInParts,
    Seeds,
)
from ancfdae.integrators.radau.method import Radau
from ancfdae.integrators.static import Static
from ancfdae.integrators.step_control import ControlledSteps, FixedSteps, GivenSteps, StepControl
from ancfdae.integrators.sundials.ida import IDA
from ancfdae.integrators.sundials.idas import IDAS
from ancfdae.integrators.sundials.index_reduced import IndexReduction
