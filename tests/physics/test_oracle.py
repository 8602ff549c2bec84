"""Self-checks of the reference implementation in ``oracle.plain_ancf``.

Tolerances are multiples of EPS times a magnitude computed in the test: the sum of the absolute
values of the terms that the oracle adds up. A strict bound multiplies that sum by the length of the
longest chain of operations: 45 quadrature points + 4 contractions of at most 24 terms (CHAIN), for
eqs. (13) to (19) 45 points + 24 * 24 terms of e^T C e + 24 terms of K e (PAPER_CHAIN). Round-off
being random, factors below 2 are seen.
"""

import numpy as np
import pytest

from tests.support.oracle import plain_ancf as ancf

EPS = np.finfo(float).eps
CHAIN = 150
PAPER_CHAIN = 700
STEP = 1e-30  # complex step: no subtraction, so truncation STEP^2 is far below round-off
PARAMETERS = {"E": 2.1e6, "nu": 0.3, "h": 0.06, "w": 0.04, "l": 0.7}
SECTION = {name: PARAMETERS[name] for name in ("h", "w", "l")}
RHO = 2770.0


def planar_arc(l, angle=1.3):
    """Arc of length l and the given angle (quarter: 1.57) with tangent and normal at the nodes."""
    radius = l / angle
    rows = []
    for theta in (0.0, angle):
        rows.append([radius * np.sin(theta), radius * (1 - np.cos(theta))])
        rows.append([np.cos(theta), np.sin(theta)])
        rows.append([-np.sin(theta), np.cos(theta)])
    return np.array(rows)


def spatial_arc(l, angle=1.3):
    """The planar arc with r_z along the third axis."""
    arc = np.column_stack([planar_arc(l, angle), np.zeros(6)])
    z_axis = [[0.0, 0.0, 1.0]]
    return np.vstack([arc[:3], z_axis, arc[3:], z_axis])


def helix(l, angle=1.3, pitch=0.4):
    """Arc of length l that also climbs, with tangent, principal normal and binormal at the nodes (a
    twisted frame).
    """
    radius = l / (angle * np.sqrt(1 + pitch**2))
    rows = []
    for theta in (0.0, angle):
        tangent = np.array([np.cos(theta), np.sin(theta), pitch]) / np.sqrt(1 + pitch**2)
        normal = np.array([-np.sin(theta), np.cos(theta), 0.0])
        rows.append([radius * np.sin(theta), radius * (1 - np.cos(theta)), radius * pitch * theta])
        rows += [tangent, normal, np.cross(tangent, normal)]
    return np.array(rows)


REFERENCES = {
    "planar straight": ancf.straight_reference(2, PARAMETERS["l"]),
    "planar arc": planar_arc(PARAMETERS["l"]),
    "spatial straight": ancf.straight_reference(3, PARAMETERS["l"]),
    "spatial helix": helix(PARAMETERS["l"]),
}


@pytest.fixture(params=REFERENCES)
def X_o(request):
    return REFERENCES[request.param]


@pytest.fixture
def X(X_o):
    return ancf.random_state(X_o.shape[1], np.random.default_rng(7), PARAMETERS["l"], X_o)


def position_rows(X_o):
    """Column (n_a, 1), one for the rows that are positions."""
    rows = np.zeros((len(X_o), 1))
    rows[[0, len(X_o) // 2]] = 1
    return rows


def complex_step(function, X):
    """Partials of function in X.ravel(), stacked along a last axis."""
    columns = []
    for k in range(X.size):
        X_k = X.astype(complex)
        X_k.flat[k] += STEP * 1j
        columns.append(np.imag(function(X_k)) / STEP)
    return np.stack(columns, axis=-1)


def force_magnitude(X, X_o, E, nu, h, w, l):
    """Sum of absolute values behind a component of the force (the strain is a difference)."""
    lam, G = ancf.lame(E, nu)
    total = np.zeros(X.shape)
    for _, g, dV in ancf.quadrature_points(X.shape[1], h, w, l, X_o):
        F = np.abs(X.T) @ np.abs(g)
        strain = (F.T @ F + np.eye(len(F))) / 2
        S = lam * np.trace(strain) * np.eye(len(F)) + 2 * G * strain
        total += dV * (np.abs(g) @ S @ F.T)
    return np.max(total)


def tangent_magnitude(X, X_o, E, nu, h, w, l):
    """Above the same sum for the tangent.

    Terms with dS and with S are both below (lam + 2 G) |g|^2 (|F|^2 + 1), in 3 directions.
    """
    lam, G = ancf.lame(E, nu)
    total = 0.0
    for _, g, dV in ancf.quadrature_points(X.shape[1], h, w, l, X_o):
        F = np.abs(X.T) @ np.abs(g)
        total += dV * 3 * (lam + 2 * G) * np.max(np.abs(g)) ** 2 * (np.max(F) ** 2 + 1)
    return total


# ---------------------------------------------------------------- shape functions and reference


@pytest.mark.parametrize("dim", [2, 3])
def test_shape_functions_interpolate_position_and_slopes_at_the_nodes(dim):
    l = 0.7
    for xi, first in ((0.0, 0), (1.0, dim + 1)):
        values = np.column_stack(
            [ancf.shape(dim, xi, 0.0, 0.0, l), ancf.shape_gradient(dim, xi, 0.0, 0.0, l)]
        )
        expected = np.zeros_like(values)
        expected[first : first + dim + 1] = np.eye(dim + 1)
        # Sums of three integers, one division by l and one product: a few roundings of numbers up
        # to 6/l.
        assert np.max(np.abs(values - expected)) <= 10 * EPS * 6 / l


@pytest.mark.parametrize("dim", [2, 3])
def test_shape_gradient_is_the_complex_step_of_shape(dim):
    l, (xi, y, z) = 0.7, (0.31, 0.02, -0.013)
    by_steps = [
        ancf.shape(dim, xi + 1j * STEP / l, y, z, l),
        ancf.shape(dim, xi, y + 1j * STEP, z, l),
    ]
    by_steps.append(ancf.shape(dim, xi, y, z + 1j * STEP, l))
    by_steps = np.imag(np.stack(by_steps[:dim], axis=-1)) / STEP
    # Polynomials with coefficients up to 6/l, ten roundings.
    assert np.max(np.abs(by_steps - ancf.shape_gradient(dim, xi, y, z, l))) <= 10 * EPS * 6 / l


def test_the_reference_has_unit_deformation_gradient(X_o):
    for _, g, _ in ancf.quadrature_points(X_o.shape[1], **SECTION, X_o=X_o):
        magnitude = np.max(np.abs(X_o.T) @ np.abs(g))
        # Sum of 8 terms, and an inverse of a well-conditioned 3 x 3 matrix (a dozen roundings).
        assert np.max(np.abs(X_o.T @ g - np.eye(X_o.shape[1]))) <= 20 * EPS * magnitude


def test_default_reference_is_straight():
    X = ancf.random_state(3, np.random.default_rng(1), PARAMETERS["l"])
    # The same operations on the same numbers: bitwise equal.
    assert ancf.energy(X, **PARAMETERS) == ancf.energy(
        X, **PARAMETERS, X_o=REFERENCES["spatial straight"]
    )


# ---------------------------------------------------------------- energy, force, tangent


def test_force_is_the_gradient_of_the_energy(X, X_o):
    by_steps = complex_step(lambda X: ancf.energy(X, **PARAMETERS, X_o=X_o), X).reshape(X.shape)
    error = np.max(np.abs(ancf.force(X, **PARAMETERS, X_o=X_o) - by_steps))
    assert error <= CHAIN * EPS * force_magnitude(X, X_o, **PARAMETERS)


def test_tangent_is_the_derivative_of_the_force(X, X_o):
    by_steps = complex_step(lambda X: ancf.force(X, **PARAMETERS, X_o=X_o).ravel(), X)
    K = ancf.tangent(X, **PARAMETERS, X_o=X_o)
    tolerance = CHAIN * EPS * tangent_magnitude(X, X_o, **PARAMETERS)
    assert np.max(np.abs(K - by_steps)) <= tolerance
    assert np.max(np.abs(K - K.T)) <= tolerance


def test_the_two_checks_above_can_fail(X, X_o):
    """The bounds leave no room for a wrong term: they are below 1e-9 of what they measure."""
    force, K = ancf.force(X, **PARAMETERS, X_o=X_o), ancf.tangent(X, **PARAMETERS, X_o=X_o)
    # Strains are about 0.1 here, so magnitudes exceed results by some 10^2 to 10^4: 150 EPS 10^4 =
    # 3e-10.
    assert CHAIN * EPS * force_magnitude(X, X_o, **PARAMETERS) < 1e-9 * np.max(np.abs(force))
    assert CHAIN * EPS * tangent_magnitude(X, X_o, **PARAMETERS) < 1e-9 * np.max(np.abs(K))


def test_rigid_motion_gives_no_force_and_no_energy(X_o):
    rng = np.random.default_rng(3)
    dim = X_o.shape[1]
    X = X_o @ ancf.random_rotation(dim, rng).T + rng.uniform(-1, 1, dim) * position_rows(X_o)
    magnitude = force_magnitude(X, X_o, **PARAMETERS)
    assert np.max(np.abs(ancf.force(X, **PARAMETERS, X_o=X_o))) <= CHAIN * EPS * magnitude
    # The energy is quadratic in strains that are round-off: EPS^2, and magnitude times |X| bounds
    # its scale.
    assert abs(ancf.energy(X, **PARAMETERS, X_o=X_o)) <= (CHAIN * EPS) ** 2 * magnitude * np.sum(
        np.abs(X)
    )


def test_force_turns_with_the_frame_and_has_no_resultant(X, X_o):
    rng = np.random.default_rng(4)
    dim = X.shape[1]
    R, shift = ancf.random_rotation(dim, rng), rng.uniform(-1, 1, dim)
    moved = X @ R.T + shift * position_rows(X_o)
    force = ancf.force(X, **PARAMETERS, X_o=X_o)
    # Two evaluations, each within the bound; the shift enlarges the magnitude of the second.
    tolerance = 2 * CHAIN * EPS * force_magnitude(moved, X_o, **PARAMETERS)
    assert np.max(np.abs(ancf.force(moved, **PARAMETERS, X_o=X_o) - force @ R.T)) <= tolerance
    assert np.max(np.abs(np.sum(position_rows(X_o) * force, axis=0))) <= tolerance
    # The moment of a generalised force is sum_a X_a x force_a, over positions and slopes.
    moment = X.T @ force - force.T @ X
    assert np.max(np.abs(moment)) <= tolerance * np.sum(np.abs(X))


def test_homogeneous_strain_of_a_curved_reference_has_the_energy_of_a_block(X_o):
    """X = X_o F^T is the same F everywhere, so U = V W(F), whatever X_o: eq. (16)."""
    dim = X_o.shape[1]
    F = np.eye(dim) + 0.1 * np.random.default_rng(5).uniform(-1, 1, (dim, dim))
    strain = (F.T @ F - np.eye(dim)) / 2
    lam, G = ancf.lame(PARAMETERS["E"], PARAMETERS["nu"])
    volume = sum(dV for _, _, dV in ancf.quadrature_points(dim, **SECTION, X_o=X_o))
    expected = volume * (lam / 2 * np.trace(strain) ** 2 + G * np.sum(strain * strain))
    # F^T F - I is a difference of numbers about 10 times the strain (0.1), sums of 8 terms up to
    # 10: 10^3 EPS per point.
    assert ancf.energy(X_o @ F.T, **PARAMETERS, X_o=X_o) == pytest.approx(
        expected, rel=CHAIN * 1e3 * EPS, abs=0
    )


def test_lame_constants_give_youngs_modulus():
    E, nu = PARAMETERS["E"], PARAMETERS["nu"]
    stress = ancf.second_piola_kirchhoff(np.diag([1.0, -nu, -nu]), *ancf.lame(E, nu))
    # A dozen roundings of numbers of size lam + 2 G < 2 E.
    assert np.max(np.abs(stress - np.diag([E, 0, 0]))) <= 24 * EPS * E
    stress = ancf.second_piola_kirchhoff(np.diag([1.0, -nu / (1 - nu)]), *ancf.lame(E, nu))
    assert np.max(np.abs(stress - np.diag([E / (1 - nu**2), 0]))) <= 24 * EPS * E


@pytest.mark.parametrize("dim", [2, 3])
def test_default_points_are_exact_for_a_straight_element(dim):
    X = ancf.random_state(dim, np.random.default_rng(7), PARAMETERS["l"])
    force = ancf.force(X, **PARAMETERS)
    finer = ancf.force(X, **PARAMETERS, n_xi=8, n_y=5, n_z=5)
    # Both exact, so round-off only; 200 instead of 45 points in the second, hence 3 CHAIN for the
    # two.
    tolerance = (
        3 * CHAIN * EPS * force_magnitude(X, ancf.straight_reference(dim, 0.7), **PARAMETERS)
    )
    assert np.max(np.abs(force - finer)) <= tolerance
    coarser = ancf.force(X, **PARAMETERS, n_xi=4)
    assert np.max(np.abs(force - coarser)) > 1e3 * tolerance  # degree 8 needs all five


# ---------------------------------------------------------------- mass and gravity


def polygon_area(X_o, h, l):
    """Area of a planar element, 1/2 closed integral of r x dr, from the shape functions alone.

    Exact: on each side r is a polynomial of degree 3 or less in the side's coordinate, the
    integrand of degree 5.
    """
    points, weights = np.polynomial.legendre.leggauss(3)
    area = 0.0
    for y, sign in ((-h / 2, 1), (h / 2, -1)):  # lower side forwards, upper side backwards
        for point, weight in zip(points, weights, strict=True):
            xi = (1 + point) / 2
            r = ancf.shape(2, xi, y, 0.0, l) @ X_o
            dr = ancf.shape_gradient(2, xi, y, 0.0, l)[:, 0] @ X_o * l / 2
            area += sign * weight * (r[0] * dr[1] - r[1] * dr[0]) / 2
    for xi, sign in ((1.0, 1), (0.0, -1)):  # end upwards, start downwards: straight lines
        a, b = (ancf.shape(2, xi, y, 0.0, l) @ X_o for y in (-h / 2, h / 2))
        area += sign * (a[0] * b[1] - a[1] * b[0]) / 2
    return area


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_total_mass_is_density_times_volume(dim, curved):
    h, w, l = PARAMETERS["h"], PARAMETERS["w"], PARAMETERS["l"]
    X_plane = planar_arc(l) if curved else ancf.straight_reference(2, l)
    X_o = X_plane if dim == 2 else (spatial_arc(l) if curved else ancf.straight_reference(3, l))
    area = polygon_area(X_plane, h, l)
    if not curved:
        # 8 terms of size up to l * l = 12 area.
        assert area == pytest.approx(h * l, rel=100 * EPS, abs=0)
    M = ancf.mass(dim, RHO, **SECTION, X_o=X_o, n_xi=6)
    unit = (position_rows(X_o) * np.eye(dim)[0]).ravel()
    # Sums of positive terms (M) and of terms up to l^2 = 10 area (area): CHAIN roundings of numbers
    # 10 times too large.
    assert unit @ M @ unit == pytest.approx(RHO * area * w, rel=10 * CHAIN * EPS, abs=0)
    assert np.array_equal(M, M.T)  # products commute exactly
    # Positive definite: the smallest eigenvalue (a slope r_y or r_z) is above 4e-5 of the largest
    # here, no round-off.
    eigenvalues = np.linalg.eigvalsh(M)
    assert eigenvalues[0] > 1e4 * EPS * eigenvalues[-1]


def test_mass_against_textbook_numbers():
    """Cubic Hermite beam, rho A l / 420 [156, 22 l, 54, -13 l]; r_y, rho I l / 6 [2, 1]."""
    h, w, l = PARAMETERS["h"], PARAMETERS["w"], PARAMETERS["l"]
    M = ancf.mass(2, RHO, **SECTION)[::2, ::2]
    hermite = (
        np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) / 420
    )
    lengths = np.array([1, l, 1, l])
    expected = np.zeros((6, 6))
    expected[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])] = (
        RHO * h * w * l * hermite * np.outer(lengths, lengths)
    )
    expected[np.ix_([2, 5], [2, 5])] = RHO * w * h**3 / 12 * l * np.array([[2, 1], [1, 2]]) / 6
    assert np.max(np.abs(M - expected)) <= CHAIN * EPS * np.max(np.abs(M))


def test_gravity_is_eq_12_for_the_straight_planar_element():
    h, w, l = PARAMETERS["h"], PARAMETERS["w"], PARAMETERS["l"]
    Q_e = ancf.gravity_force([0.0, -9.81], RHO, **SECTION).ravel()
    expected = (
        -RHO * h * w * l * 9.81 * np.array([0, 1 / 2, 0, l / 12, 0, 0, 0, 1 / 2, 0, -l / 12, 0, 0])
    )
    assert np.max(np.abs(Q_e - expected)) <= CHAIN * EPS * np.max(np.abs(expected))


def test_gravity_is_the_mass_matrix_times_the_acceleration(X_o):
    dim = X_o.shape[1]
    g = np.array([1.3, -9.81, 0.4])[:dim]
    M = ancf.mass(dim, RHO, **SECTION, X_o=X_o)
    Q_e = ancf.gravity_force(g, RHO, **SECTION, X_o=X_o)
    # A uniform acceleration is g in the rows of the positions (partition of unity); same points on
    # both sides.
    difference = M @ (position_rows(X_o) * g).ravel() - Q_e.ravel()
    assert np.max(np.abs(difference)) <= CHAIN * EPS * np.max(np.abs(Q_e))


# ---------------------------------------------------------------- the paper's tensors


@pytest.fixture
def tensors(X_o):
    return ancf.paper_tensors(X_o.shape[1], **PARAMETERS, X_o=X_o)


def paper_magnitude(X, K_1, C_K2):
    """Sums of absolute values behind eq. (13) with (17), and behind eq. (19)."""
    X, K_1, C_K2 = np.abs(X), np.abs(K_1), np.abs(C_K2)
    return np.max(ancf.paper_force(X, K_1, C_K2)), np.max(ancf.paper_tangent(X, K_1, C_K2))


def test_paper_tensors_reproduce_force_and_tangent(X, X_o, tensors):
    """Eqs. (13) and (15)-(19), and the coefficient -(3 kappa + 2 G)/2 in space.

    Seen in 20 random states, relative to the largest component: force up to 6e-14, tangent up to
    4e-15.
    """
    force, K = ancf.force(X, **PARAMETERS, X_o=X_o), ancf.tangent(X, **PARAMETERS, X_o=X_o)
    force_scale, tangent_scale = paper_magnitude(X, *tensors)
    force_error = np.max(np.abs(ancf.paper_force(X, *tensors) - force))
    tangent_error = np.max(np.abs(ancf.paper_tangent(X, *tensors) - K))
    assert force_error <= PAPER_CHAIN * EPS * force_scale
    assert tangent_error <= PAPER_CHAIN * EPS * tangent_scale
    # The same bounds relative to the result, so that they cannot be idle: terms of size E cancel to
    # strains of 0.1, and the scale is below 1000 times the largest force component and 30 times the
    # largest tangent entry.
    assert force_error <= PAPER_CHAIN * EPS * 1000 * np.max(np.abs(force))
    assert tangent_error <= PAPER_CHAIN * EPS * 30 * np.max(np.abs(K))


def test_eq_14_and_eq_18_are_different_matrices_with_the_same_force(X, X_o, tensors):
    """Eq. (18) has (S1^T S2)_i^T (S2^T S1)_j where eq. (14) means (S1^T S2)_i^T (S1^T S2)_j.

    K_2 e is the same, because (e^T S1^T S2 e) = (e^T S2^T S1 e).
    """
    K_14 = ancf.paper_K_2_eq14(X, **PARAMETERS, X_o=X_o)
    K_18 = ancf.paper_K_2(X, tensors[1])
    # Not round-off: of the order of the G terms themselves. Seen: 0.4 to 1.3 of the largest entry.
    assert np.max(np.abs(K_14 - K_18)) > 1e-2 * np.max(np.abs(K_18))
    force_scale, _ = paper_magnitude(X, *tensors)
    assert np.max(np.abs((K_14 - K_18) @ X.ravel())) <= PAPER_CHAIN * EPS * force_scale


# ---------------------------------------------------------------- complex parameters


@pytest.mark.parametrize("name", ["E", "nu", "h", "w", "l"])
@pytest.mark.parametrize("dim", [2, 3])
def test_complex_parameters_pass_through_the_force(dim, name):
    X = ancf.random_state(dim, np.random.default_rng(7), PARAMETERS["l"])
    value = PARAMETERS[name]
    by_step = np.imag(ancf.force(X, **{**PARAMETERS, name: value * (1 + 1j * STEP)})) / STEP
    delta = 1e-5
    up, down = (
        ancf.force(X, **{**PARAMETERS, name: value * (1 + sign * delta)}) for sign in (1, -1)
    )
    # Central difference: truncation delta^2 times third derivatives (up to 10^2 times the force),
    # round-off EPS/delta times force_magnitude (10^3 times the force): 1e-8 and 2e-8.
    assert np.max(np.abs(by_step - (up - down) / (2 * delta))) <= 1e-7 * np.max(np.abs(by_step))


@pytest.mark.parametrize("name", ["rho", "h", "w", "l"])
@pytest.mark.parametrize("dim", [2, 3])
def test_complex_parameters_pass_through_mass_and_gravity(dim, name):
    parameters = {"rho": RHO, **SECTION}
    g = np.array([1.3, -9.81, 0.4])[:dim]
    delta = 1e-5
    for function in (lambda p: ancf.mass(dim, **p), lambda p: ancf.gravity_force(g, **p)):
        by_step = np.imag(function({**parameters, name: parameters[name] * (1 + 1j * STEP)})) / STEP
        up, down = (
            function({**parameters, name: parameters[name] * (1 + sign * delta)})
            for sign in (1, -1)
        )
        # Monomials of degree 3 or less: truncation delta^2 = 1e-10, round-off 10 EPS/delta = 2e-10.
        assert np.max(np.abs(by_step - (up - down) / (2 * delta))) <= 1e-9 * np.max(np.abs(by_step))


@pytest.mark.parametrize("dim", [2, 3])
def test_complex_numbers_pass_through_the_tensors(dim):
    X = ancf.random_state(dim, np.random.default_rng(7), PARAMETERS["l"])
    rng = np.random.default_rng(8)
    X_complex = X + 1j * STEP * rng.uniform(-1, 1, X.shape)
    parameters = {
        **PARAMETERS,
        "l": PARAMETERS["l"] + 1j * STEP,
        "nu": PARAMETERS["nu"] + 1j * STEP,
    }
    tensors = ancf.paper_tensors(dim, **parameters)
    difference = (
        np.imag(ancf.paper_force(X_complex, *tensors) - ancf.force(X_complex, **parameters)) / STEP
    )
    scale = sum(paper_magnitude(X, *[np.real(T) for T in tensors]))
    # Partials of eq. (13) in e: the tangent's terms; in l and nu: the force's, times 4/l + 4/(1 - 2
    # nu) = 16.
    assert np.max(np.abs(difference)) <= 16 * PAPER_CHAIN * EPS * scale
