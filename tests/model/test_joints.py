"""Joints: equations by hand, and simulations that show that joints hold what they should.

Every joint stands alone in a scene, at nodes and between them, to ground and between beams. Its
equations are compared with their geometric meaning; their derivatives are in `test_parts`.
"""

from functools import partial as given

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ancfdae import (
    CABLE_2D,
    HHT,
    Beam,
    Clamp,
    Cylindrical,
    Distance,
    InitialVelocity,
    Material,
    MovingSupport,
    Pin,
    PointOnLine,
    Revolute,
    RotationDriver,
    SaintVenantKirchhoff,
    Scene,
    TranslationDriver,
    Universal,
    assemble,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import MaterialPoint
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.model.joints.frames import SectionFrame, across, unit
from ancfdae.model.joints.joint import DrivenJoint
from ancfdae.model.parts import Elements, Normal
from ancfdae.sections import Rectangle
from tests.support.by_hand import turns_by_hand, vector_by_hand
from tests.support.joint_motions import MOTIONS
from tests.support.parts import JOINTS, MEMBERS, joint_setting
from tests.support.setting import (
    VALUE,
    assert_close,
)


@pytest.fixture(scope="module", params=JOINTS)
def one(request):
    return joint_setting(request.param)


# ---------------------------------------------------------------- equations by hand


def equations_by_hand(s, q, t):
    """What the equations mean: values, and the length of those that stand in any basis."""
    joint, start = s.joint, s.system.start()[0]
    d = s.scene.dimension
    places = [vector_by_hand(s.system, q, point, 0) for point in joint.points]
    held = vector_by_hand(s.system, start, joint.points[0], 0)
    if len(places) == 2:
        there = places[1]
    else:
        ground = getattr(joint, "ground", None)
        there = held if ground is None else np.array(ground)
    gap = places[0] - there
    if isinstance(joint, Pin):
        return gap, None
    if isinstance(joint, Clamp):
        return np.append(gap, turns_by_hand(s.system, q, start, joint.point)), None
    if isinstance(joint, Distance):
        return np.array([(gap @ gap / joint.length - joint.length) / 2]), None
    if isinstance(joint, PointOnLine):
        if joint.through is not None:
            gap = places[0] - np.array(joint.through)
        along = np.array(joint.direction) / np.linalg.norm(joint.direction)
        return np.zeros(0), np.linalg.norm(gap - (gap @ along) * along)
    if isinstance(joint, TranslationDriver):
        direction = np.array(joint.direction) / np.linalg.norm(joint.direction)
        return np.array([direction @ gap - joint.travel.at(t)]), None
    if isinstance(joint, MovingSupport):
        direction = np.array(joint.direction) / np.linalg.norm(joint.direction)
        turns = turns_by_hand(s.system, q, start, joint.point)
        return np.append(gap - joint.travel.at(t) * direction, turns), None
    n_s = s.system.naming.layout.bodies[0].stride
    slopes, were = (
        np.array([vector_by_hand(s.system, x, joint.point, k) for k in range(min(2, n_s - 1), n_s)])
        for x in (q, start)
    )
    axis = np.array((0.0, 0.0, 1.0) if joint.axis is None else joint.axis)
    axis /= np.linalg.norm(axis)
    turn = Rotation.from_rotvec(joint.angle.at(t) * axis)
    if d == 2:
        b_o, b = np.append(were[0], 0.0), np.append(slopes[0], 0.0)
        return np.array([turn.apply(np.cross(axis, b_o)) @ b / np.linalg.norm(b_o)]), None
    normal = np.cross(*were) / np.linalg.norm(np.cross(*were))
    # What a moment about the turned axis works on (`Moment`): duals of the slopes in the plane.
    duals = np.linalg.inv(np.vstack([were, normal])).T[:2]
    forces = np.cross(axis - axis @ normal / 2 * normal, duals)
    values = [np.sum(turn.apply(forces) * slopes)]
    if abs(axis @ normal) > 0.1:
        y = were[0] / np.linalg.norm(were[0])
        y, z = ((duals @ x) @ slopes for x in (y, np.cross(normal, y)))
        values.append(y @ z)
    return np.array(values), None


def kind_of(joint):
    """The class of a joint, and whether it joins two points."""
    return type(joint), len(joint.points) == 2


#: Kinds whose equations are written by hand, between sections where True.
BY_HAND = {
    (kind, False)
    for kind in (
        Clamp,
        Distance,
        RotationDriver,
        TranslationDriver,
        MovingSupport,
        Pin,
        PointOnLine,
    )
}
BY_HAND |= {(kind, True) for kind in (Distance, Pin)}
#: Kinds that test_joint_kinematics compares with the motions that they let through.
BY_MOTIONS = {kind_of(value.values[0].joint) for value in MOTIONS}


def test_what_every_joint_means_is_written_here_or_in_its_motions():
    kinds = {kind_of(joint) for joint in JOINTS.values()}
    assert kinds <= BY_HAND | BY_MOTIONS


@pytest.mark.parametrize("t", [0.0, 1.7])
@pytest.mark.parametrize("name", [x for x in JOINTS if kind_of(JOINTS[x]) in BY_HAND])
def test_equations_are_what_the_joint_says(name, t):
    one = joint_setting(name)
    values, length = equations_by_hand(one, one.q, t)
    Phi = one.system.constraint(t, one.q)
    # Positions and slopes of size one, combined a few times: the round-off of VALUE.
    scale = max(1.0, np.max(np.abs(Phi)))
    assert np.max(np.abs(Phi[: len(values)] - values), initial=0.0) <= VALUE * scale
    if length is None:
        assert len(Phi) == len(values)
    else:
        assert np.linalg.norm(Phi[len(values) :]) == pytest.approx(length, abs=VALUE * scale)
    assert np.max(np.abs(Phi)) > 1e-3  # the state is off the joint, or there is nothing to see


#: Joints that hold what they find in the reference configuration.
AT_HOME = tuple(
    name
    for name, joint in JOINTS.items()
    if not isinstance(joint, Distance)
    and (len(joint.points) == 1 or name.endswith(" nodes"))
    and all(vars(joint).get(place) is None for place in ("ground", "through"))
)


@pytest.mark.parametrize("name", AT_HOME)
def test_reference_configuration_satisfies_a_joint_that_is_given_no_place(name):
    s = joint_setting(name)
    b = s.system.b.copy()
    for i, variable in enumerate(s.system.design_names):
        if variable.endswith((".offset", ".phase")):
            b[i] = 0.0  # laws that start at zero
    system = s.system.with_values(b)
    # Sums of eight products of numbers up to two.
    assert np.max(np.abs(system.constraint(0.0, system.start()[0]))) <= 5e-15


def test_coefficients_are_symmetric_and_of_the_shape_of_the_equations(one):
    d, n = one.scene.dimension, len(one.joint.vectors(one.scene.elements))
    for order in range(4 if isinstance(one.joint, DrivenJoint) else 1):
        c = one.coefficients(0.3, order)
        # Of a cable, which has no section, no right angle is asked.
        cable = one.scene.beams[0].element is CABLE_2D
        rows = one.system.n_lam + (len(one.coefficients(0.3, 0).shapes) if cable else 0)
        assert c.linear.shape == (rows, n, d)
        assert c.bilinear.shape == (rows, n, n)
        assert c.offset.shape == (rows,)
        assert np.array_equal(c.bilinear, c.bilinear.transpose(0, 2, 1))


@pytest.mark.parametrize("name", [x for x, joint in JOINTS.items() if joint.by_slopes])
def test_a_joint_by_slopes_stands_anywhere(name):
    """Joints of one kind share the equations by slopes: positions must not enter them."""
    system, places = joint_setting(name).system, len(JOINTS[name].points)
    item, _ = system.inputs.joint(JOINTS[name])
    moved = item.reference.copy()
    moved[:places] += np.random.default_rng(2).uniform(-3, 3, moved[:places].shape)
    before, after = (JOINTS[name].coefficients(item.p, x) for x in (item.reference, moved))
    for field in ("linear", "bilinear", "offset"):
        assert np.array_equal(getattr(before, field), getattr(after, field))
    assert before.shapes == after.shapes


# ---------------------------------------------------------------- directions


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_directions_across_are_orthonormal_and_across(d, seed):
    direction = np.random.default_rng(seed).uniform(-1, 1, d)
    vectors = np.vstack([unit(direction), across(direction)])
    # A few roundings of numbers below one.
    assert np.max(np.abs(vectors @ vectors.T - np.eye(d))) <= 1e-15 * 4
    assert np.linalg.det(vectors) == pytest.approx(1.0, abs=1e-15 * 8)
    assert vectors[0] @ direction == pytest.approx(np.linalg.norm(direction), rel=1e-15)


def test_directions_across_the_z_axis_are_x_and_y():
    assert np.array_equal(across(np.array([0.0, 0.0, 2.0])), np.eye(3)[:2])


def test_a_section_carries_a_direction_by_a_combination_of_its_own_slopes():
    rng = np.random.default_rng(1)
    slopes = np.eye(3) + 0.2 * rng.uniform(-1, 1, (3, 3))
    direction = rng.uniform(-1, 1, 3)
    reference = np.vstack([rng.uniform(-1, 1, (2, 3)), slopes, rng.uniform(-1, 1, (3, 3))])
    weights = SectionFrame(MaterialPoint("rod", 0.0), reference, 2).carried(direction)
    assert_close(weights @ reference, direction, 1e-15 * 10)
    assert not np.any(weights[[0, 1, 5, 6, 7]])


# ---------------------------------------------------------------- simulations

SOFT = Material(density=1000.0, youngs_modulus=1e7, poisson_ratio=0.3)
BAR = Rectangle(height=0.06, width=0.04)
# Constraints are solved at every step, and a last correction of 1e-13 of the acceleration moves
# q by h^2 times that; what is left is the round-off of coordinates and of the linear algebra:
# 100 eps of lengths of 1 m, 450 eps allowed.
HOLDS = 1e-13


def simulated(scene, t_end=0.5):
    """Solution of a run that ended well, with Phi at round-off all along."""
    solution = simulate(scene, t_end, HHT(step=2**-7))
    assert solution.outcome.success
    system = assemble(scene)
    Phi = [system.constraint(t, q) for q, t in zip(solution.q, solution.t, strict=True)]
    assert np.max(np.abs(Phi)) <= HOLDS
    # Something moves, or nothing would be shown.
    assert np.max(np.abs(solution.q - solution.q[0])) > 0.1
    return solution


def section_of(solution, point):
    """Slope vectors of a point as columns, shape (n_t, 3, 3)."""
    slopes = [solution.slope(point, k) for k in range(3)]
    return np.stack(slopes, axis=-1)


def carried(solution, beam, point, direction):
    """A direction of the reference configuration, carried along by the section, at all instants."""
    return section_of(solution, point) @ np.linalg.inv(reference_frame(beam)) @ direction


def angles(one, other):
    """Angles between vectors at all instants."""
    sines = np.linalg.norm(np.cross(one, other), axis=1)
    return sines / np.linalg.norm(one, axis=1) / np.linalg.norm(other, axis=1)


# A hinge on another section is exact up to products of strains: of these beams below 3e-4,
# ten times those of rho g L^2 / (E h) in rest.
STIFF = Material(density=1000.0, youngs_modulus=1e9, poisson_ratio=0.3)
STRAINS = 1e-7


def test_revolute_keeps_the_point_and_the_axis():
    rod = Beam("rod", (0.0, 0.0, 0.0), (0.8, 0.3, 0.2), 2, BAR, SOFT)
    axis, hinge = unit(np.array([0.3, -0.8, 0.0])), rod.at(0.1, y=0.01)
    scene = Scene([rod], [Revolute(hinge, axis)], gravity=(2.0, -1.0, -9.81))
    solution = simulated(scene)
    place = solution.position(MaterialPoint("rod", 0.1, y=0.01))
    assert np.max(np.abs(place - place[0])) <= HOLDS
    moved = carried(solution, rod, hinge, axis)
    # The axis lies in the section, which keeps it and nothing but its length.
    assert np.max(angles(moved, axis[None])) <= 10 * HOLDS
    assert np.max(np.abs(moved @ axis - 1)) > 1e-6
    # And the section does turn about it.
    across_it = carried(solution, rod, hinge, np.cross(axis, unit(np.array([0.8, 0.3, 0.2]))))
    assert np.min(angles(across_it, across_it[:1])[1:]) < 0.1
    assert np.max(angles(across_it, across_it[:1])) > 0.9


def test_revolute_between_beams_keeps_the_axis_of_the_other_beam():
    rod = Beam("rod", (0.0, 0.0, 0.0), (0.5, 0.1, 0.0), 1, BAR, STIFF)
    arm = Beam("arm", (0.5, 0.1, 0.0), (0.8, 0.5, 0.3), 1, BAR, STIFF)
    axis = unit(np.cross([0.5, 0.1, 0.0], [0.3, 0.4, 0.3]))  # in both sections
    bearing = Revolute(rod.at_start, (0.0, 1.0, 0.3))
    joints = [bearing, Revolute(arm.at_start, axis, rod.at_end)]
    solution = simulated(Scene([rod, arm], joints, gravity=(2.0, -9.81, 3.0)))
    apart = solution.position(MaterialPoint("arm", 0.0)) - solution.position(
        MaterialPoint("rod", 1.0)
    )
    assert np.max(np.abs(apart)) <= HOLDS
    own = carried(solution, arm, arm.at_start, axis)
    there = carried(solution, rod, rod.at_end, axis)
    assert np.max(angles(own, there)) <= STRAINS
    assert np.max(np.abs(there - axis)) > 0.1  # the axis turns along with the other beam
    normals = [
        carried(solution, beam, point, np.array([0.3, 0.4, 0.3]))
        for beam, point in ((rod, rod.at_end), (arm, arm.at_start))
    ]
    assert np.max(angles(*normals)) > 0.3  # and the sections turn about it


@pytest.mark.parametrize("between", [False, True], ids=["ground", "beams"])
def test_cylindrical_joint_lets_a_section_turn_about_and_slide_along_its_axis(between):
    end, way = np.array([0.5, 0.1, 0.0]), np.array([0.3, 0.4, 0.3])
    axis = unit(np.cross(end, way))  # in both sections
    rod = Beam("rod", (0.0, 0.0, 0.0), tuple(end), 1, BAR, STIFF)
    # Somewhere else on the axis, by a point inside.
    first = end + 0.1 * axis - 0.2 * way
    arm = Beam("arm", tuple(first), tuple(first + way), 1, BAR, STIFF)
    gravity = tuple(-3.0 * axis + 5.0 * across(axis)[0])
    if between:
        held = [Revolute(rod.at_start, (0.0, 1.0, 0.3)), Cylindrical(arm.at(0.2), axis, rod.at_end)]
        scene = Scene([rod, arm], held, gravity)
    else:
        scene = Scene([arm], [Cylindrical(arm.at(0.2), axis)], gravity)
    solution = simulated(scene)
    moved = carried(solution, arm, arm.at(0.2), axis)
    there, apart = np.broadcast_to(axis, moved.shape), solution.position(MaterialPoint("arm", 0.2))
    if between:
        there = carried(solution, rod, rod.at_end, axis)
        apart = apart - solution.position(MaterialPoint("rod", 1.0))
    else:
        apart = apart - apart[0]
    assert np.max(angles(moved, there)) <= (STRAINS if between else 10 * HOLDS)
    travel = np.sum(apart * there, axis=1)
    off = np.linalg.norm(np.cross(apart, there), axis=1)
    # What is across the axis in a section that contracts more one way than the other stands off by
    # that strain: of the travel, 0.1 m.
    assert np.max(off) <= (np.sqrt(STRAINS) * 0.1 if between else 10 * HOLDS)
    assert np.max(np.abs(travel - travel[0])) > 0.05  # it slides
    normal = carried(solution, arm, arm.at(0.2), way)
    assert np.max(angles(normal, normal[:1])) > 0.3  # and turns


def reference_frame(beam):
    """Slopes of a straight beam in its reference configuration, as columns."""
    return beam.reference().slopes[0].T


def test_point_on_line_stays_on_the_line():
    rod = Beam("rod", (0.0, 0.0, 0.0), (0.8, 0.3, 0.2), 2, BAR, SOFT)
    direction = np.array([1.0, -0.4, -0.5])
    joints = [PointOnLine(rod.at(0.2, z=0.01), direction)]
    solution = simulated(Scene([rod], joints, gravity=(2.0, -1.0, -9.81)))
    travel = solution.position(MaterialPoint("rod", 0.2, y=0.0, z=0.01))
    travel = travel - travel[0]
    assert np.max(np.abs(np.cross(travel, unit(direction)))) <= 10 * HOLDS
    assert np.max(np.abs(travel @ unit(direction))) > 0.1


def rod_point(fraction, y):
    """Place of a point of a straight rod from the origin to (0.6, 0.3)."""
    return fraction * np.array([0.6, 0.3]) + y * np.array([-0.3, 0.6]) / np.hypot(0.3, 0.6)


def test_distance_keeps_the_distance_to_ground_and_between_beams():
    rod = Beam("rod", (0.0, 0.0), (0.6, 0.3), 2, BAR, SOFT)
    arm = Beam("arm", (0.0, 0.5), (0.6, 0.9), 1, BAR, SOFT)
    ground = np.array([-0.3, 0.4])
    link = float(np.hypot(*(rod_point(0.7, 0.02) - [0.3, 0.7])))
    joints = [
        Distance(rod.at_start, 0.5, ground=ground, name="stay"),
        Distance(rod.at(0.7, y=0.02), link, arm.at(0.5), name="link"),
        Pin(arm.at_start),
    ]
    solution = simulated(Scene([rod, arm], joints, gravity=(0.0, -9.81)))
    stay = np.linalg.norm(solution.position(MaterialPoint("rod", 0.0)) - ground, axis=1)
    apart = solution.position(MaterialPoint("rod", 0.7, y=0.02)) - solution.position(
        MaterialPoint("arm", 0.5)
    )
    assert np.max(np.abs(stay - 0.5)) <= 10 * HOLDS
    assert np.max(np.abs(np.linalg.norm(apart, axis=1) - link)) <= 10 * HOLDS


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_drive_turns_the_section_by_its_law_over_full_turns(d, sense):
    z = (0.0,) * (d - 2)
    crank = Beam("crank", (0.0, 0.0, *z), (0.4, 0.3, *z), 1, BAR, SOFT)
    speed, grow = sense * 10.0, sense * 4.0
    spin = speed if d == 2 else (0.0, 0.0, speed)
    bearing = Pin(crank.at_start) if d == 2 else Revolute(crank.at_start, (0, 0, 1))
    motor = RotationDriver(crank.at(0.1), ConstantAcceleration(speed, acceleration=grow))
    start = [InitialVelocity("crank", spin, (0.0, 0.0, *z))]
    solution = simulated(Scene([crank], [bearing, motor], start=start), 1.25)
    height = solution.slope(MaterialPoint("crank", 0.1), 1)
    angle = np.unwrap(np.arctan2(height[:, 1], height[:, 0]))
    turned, t = angle - angle[0], solution.t
    assert np.max(np.abs(turned - (speed * t + grow * t**2 / 2))) <= 100 * HOLDS
    assert abs(turned[-1]) > 4 * np.pi


def test_guide_moves_the_point_by_its_law():
    rod = Beam("rod", (0.0, 0.0), (0.8, 0.3), 2, BAR, SOFT)
    direction, law = np.array([2.0, 1.0]), Harmonic(0.2, 6.0)
    guide = TranslationDriver(rod.at(0.2, y=0.01), direction, law)
    start = [InitialVelocity("rod", 0.0, (0.0, 0.0), velocity=1.2 * unit(direction))]
    solution = simulated(Scene([rod], [guide], gravity=(0.0, -9.81), start=start))
    place = solution.position(MaterialPoint("rod", 0.2, y=0.01))
    travel = (place - place[0]) @ unit(direction)
    assert np.max(np.abs(travel - 0.2 * np.sin(6.0 * solution.t))) <= 10 * HOLDS
    assert np.max(np.abs(travel)) > 0.15


def test_spatial_pendulum_on_a_hinge_is_the_planar_one_on_a_pin():
    # At nu = 0 the motion in the plane has no stress across it, and the elements are the same.
    plain = Material(density=1000.0, youngs_modulus=1e7, poisson_ratio=0.0)
    runs = {}
    for d in (2, 3):
        z = (0.0,) * (d - 2)
        energy = SaintVenantKirchhoff()
        rod = Beam("rod", (0.0, 0.0, *z), (0.8, 0.3, *z), 2, BAR, plain, energy=energy)
        joint = Pin(rod.at_start) if d == 2 else Revolute(rod.at_start, (0.0, 0.0, 1.0))
        runs[d] = simulated(Scene([rod], [joint], gravity=(0.0, -9.81, *z)))
    planar, spatial = (runs[d].nodes("rod") for d in (2, 3))
    assert np.max(np.abs(spatial[:, :, :3, 2])) <= HOLDS
    assert np.max(np.abs(spatial[:, :, 3] - [0.0, 0.0, 1.0])) <= HOLDS
    # Round-off of 64 steps of a motion with stiff vibrations: the force is right to
    # eps E h w = 5e-12 N of 20 N weight, and is integrated twice over half a second.
    assert np.max(np.abs(spatial[:, :, :3, :2] - planar)) <= 1e-11
    hinge, pin = (run.reaction(run.naming.layout.joints[0].name) for run in (runs[3], runs[2]))
    assert_close(hinge[:, :2], pin, 1e-9)


@pytest.mark.parametrize(
    "joint", [given(Revolute, axis=(0.0, 1.0)), given(Universal, axis=(1, 0), cross=(0, 1))]
)
def test_spatial_joints_are_refused_in_the_plane(joint):
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, BAR, SOFT)
    with pytest.raises(InvalidInputError, match="needs a scene in space"):
        Scene([rod], [joint(rod.at_start)])


def test_a_universal_joint_with_parallel_axes_is_refused():
    rod = Beam("rod", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1, BAR, SOFT)
    for cross in ((0.0, 0.0, 2.0), (0.0, 1e-7, -1.0)):
        with pytest.raises(InvalidInputError, match="must not be parallel"):
            Universal(rod.at_start, (0.0, 0.0, 1.0), cross)
    Universal(rod.at_start, (0.0, 0.0, 1.0), (0.0, 1e-5, 1.0))


def test_points_take_part_by_position_or_slope_as_each_joint_says():
    # The vectors that enter are those of the joint's own points.
    for name, joint in JOINTS.items():
        element = MEMBERS[name.split()[0]][0].element
        vectors = joint.vectors(Elements(element.d, dict.fromkeys(("rod", "arm"), element)))
        taken = {
            (x.point, element.quantities[1]) if isinstance(x, Normal) else (x[0], x[1])
            for x in vectors
        }
        assert {point for point, _ in taken} == set(joint.points)
        assert {quantity for _, quantity in taken} <= set(element.quantities)


def test_a_clamp_of_oblique_slopes_feels_turns_and_shear_but_no_stretch_of_the_section():
    slopes = np.array([[0.3, 1.2, 0.2], [0.1, -0.4, 0.9]])
    linear = (
        Clamp(MaterialPoint("rod", 0.0))
        .coefficients(np.zeros(0), np.vstack([[0.0, 0.0, 0.0], slopes]))
        .linear[:, 1:]
    )
    normal = np.cross(*slopes)
    normal /= np.linalg.norm(normal)
    y = slopes[0] / np.linalg.norm(slopes[0])
    z = np.cross(normal, y)

    def felt(gradient):
        return np.einsum("rki,ij,kj->r", linear, gradient, slopes)[3:]

    turn, shear = (np.outer(z, y) + sign * np.outer(y, z) for sign in (-1, 1))
    np.testing.assert_allclose(felt(turn), [0, 0, 1, -1], atol=1e-14)
    np.testing.assert_allclose(felt(shear), [0, 0, 1, 1], atol=1e-14)
    for stretch in (np.outer(y, y), np.outer(z, z)):
        np.testing.assert_allclose(felt(stretch), 0, atol=1e-14)
    tilt = np.outer(normal, y)
    np.testing.assert_allclose(felt(tilt), [slopes[0] @ y, slopes[1] @ y, 0, 0], atol=1e-14)
