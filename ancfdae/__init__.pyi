"""First-order design sensitivities of flexible multibody systems in ANCF."""

from ancfdae.assembly.saved import load_solution
from ancfdae.assembly.system import AncfSystem, assemble
from ancfdae.equations import (
    ErrorEstimates,
    FormulaSystem,
    MechanicalSystem,
    Sensitivities,
    Solution,
    Statistics,
)
from ancfdae.equations.conformance import check_system
from ancfdae.equations.files import SaveError
from ancfdae.errors import (
    AncfdaeError,
    CoarseMeshWarning,
    FailedDesignWarning,
    InconsistentStartError,
    Interrupted,
    InvalidInputError,
    LargeStrainWarning,
    ManyStepsWarning,
    MissingPackageError,
    NotTracedWarning,
    RedundantConstraintsError,
    StabilityWarning,
    ToleranceWarning,
    UnknownNameError,
    UnlikelyValueWarning,
    Verdict,
)
from ancfdae.integrators.explicit import DOP853
from ancfdae.integrators.hht.method import HHT
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.radau.method import Radau
from ancfdae.integrators.step_control import AdaptiveSteps, FixedSteps, PrescribedSteps
from ancfdae.integrators.sundials.ida import IDA
from ancfdae.integrators.sundials.idas import IDAS
from ancfdae.integrators.sundials.index_reduced import IndexReduction
from ancfdae.model.bodies import (
    Beam,
    BodyShape,
    CurvedBeam,
    RigidBody,
    RigidBox,
    RigidCylinder,
    RigidSphere,
)
from ancfdae.model.design import DesignVariable
from ancfdae.model.elements import (
    BEAM_2D,
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    EnhancedContinuum,
    PlaneStress,
    SaintVenantKirchhoff,
    StrainEnergyFunction,
)
from ancfdae.model.joints.axis_joint import Cylindrical, PlanarJoint, Revolute
from ancfdae.model.joints.drive import RotationDriver
from ancfdae.model.joints.held_sections import Clamp, MovingSupport, Weld
from ancfdae.model.joints.joint import Joint
from ancfdae.model.joints.point_joints import Distance, Pin, PointOnLine, Spherical
from ancfdae.model.joints.prismatic import Prismatic
from ancfdae.model.joints.universal import Universal
from ancfdae.model.laws.elementary import Constant, Harmonic
from ancfdae.model.laws.law import Law
from ancfdae.model.laws.passages import RunUp
from ancfdae.model.laws.spline import Spline
from ancfdae.model.laws.user_law import UserLaw
from ancfdae.model.loads.forces import DistributedForce, FollowerForce, PointForce
from ancfdae.model.loads.friction import RotationalFriction, TranslationalFriction
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.springs import Bushing, SpringDamper
from ancfdae.model.loads.torques import Moment, TorsionalSpringDamper
from ancfdae.model.material import Material
from ancfdae.model.point_mass import PointMass
from ancfdae.model.scene import Scene
from ancfdae.model.sections.circle import Circle, Tube
from ancfdae.model.sections.general import GeneralSection, QuadratureSection
from ancfdae.model.sections.rectangle import Rectangle
from ancfdae.model.sections.section import Section
from ancfdae.model.sections.walled import Box, ISection
from ancfdae.model.starts import EquilibriumStart, InitialVelocity, NodalState
from ancfdae.model.turning_frame import RotatingFrame
from ancfdae.modes.periods import StepSuggestion
from ancfdae.modes.result import ModeKind, Modes
from ancfdae.sensitivity.adjoint import Adjoint
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.method import Accuracy, Gradient, Searched, UnfinishedRunError
from ancfdae.sensitivity.objectives import (
    AtTimes,
    Integral,
    NonFiniteObjectiveError,
    Objective,
    SmoothMaximum,
    SmoothUpperBound,
    Terminal,
)
from ancfdae.sensitivity.observables.drives import (
    driver_force,
    driver_torque,
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
)
from ancfdae.sensitivity.observables.stress import maximum_von_mises, von_mises
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
from ancfdae.statics.critical import CriticalLoad, NoCriticalPointError
from ancfdae.statics.equilibrium import Equilibrium, NoEquilibriumError
from ancfdae.statics.outcome import EquilibriumOutcome, FreeMotionError
from ancfdae.studies.calls import differentiate, evaluate, gradient, gradients, simulate
from ancfdae.studies.campbell import Campbell, campbell
from ancfdae.studies.error_bars import (
    AdjointErrorEstimate,
    ErrorBars,
    error_bars,
    estimate_adjoint_error,
)
from ancfdae.studies.ladder import choose_model
from ancfdae.studies.ladder_result import (
    ModelComparison,
    NoAccurateModelError,
    VariantRun,
)
from ancfdae.studies.mass_properties import MassProperties, mass_properties
from ancfdae.studies.misfit import FrequencyMisfit, Misfit, RunResidualFunction, StaticMisfit
from ancfdae.studies.modes import modes, suggest_step
from ancfdae.studies.responses import Response, Responses
from ancfdae.studies.statics import CriticalValue, critical_load, equilibrium, equilibrium_gradient
from ancfdae.studies.sweep import sweep
from ancfdae.studies.sweep_file import Sweep, SweepRow
from ancfdae.studies.taylor import TaylorTest, taylor_test
from ancfdae.studies.tradeoff_result import MeasuredSetting, TargetNotReachedError

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
    "Accuracy",
    "AdaptiveSteps",
    "Adjoint",
    "AdjointErrorEstimate",
    "AncfSystem",
    "AncfdaeError",
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
    "CoarseMeshWarning",
    "ComplexStep",
    "Configuration",
    "Conformance",
    "Constant",
    "ContinuousAdjoint",
    "CriticalLoad",
    "CriticalValue",
    "CurvedBeam",
    "Cylindrical",
    "DesignVariable",
    "Direct",
    "Direction",
    "Distance",
    "DistributedForce",
    "EnhancedContinuum",
    "Equilibrium",
    "EquilibriumOutcome",
    "EquilibriumStart",
    "ErrorBars",
    "ErrorEstimates",
    "Evaluate",
    "FailedDesignWarning",
    "FiniteDifference",
    "Fit",
    "FixedSteps",
    "FollowerForce",
    "FormulaSystem",
    "FreeMotionError",
    "FrequencyMisfit",
    "GeneralSection",
    "Gradient",
    "Guide",
    "Harmonic",
    "ISection",
    "InconsistentStartError",
    "IndexReduction",
    "InitialVelocity",
    "Integral",
    "Integrator",
    "Interrupted",
    "InvalidInputError",
    "Joint",
    "LargeStrainWarning",
    "Law",
    "Load",
    "ManyStepsWarning",
    "MassProperties",
    "Material",
    "MeasuredSetting",
    "MechanicalSystem",
    "Misfit",
    "MissingPackageError",
    "ModeKind",
    "ModelComparison",
    "Modes",
    "Moment",
    "MovingSupport",
    "NoAccurateModelError",
    "NoCriticalPointError",
    "NoEquilibriumError",
    "NodalState",
    "NonFiniteObjectiveError",
    "NotTracedWarning",
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
    "PrescribedSteps",
    "Prismatic",
    "QuadratureSection",
    "Radau",
    "Ramp",
    "Rectangle",
    "RedundantConstraintsError",
    "Response",
    "Responses",
    "Revolute",
    "RigidBody",
    "RigidBox",
    "RigidCylinder",
    "RigidSphere",
    "RotatingFrame",
    "RotationDriver",
    "RotationalFriction",
    "RunResidualFunction",
    "RunUp",
    "Rung",
    "SaintVenantKirchhoff",
    "SaveError",
    "Scene",
    "Searched",
    "Section",
    "Sensitivities",
    "SmoothMaximum",
    "SmoothUpperBound",
    "Solution",
    "Spherical",
    "Spline",
    "SpringDamper",
    "StabilityWarning",
    "StaticMisfit",
    "Statistics",
    "StepSuggestion",
    "StrainEnergyFunction",
    "Sweep",
    "SweepRow",
    "TargetNotReachedError",
    "TaylorTest",
    "Terminal",
    "ToleranceWarning",
    "Torque",
    "TorsionalSpringDamper",
    "Tradeoff",
    "Traits",
    "TranslationalFriction",
    "Tube",
    "UnfinishedRunError",
    "Uniform",
    "Universal",
    "UnknownNameError",
    "UnlikelyValueWarning",
    "UserLaw",
    "VariantRun",
    "Verdict",
    "Weld",
    "__version__",
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
    "driver_force",
    "driver_torque",
    "elapsed_time",
    "equilibrium",
    "equilibrium_gradient",
    "error_bars",
    "estimate_adjoint_error",
    "evaluate",
    "gradient",
    "gradients",
    "inertia",
    "joint_power",
    "kinetic_energy",
    "linear_momentum",
    "load_power",
    "load_solution",
    "mass",
    "mass_properties",
    "maximum_von_mises",
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
    "strain_energy",
    "suggest_step",
    "sweep",
    "taylor_test",
    "torque",
    "tradeoff",
    "velocity",
    "von_mises",
]
