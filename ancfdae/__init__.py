"""First-order design sensitivities of flexible multibody systems in ANCF."""

from ancfdae.bodies import Beam, CurvedBeam, Point
from ancfdae.design import DesignVariable, distribution
from ancfdae.errors import (
    AncfdaeError,
    InconsistentStart,
    InvalidInput,
    Outcome,
    RedundantConstraints,
    StabilityWarning,
    UnknownName,
    Verdict,
)
from ancfdae.integrators import HHT, Integrator
from ancfdae.joints import Clamp, Pin, Spherical
from ancfdae.scene import NodeState, RigidMotion, Scene
from ancfdae.sections import Material, Rectangle
from ancfdae.sensitivity import (
    ComplexStep,
    Direct,
    FiniteDifference,
    TaylorTest,
    differentiate,
    simulate,
    taylor_test,
)
from ancfdae.solution import Sensitivities, Solution, Statistics
from ancfdae.system import AncfSystem, MechanicalSystem, assemble

__version__ = "0.1.0"

__all__ = [
    "HHT",
    "AncfSystem",
    "AncfdaeError",
    "Beam",
    "Clamp",
    "ComplexStep",
    "CurvedBeam",
    "DesignVariable",
    "Direct",
    "FiniteDifference",
    "InconsistentStart",
    "Integrator",
    "InvalidInput",
    "Material",
    "MechanicalSystem",
    "NodeState",
    "Outcome",
    "Pin",
    "Point",
    "Rectangle",
    "RedundantConstraints",
    "RigidMotion",
    "Scene",
    "Sensitivities",
    "Solution",
    "Spherical",
    "StabilityWarning",
    "Statistics",
    "TaylorTest",
    "UnknownName",
    "Verdict",
    "__version__",
    "assemble",
    "differentiate",
    "distribution",
    "simulate",
    "taylor_test",
]
