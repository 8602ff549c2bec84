"""What observables and docstrings promise, held against formulas that share no code with them.

Rigid chains in space against d'Alembert's principle in minimal coordinates (`oracle.newton_euler`);
beams that deform, in any state, against the balance of momentum and of angular momentum of each;
the rest against closed forms. Nothing is at rest, symmetric, or along an axis of space.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    DOP853,
    HHT,
    IDA,
    Adjoint,
    AtTimes,
    Beam,
    Bushing,
    Clamp,
    CurvedBeam,
    Cylindrical,
    DirectDifferentiation,
    Distance,
    DistributedForce,
    FollowerForce,
    InitialVelocity,
    Integral,
    Material,
    Moment,
    MotorTorque,
    MovingSupport,
    NodalState,
    Pin,
    PlanarJoint,
    PointForce,
    PointMass,
    PointOnLine,
    Prismatic,
    Revolute,
    RigidBody,
    RotationalFriction,
    RotationDriver,
    Scene,
    SmoothMaximum,
    SpringDamper,
    Terminal,
    TorsionalSpringDamper,
    TranslationalFriction,
    TranslationDriver,
    Universal,
    Weld,
    assemble,
    equilibrium,
    gradients,
    mass_properties,
    modes,
    record_observables,
    simulate,
    suggest_step,
)
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.observables import (
    angular_momentum,
    axial_strain,
    centre_of_mass,
    driver_force,
    driver_torque,
    elapsed_time,
    inertia,
    joint_power,
    kinetic_energy,
    linear_momentum,
    load_power,
    mass,
    observe,
    reaction,
    slope_angle,
    strain_energy,
)
from ancfdae.plotting.mechanism import mechanism
from ancfdae.plotting.shapes import StrainEnergyDensity
from ancfdae.sections import Circle, QuadratureSection, Rectangle
from ancfdae.sensitivity.observables.observable import States
from tests.support.oracle.newton_euler import (
    Action,
    Body,
    accelerations,
    joint_wrenches,
    motions,
    rotation,
)

GRAVITY = np.array([1.3, -2.1, -8.7])


def unit(x):
    return np.asarray(x, float) / np.linalg.norm(x)


def six(I):
    return (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])


def shifted(m, d):
    """What Steiner adds to the tensor of inertia."""
    return m * (d @ d * np.eye(3) - np.outer(d, d))


# ---------------------------------------------------------------- chains of rigid bodies


@dataclass
class Chain:
    """A scene, its twin in minimal coordinates, and both at one instant of a motion.

    `named` are the actions of each load by name, as functions of t, s, s' and the motions.
    """

    scene: Scene
    bodies: list
    places: object
    joints: list
    named: object
    t: float = 0.0

    def start(self, s, ds):
        """Return the scene with the velocities of the twin."""
        moving = motions(self.places, s, ds, np.zeros(len(s)), 0.0)
        rigid = [body for body in self.scene.bodies if isinstance(body, RigidBody)]
        own = [
            InitialVelocity(body.name, tuple(m.omega), tuple(m.r), tuple(m.v))
            for body, m in zip(rigid, moving, strict=True)
        ]
        return dataclasses.replace(self.scene, start=own)

    def run(self, s, ds, t_end, coordinates):
        """Move both: ours by a run, the twin by the coordinates read from its last instant."""
        self.system = assemble(self.start(s, ds))
        solution = simulate(self.system, t_end, DOP853(1e-7, intervals=8))
        self.t = float(solution.t[-1])
        last = {x: getattr(solution, x)[-1:] for x in ("t", "q", "v", "a", "lam")}
        self.solution = dataclasses.replace(solution, degree=1, **last)
        self.s, self.ds = coordinates(self.solution)

        def actions(moving):
            own = [
                Action(k, b.mass * GRAVITY, moving[k].at(b.centre)[0], np.zeros(3))
                for k, b in enumerate(self.bodies)
            ]
            return [x for parts in self.of_loads(moving).values() for x in parts] + own

        self.dds = accelerations(self.bodies, self.places, actions, self.s, self.ds, self.t)
        self.moving = motions(self.places, self.s, self.ds, self.dds, self.t)
        self.wrenches = joint_wrenches(self.bodies, self.moving, actions(self.moving), self.joints)
        return self

    def of_loads(self, moving):
        return self.named(self.t, self.s, self.ds, moving)

    def observed(self, observable):
        return observe(observable, self.solution, self.system)[0]

    def vector(self, observable):
        return np.array([self.observed(observable(axis)) for axis in range(3)])


# The run is right to 1e-7, and so are places; forces of some 10 N are functions of these.
CLOSE = {"rtol": 0, "atol": 1e-6}


def tensors(seed, count):
    random = np.random.default_rng(seed)
    spreads = (random.normal(size=(count, 3, 3)) for _ in range(1))
    for P in next(spreads):
        P = 0.02 * P @ P.T + 0.05 * np.eye(3)
        yield np.trace(P) * np.eye(3) - P


def linear_spring(k, c, free, x, v, y, w):
    e = x - y
    l = np.linalg.norm(e)
    return -(k * (l - free) + c * ((v - w) @ e) / l) * e / l


@pytest.fixture(scope="module")
def elbow():
    """A driven body and one that swings from it, with every load, on tilted hinges."""
    F_1, F_2 = rotation([1, 2, -1], 0.8), rotation([-1, 0.5, 2], -1.1)
    I_1, I_2 = tensors(3, 2)
    c_1, c_2 = np.array([0.2, -0.1, 0.15]), np.array([-0.1, 0.25, 0.05])
    a_1, a_2 = unit([0.3, -0.5, 0.8]), unit([-0.6, 0.2, 0.7])
    p_1, q_1, p_2 = np.array([[-0.3, 0.2, 0.1], [0.4, -0.2, 0.3], [-0.2, -0.1, 0.25]])
    o_1 = np.array([0.3, 0.1, -0.2])
    base, joint = o_1 + F_1 @ p_1, o_1 + F_1 @ q_1
    o_2 = joint - F_2 @ p_2
    one = RigidBody("one", o_1, mass=2.3, inertia=six(I_1), centre=c_1, frame=F_1.T)
    two = RigidBody("two", o_2, mass=1.7, inertia=six(I_2), centre=c_2, frame=F_2.T)
    hinge, ground = {"axis": a_2, "other": one.origin}, np.array([1.0, 0.5, -0.7])
    x, y, lump = np.array([[0.1, 0.3, 0.2], [0.1, 0.1, 0.1], [0.3, 0.2, -0.4]])
    push = np.array([1.0, -2.0, 0.5])
    loads = [
        SpringDamper(two.at(*x), 40.0, 1.5, 0.6, ground=ground, name="spring"),
        SpringDamper(two.at(*x), 25.0, 0.8, 0.3, other=one.at(*y), name="between"),
        TorsionalSpringDamper(two.origin, 3.0, 0.2, 0.4, **hinge, name="torsion spring"),
        MotorTorque(two.origin, 1.1, **hinge, name="torque", law=Harmonic(1.0, 4.0, 0.3)),
        RotationalFriction(two.origin, 0.5, 0.3, 0.07, 1.0, 0.8, **hinge, name="friction"),
        FollowerForce(two.at(*x), push, name="follower"),
        Moment(two.origin, push, name="moment"),
        Moment(one.origin, push, follower=True, name="moment that follows"),
        PointForce(one.at(*x), push, name="force", law=ConstantAcceleration(0.5, 1.0)),
    ]
    law = Harmonic(0.7, 3.0, 0.4, -0.7 * np.sin(0.4))
    joints = [
        Revolute(one.at(*p_1), a_1, name="base"),
        RotationDriver(one.at(*p_1), law, axis=a_1, name="motor"),
        Revolute(two.at(*p_2), a_2, other=one.at(*q_1), name="elbow"),
    ]
    payload = PointMass(two.at(*lump), 0.6, name="payload")
    scene = Scene([], joints, GRAVITY, loads=loads, bodies=[one, two, payload])

    def places(s, t):
        R_1 = rotation(a_1, 0.7 * np.sin(3 * t + 0.4) - 0.7 * np.sin(0.4))
        R_2 = R_1 @ rotation(a_2, s[0])
        r_1, place = base + R_1 @ (o_1 - base), base + R_1 @ (joint - base)
        return [(r_1, R_1 @ F_1), (place + R_2 @ (o_2 - joint), R_2 @ F_2)]

    c = (1.7 * c_2 + 0.6 * lump) / 2.3
    both = Body(2.3, I_2 + shifted(1.7, c_2 - c) + shifted(0.6, lump - c), c)

    def named(t, s, ds, moving):
        m_1, m_2 = moving
        axis, none = m_1.R @ F_1.T @ a_2, np.zeros(3)
        (r_x, v_x, _), (r_y, v_y, _) = m_2.at(x), m_1.at(y)
        inner = linear_spring(25.0, 0.8, 0.3, r_x, v_x, r_y, v_y)
        w = ds[0]
        stribeck = (0.5 + 0.5 * np.exp(-((w / 0.8) ** 2))) * np.tanh(w / 0.3) + 0.07 * w
        outer = linear_spring(40.0, 1.5, 0.6, r_x, v_x, ground, 0.0)
        own = {
            "spring": [Action(1, outer, r_x, none)],
            "between": [Action(1, inner, r_x, none), Action(0, -inner, r_y, none)],
            "follower": [Action(1, m_2.R @ push, r_x, none)],
            "moment": [Action(1, none, r_x, push)],
            "moment that follows": [Action(0, none, r_y, m_1.R @ push)],
            "force": [Action(0, push * (1 + 0.5 * t), m_1.at(x)[0], none)],
        }
        for name, T in (
            ("torsion spring", -(3.0 * (s[0] - 0.4) + 0.2 * w)),
            ("torque", 1.1 * np.sin(4 * t + 0.3)),
            ("friction", -stribeck),
        ):
            own[name] = [Action(1, none, r_x, T * axis), Action(0, none, r_y, -T * axis)]
        return own

    def coordinates(solution):
        R = [solution.nodes(name)[0, 0, 1:].T @ F.T for name, F in (("one", F_1), ("two", F_2))]
        D = R[0].T @ R[1]
        s = np.arctan2(a_2 @ np.cross(across(a_2), D @ across(a_2)), across(a_2) @ D @ across(a_2))
        W = [rate(solution, name) for name in ("one", "two")]
        return np.array([s]), np.array([(W[1] - W[0]) @ R[0] @ a_2])

    twin = [Body(2.3, I_1, c_1), both]
    chain = Chain(scene, twin, places, [p_1, p_2], named)
    chain.run(np.zeros(1), np.array([1.2]), 0.1, coordinates)
    chain.axis, chain.law, chain.tensor = a_1, law, I_1
    return chain


def across(a):
    return unit(np.cross(a, [0.3, 0.9, -0.2]))


def rate(solution, name):
    """Spin of a rigid body from the rates of its axes."""
    d, v = (solution.naming.nodes(x, name)[0, 0, 1:] for x in (solution.q, solution.v))
    return 0.5 * sum(np.cross(a, b) for a, b in zip(d, v, strict=True))


def test_both_move_alike(elbow):
    x = np.array([0.1, 0.2, 0.3])
    for k, name in enumerate(("one", "two")):
        point = elbow.scene.member(name).at(*x)
        own = elbow.moving[k].at(x)
        for ours, exact in zip(
            (elbow.solution.position, elbow.solution.velocity, elbow.solution.acceleration),
            own,
            strict=True,
        ):
            assert np.allclose(ours(point)[0], exact, **CLOSE)


def test_reactions_of_hinges_are_forces_on_their_first_points(elbow):
    for (force, _), name in zip(elbow.wrenches, ("base", "elbow"), strict=True):
        assert np.linalg.norm(force) > 5.0
        assert np.allclose(elbow.vector(lambda i, n=name: reaction(n, i)), force, **CLOSE)
        assert np.allclose(elbow.solution.reaction(name)[0], force, **CLOSE)


def test_a_motor_gives_the_moment_about_its_axis(elbow):
    torque = elbow.wrenches[0][1] @ elbow.axis
    power = torque * elbow.law.at(elbow.t, 1)
    assert abs(torque) > 1.0
    assert np.allclose(elbow.observed(driver_torque("motor")), torque, **CLOSE)
    assert np.allclose(elbow.observed(joint_power("motor")), power, **CLOSE)


def test_the_power_of_every_load_is_that_of_its_forces(elbow):
    for name, parts in elbow.of_loads(elbow.moving).items():
        power = sum(part.power(elbow.moving) for part in parts)
        assert abs(power) > 1e-3, name
        assert np.allclose(elbow.observed(load_power(name)), power, **CLOSE), name


def test_momenta_energy_and_inertia_are_those_of_the_bodies(elbow):
    m, moving = [b.mass for b in elbow.bodies], elbow.moving
    r, v = np.array(
        [x.at(b.centre)[:2] for b, x in zip(elbow.bodies, moving, strict=True)]
    ).swapaxes(0, 1)
    J = [x.R @ b.inertia @ x.R.T for b, x in zip(elbow.bodies, moving, strict=True)]
    spins = [x.omega for x in moving]
    centre = (m[0] * r[0] + m[1] * r[1]) / sum(m)

    def about(place):
        return sum(J[k] + shifted(m[k], r[k] - place) for k in range(2))

    def seen(place=None, beam=None):
        return np.array(
            [[elbow.observed(inertia(i, j, beam, place)) for j in range(3)] for i in range(3)]
        )

    L = sum(m[k] * np.cross(r[k], v[k]) + J[k] @ spins[k] for k in range(2))
    T = sum(m[k] * v[k] @ v[k] + spins[k] @ J[k] @ spins[k] for k in range(2)) / 2
    assert np.allclose(elbow.vector(angular_momentum), L, **CLOSE)
    assert np.allclose(elbow.vector(linear_momentum), m[0] * v[0] + m[1] * v[1], **CLOSE)
    assert np.allclose(elbow.observed(kinetic_energy()), T, **CLOSE)
    assert np.allclose(elbow.vector(centre_of_mass), centre, **CLOSE)
    assert np.allclose(seen(), about(centre), **CLOSE)
    x = np.array([0.1, 0.2, 0.3])
    on_body = elbow.scene.member("one").at(*x)
    assert np.allclose(seen(on_body), about(moving[0].at(x)[0]), **CLOSE)
    assert np.allclose(seen(tuple(GRAVITY)), about(GRAVITY), **CLOSE)
    assert np.allclose(seen(beam="one"), J[0], **CLOSE)


@pytest.fixture(scope="module")
def slider():
    """Guide, prismatic and cylindrical joint with a motor, universal joint and weld, in a row."""
    random = np.random.default_rng(5)
    F = [rotation(random.normal(size=3), angle) for angle in (0.8, -1.1, 2.0, 0.4)]
    I, m = list(tensors(7, 4)), (2.3, 1.7, 1.1, 0.8)
    c, p, q = (random.normal(size=(4, 3)) * size for size in (0.2, 0.3, 0.3))
    a, b = unit([0.3, -0.5, 0.8]), unit([-0.6, 0.2, 0.7])
    arm = unit([0.2, 0.9, -0.3])
    cross = unit(np.cross(arm, [1, 0, 0.3]))
    o, x = [np.array([0.3, 0.1, -0.2])], []
    for k in range(3):
        x.append(o[k] + F[k] @ q[k])
        o.append(x[k] - F[k + 1] @ p[k + 1])
    body = [
        RigidBody(f"b{k}", o[k], mass=m[k], inertia=six(I[k]), centre=c[k], frame=F[k].T)
        for k in range(4)
    ]
    first, second = body[0].at(*p[0]), (body[1].at(*p[1]), body[0].at(*q[0]))
    slide = Harmonic(0.2, 3.0, 0.4, -0.2 * np.sin(0.4))
    turn = Harmonic(0.5, 2.0, -0.3, 0.5 * np.sin(0.3))
    joints = [
        Prismatic(first, a, name="prismatic"),
        TranslationDriver(first, a, slide, name="guide"),
        Cylindrical(second[0], b, other=second[1], name="cylindrical"),
        RotationDriver(body[1].origin, turn, axis=b, other=body[0].origin, name="motor"),
        Universal(body[2].at(*p[2]), arm, cross, other=body[1].at(*q[1]), name="universal"),
        Weld(body[3].at(*p[3]), body[2].at(*q[2]), name="weld"),
    ]
    y, z, ground = np.array([0.1, 0.2, 0.3]), np.array([-0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.7])
    rub = TranslationalFriction(
        second[0], b, 1.5, 0.2, 0.3, 2.5, 0.5, other=second[1], name="friction"
    )
    loads = [
        rub,
        SpringDamper(body[1].at(*y), 30.0, 1.0, 0.2, other=body[0].at(*z), name="between"),
        SpringDamper(body[3].at(*y), 20.0, 1.0, 0.2, ground=ground, name="spring"),
    ]
    scene = Scene([], joints, GRAVITY, loads=loads, bodies=body)

    def places(s, t):
        d = 0.2 * (np.sin(3 * t + 0.4) - np.sin(0.4)) * a
        R = [np.eye(3), rotation(b, 0.5 * (np.sin(2 * t - 0.3) + np.sin(0.3)))]
        R.append(R[1] @ rotation(cross, s[1]) @ rotation(arm, s[2]))
        at = x[0] + d + s[0] * b
        after = at + R[1] @ (x[1] - x[0])
        r = [o[0] + d, at + R[1] @ (o[1] - x[0])]
        r += [after + R[2] @ (o[k] - x[1]) for k in (2, 3)]
        return [(r[k], R[min(k, 2)] @ F[k]) for k in range(4)]

    def named(t, s, ds, moving):
        none, w = np.zeros(3), ds[0]
        (r_y, v_y, _), (r_z, v_z, _) = moving[1].at(y), moving[0].at(z)
        inner = linear_spring(30.0, 1.0, 0.2, r_y, v_y, r_z, v_z)
        R = (1.5 + np.exp(-((w / 0.5) ** 2))) * np.tanh(w / 0.2) + 0.3 * w
        contact = moving[1].at(p[1])[0]
        last = moving[3].at(y)
        outer = linear_spring(20.0, 1.0, 0.2, last[0], last[1], ground, 0.0)
        return {
            "friction": [Action(1, -R * b, contact, none), Action(0, R * b, contact, none)],
            "between": [Action(1, inner, r_y, none), Action(0, -inner, r_z, none)],
            "spring": [Action(3, outer, last[0], none)],
        }

    def coordinates(solution):
        R = [solution.nodes(f"b{k}")[0, 0, 1:].T @ F[k].T for k in range(3)]
        at = [solution.position(point)[0] for point in second]
        v = [solution.velocity(point)[0] for point in second]
        W = [rate(solution, f"b{k}") for k in range(3)]
        D = R[1].T @ R[2]
        # D = rotation(cross, s_1) rotation(arm, s_2): D arm = rotation(cross, s_1) arm.
        s_1 = np.arctan2((D @ arm) @ np.cross(cross, arm), (D @ arm) @ arm)
        back = rotation(cross, s_1).T @ D
        s_2 = np.arctan2((back @ cross) @ np.cross(arm, cross), (back @ cross) @ cross)
        w = R[1].T @ (W[2] - W[1])
        s = np.array([(at[0] - at[1]) @ b, s_1, s_2])
        return s, np.array([(v[0] - v[1]) @ b, w @ cross, w @ rotation(cross, s_1) @ arm])

    twin = [Body(m[k], I[k], c[k]) for k in range(4)]
    chain = Chain(scene, twin, places, list(p), named)
    chain.run(np.zeros(3), np.array([0.4, 1.3, -0.7]), 0.1, coordinates)
    chain.laws, chain.axes, chain.frames = (slide, turn), (a, b), F
    return chain


def test_universal_joint_and_weld_react_with_their_force(slider):
    for name, k in (("universal", 2), ("weld", 3)):
        force, moment = slider.wrenches[k]
        assert np.allclose(slider.vector(lambda i, n=name: reaction(n, i)), force, **CLOSE)
        # The rows behind the force are the turns: their multipliers are of the size of the moment.
        turns = slider.solution.multipliers(name)[0, 3:]
        assert np.allclose(np.linalg.norm(turns), np.linalg.norm(moment), **CLOSE)
        if name == "weld":
            carried = slider.moving[k].R @ slider.frames[k].T
            assert np.allclose(-turns, (carried.T @ moment)[[2, 0, 1]], **CLOSE)


def as_on_a_line(a):
    """The directions across a line in space, as `PointOnLine` words them."""
    most = np.eye(3)[np.argmin(np.abs(a))]
    first = unit(most - (most @ a) * a)
    return np.stack([first, np.cross(a, first)])


def test_sliding_joints_hold_the_force_across_their_axis(slider):
    for name, k, axis, turns in (("prismatic", 0, 0, 3), ("cylindrical", 1, 1, 2)):
        (force, moment), a = slider.wrenches[k], slider.axes[axis]
        lam, e = slider.solution.multipliers(name)[0], as_on_a_line(a)
        # Body 0 does not turn, and carries the axis of the cylinder.
        assert np.allclose(-lam[:2] @ e, force - (force @ a) * a, **CLOSE)
        if k == 1:
            moment = np.cross(a, moment)
        own = np.linalg.norm(lam[2 : 2 + turns])
        assert np.allclose(own, np.linalg.norm(moment), **CLOSE)


def test_a_guide_and_a_motor_on_a_moving_base_give_force_and_moment(slider):
    (slide, turn), (a, b) = slider.laws, slider.axes
    force, torque = slider.wrenches[0][0] @ a, slider.wrenches[1][1] @ b
    assert min(abs(force), abs(torque)) > 0.5
    for observable, exact in (
        (driver_force("guide"), force),
        (driver_torque("motor"), torque),
        (joint_power("guide"), force * slide.at(slider.t, 1)),
        (joint_power("motor"), torque * turn.at(slider.t, 1)),
    ):
        assert np.allclose(slider.observed(observable), exact, **CLOSE)


def test_the_power_of_loads_between_moving_bodies_is_that_of_their_forces(slider):
    for name, parts in slider.of_loads(slider.moving).items():
        power = sum(part.power(slider.moving) for part in parts)
        assert np.allclose(slider.observed(load_power(name)), power, **CLOSE), name


# ---------------------------------------------------------------- balances of beams that deform


SOFT = Material(1100, 2e6, 0.3, damping_time=2e-3)
LOPSIDED = QuadratureSection(
    places=[(0.02, 0.01), (-0.01, 0.02), (0.005, -0.02), (-0.015, -0.01)],
    areas=[2e-4, 3e-4, 1.5e-4, 1e-4],
)


def curved(d, rigid=False):
    """An arc, in space a pretwisted helix, with another section in every element."""
    s = np.linspace(0.0, 1.3, 4)
    zero, rise = 0 * s, 0.2 * (d - 2)
    t = np.stack([0.5 * np.cos(s), 0.5 * np.sin(s), zero + rise], axis=1)
    t /= np.linalg.norm(t, axis=1)[:, None]
    n = np.stack([-np.sin(s), np.cos(s), zero], axis=1)
    places = np.stack([0.5 * np.sin(s), 0.5 * (1 - np.cos(s)), rise * s], axis=1)
    twist = (d - 2) * 0.6 * s[:, None]
    height = np.cos(twist) * n + np.sin(twist) * np.cross(t, n)
    frames = np.stack([t, height, np.cross(t, height)], axis=1)[:, :d, :d]
    R = rotation([1, 2, 3], 0.7) if d == 3 else np.eye(3)
    sections = [Rectangle(0.05 - 0.01 * k, 0.03) for k in range(3)]
    places, frames = places[:, :d] @ R[:d, :d].T + 0.3, frames @ R[:d, :d].T
    return CurvedBeam("one", places, frames, sections, SOFT, rigid=rigid)


def place_of(beam, point):
    """Place of a point in the reference."""
    solution = simulate(Scene([beam], [Clamp(beam.at_start)]), 1e-3, HHT(1e-3))
    return solution.position(point)[0]


def ruffled(beam, seed):
    """A state of nodes near the reference, strained and moving, at random."""
    X = simulate(Scene([beam], [Clamp(beam.at_start)]), 1e-3, HHT(1e-3)).nodes(beam.name)[0]
    random = np.random.default_rng(seed)
    return NodalState(
        beam.name, X + 0.01 * random.normal(size=X.shape), 0.3 * random.normal(size=X.shape)
    )


def line_load(beam, density, solution):
    """Force, and moment about the origin, of a force per length by Gauss's rule."""
    lengths = beam.reference().lengths
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    nodes, weights = np.polynomial.legendre.leggauss(4)
    F, M = 0.0, 0.0
    for first, l in zip(ends[:-1], lengths, strict=True):
        for x, w in zip((nodes + 1) / 2, weights / 2, strict=True):
            r = solution.position(beam.at((first + x * l) / ends[-1]))[0]
            F, M = F + w * l * density, M + w * l * turning(r, density)
    return F, M


def turning(r, F):
    """Moment of a force; in the plane that about z."""
    return np.cross(r, F) if len(r) == 3 else np.array([r[0] * F[1] - r[1] * F[0]])


class Balance:
    """Forces and moments about the origin on each of two beams against the rates of momenta."""

    def __init__(self, beams, joints, loads, lump, point):
        d = beams[0].dimension
        starts = [ruffled(beam, k) for k, beam in enumerate(beams) if not beam.rigid]
        payload = PointMass(point, lump, name="lump")
        scene = Scene(
            beams, joints, GRAVITY[-d:], starts, loads, bodies=[payload], project_start=True
        )
        self.system, self.d = assemble(scene), d
        # At the start accelerations and multipliers obey M a + Phi_q^T lam = Q to round-off.
        self.solution = simulate(self.system, 1e-5, HHT(1e-5))
        self.rates = dataclasses.replace(self.solution, v=self.solution.a)
        axes = range(3) if d == 3 else (2,)
        parts = {"one": ["one"], "two": ["two", "lump"]}
        self.left = {}
        for name, owners in parts.items():
            P = sum(self.seen(linear_momentum, range(d), owner) for owner in owners)
            L = sum(self.seen(angular_momentum, axes, owner) for owner in owners)
            self.left[name] = [P, L]
            for owner in owners:
                weight = observe(mass(owner), self.solution, self.system)[0] * GRAVITY[-d:]
                centre = [
                    observe(centre_of_mass(i, owner), self.solution, self.system)[0]
                    for i in range(d)
                ]
                self.take(name, weight, np.array(centre))

    def seen(self, observable, axes, owner):
        return np.array([observe(observable(i, owner), self.rates, self.system)[0] for i in axes])

    def take(self, name, force, place, moment=0.0):
        """Subtract a force from the residuals of the momentum balances of a beam or body."""
        self.left[name][0] = self.left[name][0] - force
        self.left[name][1] = self.left[name][1] - turning(place, force) - moment

    def at(self, point):
        return self.solution.position(point)[0], self.solution.velocity(point)[0]

    def between(self, first, second, force):
        """Take a force on a point of the first, and its opposite on one of the second, if any."""
        self.take(first.beam, force, self.at(first)[0])
        if second is not None:
            self.take(second.beam, -force, self.at(second)[0])

    def value(self, observable):
        return observe(observable, self.solution, self.system)[0]


def two_beams(d, kind):
    """Two beams of a kind, with places of a base and of an elbow off their axes."""
    cable = {"element": CABLE_2D} if kind == "cable" else {}
    off = 0.0 if cable else 0.01
    z = {"z": -0.005} if d == 3 else {}
    one = curved(d, rigid=kind == "rigid")
    if cable:
        one = Beam("one", (0, 0), (0.5, 0.2), 3, one.section, SOFT, **cable)
    base, elbow = one.at(0.1, off, **z), one.at(0.8, -off, **z)
    span = np.array([0.4, -0.2, 0.3])[:d]
    section = LOPSIDED if d == 3 else [Rectangle(0.04, 0.02), Rectangle(0.03, 0.02)]
    two = Beam("two", (0,) * d, tuple(span), 2, section, SOFT, rigid=kind == "rigid", **cable)
    inner = two.at(0.3, off / 2, **z)
    start = place_of(one, elbow) - place_of(two, inner)
    return (
        one,
        dataclasses.replace(two, start=tuple(start), end=tuple(start + span)),
        base,
        inner,
        elbow,
    )


def loaded(one, two, base, inner, elbow, joints):
    """Return the balance of both beams with all but the joints taken out."""
    d, off = one.dimension, 0.0 if one.element is CABLE_2D else 0.004
    f_1, f_2 = np.array([0.5, -1.0, 2.0])[:d], np.array([-0.5, 0.3, 1.0])[:d]
    moment = 0.03 if d == 2 else np.array([0.01, -0.02, 0.03])
    lump, point = 0.05, two.at(0.6, off)
    loads = [
        DistributedForce("one", f_1, name="line 1", law=Harmonic(1.0, 3.0, 0.2, 1.0)),
        DistributedForce("two", f_2, name="line 2"),
        PointForce(one.at(0.6, off), f_1, name="force"),
        Moment(two.at(0.7), moment, name="moment"),
        SpringDamper(one.at(0.95), 3.0, 0.1, 0.2, other=two.at(0.5), name="spring"),
    ]
    follows = one.element is not CABLE_2D
    if follows:
        loads.append(FollowerForce(two.at(0.9, off), f_2, name="follower"))
    own = Balance([one, two], joints, loads, lump, point)
    for beam, density in ((one, f_1 * (1 + np.sin(0.2))), (two, f_2)):
        F, M = line_load(beam, density, own.solution)
        own.take(beam.name, F, np.zeros(d), M)
    own.take("one", f_1, own.at(one.at(0.6, off))[0])
    own.take("two", np.zeros(d), np.zeros(d), moment)
    own.between(
        one.at(0.95),
        two.at(0.5),
        linear_spring(3.0, 0.1, 0.2, *own.at(one.at(0.95)), *own.at(two.at(0.5))),
    )
    if follows:
        slopes = (own.solution.slope(two.at(0.9, off), k)[0] for k in range(d))
        force = sum(f * unit(r) for f, r in zip(f_2, slopes, strict=True))
        own.take("two", force, own.at(two.at(0.9, off))[0])
    return own


# Round-off of the solution of M a + Phi_q^T lam = Q, whose largest entries are elastic forces of
# slopes, some 1e3 times the forces and moments here.
BALANCED = {"rtol": 0, "atol": 1e-9}


@pytest.mark.parametrize("kind", ["soft", "rigid"])
@pytest.mark.parametrize("between", [Pin, Weld, Universal])
def test_forces_and_moments_on_spatial_beams_balance(kind, between):
    one, two, base, inner, elbow = two_beams(3, kind)
    a, other = unit([0.3, -0.5, 0.8]), {"other": elbow, "name": "elbow"}
    joints = [
        Revolute(base, a, name="base"),
        RotationDriver(base, ConstantAcceleration(0.0, 0.0, 0.7), a, name="motor"),
    ]
    joints.append(
        Universal(inner, a, np.cross(a, [1, 0, 0.2]), **other)
        if between is Universal
        else between(inner, **other)
    )
    own = loaded(one, two, base, inner, elbow, joints)
    for first, second, name in ((base, None, "base"), (inner, elbow, "elbow")):
        own.between(first, second, np.array([own.value(reaction(name, i)) for i in range(3)]))
    (P_1, L_1), (P_2, L_2) = own.left["one"], own.left["two"]
    assert np.allclose(P_1, 0, **BALANCED)
    assert np.allclose(P_2, 0, **BALANCED)
    if between is Pin:
        assert np.allclose(L_2, 0, **BALANCED)
    # What the elbow turns one by it turns the other by; the motor holds the rest about its axis.
    assert np.allclose((L_1 + L_2) @ a, own.value(driver_torque("motor")), **BALANCED)


@pytest.mark.parametrize("kind", ["soft", "rigid", "cable"])
@pytest.mark.parametrize("held", ["pin", "base", "line"])
def test_forces_and_moments_on_planar_beams_balance(kind, held):
    one, two, base, inner, elbow = two_beams(2, kind)
    joints = [Pin(inner, elbow, name="elbow")]
    if held == "base":
        joints.append(MovingSupport(base, (1, 2), ConstantAcceleration(0.0, 0.0, 0.7), name="base"))
    else:
        joints.append(Pin(base, name="base"))
        joints.append(RotationDriver(base, ConstantAcceleration(0.0, 0.0, 0.7), name="motor"))
    end = place_of(two, two.at_end)
    ground = end + np.array([0.1, 0.2])
    length = np.hypot(0.1, 0.2)
    if held == "line":
        joints.append(
            TranslationDriver(two.at_end, (2, 1), ConstantAcceleration(0.0, 0.0, 0.3), name="guide")
        )
    else:
        joints.append(Distance(two.at_end, length, ground=ground, name="link"))
    own = loaded(one, two, base, inner, elbow, joints)
    for first, second, name in ((base, None, "base"), (inner, elbow, "elbow")):
        own.between(first, second, np.array([own.value(reaction(name, i)) for i in range(2)]))
    if held == "line":
        own.between(two.at_end, None, own.value(driver_force("guide")) * unit([2, 1]))
    else:
        # The multiplier of a link is its tension.
        pull = ground - own.at(two.at_end)[0]
        own.between(two.at_end, None, own.solution.multipliers("link")[0, 0] * pull / length)
    (P_1, L_1), (P_2, L_2) = own.left["one"], own.left["two"]
    for x in (P_1, P_2, L_2):
        assert np.allclose(x, 0, **BALANCED)
    if held != "base":
        assert np.allclose(L_1, own.value(driver_torque("motor")), **BALANCED)


def test_the_power_of_a_moving_base_is_that_of_its_force():
    one = curved(3)
    law, along = Harmonic(0.1, 5.0, 0.4, -0.1 * np.sin(0.4)), unit([1, 2, -0.5])
    base = MovingSupport(one.at(0.1), along, law, name="base")
    start = [InitialVelocity("one", (0, 0, 0), (0, 0, 0), tuple(law.at(0.0, 1) * along))]
    system = assemble(Scene([one], [base], GRAVITY, start))
    solution = simulate(system, 0.02, HHT(0.005))
    force = solution.reaction("base") @ along
    assert np.max(np.abs(force)) > 0.1
    expected = force * law.at(solution.t, 1)
    power = observe(joint_power("base"), solution, system)
    assert np.allclose(power, expected, rtol=1e-12)
    assert np.allclose(observe(driver_force("base"), solution, system), force, rtol=1e-12)


def test_the_multiplier_of_a_link_is_its_tension():
    weight = RigidBody("weight", (0.3, -0.4), mass=2.0, inertia=0.1)
    link = Distance(weight.origin, 0.5, ground=(0, 0), name="link")
    pulled = Scene([], [link], (0.6 * 9.81, -0.8 * 9.81), bodies=[weight])
    solution = simulate(pulled, 0.01, HHT(0.005))
    assert np.allclose(solution.multipliers("link")[:, 0], 2.0 * 9.81, rtol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_on_a_line_is_held_by_the_force_across(d):
    line, g = unit([0.2, -0.3, 0.9][:d]), GRAVITY[-d:]
    inertia = 0.1 if d == 2 else (0.1, 0.2, 0.25)
    bead = RigidBody("bead", (0.1, 0.2, 0.3)[:d], mass=2.0, inertia=inertia)
    held = PointOnLine(bead.origin, line, name="held")
    lam = simulate(Scene([], [held], g, bodies=[bead]), 0.01, HHT(0.005)).multipliers("held")[0]
    n = as_on_a_line(line) if d == 3 else np.array([[-line[1], line[0]]])
    assert np.allclose(-lam @ n, -2.0 * (g - (g @ line) * line), rtol=1e-12)


def test_a_planar_joint_holds_the_force_along_its_normal():
    """A plate that slides on an incline."""
    n = unit([0.2, -0.3, 0.9])
    plate = RigidBody("plate", (0.1, 0.2, 0.3), mass=2.0, inertia=(0.1, 0.2, 0.25))
    plane = PlanarJoint(plate.origin, n, name="plane")
    solution = simulate(Scene([], [plane], GRAVITY, bodies=[plate]), 0.01, HHT(0.005))
    lam = solution.multipliers("plane")[0]
    assert np.allclose(lam[0], 2.0 * GRAVITY @ n, rtol=1e-12)
    assert np.allclose(lam[1:], 0.0, atol=1e-12)


# ---------------------------------------------------------------- bushing, angles


def best_turn(R, axis):
    """Angle about an axis that brings directions nearest to those that R has turned."""
    turn = np.linspace(-np.pi, np.pi, 7)[1:]
    start = max(turn, key=lambda x: np.trace(rotation(axis, x).T @ R))
    for _ in range(20):
        x = start + np.array([-1e-3, 0.0, 1e-3])
        f = [np.trace(rotation(axis, y).T @ R) for y in x]
        start -= (f[2] - f[0]) / (2 * (f[2] - 2 * f[1] + f[0])) * 1e-3
    return start


def test_a_bushing_gives_back_what_its_springs_hold():
    """Power of a bushing: minus the rate of 1/2 k x^2 + 1/2 k theta^2, less that of its dampers."""
    k, k_turn = np.array([30.0, 50.0, 20.0]), np.array([3.0, 1.0, 2.0])
    c, c_turn = np.array([0.3, 0.2, 0.5]), np.array([0.1, 0.3, 0.2])
    one = RigidBody("one", (0.1, 0.2, 0.3), mass=2.0, inertia=(0.1, 0.2, 0.25))
    two = RigidBody("two", (0.3, 0.1, 0.2), mass=1.0, inertia=(0.2, 0.1, 0.15))
    points = two.at(0.1, -0.1, 0.2), one.at(-0.1, 0.1, 0.05)
    held = Bushing(points[0], k, c, k_turn, c_turn, other=points[1], name="held")
    start = [
        InitialVelocity("one", (0.5, -1.0, 0.7), one.position, (0.3, 0.1, -0.2)),
        InitialVelocity("two", (-1.0, 2.0, 1.5), two.position, (-0.3, 0.6, 0.2)),
    ]
    system = assemble(Scene([], start=start, loads=[held], bodies=[one, two]))
    solution = simulate(system, 0.3, HHT(0.0025))
    gap = solution.position(points[0])[0] - solution.position(points[1])[0]

    def travel(at):
        """Coordinates of the bushing at an instant of the run."""
        R = [at.nodes(name)[0, 0, 1:].T for name in ("one", "two")]
        e = at.position(points[0])[0] - at.position(points[1])[0]
        turned = R[0].T @ R[1]
        return np.append(R[0].T @ e - gap, [best_turn(turned, axis) for axis in np.eye(3)])

    last = dataclasses.replace(
        solution, **{x: getattr(solution, x)[-1:] for x in ("t", "q", "v", "a", "lam")}
    )
    x = travel(last)
    # Central differences of fourth order along the velocities; those of HHT leave bodies rigid to
    # the square of its step.
    h = 1e-3
    f = [travel(dataclasses.replace(last, q=last.q + s * h * last.v)) for s in (-2, -1, 1, 2)]
    rate = (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * h)
    stiffness, damping = np.append(k, k_turn), np.append(c, c_turn)
    power = -(stiffness * x + damping * rate) @ rate
    assert np.max(np.abs(x[3:])) > 0.3
    assert np.allclose(observe(load_power("held"), last, system)[0], power, rtol=1e-5)


class TestAngles:
    """An angle counts full turns wherever a run is looked at part by part."""

    speed, offset, t_end = 10.0, 0.3, 0.8

    def system(self):
        wheel = RigidBody("wheel", (0.1, 0.2), mass=1.0, inertia=0.1)
        motor = RotationDriver(
            wheel.origin, ConstantAcceleration(self.speed, self.offset), name="motor"
        )
        start = [InitialVelocity("wheel", self.speed, wheel.position)]
        scene = Scene([], [Pin(wheel.origin), motor], start=start, bodies=[wheel], assemble=True)
        return assemble(scene, ["motor.speed", "motor.offset"]), slope_angle(wheel.origin)

    # Steps of HHT and quadrature on instants are exact for lines and the square to h^2; the memory
    # holds a few steps only.
    @pytest.mark.parametrize(
        ("integrator", "method"),
        [
            (HHT(0.01), DirectDifferentiation()),
            (HHT(0.01), Adjoint(memory="0.01 MB")),
            (IDA(1e-5, intervals=16), DirectDifferentiation()),
            (DOP853(1e-5, intervals=16), DirectDifferentiation()),
        ],
        ids=["HHT", "parts", "IDA", "DOP853"],
    )
    def test_integrals_of_an_angle_are_those_of_the_law(self, integrator, method):
        system, angle = self.system()
        w, a, T = self.speed, self.offset, self.t_end
        both = [Integral(angle), Integral(angle**2)]
        found, squares = gradients(system, both, T, integrator, method=method)
        assert np.isclose(found.value, a * T + w * T**2 / 2, rtol=1e-6)
        assert np.allclose(found.gradient, [T**2 / 2, T], rtol=1e-6)
        assert np.isclose(squares.value, ((a + w * T) ** 3 - a**3) / (3 * w), rtol=1e-4)
        # d/dw and d/da of the integral of (a + w t)^2.
        slopes = [a * T**2 + 2 * w * T**3 / 3, 2 * a * T + w * T**2]
        assert np.allclose(squares.gradient, slopes, rtol=1e-4)

    def test_observations_follow_every_step(self, monkeypatch):
        monkeypatch.setattr("ancfdae.studies.parts._NUMBERS", 500)
        system, angle = self.system()
        at = [0.1, 0.12, 0.5, 0.8]
        seen = record_observables(system, [angle, 2.0 * angle], self.t_end, HHT(0.01), keep=at)
        expected = self.offset + self.speed * np.array(at)
        assert np.allclose(seen.values, expected[:, None] * [1, 2], rtol=1e-9)


# ---------------------------------------------------------------- strain, mass, modes


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("offsets", [(0.0, 0.0), (0.012, -0.01)])
def test_axial_strain_is_the_change_of_a_fibre(d, offsets):
    """Half of the change of the squared length of a short piece of fibre, over the square."""
    one, y, z = curved(d), offsets[0], offsets[1] * (d - 2)
    system = assemble(
        Scene([one], [Clamp(one.at_start)], start=[ruffled(one, 3)], project_start=True)
    )
    moved = simulate(system, 1e-5, HHT(1e-5))
    still = simulate(assemble(Scene([one], [Clamp(one.at_start)])), 1e-5, HHT(1e-5))
    for fraction in (0.05, 0.4, 0.81):
        # Central differences of fourth order.
        def piece(solution, f=fraction):
            r = [solution.position(one.at(f + s * 1e-3, y, z))[0] for s in (-2, -1, 1, 2)]
            return 8 * (r[2] - r[1]) - (r[3] - r[0])

        strain = axial_strain(one.at(fraction, y, z))
        square = [piece(x) @ piece(x) for x in (moved, still)]
        expected = (square[0] / square[1] - 1) / 2
        assert abs(expected) > 1e-3
        assert np.isclose(observe(strain, moved, system)[0], expected, rtol=1e-6, atol=1e-9)
        assert abs(observe(strain, still, system)[0]) <= 1e-14


def test_the_partials_of_an_axial_strain_hold_for_a_length():
    one = curved(3)
    scene = Scene([one], [Clamp(one.at_start)], start=[ruffled(one, 3)], project_start=True)
    system, strain = assemble(scene, ["one.length"]), axial_strain(one.at(0.4, 0.012, -0.01))
    q, v = system.start()
    states = States(np.zeros(1), q[None], v[None], np.zeros((1, system.n_lam)))
    stepped = system.with_values(system.b + 1e-40j)
    exact = strain.value(stepped, states)[0].imag / 1e-40
    assert abs(exact) > 1e-3
    assert np.allclose(strain.partials(system, states).b, exact, rtol=1e-12)


def hermite(beam):
    """Position and its gradient at (element, xi, y, z) of the reference, by the shape functions."""
    X, shape = np.asarray(beam.positions), np.asarray(beam.frames)
    lengths = beam.reference().lengths

    def at(k, x, y, z):
        l, (p, q), (F, G) = lengths[k], X[k : k + 2], shape[k : k + 2]
        r = (1 - 3 * x**2 + 2 * x**3) * p + l * (x - 2 * x**2 + x**3) * F[0]
        r = r + (3 * x**2 - 2 * x**3) * q + l * (x**3 - x**2) * G[0]
        r_x = 6 * (x - x**2) * (q - p) / l
        r_x = r_x + (1 - 4 * x + 3 * x**2) * F[0] + (3 * x**2 - 2 * x) * G[0]
        across = [(1 - x) * F[j] + x * G[j] for j in range(1, len(p))]
        for offset, e, j in zip((y, z), across, range(1, len(p)), strict=False):
            r, r_x = r + offset * e, r_x + offset * (G[j] - F[j]) / l
        return r, np.array([r_x, *across])

    return at


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_mass_properties_of_a_curved_tapered_beam_are_integrals_over_its_volume(d, rigid):
    one = curved(d, rigid)
    at, lengths = hermite(one), one.reference().lengths
    nodes, weights = (x / 2 for x in np.polynomial.legendre.leggauss(6))
    m, first, second = 0.0, np.zeros(d), np.zeros((d, d))
    for k, section in enumerate(one.section):
        for x, w_x in zip(nodes + 0.5, weights, strict=True):
            for y, w_y in zip(nodes * section.height, weights * section.height, strict=True):
                for z, w_z in zip(nodes * section.width, weights * section.width, strict=True):
                    r, J = at(k, x, y, z)
                    dm = 1100 * np.linalg.det(J) * lengths[k] * w_x * w_y * w_z
                    m, first, second = m + dm, first + dm * r, second + dm * np.outer(r, r)
    centre = first / m
    spread = second - m * np.outer(centre, centre)
    tensor = np.trace(spread) * np.eye(d) - spread if d == 3 else [[np.trace(spread)]]
    found = mass_properties(Scene([one]))
    # Both rules are exact in x, y, z to round-off: the integrand is a polynomial.
    assert np.isclose(found.mass, m, rtol=1e-12)
    assert np.allclose(found.centre, centre, rtol=1e-12)
    assert np.allclose(found.inertia, tensor, rtol=1e-9, atol=1e-12 * np.max(np.abs(tensor)))


def test_a_free_bar_in_space_vibrates_and_is_damped_as_theory_says():
    """A tilted clamped round bar: stretching, twisting and bending waves, ratios tau omega / 2."""
    E, nu, rho, tau, L, R = 7e9, 0.3, 2700.0, 3e-6, 1.0, 0.02
    start = np.array([0.1, 0.2, 0.3])
    bar = Beam(
        "bar",
        tuple(start),
        tuple(start + L * unit([0.3, -0.5, 0.8])),
        12,
        Circle(R),
        Material(rho, E, nu, damping_time=tau),
        height_axis=(1, 1, 0),
    )
    found = modes(Scene([bar], [Clamp(bar.at_start)]), 12)
    w = found.natural_frequencies
    stretch, twist = (np.pi / 2 / L * np.sqrt(M / rho) for M in (E, E / 2 / (1 + nu)))
    # Euler's frequency less shear and rotary inertia, (1 + E/kG) of it (Timoshenko), to first
    # order in (R/L)^2: mode 1 of a cantilever with the constant 1.8751 and the factor 1.1678.
    bend = 1.8751040687**2 * np.sqrt(E * R**2 / 4 / rho) / L**2
    # 12 elements: waves to (pi/2/12)^2/12 and less; the first bending mode falls by 1.1e-3.
    for expected, near in ((stretch, 2e-4), (twist, 2e-3), (bend, 2.5e-3)):
        assert np.min(np.abs(w / expected - 1)) < near
    assert np.allclose(found.damping_ratios, tau * w / 2, rtol=1e-8)


def test_the_colour_of_a_strain_energy_is_that_over_the_volume():
    """Of a curved beam whose section lies beside its axis: the mass over the density."""
    one = dataclasses.replace(curved(3), section=LOPSIDED)
    scene = Scene([one], [Clamp(one.at_start)], start=[ruffled(one, 3)], project_start=True)
    solution = simulate(scene, 1e-5, HHT(1e-5))
    shown = mechanism(scene, solution, None, StrainEnergyDensity())
    values = shown.values[0].reshape(len(solution.t), *shown.meshes[0].shape)[0, :, 0, 0]
    at, lengths = hermite(one), one.reference().lengths
    nodes, weights = (x / 2 for x in np.polynomial.legendre.leggauss(6))
    volumes = [
        sum(
            w * lengths[k] * area * np.linalg.det(at(k, x, y, z)[1])
            for x, w in zip(nodes + 0.5, weights, strict=True)
            for (y, z), area in zip(LOPSIDED.places, LOPSIDED.areas, strict=True)
        )
        for k in range(len(lengths))
    ]
    expected = observe(strain_energy(), solution, assemble(scene))[0]
    assert np.isclose(values @ volumes, expected, rtol=1e-10)


@pytest.mark.parametrize("alpha", [-0.3, -0.1])
def test_hht_errs_in_phase_as_the_docstring_of_a_step_says(alpha):
    """C (2 pi / N)^2 of a turn in each, C = 1/12 - alpha/4 - 3 alpha^2/8, 1/8 by default."""
    k, count, periods = 1000.0, 40, 8
    w = np.sqrt(k)
    wheel = RigidBody("wheel", (0.1, 0.2), mass=1.0, inertia=1.0)
    spring, turning = (
        TorsionalSpringDamper(wheel.origin, k),
        InitialVelocity("wheel", 0.05 * w, wheel.position),
    )
    scene = Scene([], [Pin(wheel.origin)], start=[turning], loads=[spring], bodies=[wheel])
    suggested = suggest_step(scene, count)
    assert np.isclose(suggested.step, 2 * np.pi / w / count, rtol=1e-10)
    solution = simulate(scene, periods * 2 * np.pi / w, HHT(suggested.step, hht_alpha=alpha))
    angle = observe(slope_angle(wheel.origin), solution)
    # Where it passes zero upwards, n periods later than at the start: by a secant, right to h^3.
    k = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0))[-1]
    at = solution.t[k] - angle[k] * np.diff(solution.t)[k] / (angle[k + 1] - angle[k])
    turns = round(at * w / (2 * np.pi))
    late = at * w / (2 * np.pi) / turns - 1
    expected = (1 / 12 - alpha / 4 - 3 * alpha**2 / 8) * (2 * np.pi / count) ** 2
    # The next term is (2 pi / N)^4, 0.02 of this; the secant errs by a thousandth of it.
    assert np.isclose(late, expected, rtol=0.03)


def test_a_tilted_pendulum_swings_and_rests_as_a_physical_one():
    frame, g = rotation([1, 2, 3], 0.7), GRAVITY
    (tensor,), centre = tensors(11, 1), np.array([0.2, -0.3, 0.1])
    a, x = unit([0.5, -0.4, 0.7]), np.array([-0.3, 0.2, 0.4])
    body = RigidBody(
        "body", (0.1, 0, 0), mass=2.0, inertia=six(tensor), centre=centre, frame=frame.T
    )
    scene = Scene([], [Revolute(body.at(*x), a, name="hinge")], g, bodies=[body])
    rest = equilibrium(scene)
    assert np.allclose(rest.solution.reaction("hinge")[0], -2.0 * g, rtol=0, atol=1e-10)
    arm, pull = (v - (v @ a) * a for v in (frame @ (centre - x), g))
    about = a @ frame @ tensor @ frame.T @ a + 2.0 * arm @ arm
    expected = np.sqrt(2.0 * np.linalg.norm(arm) * np.linalg.norm(pull) / about)
    assert np.isclose(modes(scene, 1, at=rest).frequencies[0], expected, rtol=1e-10)
    assert np.allclose(
        simulate(scene, 0.01, HHT(0.01)).position(body.centre_of_mass)[0],
        np.array([0.1, 0, 0]) + frame @ centre,
    )


# ---------------------------------------------------------------- energies, objectives


@pytest.mark.parametrize("damping", [0.0, 2e-3])
def test_energy_changes_by_the_power_of_loads_motors_and_weight(monkeypatch, damping):
    """dT/dt + dU/dt of a strained moving chain; damping of the material takes the rest."""
    monkeypatch.setitem(globals(), "SOFT", Material(1100, 2e6, 0.3, damping_time=damping))
    one, two, base, inner, elbow = two_beams(3, "soft")
    a = unit([0.3, -0.5, 0.8])
    motor = RotationDriver(base, ConstantAcceleration(0.9, 0.0, 0.7), a, name="motor")
    joints = [Revolute(base, a, name="base"), motor, Pin(inner, elbow, name="elbow")]
    own = loaded(one, two, base, inner, elbow, joints)
    states = States(*(getattr(own.solution, x)[:1] for x in ("t", "q", "v", "lam")))
    kinetic, strain = (x().partials(own.system, states) for x in (kinetic_energy, strain_energy))
    rate = kinetic.v[0] @ own.solution.a[0] + strain.q[0] @ states.v[0]
    names = ("line 1", "line 2", "force", "moment", "spring", "follower")
    power = sum(own.value(load_power(name)) for name in names)
    weight = sum(own.value(linear_momentum(i)) * g for i, g in enumerate(GRAVITY))
    turned = own.value(joint_power("motor"))
    assert min(abs(power), abs(weight), abs(turned)) > 1e-3
    lost = power + weight + turned - rate
    if damping:
        # The waves of this state lose far more than anything else gives.
        assert lost > 1.0
    else:
        assert abs(lost) <= 1e-9 * abs(strain.q[0] @ states.v[0])


def test_strain_energy_is_that_of_beam_theory():
    """A tilted cantilever under a force and a moment at its tip, each along its own axes."""
    E, nu, L, h, w = 7e9, 0.3, 1.0, 0.06, 0.04
    axis, start = unit([0.3, -0.5, 0.8]), np.array([0.1, 0.2, 0.3])
    section = Rectangle(h, w)
    bar = Beam(
        "bar",
        tuple(start),
        tuple(start + L * axis),
        8,
        section,
        Material(2700, E, nu),
        height_axis=(1, 1, 0),
    )
    height = unit(np.array([1, 1, 0]) - (np.array([1, 1, 0]) @ axis) * axis)
    frame = np.array([axis, height, np.cross(axis, height)])
    N, V_y, V_z, T, M_y, M_z = 0.3, 0.03, -0.02, 0.015, 0.008, -0.012
    loads = [
        PointForce(bar.at_end, tuple(np.array([N, V_y, V_z]) @ frame)),
        Moment(bar.at_end, tuple(np.array([T, M_y, M_z]) @ frame)),
    ]
    scene = Scene([bar], [Clamp(bar.at_start)], loads=loads)
    found = equilibrium(scene)
    A, I_y, I_z, G = h * w, h * w**3 / 12, w * h**3 / 12, E / 2 / (1 + nu)
    k = 10 * (1 + nu) / (12 + 11 * nu)
    n = np.arange(1, 40, 2)
    series = np.sum(np.tanh(n * np.pi * h / 2 / w) / n**5)
    J = h * w**3 * (1 / 3 - 64 / np.pi**5 * w / h * series)
    # Moments along the beam: M_z + V_y (L - x) about the width, M_y - V_z (L - x) about the height.
    bend = sum(
        (M**2 * L + M * V * L**2 + V**2 * L**3 / 3) / (2 * E * I)
        for M, V, I in ((M_z, V_y, I_z), (M_y, -V_z, I_y))
    )
    rest = N**2 / (E * A) + (V_y**2 + V_z**2) / (k * G * A) + T**2 / (G * J)
    expected = bend + rest * L / 2
    energy = observe(strain_energy(), found.solution, assemble(scene))[0]
    # The tension stiffens by less than N L^2/(E I) = 1.3e-4.
    assert np.isclose(energy, expected, rtol=1.3e-4)


@pytest.mark.parametrize(
    ("integrator", "near"),
    [(HHT(0.01), 1e-3), (IDA(1e-6, intervals=4), 1e-6), (DOP853(1e-6, intervals=4), 1e-6)],
    ids=["HHT", "IDA", "DOP853"],
)
def test_objectives_of_the_time_are_integrals_of_calculus(integrator, near):
    wheel = RigidBody("wheel", (0.1, 0.2), mass=1.0, inertia=0.1)
    start = [InitialVelocity("wheel", 2.0, wheel.position)]
    scene = Scene([], start=start, bodies=[wheel])
    system, T, k = assemble(scene, ["wheel.mass"]), 0.7, 9.0
    t = elapsed_time()
    expected = {
        Integral(t**2): T**3 / 3,
        AtTimes(t**2, [0.123, 0.456]): 0.123**2 + 0.456**2,
        Terminal(np.exp(t)): np.exp(T),
        SmoothMaximum(t, k): np.log(np.expm1(k * T) / (k * T)) / k,
        -SmoothMaximum(-t, k): -np.log(-np.expm1(-k * T) / (k * T)) / k,
    }
    found = gradients(system, list(expected), T, integrator, method=DirectDifferentiation())
    for each, exact in zip(found, expected.values(), strict=True):
        assert np.isclose(each.value, exact, rtol=near)
