"""Solutions: vectors of named points, reactions, derivatives of observables, and files.

Named access is linear in the coordinates; it is compared with shape functions of the oracle, and
round-off is that of a sum of eight products of numbers below two: 16 eps = 4e-15 (EXACT).
"""

import dataclasses
import io
import json
import stat

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    DirectDifferentiation,
    InitialVelocity,
    Material,
    NodalState,
    Pin,
    Scene,
    assemble,
    differentiate,
    load_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.extend import MaterialPoint
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.results import RunOutcome, Statistics, Verdict
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.method import Run
from tests.support.members import constraint_force, force_q
from tests.support.oracle import plain_ancf as ancf

EXACT = 4e-15
STEP = 1 / 128
T_END = 16 * STEP
SOFT = Material(density=1100.0, youngs_modulus=1e6, poisson_ratio=0.3)
SECTION = Rectangle(height=0.06, width=0.04)
DESIGN = ["rod.length", "rod.youngs_modulus", "bow.height"]


def bow(dimension):
    """Arc of two unequal elements; its nodes lie at uneven fractions."""
    positions, frames = [], []
    for theta in (0.0, 0.5, 0.9):
        c, s = np.cos(theta), np.sin(theta)
        positions.append(np.array([s, -c, 0.0])[:dimension])
        frame = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        frames.append(frame[:dimension, :dimension])
    return CurvedBeam("bow", np.array(positions), np.array(frames), SECTION, SOFT)


def mechanism(dimension):
    """A clamped arc carries a swinging straight beam of three elements."""
    holder = bow(dimension)
    tip = holder.positions[-1]
    along = np.array([0.9, 0.3, 0.2])[:dimension]
    rod = Beam("rod", tuple(tip), tuple(tip + along), 3, SECTION, SOFT)
    joints = [Clamp(holder.at_start, name="wall"), Pin(holder.at_end, rod.at_start, name="pivot")]
    spin = 2.0 if dimension == 2 else (0.3, -0.5, 2.0)
    gravity = (0.5, -9.81, 1.0)[:dimension]
    return Scene([holder, rod], joints, gravity, [InitialVelocity("rod", spin, tuple(tip))])


@pytest.fixture(scope="module", params=[2, 3], ids=["planar", "spatial"])
def solution(request):
    solution = differentiate(mechanism(request.param), T_END, HHT(STEP), design=DESIGN)
    assert solution.outcome.success
    return solution


def assert_close(value, expected, tolerance):
    scale = np.max(np.abs(expected))
    assert scale > 0
    assert np.shape(value) == np.shape(expected)
    assert np.max(np.abs(value - expected)) <= tolerance * scale


def dimension_of(solution):
    return solution.naming.layout.d


# ---------------------------------------------------------------- vectors of named points


def by_hand(solution, states, beam, element, xi, y, z, axis=None):
    """Position, or slope along an axis, by the oracle's shape functions at every instant."""
    d = dimension_of(solution)
    place = solution.naming.layout.beam(beam)
    size = (d + 1) * d
    first = solution.naming.layout.body(beam).first_vector * d + element * size
    X = states[:, first : first + 2 * size].reshape(len(states), -1, d)
    l = solution.naming.lengths[place.first_element + element]
    if axis is None:
        return np.einsum("a,tad->td", ancf.shape(d, xi, y, z, l), X)
    return np.einsum("a,tad->td", ancf.shape_gradient(d, xi, y, z, l)[:, axis], X)


PLACES = [(0, 0.2), (0, 0.37), (1, 0.5), (1, 0.95), (1, 1.0)]


def fraction_of(solution, beam, element, xi):
    fractions = solution.naming.layout.beam(beam).fractions
    return fractions[element] + xi * (fractions[element + 1] - fractions[element])


@pytest.mark.parametrize(("element", "xi"), PLACES)
@pytest.mark.parametrize("beam", ["rod", "bow"])
@pytest.mark.parametrize("name", ["position", "velocity", "acceleration"])
def test_vectors_of_points_are_those_of_the_shape_functions(solution, name, beam, element, xi):
    states = getattr(solution, name[0] if name != "position" else "q")
    fraction = fraction_of(solution, beam, element, xi)
    for y, z in ((0.0, 0.0), (0.02, -0.01 * (dimension_of(solution) - 2))):
        value = getattr(solution, name)(MaterialPoint(beam, fraction, y, z))
        # The fraction goes through a division: a few eps in xi times a slope below two.
        assert_close(value, by_hand(solution, states, beam, element, xi, y, z), 4 * EXACT)


@pytest.mark.parametrize("beam", ["rod", "bow"])
def test_position_at_a_node_is_its_coordinate(solution, beam):
    place = solution.naming.layout.beam(beam)
    nodes = solution.nodes(beam)
    d = dimension_of(solution)
    assert nodes.shape == (len(solution.t), place.element_count + 1, d + 1, d)
    for k, fraction in enumerate(place.fractions):
        assert np.array_equal(solution.position(MaterialPoint(beam, fraction)), nodes[:, k, 0])
        for axis in range(d):
            assert_close(
                solution.slope(MaterialPoint(beam, fraction), axis), nodes[:, k, 1 + axis], EXACT
            )


@pytest.mark.parametrize("beam", ["rod", "bow"])
@pytest.mark.parametrize(("element", "xi"), PLACES)
def test_slopes_are_those_of_the_shape_functions(solution, beam, element, xi):
    fraction = fraction_of(solution, beam, element, xi)
    # Beside the centre line r_x jumps from element to element.
    y = 0.015 if xi < 1 else 0.0
    for axis in range(dimension_of(solution)):
        value = solution.slope(MaterialPoint(beam, fraction, y=y), axis)
        expected = by_hand(solution, solution.q, beam, element, xi, y, 0.0, axis)
        # As above, times the derivative of a slope (1/l = 3).
        assert_close(value, expected, 20 * EXACT)


def test_slope_is_the_derivative_of_position_along_the_beam(solution):
    # Central differences over 2 s: error s^2/6 r''' + eps/s; the third derivative of the cubic
    # is below 12 |r_2 - r_1 - ...|/l^3, which a slope change of order one makes 12/l^2 = 130.
    s, length = 1e-4, np.sum(solution.naming.lengths[2:])
    ahead = solution.position(MaterialPoint("rod", 0.45 + s / length, y=0.01))
    behind = solution.position(MaterialPoint("rod", 0.45 - s / length, y=0.01))
    slope = solution.slope(MaterialPoint("rod", 0.45, y=0.01), 0)
    assert np.max(np.abs((ahead - behind) / (2 * s) - slope)) <= 130 * s**2 / 6 + 1e-11
    across = (
        solution.position(MaterialPoint("rod", 0.45, y=s))
        - solution.position(MaterialPoint("rod", 0.45, y=-s))
    ) / (2 * s)
    # Linear in y: round-off over the distance, 2 eps / 2e-4 for positions of size one.
    assert np.max(np.abs(across - solution.slope(MaterialPoint("rod", 0.45), 1))) <= 1e-11


def test_velocity_and_acceleration_are_time_derivatives_as_hht_i3_has_them(solution):
    alpha, h = -0.3, STEP
    gamma, beta = (1 - 2 * alpha) / 2, (1 - alpha) ** 2 / 4
    point = MaterialPoint("rod", 0.8, 0.01)
    r, v, a = solution.position(point), solution.velocity(point), solution.acceleration(point)
    # Eqs. (2) and (3) hold for the algorithm's acceleration A; by eq. (4) it is a mean of the
    # recorded ones, which satisfy M a = Q - Phi_q^T lam at their instants.
    A = (1 + alpha) * a[1:] - alpha * a[:-1]
    dv = v[2:] - v[1:-1] - h * ((1 - gamma) * A[:-1] + gamma * A[1:])
    dr = r[2:] - r[1:-1] - h * v[1:-1] - h**2 * ((0.5 - beta) * A[:-1] + beta * A[1:])
    # Round-off of positions of size one, velocities below 10 and accelerations below 1e3.
    assert np.max(np.abs(dr)) <= 1e-14
    assert np.max(np.abs(dv)) <= 1e-13


def test_wrong_names_and_places_are_refused(solution):
    d = dimension_of(solution)
    for action, where in (
        (lambda: solution.position("bow"), "point"),
        (lambda: solution.position(MaterialPoint("bow", 1.1)), "point of 'bow'"),
        (lambda: solution.velocity(MaterialPoint("bow", -0.1)), "point of 'bow'"),
        (lambda: solution.slope(MaterialPoint("bow", np.nan)), "point of 'bow'"),
        (lambda: solution.slope(MaterialPoint("bow", 0.5), d), "slope, along"),
        (lambda: solution.slope(MaterialPoint("bow", 0.5), -1), "slope, along"),
    ):
        with pytest.raises(InvalidInputError) as error:
            action()
        assert error.value.where == where
    for action, known in (
        (lambda: solution.position(MaterialPoint("bo", 0.5)), "bow, rod"),
        (lambda: solution.nodes("bo"), "bow, rod"),
        (lambda: solution.multipliers("wal"), "pivot, wall"),
        (lambda: solution.reaction("wal"), "pivot, wall"),
        (lambda: solution.design_index("E"), "bow.height, rod.length, rod.youngs_modulus"),
    ):
        with pytest.raises(UnknownNameError) as unknown:
            action()
        assert unknown.value.repair == f"Known names: {known}."


def test_a_planar_beam_has_no_third_axis():
    solution = simulate(mechanism(2), STEP, HHT(STEP))
    with pytest.raises(InvalidInputError, match="z"):
        solution.position(MaterialPoint("rod", 0.5, z=0.01))


def test_named_access_needs_names(solution):
    nameless = dataclasses.replace(solution, naming=None)
    for action in (
        lambda: nameless.position(MaterialPoint("rod", 0.5)),
        lambda: nameless.nodes("rod"),
        lambda: nameless.reaction("wall"),
    ):
        with pytest.raises(InvalidInputError, match=r"by name.*q, v, a and lam"):
            action()


# ---------------------------------------------------------------- reactions


def total_momentum_rate(scene, solution):
    """Sum over the scene of mass times acceleration, (n_t, d)."""
    system, d = assemble(scene), dimension_of(solution)
    field = np.zeros((d, system.n_q // d, d))
    field[np.arange(d), :: d + 1, np.arange(d)] = 1.0
    weights = np.stack([system.mass_times(None, unit.ravel()) for unit in field])
    return solution.a @ weights.T, weights


def test_sum_of_forces_is_mass_times_acceleration_at_every_instant(solution):
    scene = mechanism(dimension_of(solution))
    rate, weights = total_momentum_rate(scene, solution)
    d = dimension_of(solution)
    masses = weights.reshape(d, -1, d + 1, d)[:, :, 0].sum(axis=(1, 2))
    assert_close(masses, np.full(d, masses[0]), 1e-14)  # the same mass in every direction
    weight = masses[0] * np.array(scene.gravity)
    # The pin between the beams is internal; only the wall acts from outside. Newton's method
    # leaves 1e-13 of the forces, which add up over the recursion for a_{n+1} by
    # 1/(1 - 0.3/0.7) < 2 and over 4 d coordinates.
    expected = weight + solution.reaction("wall")
    assert np.max(np.abs(rate - expected)) <= 1e-11 * np.max(np.abs(expected))


def test_reaction_of_a_pin_is_what_accelerates_the_first_beam(solution):
    # On the second beam alone act its weight and minus the pin's reaction on the first.
    scene = mechanism(dimension_of(solution))
    d = dimension_of(solution)
    rod = solution.naming.layout.body("rod")
    alone = Scene([scene.beam("rod")], gravity=scene.gravity)
    first = rod.first_vector * d
    part = dataclasses.replace(solution, a=solution.a[:, first:])
    rate, weights = total_momentum_rate(alone, part)
    mass = weights.reshape(d, -1, d + 1, d)[0, :, 0, 0].sum()
    expected = mass * np.array(scene.gravity) - solution.reaction("pivot")
    assert np.max(np.abs(rate - expected)) <= 1e-11 * np.max(np.abs(expected))  # as above


def test_multipliers_are_the_rows_of_the_joint(solution):
    d = dimension_of(solution)
    rows = 3 if d == 2 else 7  # place, turn, and in space shear of the section in its plane
    assert np.array_equal(solution.multipliers("wall"), solution.lam[:, :rows])
    assert np.array_equal(solution.multipliers("pivot"), solution.lam[:, rows:])
    assert np.array_equal(solution.reaction("pivot"), -solution.multipliers("pivot"))
    assert np.array_equal(solution.reaction("wall"), -solution.lam[:, :d])


def equilibrium(scene):
    """Node state at rest under gravity, by Newton's method on Q = B^T lam, Phi = 0."""
    system = assemble(scene)
    q, lam = system.start()[0].copy(), np.zeros(system.n_lam)
    B = system.constraint_q(0.0, q)
    matrices = SaddlePoint(system.pattern, system.constraint_pattern, system.weights, B)
    v = np.zeros(system.n_q)
    for _ in range(12):
        right = system.force(0.0, q, v) - constraint_force(system, 0.0, q, lam)
        right = np.concatenate([right, -system.constraint(0.0, q)])
        x = matrices.factor(-force_q(system, 0.0, q, v), B).solve(right)
        q, lam = q + x[: system.n_q], lam + x[system.n_q :]
    return q.reshape(-1, system.naming.layout.bodies[0].stride, system.naming.layout.d)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_beam_hanging_at_rest_stays_there_and_its_clamp_carries_the_weight(dimension):
    down = np.eye(dimension)[1]
    rod = Beam("rod", (0.0,) * dimension, tuple(-1.2 * down), 3, SECTION, SOFT)
    scene = Scene([rod], [Clamp(rod.at_start, name="wall")], gravity=tuple(-9.81 * down))
    state = equilibrium(scene)
    assert state[-1, 0, 1] < -1.2  # it is stretched
    hanging = dataclasses.replace(scene, start=[NodalState("rod", state)])
    solution = simulate(hanging, 0.5, HHT(1 / 32))
    assert solution.outcome.success
    # Newton's method leaves 1e-13 of the force, that is 1e-13 of g in the accelerations of the
    # rod and much more in the light slopes; half a second of it and of the round-off of the
    # elastic force (EA eps against the weight of 31 N: 2400 eps/31) moves nothing further than:
    assert np.max(np.abs(solution.position(MaterialPoint("rod", 1.0)) - state[-1, 0])) <= 1e-10
    weight = 1100.0 * 0.06 * 0.04 * 1.2 * 9.81
    assert np.max(np.abs(solution.reaction("wall") - weight * down)) <= 1e-10 * weight


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_scene_without_any_force_is_integrated(dimension):
    # Forces are pure round-off here, and a convergence test relative to them never ends.
    zeros = (0.0,) * dimension
    rod = Beam("rod", (0.3,) * dimension, (1.1, 0.9, 0.2)[:dimension], 3, SECTION, SOFT)
    at_rest = simulate(Scene([rod], [Pin(rod.at_start)]), T_END, HHT(STEP))
    assert at_rest.outcome.success
    assert np.max(np.abs(at_rest.q - at_rest.q[0])) <= 1e-12
    spin = 0.0 if dimension == 2 else zeros
    motion = InitialVelocity("rod", spin, zeros, (1.0, 2.0, 3.0)[:dimension])
    drifting = simulate(Scene([rod], start=[motion]), T_END, HHT(STEP))
    assert drifting.outcome.success
    path = (
        drifting.position(MaterialPoint("rod", 1.0))
        - drifting.position(MaterialPoint("rod", 1.0))[0]
    )
    expected = drifting.t[:, None] * np.array((1.0, 2.0, 3.0)[:dimension])
    assert np.max(np.abs(path - expected)) <= 1e-12


# ---------------------------------------------------------------- derivatives of observables


FUNCTIONS = {
    "position between nodes": lambda s: s.position(MaterialPoint("rod", 0.45, y=0.01)),
    "position at the tip": lambda s: s.position(MaterialPoint("rod", 1.0)),
    "velocity between nodes": lambda s: s.velocity(MaterialPoint("rod", 0.8)),
    "acceleration between nodes": lambda s: s.acceleration(MaterialPoint("rod", 0.8)),
    "slope between nodes": lambda s: s.slope(MaterialPoint("rod", 0.45, y=0.01), 0),
    "slope across": lambda s: s.slope(MaterialPoint("bow", 0.3), 1),
    "reaction": lambda s: s.reaction("wall"),
    "a nonlinear one": lambda s: (
        np.sum(s.position(MaterialPoint("rod", 0.7)) ** 2, axis=1) * s.lam[:, 0]
    ),
    "one of the times": lambda s: s.t * s.position(MaterialPoint("rod", 0.3))[:, 0],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivative_is_the_complex_step_of_the_whole_run(solution, name, complex_runs):
    function = FUNCTIONS[name]
    derivative = solution.derivative(function)
    expected = np.stack(
        [function(run).imag / size for run, size in complex_runs[dimension_of(solution)]],
        axis=-1,
    )
    assert derivative.shape == expected.shape
    for i in range(len(DESIGN)):
        # Both are exact derivatives of the discrete solution; round-off of 16 steps with factors
        # of conditions below 1e4 each: 1e-9.
        assert_close(derivative[..., i], expected[..., i], 1e-9)


@pytest.fixture(scope="module")
def complex_runs():
    """Runs of the perturbed scenes themselves: their naming has complex lengths."""
    runs = {}
    for dimension in (2, 3):
        system = assemble(mechanism(dimension), DESIGN)
        runs[dimension] = []
        for i, value in enumerate(system.b):
            b = system.b.astype(complex)
            b[i] += 1e-40j * value
            run = HHT(STEP).integrate(system.with_values(b), T_END)
            runs[dimension].append((run, 1e-40 * value))
    return runs


def test_length_moves_a_point_between_nodes_beyond_what_its_nodes_do(solution):
    # The shape functions depend on the length: leaving that out must show.
    frozen = dataclasses.replace(
        solution.naming, lengths_b=np.zeros_like(solution.naming.lengths_b)
    )
    other = dataclasses.replace(solution, naming=frozen)
    i = solution.design_index("rod.length")
    at = FUNCTIONS["position between nodes"]
    change = solution.derivative(at)[..., i] - other.derivative(at)[..., i]
    assert np.max(np.abs(change)) > 1e-3


def test_derivatives_of_the_coordinates_are_the_sensitivities(solution):
    s = solution.sensitivities
    for name, expected in (("q", s.q_b), ("v", s.v_b), ("a", s.a_b), ("lam", s.lam_b)):
        value = solution.derivative(lambda x, name=name: getattr(x, name))
        assert_close(value, expected, 1e-15)  # one product and one division


def test_derivative_by_complex_step_is_that_by_direct_differentiation(solution):
    scene = mechanism(dimension_of(solution))
    other = differentiate(scene, T_END, HHT(STEP), design=DESIGN, method=ComplexStep())
    at = FUNCTIONS["position between nodes"]
    for i in range(len(DESIGN)):
        assert_close(other.derivative(at)[..., i], solution.derivative(at)[..., i], 1e-9)  # above


@pytest.mark.parametrize(
    "function",
    [
        lambda s: np.abs(s.position(MaterialPoint("rod", 1.0))),
        lambda s: np.linalg.norm(s.position(MaterialPoint("rod", 1.0)), axis=1),
        lambda s: s.q.real,
        lambda s: s.t,
    ],
    ids=["abs", "norm", "real", "constant"],
)
def test_function_that_drops_the_imaginary_part_is_refused(solution, function):
    with pytest.raises(
        InvalidInputError, match=r"function of a solution: must keep the imaginary part"
    ):
        solution.derivative(function)


def test_derivative_without_sensitivities_is_refused(solution):
    bare = dataclasses.replace(solution, sensitivities=None)
    for action in (lambda: bare.derivative(lambda s: s.q), lambda: bare.design_index("E")):
        with pytest.raises(InvalidInputError, match="Call `differentiate`"):
            action()


def test_derivative_in_no_design_variable_is_empty():
    scene = mechanism(2)
    solution = DirectDifferentiation().differentiate(Run(assemble(scene), STEP, HHT(STEP)))
    value = solution.derivative(lambda s: s.position(MaterialPoint("rod", 1.0)))
    assert value.shape == (2, 2, 0)


def test_differentiation_in_the_density_alone_works():
    # No element parameter that enters the elastic force is driven.
    scene = mechanism(2)
    direct = differentiate(scene, T_END, HHT(STEP), design=["rod.density"])
    stepped = differentiate(scene, T_END, HHT(STEP), design=["rod.density"], method=ComplexStep())
    assert_close(direct.sensitivities.q_b, stepped.sensitivities.q_b, 1e-9)  # as above


def test_design_index_is_the_place_in_the_last_axis(solution):
    assert [solution.design_index(name) for name in DESIGN] == [0, 1, 2]


# ---------------------------------------------------------------- files


def identical(a, b):
    """Whether two values are the same to the last bit, with the same types."""
    if dataclasses.is_dataclass(a):
        names = [field.name for field in dataclasses.fields(a)]
        return type(a) is type(b) and all(identical(getattr(a, n), getattr(b, n)) for n in names)
    if isinstance(a, np.ndarray):
        same = isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape
        return same and np.array_equal(a, b)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(identical, a, b))
    return type(a) is type(b) and a == b


def test_the_comparison_of_this_file_notices_differences(solution):
    assert identical(solution, solution)
    for changes in (
        {"q": solution.q + 1e-16},
        {"lam": solution.lam.astype(np.float32)},
        {"sensitivities": None},
        {"naming": None},
        {"statistics": dataclasses.replace(solution.statistics, steps=1)},
    ):
        assert not identical(solution, dataclasses.replace(solution, **changes))


@pytest.mark.parametrize("drop", [{}, {"sensitivities": None}, {"naming": None}])
def test_every_field_survives_the_round_trip(solution, drop, tmp_path):
    solution = dataclasses.replace(solution, **drop)
    path = tmp_path / "run.npz"
    assert solution.save(path) == path
    assert identical(load_solution(path), solution)
    assert identical(load_solution(str(path)), solution)
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]


def test_loaded_solution_answers_as_the_original(solution, tmp_path):
    loaded = load_solution(solution.save(tmp_path / "run.npz"))
    for function in FUNCTIONS.values():
        assert np.array_equal(function(loaded), function(solution))
        assert np.array_equal(loaded.derivative(function), solution.derivative(function))


@pytest.mark.parametrize("verdict", Verdict)
@pytest.mark.parametrize("residual", [0.0, 0.1, np.inf, np.nan])
def test_every_outcome_survives_the_round_trip(solution, verdict, residual, tmp_path):
    outcome = RunOutcome(verdict, 0.3, 2, residual)
    changed = dataclasses.replace(solution, outcome=outcome)
    loaded = load_solution(changed.save(tmp_path / "run.npz")).outcome
    assert loaded.verdict is verdict
    assert loaded.success == (verdict in (Verdict.FINISHED, Verdict.EQUILIBRIUM))
    assert str(loaded) == str(outcome)


def test_complex_solution_survives_the_round_trip(solution, complex_runs, tmp_path):
    run = complex_runs[dimension_of(solution)][0][0]
    assert np.any(run.q.imag)
    assert identical(load_solution(run.save(tmp_path / "run.npz")), run)


def test_numbers_of_numpy_as_settings_can_be_saved(tmp_path):
    scene = mechanism(2)
    for step in (np.float64(STEP), np.float32(STEP)):
        solution = simulate(scene, 2 * STEP, HHT(step))
        loaded = load_solution(solution.save(tmp_path / "run.npz"))
        assert loaded.outcome.time == pytest.approx(2 * STEP)  # powers of two


def test_files_hold_no_pickled_objects(solution, tmp_path):
    path = solution.save(tmp_path / "run.npz")
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}  # raises for an object array
    assert all(array.dtype.kind in "fcU" for array in arrays.values())
    assert json.loads(str(arrays["meta"]))["format"] == "ancfdae solution 10"


def test_object_arrays_are_not_written(solution, tmp_path):
    pickled = dataclasses.replace(solution, t=np.array([object()]))
    with pytest.raises(InvalidInputError, match="got objects in t"):
        pickled.save(tmp_path / "run.npz")
    assert not list(tmp_path.iterdir())


def test_saving_replaces_an_old_file(solution, tmp_path):
    path = tmp_path / "run.npz"
    path.write_bytes(b"old")
    solution.save(path)
    assert identical(load_solution(path), solution)


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
@pytest.mark.parametrize("old", [False, True])
def test_failed_save_leaves_what_was_there(solution, error, old, tmp_path, monkeypatch):
    path = tmp_path / "run.npz"
    if old:
        solution.save(path)
        before = path.read_bytes()

    def write_garbage(file, **_):
        file.write(b"garbage")
        raise error

    monkeypatch.setattr(np, "savez", write_garbage)
    with pytest.raises(type(error)):
        dataclasses.replace(solution, q=2 * solution.q).save(path)
    assert [p.name for p in tmp_path.iterdir()] == (["run.npz"] if old else [])
    if old:
        assert path.read_bytes() == before
        assert identical(load_solution(path), solution)


def test_saved_file_has_the_permissions_of_an_ordinary_file(solution, tmp_path):
    ordinary = tmp_path / "ordinary"
    ordinary.touch()
    path = solution.save(tmp_path / "run.npz")
    assert stat.filemode(path.stat().st_mode) == stat.filemode(ordinary.stat().st_mode)


def archive(path, **arrays):
    np.savez(path, **arrays)
    return path.read_bytes()


def meta(**changes):
    return np.array(json.dumps({"format": "ancfdae solution 10", **changes}))


def of_format(good, name):
    """Arrays of a good file that says another format and is right otherwise."""
    with np.load(io.BytesIO(good)) as file:
        arrays = dict(file)
    arrays["meta"] = np.array(str(arrays["meta"]).replace("ancfdae solution 10", name))
    return arrays


def changed(path, good, *names, how=None):
    """The file with some arrays changed."""
    *names, how = (*names, how) if how is not None else names
    with np.load(io.BytesIO(good)) as file:
        arrays = dict(file)
    return archive(path, **(arrays | {name: how(arrays[name]) for name in names}))


BROKEN = {
    "empty": lambda path, good: b"",
    "text": lambda path, good: b"not a solution",
    "truncated": lambda path, good: good[: len(good) // 2],
    "one byte short": lambda path, good: good[:-1],
    "head only": lambda path, good: good[:4],
    "flipped bytes": lambda path, good: good[:200] + good[299:199:-1] + good[300:],
    "other archive": lambda path, good: archive(path, x=np.zeros(3)),
    "other format": lambda path, good: archive(path, **of_format(good, "ancfdae solution 2")),
    "no object": lambda path, good: archive(path, meta=np.array("[]")),
    "no JSON": lambda path, good: archive(path, meta=np.array("{")),
    "nothing else": lambda path, good: archive(path, meta=meta()),
    "wrong fields": lambda path, good: archive(path, meta=meta(outcome=3, layout=4, names=5)),
    "bad layout": lambda path, good: archive(
        path, meta=meta(outcome={"verdict": "FINISHED"}, layout="x", names=None)
    ),
    "bad verdict": lambda path, good: archive(path, meta=meta(outcome={"verdict": "LOST"})),
    "fewer velocities": lambda path, good: changed(path, good, "v", lambda x: x[:-1]),
    "fewer coordinates": lambda path, good: changed(path, good, *"qva", how=lambda x: x[:, :-2]),
    "fewer multipliers": lambda path, good: changed(path, good, "lam", lambda x: x[:, :-1]),
    "derivatives of fewer": lambda path, good: changed(
        path, good, "sensitivity_q_b", lambda x: x[..., :-1]
    ),
    "texts": lambda path, good: changed(path, good, "a", lambda x: x.astype(str)),
    "turned instants": lambda path, good: changed(path, good, "t", lambda x: x[::-1]),
    "no instants": lambda path, good: changed(path, good, "t", *"qva", "lam", how=lambda x: x[:0]),
    "more lengths": lambda path, good: changed(path, good, "lengths", lambda x: [*x, 1.0]),
    "a number": lambda path, good: changed(path, good, "q", lambda x: x[0, 0]),
    "complex instants": lambda path, good: changed(path, good, "t", lambda x: x + 0j),
    "lengths in words": lambda path, good: changed(path, good, "lengths", lambda x: x.astype(str)),
    "pickled": lambda path, good: archive(path, meta=np.array([{}], dtype=object)),
}


@pytest.mark.parametrize("name", BROKEN)
def test_loading_what_is_no_solution_names_the_file(solution, name, tmp_path):
    good = solution.save(tmp_path / "good.npz").read_bytes()
    broken = BROKEN[name](tmp_path / "scratch.npz", good)
    path = tmp_path / "broken.npz"
    path.write_bytes(broken)
    with pytest.raises(InvalidInputError, match=r"Solution\.save") as error:
        load_solution(path)
    assert str(path) in error.value.where


def test_loading_a_plain_array_names_the_file(tmp_path):
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(InvalidInputError, match=r"array\.npy"):
        load_solution(tmp_path / "array.npy")


def test_loading_a_file_that_is_not_there_says_so(tmp_path):
    with pytest.raises(InvalidInputError, match=r"must exist; got .*nowhere"):
        load_solution(tmp_path / "nowhere.npz")


def test_statistics_count_what_happened(solution):
    statistics = solution.statistics
    assert statistics.steps == len(solution.t) - 1 == 16
    assert statistics.residuals == statistics.iterations >= statistics.steps
    assert statistics.factorisations >= statistics.steps  # one per step for the sensitivities
    assert statistics.wall_seconds > 0
    assert isinstance(statistics, Statistics)


def flipped(rng, data):
    data[rng.integers(len(data))] ^= int(rng.integers(1, 256))
    return data


def zeroed(rng, data):
    first = rng.integers(len(data))
    data[first : first + 48] = bytes(len(data[first : first + 48]))
    return data


def without_end(rng, data):
    return data[: rng.integers(len(data))]


@pytest.mark.parametrize("damage", [flipped, zeroed, without_end])
def test_damaged_hdf5_is_refused_in_words(solution, tmp_path, damage):
    """Before HDF5 2.0 reads it, which ends the process at some tables of zeros."""
    pytest.importorskip("h5py")
    good, path = solution.save(tmp_path / "run.h5").read_bytes(), tmp_path / "damaged.h5"
    rng = np.random.default_rng(3)
    for _ in range(300):
        data = bytes(damage(rng, bytearray(good)))
        if data == good:
            continue
        path.write_bytes(data)
        with pytest.raises(InvalidInputError, match="must be a whole file written by"):
            load_solution(path)


def test_hdf5_files_are_those_of_other_programs(solution, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(solution.save(tmp_path / "run.h5"), "r") as file:
        np.testing.assert_array_equal(file["q"][()], solution.q)
