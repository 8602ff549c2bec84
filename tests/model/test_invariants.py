"""Invariant matrices and what follows from them, against plain quadrature and complex steps.

Tolerances are relative to the largest entry of what they compare. Round-off: a number is a sum
over at most 432 quadrature points, and terms of size one cancel to a strain of 0.1. Random errors
of n terms add up to sqrt(n) eps, 20 eps for 432; the cancellation makes that 200 eps = 5e-14, and
CLOSE = 1e-13 leaves a factor of two. Seen over 40 states: 6e-15 in energy and force. A wrong term
shows at order one.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ancfdae.assembly.elastic_forces import apply_invariant, strain_energy
from ancfdae.errors import InvalidInputError
from ancfdae.kernels import strain, stressed
from ancfdae.model.elements import (
    ALL_ELEMENTS,
    Batch,
    ElementParameter,
    ElementType,
    SaintVenantKirchhoff,
)
from ancfdae.model.elements import continuum as invariants
from ancfdae.model.elements.continuum import prepare
from ancfdae.model.sections.shapes import Rectangle
from tests.support import element_forces
from tests.support.oracle import plain_ancf as ancf
from tests.support.oracle import plain_cable

CLOSE = 1e-13
# A complex step has no truncation error (STEP^2 vanishes against one); what is left is the
# round-off of two different evaluations of one derivative, with the cancellation between the
# terms of the product rule on top of CLOSE: a factor of ten.
DERIVATIVE = 1e-12
STEP = 1e-40
#: E, nu, rho, l, tau, initial strain, height, width.
VALUES = np.array([2.1e6, 0.3, 2770.0, 0.7, 0.02, 0.0, 0.06, 0.04, 0.0, 0.0])
HEIGHT, WIDTH = ElementParameter.SIZE_1, ElementParameter.SIZE_2
GEOMETRIC = (HEIGHT, WIDTH, ElementParameter.LENGTH)
ELEMENTS = {element.name: element for element in ALL_ELEMENTS}
#: What invariants depend on, and what the elastic one does.
INVARIANT = [
    ElementParameter.YOUNGS_MODULUS,
    ElementParameter.POISSON_RATIO,
    ElementParameter.DENSITY,
    *GEOMETRIC,
]
ELASTIC = [which for which in INVARIANT if which is not ElementParameter.DENSITY]
LENGTH = VALUES[ElementParameter.LENGTH]
TAU = VALUES[[ElementParameter.DAMPING_TIME]]


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
    "BEAM_2D straight": ancf.straight_reference(2, LENGTH),
    "BEAM_2D arc": arc(2),
    "BEAM_3D straight": ancf.straight_reference(3, LENGTH),
    "BEAM_3D helix": arc(3, pitch=0.4),
}
# Every other element: straight, with the vectors that it has.
for ELEMENT in ALL_ELEMENTS:
    if ELEMENT.name not in ("BEAM_2D", "BEAM_3D"):
        CHOSEN = [
            int(quantity) + node * (ELEMENT.d + 1)
            for node in (0, 1)
            for quantity in ELEMENT.quantities
        ]
        STRAIGHT = ancf.straight_reference(ELEMENT.d, LENGTH)[CHOSEN]
        REFERENCES[f"{ELEMENT.name} straight"] = STRAIGHT
#: Elements with an oracle of their own.
ORACLES = {"CABLE_2D": plain_cable, "CABLE_3D": plain_cable}


class Case:
    """One element with its invariants, and the same element for the oracle."""

    def __init__(self, name):
        self.X_o = REFERENCES[name]
        self.dim = self.X_o.shape[1]
        self.element = ELEMENTS[name.split()[0]]
        self.oracle = ORACLES.get(self.element.name, ancf)
        self.straight = name.endswith("straight")
        energy = SaintVenantKirchhoff() if self.element.default_energy else None
        self.kind = ElementType(Rectangle(0.06, 0.04), energy, self.straight)
        self.Y_unit = self.relative(self.X_o)
        self.Y_unit[:, 0] /= LENGTH
        self.inv = self.prepare(VALUES)
        self.rule = {} if self.straight else {"n_xi": 12, "n_y": 6, "n_z": 6}

    def prepare(self, values):
        return prepare(self.element, Batch(self.kind, values[None], self.Y_unit))

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
        return self.absolute(
            element_forces.force(inv.A, inv.g_o, self.relative(X), bending=inv.bending)
        )

    def tangent(self, X):
        """Hessian in X: the linear map X -> Y applied on both sides."""
        identity = np.eye(X.size).reshape(X.size, *X.shape)
        R = np.stack([self.relative(unit)[0].ravel() for unit in identity], axis=1)
        return (
            R.T
            @ element_forces.tangent(*self.law, self.relative(X), bending=self.inv.bending)[0]
            @ R
        )

    def state(self, seed):
        return ancf.random_state(self.dim, np.random.default_rng(seed), LENGTH, self.X_o)

    def elastic_arguments(self):
        E, nu, _, l, _, _, h, w = VALUES[:8]
        return (E, nu, h, w, l, self.X_o)

    def inertial_arguments(self):
        _, _, rho, l, _, _, h, w = VALUES[:8]
        return (rho, h, w, l, self.X_o)

    def compare_partial(self, value, expected, which):
        """Compare derivatives; the beam law of a cable has no Poisson's ratio."""
        if self.element.default_energy is None and which is ElementParameter.POISSON_RATIO:
            assert not np.any(value)
            assert not np.any(expected)
        else:
            assert_close(value, expected, DERIVATIVE)

    @property
    def law(self):
        """A and g_o."""
        return self.inv.A, self.inv.g_o

    def moved_stress(self, inv, size):
        """A dg_o/db by a complex step."""
        return self.inv.A @ (inv.g_o.imag / size)[0]

    def flexural(self, inv):
        """E I and length of a cable, nothing of a beam."""
        return np.zeros((1, 2)) if inv.bending is None else inv.bending

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
    U = strain_energy(*case.law, case.relative(X), case.inv.bending)
    expected = np.array([case.oracle.energy(X, *case.elastic_arguments(), **case.rule)])
    assert_close(U, expected, CLOSE)


@pytest.mark.parametrize("seed", range(3))
def test_force_is_that_of_plain_quadrature(case, seed):
    X = case.state(seed)
    expected = case.oracle.force(X, *case.elastic_arguments(), **case.rule)
    assert_close(case.force(X), expected, CLOSE)


def test_tangent_is_that_of_plain_quadrature(case):
    X = case.state(3)
    expected = case.oracle.tangent(X, *case.elastic_arguments(), **case.rule)
    assert_close(case.tangent(X), expected, CLOSE)


def test_mass_is_that_of_plain_quadrature(case):
    expected = case.oracle.mass(case.dim, *case.inertial_arguments(), **case.rule)
    assert_close(np.kron(case.inv.m[0], np.eye(case.dim)), expected, CLOSE)


def test_gravity_is_the_mass_invariant_summed_over_positions(case):
    g = np.array([1.3, -9.81, 0.7])[: case.dim]
    positions = np.zeros(case.element.n_a)
    positions[[0, case.element.n_s]] = 1.0
    value = np.outer(case.inv.m[0] @ positions, g)
    expected = case.oracle.gravity_force(g, *case.inertial_arguments(), **case.rule)
    assert_close(value, expected, CLOSE)


def test_straight_rule_is_exact():
    # More points change nothing; each rule sums its own terms, hence twice CLOSE.
    for dim in (2, 3):
        case = Case(f"BEAM_{dim}D straight")
        X = case.state(5)
        finer = {"n_xi": 8, "n_y": 5, "n_z": 5}
        assert_close(case.force(X), ancf.force(X, *case.elastic_arguments(), **finer), 2 * CLOSE)
        expected = ancf.mass(dim, *case.inertial_arguments(), **finer)
        assert_close(np.kron(case.inv.m[0], np.eye(dim)), expected, 2 * CLOSE)


def test_force_and_tangent_are_those_of_the_papers_tensors(case):
    # The tensors act on absolute positions; near the origin that costs nothing. Their sums have
    # N^2 = 144 or 576 terms that cancel to the strain, so this is the comparison with the least
    # room: 5e-14 was seen on three states.
    if case.oracle is not ancf:
        pytest.skip("the paper has no tensors of this element")
    K_1, C_K2 = ancf.paper_tensors(case.dim, *case.elastic_arguments(), **case.rule)
    X = case.state(7)
    X = X - 0.5 * (X[0] + X[case.element.n_s]) * positions_column(case)
    assert_close(case.force(X), ancf.paper_force(X, K_1, C_K2), CLOSE)
    assert_close(case.tangent(X), ancf.paper_tangent(X, K_1, C_K2), CLOSE)


def positions_column(case):
    column = np.zeros((case.element.n_a, 1))
    column[[0, case.element.n_s]] = 1.0
    return column


# ---------------------------------------------------------------- design derivatives


@pytest.mark.parametrize("which", INVARIANT)
def test_derivative_invariants_are_the_complex_step_of_prepare(case, which):
    values, size = perturbed(which)
    inv, partial = case.prepare(values), case.inv.partials([which])[which]
    # c is what a moving reference takes off the stress: A dg_o/db.
    for derivative, by_step, scale in (
        (partial.A, inv.A.imag / size, case.inv.A),
        (partial.c, case.moved_stress(inv, size), case.inv.A),
        (partial.m, inv.m.imag / size, case.inv.m),
        (partial.bending, case.flexural(inv).imag / size, case.flexural(case.inv)),
    ):
        # Where the exact derivative vanishes there is nothing to be relative to but the
        # quantity itself per value of the parameter.
        scale = max(np.max(np.abs(by_step)), np.max(np.abs(scale)) / VALUES[which])
        assert derivative.shape == by_step.shape
        assert np.max(np.abs(derivative - by_step)) <= DERIVATIVE * scale


def test_each_parameter_moves_what_it_should(case):
    # Without this the comparison of zero with zero above would pass unnoticed.
    for which in INVARIANT:
        partial = case.inv.partials([which])[which]
        unused = (ElementParameter.POISSON_RATIO,) if case.element.default_energy is None else ()
        in_A = which not in (ElementParameter.DENSITY, *unused)
        in_m = which not in (ElementParameter.YOUNGS_MODULUS, ElementParameter.POISSON_RATIO)
        assert np.any(partial.A) == in_A
        assert np.any(partial.m) == in_m
        assert np.any(partial.c) == (which is ElementParameter.LENGTH)
        assert np.any(partial.bending) == (case.inv.bending is not None and in_A)


def test_damping_time_changes_no_invariant(case):
    for damping_time in (0.0, 7.0):
        values = VALUES.copy()
        values[ElementParameter.DAMPING_TIME] = damping_time
        inv = case.prepare(values)
        assert np.array_equal(inv.A, case.inv.A)
        assert np.array_equal(inv.g_o, case.inv.g_o)
        assert np.array_equal(inv.m, case.inv.m)


@pytest.mark.parametrize("which", ELASTIC)
def test_force_partial_is_the_complex_step_of_the_oracle(case, which):
    X, (values, size) = case.state(11), perturbed(which)
    E, nu, _, l, _, _, h, w = values[:8]
    X_o = case.moved_reference(values)
    by_step = case.oracle.force(X.astype(complex), E, nu, h, w, l, X_o, **case.rule).imag / size
    partial, Y = case.inv.partials([which])[which], case.relative(X)
    F_b = element_forces.force_partial((*case.law, case.inv.bending), partial, Y)
    case.compare_partial(case.absolute(F_b), by_step, which)


@pytest.mark.parametrize("tau", [None, TAU], ids=["undamped", "damped"])
@pytest.mark.parametrize("which", ELASTIC)
def test_force_partial_is_the_complex_step_of_force(case, which, tau):
    Y, V = case.relative(case.state(12)), case.relative(case.state(13))
    partial, (values, size) = case.inv.partials([which])[which], perturbed(which)
    inv = case.prepare(values)
    by_step = element_forces.force(inv.A, inv.g_o, Y, V, tau, inv.bending).imag / size
    tau = None if tau is None else np.array([tau])
    F_b = element_forces.force_partial((*case.law, case.inv.bending), partial, Y, V, tau)
    case.compare_partial(F_b, by_step, which)


def test_force_partial_in_the_damping_time_is_the_stress_of_the_strain_rate(case):
    Y, V = case.relative(case.state(12)), case.relative(case.state(13))
    A, g_o = case.inv.A, case.inv.g_o
    by_step = element_forces.force(A, g_o, Y, V, TAU + 1j * STEP).imag / STEP
    rate = apply_invariant(A, strain(None, Y, V, None))
    assert_close(stressed(rate, Y), by_step, DERIVATIVE)


def test_mass_partials_are_the_complex_step_of_the_oracle(case):
    for which in (ElementParameter.DENSITY, *GEOMETRIC):
        values, size = perturbed(which)
        _, _, rho, l, _, _, h, w = values[:8]
        X_o = case.moved_reference(values)
        by_step = case.oracle.mass(case.dim, rho, h, w, l, X_o, **case.rule).imag / size
        value = np.kron(case.inv.partials([which])[which].m[0], np.eye(case.dim))
        assert_close(value, by_step, DERIVATIVE)


# ---------------------------------------------------------------- derivatives in the coordinates


def test_force_is_the_complex_step_of_the_energy(case):
    Y = case.relative(case.state(21))
    gradient = np.zeros_like(Y)
    for k in range(Y.size):
        moved = Y.astype(complex)
        moved.flat[k] += 1j * STEP
        gradient.flat[k] = strain_energy(*case.law, moved, case.inv.bending)[0].imag / STEP
    assert_close(element_forces.force(*case.law, Y, bending=case.inv.bending), gradient, DERIVATIVE)


def by_component(case, Y, function):
    """Complex step of function(Y) in every component, as a last axis."""
    columns = []
    for k in range(Y.size):
        moved = Y.astype(complex)
        moved.flat[k] += 1j * STEP
        columns.append(function(moved)[0].ravel().imag / STEP)
    return np.stack(columns, axis=-1)[None]


@pytest.mark.parametrize("tau", [None, TAU], ids=["undamped", "damped"])
def test_tangent_is_the_complex_step_of_force(case, tau):
    Y, V = case.relative(case.state(22)), case.relative(case.state(23))
    A, g_o, bending = *case.law, case.inv.bending
    expected = by_component(case, Y, lambda y: element_forces.force(A, g_o, y, V, tau, bending))
    assert_close(element_forces.tangent(A, g_o, Y, V, tau, bending), expected, DERIVATIVE)


def test_damping_tangent_is_the_complex_step_of_force_in_the_velocities(case):
    Y, V = case.relative(case.state(22)), case.relative(case.state(23))
    A, g_o, bending = *case.law, case.inv.bending
    expected = by_component(case, V, lambda v: element_forces.force(A, g_o, Y, v, TAU, bending))
    assert_close(element_forces.damping_tangent(A, Y, TAU), expected, DERIVATIVE)


@pytest.mark.parametrize("tau", [None, TAU], ids=["undamped", "damped"])
def test_force_rate_is_the_complex_step_of_force_along_the_motion(case, tau):
    Y, V, Z = (case.relative(case.state(seed)) for seed in (24, 25, 26))
    A, g_o, bending = *case.law, case.inv.bending
    moved = element_forces.force(A, g_o, Y + 1j * STEP * V, V + 1j * STEP * Z, tau, bending)
    rate = element_forces.force_rate(A, g_o, Y, V, Z, tau, bending)
    assert_close(rate, moved.imag / STEP, DERIVATIVE)
    # And by the tangents.
    product = (element_forces.tangent(A, g_o, Y, V, tau, bending)[0] @ V.ravel()).reshape(V.shape)
    if tau is not None:
        product += (element_forces.damping_tangent(A, Y, tau)[0] @ Z.ravel()).reshape(Z.shape)
    assert_close(rate, product, DERIVATIVE)


def test_tangent_is_symmetric(case):
    K = element_forces.tangent(*case.law, case.relative(case.state(27)), bending=case.inv.bending)
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
    U, V = (strain_energy(*case.law, Y, case.inv.bending) for Y in (before, after))
    # Moving by 1 m rounds r_2 - r_1 (0.7 m) by 2 eps; divided by a strain of 0.1 and twice in
    # the energy that is 40 eps = 1e-14, below the round-off of the sums.
    assert_close(V, U, 10 * CLOSE)
    assert_close(case.force(moved), case.force(X) @ R.T, 2 * CLOSE)


CASES = {name: Case(name) for name in REFERENCES}


def test_rigid_motion_of_the_reference_stores_no_energy(case):
    rng = np.random.default_rng(31)
    X = case.X_o @ ancf.random_rotation(case.dim, rng).T
    U = strain_energy(*case.law, case.relative(X), case.inv.bending)[0]
    # g - g_o is 10 eps at most, and U quadratic in it: 100 eps^2 |A|, summed over all entries.
    size, eps = case.inv.A.shape[1], np.finfo(float).eps
    allowed = 100 * eps**2 * size**2 * np.max(np.abs(case.inv.A))
    assert abs(U) <= allowed


def test_force_is_right_a_thousand_metres_from_the_origin(case):
    # Positions at 1000 m are rounded by up to 0.6e-13 m at both ends, against a stretch of
    # 0.1 * 0.7 m that is 2e-12, times the stiffer directions; 7e-12 was seen over 40 states. A
    # Gram matrix of absolute positions would be off by eps (1000/0.7)^2 / 0.1 = 5e-9.
    X = case.state(41)
    far = X + 1000.0 * positions_column(case)
    assert_close(case.force(far), case.force(X), 1e-11)


# ---------------------------------------------------------------- Kelvin-Voigt damping


def dissipated_power(case, Y, V):
    """Power of the damping part of the force, and the sum of its terms by magnitude."""
    A, g_o = case.inv.A, case.inv.g_o
    D = element_forces.force(A, g_o, Y, V, TAU) - element_forces.force(A, g_o, Y)
    rate = np.abs(strain(None, Y, V, None))
    return np.sum(D * V), TAU[0] * np.max(np.abs(A)) * np.sum(rate) ** 2


@pytest.mark.parametrize("seed", range(20))
def test_dissipated_power_is_positive_and_that_of_the_strain_rate(case, seed):
    rng = np.random.default_rng(seed)
    Y = case.relative(case.state(seed))
    # Every fifth motion is nearly rigid, where the sign is a matter of cancellation.
    V = rng.uniform(-1, 1, Y.shape)
    if seed % 5 == 0:
        V = Y @ spin(case.dim, rng).T + 0.01 * V
    power, _ = dissipated_power(case, Y, V)
    rate = strain(None, Y, V, None)[0]
    assert power > 0
    # The damping force is a difference of two forces; the nearly rigid motion makes its power
    # smaller by 0.01^2 than that of the elastic force: CLOSE over 1e-4.
    assert power == pytest.approx(TAU[0] * rate @ case.inv.A[0] @ rate, rel=1e-9)


def spin(dim, rng):
    B = rng.uniform(-1, 1, (dim, dim))
    return B - B.T


@pytest.mark.parametrize("seed", range(5))
def test_rigid_rotation_dissipates_nothing_in_any_deformed_state(case, seed):
    rng = np.random.default_rng(seed)
    Y = case.relative(case.state(seed))
    V, other = Y @ spin(case.dim, rng).T, rng.uniform(-1, 1, Y.shape)
    A, g_o = case.inv.A, case.inv.g_o
    damped, undamped = element_forces.force(A, g_o, Y, V, TAU), element_forces.force(A, g_o, Y)
    # Sums of d products cancel to 2 eps each, which A multiplies as it does any strain.
    size = np.max(np.abs(element_forces.force(A, g_o, Y, other, TAU) - undamped))
    assert np.max(np.abs(damped - undamped)) <= CLOSE * max(size, np.max(np.abs(undamped)))
    assert size > 0.01 * TAU[0] * np.max(np.abs(undamped))  # another motion is damped


def test_zero_damping_time_gives_bitwise_the_undamped_force(case):
    Y, V = case.relative(case.state(61)), case.relative(case.state(62))
    A, g_o, zero = case.inv.A, case.inv.g_o, np.zeros(1)
    assert np.array_equal(element_forces.force(A, g_o, Y, V, zero), element_forces.force(A, g_o, Y))
    assert np.array_equal(
        element_forces.tangent(A, g_o, Y, V, zero), element_forces.tangent(A, g_o, Y)
    )
    assert not np.any(element_forces.damping_tangent(A, Y, zero))


# ---------------------------------------------------------------- blocks of elements


@pytest.mark.parametrize("small", [True, False], ids=["small", "default"])
def test_preparation_in_chunks_is_the_preparation_of_each(case, small, monkeypatch):
    name = "_STRAIGHT_CHUNK" if case.straight else "_CURVED_CHUNK"
    assert getattr(invariants, name) == (256 if case.straight else 32)
    if small:
        monkeypatch.setattr(invariants, name, 2)
    chunk = getattr(invariants, name)
    n = 5 if small else chunk + 1
    rng = np.random.default_rng(51)
    parameters = VALUES * (1 + 0.1 * rng.uniform(-1, 1, (n, len(VALUES))))
    wanted = (ElementParameter.LENGTH,)
    batch = Batch(case.kind, parameters, np.repeat(case.Y_unit, n, axis=0))
    whole = prepare(case.element, batch)
    of_whole = whole.partials(wanted)[wanted[0]]
    assert len(whole.A) == n > chunk
    for k in (0, chunk - 1, chunk, n - 1):
        one = prepare(case.element, Batch(case.kind, parameters[k : k + 1], case.Y_unit))
        of_one = one.partials(wanted)[wanted[0]]
        # The same sums, possibly in another order of the linear algebra library.
        for a, b in (
            (whole.A[k], one.A[0]),
            (whole.g_o[k], one.g_o[0]),
            (whole.m[k], one.m[0]),
            (of_whole.A[k], of_one.A[0]),
            (of_whole.c[k], of_one.c[0]),
            (of_whole.m[k], of_one.m[0]),
        ):
            assert_close(a, b, CLOSE)


def test_block_of_different_states_is_each_state_alone(case):
    Y = np.concatenate([case.relative(case.state(seed)) for seed in range(4)])
    shared = element_forces.force(case.inv.A, case.inv.g_o, Y)
    own = element_forces.force(
        np.repeat(case.inv.A, 4, axis=0), np.repeat(case.inv.g_o, 4, axis=0), Y
    )
    for k in range(4):
        one = element_forces.force(case.inv.A, case.inv.g_o, Y[k : k + 1])[0]
        assert_close(shared[k], one, CLOSE)
        assert_close(own[k], one, CLOSE)


def alike(partial, n):
    """The partial of an element for n of them."""
    return type(partial)(**{name: np.repeat(x, n, axis=0) for name, x in vars(partial).items()})


def test_leading_axes_are_instants(case):
    # Five instants of three elements, undamped and damped, against each state alone.
    n, k = 3, 5
    states = [[case.relative(case.state(7 * i + j))[0] for j in range(n)] for i in range(3 * k)]
    Y, V, Z = np.array(states).reshape(3, k, n, *case.Y_unit.shape[1:])
    A = case.inv.A * np.array([1.0, 1.1, 0.9])[:, None, None]
    g_o = case.inv.g_o * np.array([1.0, 0.9, 1.1])[:, None]
    tau, partial = np.array([0.0, 0.02, 0.03]), case.inv.partials([WIDTH])[WIDTH]
    functions = {
        "energy": lambda e, y, v, z: strain_energy(A[e], g_o[e], y),
        "force": lambda e, y, v, z: element_forces.force(A[e], g_o[e], y),
        "damped": lambda e, y, v, z: element_forces.force(A[e], g_o[e], y, v, tau[e]),
        "tangent": lambda e, y, v, z: element_forces.tangent(A[e], g_o[e], y),
        "damped tangent": lambda e, y, v, z: element_forces.tangent(A[e], g_o[e], y, v, tau[e]),
        "damping": lambda e, y, v, z: element_forces.damping_tangent(A[e], y, tau[e]),
        "rate": lambda e, y, v, z: element_forces.force_rate(A[e], g_o[e], y, v, z),
        "damped rate": lambda e, y, v, z: element_forces.force_rate(A[e], g_o[e], y, v, z, tau[e]),
        "partial": lambda e, y, v, z: element_forces.force_partial(
            (A[e], g_o[e], None), alike(partial, len(g_o[e])), y, v, tau[e]
        ),
    }
    for function in functions.values():
        whole = function(slice(None), Y, V, Z)
        assert whole.shape[:2] == (k, n)
        for i in range(k):
            for j in range(n):
                one = slice(j, j + 1)
                alone = function(one, Y[i, one], V[i, one], Z[i, one])[0]
                scale = np.max(np.abs(whole))  # the damping of the first element is zero
                assert np.max(np.abs(whole[i, j] - alone)) <= CLOSE * scale


@pytest.mark.parametrize("name", ["BEAM_2D arc", "BEAM_3D helix"])
def test_folded_reference_is_refused(name):
    case = Case(name)
    values = VALUES.copy()
    # The centre of curvature of the arc lies 0.54 m away, of the helix 0.58 m; half of 1.4 m is
    # beyond both.
    values[HEIGHT] = 1.4
    with pytest.raises(InvalidInputError, match="determinant") as error:
        case.prepare(values)
    assert "reference configuration" in error.value.where
    assert error.value.repair
