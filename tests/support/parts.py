"""Every public joint and load, alone in a scene of the plane, of space or of planar cables."""

import functools
from dataclasses import replace

import numpy as np

from ancfdae import (
    CABLE_2D,
    Beam,
    Clamp,
    Cylindrical,
    Distance,
    DistributedForce,
    FollowerForce,
    Material,
    Pin,
    PlanarJoint,
    PointForce,
    PointOnLine,
    Prismatic,
    Revolute,
    Rope,
    RotationDriver,
    Scene,
    SlidingJoint,
    Spherical,
    SpringDamper,
    TranslationDriver,
    Universal,
    Weld,
    assemble,
)
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.model import joints, loads
from ancfdae.model.joints.joint import DrivenJoint, FormulaJoint, Joint
from ancfdae.model.loads.load import Load
from ancfdae.model.parts import Normal
from tests.support.by_hand import vector_by_hand
from tests.support.examples import all_examples, coefficients_of
from tests.support.oracle import plain_ancf as ancf
from tests.support.scenes import FLAT, THICK, arc
from tests.support.setting import MeasuredSetting

# Elastic forces of 1e-3 N beside loads of 10 N lose nothing in the difference.
GEL = Material(density=1000.0, youngs_modulus=1.0, poisson_ratio=0.3)
UNIFORM = ConstantAcceleration(speed=2.0, offset=0.3, acceleration=1.5)
HARMONIC = Harmonic(amplitude=0.4, frequency=3.0, phase=0.2, offset=0.1)


def beams(d):
    """A rod of two elements, an arm at its end and a curved beam, all oblique."""
    z = (0.2,) * (d - 2)
    rod = Beam("rod", (0.1, 0.2, *z), (0.9, 0.7, *z), 2, FLAT, GEL)
    arm = Beam("arm", (0.9, 0.7, *z), (1.5, 0.4, *(3 * x for x in z)), 1, THICK, GEL)
    bow = arc("bow", (0.9, 1.7, *z), 1.0, (0.0, 0.6), d, pitch=0.3 * (d - 2), material=GEL)
    return rod, arm, bow


def cables():
    """A rod and an arm of cable elements."""
    rod = Beam("rod", (0.1, 0.2), (0.9, 0.7), 2, FLAT, GEL, element=CABLE_2D)
    return rod, Beam("arm", (0.9, 0.7), (1.5, 0.4), 1, FLAT, GEL, element=CABLE_2D)


MEMBERS = {"planar": beams(2), "spatial": beams(3), "cable": cables()}
#: The two beams that examples stand on.
PAIRS = {space: (members[0], members[-1]) for space, members in MEMBERS.items()}


def planar_joints(rod, arm, _):
    return {
        "pin, node": Pin(rod.at(0.5)),
        "pin, nodes": Pin(rod.at_end, arm.at_start),
        "clamp, node": Clamp(rod.at(0.5)),
        "distance, node": Distance(rod.at_end, 0.7, ground=(1.1, 0.1)),
        "line, node": PointOnLine(rod.at(0.5), (0.8, -0.3)),
        "drive, node": RotationDriver(rod.at(0.5), UNIFORM),
        "guide, node": TranslationDriver(rod.at_end, (0.6, -0.8), HARMONIC),
        "weld, nodes": Weld(rod.at_end, arm.at_start),
        "prismatic, node": Prismatic(rod.at(0.5), (0.8, -0.3)),
    }


def spatial_joints(rod, arm, _):
    return {
        "spherical, node": Spherical(rod.at(0.5)),
        "revolute, node": Revolute(rod.at(0.5), (0.0, 0.0, 1.0)),
        "revolute, nodes": Revolute(rod.at_end, (0.0, 1.0, 0.0), arm.at_start),
        "distance, node": Distance(rod.at_end, 0.7, ground=(1.1, 0.1, 0.5)),
        "line, node": PointOnLine(rod.at(0.5), (0.0, 0.0, 2.0)),
        "drive, node": RotationDriver(rod.at(0.5), HARMONIC),
        "drive, nodes": RotationDriver(rod.at_end, UNIFORM, other=arm.at_start),
        "drive, twist inside": RotationDriver(rod.at(0.3), HARMONIC, axis=(0.8, 0.5, 0.0)),
        "guide, node": TranslationDriver(rod.at_end, (0.6, -0.8, 0.3), UNIFORM),
        "weld, nodes": Weld(rod.at_end, arm.at_start),
        "prismatic, node": Prismatic(rod.at(0.5), (0.8, -0.3, 0.1)),
        "cylindrical, node": Cylindrical(rod.at(0.5), (0.0, 0.0, 1.0)),
        "cylindrical, along inside": Cylindrical(rod.at(0.3), (0.8, 0.5, 0.0)),
        "cylindrical, nodes": Cylindrical(rod.at_end, (0.3, 1.0, -0.4), arm.at_start),
        "plane, nodes": PlanarJoint(rod.at_end, (0.0, 0.0, 1.0), arm.at_start),
        "universal, node": Universal(rod.at(0.5), (0.0, 0.0, 1.0), (0.5, -0.8, 0.0)),
        "universal, nodes": Universal(rod.at_end, (0, 0, 1), (0.4, 0.7, 0.1), arm.at_start),
    }


def planar_loads(rod, *_):
    return {
        "point, node": PointForce(rod.at_end, (3.0, -5.0)),
        "line, straight": DistributedForce("rod", (2.0, -4.0)),
        "follower, node": FollowerForce(rod.at(0.5), (4.0, 0.0)),
        "spring, undamped": SpringDamper(rod.at_end, 30.0, ground=(0.0, 1.0)),
    }


def spatial_loads(rod, *_):
    return {
        "point, node": PointForce(rod.at_end, (3.0, -5.0, 1.0)),
        "line, straight": DistributedForce("rod", (2.0, -4.0, 1.0)),
        "follower, node": FollowerForce(rod.at(0.5), (0.0, 0.0, 5.0)),
    }


def catalogue(module, base, planar, spatial):
    """Parts by space and name: at nodes, and examples of every class between nodes."""
    found = {f"planar {name}": part for name, part in planar(*MEMBERS["planar"]).items()}
    found |= {f"spatial {name}": part for name, part in spatial(*MEMBERS["spatial"]).items()}
    for space, (one, other) in PAIRS.items():
        off = 0.0 if space == "cable" else 0.01
        points = other.at(0.4, y=2 * off), one.at(0.8, y=-off)
        parts = all_examples(module, base, (one, other), points)
        found |= {f"{space} {name}": part for name, part in parts.items()}
    return found


#: Sliding joints and ropes, some examples of which are slack, have tests of their own:
#: tests/model/test_sliding.py and test_rope.py.
JOINTS = {
    name: joint
    for name, joint in catalogue(joints, Joint, planar_joints, spatial_joints).items()
    if not isinstance(joint, SlidingJoint)
}
LOADS = {
    name: load
    for name, load in catalogue(loads, Load, planar_loads, spatial_loads).items()
    if not isinstance(load, Rope)
}


class Alone(MeasuredSetting):
    """One part on the beams that it touches; the design is all that it can depend on."""

    def __init__(self, name, part):
        self.own = [f"{part.name}.{parameter}" for parameter in part.parameters()]
        touched = dict.fromkeys([*part.whole_beams, *(point.beam for point in part.points)])
        chosen = [beam for beam in MEMBERS[name.split()[0]] if beam.name in touched]
        scene = Scene(chosen, **{f"{part.role}s": [part]})
        super().__init__(scene, [*self.own, *(f"{beam.name}.length" for beam in chosen)])


def named_by_hand(system, q, name):
    """A vector that a joint names; of a cable the normal is its tangent, turned."""
    if isinstance(name, Normal):
        x, y = vector_by_hand(system, q, name.point, 1)
        return np.array([-y, x])
    return vector_by_hand(system, q, name[0], int(name[1]))


class JointSetting(Alone):
    def __init__(self, name):
        self.joint = JOINTS[name]
        super().__init__(name, self.joint)
        rng = np.random.default_rng(4)
        self.jerk = rng.uniform(-1, 1, self.system.n_q)
        self.lam_along = rng.uniform(-1, 1, self.system.n_lam)
        products = bool(np.any(self.coefficients(0.0, 0).bilinear))
        self.curved = products or isinstance(self.joint, FormulaJoint)
        self.steady = not (self.curved or isinstance(self.joint, DrivenJoint))

    def coefficients(self, t, order):
        """What the joint states, at its own parameters."""
        q_o = self.system.start()[0]
        vectors = self.joint.vectors(self.scene.elements)
        reference = np.array([named_by_hand(self.system, q_o, name) for name in vectors])
        p = np.array(list(self.joint.parameters().values()))
        return coefficients_of(self.joint, p, reference, t, order)

    def curve(self, t):
        """Cubic q(t) through the state at self.t, with its velocity."""
        s = t - self.t
        q = self.q + s * self.v + s**2 / 2 * self.a + s**3 / 6 * self.jerk
        return q, self.v + s * self.a + s**2 / 2 * self.jerk

    def size(self, value):
        """Scale where an exact derivative vanishes: the quantity, or 1 m and 1 rad."""
        return max(1.0, np.max(np.abs(value), initial=0.0))


def kinked(scene):
    """The scene with beams that have the same coordinates without its loads."""
    return replace(scene, beams=[b.with_kinks(scene.kinks.get(b.name, ())) for b in scene.beams])


class LoadSetting(Alone):
    def __init__(self, name):
        self.load = LOADS[name]
        super().__init__(name, self.load)
        self.bare = assemble(replace(kinked(self.scene), loads=[]), self.design[len(self.own) :])
        self.start = self.system.start()[0]
        self.factor = 1.0 if self.load.law is None else self.load.law.at(self.t)
        layout = self.system.naming.layout
        places = np.concatenate([body.positions for body in layout.bodies])
        self.positions = np.isin(np.arange(self.system.n_q // layout.d), places)

    def added(self, q=None, v=None, t=None):
        """Generalised force of the load."""
        q, v = self.q if q is None else q, self.v if v is None else v
        t = self.t if t is None else t
        return self.system.force(t, q, v) - self.without(lambda x, *z: x.force(*z), t, q, v)

    def without(self, of, t, *states):
        """A term of the equations without the load; zero for vectors of its states."""
        n = self.bare.n_q
        value = of(self.bare, t, *(x[:n] for x in states))
        return np.pad(value, [(0, self.system.n_q - n)] * value.ndim)

    def motion(self, seed):
        """A rigid motion of all bodies, a turn and a shift, and its rate; states stay."""
        d, rng = self.scene.dimension, np.random.default_rng(seed)
        first = self.bare.n_q // d
        spin, at = rng.uniform(-1, 1, (d, d)), self.positions
        rate = self.q.reshape(-1, d) @ (spin - spin.T)
        rate[at] += rng.uniform(-1, 1, d)
        rate[first:] = 0.0
        R, shift = ancf.random_rotation(d, rng), rng.uniform(-1, 1, d)

        def turned(x):
            X = x.reshape(-1, d).copy()
            X[:first] = X[:first] @ R.T
            return X.ravel()

        moved = turned(self.q).reshape(-1, d)
        moved[at] += shift
        return rate.ravel(), moved.ravel(), turned


joint_setting, load_setting = functools.cache(JointSetting), functools.cache(LoadSetting)
