"""First-order design sensitivities of flexible multibody systems in ANCF."""

from ancfdae.assembly.saved import load_solution
from ancfdae.assembly.system import AncfSystem, assemble
from ancfdae.equations import (
    Direction,
    EstimatedErrors,
    FormulaSystem,
    MechanicalSystem,
    Sensitivities,
    Solution,
    Statistics,
    Traits,
)
from ancfdae.equations.conformance import Conformance, check_system
from ancfdae.equations.files import NotSaved
from ancfdae.errors import (
    AncfdaeError,
    CoarseMesh,
    FailedDesign,
    InconsistentStart,
    Interrupted,
    InvalidInput,
    LargeStrain,
    ManySteps,
    MissingPackage,
    NotTraced,
    Outcome,
    RedundantConstraints,
    StabilityWarning,
    ToleranceMissed,
    UnknownName,
    UnlikelyValue,
    Verdict,
)
from ancfdae.integrators.explicit import Explicit
from ancfdae.integrators.hht.method import HHT
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.radau.method import Radau
from ancfdae.integrators.step_control import ControlledSteps, FixedSteps, GivenSteps
from ancfdae.integrators.sundials.ida import IDA
from ancfdae.integrators.sundials.idas import IDAS
from ancfdae.integrators.sundials.index_reduced import IndexReduction
from ancfdae.model.bodies import (
    Beam,
    BodyShape,
    CurvedBeam,
    Point,
    RigidBody,
    RigidBox,
    RigidCylinder,
    RigidSphere,
)
from ancfdae.model.design import DesignVariable, distribution
from ancfdae.model.elements import (
    BEAM_2D,
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    EnhancedContinuum,
    PlaneStress,
    SaintVenantKirchhoff,
    StrainEnergy,
)
from ancfdae.model.joints.axis_joint import Cylindrical, PlanarJoint, Revolute
from ancfdae.model.joints.drive import Drive
from ancfdae.model.joints.guide import Guide
from ancfdae.model.joints.held_sections import Clamp, MovingBase, Weld
from ancfdae.model.joints.joint import Joint
from ancfdae.model.joints.point_joints import Distance, Pin, PointOnLine, Spherical
from ancfdae.model.joints.prismatic import Prismatic
from ancfdae.model.joints.universal import Universal
from ancfdae.model.laws.elementary import Constant, Harmonic, Uniform
from ancfdae.model.laws.law import Law
from ancfdae.model.laws.passages import Change, Ramp, RunUp
from ancfdae.model.laws.spline import Spline
from ancfdae.model.laws.user_law import UserLaw
from ancfdae.model.loads.forces import DistributedForce, FollowerForce, PointForce
from ancfdae.model.loads.friction import JointFriction, SlideFriction
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.springs import Bushing, SpringDamper
from ancfdae.model.loads.torques import Moment, Torque, TorsionSpring
from ancfdae.model.material import Material
from ancfdae.model.point_mass import PointMass
from ancfdae.model.scene import Scene
from ancfdae.model.sections.circle import Circle, Tube
from ancfdae.model.sections.general import MomentSection, PointSection
from ancfdae.model.sections.rectangle import Rectangle
from ancfdae.model.sections.section import Section
from ancfdae.model.sections.walled import Box, ISection
from ancfdae.model.starts import AtRest, NodeState, RigidMotion
from ancfdae.model.turning_frame import TurningFrame
from ancfdae.modes.configuration import Configuration
from ancfdae.modes.periods import StepSuggestion
from ancfdae.modes.result import Modes, MotionKind
from ancfdae.numerics.external import ExternalFunction
from ancfdae.numerics.patterns import Pattern
from ancfdae.sensitivity.adjoint import Adjoint, Direct
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.method import Accuracy, Gradient, Searched, UnfinishedRun
from ancfdae.sensitivity.objectives import (
    AtTimes,
    Integral,
    NonFiniteObjective,
    Objective,
    SmoothMaximum,
    Terminal,
    UpperMaximum,
)
from ancfdae.sensitivity.observables.drives import (
    drive_torque,
    guide_force,
    joint_power,
    load_power,
)
from ancfdae.sensitivity.observables.mass import (
    angular_momentum,
    centre_of_mass,
    inertia,
    linear_momentum,
    mass,
)
from ancfdae.sensitivity.observables.observable import Observable, observe
from ancfdae.sensitivity.observables.quantities import (
    design_value,
    elapsed_time,
    kinetic_energy,
    multiplier,
    reaction,
    strain_energy,
)
from ancfdae.sensitivity.observables.section_forces import (
    axial_force,
    bending_moment,
    shear_force,
    torque,
)
from ancfdae.sensitivity.observables.stress import maximum_stress, von_mises
from ancfdae.sensitivity.observables.user_functions import apply, custom
from ancfdae.sensitivity.observables.vectors import (
    axial_strain,
    deflection,
    position,
    slope,
    slope_angle,
    velocity,
)
from ancfdae.sensitivity.perturbation import ComplexStep, FiniteDifference
from ancfdae.statics.critical import CriticalLoad, NoCriticalPoint
from ancfdae.statics.equilibrium import Equilibrium, NoEquilibrium
from ancfdae.statics.outcome import FreeMechanism, LoadOutcome
from ancfdae.studies.calls import differentiate, evaluate, gradient, gradients, simulate
from ancfdae.studies.campbell import Campbell, campbell
from ancfdae.studies.error_bars import AdjointError, ErrorBars, adjoint_error, error_bars
from ancfdae.studies.fit import Fit
from ancfdae.studies.ladder import choose_model
from ancfdae.studies.ladder_result import Choice, ModelLadder, NoModel, Rung, RungRun
from ancfdae.studies.mass_properties import MassProperties, mass_properties
from ancfdae.studies.misfit import FrequencyMisfit, Misfit, RunFit, StaticMisfit
from ancfdae.studies.modes import modes, suggest_step
from ancfdae.studies.observing import Observations, observations
from ancfdae.studies.responses import Response, Responses
from ancfdae.studies.statics import CriticalValue, critical_load, equilibrium, static_gradient
from ancfdae.studies.sweep import Evaluate, sweep
from ancfdae.studies.sweep_file import Sweep, SweepRow
from ancfdae.studies.taylor import TaylorTest, taylor_test
from ancfdae.studies.tolerance.observables import Observed
from ancfdae.studies.tradeoff import tradeoff
from ancfdae.studies.tradeoff_result import Setting, TargetNotReached, Tradeoff

__version__: str

__all__ = [
    "BEAM_2D",
    "BEAM_3D",
    "CABLE_2D",
    "CABLE_3D",
    "HHT",
    "IDA",
    "IDAS",
    "Accuracy",
    "Adjoint",
    "AdjointError",
    "AncfSystem",
    "AncfdaeError",
    "AtRest",
    "AtTimes",
    "Beam",
    "BodyShape",
    "Box",
    "Bushing",
    "Campbell",
    "Change",
    "Choice",
    "Circle",
    "Clamp",
    "CoarseMesh",
    "ComplexStep",
    "Configuration",
    "Conformance",
    "Constant",
    "ContinuousAdjoint",
    "ControlledSteps",
    "CriticalLoad",
    "CriticalValue",
    "CurvedBeam",
    "Cylindrical",
    "DesignVariable",
    "Direct",
    "Direction",
    "Distance",
    "DistributedForce",
    "Drive",
    "EnhancedContinuum",
    "Equilibrium",
    "ErrorBars",
    "EstimatedErrors",
    "Evaluate",
    "Explicit",
    "ExternalFunction",
    "FailedDesign",
    "FiniteDifference",
    "Fit",
    "FixedSteps",
    "FollowerForce",
    "FormulaSystem",
    "FreeMechanism",
    "FrequencyMisfit",
    "GivenSteps",
    "Gradient",
    "Guide",
    "Harmonic",
    "ISection",
    "InconsistentStart",
    "IndexReduction",
    "Integral",
    "Integrator",
    "Interrupted",
    "InvalidInput",
    "Joint",
    "JointFriction",
    "LargeStrain",
    "Law",
    "Load",
    "LoadOutcome",
    "ManySteps",
    "MassProperties",
    "Material",
    "MechanicalSystem",
    "Misfit",
    "MissingPackage",
    "ModelLadder",
    "Modes",
    "Moment",
    "MomentSection",
    "MotionKind",
    "MovingBase",
    "NoCriticalPoint",
    "NoEquilibrium",
    "NoModel",
    "NodeState",
    "NonFiniteObjective",
    "NotSaved",
    "NotTraced",
    "Objective",
    "Observable",
    "Observations",
    "Observed",
    "Outcome",
    "Pattern",
    "Pin",
    "PlanarJoint",
    "PlaneStress",
    "Point",
    "PointForce",
    "PointMass",
    "PointOnLine",
    "PointSection",
    "Prismatic",
    "Radau",
    "Ramp",
    "Rectangle",
    "RedundantConstraints",
    "Response",
    "Responses",
    "Revolute",
    "RigidBody",
    "RigidBox",
    "RigidCylinder",
    "RigidMotion",
    "RigidSphere",
    "RunFit",
    "RunUp",
    "Rung",
    "RungRun",
    "SaintVenantKirchhoff",
    "Scene",
    "Searched",
    "Section",
    "Sensitivities",
    "Setting",
    "SlideFriction",
    "SmoothMaximum",
    "Solution",
    "Spherical",
    "Spline",
    "SpringDamper",
    "StabilityWarning",
    "StaticMisfit",
    "Statistics",
    "StepSuggestion",
    "StrainEnergy",
    "Sweep",
    "SweepRow",
    "TargetNotReached",
    "TaylorTest",
    "Terminal",
    "ToleranceMissed",
    "Torque",
    "TorsionSpring",
    "Tradeoff",
    "Traits",
    "Tube",
    "TurningFrame",
    "UnfinishedRun",
    "Uniform",
    "Universal",
    "UnknownName",
    "UnlikelyValue",
    "UpperMaximum",
    "UserLaw",
    "Verdict",
    "Weld",
    "__version__",
    "adjoint_error",
    "angular_momentum",
    "apply",
    "assemble",
    "axial_force",
    "axial_strain",
    "bending_moment",
    "campbell",
    "centre_of_mass",
    "check_system",
    "choose_model",
    "critical_load",
    "custom",
    "deflection",
    "design_value",
    "differentiate",
    "distribution",
    "drive_torque",
    "elapsed_time",
    "equilibrium",
    "error_bars",
    "evaluate",
    "gradient",
    "gradients",
    "guide_force",
    "inertia",
    "joint_power",
    "kinetic_energy",
    "linear_momentum",
    "load_power",
    "load_solution",
    "mass",
    "mass_properties",
    "maximum_stress",
    "modes",
    "multiplier",
    "observations",
    "observe",
    "position",
    "reaction",
    "shear_force",
    "simulate",
    "slope",
    "slope_angle",
    "static_gradient",
    "strain_energy",
    "suggest_step",
    "sweep",
    "taylor_test",
    "torque",
    "tradeoff",
    "velocity",
    "von_mises",
]
