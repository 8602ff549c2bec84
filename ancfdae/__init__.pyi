"""First-order design sensitivities of flexible multibody systems in ANCF."""

from ancfdae.assembly.saved import load_event_solution, load_solution
from ancfdae.assembly.system import assemble
from ancfdae.equations.conformance import check_system
from ancfdae.events.kinds import EndEvent, Impact, ImpactLaw, Mode, RestModes, Switch
from ancfdae.integrators.explicit import DOP853
from ancfdae.integrators.hht.method import HHT
from ancfdae.integrators.radau.method import Radau
from ancfdae.integrators.step_control import AdaptiveSteps, FixedSteps, PrescribedSteps
from ancfdae.integrators.sundials.ida import IDA
from ancfdae.integrators.sundials.idas import IDAS
from ancfdae.integrators.sundials.index_reduced import IndexReduction
from ancfdae.model.bodies import Beam, CurvedBeam, RigidBody, RigidBox, RigidCylinder, RigidSphere
from ancfdae.model.design import DesignVariable, distributed_variables
from ancfdae.model.elements import (
    BEAM_2D,
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    EnhancedContinuum,
    PlaneStress,
    SaintVenantKirchhoff,
)
from ancfdae.model.joints.axis_joint import (
    Cylindrical,
    PlanarJoint,
    Prismatic,
    Revolute,
    Universal,
)
from ancfdae.model.joints.drive import RotationDriver, TranslationDriver
from ancfdae.model.joints.point_joints import (
    Clamp,
    Distance,
    MovingSupport,
    Pin,
    PointOnLine,
    Spherical,
    Weld,
)
from ancfdae.model.joints.sliding import SlidingJoint
from ancfdae.model.loads.actuators import DCMotor, FirstOrderLag
from ancfdae.model.loads.contact import BeamContact, Contact
from ancfdae.model.loads.controller import PID
from ancfdae.model.loads.forces import (
    DistributedForce,
    FollowerForce,
    Moment,
    MotorTorque,
    PointForce,
    TorsionalSpringDamper,
)
from ancfdae.model.loads.friction import RotationalFriction, SlidingFriction, TranslationalFriction
from ancfdae.model.loads.obstacles import Cylinder, Plane, Sphere
from ancfdae.model.loads.pair_contact import BeamPairContact, SphereContacts
from ancfdae.model.loads.rope import Pulley, Rope
from ancfdae.model.loads.springs import Bushing, SpringDamper
from ancfdae.model.material import Material
from ancfdae.model.parts import PointMass
from ancfdae.model.scene import Scene
from ancfdae.model.starts import EquilibriumStart, InitialVelocity, NodalState
from ancfdae.model.turning_frame import RotatingFrame
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.objectives import (
    AtTimes,
    Integral,
    SmoothMaximum,
    SmoothUpperBound,
    Terminal,
)
from ancfdae.sensitivity.perturbation import ComplexStep, FiniteDifference
from ancfdae.studies.accuracy.error_bars import error_bars, estimate_adjoint_error
from ancfdae.studies.calls import differentiate, evaluate, gradient, gradients, simulate
from ancfdae.studies.fit import FrequencyMisfit, Misfit, StaticMisfit
from ancfdae.studies.ladder import choose_model
from ancfdae.studies.mass_properties import mass_properties
from ancfdae.studies.modes import campbell, modes, suggest_step
from ancfdae.studies.observing import record_observables
from ancfdae.studies.redundant import drop_redundant
from ancfdae.studies.responses import Responses
from ancfdae.studies.statics import CriticalValue, critical_load, equilibrium, equilibrium_gradient
from ancfdae.studies.sweep import Evaluator, sweep
from ancfdae.studies.taylor import taylor_test
from ancfdae.studies.tradeoff import work_precision

__version__: str

__all__ = [
    "BEAM_2D",
    "BEAM_3D",
    "CABLE_2D",
    "CABLE_3D",
    "DOP853",
    "HHT",
    "IDA",
    "IDAS",
    "PID",
    "AdaptiveSteps",
    "Adjoint",
    "AtTimes",
    "Beam",
    "BeamContact",
    "BeamPairContact",
    "Bushing",
    "Clamp",
    "ComplexStep",
    "Contact",
    "ContinuousAdjoint",
    "CriticalValue",
    "CurvedBeam",
    "Cylinder",
    "Cylindrical",
    "DCMotor",
    "DesignVariable",
    "DirectDifferentiation",
    "Distance",
    "DistributedForce",
    "EndEvent",
    "EnhancedContinuum",
    "EquilibriumStart",
    "Evaluator",
    "FiniteDifference",
    "FirstOrderLag",
    "FixedSteps",
    "FollowerForce",
    "FrequencyMisfit",
    "Impact",
    "ImpactLaw",
    "IndexReduction",
    "InitialVelocity",
    "Integral",
    "Material",
    "Misfit",
    "Mode",
    "Moment",
    "MotorTorque",
    "MovingSupport",
    "NodalState",
    "Pin",
    "PlanarJoint",
    "Plane",
    "PlaneStress",
    "PointForce",
    "PointMass",
    "PointOnLine",
    "PrescribedSteps",
    "Prismatic",
    "Pulley",
    "Radau",
    "Responses",
    "RestModes",
    "Revolute",
    "RigidBody",
    "RigidBox",
    "RigidCylinder",
    "RigidSphere",
    "Rope",
    "RotatingFrame",
    "RotationDriver",
    "RotationalFriction",
    "SaintVenantKirchhoff",
    "Scene",
    "SlidingFriction",
    "SlidingJoint",
    "SmoothMaximum",
    "SmoothUpperBound",
    "Sphere",
    "SphereContacts",
    "Spherical",
    "SpringDamper",
    "StaticMisfit",
    "Switch",
    "Terminal",
    "TorsionalSpringDamper",
    "TranslationDriver",
    "TranslationalFriction",
    "Universal",
    "Weld",
    "__version__",
    "assemble",
    "campbell",
    "check_system",
    "choose_model",
    "critical_load",
    "differentiate",
    "distributed_variables",
    "drop_redundant",
    "equilibrium",
    "equilibrium_gradient",
    "error_bars",
    "estimate_adjoint_error",
    "evaluate",
    "gradient",
    "gradients",
    "load_event_solution",
    "load_solution",
    "mass_properties",
    "modes",
    "record_observables",
    "simulate",
    "suggest_step",
    "sweep",
    "taylor_test",
    "work_precision",
]
