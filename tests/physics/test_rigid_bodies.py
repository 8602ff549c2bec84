"""Rigid bodies, rigid beams and point masses against mechanics that knows no coordinates of theirs.

Partials by complex step of scenes with them: `test_assembler`.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from ancfdae import (
    CABLE_2D,
    DOP853,
    HHT,
    IDA,
    Adjoint,
    Beam,
    BeamContact,
    BeamPairContact,
    ComplexStep,
    DesignVariable,
    DirectDifferentiation,
    DistributedForce,
    EquilibriumStart,
    InitialVelocity,
    Integral,
    Material,
    NodalState,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Revolute,
    RigidBody,
    RigidBox,
    RigidCylinder,
    RigidSphere,
    RotationDriver,
    Scene,
    Spherical,
    SpringDamper,
    Terminal,
    assemble,
    equilibrium,
    gradient,
    gradients,
    load_solution,
    modes,
    simulate,
)
from ancfdae.errors import FreeMotionError, InvalidInputError, UnknownNameError
from ancfdae.extend import MaterialPoint
from ancfdae.laws import SmoothStep
from ancfdae.model import joints, loads
from ancfdae.model.bodies import Quantity
from ancfdae.model.joints.joint import Joint
from ancfdae.model.loads.load import Load
from ancfdae.observables import kinetic_energy, position, strain_energy, velocity
from ancfdae.sections import Rectangle
from tests.support.examples import all_examples, scene_of
from tests.support.members import constraint_b
from tests.support.scenes import FLAT, RIGID, SCENES, STEEL, THICK, arc

# A few sums and products of numbers of size one.
EXACT = 1e-13
G = 9.81


def assert_close(value, expected, tolerance=EXACT):
    scale = np.max(np.abs(expected))
    assert scale > 0
    assert np.shape(value) == np.shape(expected)
    assert np.max(np.abs(value - expected)) <= tolerance * scale


# ---------------------------------------------------------------- against ordinary equations


def planar_pendulum():
    """A body that hangs on a point beside its reference point, and that point to the centre."""
    body = RigidBody("arm", (0.3, 0.2), 2.0, 0.05, centre=(0.4, 0.1))
    scene = Scene(joints=[Pin(body.at(0.1, -0.1))], gravity=(0.0, -G), bodies=[body])
    return scene, body, np.array([0.3, 0.2])


def pendulum_by_hand(arm, t):
    """Where the centre of a pendulum of mass 2 and inertia 0.05 about it has gone from rest."""
    l, phi_0 = np.hypot(*arm), np.arctan2(arm[1], arm[0])
    inertia = 0.05 + 2.0 * l**2

    def rates(t, y):
        return [y[1], -2.0 * G * l * np.cos(y[0]) / inertia]

    run = solve_ivp(rates, (0.0, t), (phi_0, 0.0), "DOP853", rtol=1e-12, atol=1e-12)
    phi = run.y[0, -1]
    return l * np.array([np.cos(phi), np.sin(phi)])


@pytest.mark.parametrize(
    # Global errors of a second and what the methods claim of a step: a hundred times rtol; that
    # of HHT is h^2 times a third derivative of 5^3 a second, over ten.
    ("integrator", "tolerance"),
    [(DOP853(rtol=1e-10), 1e-8), (IDA(rtol=1e-9), 1e-7), (HHT(step=1e-3), 2e-5)],
    ids=["explicit", "IDA", "HHT"],
)
def test_physical_pendulum(integrator, tolerance):
    scene, body, arm = planar_pendulum()
    run = simulate(scene, 1.0, integrator)
    moved = run.position(body.centre_of_mass)[-1] - run.position(body.at(0.1, -0.1))[-1]
    assert np.max(np.abs(moved - pendulum_by_hand(arm, 1.0))) <= tolerance


def top_by_hand(inertia, mass, arm, omega, t):
    """Directions of a body held at its origin, by Euler's equations in its own axes.

    I omega' = -omega x I omega + arm x m R^T g, R' = R (omega x).
    """

    def rates(t, y):
        own, R = y[:3], y[3:].reshape(3, 3)
        torque = mass * np.cross(arm, R.T @ (0.0, 0.0, -G))
        spin = np.linalg.solve(inertia, torque - np.cross(own, inertia @ own))
        return [*spin, *np.cross(R, own).ravel()]

    start = [*omega, *np.eye(3).ravel()]
    run = solve_ivp(rates, (0.0, t), start, "DOP853", rtol=1e-12, atol=1e-12)
    return run.y[3:, -1].reshape(3, 3)


TENSOR = np.array([[0.3, 0.02, -0.01], [0.02, 0.2, 0.03], [-0.01, 0.03, 0.15]])
SIX = tuple(TENSOR[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
OMEGA = (0.3, 4.0, 0.2)


def directions(run, body):
    """Directions of a body at the end as columns."""
    return run.nodes(body.name)[-1, 0, 1:].T


def test_free_body_tumbles_as_by_eulers_equations():
    # Turning about the middle axis is unstable (Dzhanibekov): in 6 s it has turned over.
    body = RigidBody("body", (0, 0, 0), 2.0, SIX)
    run = simulate(
        Scene(bodies=[body], start=[InitialVelocity("body", OMEGA, (0, 0, 0))]), 6.0, DOP853(1e-10)
    )
    R = top_by_hand(TENSOR, 0.0, np.zeros(3), OMEGA, 6.0)
    assert R[1, 1] < 0.0
    # Errors grow by about e^(sqrt(...) 4 t) < 300 on the way; 100 steps.
    assert np.max(np.abs(directions(run, body) - R)) <= 1e-6


def test_heavy_top_turns_as_by_eulers_equations():
    arm = np.array([0.1, -0.2, 0.3])
    body = RigidBody("body", (0.0, 0.0, 0.0), 2.0, SIX, centre=tuple(arm))
    scene = Scene(
        joints=[Spherical(body.origin)],
        gravity=(0.0, 0.0, -G),
        start=[InitialVelocity("body", OMEGA, (0, 0, 0))],
        bodies=[body],
    )
    about_origin = TENSOR + 2.0 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    R = top_by_hand(about_origin, 2.0, arm, OMEGA, 1.0)
    run = simulate(scene, 1.0, DOP853(rtol=1e-10))
    assert np.max(np.abs(directions(run, body) - R)) <= 1e-8
    # Second order: halving the step leaves a quarter, up to terms of higher order.
    coarse, fine = (
        np.max(np.abs(directions(simulate(scene, 1.0, HHT(step=h)), body) - R))
        for h in (2e-3, 1e-3)
    )
    assert 3.6 < coarse / fine < 4.4


def test_axes_of_a_body_are_a_matter_of_description():
    Q = Rotation.from_rotvec((0.4, -1.0, 0.7)).as_matrix()  # rows: axes of the body
    own = Q @ TENSOR @ Q.T
    entries = tuple(own[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    centre = np.array([0.1, -0.2, 0.3])
    plain = RigidBody("body", (0, 0, 0), 2.0, SIX, centre=tuple(centre))
    turned = RigidBody("body", (0, 0, 0), 2.0, entries, tuple(Q @ centre), frame=Q.tolist())
    ends = []
    for body, at in ((plain, np.array([0.3, 0.2, 0.1])), (turned, Q @ (0.3, 0.2, 0.1))):
        scene = Scene(joints=[Spherical(body.origin)], gravity=(0, 0, -G), bodies=[body])
        ends.append(simulate(scene, 0.5, HHT(step=0.01)).position(body.at(*at))[-1])
    # The step is the same; Newton's method leaves 1e-14 of the forces in 50 steps.
    assert_close(ends[1], ends[0], 1e-10)


def energies(scene, t_end):
    system = assemble(scene)
    run = simulate(system, t_end, DOP853(rtol=1e-11))
    assert run.outcome.success
    energies = system.energies
    return energies.kinetic(run.v), energies.strain(run.q) + energies.gravity(run.q)


def test_chain_of_bodies_keeps_its_energy():
    bodies, links, shape = [], [], RigidBox(0.5, 0.1, 0.1)
    for k in range(3):
        body = RigidBody(f"b{k}", (0.5 * k, 0.0), shape=shape, density=1000.0)
        links.append(Pin(body.origin, None if k == 0 else bodies[-1].at(0.5)))
        bodies.append(body)
    mass = PointMass(bodies[-1].at(0.5), 2.0)
    kinetic, potential = energies(Scene(joints=links, gravity=(0, -G), bodies=[*bodies, mass]), 0.5)
    assert np.max(kinetic) > 10.0
    assert np.ptp(kinetic + potential) <= 1e-7 * np.max(kinetic)


# ---------------------------------------------------------------- masses


def block_of(body):
    """Mass matrix of one body on its reference point and directions, (d + 1, d + 1)."""
    system = assemble(Scene(bodies=[body]))
    d = body.dimension
    M = system.pattern.dense(system.mass(system.start()[0]))
    m = M[::d, ::d]
    assert_close(M, np.kron(m, np.eye(d)))
    return m


def volume_of(shape, size):
    """Points and volumes of a fine Gauss rule over the shape, in its own coordinates."""
    x, w = np.polynomial.legendre.leggauss(12)
    if isinstance(shape, RigidBox):
        X, Y, Z = np.meshgrid(*(x * s / 2 for s in size), indexing="ij")
        W = np.einsum("i,j,k->ijk", *(w * s / 2 for s in size))
        return np.stack([X.ravel(), Y.ravel(), Z.ravel()]), W.ravel()
    # Radius, polar angle or height, and 12 equal angles, exact for squares.
    angle = np.arange(12) * np.pi / 6
    r, w_r = (x + 1) * size[0] / 2, w * size[0] / 2
    second, w_2 = (x, w) if isinstance(shape, RigidSphere) else (x * size[1] / 2, w * size[1] / 2)
    R, S, A = np.meshgrid(r, second, angle, indexing="ij")
    W = np.einsum("i,j,k->ijk", w_r, w_2, np.full(12, np.pi / 6))
    if isinstance(shape, RigidSphere):
        flat = R * np.sqrt(1 - S**2)
        return np.stack([x.ravel() for x in (flat * np.cos(A), flat * np.sin(A), R * S)]), (
            W * R**2
        ).ravel()
    return np.stack([x.ravel() for x in (R * np.cos(A), R * np.sin(A), S)]), (W * R).ravel()


SHAPES = {
    "box": RigidBox(0.4, 0.3, 0.2),
    "cylinder": RigidCylinder(0.3, 0.5),
    "sphere": RigidSphere(0.3),
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("shape", SHAPES)
def test_mass_of_a_shape_is_the_integral_over_it(shape, d):
    own, centre = SHAPES[shape], np.array([0.1, -0.2, 0.3])[:d]
    body = RigidBody("b", (0.5,) * d, shape=own, density=700.0, centre=tuple(centre))
    x, dV = volume_of(own, tuple(own.parameters().values()))
    places = np.concatenate([np.ones((1, len(dV))), x[:d] + centre[:, None]])
    assert_close(block_of(body), (places * 700.0 * dV) @ places.T, 1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_shape_is_the_body_of_its_mass_and_inertia(d):
    a, b, c, rho = 0.4, 0.3, 0.2, 700.0
    m = rho * a * b * c
    moments = tuple(m / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b]))
    inertia = moments if d == 3 else moments[2]
    of_shape = RigidBody("b", (0,) * d, shape=RigidBox(a, b, c), density=rho)
    given = RigidBody("b", (0,) * d, m, inertia)
    if d == 3:
        assert_close(block_of(given), block_of(of_shape))
    # In the plane the sum of both moments is what a turn feels.
    felt = np.sum(moments) / 2 if d == 3 else moments[2]
    for block in (block_of(given), block_of(of_shape)):
        assert np.trace(block[1:, 1:]) == pytest.approx(felt, rel=EXACT)


def test_point_mass_is_a_ball_without_size():
    ball = RigidBody("b", (0, 0, 0), 2.0, SIX, centre=(0.1, 0.2, 0.3))
    at = np.array([1.0, 0.3, -0.2, 0.5])
    with_mass = assemble(Scene(bodies=[ball, PointMass(ball.at(*at[1:]), 0.7)]))
    M = with_mass.pattern.dense(with_mass.mass(with_mass.start()[0]))[::3, ::3]
    assert_close(M, block_of(ball) + 0.7 * np.outer(at, at))


@pytest.mark.parametrize("element", [None, CABLE_2D])
def test_point_mass_on_a_beam_weighs_its_position(element):
    rod = Beam("rod", (0.1, 0.2), (1.2, 0.7), 3, FLAT, STEEL, element=element)
    at = rod.at(0.45, y=0.0 if element else 0.02)
    system = assemble(
        Scene([rod], gravity=(1.0, -G), bodies=[PointMass(at, 0.7, name="m")]), ["m.mass"]
    )
    bare = assemble(Scene([rod], gravity=(1.0, -G)))
    v = np.random.default_rng(0).uniform(-1, 1, system.n_q)
    moved = system.naming.vector(at, Quantity.POSITION).of(v, 2)
    own = system.energies.kinetic(v[None], "m")
    assert_close(own, 0.35 * moved[None] @ moved)
    both = system.energies.kinetic(v[None])
    assert_close(both, own + bare.energies.kinetic(v[None]))
    assert_close(system.energies.kinetic(v[None], "rod"), bare.energies.kinetic(v[None]))
    # Gravity works on it with 0.7 g . v.
    q = system.start()[0]
    power = (system.force(0.0, q, v) - bare.force(0.0, q, v)) @ v
    assert power == pytest.approx(0.7 * (1.0 * moved[0] - G * moved[1]), rel=1e-12)


# ---------------------------------------------------------------- rigid beams


def rods(d):
    """A straight beam of two sections and a curved one."""
    z = (0.2,) * (d - 2)
    heights = [Rectangle(h, 0.05) for h in (0.05, 0.08)]
    yield Beam("rod", (0.1, 0.2, *z), (0.9, 0.7, *z), 2, heights, STEEL)
    yield arc("rod", (0.9, 1.7, *z), 1.0, (0.0, 0.3, 0.6), d, pitch=0.3 if d == 3 else 0.0)


RODS = [rod for d in (2, 3) for rod in rods(d)]
RODS.append(Beam("rod", (0.1, 0.2), (0.9, 0.7), 2, FLAT, STEEL, element=CABLE_2D))


def carried(rod):
    """Node vectors of a beam as a linear map of the vectors of a rigid one, by its shape alone."""
    d, n_s = rod.dimension, rod.element.n_s
    X = assemble(Scene([rod])).start()[0].reshape(-1, n_s, d)
    frame = assemble(Scene([replace(rod, rigid=True)])).start()[0].reshape(d + 1, d)
    assert_close(frame[1:] @ frame[1:].T, np.eye(d))
    W = np.zeros((*X.shape[:2], d + 1))
    W[:, 0, 0] = 1.0
    X[:, 0] -= frame[0]
    W[..., 1:] = X @ frame[1:].T
    return np.kron(W.reshape(-1, d + 1), np.eye(d))


@pytest.mark.parametrize("rod", RODS)
def test_rigid_beam_is_the_beam_on_its_rigid_motions(rod):
    d = rod.dimension
    parts = {
        "gravity": (1.0, -G, 0.5)[:d],
        "loads": [
            DistributedForce("rod", (2.0, -4.0, 1.0)[:d]),
            PointForce(rod.at(0.7), (1.0, 2.0, 3.0)[:d]),
        ],
    }
    beam, rigid = (
        assemble(Scene([rod], **parts)),
        assemble(Scene([replace(rod, rigid=True)], **parts)),
    )
    assert (rigid.n_q, rigid.n_lam) == ((d + 1) * d, d * (d + 1) // 2)
    W = carried(rod)
    q, v = np.random.default_rng(1).uniform(-1, 1, (2, rigid.n_q))
    M = beam.pattern.dense(beam.mass(W @ q))
    assert_close(rigid.pattern.dense(rigid.mass(q)), W.T @ M @ W)
    # Elastic forces of the reference vanish up to round-off of E.
    q_o = rigid.start()[0]
    assert_close(rigid.force(0.0, q_o, v), W.T @ beam.force(0.0, W @ q_o, W @ v), 1e-8)
    y = 0.0 if rod.element is CABLE_2D else 0.01
    for point in (rod.at_start, rod.at(0.3, y=y), rod.at(0.5), rod.at_end):
        for quantity in rod.element.quantities:
            own, other = (x.naming.vector(point, quantity) for x in (rigid, beam))
            assert_close(own.of(q, d), other.of(W @ q, d))


@pytest.mark.parametrize("rod", RODS)
def test_solution_of_a_rigid_beam_has_its_nodes(rod, tmp_path):
    rigid = replace(rod, rigid=True)
    spin = 1.5 if rod.dimension == 2 else (0.5, -1.0, 1.5)
    start = [InitialVelocity("rod", spin, (0.1,) * rod.dimension)]
    run = simulate(Scene([rigid], start=start), 0.1, HHT(step=0.01))
    again = load_solution(run.save(tmp_path / "run.npz"))
    assert again.naming.layout == run.naming.layout
    nodes = again.nodes("rod")
    assert_close(nodes[0].ravel(), assemble(Scene([rod])).start()[0])
    for k, fraction in enumerate(run.naming.layout.beam("rod").fractions):
        assert_close(again.position(rod.at(fraction)), nodes[:, k, 0])
    # Arms between nodes keep their lengths: constraints hold to Newton's tolerance, a few 1e-14.
    arms = np.linalg.norm(nodes[:, 1:, 0] - nodes[:, :1, 0], axis=2)
    assert_close(arms, np.repeat(arms[:1], len(arms), axis=0), 1e-11)


@pytest.mark.parametrize("d", [2, 3])
def test_stiff_beam_approaches_the_rigid_one(d):
    z = (0.0,) * (d - 2)

    def tip(rigid, E):
        material = replace(STEEL, youngs_modulus=E)
        rod = Beam("rod", (0, 0, *z), (1.0, 0.0, *z), 2, THICK, material, rigid=rigid)
        joint = Pin(rod.at_start) if d == 2 else Revolute(rod.at_start, (0, 0, 1))
        scene = Scene([rod], [joint], gravity=(0.0, -G, *z))
        return simulate(scene, 0.3, HHT(step=2e-3)).position(rod.at_end)

    stiff = tip(True, 1e9)
    near, nearer = (np.max(np.abs(tip(False, E) - stiff)) for E in (1e8, 1e9))
    # The beam sags from the rigid motion, and vibrates about that, in proportion to 1 / E; a
    # clamped one would sag by 12 rho g l^4 / (8 E h^2) = 0.05 m.
    assert near < 0.01
    assert nearer == pytest.approx(near / 10, rel=0.3)


def test_parameters_of_a_rigid_beam_stay_targets():
    rod = Beam("rod", (0, 0), (1.0, 0.0), 2, FLAT, STEEL, rigid=True)
    scene = Scene([rod], [Pin(rod.at_start)], gravity=(0, -G))
    design = ["rod.youngs_modulus", "rod.damping_time", "rod.density", "rod.length"]
    end = Terminal(position(rod.at_end, 0))
    slopes = gradient(scene, end, 0.2, HHT(step=0.01), design=design).gradient
    # A pendulum falls alike whatever its density; nothing of the elastic law is felt.
    assert np.max(np.abs(slopes[:2])) == 0.0
    assert abs(slopes[2] * STEEL.density) < 1e-11
    assert abs(slopes[3]) > 0.1


# ---------------------------------------------------------------- joints and loads on bodies


def twins(d):
    """Two beams, and bodies in their place."""
    z = (0.2,) * (d - 2)
    beams = (
        Beam("one", (0.1, 0.2, *z), (0.9, 0.7, *z), 1, FLAT, STEEL),
        Beam("two", (0.9, 0.7, *z), (1.5, 0.4, *(3 * x for x in z)), 1, THICK, STEEL),
    )
    box, frames = RigidBox(0.5, 0.4, 0.3), [beam.directions().tolist() for beam in beams]
    bodies = [
        RigidBody(
            beam.name, beam.start, shape=box, density=500.0, centre=(0.2, 0.1, 0.3)[:d], frame=frame
        )
        for beam, frame in zip(beams, frames, strict=True)
    ]
    return beams, bodies


def points_of(members):
    """The same places of bodies and beams."""
    one, two = members
    if isinstance(one, RigidBody):
        l_1, l_2 = (np.linalg.norm(np.subtract(b.end, b.start)) for b in twins(one.dimension)[0])
        return two.at(0.4 * l_2, 0.02), one.at(0.8 * l_1, -0.01)
    return two.at(0.4, y=0.02), one.at(0.8, y=-0.01)


def pairs():
    """Every example of a joint or load on beams, and the same part on bodies."""
    for module, base in ((joints, Joint), (loads, Load)):
        for d in (2, 3):
            beams, bodies = twins(d)
            on_bodies = all_examples(module, base, bodies, points_of(bodies))
            on_beams = all_examples(module, base, beams, points_of(beams))
            # What acts on a whole centre line needs a beam.
            whole = {
                name
                for name, part in on_beams.items()
                if part.whole_beams or isinstance(part, BeamContact | BeamPairContact)
            }
            # Only a rigid body carries the obstacle of a contact.
            apart = set(on_bodies) ^ (set(on_beams) - whole)
            assert all(name.startswith("Contact") for name in apart)
            for name, part in on_bodies.items():
                if name in apart:
                    continue
                yield pytest.param(d, part, on_beams[name], id=f"{d}, {name}")


PAIRS = list(pairs())


@pytest.mark.parametrize(("d", "part", "twin"), PAIRS)
def test_part_on_a_body_is_that_on_a_beam_that_moves_like_it(d, part, twin):
    beams, bodies = twins(d)
    part, twin = replace(part, name="part"), replace(twin, name="part")
    design = [f"part.{name}" for name in part.parameters()]
    here = assemble(scene_of(bodies, part), design)
    there, bare = assemble(scene_of(beams, twin), design), assemble(Scene(beams))
    order = [body.name for body in here.naming.layout.bodies]
    assert order == [body.name for body in there.naming.layout.bodies] == ["one", "two"]
    W = block_diag(*(carried(beam) for beam in beams))
    rng, t, n = np.random.default_rng(2), 0.3, W.shape[1]
    states = here.n_q - n
    q, v = (np.append(x, 0.3 * np.ones(states)) for x in rigid_state(here.start()[0][:n], d, rng))
    W = block_diag(W, np.eye(states)) if states else W
    # A joint keeps the right angle of sections in space that are not rigid, by rows of its own.
    rows = here.naming.layout.joints[0].rows if here.n_lam > len(bodies) * d * (d + 1) // 2 else 0

    def same(value, expected, tolerance=EXACT):
        # Of the size of the numbers that go in, one, where the result is less.
        assert value.shape == expected.shape
        size = max(1.0, np.max(np.abs(expected), initial=0.0))
        assert np.max(np.abs(value - expected), initial=0.0) <= tolerance * size

    pairs = ((here, q, v), (there, W @ q, W @ v))
    for value in (
        lambda x, q, v: x.constraint(t, q),
        lambda x, q, v: constraint_b(x, t, q),
        lambda x, q, v: x.constraint_pattern.dot(x.constraint_q(t, q), v),
    ):
        own, other = (value(*pair)[:rows] for pair in pairs)
        same(own, other)
    # Elastic forces of 1e6 N leave their round-off in the difference.
    m = bare.n_q
    load = there.force(t, W @ q, W @ v)[:m] - bare.force(t, (W @ q)[:m], (W @ v)[:m])
    # Equations of states have masses of their own.
    same(v[:n] @ here.force(t, q, v)[:n], (W @ v)[:m] @ load, 1e-8)


def rigid_state(q, d, rng):
    """Coordinates and velocities of bodies that have moved rigidly, each by itself."""
    X = q.reshape(-1, d + 1, d).copy()
    V = np.zeros_like(X)
    for x, v in zip(X, V, strict=True):
        turn, spin = rng.uniform(-0.3, 0.3, (2, 3)) * ([0, 0, 1] if d == 2 else [1, 1, 1])
        R = Rotation.from_rotvec(turn).as_matrix()[:d, :d]
        x[0] += rng.uniform(-0.05, 0.05, d)
        x[1:] = x[1:] @ R.T
        v[0] = rng.uniform(-1, 1, d)
        v[1:] = np.cross(spin, np.pad(x[1:], ((0, 0), (0, 3 - d))))[:, :d]
    return X.ravel(), V.ravel()


# Every fourth: the equations and forces of all are compared above.
@pytest.mark.parametrize(("d", "part", "twin"), PAIRS[::4])
def test_gradients_with_a_part_on_a_body(d, part, twin):
    _, bodies = twins(d)
    spin = 1.5 if d == 2 else (0.5, -1.0, 1.5)
    scene = replace(
        scene_of(bodies, part),
        gravity=(1.0, -G, 0.5)[:d],
        start=[InitialVelocity(body.name, spin, body.position) for body in bodies],
        project_start=True,
    )
    targets = [f"{part.name}.{name}" for name in part.parameters()]
    design = [*targets, "one.length", "two.density", "two.centre_y", "one.centre_y"]
    places = [position(body.at(0.3, 0.1), 1) for body in bodies]
    turn = velocity(bodies[1].at(0.2), 0)
    assert_gradients(
        scene, [Terminal(places[0] + places[1]), Integral(kinetic_energy() + turn)], design
    )


def assert_gradients(scene, objectives, design, t_end=0.04):
    """Compare direct differentiation and the adjoint with a complex step of the whole call."""

    def by(method, design=design):
        run = gradients(scene, objectives, t_end, HHT(step=0.005), design=design, method=method)
        return np.array([one.gradient for one in run])

    direct, adjoint, values = by(DirectDifferentiation()), by(Adjoint()), assemble(scene, design).b
    # The claim: 1e-9 of the largest change that a variable makes when all change by their size.
    scale = np.max(np.abs(direct * values), axis=1)
    assert np.all(scale > 0)
    assert np.max(np.abs((adjoint - direct) * values) / scale[:, None]) <= 1e-9
    # Along random signs of all variables: an error of one of them is missed by each with a
    # probability of a half at most, whatever the others' are.
    for seed in range(2):
        along = np.random.default_rng(seed).choice([-1.0, 1.0], len(values))
        along *= np.where(values == 0, 1.0, values) / len(values) ** 0.5
        every = DesignVariable("every", dict(zip(design, along.tolist(), strict=True)))
        exact = by(ComplexStep(), [every])[:, 0]
        assert np.any(exact != 0)
        assert np.max(np.abs(direct @ along - exact) / scale) <= 1e-9


# ---------------------------------------------------------------- whole scenes


BAR = Rectangle(0.02, 0.03)
METAL = Material(2700.0, 7e9, 0.3)


def planar_machine():
    """A rod that bends carries a rigid one with a disc, and point masses on both."""
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, BAR, METAL)
    link = Beam("link", (1.0, 0.0), (1.4, 0.3), 2, BAR, METAL, rigid=True)
    disc = RigidBody("disc", (1.4, 0.3), shape=RigidCylinder(0.1, 0.05), density=2000.0)
    bead, knot = (
        PointMass(rod.at(0.3), 0.2, name="bead"),
        PointMass(link.at(0.4, 0.005), 0.1, name="knot"),
    )
    hooks = [
        Pin(rod.at_start, ground=(0.0, 0.0), name="base"),
        Pin(rod.at_end, link.at_start),
        Pin(link.at_end, disc.at(0.0, 0.0), name="hook"),
    ]
    loads_ = [DistributedForce("link", (1.0, 2.0)), PointForce(disc.at(0.1), (0.1, 0.2))]
    design = [
        *("rod.height", "rod.length", "link.height", "link.length", "link.density", "link.turn"),
        *("disc.radius", "bead.mass", "bead.point_fraction", "knot.mass", "hook.other_x"),
        *("base.ground_y", "scene.gravity_x"),
    ]
    bodies = [disc, bead, knot]
    return Scene([rod, link], hooks, (1.0, -G), loads=loads_, bodies=bodies), design


def spatial_machine():
    """A rod that bends, a rigid arc and a body of any inertia, on hinges."""
    rod = Beam("rod", (0, 0, 0), (1.0, 0, 0), 1, BAR, METAL)
    bow = replace(arc("bow", (1.0, 0.6, 0.0), 0.6, (0.0, 0.5, 1.0), 3, section=BAR), rigid=True)
    end, frame = bow.positions[-1], bow.frames[1].tolist()
    body = RigidBody("body", tuple(end), 2.0, SIX, centre=(0.1, 0.02, 0.03), frame=frame)
    bodies = [body, PointMass(rod.at(0.3, 0.005, 0.002), 0.2, name="bead")]
    joints_ = [
        Revolute(rod.at_start, (0, 0, 1)),
        Spherical(rod.at_end, bow.at_start),
        Revolute(bow.at_end, (0, 1, 1), other=body.origin, name="hinge"),
    ]
    loads_ = [
        DistributedForce("bow", (1.0, 2.0, 3.0)),
        SpringDamper(body.at(0.1, 0.1, 0.1), 20.0, 0.3, 0.2, rod.at(0.3)),
    ]
    start = [InitialVelocity("body", (0.0, 0.7, 0.7), tuple(end))]  # about the hinge
    design = [
        *("rod.width", "bow.height", "bow.length", "bow.density", "body.mass", "body.inertia_xy"),
        *("body.inertia_zz", "body.centre_y", "bead.mass", "hinge.axis_z", "body.turn_x"),
    ]
    return Scene([rod, bow], joints_, (0, -G, 1.0), start, loads_, bodies=bodies), design


def cable_machine():
    """A cable that carries a body."""
    rope = Beam("rope", (0, 0), (1.0, 0), 2, BAR, METAL, element=CABLE_2D)
    disc = RigidBody("disc", (1.0, 0.0), shape=RigidCylinder(0.1, 0.05), density=2000.0)
    hooks = [Pin(rope.at_start), Pin(rope.at_end, disc.at(0.0, 0.0))]
    return Scene([rope], hooks, (0, -G), bodies=[disc]), [
        "rope.length",
        "rope.height",
        "disc.radius",
    ]


def bodies_alone():
    """Two bodies and a point mass."""
    arm = RigidBody("arm", (0.1, 0.2), 2.0, 0.05, centre=(0.4, 0.1), turn=0.3)
    at = np.array([0.1, 0.2]) + 0.9 * np.array([np.cos(0.3), np.sin(0.3)])
    box = RigidBody("box", tuple(at), shape=RigidBox(0.3, 0.1, 0.05), density=2000.0)
    bodies = [arm, box, PointMass(box.at(0.3, 0.02), 0.7, name="load")]
    hooks = [Pin(arm.origin), Pin(arm.at(0.9), box.origin, name="elbow")]
    loads_ = [SpringDamper(box.at(0.3), 20.0, 0.3, 0.2, ground=(1.0, 0.5))]
    design = [
        *("arm.mass", "arm.inertia", "arm.centre_x", "arm.turn", "box.length", "box.density"),
        *("box.centre_y", "load.mass", "load.point_y", "elbow.point_x"),
    ]
    return Scene(joints=hooks, gravity=(0, -G), loads=loads_, bodies=bodies), design


MACHINES = [planar_machine, spatial_machine, cable_machine, bodies_alone]


def end_of(scene):
    """A point of the last beam or body."""
    member = scene.members[-1]
    return member.at(0.1, 0.05) if isinstance(member, RigidBody) else member.at_end


@pytest.mark.parametrize("machine", MACHINES)
def test_gradients_of_scenes_with_something_rigid(machine):
    scene, design = machine()
    objectives = [
        Terminal(position(end_of(scene), 0) + 1e-3 * kinetic_energy(scene.members[-1].name)),
        Integral(velocity(end_of(scene), 1) + 1e-3 * strain_energy()),
    ]
    assert_gradients(scene, objectives, design)


@pytest.mark.parametrize("machine", MACHINES)
def test_gradient_is_the_limit_of_differences_of_the_public_call(machine):
    scene, design = machine()
    end, run = Terminal(velocity(end_of(scene), 1)), (0.04, HHT(step=0.005))
    slopes = gradient(scene, end, *run, design=design).gradient
    for target, slope in zip(design, slopes, strict=True):
        (value,) = assemble(scene, [target]).b
        step = 1e-4 * (abs(value) or 1.0)

        def at(x, target=target):
            return gradient(scene.with_values({target: x}), end, *run, design=[target]).value

        difference = (at(value + step) - at(value - step)) / (2 * step)
        # Truncation (1e-4)^2 times a few; Newton's method leaves 1e-11 of 1 m/s.
        assert abs(difference - slope) * step <= 1e-6 * abs(slope) * step + 1e-11, target


@pytest.mark.parametrize("machine", MACHINES)
def test_hht_converges_to_ida(machine):
    scene, _ = machine()
    ends = []
    for integrator in (HHT(step=2e-4), IDA(rtol=1e-8)):
        run = simulate(scene, 0.01, integrator)
        assert run.outcome.success
        ends.append(run.position(end_of(scene))[-1])
    # Second order: h^2 t / 12 times a fourth derivative below 1e4 m/s^4, (10 rad/s)^4.
    assert np.max(np.abs(ends[0] - ends[1])) <= 1e-6


def test_energies_of_all_parts_sum_to_that_of_the_scene():
    for name in RIGID:
        system = assemble(SCENES[name]())
        v = np.random.default_rng(0).uniform(-1, 1, (2, system.n_q))
        parts = [system.energies.kinetic(v, owner) for owner in system.naming.layout.owners]
        assert_close(np.sum(parts, axis=0), system.energies.kinetic(v))
        for body, rigid in zip(system.naming.layout.bodies, system._numbering.rigid, strict=True):
            own = system.energies.strain(v, body.name)
            assert np.all(own == 0) == rigid


def test_scene_of_bodies_alone_pays_for_nothing_else():
    scene, _, _ = planar_pendulum()
    system = assemble(scene)
    # Three vectors; the pin and three equations of rigidity.
    assert (system.n_q, system.n_lam) == (6, 5)
    assert system.constraint_names == ("pin(arm(0.1, -0.1))",) * 2 + ("rigid(arm)",) * 3
    assert not system.traits.velocity_forces


# ---------------------------------------------------------------- equilibria and modes


def test_pendulum_hangs_and_swings_as_a_physical_one():
    scene, body, arm = planar_pendulum()
    rest = equilibrium(scene)
    pin = rest.solution.position(body.at(0.1, -0.1))[0]
    l = np.hypot(*arm)
    assert np.max(np.abs(rest.solution.position(body.centre_of_mass)[0] - pin - (0, -l))) <= 1e-12
    omega = np.sqrt(2.0 * G * l / (0.05 + 2.0 * l**2))
    found = modes(scene, 1, at=rest)
    assert found.frequencies[0] == pytest.approx(omega, rel=1e-10)
    run = simulate(replace(scene, start=[EquilibriumStart()]), 0.1, HHT(step=0.01))
    assert np.max(np.abs(run.q - run.q[0])) <= 1e-12


def test_bodies_that_nothing_holds_are_named():
    body = RigidBody("box", (0.3, 0.2), shape=RigidBox(0.4, 0.3, 0.2), density=700.0)
    for scene, words in (
        (Scene(bodies=[body]), "box turns about its origin"),
        (Scene(joints=[PointOnLine(body.origin, (1, 0))], bodies=[body]), "along x"),
    ):
        with pytest.raises(FreeMotionError, match=words):
            equilibrium(scene)


def test_body_starts_with_a_rigid_motion():
    body = RigidBody("body", (0.1, 0.2, 0.3), 2.0, SIX, centre=(0.1, 0.0, 0.0))
    motion = InitialVelocity("body", OMEGA, (1.0, 0.0, 0.0), velocity=(0.5, 0.0, 0.0))
    run = simulate(Scene(bodies=[body], start=[motion]), 0.01, HHT(step=0.01))
    at = np.array([0.3, -0.1, 0.2])
    arm = np.array([0.1, 0.2, 0.3]) + at - (1.0, 0.0, 0.0)
    assert_close(run.velocity(body.at(*at))[0], np.cross(OMEGA, arm) + motion.velocity)
    assert_close(run.slope(body.origin, 1)[0], np.array([0.0, 1.0, 0.0]))


# ---------------------------------------------------------------- bad input

BODY = RigidBody("body", (0.0, 0.0), 2.0, 0.05)
SOLID = RigidBody("solid", (0.0, 0.0, 0.0), 2.0, (1.0, 1.0, 1.0))
ROD = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, FLAT, STEEL)
BOX = RigidBox(0.4, 0.3, 0.2)

REFUSED = {
    "no mass": (lambda: RigidBody("b", (0, 0)), "b", "mass and inertia"),
    "no inertia": (lambda: RigidBody("b", (0, 0), 1.0), "b", "mass and inertia"),
    "both": (lambda: RigidBody("b", (0, 0), 1.0, 1.0, shape=BOX, density=1.0), "b", "or a shape"),
    "no density": (lambda: RigidBody("b", (0, 0), shape=BOX), "b", "density"),
    "name": (lambda: RigidBody("b.c", (0, 0), 1.0, 1.0), "name", "'.'"),
    "mass": (lambda: RigidBody("b", (0, 0), -1.0, 1.0), "mass", "positive"),
    "planar inertia": (lambda: RigidBody("b", (0, 0), 1.0, 0.0), "inertia", "positive"),
    "size of inertia": (lambda: RigidBody("b", (0, 0), 1.0, (1, 1, 1)), "inertia", "number"),
    "no body": (lambda: replace(SOLID, inertia=(1.0, 1.0, 2.0)), "inertia", "sum of the other"),
    "no tensor": (
        lambda: replace(SOLID, inertia=(1, 1, 1, 0.9, 0.9, 0.9)),
        "inertia",
        "sum of the other",
    ),
    "centre": (lambda: replace(BODY, centre=(0, 0, 0)), "centre", "2 components"),
    "frame": (lambda: replace(BODY, frame=((1, 0), (0, -1))), "frame", "right-handed"),
    "oblique frame": (lambda: replace(BODY, frame=((1, 0), (0.1, 1))), "frame", "perpendicular"),
    "size": (lambda: RigidSphere(0.0), "radius", "positive"),
    "no shape": (lambda: RigidBody("b", (0, 0), shape=FLAT, density=1.0), "shape", "BodyShape"),
    "place": (lambda: BODY.at(np.nan), "point of 'body'", "finite"),
    "both places": (lambda: MaterialPoint("body", 0.5, x=0.1), "point of 'body'", "fraction"),
    "fraction": (
        lambda: Scene(joints=[Pin(MaterialPoint("body", 0.5))], bodies=[BODY]),
        "pin(body@0.5)",
        "place x, y, z",
    ),
    "no fraction": (lambda: Scene([ROD], [Pin(MaterialPoint("rod"))]), "pin(rod)", "fraction"),
    "off the plane": (
        lambda: Scene(joints=[Pin(BODY.at(0.1, 0.1, 0.1))], bodies=[BODY]),
        "pin(body(0.1, 0.1, 0.1))",
        "z must be 0",
    ),
    "two dimensions": (lambda: Scene(bodies=[BODY, SOLID]), "Scene", "planar"),
    "beam and body": (lambda: Scene([ROD], bodies=[SOLID]), "Scene", "planar"),
    "nothing": (lambda: Scene(), "Scene", "at least one"),
    "mass alone": (lambda: Scene(bodies=[PointMass(BODY.origin, 1.0)]), "Scene", "at least one"),
    "one name": (lambda: Scene(bodies=[BODY, BODY]), "Scene.bodies", "name of its own"),
    "beam's name": (
        lambda: Scene([replace(ROD, name="body")], bodies=[BODY]),
        "Scene",
        "name of its own",
    ),
    "point mass": (lambda: PointMass(BODY.origin, 0.0), "mass(body)", "positive"),
    "nodes": (
        lambda: Scene([replace(ROD, rigid=True)], start=[NodalState("rod", np.zeros((3, 3, 2)))]),
        "start of 'rod'",
        "no nodes",
    ),
    "centre line": (
        lambda: Scene(bodies=[BODY], loads=[DistributedForce("body", (1.0, 0.0))]),
        "line-load(body)",
        "known name",
    ),
    "kind": (lambda: Scene(bodies=[ROD]), "Scene.bodies", "RigidBody"),
    "target": (
        lambda: assemble(Scene(bodies=[BODY]), ["body.radius"]),
        "design target",
        "known",
    ),
    "element": (
        lambda: assemble(Scene(bodies=[BODY]), ["body.mass[0]"]),
        "design target",
        "known",
    ),
    "value": (
        lambda: Scene(bodies=[BODY]).with_values({"body.mass": -1.0}),
        "body.mass",
        "positive",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_body_is_refused(case):
    action, where, rule = REFUSED[case]
    with pytest.raises(InvalidInputError) as caught:
        action()
    assert where in caught.value.where
    assert rule in f"{caught.value.rule} {caught.value.repair}"


def test_values_of_one_body_change_together():
    # On the way from one admissible inertia to the other each alone would be none.
    scene = Scene(bodies=[SOLID])
    changed = scene.with_values({"solid.inertia_x": 10.0, "solid.inertia_y": 10.0})
    assert changed.bodies[0].inertia == (10.0, 10.0, 1.0)
    with pytest.raises(InvalidInputError, match="sum of the other two"):
        scene.with_values({"solid.inertia_x": 10.0})


def test_solution_names_bodies(tmp_path):
    run = simulate(Scene(bodies=[BODY], gravity=(0, -G)), 0.1, HHT(step=0.05))
    again = load_solution(run.save(tmp_path / "run.npz"))
    assert again.naming.layout == run.naming.layout
    assert again.nodes("body").shape == (3, 1, 3, 2)
    assert_close(again.position(BODY.at(0.1, 0.2))[0], np.array([0.1, 0.2]))
    with pytest.raises(InvalidInputError, match="by their coordinates in it"):
        again.position(MaterialPoint("body", 0.5))
    with pytest.raises(UnknownNameError, match="body"):
        again.position(MaterialPoint("boddy"))


def test_a_rigid_rod_is_driven_from_rest_where_nothing_pulls():
    # No force at all at the start: nothing tells what size of motion is large.
    rod = Beam(
        "rod", (0, 0), (1, 0), 2, Rectangle(0.02, 0.02), Material(2700, 7e10, 0.3), rigid=True
    )
    drive = RotationDriver(rod.at_start, SmoothStep(0.0, 1.0, 1.0))
    run = simulate(Scene([rod], [Pin(rod.at_start), drive]), 0.5, HHT(2.0**-8))
    assert run.outcome.success
    end = run.position(rod.at_end)[-1]
    # Half way the ramp stands at 1/2; constraints are met to Newton's accuracy.
    np.testing.assert_allclose(end, [np.cos(0.5), np.sin(0.5)], atol=1e-10)
