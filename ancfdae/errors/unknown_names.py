"""Messages for names that the package does not have: the call or page to use, or similar names."""

import difflib

from ancfdae.facade import public_names

_CABLE = "A cable is a Beam(..., element=CABLE_2D), in space CABLE_3D (docs/howto/elements.md)."
_CONTACT = (
    "Contact is a load: Contact(point, Plane(...), stiffness=...) of a point or sphere, "
    "BeamContact of a beam (docs/howto/contact.md). Impacts and stops of named points are "
    "events, too (docs/howto/events.md)."
)
_EVENT = (
    "Events are Impact, EndEvent and Switch, given as events= to a call (docs/howto/events.md)."
)
_GEAR = (
    "Gears are not supported (docs/limits.md). Two RotationDriver joints, with laws in the ratio, "
    "prescribe both rotations."
)
_ACCELERATION = (
    "acceleration(point, axis) of ancfdae.observables is one component; "
    "solution.acceleration(point) returns the vectors, (n_t, d)."
)
_ROTATION = (
    "Rotations are observed by rotation_angle(point, axis, other), also of a joint, by "
    "orientation(point, direction, axis) and by angular_velocity(point, axis)."
)
_RUN = "simulate(scene, t_end, HHT(step=...)) integrates the motion (docs/howto/integrator.md)."
_GROUND = "The ground needs no object: joints and loads take ground=(x, y), a place."
_SPRING = (
    "Springs are SpringDamper (two points), TorsionalSpringDamper (an angle) and Bushing (all "
    "axes)."
)
_GRAVITY = "Gravity is an argument: Scene(..., gravity=(0, -9.81))."
_MOTOR = (
    "A prescribed rotation is a RotationDriver, a prescribed force a PointForce, a prescribed "
    "torque a MotorTorque."
)
_FORCE = "Forces on a point are PointForce, FollowerForce and DistributedForce."
_RIGID = "Rigid bodies are RigidBody, RigidBox, RigidCylinder and RigidSphere."
_LAW = (
    "Functions of time are laws: Constant, ConstantAcceleration, Harmonic, SmoothStep, RunUp, "
    "Spline, UserLaw."
)
_MODES = "modes(scene, count) returns frequencies and shapes."
_OPTIMISE = (
    "Responses gives SciPy values and gradients (docs/optimisation.md); gradient computes one."
)
_PLOT = "ancfdae.plotting has the calls history, animate, snapshots and write_vtk."

# Names from other programs, in lower case without underscores, with the answer to them.
_ANSWERS = {
    **dict.fromkeys(("cable", "string", "ancfcable", "ancfcable2d", "wire"), _CABLE),
    **dict.fromkeys(
        ("collision", "floor", "wall", "obstacle", "penalty", "hertz", "huntcrossley", "touch"),
        _CONTACT,
    ),
    **dict.fromkeys(("event", "events", "stop", "lock", "latch", "clutch", "restitution"), _EVENT),
    "friction": "Friction is RotationalFriction in a joint, TranslationalFriction along a line "
    "and friction= of a Contact.",
    **dict.fromkeys(("gear", "gears", "rackandpinion", "screw", "belt", "coupler"), _GEAR),
    "accelerations": _ACCELERATION,
    **dict.fromkeys(
        ("angle", "rotation", "jointangle", "angularvelocity", "quaternion", "omega"), _ROTATION
    ),
    **dict.fromkeys(("time", "t"), "The time since the start is the observable elapsed_time()."),
    **dict.fromkeys(("solve", "integrate", "run", "step", "dynamicsolver", "simulation"), _RUN),
    **dict.fromkeys(("ground", "fixed", "base", "world", "objectground"), _GROUND),
    **dict.fromkeys(("spring", "damper", "dashpot", "springdamp", "tsda", "rsda"), _SPRING),
    **dict.fromkeys(("gravity", "weight"), _GRAVITY),
    **dict.fromkeys(("motor", "actuator", "driver", "servo"), _MOTOR),
    **dict.fromkeys(("force", "pressure", "lineload"), _FORCE),
    **dict.fromkeys(("body", "rigid", "link", "bodyeasybox"), _RIGID),
    **dict.fromkeys(("function", "timefunction", "signal", "sine", "sin", "stepfunction"), _LAW),
    **dict.fromkeys(("eigenmodes", "frequencies", "eigenvalues", "modal"), _MODES),
    **dict.fromkeys(("optimise", "optimize", "minimize", "minimise", "optimizer"), _OPTIMISE),
    **dict.fromkeys(("plot", "animate", "animation", "draw", "visualize", "show"), _PLOT),
    **dict.fromkeys(
        ("hinge", "revolutejoint", "pinjoint"),
        "A hinge is a Pin in the plane, a Revolute in space.",
    ),
    **dict.fromkeys(("ball", "balljoint"), "A ball joint is Spherical."),
    **dict.fromkeys(
        ("slider", "translational", "prismaticjoint"), "A slider is a Prismatic joint."
    ),
    **dict.fromkeys(
        ("fixedjoint", "rigidjoint"), "Clamp holds a beam to the ground, Weld to a body."
    ),
    **dict.fromkeys(
        ("plate", "shell", "solid", "membrane"),
        "Only beams, cables and rigid bodies are supported (docs/limits.md).",
    ),
    **dict.fromkeys(
        ("stress", "maxstress"),
        "Stresses are von_mises(point) and maximum_von_mises(beam, sharpness).",
    ),
    **dict.fromkeys(
        ("energy", "potentialenergy"),
        "Energies are kinetic_energy(), potential_energy() and its parts: strain_energy(), "
        "gravitational_energy() and spring_energy().",
    ),
    "displacement": "A displacement is position(point, axis) less its value at the start.",
}
# Least similarity of a name that is suggested, and most suggestions.
_NEAR, _MOST = 0.6, 3


# Names from before version 0.1, with the present names.
_RENAMED = {
    "AdjointError": "AdjointErrorEstimate",
    "AtRest": "EquilibriumStart",
    "Change": "Transition",
    "Choice": "ModelChoice",
    "CoarseMesh": "CoarseMeshWarning",
    "Configuration": "LinearisationPoint",
    "Conformance": "SystemCheck",
    "ControlledSteps": "AdaptiveSteps",
    "Direct": "DirectDifferentiation",
    "Direction": "StateDirection",
    "Drive": "RotationDriver",
    "EstimatedErrors": "ErrorEstimates",
    "Evaluate": "Evaluator",
    "Explicit": "DOP853",
    "FailedDesign": "FailedDesignWarning",
    "Fit": "ResidualFunction",
    "FreeMechanism": "FreeMotionError",
    "GivenSteps": "PrescribedSteps",
    "Guide": "TranslationDriver",
    "InconsistentStart": "InconsistentStartError",
    "InvalidInput": "InvalidInputError",
    "JointFriction": "RotationalFriction",
    "LargeStrain": "LargeStrainWarning",
    "LoadOutcome": "EquilibriumOutcome",
    "ManySteps": "ManyStepsWarning",
    "MissingPackage": "MissingPackageError",
    "ModelLadder": "ModelComparison",
    "MomentSection": "GeneralSection",
    "MotionKind": "ModeKind",
    "MovingBase": "MovingSupport",
    "NoCriticalPoint": "NoCriticalPointError",
    "NoEquilibrium": "NoEquilibriumError",
    "NoModel": "NoAccurateModelError",
    "NodeState": "NodalState",
    "NonFiniteObjective": "NonFiniteObjectiveError",
    "NotSaved": "SaveError",
    "NotTraced": "NotTracedWarning",
    "Observations": "ObservableRecord",
    "Observed": "ObservableEstimates",
    "Outcome": "RunOutcome",
    "Pattern": "SparsityPattern",
    "Point": "MaterialPoint",
    "PointSection": "QuadratureSection",
    "Ramp": "SmoothStep",
    "RedundantConstraints": "RedundantConstraintsError",
    "RigidMotion": "InitialVelocity",
    "RunFit": "RunResidualFunction",
    "Rung": "ModelVariant",
    "RungRun": "VariantRun",
    "Setting": "MeasuredSetting",
    "SlideFriction": "TranslationalFriction",
    "StrainEnergy": "StrainEnergyFunction",
    "TargetNotReached": "TargetNotReachedError",
    "ToleranceMissed": "ToleranceWarning",
    "Torque": "MotorTorque",
    "TorsionSpring": "TorsionalSpringDamper",
    "Tradeoff": "WorkPrecision",
    "Traits": "SystemProperties",
    "TurningFrame": "RotatingFrame",
    "UnfinishedRun": "UnfinishedRunError",
    "Uniform": "ConstantAcceleration",
    "UnknownName": "UnknownNameError",
    "UnlikelyValue": "UnlikelyValueWarning",
    "UpperMaximum": "SmoothUpperBound",
    "adjoint_error": "estimate_adjoint_error",
    "distribution": "distributed_variables",
    "drive_torque": "driver_torque",
    "guide_force": "driver_force",
    "maximum_stress": "maximum_von_mises",
    "observations": "record_observables",
    "static_gradient": "equilibrium_gradient",
    "torque": "torsional_moment",
    "tradeoff": "work_precision",
    "ComplexStepSystem": "FormulaSystem",
}


def answer(name: str, module: str) -> str:
    """Return the message for a name that a public module does not have.

    It gives the present place of the name, or the call or page to use instead, or similar names.
    """
    text = f"{module} has no name {name!r}."
    homes = public_names()
    now = _RENAMED.get(name, name)
    if now in homes:
        renamed = f"It is called {now} now" if now != name else "It is"
        return f"{text} {renamed}: from {homes[now]} import {now}."
    plain = name.lower().replace("_", "")
    if plain in _ANSWERS:
        return f"{text} {_ANSWERS[plain]}"
    plains = {x.lower().replace("_", ""): x for x in homes}
    same = [plain] if plain in plains else difflib.get_close_matches(plain, plains, _MOST, _NEAR)
    near = [plains[x] for x in same]
    if near:
        places = " or ".join(f"{homes[x]}.{x}" for x in near)
        return f"{text} Did you mean {places}?"
    return f"{text} dir({module}) lists all names, docs/limits.md what is not supported."
