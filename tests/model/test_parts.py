"""Every joint and load, alone in the plane, in space and on cables, keeps what it promises.

The rows are the parts (`tests.support.parts`), the columns the promises below. Rates in time are
compared with an interpolated curve. Every derivative of the protocol is compared with a complex
step of the values (tolerances: `setting`), along one random direction of the coordinates or of the
design: a wrong entry changes the derivative along it. Zeros that are declared are looked at entry
by entry. What the values mean is in `test_joints`, `test_joint_kinematics` and `test_loads`.
"""

from dataclasses import fields

import numpy as np
import pytest

from ancfdae import Bushing, Rope, SlidingFriction, SlidingJoint
from ancfdae.assembly.geometry import Rigidity
from ancfdae.extend import Law
from ancfdae.model import joints, loads
from ancfdae.model.joints.joint import DrivenJoint, Joint
from ancfdae.model.loads.contact import ContactLoad
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.pair_contact import PairContact
from tests.support.curves import CURVE, rates_of
from tests.support.examples import public_classes
from tests.support.members import (
    acceleration_side,
    constraint_force,
    constraint_force_b,
    constraint_force_q,
    constraint_force_rate,
    constraint_force_rate_total,
    force_b,
    force_q,
    force_rate,
    force_rate_total,
    force_v,
    jerk_side,
    velocity_side,
)
from tests.support.parts import JOINTS, LOADS, joint_setting, load_setting
from tests.support.setting import DERIVATIVE, STEP, VALUE, assert_close, concrete_subclasses

every_joint = pytest.mark.parametrize("name", JOINTS)
every_load = pytest.mark.parametrize("name", LOADS)


@pytest.mark.parametrize(
    ("module", "base", "parts", "inner"),
    # The assembler has one more joint, of rigid bodies.
    [(joints, Joint, JOINTS, {Rigidity}), (loads, Load, LOADS, set())],
)
def test_every_public_part_has_examples_in_each_dimension_it_works_in(module, base, parts, inner):
    kinds = set(public_classes(module, base).values())
    assert kinds == concrete_subclasses(base) - inner
    # Loads between bodies that touch: tests/physics/test_pair_contact.py.
    kinds -= concrete_subclasses(PairContact)
    # tests/model/test_sliding.py and test_rope.py.
    kinds -= {SlidingJoint, SlidingFriction, Rope}
    for space in ("planar", "spatial"):
        here = {type(part) for name, part in parts.items() if name.startswith(space)}
        assert here == {kind for kind in kinds if space == "spatial" or not kind.spatial}
    # Every field of every joint is given in one of them; a law goes with few loads.
    for kind in kinds if base is Joint else ():
        given = [vars(part) for part in parts.values() if type(part) is kind]
        for field in fields(kind):
            assert any(values[field.name] is not None for values in given), (kind, field.name)


# ---------------------------------------------------------------- joints


@every_joint
def test_rates_of_a_joint_are_those_along_a_curve(name):
    s = joint_setting(name)
    x = s.system
    B = x.constraint_pattern.dense(x.constraint_q(s.t, s.q))
    sides = (
        velocity_side(x, s.t, s.q),
        acceleration_side(x, s.t, s.q, s.v),
        jerk_side(x, s.t, s.q, s.v, s.a),
    )
    rates = rates_of(lambda t: x.constraint(t, s.curve(t)[0]), s.t)
    motions = (s.v, s.a, s.jerk)
    expected = (x.constraint(s.t, s.q), *(B @ y - g for y, g in zip(motions, sides, strict=True)))
    for rate, value in zip(rates, expected, strict=True):
        assert np.max(np.abs(rate - value)) <= CURVE * s.size(value)
        assert np.max(np.abs(value)) > 1e-3
    held = rates_of(lambda t: x.constraint(t, s.q), s.t)[1]
    assert np.max(np.abs(sides[0] + held)) <= CURVE * s.size(sides[0])
    # The force, with multipliers held.
    moving = rates_of(lambda t: constraint_force(x, t, s.curve(t)[0], s.lam), s.t)[1]
    rate = constraint_force_rate(x, s.t, s.q, s.v, s.lam)
    assert np.max(np.abs(rate - moving)) <= CURVE * s.size(moving)
    # Where nothing moves Phi_q nothing is left of it: a guide is driven by its offset alone.
    assert np.any(rate) == (np.max(np.abs(moving)) > CURVE)


@every_joint
def test_partials_of_a_joint_are_complex_steps_of_its_equations(name):
    s = joint_setting(name)
    x, motion, along = s.system, (s.q, s.v, s.a, s.jerk), (*s.along, 0 * s.jerk)
    B = x.constraint_pattern.dense(x.constraint_q(s.t, s.q))
    moved = x.constraint(s.t, s.q + 1j * STEP * s.jerk)
    assert_close(B @ s.jerk, moved.imag / STEP, DERIVATIVE)
    held = x.constraint_total(s.t, (s.q,))
    s.check_design(held, lambda x, e: x.constraint(s.t, s.q), 1.0)
    # Phi and its first three time derivatives.
    motion_b = (s.q_b, s.v_b, s.a_b, 0 * s.a_b)
    for n in range(1, 5):
        total = x.constraint_total(s.t, motion[:n], motion_b[:n])

        def value(x, e, n=n):
            states = zip(motion[:n], along[:n], strict=True)
            return x.constraint(s.t, *(y + e * y_e for y, y_e in states))

        s.check_design(total, value, s.size(x.constraint(s.t, *motion[:n])))
    for parameter in s.own:
        column = held[:, x.design_names.index(parameter)]
        # Without this the comparison above could be of zero with zero. Derivatives in the mere
        # length of a direction vanish to round-off.
        assert (np.max(np.abs(column)) > 1e-6) != is_length_of_direction(s.joint, parameter)


def is_length_of_direction(joint, name):
    """Whether the parameter is the only nonzero component of a direction."""
    vector, _, axis = name.rpartition(".")[2].rpartition("_")
    if vector not in ("axis", "direction"):
        return False
    components = np.array(getattr(joint, vector))
    return np.count_nonzero(components) == 1 and components["xyz".index(axis)] != 0


@every_joint
def test_partials_of_a_joint_are_complex_steps_of_its_force(name):
    s = joint_setting(name)
    x, (q_e, v_e, _) = s.system, s.along
    force = constraint_force(x, s.t, s.q, s.lam)
    assert_close(force, x.constraint_pattern.dense(x.constraint_q(s.t, s.q)).T @ s.lam, VALUE)
    bent = x.pattern.dense(constraint_force_q(x, s.t, s.q, s.lam))
    moved = constraint_force(x, s.t, s.q + 1j * STEP * s.jerk, s.lam).imag / STEP
    assert x.traits.linear_constraints == (not np.any(bent)) == (not np.any(moved))
    if np.any(bent):
        assert_close(bent @ s.jerk, moved, DERIVATIVE)
        assert_close(bent, bent.T, VALUE)
    held = constraint_force_b(x, s.t, s.q, s.lam)
    s.check_design(held, lambda x, e: constraint_force(x, s.t, s.q, s.lam), s.size(force))
    lam_b = np.outer(s.lam_along, np.ones(x.n_b)) / s.units
    total = constraint_force_rate_total(x, s.t, s.q, s.v, s.lam, s.q_b, s.v_b, lam_b)

    def rate(x, e):
        lam = s.lam + e * (lam_b @ s.b_along)
        return constraint_force_rate(x, s.t, s.q + e * q_e, s.v + e * v_e, lam)

    s.check_design(total, rate, s.size(rate(x, 0.0)))


@every_joint
def test_only_products_and_formulas_have_curvature_and_only_driven_ones_move(name):
    s = joint_setting(name)
    driven = isinstance(s.joint, DrivenJoint)
    assert s.system.traits.linear_constraints == (not s.curved)
    assert driven == any(isinstance(value, Law) for value in vars(s.joint).values())
    assert np.any(velocity_side(s.system, s.t, s.q)) == driven
    assert np.any(acceleration_side(s.system, s.t, s.q, s.v)) == (not s.steady)
    still = np.array_equal(s.system.constraint(0.1, s.q), s.system.constraint(0.9, s.q))
    assert still == (not driven)


# ---------------------------------------------------------------- loads


@every_load
def test_tangents_of_a_load_are_complex_steps_of_its_force(name):
    s = load_setting(name)
    x, e = s.system, 1j * STEP
    y, z = np.random.default_rng(7).uniform(-1, 1, (2, x.n_q))
    tangents = x.pattern.dense(force_q(x, s.t, s.q, s.v)) - s.without(
        lambda bare, *states: bare.pattern.dense(force_q(bare, *states)), s.t, s.q, s.v
    )
    Q_v = x.pattern.dense(force_v(x, s.t, s.q, s.v))
    still = s.load.constant or not np.any(moved := s.added(s.q + e * y).imag)
    damped = s.load.uses_velocity(())
    assert np.any(tangents) == (not still)
    assert np.any(Q_v) == np.any(s.added(v=s.v + e * z).imag) == damped
    if not still:
        assert_close(tangents @ y, moved / STEP, DERIVATIVE)
    if damped:
        assert_close(Q_v @ z, s.added(v=s.v + e * z).imag / STEP, DERIVATIVE)
    # Friction of contact follows the normal force, but not the other way round.
    if damped and not s.load.states and not isinstance(s.load, ContactLoad):
        # A damper is symmetric, and takes energy out where its numbers are positive.
        assert_close(Q_v, Q_v.T, VALUE)
        assert isinstance(s.load, Bushing) or s.v @ Q_v @ s.v < 0
    rate = force_rate(x, s.t, s.q, s.v, s.a) - s.without(force_rate, s.t, s.q, s.v, s.a)
    if s.load.constant and s.load.law is None:
        assert not np.any(rate)
    else:
        moved = s.added(s.q + e * s.v, s.v + e * s.a, s.t + e).imag
        assert_close(rate, moved / STEP, DERIVATIVE)


@every_load
def test_partials_of_a_load_are_complex_steps_of_its_force(name):
    s = load_setting(name)
    x = s.system
    partial = force_b(x, s.t, s.q, s.v)
    s.check_design(partial, lambda x, e: x.force(s.t, s.q, s.v), np.max(np.abs(s.added())))
    total = force_rate_total(x, s.t, s.q, s.v, s.a, s.q_b, s.v_b, s.a_b)

    def rate(x, e):
        states = zip((s.q, s.v, s.a), s.along, strict=True)
        return force_rate(x, s.t, *(y + e * y_e for y, y_e in states))

    s.check_design(total, rate, np.max(np.abs(rate(x, 0.0))))
    starts = x.start_b()[1][s.bare.n_q :]
    for parameter in s.own:
        column = x.design_names.index(parameter)
        # An initial state moves the start.
        if not np.any(starts[:, column]):
            assert np.max(np.abs(partial[:, column])) > 1e-6, parameter
