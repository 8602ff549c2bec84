"""Loads and internal damping of a scene: values by hand, laws of time, power.

Tolerances: `setting`; derivatives are in `test_parts`. What a load adds is the difference of the
forces of a scene with and without it, without gravity; elastic forces are about 1e4 N and loads
about 10 N, so that this difference is taken of scenes of a soft material.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from ancfdae import (
    CABLE_2D,
    HHT,
    PID,
    Beam,
    BeamContact,
    BeamPairContact,
    Bushing,
    Clamp,
    Contact,
    DCMotor,
    DistributedForce,
    FirstOrderLag,
    FollowerForce,
    InitialVelocity,
    Material,
    Moment,
    MotorTorque,
    PointForce,
    RigidBody,
    Rope,
    RotationalFriction,
    Scene,
    SlidingFriction,
    SphereContacts,
    SpringDamper,
    TorsionalSpringDamper,
    TranslationalFriction,
    assemble,
    check_system,
    critical_load,
    equilibrium,
    modes,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import Controller, Law, MaterialPoint
from ancfdae.model.bodies import Quantity
from ancfdae.model.elements import ElementParameter
from ancfdae.model.loads.load import Load
from ancfdae.sections import Rectangle
from tests.support.by_hand import vector_by_hand
from tests.support.examples import LAW_TIME, law_examples
from tests.support.members import (
    force_b,
    force_q,
    force_q_times,
    force_rate,
    force_v,
)
from tests.support.oracle import plain_ancf as ancf
from tests.support.parts import GEL, LOADS, PAIRS, kinked, load_setting
from tests.support.scenes import FLAT, STEEL, THICK
from tests.support.setting import (
    DERIVATIVE,
    STEP,
    VALUE,
    assert_close,
    concrete_subclasses,
)


@pytest.fixture(scope="module", params=LOADS)
def one(request):
    return load_setting(request.param)


# ---------------------------------------------------------------- values by hand


def force_by_hand(s, q, v):
    """(points, forces) of a load that acts at points."""
    load, system = s.load, s.system
    if isinstance(load, PointForce):
        return [load.point], [np.array(load.force_vector)]
    if isinstance(load, FollowerForce):
        slopes = (
            vector_by_hand(system, q, load.point, k + 1) for k in range(len(load.force_components))
        )
        parts = zip(load.force_components, slopes, strict=True)
        return [load.point], [sum(f * r / np.linalg.norm(r) for f, r in parts)]
    turning = Moment | MotorTorque | TorsionalSpringDamper | RotationalFriction | PID | DCMotor
    if isinstance(load, turning) or (isinstance(load, FirstOrderLag) and load.direction is None):
        return [], []
    assert isinstance(load, SpringDamper), f"write what a {type(load).__name__} means"
    points = [load.point] if load.other is None else [load.point, load.other]
    e, w = (vector_by_hand(system, x, load.point, 0) for x in (q, v))
    if load.other is None:
        e = e - np.array(load.ground)
    else:
        there, there_v = (vector_by_hand(system, x, load.other, 0) for x in (q, v))
        e, w = e - there, w - there_v
    l = np.linalg.norm(e)
    tension = load.stiffness * (l - load.free_length) + load.damping * (e @ w) / l
    return points, [-tension * e / l, tension * e / l][: len(points)]


def touching_by_hand(s, point, virtual):
    """Force of contact with a plane at a point of a beam, and its power in a virtual velocity."""
    load, d = s.load, s.scene.dimension
    n = np.array(load.obstacle.normal) / np.linalg.norm(load.obstacle.normal)
    radius = load.radius or 0.0
    depth = radius - n @ (vector_by_hand(s.system, s.q, point, 0) - load.obstacle.place)
    assert depth > 0
    w, moved = (vector_by_hand(s.system, x, point, 0) for x in (s.v, virtual))
    turns = load.friction is not None and s.scene.beams[0].element is not CABLE_2D
    slopes = range(2, d + 1) if turns else ()
    for k in slopes:
        r_k = vector_by_hand(s.system, s.q, point, k)
        part = -radius * (n @ r_k) / (r_k @ r_k)
        w = w + part * vector_by_hand(s.system, s.v, point, k)
        moved = moved + part * vector_by_hand(s.system, virtual, point, k)
    N, F = load.stiffness * depth**load.exponent, 0 * n
    if load.restitution is not None:
        e = load.restitution
        # From kinetic energies before and after: u (1 + e) = ln(1 + u) - ln(1 - e u).
        u = scipy.optimize.brentq(
            lambda u: u * (1 + e) - np.log((1 + u) / (1 - e * u)), 1e-6, (1 - 1e-9) / e, xtol=1e-15
        )
        N = max(N * (1 - u / load.impact_speed * (w @ n)), 0.0)
    if load.friction is not None:
        slip = w - (w @ n) * n
        limit = (np.linalg.norm(slip) ** 4 + load.slip_speed**4) ** 0.25
        F = -load.friction * N * slip / limit
    return N * n + F, (N * n + F) @ moved


def power_by_hand(s, virtual):
    """Power of the load in a virtual velocity: of each force on its point, or per length."""
    if isinstance(s.load, Contact):
        return touching_by_hand(s, s.load.point, virtual)[1]
    if isinstance(s.load, BeamContact):
        return along_by_hand(
            s, s.load.points_per_element, lambda x: touching_by_hand(s, x, virtual)[1]
        )
    if isinstance(s.load, DistributedForce):
        f = np.array(s.load.force_per_length)
        # Cubic positions: four Gauss points are exact.
        return along_by_hand(s, 4, lambda x: f @ vector_by_hand(s.system, virtual, x, 0))
    if isinstance(s.load, Moment):
        return moment_power(s, virtual)
    if isinstance(
        s.load,
        MotorTorque
        | TorsionalSpringDamper
        | RotationalFriction
        | TranslationalFriction
        | Bushing
        | Controller,
    ):
        return coordinate_power(s, virtual)
    points, forces = force_by_hand(s, s.q, s.v)
    pairs = zip(points, forces, strict=True)
    return sum(F @ vector_by_hand(s.system, virtual, point, 0) for point, F in pairs)


def along_by_hand(s, count, of_point):
    """Integral of a function of points along the beam of a load, by Gauss points in elements."""
    x, w = np.polynomial.legendre.leggauss(count)
    place = s.system.naming.layout.beam(s.load.beam)
    fractions, total = np.array(place.fractions), 0.0
    first = place.first_element
    lengths = s.system.naming.lengths[first : first + place.element_count]
    for left, right, length in zip(fractions[:-1], fractions[1:], lengths, strict=True):
        for xi, weight in zip((1 + x) / 2, w / 2, strict=True):
            point = s.scene.beam(s.load.beam).at(left + xi * (right - left))
            total = total + weight * length * of_point(point)
    return total


def moment_power(s, virtual):
    """M . omega, omega from the rates of the unit normal and of the slopes in the section."""
    d, load = s.scene.dimension, s.load
    # A cable turns with its tangent.
    slopes = [1] if s.scene.beams[0].element is CABLE_2D else range(2, d + 1)
    R, R_1 = (
        np.array([vector_by_hand(s.system, x, load.point, k) for k in slopes]).T
        for x in (s.q, virtual)
    )
    if d == 2:
        (x, y), (x_1, y_1) = R[:, 0], R_1[:, 0]
        return load.moment * (x * y_1 - y * x_1) / (x * x + y * y)  # rate of atan2(y, x)
    moved = np.cross(*(R + 1j * STEP * R_1).T)
    moved = moved / np.sqrt(np.sum(moved * moved))
    n, n_1 = moved.real, moved.imag / STEP
    # In the section: the skew part of the gradient of the velocity, about the normal.
    L = R_1 @ np.linalg.pinv(R)
    P = np.eye(3) - np.outer(n, n)
    W = P @ (L - L.T) @ P / 2
    omega = np.cross(n, n_1) + n * (n @ [W[2, 1], W[0, 2], W[1, 0]])
    axes = np.vstack([n, (R / np.linalg.norm(R, axis=0)).T]) if load.follower else np.eye(3)
    return np.array(load.moment) @ axes @ omega


def directions_by_hand(s, q, rows):
    """Directions of the reference as the other section carries them: with its normal and slopes."""
    load, d = s.load, s.scene.dimension
    if load.other is None:
        return np.array(rows)
    slopes = [1] if s.scene.beams[0].element is CABLE_2D else range(2, d + 1)

    def basis(x):
        own = [vector_by_hand(s.system, x, load.other, k) for k in slopes]
        if d == 2:
            return np.array([[own[0][1], -own[0][0]], own[0]])
        return with_normal(own)

    # Coefficients by Cramer's rule in effect: solve(basis^T, row).
    return np.linalg.solve(basis(s.start).T, np.array(rows).T).T @ basis(q)


def with_normal(slopes):
    """Unit normal of a section, and its slopes."""
    n = np.cross(*slopes)
    return np.vstack([n / np.sqrt(n @ n), slopes])


def angle_by_hand(s, q, axis):
    """Angle about an axis by the sums of sines and cosines, as (sum of sines, of cosines)."""
    load, d = s.load, s.scene.dimension
    slopes = [1] if s.scene.beams[0].element is CABLE_2D else range(2, d + 1)
    now, then = (
        np.array([vector_by_hand(s.system, x, load.point, k) for k in slopes]) for x in (q, s.start)
    )
    if d == 3:
        now, then = with_normal(now), with_normal(then)
    then = directions_by_hand(s, q, then)
    if d == 2:
        (x, y), (u, w) = then[0], now[0]
        return x * w - y * u, x * u + y * w
    a = directions_by_hand(s, q, [axis])[0]
    a = a / np.sqrt(a @ a)
    # What is across the axis turns.
    now, then = now - np.outer(now @ a, a), then - np.outer(then @ a, a)
    return sum(a @ np.cross(x, y) for x, y in zip(then, now, strict=True)), np.sum(now * then)


def coordinates_by_hand(s, q):
    """Values of the coordinates that a load works on, each with how it shows its rate."""
    load, d = s.load, s.scene.dimension
    found = []
    slides = isinstance(load, FirstOrderLag) and load.direction is not None
    if isinstance(load, TranslationalFriction | Bushing) or slides:
        e, e_o = (vector_by_hand(s.system, x, load.point, 0) for x in (q, s.start))
        if load.other is not None:
            e = e - vector_by_hand(s.system, q, load.other, 0)
            e_o = e_o - vector_by_hand(s.system, s.start, load.other, 0)
        elif isinstance(load, Bushing):
            e, e_o = e - e_o, 0 * e_o
        if isinstance(load, TranslationalFriction) or slides:
            a = directions_by_hand(s, q, [load.direction])[0]
            return [a @ e / np.sqrt(a @ a)]
        found += list(directions_by_hand(s, q, np.eye(d)) @ e - e_o)
        axes = np.eye(3) if d == 3 else [None]
    else:
        axis = (0.0, 0.0, 1.0) if load.axis is None else load.axis
        axes = [np.array(axis) / np.linalg.norm(axis)]
    for axis in axes:
        S, C = angle_by_hand(s, q, axis)
        turned = (np.real(C) * np.imag(S) - np.real(S) * np.imag(C)) / np.real(S * S + C * C)
        found.append(np.arctan2(np.real(S), np.real(C)) + 1j * turned)
    return found


def coordinate_power(s, virtual):
    """What the load does on each coordinate times its rate in a virtual velocity."""
    load, d = s.load, s.scene.dimension
    values = [np.real(x) for x in coordinates_by_hand(s, s.q)]
    rates, moved = (
        [np.imag(x) / STEP for x in coordinates_by_hand(s, s.q + 1j * STEP * y)]
        for y in (s.v, virtual)
    )
    if isinstance(load, MotorTorque):
        resisting = [-load.torque]
    elif isinstance(load, TorsionalSpringDamper):
        stretched = values[0] - load.free_angle
        resisting = [load.stiffness * stretched + load.damping * rates[0]]
    elif isinstance(load, Controller):
        state, r = s.v[s.bare.n_q], next(x for x in vars(load).values() if isinstance(x, Law))
        resisting = [-state]
        if isinstance(load, DCMotor):
            resisting = [-load.torque_constant * state]
        elif isinstance(load, PID):
            errors = np.array([r.at(s.t) - values[0], state, r.at(s.t, 1) - rates[0]])
            resisting = [-np.dot([load.proportional, load.integral, load.derivative], errors)]
    elif isinstance(load, Bushing):
        turning = np.zeros(1 if d == 2 else 3)
        k = np.append(
            load.stiffness, turning if load.turn_stiffness is None else load.turn_stiffness
        )
        c = np.append(
            np.zeros(d) if load.damping is None else load.damping,
            turning if load.turn_damping is None else load.turn_damping,
        )
        resisting = k * values + c * rates
    else:
        w, level = rates[0], load.coulomb
        if load.breakaway is not None:
            level += (load.breakaway - level) * np.exp(-((w / load.stribeck_speed) ** 2))
        resisting = [level * np.tanh(w / load.smooth_speed) + load.viscous * w]
    return -np.dot(resisting, moved)


MOMENTS = [name for name, load in LOADS.items() if isinstance(load, Moment)]


@pytest.mark.parametrize("name", MOMENTS)
@pytest.mark.parametrize("seed", range(3))
def test_power_of_a_moment_in_a_rigid_motion_of_any_state_is_moment_times_spin(name, seed):
    s, rng = load_setting(name), np.random.default_rng(seed)
    d = s.scene.dimension
    omega, X = rng.uniform(-1, 1, 3), s.q.reshape(-1, d)
    spin = np.cross(np.eye(3), omega)[:d, :d]  # rows e_i x omega: r' = spin r
    V = (X @ spin.T).reshape(-1, s.system.naming.layout.bodies[0].stride, d)
    V[:, 0] += rng.uniform(-1, 1, d)
    M = np.array([0.0, 0.0, s.load.moment] if d == 2 else s.load.moment)
    if s.load.follower and d == 3:
        R = [vector_by_hand(s.system, s.q, s.load.point, k) for k in (2, 3)]
        M = M @ [v / np.linalg.norm(v) for v in (np.cross(*R), *R)]
    # Turned by a quarter about z, as any other way round, the sign would show.
    power = s.added() @ V.ravel() / s.factor
    assert power == pytest.approx(M @ omega, abs=VALUE * np.sum(np.abs(s.added() * V.ravel())))
    assert abs(M @ omega) > 1e-3


def test_constant_moment_in_the_plane_does_the_work_of_the_angle_it_turns_through():
    # Conservative: Q is the gradient of the moment times the angle of the section.
    s = load_setting("planar Moment")
    assert s.load.kind == "moment"
    Q_q = s.system.pattern.dense(force_q(s.system, s.t, s.q, s.v))
    Q_q -= s.bare.pattern.dense(force_q(s.bare, s.t, s.q, s.v))
    assert_close(Q_q, Q_q.T, VALUE)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [1, 4])
def test_cantilever_under_an_end_moment_bends_to_a_circle(d, n):
    M = 2e-6  # The moment's own stiffness is 1e-10 of that of the beam.
    turns = [((M,), 1)] if d == 2 else [((0.0, 0.0, M), 1), ((0.0, -M, 0.0), 2)]
    for components, axis in turns:
        rod = straight(d, n)
        moment = components if d == 3 else components[0]
        bent = displaced(rod, [Clamp(rod.at_start)], Moment(rod.at_end, moment))
        thick, wide = (FLAT.height, FLAT.width)[:: 1 if axis == 1 else -1]
        # Linear interpolation of the section's turn is exact for a constant curvature.
        expected = M / (2 * PLAIN.youngs_modulus * wide * thick**3 / 12)
        assert bent[axis] == pytest.approx(expected, rel=1e-8)


def test_virtual_work_is_that_of_the_forces_on_their_points(one):
    virtual = np.random.default_rng(1).uniform(-1, 1, one.system.n_q)
    virtual[one.bare.n_q :] = 0.0  # Forces on states are their equations.
    Q = one.added()
    # Forces of 10 N in 40 terms of size one; relative to the sum of their magnitudes.
    size = np.sum(np.abs(Q * virtual))
    assert abs(Q @ virtual - one.factor * power_by_hand(one, virtual)) <= VALUE * size
    assert size > 1e-3


def test_resultant_of_a_load_is_its_force(one):
    d = one.scene.dimension
    translation = np.zeros((one.system.n_q // d, d, d))
    translation[one.positions] = np.eye(d)
    resultant = one.added() @ translation.reshape(-1, d) / one.factor
    if isinstance(one.load, DistributedForce):
        length = one.scene.beam(one.load.beam).length
        expected = length * np.array(one.load.force_per_length)
    elif isinstance(one.load, BeamContact):
        count, rest = one.load.points_per_element, 0 * one.q
        expected = along_by_hand(one, count, lambda x: touching_by_hand(one, x, rest)[0])
    elif isinstance(one.load, Contact):
        expected = touching_by_hand(one, one.load.point, 0 * one.q)[0]
    elif isinstance(one.load, TranslationalFriction | Bushing | FirstOrderLag):
        # Of a translation of everything: nothing between two beams.
        expected = [power_by_hand(one, field) for field in translation.reshape(-1, d).T]
    else:
        expected = np.sum(force_by_hand(one, one.q, one.v)[1], axis=0)
    # Between two beams the forces balance; they are measured by their size.
    scale = max(np.max(np.abs(expected)), np.max(np.abs(one.added())))
    assert np.max(np.abs(resultant - expected)) <= VALUE * scale


@pytest.mark.parametrize("d", [2, 3])
def test_line_load_of_rho_h_w_g_is_gravity(d):
    beam = Beam("rod", (0.1, 0.2, 0.3)[:d], (0.9, 0.7, 0.5)[:d], 3, THICK, STEEL)
    g = np.array([1.3, -9.81, 0.7])[:d]
    line = DistributedForce("rod", STEEL.density * THICK.height * THICK.width * g)
    loaded, heavy = assemble(Scene([beam], loads=[line])), assemble(Scene([beam], gravity=g))
    q, v = loaded.start()
    for design in (q, q + 0.05 * np.random.default_rng(1).uniform(-1, 1, len(q))):
        bare = assemble(Scene([beam])).force(0.0, design, v)
        Q, weight = loaded.force(0.0, design, v) - bare, heavy.force(0.0, design, v) - bare
        # Elastic forces of up to 1e4 N leave a difference of weights of 20 N.
        assert_close(Q, weight, 10 * VALUE * max(1.0, np.max(np.abs(bare)) / np.max(np.abs(Q))))
    # The reference state is free of stress, so that the vectors agree to round-off there.
    assert_close(loaded.force(0.0, q, v), heavy.force(0.0, q, v), 1e-10)


FOLLOWERS = [
    f"{space} {at}" for space in ("planar", "spatial") for at in ("follower, node", "FollowerForce")
]


@pytest.mark.parametrize("name", FOLLOWERS)
@pytest.mark.parametrize("seed", range(3))
def test_follower_force_turns_with_the_section_and_keeps_its_size(name, seed):
    s = load_setting(name)
    d, rng = s.scene.dimension, np.random.default_rng(seed)
    R = ancf.random_rotation(d, rng)
    turned = (s.q.reshape(-1, d) @ R.T).ravel()
    Q = s.added()
    assert_close(s.added(turned), (Q.reshape(-1, d) @ R.T).ravel(), VALUE)
    # Stretching the section does not change it: components are along unit vectors.
    stretched = 1.7 * s.q.reshape(-1, d)
    for body in s.system.naming.layout.bodies:
        stretched[body.positions] /= 1.7
    if s.load.point.fraction == 0.5:  # at a node slopes are node vectors
        assert_close(s.added(stretched.ravel()), Q, VALUE)
    assert np.max(np.abs(R - np.eye(d))) > 0.05


def test_constant_loads_are_constant_and_the_others_are_not(one):
    rng = np.random.default_rng(5)
    moved = one.q + 0.1 * rng.uniform(-1, 1, one.system.n_q)
    change = np.max(np.abs(one.added(moved) - one.added()))
    still = change <= VALUE * np.max(np.abs(one.added()))
    # Friction on a line of the ground depends on velocities alone.
    assert still == (one.load.constant or not np.any(one.by_coordinate(one.added)))
    change = np.max(np.abs(one.added(v=2 * one.v) - one.added()))
    damped = one.load.uses_velocity(())
    assert (change > 1e-3) == damped
    own = [one.load.numbers_of(name) for name in one.load.damping_fields]
    assert one.load.uses_velocity(one.load.parameters()) == any([*own, one.load.states])
    assert one.system.traits.velocity_forces or not damped


BETWEEN = [name for name, load in LOADS.items() if len(load.points) == 2]


@pytest.mark.parametrize("name", BETWEEN)
def test_action_and_reaction_do_no_work_in_a_rigid_motion(name):
    s = load_setting(name)
    rate, moved, turned = s.motion(1)
    work = s.added() * rate
    assert abs(np.sum(work)) <= VALUE * np.sum(np.abs(work))
    # And a motion of both together neither loads nor relieves it.
    assert_close(s.added(moved, turned(s.v)), turned(s.added()), 10 * VALUE)


# ---------------------------------------------------------------- springs and dampers


SPRINGS = [name for name, x in LOADS.items() if isinstance(x, SpringDamper) and x.law is None]


@pytest.mark.parametrize("name", SPRINGS)
@pytest.mark.parametrize("seed", range(2))
def test_power_of_spring_and_damper_is_the_loss_of_energy(name, seed):
    s, rng = load_setting(name), np.random.default_rng(seed)
    v = rng.uniform(-1, 1, s.system.n_q)
    load = s.load

    def length(q):
        e = vector_by_hand(s.system, q, load.point, 0)
        other = load.ground if load.other is None else vector_by_hand(s.system, q, load.other, 0)
        e = e - np.asarray(other)
        return np.sqrt(e @ e)

    moved = length(s.q + 1j * STEP * v)
    rate = moved.imag / STEP
    stored = load.stiffness * (moved.real - load.free_length) * rate
    lost = load.damping * rate**2
    power = s.added(v=v) @ v
    size = np.sum(np.abs(s.added(v=v) * v))
    assert power == pytest.approx(-stored - lost, abs=VALUE * size)
    assert abs(stored) > 1e3 * VALUE * size
    assert (lost > 1e3 * VALUE * size) == (load.damping > 0)


def test_a_spring_depends_on_velocities_where_it_damps():
    ground = (0.0, 1.0)
    assert not SpringDamper(MaterialPoint("rod", 1.0), 30.0, ground=ground).uses_velocity(())
    for damping in (0.5, 1.0):
        assert SpringDamper(MaterialPoint("rod", 1.0), 30.0, damping, ground=ground).uses_velocity(
            ()
        )


def test_damper_takes_the_energy_out_of_a_swinging_beam():
    steel = Material(density=1000.0, youngs_modulus=1e7, poisson_ratio=0.3)
    rod = Beam("rod", (0.0, 0.0), (0.8, 0.0), 1, FLAT, steel)
    start = [InitialVelocity("rod", 0.0, (0.0, 0.0), velocity=(1.0, 0.5))]
    energies, lost = [], []
    for damping in (0.0, 0.5):
        spring = SpringDamper(rod.at(0.5), 40.0, damping, 0.3, ground=(0.2, -0.5))
        scene = Scene([rod], loads=[spring], start=start)
        # Alpha next to zero: numerical damping would hide the balance.
        solution = simulate(scene, 0.5, HHT(step=2**-9, hht_alpha=-0.01))
        assert solution.outcome.success
        system = assemble(scene)
        e = solution.position(MaterialPoint("rod", 0.5)) - [0.2, -0.5]
        l = np.linalg.norm(e, axis=1)
        rate = np.sum(e * solution.velocity(MaterialPoint("rod", 0.5)), axis=1) / l
        stored = 0.5 * 40.0 * (l - 0.3) ** 2 + system.energies.strain(solution.q)
        energy = system.energies.kinetic(solution.v) + stored
        power = damping * rate**2
        lost.append(np.sum(power[1:] + power[:-1]) / 2 * 2**-9)
        energies.append(energy)
    (free, damped), (_, work) = energies, lost
    # Second order: 1e-5, 2e-6 and 8e-7 of the energy were lost at steps of 2^-8, 2^-9 and 2^-10,
    # and the balance of the damped run is open by 5e-6 here; four times that.
    assert np.max(np.abs(free - free[0])) <= 2e-5 * free[0]
    assert damped[0] - damped[-1] == pytest.approx(work, abs=2e-5 * damped[0])
    assert work > 0.02 * damped[0]


def test_loads_of_a_scene_add_up():
    rod, bow = PAIRS["planar"]
    here = [load for name, load in LOADS.items() if name.startswith("planar")]
    many = [load for load in here if not load.states]  # Others have coordinates of their own.
    many = [replace(load, name=str(k)) for k, load in enumerate(many)]
    scene = kinked(Scene([rod, bow], loads=many))
    bare, whole = assemble(replace(scene, loads=[])), assemble(scene)
    rng = np.random.default_rng(6)
    q, v = bare.start()[0] + 0.05 * rng.uniform(-1, 1, bare.n_q), rng.uniform(-1, 1, bare.n_q)
    expected = bare.force(0.3, q, v)
    parts = [assemble(replace(scene, loads=[load])).force(0.3, q, v) for load in many]
    expected = expected + sum(part - expected for part in parts)
    assert_close(whole.force(0.3, q, v), expected, VALUE)


# ---------------------------------------------------------------- laws of time


@pytest.mark.parametrize("law", law_examples().values(), ids=law_examples())
@pytest.mark.parametrize("name", ["planar point, node", SPRINGS[0]])
def test_a_law_multiplies_a_load_at_every_instant(law, name):
    load = LOADS[name]
    scene = Scene(PAIRS["planar"], loads=[replace(load, law=law)])
    design = [f"{load.name}.{parameter}" for parameter in law.parameters()]
    system, still = assemble(scene, design), assemble(replace(scene, loads=[load]))
    bare, rng = assemble(replace(scene, loads=[])), np.random.default_rng(4)
    q = bare.start()[0] + 0.05 * rng.uniform(-1, 1, bare.n_q)
    v, a = rng.uniform(-1, 1, (2, bare.n_q))
    lam = np.zeros(0)
    times = LAW_TIME + np.array([0.0, 0.1])
    for t in times:
        added = system.force(t, q, v) - bare.force(t, q, v)
        one = still.force(t, q, v) - bare.force(t, q, v)
        assert_close(added, law.at(t) * one, VALUE)
        rate = force_rate(system, t, q, v, a) - force_rate(bare, t, q, v, a)
        moving = force_rate(still, t, q, v, a) - force_rate(bare, t, q, v, a)
        expected = law.at(t) * moving + law.at(t, 1) * one
        assert np.max(np.abs(rate - expected)) <= DERIVATIVE * (1 + np.max(np.abs(expected)))
        # Q_q x holds the law still.
        held = force_q_times(system, t, q, v) - force_q_times(bare, t, q, v)
        now = force_q_times(still, t, q, v) - force_q_times(bare, t, q, v)
        assert np.max(np.abs(held - law.at(t) * now)) <= DERIVATIVE * (1 + np.max(np.abs(now)))
    # Many instants at once are the instants one by one.
    rows = [np.array([x, x]) for x in (q, v, a, lam)]
    both = system.linearise(times, *rows)
    each = [system.linearise(times[[k]], *(x[[k]] for x in rows)) for k in (0, 1)]
    for member in ("f_q", "f_v"):
        whole, parts = getattr(both, member), [getattr(one, member) for one in each]
        assert (whole is None) == (parts[0] is None)
        if whole is not None:
            assert_close(whole, np.concatenate(parts), VALUE)
    mu = rng.uniform(-1, 1, (2, bare.n_q))
    pulled = system.pull_back(times, tuple(rows), (mu, np.zeros((2, 0))))
    expected = sum(-force_b(system, t, q, v).T @ y for t, y in zip(times, mu, strict=True))
    assert_close(pulled, expected, DERIVATIVE)
    assert np.all(expected != 0)


def test_loads_that_depend_on_time_pass_every_check_of_a_system():
    law = law_examples()["Harmonic"]
    rod, bow = PAIRS["planar"]
    scene = Scene(
        [rod, bow],
        loads=[
            PointForce(bow.at(0.4), (3.0, -5.0), law=law, name="pull"),
            FollowerForce(rod.at(0.5), (4.0, 1.0), law=law, name="jet"),
            SpringDamper(rod.at(0.3), 30.0, 5.0, 0.4, bow.at_end, law=law, name="spring"),
        ],
    )
    targets = ["pull.frequency", "pull.force_x", "jet.phase", "spring.offset", "spring.damping"]
    assert check_system(assemble(scene, targets), samples=1).passed


# ---------------------------------------------------------------- statics


# nu = 0: no Poisson locking, and the section is free.
PLAIN = Material(density=2700.0, youngs_modulus=3e6, poisson_ratio=0.0)


def straight(d, n):
    """A beam of length one along x."""
    z = (0.0,) * (d - 2)
    return Beam("rod", (0.0, 0.0, *z), (1.0, 0.0, *z), n, FLAT, PLAIN)


def displaced(rod, joints, load):
    """Displacement of the end of a beam, linearised at the reference."""
    system, d = assemble(Scene([rod], joints, loads=[load])), rod.dimension
    q, v = system.start()
    K = -system.pattern.dense(force_q(system, 0.0, q, v))
    B = system.constraint_pattern.dense(system.constraint_q(0.0, q))
    saddle = np.block([[K, B.T], [B, np.zeros((len(B), len(B)))]])
    x = np.linalg.solve(saddle, np.concatenate([system.force(0.0, q, v), np.zeros(len(B))]))
    return system.naming.vector(rod.at_end, Quantity.POSITION).of(x[: system.n_q], d)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [1, 2, 8])
def test_tip_of_a_cantilever_moves_as_in_beam_theory(d, n):
    F, (h, w) = 0.3, (FLAT.height, FLAT.width)
    for axis, (thick, wide) in enumerate(((h, w), (w, h))[: d - 1], start=1):
        force = tuple(F if k == axis else 0.0 for k in range(d))
        rod = straight(d, n)
        bent = displaced(rod, [Clamp(rod.at_start)], PointForce(rod.at_end, force))
        E, G, factor = PLAIN.youngs_modulus, PLAIN.youngs_modulus / 2, 10 / 12
        deflection = F / (3 * E * (wide * thick**3 / 12)) + F / (factor * G * wide * thick)
        # Exact at nu = 0; the stiffest coordinate is 1e6 times as stiff as the softest.
        assert bent[axis] == pytest.approx(deflection, rel=1e-9)
        assert np.max(np.abs(np.delete(bent, axis))) <= 1e-9 * abs(bent[axis])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [1, 2, 8])
def test_pulled_bar_stretches_by_force_over_stiffness(d, n):
    F, rod, along = 0.3, straight(d, n), np.eye(d)[0]
    bearing = Clamp(rod.at_start)
    pulled = displaced(rod, [bearing], PointForce(rod.at_end, F * along))
    # The stiffest coordinate is 1e6 times as stiff as the softest; times eps, and a few.
    assert pulled[0] == pytest.approx(F / (3e6 * FLAT.height * FLAT.width), rel=1e-9)


# ---------------------------------------------------------------- internal damping of a scene


def damped_beams(d, times):
    z = (0.2,) * (d - 2)
    materials = [Material(1000.0, 1e4, 0.3, time) for time in times]
    rod = Beam("rod", (0.1, 0.2, *z), (0.9, 0.7, *z), 2, FLAT, materials)
    return Scene([rod])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(10))
def test_internal_damping_takes_energy_out_of_every_motion(d, seed):
    rng = np.random.default_rng(seed)
    damped, bare = (assemble(damped_beams(d, t)) for t in ((0.02, 0.05), (0.0, 0.0)))
    q = damped.start()[0] + 0.05 * rng.uniform(-1, 1, damped.n_q)
    v = rng.uniform(-1, 1, damped.n_q)
    power = (damped.force(0.0, q, v) - bare.force(0.0, q, v)) @ v
    assert power < 0
    Q_v = damped.pattern.dense(force_v(damped, 0.0, q, v))
    assert power == pytest.approx(v @ Q_v @ v, rel=1e-9)
    # Every direction: Q_v is negative semidefinite, to the round-off of its largest entries.
    values = np.linalg.eigvalsh((Q_v + Q_v.T) / 2)
    assert np.max(values) <= VALUE * -np.min(values)
    assert np.min(values) < 0


@pytest.mark.parametrize("d", [2, 3])
def test_rigid_motion_of_a_deformed_beam_is_not_damped(d):
    rng = np.random.default_rng(3)
    damped, bare = (assemble(damped_beams(d, t)) for t in ((0.02, 0.05), (0.0, 0.0)))
    q = damped.start()[0] + 0.05 * rng.uniform(-1, 1, damped.n_q)
    B = rng.uniform(-1, 1, (d, d))
    X = q.reshape(-1, d + 1, d)
    V = X @ (B - B.T).T
    V[:, 0] += rng.uniform(-1, 1, d)
    difference = damped.force(0.0, q, V.ravel()) - bare.force(0.0, q, V.ravel())
    other = damped.force(0.0, q, V.ravel()[::-1]) - bare.force(0.0, q, V.ravel())
    round_off = VALUE * np.max(np.abs(bare.force(0.0, q, V.ravel())))
    assert np.max(np.abs(difference)) <= round_off
    assert np.max(np.abs(other)) > 1e6 * round_off


@pytest.mark.parametrize("d", [2, 3])
def test_zero_damping_time_is_bitwise_no_damping_even_as_a_design_variable(d):
    scene = damped_beams(d, (0.0, 0.0))
    bare, named = assemble(scene), assemble(scene, ["rod.damping_time"])
    rng = np.random.default_rng(2)
    q, v = bare.start()[0] + 0.05 * rng.uniform(-1, 1, bare.n_q), rng.uniform(-1, 1, bare.n_q)
    assert not bare.traits.velocity_forces
    assert named.traits.velocity_forces
    assert np.array_equal(bare.force(0.0, q, v), named.force(0.0, q, v))
    assert np.array_equal(force_q(bare, 0.0, q, v), force_q(named, 0.0, q, v))
    assert not np.any(force_v(named, 0.0, q, v))
    # And it can be turned on from there.
    assert np.max(np.abs(force_b(named, 0.0, q, v))) > 1.0


def test_damping_time_of_an_element_is_its_own():
    system = assemble(damped_beams(2, (0.02, 0.05)), ["rod.damping_time[0]", "rod.damping_time[1]"])
    tau = system._scene.element_parameters[:, ElementParameter.DAMPING_TIME]
    assert np.array_equal(tau, [0.02, 0.05])
    assert np.array_equal(system.b, [0.02, 0.05])
    q = system.start()[0]
    v = np.random.default_rng(2).uniform(-1, 1, system.n_q)
    size = (2 + 1) * 2
    Q_b = force_b(system, 0.0, q, v)
    # The first element does not reach the last node, nor the second the first.
    assert not np.any(Q_b[2 * size :, 0])
    assert not np.any(Q_b[:size, 1])
    assert np.any(Q_b[:size, 0])
    assert np.any(Q_b[2 * size :, 1])


@pytest.mark.parametrize("d", [2, 3])
def test_damping_of_small_motions_is_the_damping_time_times_the_stiffness(d):
    # Hence every mode decays with omega^2 tau / 2.
    scene = damped_beams(d, (0.02, 0.02))
    system = assemble(scene)
    q, v = system.start()
    K, D = (system.pattern.dense(-f(system, 0.0, q, v)) for f in (force_q, force_v))
    assert_close(D, 0.02 * K, VALUE)


def test_a_follower_force_on_a_straight_beam_acts_on_the_position_alone():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, FLAT, GEL)
    free, loaded = (
        assemble(Scene([rod], loads=loads))
        for loads in ([], [FollowerForce(rod.at_end, (4.0, -3.0))])
    )
    q, v = free.start()
    change = (loaded.force(0.0, q, v) - free.force(0.0, q, v)).reshape(2, 3, 2)
    expected = np.zeros((2, 3, 2))
    expected[1, 0] = 4.0, -3.0
    np.testing.assert_allclose(change, expected, rtol=0, atol=1e-14)  # of 5 N, by eps


@pytest.mark.parametrize("follows", [False, True])
def test_loads_that_follow_are_those_without_an_energy(follows):
    # Statics increases them along the path; a spring is there from its beginning.
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, FLAT, STEEL)
    spring = SpringDamper(rod.at_end, 30.0, ground=(0.0, 1.0))
    load = FollowerForce(rod.at_end, (0.0, 1.0)) if follows else spring
    system = assemble(Scene([rod], [Clamp(rod.at_start)], loads=[load]))
    q, v = system.start()
    assert np.any(system.force(0.0, q, v))
    for part in system.following_load(0.0, q):
        assert np.any(part) == follows


def test_loads_with_an_energy_are_known():
    springs = {
        BeamContact,
        Bushing,
        Contact,
        Rope,
        RotationalFriction,
        SlidingFriction,
        TranslationalFriction,
        BeamPairContact,
        SphereContacts,
        SpringDamper,
        TorsionalSpringDamper,
    }
    assert {kind for kind in concrete_subclasses(Load) if kind.elastic} == springs


@pytest.mark.parametrize("n", [8, 32, 128])
@pytest.mark.parametrize("width", [0.05, 0.02])
def test_a_moment_shears_the_section_at_the_end_of_a_twisted_bar(n, width):
    """Closed form of linear elements for G J theta'' = 0, K gamma'' = G A gamma.

    The moment does the work M (theta + (c_z - c_y) gamma/2) on the mean turn of both slopes;
    gamma decays as mu^j along the nodes.
    """
    height, length, E, nu, M = 0.05, 1.0, 1e7, 0.3, 1e-3
    section, G = Rectangle(height, width), E / (2 * (1 + nu))
    rod = Beam(
        "rod", (0, 0, 0), (length, 0, 0), n, section, Material(1e3, E, nu), height_axis=(0, 1, 0)
    )
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[Moment(rod.at_end, (M, 0, 0))])
    slopes = equilibrium(scene).solution.nodes("rod")[0][:, 2:]
    a = np.arctan2(slopes[:, 0, 2], slopes[:, 0, 1])
    b = np.arctan2(-slopes[:, 1, 1], slopes[:, 1, 2])
    c_y = height**2 / (height**2 + width**2)
    theta = c_y * a + (1 - c_y) * b
    GJ = M * length / (2 * theta[n // 2])
    uneven, K = (2 * c_y - 1) ** 2, GJ * c_y * (1 - c_y)
    k, s = K * n / length, G * height * width * length / n / 6
    root = (k + 2 * s) / (k - s)
    mu = root - np.copysign(np.sqrt(root**2 - 1), root)
    excess = uneven / 4 / (k * (1 - mu) + s * (2 + mu)) * GJ / length
    mean = (a[-1] + b[-1]) / 2 * GJ / (M * length)
    assert mean - 1 == pytest.approx(excess, rel=1e-4, abs=1e-8)
    # In the mean by the squares of radii it is that of the bar.
    assert theta[-1] * GJ / (M * length) == pytest.approx(1, rel=1e-7)


def on_springs(**more):
    """A mass on the x axis between two springs along it, of stiffness 50 and -20."""
    ball = RigidBody("ball", (0, 0), mass=2.0, inertia=1.0)
    springs = [
        SpringDamper(ball.at(0, 0), k, free_length=1.0, ground=(x, 0), name=name, **more)
        for k, x, name in ((50.0, -1.0, "one"), (-20.0, 1.0, "other"))
    ]
    hold = Bushing(ball.at(0, 0), (0.0, 100.0), (0.0, 0.1), 1.0, 0.1, name="bushing")
    turn = TorsionalSpringDamper(ball.at(0, 0), 1.0, 0.1, name="turn")
    return Scene(bodies=[ball], loads=[*springs, hold, turn])


def test_a_negative_stiffness_is_one():
    # The frequency falls to sqrt((50 - 20) / 2), and vanishes at -50.
    found = modes(on_springs(), 3).natural_frequencies
    assert np.min(np.abs(found / np.sqrt(15.0) - 1)) < 1e-12
    lost = critical_load(on_springs(), "other.stiffness", -80.0, design=["one.stiffness"])
    assert lost.value == pytest.approx(-50.0, rel=1e-9)
    assert lost.gradient == pytest.approx([-1.0], rel=1e-9)


@pytest.mark.parametrize(
    "target",
    [
        "one.damping",
        "one.free_length",
        "turn.damping",
        "bushing.damping_x",
        "bushing.damping_y",
        "bushing.turn_damping",
    ],
)
def test_a_negative_damping_or_length_is_refused(target):
    field = target.partition(".")[2]
    with pytest.raises(InvalidInputError, match=rf"{field}.*must not be negative; got -0\.1"):
        on_springs().with_values({target: -0.1})
    on_springs().with_values({target: 0.0})
