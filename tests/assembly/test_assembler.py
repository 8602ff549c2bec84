"""The assembler behind the system protocol, and the linear solvers that factorise its matrices.

Every partial of the protocol is compared with a complex step of the system's own values, the
values with a plain assembly of oracle elements and shape functions written by hand. Complex
steps have no truncation error: STEP^2 vanishes against one.
"""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    Material,
    Pin,
    PointOnLine,
    SaintVenantKirchhoff,
    Scene,
    assemble,
    distributed_variables,
)
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors import InvalidInputError
from ancfdae.extend import MechanicalSystem
from ancfdae.integrators.hht.equations import Coefficients
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.start import (
    Covectors,
    consistent_start,
    pull_back_start,
    start_sensitivity,
)
from ancfdae.model.elements import ALL_ELEMENTS, BeamElement, ElementParameter
from ancfdae.numerics.complex_step import real_derivative
from ancfdae.sections import Rectangle
from tests.support.by_hand import oracle_of, plain_elements, turns_by_hand, vector_by_hand
from tests.support.design_cases import ALL, CASES
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
    force_b,
    force_q,
    force_rate,
    force_rate_total,
    force_total,
    force_v,
    jerk_side,
    jerk_side_total,
    mass_b_times,
    velocity_side,
    velocity_side_total,
)
from tests.support.scenes import FLAT, MACHINES, RIGID, SCENES, STEEL, one_planar_beam
from tests.support.setting import (
    DERIVATIVE,
    STEP,
    VALUE,
    MeasuredSetting,
    assert_close,
    concrete_subclasses,
)

# Time is real: derivatives in it come from extrapolated differences, good to about 1e-11.
DIFFERENCES = 1e-9


@pytest.fixture(scope="module", params=CASES)
def setting(request):
    return MeasuredSetting(*CASES[request.param])


@pytest.fixture(scope="module", params=SCENES)
def plain(request):
    """Every scene once, without design variables."""
    return MeasuredSetting(request.param, [])


@pytest.fixture(scope="module", params=[name for name in SCENES if name not in RIGID])
def bending(request):
    """Scenes of beams that bend."""
    return MeasuredSetting(request.param, [])


@pytest.fixture(scope="module", params=[name for name in SCENES if name not in MACHINES])
def conservative(request):
    """Scenes of pins and clamps under gravity."""
    return MeasuredSetting(request.param, [])


# ---------------------------------------------------------------- completeness


def test_every_element_is_known_and_so_appears_in_the_scenes_of_this_file():
    # Joints and loads: each one alone in test_joints and test_loads.
    assert concrete_subclasses(BeamElement) == {type(element) for element in ALL_ELEMENTS}


def test_every_scene_and_every_parameter_has_a_case():
    assert {scene for scene, _ in CASES.values()} == set(SCENES)
    for dimension in (2, 3):
        driven = set()
        for scene, design in CASES.values():
            system = assemble(SCENES[scene](), design)
            if system.naming.layout.d == dimension:
                targets = [t for variable in system._structure.design for t in variable.targets]
                beams = {beam.name for beam in system._scene.beams}
                owners = (target.split(".") for target in targets)
                driven |= {name.split("[")[0] for owner, name in owners if owner in beams}
        assert driven == set(ALL)


# ---------------------------------------------------------------- partials by complex step


def test_force_b(setting):
    s = setting
    Q = s.system.force(s.t, s.q, s.v)
    partial = force_b(s.system, s.t, s.q, s.v)
    s.check_design(partial, lambda x, e: x.force(s.t, s.q, s.v), np.max(np.abs(Q)))


def test_force_total(setting):
    s = setting
    total = force_total(s.system, s.t, s.q, s.v, s.q_b, s.v_b)
    rows = [np.concatenate([x[None], x_b.T]) for x, x_b in ((s.q, s.q_b), (s.v, s.v_b))]
    both = s.system.force_and_total(s.t, *rows)
    assert np.array_equal(both[1:].T, total)
    Q = s.system.force(s.t, s.q, s.v)
    # The same products in another order.
    assert np.max(np.abs(both[0] - Q)) < 1e-13 * np.max(np.abs(Q))

    def moved(x, e):
        return x.force(s.t, *(y + e * y_e for y, y_e in zip((s.q, s.v), s.along[:2], strict=True)))

    s.check_design(total, moved, np.max(np.abs(s.system.force(s.t, s.q, s.v))))


def test_mass_b_times(setting):
    s = setting
    partial = mass_b_times(s.system, s.q, s.a)
    magnitude = np.max(np.abs(s.system.mass_times(s.q, s.a)))
    s.check_design(partial, lambda x, e: x.mass_times(s.q, s.a), magnitude)


def test_force_rate_total(setting):
    s = setting
    partial = force_rate_total(s.system, s.t, s.q, s.v, s.a, s.q_b, s.v_b, s.a_b)

    def rate(x, e):
        states = zip((s.q, s.v, s.a), s.along, strict=True)
        return force_rate(x, s.t, *(y + e * y_e for y, y_e in states))

    s.check_design(partial, rate, np.max(np.abs(force_rate(s.system, s.t, s.q, s.v, s.a))))


def test_constraint_b(setting):
    s = setting
    partial = constraint_b(s.system, s.t, s.q)
    s.check_design(partial, lambda x, e: x.constraint(s.t, s.q), 1.0)  # positions of 1 m


def test_constraint_force_b(setting):
    s = setting
    partial = constraint_force_b(s.system, s.t, s.q, s.lam)
    magnitude = np.max(np.abs(constraint_force(s.system, s.t, s.q, s.lam)))
    s.check_design(partial, lambda x, e: constraint_force(x, s.t, s.q, s.lam), magnitude)


def test_constraint_q_times_total(setting):
    s = setting
    partial = constraint_q_times_total(s.system, s.t, s.q, s.v, s.q_b)

    def product(x, e):
        values = x.constraint_q(s.t, s.q + e * s.along[0])
        return x.constraint_pattern.dot(values, s.v)

    s.check_design(partial, product, 1.0)


def test_start_b(setting):
    s = setting
    for k in (0, 1):
        s.check_design(s.system.start_b()[k], lambda x, e, k=k: x.start()[k], 1.0)


def test_start_pull_back_is_the_contraction_of_start_b(setting):
    x = np.random.default_rng(10).uniform(-1, 1, (2, setting.system.n_q))
    q_b, v_b = setting.system.start_b()
    size = np.abs(x[0]) @ np.abs(q_b) + np.abs(x[1]) @ np.abs(v_b)
    error = setting.system.start_pull_back(*x) - (x[0] @ q_b + x[1] @ v_b)
    assert np.all(np.abs(error) <= VALUE * size)


def test_pulling_back_forms_no_column_of_coordinates_for_every_variable():
    beam = Beam("b", (0, 0), (1, 0), 200, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3))
    scene = Scene([beam], [Pin(beam.at_start)], gravity=(0, -9.81))
    system = assemble(scene, [f"b.height[{i}]" for i in range(200)])
    x, lam, t = np.ones((1, system.n_q)), np.ones((1, system.n_lam)), np.zeros(1)
    system.pull_back(t, (x, x, x, lam), (x, lam))  # The first use makes the laws' derivatives.
    tracemalloc.start()
    system.pull_back(t, (x, x, x, lam), (x, lam))
    system.start_pull_back(x[0], x[0])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # One such array; the products of all pairs take a third of it.
    assert peak < system.n_q * system.n_b * 8 / 2, peak


def test_lengths_b(setting):
    s = setting
    if not s.scene.beams:
        assert s.system.naming.lengths_b.shape == (0, s.system.n_b)
        return
    s.check_design(s.system.naming.lengths_b, lambda x, e: x.naming.lengths, 1.0)


def test_design_derivatives_of_the_constraints_are_not_all_zero():
    # The checks above would accept zero for zero: pins away from the nodes move with the length.
    s = MeasuredSetting("planar_pair", ["crank.length", "rod.length"])
    for partial in (
        constraint_b(s.system, s.t, s.q),
        constraint_force_b(s.system, s.t, s.q, s.lam),
        constraint_q_times_total(s.system, s.t, s.q, s.v, s.q_b),
    ):
        # The crank is held at its ends only, the rod inside of its second element.
        assert not np.any(partial[:, 0])
        assert np.any(partial[:, 1])
    q_b, v_b = s.system.start_b()
    assert np.all(np.any(q_b, axis=0))
    assert np.all(np.any(v_b, axis=0))


def test_force_is_minus_the_gradient_of_the_energies(conservative):
    s, system = conservative, conservative.system
    gradient = s.by_coordinate(
        lambda q: system.energies.strain(q[None])[0] + system.energies.gravity(q)
    )
    assert_close(system.force(s.t, s.q, s.v), -gradient, DERIVATIVE)


def test_force_q(plain):
    s, system = plain, plain.system
    expected = s.by_coordinate(lambda q: system.force(s.t, q, s.v))
    Q_q = system.pattern.dense(force_q(system, s.t, s.q, s.v))
    assert_close(Q_q, expected, DERIVATIVE)


def test_tangent_of_conservative_forces_is_symmetric(conservative):
    s, system = conservative, conservative.system
    Q_q = system.pattern.dense(force_q(system, s.t, s.q, s.v))
    assert_close(Q_q, Q_q.T, VALUE)
    assert not system.traits.velocity_forces
    assert not np.any(force_v(system, s.t, s.q, s.v))


def test_force_v(plain):
    s, system = plain, plain.system
    Q_v = system.pattern.dense(force_v(system, s.t, s.q, s.v))
    if not system.traits.velocity_forces:
        moved = system.force(s.t, s.q, s.v + 1.0)
        assert np.array_equal(moved, system.force(s.t, s.q, s.v))
        assert not np.any(Q_v)
        return
    expected = s.by_coordinate(lambda v: system.force(s.t, s.q, v), s.v)
    assert_close(Q_v, expected, DERIVATIVE)


def test_force_rate(plain):
    s, system = plain, plain.system
    moved = system.force(s.t, s.q + 1j * STEP * s.v, s.v + 1j * STEP * s.a)
    expected = moved.imag / STEP
    assert_close(force_rate(system, s.t, s.q, s.v, s.a), expected, DERIVATIVE)


def test_constraint_q_and_its_transpose(plain):
    s, system = plain, plain.system
    expected = s.by_coordinate(lambda q: system.constraint(s.t, q))
    B = system.constraint_pattern.dense(system.constraint_q(s.t, s.q))
    assert_close(B, expected, DERIVATIVE)
    assert_close(constraint_force(system, s.t, s.q, s.lam), B.T @ s.lam, VALUE)


def test_linear_constraints_have_no_curvature(conservative):
    s, system = conservative, conservative.system
    assert system.traits.linear_constraints
    values = system.constraint_q(s.t, s.q + 1j * STEP * s.v)
    assert not np.any(np.imag(values))
    for array in (
        constraint_force_q(system, s.t, s.q, s.lam),
        velocity_side(system, s.t, s.q),
        acceleration_side(system, s.t, s.q, s.v),
        jerk_side(system, s.t, s.q, s.v, s.a),
        constraint_force_rate(system, s.t, s.q, s.v, s.lam),
    ):
        assert not np.any(array)


def test_curvature_of_constraints(plain):
    s, system = plain, plain.system
    values = system.pattern.dense(constraint_force_q(system, s.t, s.q, s.lam))
    if system.traits.linear_constraints:
        assert not np.any(values)
        return
    expected = s.by_coordinate(lambda q: constraint_force(system, s.t, q, s.lam))
    assert_close(values, expected, DERIVATIVE)


def test_constraint_q_rate(plain):
    s, system = plain, plain.system
    dense, dot = system.constraint_pattern.dense, system.constraint_pattern.dot
    rate = dense(system.constraint_q(s.t, s.q, s.v))
    if system.traits.linear_constraints:
        assert not np.any(rate)
        return
    # Along the motion, prescribed motions included, and as the partial of dPhi/dt in q.
    moved = real_derivative(lambda e: system.constraint_q(s.t + e, s.q + e * s.v))
    assert_close(rate, dense(moved), DIFFERENCES)
    expected = s.by_coordinate(
        lambda q: dot(system.constraint_q(s.t, q), s.v) - velocity_side(system, s.t, q)
    )
    assert_close(rate, expected, DERIVATIVE)


def test_constraint_q_second_rate(plain):
    s, system = plain, plain.system
    dense, dot = system.constraint_pattern.dense, system.constraint_pattern.dot
    rate = dense(system.constraint_q(s.t, s.q, s.v, s.a))
    if system.traits.linear_constraints:
        assert not np.any(rate)
        return
    moved = real_derivative(
        lambda e: system.constraint_q(s.t + e, s.q + e * (s.v + e / 2 * s.a), s.v + e * s.a)
    )
    assert_close(rate, dense(moved), DIFFERENCES)
    expected = s.by_coordinate(
        lambda q: dot(system.constraint_q(s.t, q), s.a) - acceleration_side(system, s.t, q, s.v)
    )
    assert_close(rate, expected, DERIVATIVE)


def instants(s, k=3):
    """States of k instants as rows, and their times."""
    rng = np.random.default_rng(8)
    q = s.q + 0.05 * rng.uniform(-1, 1, (k, s.system.n_q))
    v, a = rng.uniform(-1, 1, (2, k, s.system.n_q))
    return s.t + 0.1 * np.arange(k), (q, v, a, rng.uniform(-1, 1, (k, s.system.n_lam)))


def test_linearise_is_the_loop_over_instants(plain):
    s, system = plain, plain.system
    t, states = instants(s)
    ours, loop = system.linearise(t, *states), MechanicalSystem.linearise(system, t, *states)
    assert_close(ours.M, loop.M, VALUE)
    assert_close(ours.f_q, loop.f_q, VALUE)
    assert_close(ours.Phi_q, loop.Phi_q, VALUE)
    assert (ours.f_v is None) == (not system.traits.velocity_forces)
    if system.traits.velocity_forces:
        assert_close(ours.f_v, loop.f_v, VALUE)


def test_design_partials_are_the_loop_over_instants(setting):
    s, system = setting, setting.system
    t, states = instants(s)
    ours = system.design_partials(t, *states)
    loop = MechanicalSystem.design_partials(system, t, *states)
    for name in ("f_b", "Phi_b"):
        value, expected = getattr(ours, name), getattr(loop, name)
        assert value.shape == expected.shape
        for i in range(system.n_b):
            scale = np.max(np.abs(expected[..., i]))
            assert np.max(np.abs(value[..., i] - expected[..., i])) <= VALUE * scale


def test_pull_back_is_the_contraction_of_the_design_partials(setting):
    s, system = setting, setting.system
    t, states = instants(s)
    rng = np.random.default_rng(9)
    covectors = tuple(rng.uniform(-1, 1, (len(t), n)) for n in (system.n_q, system.n_lam))
    ours = system.pull_back(t, states, covectors)
    partials = system.design_partials(t, *states)
    terms = [
        partial * covector[..., None]
        for partial, covector in zip((partials.f_b, partials.Phi_b), covectors, strict=True)
    ]
    expected = sum(np.sum(term, axis=(0, 1)) for term in terms)
    # Each sum against the sum of its magnitudes.
    size = sum(np.sum(np.abs(term), axis=(0, 1)) for term in terms)
    assert ours.shape == expected.shape == (system.n_b,)
    assert np.all(np.abs(ours - expected) <= VALUE * size)


def test_arrays_of_the_protocol_have_their_shapes(setting):
    s, x = setting, setting.system
    n_q, n_lam, n_b = x.n_q, x.n_lam, x.n_b
    lam_b = np.zeros((n_lam, n_b))
    for array, shape in (
        (velocity_side_total(x, s.t, s.q, s.q_b), (n_lam, n_b)),
        (acceleration_side_total(x, s.t, s.q, s.v, s.q_b, s.v_b), (n_lam, n_b)),
        (jerk_side_total(x, s.t, s.q, s.v, s.a, s.q_b, s.v_b, s.a_b), (n_lam, n_b)),
        (constraint_force_rate_total(x, s.t, s.q, s.v, s.lam, s.q_b, s.v_b, lam_b), (n_q, n_b)),
        (constraint_q_times_total(x, s.t, s.q, s.v, s.q_b), (n_lam, n_b)),
        (force_v(x, s.t, s.q, s.v), (x.pattern.size,)),
        (x.mass(s.q), (x.pattern.size,)),
        (x.weights, (n_q,)),
        (velocity_side(x, s.t, s.q), (n_lam,)),
    ):
        assert array.shape == shape
    assert len(x.constraint_names) == n_lam
    assert len(x.design_names) == n_b
    assert np.all(x.weights > 0)


# ---------------------------------------------------------------- values by hand


def test_force_is_the_sum_of_oracle_elements(conservative):
    s, d = conservative, conservative.scene.dimension
    # The oracle has the energy of the source paper.
    beams = [replace(beam, energy=beam.energy and SaintVenantKirchhoff()) for beam in s.scene.beams]
    paper = assemble(replace(s.scene, beams=beams))
    expected = np.zeros(s.system.n_q)
    g, oracle = s.scene.gravity, oracle_of(s.scene.beams[0].element)
    for rows, p, X_o, rule in plain_elements(s.scene):
        section = (p["h"], p["w"], p["l"], X_o)
        X = s.q[rows].reshape(-1, d)
        expected[rows] -= oracle.force(X, p["E"], p["nu"], *section, **rule).ravel()
        if g is not None:
            expected[rows] += oracle.gravity_force(g, p["rho"], *section, **rule).ravel()
    assert_close(paper.force(s.t, s.q, s.v), expected, VALUE)


def test_mass_is_the_sum_of_oracle_elements_and_its_total_the_mass_of_the_scene(bending):
    s, d = bending, bending.scene.dimension
    expected, volumes, oracle = (
        np.zeros((s.system.n_q, s.system.n_q)),
        0.0,
        oracle_of(s.scene.beams[0].element),
    )
    for rows, p, X_o, rule in plain_elements(s.scene):
        section = (p["h"], p["w"], p["l"], X_o)
        expected[np.ix_(rows, rows)] += oracle.mass(d, p["rho"], *section, **rule)
        dV = [dV for *_, dV in oracle.quadrature_points(d, *section, **rule)]
        volumes += p["rho"] * np.sum(dV)
    M = s.system.pattern.dense(s.system.mass(s.q))
    assert_close(M, expected, VALUE)
    assert_close(s.system.mass_times(s.q, s.a), M @ s.a, VALUE)
    assert_close(s.system.energies.kinetic(s.v[None]), np.array([0.5 * s.v @ M @ s.v]), VALUE)
    translation = np.zeros((s.system.n_q // d, d))
    translation[:: s.system.naming.layout.bodies[0].stride, 0] = 1.0
    total = translation.ravel() @ s.system.mass_times(s.q, translation.ravel())
    assert_close(total, volumes, VALUE)
    if all(beam.reference().straight for beam in s.scene.beams):
        blocks = s.scene.element_parameters
        P = ElementParameter
        which = [P.DENSITY, P.SIZE_1, P.SIZE_2, P.LENGTH]
        assert_close(total, np.sum(np.prod(blocks[:, which], axis=1)), VALUE)


def test_constraints_are_those_of_vectors_by_hand(conservative):
    s, system, expected = conservative, conservative.system, []
    q_o = system._reference.q
    for joint in s.scene.joints:
        here = vector_by_hand(system, s.q, joint.points[0], 0)
        if isinstance(joint, PointOnLine):
            along = np.array(joint.direction) / np.linalg.norm(joint.direction)
            across = np.array([-along[1], along[0]])
            expected.append([across @ (here - joint.through)])
            continue
        if len(joint.points) == 2:
            there = vector_by_hand(system, s.q, joint.points[1], 0)
        elif isinstance(joint, Pin) and joint.ground is not None:
            there = np.array(joint.ground)
        else:
            there = vector_by_hand(system, q_o, joint.points[0], 0)
        expected.append(here - there)
        if isinstance(joint, Clamp):
            expected.append(turns_by_hand(system, s.q, q_o, joint.point))
    # Differences of positions of 1 m that differ by 0.05 m: 20 times the round-off of a sum of
    # eight products.
    assert_close(system.constraint(s.t, s.q), np.concatenate(expected), VALUE)


def test_pin_holds_to_the_given_ground():
    beam = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, FLAT, STEEL)
    system = assemble(Scene([beam], [Pin(beam.at_end, ground=(0.7, 0.2))]))
    # (1, 0) - (0.7, 0.2), one rounding.
    assert system.constraint(0.0, system._reference.q) == pytest.approx([0.3, -0.2], rel=1e-15)


def test_rigid_motion_turns_positions_and_slopes():
    for name in ("planar_machine", "spatial_machine"):
        # As declared: assembled, others would have to move too.
        scene = replace(SCENES[name](), joints=())
        system, (motion,), d = assemble(scene), scene.start, scene.dimension
        omega = np.zeros(3)
        omega[-1 if d == 2 else slice(None)] = motion.angular_velocity
        expected = np.zeros(system.n_q).reshape(-1, d + 1, d)
        place = system.naming.layout.body(motion.body)
        first, count = place.first_vector // place.stride, place.count // place.stride
        nodes = slice(first, first + count)
        arms = system.start()[0].reshape(-1, d + 1, d)[nodes].copy()
        arms[:, 0] -= motion.about
        space = np.zeros((*arms.shape[:-1], 3))
        space[..., :d] = arms
        expected[nodes] = np.cross(omega, space)[..., :d]
        expected[nodes, 0] += motion.velocity
        assert_close(system.start()[1], expected.ravel(), 1e-15)  # two products and a sum


# ---------------------------------------------------------------- consistent start


def test_start_sensitivity_is_the_complex_step_of_the_consistent_start(setting):
    s = setting
    matrices = saddle_point(s.system, 0.0)
    state = consistent_start(s.system, matrices, 0.0)[0]
    partials = start_sensitivity(s.system, matrices, state)
    start = consistent_start(s.moved, saddle_point(s.moved, 0.0), 0.0)[0]
    for name in ("q", "v", "a", "lam"):
        values = getattr(state, name)

        # Solves with a scaled matrix whose condition is below 1e4 come on top of DERIVATIVE.
        # Joints take velocities of 1 m/s: what is left where they hold all is round-off of these.
        size, noise = max(np.max(np.abs(values)), 1.0 if name == "v" else 0.0), s.noise(name)
        moved = getattr(start, name)
        partial = getattr(partials, f"{name}_b")
        s.check_design(partial, lambda x, e, moved=moved: moved, size, 1e-9, noise)


def test_pull_back_of_a_start_is_the_transpose_of_its_derivatives(setting):
    system, matrices = setting.system, saddle_point(setting.system, 0.0)
    state = consistent_start(system, matrices, 0.0)[0]
    partials = start_sensitivity(system, matrices, state)
    rng, none = np.random.default_rng(5), [np.zeros_like(x) for x in state[1:]]
    for i, (name, x) in enumerate(zip("qval", state[1:], strict=True)):
        size = np.max(np.abs(x), initial=0.0)
        if size < 1e-6:
            continue  # At rest: velocities are round-off, and so are their derivatives.
        on = rng.normal(size=x.shape) / size
        covectors = Covectors(*none[:i], on, *none[i + 1 :], np.zeros(system.n_b))
        found, partial = pull_back_start(system, matrices, state, covectors), partials[i]
        # Sums of as many terms as there are coordinates cancel; solves as above.
        terms = np.abs(partial).T @ np.abs(on)
        tolerance = 1e-7 * np.maximum(terms, 1e-3 * np.max(terms, initial=0.0)) + 1e-12
        assert np.all(np.abs(found - partial.T @ on) <= tolerance), name


def test_start_of_the_recurrence_is_differentiated_exactly(setting):
    s, c = setting, Coefficients(0.01, -0.3)

    def start(x):
        return RecurrenceStart.of(InitialValueProblem.of(x, 1.0), c)

    first, node = start(s.system), start(s.moved).node
    matrices = saddle_point(s.system, 0.0)
    partials = first.sensitivity(start_sensitivity(s.system, matrices, first.initial))
    for name in ("v", "a"):
        # As above.
        size = max(np.max(np.abs(getattr(first.node, name))), 1.0 if name == "v" else 0.0)
        # Damping 1e7 times the mass stands in the matrix of the third derivative: 1e7 eps, and ten
        # times as much for the products.
        moved = getattr(node, name)
        partial = getattr(partials, f"{name}_b")
        s.check_design(partial, lambda x, e, moved=moved: moved, size, 2e-8, s.noise(name))


def test_cases_contain_projected_starts():
    # Otherwise the terms of the projection would not be seen above.
    for name in ("planar_machine", "spatial_machine"):
        system = assemble(SCENES[name]())
        q, v = system.start()
        state = consistent_start(system, saddle_point(system, 0.0), 0.0)[0]
        assert np.max(np.abs(state.q - q)) > 1e-3
        assert np.max(np.abs(state.v - v)) > 1e-3


# ---------------------------------------------------------------- design values


def scaled_values(system, factor):
    values = {}
    for variable, value in zip(system._structure.design, system.b, strict=True):
        values |= {target: float(value) * factor for target in variable.targets}
    return values


def test_system_with_values_is_the_scene_with_values(setting):
    s, factor = setting, 1.01
    moved = s.system.with_values(s.system.b * factor)
    scene = s.scene.with_values(scaled_values(s.system, factor))
    other = assemble(scene, s.design)
    # Lengths go through coordinates and back, or through a factor: a few eps; a force of this
    # state changes by 10 times its relative error (strain of 0.1).
    if s.scene.beams:
        assert_close(moved.naming.lengths, other.naming.lengths, VALUE)
    assert_close(moved.start()[0], other.start()[0], VALUE)
    assert_close(moved.force(s.t, s.q, s.v), other.force(s.t, s.q, s.v), 10 * VALUE)
    assert_close(moved.mass_times(s.q, s.a), other.mass_times(s.q, s.a), VALUE)
    assert_close(moved.constraint(s.t, s.q), other.constraint(s.t, s.q), 10 * VALUE)
    if s.system.n_b:
        assert_close(other.b, s.system.b * factor, VALUE)
        change = moved.force(s.t, s.q, s.v) - s.system.force(s.t, s.q, s.v)
        assert np.max(np.abs(change)) > 0


def test_naming_design_variables_changes_nothing(setting):
    s = setting
    plain = assemble(s.scene)
    # Values are written through shares of a length: a rounding of the length or two.
    if s.scene.beams:
        assert_close(s.system.naming.lengths, plain.naming.lengths, VALUE)
    assert_close(s.system.force(s.t, s.q, s.v), plain.force(s.t, s.q, s.v), 10 * VALUE)
    assert_close(s.system.mass_times(s.q, s.a), plain.mass_times(s.q, s.a), VALUE)
    assert_close(s.system.start()[0], plain.start()[0], VALUE)


def test_with_values_of_the_same_values_is_the_same_system(setting):
    s = setting
    same = s.system.with_values(s.system.b)
    assert np.array_equal(same.force(s.t, s.q, s.v), s.system.force(s.t, s.q, s.v))
    assert np.array_equal(same.mass(s.q), s.system.mass(s.q))
    assert np.array_equal(same.constraint(s.t, s.q), s.system.constraint(s.t, s.q))


def test_wrong_number_of_design_values_is_refused():
    system = assemble(one_planar_beam(), ["rod.height"])
    for b in (np.zeros(0), np.ones(2), np.ones((1, 1))):
        with pytest.raises(InvalidInputError, match="design values"):
            system.with_values(b)


def test_equal_elements_share_their_invariants_and_a_single_changed_one_does_not():
    shared = assemble(one_planar_beam(), distributed_variables("rod.height", 2))
    assert len(shared._elastic._block.A) == 1
    assert len(shared.with_values(shared.b * [1.0, 1.1])._elastic._block.A) == 2
    # The imaginary part of a complex step makes an element different, too.
    assert len(shared.with_values(shared.b + np.array([0.0, 1e-40j]))._elastic._block.A) == 2
