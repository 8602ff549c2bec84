"""Joints: equations by hand, partials by complex step, rates along a curve.

Every joint stands alone in a scene, at nodes and between them, to ground and between beams. Its
equations are compared with their geometric meaning, every derivative of the protocol with a
complex step (tolerances: `setting`), and the right sides of the velocity, acceleration and
jerk equations with the derivatives of Phi along a smooth curve q(t). Simulations show that the
joints hold what they should.
"""

import functools
from dataclasses import fields
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
    PlanarJoint,
    PointOnLine,
    Prismatic,
    Revolute,
    RotationDriver,
    SaintVenantKirchhoff,
    Scene,
    Spherical,
    TranslationDriver,
    Universal,
    Weld,
    assemble,
    simulate,
)
from ancfdae.assembly.part_inputs import Rigidity
from ancfdae.errors import InvalidInputError
from ancfdae.extend import Law, MaterialPoint
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.model import joints
from ancfdae.model.joints.frames import SectionFrame, across, unit
from ancfdae.model.joints.joint import DrivenJoint, Joint
from ancfdae.model.parts import Elements, Normal
from ancfdae.sections import Rectangle
from tests.support.by_hand import turns_by_hand, vector_by_hand
from tests.support.curves import CURVE, rates_of
from tests.support.examples import all_examples, coefficients_of, public_classes
from tests.support.joint_motions import MOTIONS
from tests.support.members import (
    acceleration_side,
    acceleration_side_total,
    constraint_b,
    constraint_force,
    constraint_force_b,
    constraint_force_q,
    constraint_force_rate,
    constraint_force_rate_total,
    constraint_q_times_total,
    jerk_side,
    jerk_side_total,
    velocity_side,
    velocity_side_total,
)
from tests.support.scenes import FLAT, STEEL, THICK, arc
from tests.support.setting import (
    DERIVATIVE,
    VALUE,
    MeasuredSetting,
    assert_close,
    concrete_subclasses,
)

# ---------------------------------------------------------------- variants

UNIFORM = ConstantAcceleration(speed=2.0, offset=0.3, acceleration=1.5)
HARMONIC = Harmonic(amplitude=0.4, frequency=3.0, phase=0.2, offset=0.1)


def beams(d):
    """A rod of two elements, an arm and a curved beam, all oblique."""
    z = (0.2,) * (d - 2)
    rod = Beam("rod", (0.1, 0.2, *z), (0.9, 0.7, *z), 2, FLAT, STEEL)
    arm = Beam("arm", (0.9, 0.7, *z), (1.5, 0.4, *(3 * x for x in z)), 1, THICK, STEEL)
    bow = arc("bow", (0.9, 1.7, *z), 1.0, (0.0, 0.6), d, pitch=0.3 if d == 3 else 0.0)
    return rod, arm, bow


def cables():
    """A rod and an arm of cable elements."""
    rod = Beam("rod", (0.1, 0.2), (0.9, 0.7), 2, FLAT, STEEL, element=CABLE_2D)
    return rod, Beam("arm", (0.9, 0.7), (1.5, 0.4), 1, FLAT, STEEL, element=CABLE_2D)


def planar_joints():
    rod, arm, _ = beams(2)
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


def spatial_joints():
    rod, arm, _ = beams(3)
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


VARIANTS = {f"planar {name}": joint for name, joint in planar_joints().items()}
VARIANTS |= {f"spatial {name}": joint for name, joint in spatial_joints().items()}
ELEMENT_BEAMS = {"planar": beams(2), "spatial": beams(3), "cable": cables()}
for SPACE, BEAMS in ELEMENT_BEAMS.items():
    OFF = 0.0 if SPACE == "cable" else 0.01
    FOUND = all_examples(
        joints, Joint, BEAMS, (BEAMS[-1].at(0.4, y=2 * OFF), BEAMS[0].at(0.8, y=-OFF))
    )
    VARIANTS |= {f"{SPACE} {name}": joint for name, joint in FOUND.items()}


def named_by_hand(system, q, name):
    """A vector that a joint names; of a cable the normal is its tangent, turned."""
    if isinstance(name, Normal):
        x, y = vector_by_hand(system, q, name.point, 1)
        return np.array([-y, x])
    return vector_by_hand(system, q, name[0], int(name[1]))


class JointSetting(MeasuredSetting):
    """One joint alone; the design is everything that its equations can depend on."""

    def __init__(self, name):
        self.joint = VARIANTS[name]
        self.own = [f"{self.joint.name}.{parameter}" for parameter in self.joint.parameters()]
        touched = dict.fromkeys(point.beam for point in self.joint.points)
        chosen = [beam for beam in ELEMENT_BEAMS[name.split()[0]] if beam.name in touched]
        design = [*self.own, *(f"{name}.length" for name in touched)]
        super().__init__(Scene(chosen, [self.joint]), design)
        rng = np.random.default_rng(4)
        self.jerk = rng.uniform(-1, 1, self.system.n_q)
        self.lam_b = rng.uniform(-1, 1, (self.system.n_lam, self.system.n_b))
        self.lam_b /= [self.unit(i) for i in range(self.system.n_b)]
        self.bilinear = bool(np.any(self.coefficients(0.0, 0).bilinear))
        self.steady = not (self.bilinear or isinstance(self.joint, DrivenJoint))

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

    def along(self, e, i):
        """States moved along their design derivatives."""
        states = ((self.q, self.q_b), (self.v, self.v_b), (self.a, self.a_b))
        return tuple(x + e * x_b[:, i] for x, x_b in states)

    def size(self, value):
        """Scale where an exact derivative vanishes: the quantity, or 1 m and 1 rad."""
        return max(1.0, np.max(np.abs(value), initial=0.0))


setting_of = functools.cache(JointSetting)


@pytest.fixture(scope="module", params=VARIANTS)
def one(request):
    return setting_of(request.param)


def test_every_public_joint_has_examples_in_each_dimension_it_works_in():
    kinds = set(public_classes(joints, Joint).values())
    # The assembler has one more, of rigid bodies.
    assert kinds == concrete_subclasses(Joint) - {Rigidity}
    for space in ("planar", "spatial"):
        here = {type(joint) for name, joint in VARIANTS.items() if name.startswith(space)}
        assert here == {kind for kind in kinds if space == "spatial" or not kind.spatial}
    # Every field of every joint is given in one of them.
    for kind in kinds:
        given = [vars(joint) for joint in VARIANTS.values() if type(joint) is kind]
        for field in fields(kind):
            assert any(values[field.name] is not None for values in given), (kind, field.name)


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
    kinds = {kind_of(joint) for joint in VARIANTS.values()}
    assert kinds <= BY_HAND | BY_MOTIONS


@pytest.mark.parametrize("t", [0.0, 1.7])
@pytest.mark.parametrize("name", [x for x in VARIANTS if kind_of(VARIANTS[x]) in BY_HAND])
def test_equations_are_what_the_joint_says(name, t):
    one = setting_of(name)
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
    for name, joint in VARIANTS.items()
    if not isinstance(joint, Distance)
    and (len(joint.points) == 1 or name.endswith(" nodes"))
    and all(vars(joint).get(place) is None for place in ("ground", "through"))
)


@pytest.mark.parametrize("name", AT_HOME)
def test_reference_configuration_satisfies_a_joint_that_is_given_no_place(name):
    s = setting_of(name)
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


@pytest.mark.parametrize("name", [x for x, joint in VARIANTS.items() if joint.by_slopes])
def test_a_joint_by_slopes_stands_anywhere(name):
    """Joints of one kind share the equations by slopes: positions must not enter them."""
    system, places = setting_of(name).system, len(VARIANTS[name].points)
    item, _ = system.inputs.joint(VARIANTS[name])
    moved = item.reference.copy()
    moved[:places] += np.random.default_rng(2).uniform(-3, 3, moved[:places].shape)
    before, after = (VARIANTS[name].coefficients(item.p, x) for x in (item.reference, moved))
    for field in ("linear", "bilinear", "offset"):
        assert np.array_equal(getattr(before, field), getattr(after, field))
    assert before.shapes == after.shapes


# ---------------------------------------------------------------- partials by complex step


def test_constraint_q_is_the_complex_step_of_constraint(one):
    expected = one.by_coordinate(lambda q: one.system.constraint(one.t, q))
    B = one.system.constraint_pattern.dense(one.system.constraint_q(one.t, one.q))
    assert_close(B, expected, DERIVATIVE)
    assert_close(constraint_force(one.system, one.t, one.q, one.lam), B.T @ one.lam, VALUE)


def test_curvature_is_the_complex_step_of_the_constraint_force(one):
    system = one.system
    expected = one.by_coordinate(lambda q: constraint_force(system, one.t, q, one.lam))
    values = system.pattern.dense(constraint_force_q(system, one.t, one.q, one.lam))
    if system.traits.linear_constraints:
        assert not np.any(expected)
        assert not np.any(values)
        return
    assert_close(values, expected, DERIVATIVE)
    assert_close(values, values.T, VALUE)


def test_only_bilinear_joints_have_curvature_and_only_driven_ones_move(one):
    system, joint = one.system, one.joint
    driven = isinstance(joint, DrivenJoint)
    assert system.traits.linear_constraints == (not one.bilinear)
    assert driven == any(isinstance(value, Law) for value in vars(joint).values())
    assert np.any(velocity_side(system, one.t, one.q)) == driven
    assert np.any(acceleration_side(system, one.t, one.q, one.v)) == (not one.steady)
    still = np.array_equal(system.constraint(0.1, one.q), system.constraint(0.9, one.q))
    assert still == (not driven)


def test_constraint_b_is_the_complex_step_of_constraint(one):
    partial = constraint_b(one.system, one.t, one.q)
    one.check_design(partial, lambda x, i, e: x.constraint(one.t, one.q), 1.0)


def test_constraint_force_b_is_the_complex_step_of_the_constraint_force(one):
    force = constraint_force(one.system, one.t, one.q, one.lam)
    partial = constraint_force_b(one.system, one.t, one.q, one.lam)
    one.check_design(
        partial, lambda x, i, e: constraint_force(x, one.t, one.q, one.lam), one.size(force)
    )


def test_constraint_q_times_total_is_the_complex_step_of_the_product(one):
    partial = constraint_q_times_total(one.system, one.t, one.q, one.a, one.q_b)

    def product(x, i, e):
        return x.constraint_pattern.dot(x.constraint_q(one.t, one.along(e, i)[0]), one.a)

    one.check_design(partial, product, one.size(partial))


def test_velocity_side_total_is_the_complex_step_of_velocity_side(one):
    value = velocity_side(one.system, one.t, one.q)
    total = velocity_side_total(one.system, one.t, one.q, one.q_b)
    one.check_design(
        total, lambda x, i, e: velocity_side(x, one.t, one.along(e, i)[0]), one.size(value)
    )


def test_acceleration_side_total_is_the_complex_step_of_acceleration_side(one):
    value = acceleration_side(one.system, one.t, one.q, one.v)
    total = acceleration_side_total(one.system, one.t, one.q, one.v, one.q_b, one.v_b)
    one.check_design(
        total, lambda x, i, e: acceleration_side(x, one.t, *one.along(e, i)[:2]), one.size(value)
    )


def test_jerk_side_total_is_the_complex_step_of_jerk_side(one):
    value = jerk_side(one.system, one.t, one.q, one.v, one.a)
    states_b = (one.q_b, one.v_b, one.a_b)
    total = jerk_side_total(one.system, one.t, one.q, one.v, one.a, *states_b)
    one.check_design(total, lambda x, i, e: jerk_side(x, one.t, *one.along(e, i)), one.size(value))


def test_constraint_force_rate_total_is_the_complex_step_of_constraint_force_rate(one):
    value = constraint_force_rate(one.system, one.t, one.q, one.v, one.lam)
    total = constraint_force_rate_total(
        one.system, one.t, one.q, one.v, one.lam, one.q_b, one.v_b, one.lam_b
    )

    def rate(x, i, e):
        q, v, _ = one.along(e, i)
        return constraint_force_rate(x, one.t, q, v, one.lam + e * one.lam_b[:, i])

    one.check_design(total, rate, one.size(value))


def is_length_of_direction(joint, name):
    """Whether the parameter is the only nonzero component of a direction."""
    vector, _, axis = name.rpartition(".")[2].rpartition("_")
    if vector not in ("axis", "direction"):
        return False
    components = np.array(getattr(joint, vector))
    return np.count_nonzero(components) == 1 and components["xyz".index(axis)] != 0


def test_every_parameter_of_a_joint_moves_its_equations(one):
    # Without this the comparisons above could be of zero with zero.
    partial = constraint_b(one.system, one.t, one.q)
    for name in one.own:
        column = partial[:, one.system.design_names.index(name)]
        # Derivatives in the mere length of a direction vanish to round-off.
        assert (np.max(np.abs(column)) > 1e-6) != is_length_of_direction(one.joint, name), name


# ---------------------------------------------------------------- rates along a curve


def test_rates_of_the_equations_along_a_curve_are_those_of_the_right_sides(one):
    s, x = one, one.system
    rates = rates_of(lambda t: x.constraint(t, s.curve(t)[0]), s.t)
    B = x.constraint_pattern.dense(x.constraint_q(s.t, s.q))
    expected = (
        x.constraint(s.t, s.q),
        B @ s.v - velocity_side(x, s.t, s.q),
        B @ s.a - acceleration_side(x, s.t, s.q, s.v),
        B @ s.jerk - jerk_side(x, s.t, s.q, s.v, s.a),
    )
    for rate, value in zip(rates, expected, strict=True):
        assert np.max(np.abs(rate - value)) <= CURVE * s.size(value)
        assert np.max(np.abs(value)) > 1e-3


def test_velocity_side_is_minus_the_time_derivative_with_the_coordinates_held(one):
    rates = rates_of(lambda t: one.system.constraint(t, one.q), one.t)
    side = velocity_side(one.system, one.t, one.q)
    assert np.max(np.abs(side + rates[1])) <= CURVE * one.size(side)


def test_constraint_force_rate_is_the_derivative_along_a_curve_with_multipliers_held(one):
    s, x = one, one.system
    expected = rates_of(lambda t: constraint_force(x, t, s.curve(t)[0], s.lam), s.t)[1]
    rate = constraint_force_rate(x, s.t, s.q, s.v, s.lam)
    assert np.max(np.abs(rate - expected)) <= CURVE * one.size(expected)
    # Where nothing moves Phi_q nothing is left of it: a guide is driven by its offset alone.
    assert np.any(rate) == (np.max(np.abs(expected)) > CURVE)


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
    for name, joint in VARIANTS.items():
        element = ELEMENT_BEAMS[name.split()[0]][0].element
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
