"""Invariant matrices and what follows from them, against plain quadrature and complex steps.

Tolerances are relative to the largest entry of what they compare. Round-off: a number is a sum
over at most 45 (straight) or 432 (curved) quadrature points of products whose absolute values
exceed the result by the cancellation in g - g_o: the states have strains of about 0.1, so that
terms of size one leave a tenth, in the energy (strain squared) a hundredth. Errors being random,
a sum of n terms carries about sqrt(n) eps, 20 eps for the curved rule; ten times that for the
force is 5e-14, and CLOSE = 1e-13 leaves a factor of two. A wrong term shows at order one.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ancfdae.elements import BEAM_2D, BEAM_3D, ElementParameter, elastic, invariants
from ancfdae.elements.invariants import prepare
from ancfdae.errors import InvalidInput

from oracle import plain_ancf as ancf

CLOSE = 1e-13
# A complex step has no truncation error (STEP^2 vanishes against one); what is left is the
# round-off of two different evaluations of one derivative, with the cancellation between the
# terms of the product rule on top of CLOSE: a factor of ten.
DERIVATIVE = 1e-12
STEP = 1e-40
VALUES = np.array([2.1e6, 0.3, 2770.0, 0.06, 0.04, 0.7])
ELEMENTS = {2: BEAM_2D, 3: BEAM_3D}
ELASTIC = [which for which in ElementParameter if which is not ElementParameter.DENSITY]
LENGTH = VALUES[ElementParameter.LENGTH]


def arc(dim, angle=1.3, pitch=0.0):
    """Node vectors of an arc (spatial with a pitch: of a helix) of length LENGTH."""
    radius = LENGTH / (angle * np.sqrt(1 + pitch**2))
    rows = []
    for theta in (0.0, angle):
        tangent = np.array([np.cos(theta), np.sin(theta), pitch]) / np.sqrt(1 + pitch**2)
        normal = np.array([-np.sin(theta), np.cos(theta), 0.0])
        place = radius * np.array([np.sin(theta), 1 - np.cos(theta), pitch * theta])
        rows += [place, tangent, normal] + [np.cross(tangent, normal)] * (dim == 3)
    return np.array(rows)[:, :dim]


REFERENCES = {
    "planar straight": ancf.straight_reference(2, LENGTH),
    "planar arc": arc(2),
    "spatial straight": ancf.straight_reference(3, LENGTH),
    "spatial helix": arc(3, pitch=0.4),
}


class Case:
    """One element with its invariants, and the same element for the oracle."""

    def __init__(self, name):
        self.X_o = REFERENCES[name]
        self.dim = self.X_o.shape[1]
        self.element = ELEMENTS[self.dim]
        self.straight = name.endswith("straight")
        self.Y_unit = self.relative(self.X_o)
        self.Y_unit[:, 0] /= LENGTH
        self.inv = self.prepare(VALUES, ElementParameter)
        self.rule = {} if self.straight else {"n_xi": 12, "n_y": 6, "n_z": 6}

    def prepare(self, values, wanted=()):
        return prepare(self.element, values[None], self.Y_unit, self.straight, wanted)

    def relative(self, X):
        """Relative node vectors of one element, with the leading axis of a block."""
        n_s = self.element.n_s
        return np.concatenate([[X[n_s] - X[0]], X[1:n_s], X[n_s + 1 :]])[None]

    def absolute(self, F):
        """Force in node vectors X from the force in Y: r_1 gets minus the first row."""
        n_s = self.element.n_s
        slopes_1, slopes_2 = F[0, 1:n_s], F[0, n_s:]
        return np.concatenate([-F[0, :1], slopes_1, F[0, :1], slopes_2])

    def force(self, X, inv=None):
        inv = inv or self.inv
        return self.absolute(elastic.force(inv.A, inv.g_o, self.relative(X)))

    def tangent(self, X):
        """Hessian in X: the linear map X -> Y applied on both sides."""
        identity = np.eye(X.size).reshape(X.size, *X.shape)
        R = np.stack([self.relative(unit)[0].ravel() for unit in identity], axis=1)
        return R.T @ elastic.tangent(self.inv.A, self.inv.g_o, self.relative(X))[0] @ R

    def state(self, seed):
        return ancf.random_state(self.dim, np.random.default_rng(seed), LENGTH, self.X_o)

    def elastic_arguments(self):
        E, nu, _, h, w, l = VALUES
        return (E, nu, h, w, l, self.X_o)

    def inertial_arguments(self):
        _, _, rho, h, w, l = VALUES
        return (rho, h, w, l, self.X_o)

    def moved_reference(self, values):
        """Node vectors of the reference for the oracle: the chord follows the length."""
        X_o = self.X_o.astype(values.dtype)
        X_o[self.element.n_s] = X_o[0] + values[ElementParameter.LENGTH] * self.Y_unit[0, 0]
        return X_o


@pytest.fixture(scope="module", params=REFERENCES)
def case(request):
    return Case(request.param)


def assert_close(value, expected, tolerance):
    scale = np.max(np.abs(expected))
    assert scale > 0  # nothing to compare with would make the test empty
    assert np.shape(value) == np.shape(expected)
    assert np.max(np.abs(value - expected)) <= tolerance * scale


def perturbed(which):
    values = VALUES.astype(complex)
    size = STEP * values[which].real
    values[which] += 1j * size
    return values, size


# ---------------------------------------------------------------- against the oracle


@pytest.mark.parametrize("seed", range(3))
def test_energy_is_that_of_plain_quadrature(case, seed):
    X = case.state(seed)
    U = elastic.energy(case.inv.A, case.inv.g_o, case.relative(X))
    expected = np.array([ancf.energy(X, *case.elastic_arguments(), **case.rule)])
    # Ten times CLOSE: the cancellation counts twice, see the module's text.
    assert_close(U, expected, 10 * CLOSE)


@pytest.mark.parametrize("seed", range(3))
def test_force_is_that_of_plain_quadrature(case, seed):
    X = case.state(seed)
    assert_close(case.force(X), ancf.force(X, *case.elastic_arguments(), **case.rule), CLOSE)


def test_tangent_is_that_of_plain_quadrature(case):
    X = case.state(3)
    assert_close(case.tangent(X), ancf.tangent(X, *case.elastic_arguments(), **case.rule), CLOSE)


def test_mass_is_that_of_plain_quadrature(case):
    expected = ancf.mass(case.dim, *case.inertial_arguments(), **case.rule)
    assert_close(np.kron(case.inv.m[0], np.eye(case.dim)), expected, CLOSE)


def test_gravity_is_the_mass_invariant_summed_over_positions(case):
    g = np.array([1.3, -9.81, 0.7])[: case.dim]
    positions = np.zeros(case.element.n_a)
    positions[[0, case.element.n_s]] = 1.0
    value = np.outer(case.inv.m[0] @ positions, g)
    assert_close(value, ancf.gravity_force(g, *case.inertial_arguments(), **case.rule), CLOSE)


def test_straight_rule_is_exact():
    # More points change nothing; each rule sums its own terms, hence twice CLOSE.
    for dim in (2, 3):
        case = Case(f"{'planar' if dim == 2 else 'spatial'} straight")
        X = case.state(5)
        finer = {"n_xi": 8, "n_y": 5, "n_z": 5}
        assert_close(case.force(X), ancf.force(X, *case.elastic_arguments(), **finer), 2 * CLOSE)
        expected = ancf.mass(dim, *case.inertial_arguments(), **finer)
        assert_close(np.kron(case.inv.m[0], np.eye(dim)), expected, 2 * CLOSE)


def test_force_and_tangent_are_those_of_the_papers_tensors(case):
    # The tensors act on absolute positions; near the origin that costs nothing. The sum over
    # N^2 = 144 or 576 products e_m C_ijmn e_n has cancellation of its own: K_1 e and K_2 e are of
    # size 1 and leave the strain of 0.1 as in the module's text, but each sum has 12 or 24 times
    # as many terms as one over g, sqrt(24) = 5 times the round-off.
    K_1, C_K2 = ancf.paper_tensors(case.dim, *case.elastic_arguments(), **case.rule)
    X = case.state(7)
    X = X - 0.5 * (X[0] + X[case.element.n_s]) * positions_column(case)
    assert_close(case.force(X), ancf.paper_force(X, K_1, C_K2), 5 * CLOSE)
    assert_close(case.tangent(X), ancf.paper_tangent(X, K_1, C_K2), 5 * CLOSE)


def positions_column(case):
    column = np.zeros((case.element.n_a, 1))
    column[[0, case.element.n_s]] = 1.0
    return column


# ---------------------------------------------------------------- design derivatives


@pytest.mark.parametrize("which", ElementParameter)
def test_derivative_invariants_are_the_complex_step_of_prepare(case, which):
    values, size = perturbed(which)
    inv, partial = case.prepare(values), case.inv.partials[which]
    # c is what a moving reference adds: A dg_o/db.
    for derivative, by_step, scale in (
        (partial.A, inv.A.imag / size, case.inv.A),
        (partial.c, (case.inv.A @ (inv.g_o.imag / size)[0]), case.inv.A),
        (partial.m, inv.m.imag / size, case.inv.m),
    ):
        # Where the exact derivative vanishes there is nothing to be relative to but the
        # quantity itself per value of the parameter.
        scale = max(np.max(np.abs(by_step)), np.max(np.abs(scale)) / VALUES[which])
        assert derivative.shape == by_step.shape
        assert np.max(np.abs(derivative - by_step)) <= DERIVATIVE * scale


def test_each_parameter_moves_what_it_should(case):
    # Without this the comparison of zero with zero above would pass unnoticed.
    for which in ElementParameter:
        partial = case.inv.partials[which]
        in_A = which is not ElementParameter.DENSITY
        in_m = which not in (ElementParameter.YOUNGS_MODULUS, ElementParameter.POISSON_RATIO)
        assert np.any(partial.A) == in_A
        assert np.any(partial.m) == in_m
        assert np.any(partial.c) == (which is ElementParameter.LENGTH)


@pytest.mark.parametrize("which", ELASTIC)
def test_force_partial_is_the_complex_step_of_the_oracle(case, which):
    X, (values, size) = case.state(11), perturbed(which)
    E, nu, _, h, w, l = values
    X_o = case.moved_reference(values)
    by_step = ancf.force(X.astype(complex), E, nu, h, w, l, X_o, **case.rule).imag / size
    partial = case.inv.partials[which]
    F_b = elastic.force_partial(partial.A, partial.c, case.inv.g_o, case.relative(X))
    assert_close(case.absolute(F_b), by_step, DERIVATIVE)


@pytest.mark.parametrize("which", ELASTIC)
def test_force_partial_and_its_direction_are_complex_steps_of_force(case, which):
    X, U = case.state(12), case.state(13)
    Y, V = case.relative(X), case.relative(U)
    partial, (values, size) = case.inv.partials[which], perturbed(which)
    inv = case.prepare(values)
    by_step = elastic.force(inv.A, inv.g_o, Y).imag / size
    F_b = elastic.force_partial(partial.A, partial.c, case.inv.g_o, Y)
    assert_close(F_b, by_step, DERIVATIVE)
    # Direction: the derivative of F_b in Y.
    moved = elastic.force_partial(partial.A, partial.c, case.inv.g_o, Y + 1j * STEP * V)
    F_bu = elastic.force_partial_direction(partial.A, partial.c, case.inv.g_o, Y, V)
    assert_close(F_bu, moved.imag / STEP, DERIVATIVE)
    # And the other order: the complex step in the parameter of the directional derivative.
    other = elastic.force_direction(inv.A, inv.g_o, Y, V).imag / size
    assert_close(F_bu, other, DERIVATIVE)


def test_mass_partials_are_the_complex_step_of_the_oracle(case):
    for which in (ElementParameter.DENSITY, *list(ElementParameter)[3:]):
        values, size = perturbed(which)
        _, _, rho, h, w, l = values
        X_o = case.moved_reference(values)
        by_step = ancf.mass(case.dim, rho, h, w, l, X_o, **case.rule).imag / size
        value = np.kron(case.inv.partials[which].m[0], np.eye(case.dim))
        assert_close(value, by_step, DERIVATIVE)


# ---------------------------------------------------------------- derivatives in the coordinates


def test_force_is_the_complex_step_of_the_energy(case):
    Y = case.relative(case.state(21))
    gradient = np.zeros_like(Y)
    for k in range(Y.size):
        moved = Y.astype(complex)
        moved.flat[k] += 1j * STEP
        gradient.flat[k] = elastic.energy(case.inv.A, case.inv.g_o, moved)[0].imag / STEP
    assert_close(elastic.force(case.inv.A, case.inv.g_o, Y), gradient, DERIVATIVE)


def test_force_direction_is_the_complex_step_of_force_and_the_tangent_times_it(case):
    Y, U = case.relative(case.state(22)), case.relative(case.state(23))
    A, g_o = case.inv.A, case.inv.g_o
    F_u = elastic.force_direction(A, g_o, Y, U)
    assert_close(F_u, elastic.force(A, g_o, Y + 1j * STEP * U).imag / STEP, DERIVATIVE)
    product = (elastic.tangent(A, g_o, Y)[0] @ U.ravel()).reshape(U.shape)
    assert_close(F_u, product, DERIVATIVE)


def test_force_second_direction_is_the_complex_step_of_force_direction(case):
    Y, U, V = (case.relative(case.state(seed)) for seed in (24, 25, 26))
    A, g_o = case.inv.A, case.inv.g_o
    F_uv = elastic.force_second_direction(A, Y, U, V)
    moved = elastic.force_direction(A, g_o, Y + 1j * STEP * V, U)
    assert_close(F_uv, moved.imag / STEP, DERIVATIVE)


def test_tangent_is_symmetric(case):
    K = elastic.tangent(case.inv.A, case.inv.g_o, case.relative(case.state(27)))
    assert_close(K, K.transpose(0, 2, 1), CLOSE)


# ---------------------------------------------------------------- invariance


@settings(max_examples=25)
@given(
    name=st.sampled_from(sorted(REFERENCES)),
    seed=st.integers(0, 10**6),
    shift=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
)
def test_energy_is_invariant_under_rigid_motion_and_force_turns_along(name, seed, shift):
    case = CASES[name]
    X, rng = case.state(seed), np.random.default_rng(seed + 1)
    R = ancf.random_rotation(case.dim, rng)
    moved = X @ R.T
    moved[[0, case.element.n_s]] += np.array(shift)[: case.dim]
    before, after = case.relative(X), case.relative(moved)
    U, V = (elastic.energy(case.inv.A, case.inv.g_o, Y) for Y in (before, after))
    # Moving by 1 m rounds r_2 - r_1 (0.7 m) by 2 eps; divided by a strain of 0.1 and twice in
    # the energy that is 40 eps = 1e-14, below the round-off of the sums.
    assert_close(V, U, 10 * CLOSE)
    assert_close(case.force(moved), case.force(X) @ R.T, 2 * CLOSE)


CASES = {name: Case(name) for name in REFERENCES}


def test_rigid_motion_of_the_reference_stores_no_energy(case):
    rng = np.random.default_rng(31)
    X = case.X_o @ ancf.random_rotation(case.dim, rng).T
    U = elastic.energy(case.inv.A, case.inv.g_o, case.relative(X))[0]
    # g - g_o is 10 eps at most, and U quadratic in it: 100 eps^2 |A|, summed over all entries.
    size = case.inv.A.shape[1]
    assert 0 <= abs(U) <= 100 * np.finfo(float).eps ** 2 * size**2 * np.max(np.abs(case.inv.A))


def test_force_is_right_a_thousand_metres_from_the_origin(case):
    # Positions at 1000 m are rounded to 0.6e-13 m, relative to a stretch of 0.1 * 0.7 m twice
    # 1e-12 at both ends; a Gram matrix of absolute positions would be off by
    # eps (1000/0.7)^2 / 0.1 = 5e-9.
    X = case.state(41)
    far = X + 1000.0 * positions_column(case)
    assert_close(case.force(far), case.force(X), 1e-11)


# ---------------------------------------------------------------- blocks of elements


@pytest.mark.parametrize(("chunk", "n"), [(2, 5), (256, 300)], ids=["small", "default"])
def test_preparation_in_chunks_is_the_preparation_of_each(case, chunk, n, monkeypatch):
    if chunk == 256 and not case.straight:
        n = 257  # the fine rule makes the block expensive; one element more than a chunk will do
    assert invariants._CHUNK == 256
    monkeypatch.setattr(invariants, "_CHUNK", chunk)
    rng = np.random.default_rng(51)
    parameters = VALUES * (1 + 0.1 * rng.uniform(-1, 1, (n, 6)))
    wanted = (ElementParameter.LENGTH,)
    whole = prepare(
        case.element, parameters, np.repeat(case.Y_unit, n, axis=0), case.straight, wanted
    )
    assert len(whole.A) == n > chunk
    for k in (0, chunk - 1, chunk, n - 1):
        one = prepare(case.element, parameters[k : k + 1], case.Y_unit, case.straight, wanted)
        # The same sums, possibly in another order of the linear algebra library.
        for a, b in (
            (whole.A[k], one.A[0]),
            (whole.g_o[k], one.g_o[0]),
            (whole.m[k], one.m[0]),
            (whole.partials[wanted[0]].A[k], one.partials[wanted[0]].A[0]),
            (whole.partials[wanted[0]].c[k], one.partials[wanted[0]].c[0]),
            (whole.partials[wanted[0]].m[k], one.partials[wanted[0]].m[0]),
        ):
            assert_close(a, b, CLOSE)


def test_block_of_different_states_is_each_state_alone(case):
    Y = np.concatenate([case.relative(case.state(seed)) for seed in range(4)])
    shared = elastic.force(case.inv.A, case.inv.g_o, Y)
    own = elastic.force(np.repeat(case.inv.A, 4, axis=0), np.repeat(case.inv.g_o, 4, axis=0), Y)
    for k in range(4):
        one = elastic.force(case.inv.A, case.inv.g_o, Y[k : k + 1])[0]
        assert_close(shared[k], one, CLOSE)
        assert_close(own[k], one, CLOSE)


@pytest.mark.parametrize("name", ["planar arc", "spatial helix"])
def test_folded_reference_is_refused(name):
    case = Case(name)
    values = VALUES.copy()
    # The centre of curvature of the arc lies 0.54 m away, of the helix 0.58 m; half of 1.4 m is
    # beyond both.
    values[ElementParameter.HEIGHT] = 1.4
    with pytest.raises(InvalidInput, match="determinant") as error:
        case.prepare(values)
    assert "reference configuration" in error.value.where
    assert error.value.repair
