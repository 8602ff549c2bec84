"""Answers to names that the package does not have: the call or page that serves, or near names."""

import difflib
from collections.abc import Iterable

_CABLE = "A cable is a Beam(..., element=CABLE_2D), in space CABLE_3D (docs/howto/elements.md)."
_CONTACT = (
    "Contact is not supported (docs/limits.md). A penalty force on a point, such as a floor, is a "
    "Load of your own (docs/howto/own-parts.md)."
)
_GEAR = (
    "Gears are not supported (docs/limits.md). Two RotationDriver joints, with laws in the ratio, prescribe "
    "both rotations."
)
_ACCELERATION = (
    "No observable of acceleration exists. solution.acceleration(point) returns it, (n_t, d); "
    "velocity(point) is an observable."
)
_ROTATION = (
    "Rotations are observed by slope_angle(point) in the plane, by slope(point, along, axis) in "
    "space; the slope vectors of a section turn with it."
)
_RUN = "simulate(scene, t_end, HHT(step=...)) integrates the motion (docs/howto/integrator.md)."
_GROUND = "The ground needs no object: joints and loads take ground=(x, y), a place."
_SPRING = "Springs are SpringDamper (two points), TorsionalSpringDamper (an angle) and Bushing (all axes)."
_GRAVITY = "Gravity is an argument: Scene(..., gravity=(0, -9.81))."
_MOTOR = "A prescribed rotation is a RotationDriver, a prescribed force or torque a PointForce or MotorTorque."
_FORCE = "Forces on a point are PointForce, FollowerForce and DistributedForce."
_RIGID = "Rigid bodies are RigidBody, RigidBox, RigidCylinder and RigidSphere."
_LAW = "Functions of time are laws: Constant, ConstantAcceleration, Harmonic, SmoothStep, RunUp, Spline, UserLaw."
_MODES = "modes(scene, count) returns frequencies and shapes."
_OPTIMISE = (
    "Responses gives SciPy values and gradients (docs/optimisation.md); gradient computes one."
)
_PLOT = "ancfdae.plotting has the calls history, animate, snapshots and write_vtk."

# Names in lower case without underscores, as people know them from other programs.
_ANSWERS = {
    **dict.fromkeys(("cable", "rope", "string", "ancfcable", "ancfcable2d", "wire"), _CABLE),
    **dict.fromkeys(("contact", "collision", "impact", "floor", "penalty"), _CONTACT),
    "friction": "Friction is RotationalFriction in a joint, TranslationalFriction along a line.",
    **dict.fromkeys(("gear", "gears", "rackandpinion", "screw", "belt", "coupler"), _GEAR),
    **dict.fromkeys(("acceleration", "accelerations"), _ACCELERATION),
    **dict.fromkeys(
        ("angle", "rotation", "orientation", "angularvelocity", "quaternion", "omega"), _ROTATION
    ),
    **dict.fromkeys(("time", "t"), "The time since the start is the observable elapsed_time()."),
    **dict.fromkeys(("solve", "integrate", "run", "step", "dynamicsolver", "simulation"), _RUN),
    **dict.fromkeys(("ground", "fixed", "base", "world", "objectground"), _GROUND),
    **dict.fromkeys(("spring", "damper", "dashpot", "springdamp", "tsda", "rsda"), _SPRING),
    **dict.fromkeys(("gravity", "weight"), _GRAVITY),
    **dict.fromkeys(("motor", "actuator", "driver", "servo"), _MOTOR),
    **dict.fromkeys(("force", "pressure", "lineload"), _FORCE),
    **dict.fromkeys(("body", "rigid", "link", "bodyeasybox", "cylinder", "sphere"), _RIGID),
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
        "Energies are kinetic_energy() and strain_energy(); that of the weight is -m g times the "
        "height of centre_of_mass.",
    ),
    "displacement": "A displacement is position(point, axis) less its value at the start.",
}
# Similarity of names from which one is offered, and how many at most.
_NEAR, _MOST = 0.6, 3


def answer(name: str, known: Iterable[str]) -> str:
    """Return the message for a name that the package does not have: what serves, or near names."""
    text = f"ancfdae has no name {name!r}."
    plain = name.lower().replace("_", "")
    if plain in _ANSWERS:
        return f"{text} {_ANSWERS[plain]}"
    plains = {x.lower().replace("_", ""): x for x in known}
    near = [plains[x] for x in difflib.get_close_matches(plain, plains, _MOST, _NEAR)]
    if near:
        return f"{text} Did you mean {' or '.join(near)}?"
    return f"{text} dir(ancfdae) lists all names, docs/limits.md what is not supported."
