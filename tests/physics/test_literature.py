"""The references of the report on the literature reproduce what was published."""

import numpy as np
import pytest

from validation.literature import (
    arch,
    bend,
    buckling,
    cable,
    elastica,
    princeton,
    rotating,
    supported,
)
from validation.literature.moving_rod import HubRod
from validation.literature.rod import Rod, clamped, derivatives, tip_loaded


def test_elliptic_integrals_reproduce_the_printed_elastica():
    printed = elastica._PUBLISHED
    found = np.array([elastica.closed_form(alpha) for alpha in printed[:, 0]])
    # Half of the last printed digit.
    np.testing.assert_allclose(found, printed[:, 1:], rtol=0, atol=5.1e-6)


def test_rod_without_shear_and_extension_is_the_elastica():
    # Stiffnesses of 1e8 leave 1e-8 of shear and extension.
    rod = Rod(1.0, 1e8 * np.ones(3), np.ones(3))
    end = tip_loaded(rod, np.array([0, -2.0, 0]))[0].real
    exact = elastica.closed_form(2.0)
    np.testing.assert_allclose([-end[1], 1 - end[0]], exact[:2], rtol=1e-7)


def test_rod_reproduces_the_45_degree_bend():
    # The values that the issue names have six decimals.
    np.testing.assert_allclose(
        bend._displacement(bend._rod_tip(600.0)), bend._PUBLISHED["asked"], rtol=0, atol=1.1e-6
    )


@pytest.mark.parametrize("load", princeton._LOADS)
def test_rod_reproduces_the_princeton_beam_in_its_principal_directions(load):
    stiff, soft = (princeton._rod_tip(load, angle) for angle in (0.0, 90.0))
    printed = princeton._BEAM[load]
    # ANSYS shears by another factor: 1e-4.
    np.testing.assert_allclose([stiff[0], soft[1]], [printed[0][0], printed[1][-1]], rtol=2e-4)


def test_derivatives_of_a_solution_are_those_of_solving_again():
    def rod(b):
        return Rod(1.0, b[0] * np.ones(3), b[1] * np.ones(3))

    def quantity(m, b):
        end = clamped(rod(b), m[None], np.array([0, 0, b[2]]))[0]
        return end[12:], end[:3:2]

    def place(b):
        return tip_loaded(rod(b), np.array([0, 0, b[2]]))[0][:3:2].real

    b = np.array([100.0, 1.0, 2.0])
    moment = tip_loaded(rod(b), np.array([0, 0, b[2]]))[1]
    x, x_b = derivatives(quantity, moment, b)
    np.testing.assert_allclose(x, place(b), rtol=1e-10)
    # Central differences: 1e-4 squared and the integration's 1e-11 over 1e-4.
    d = 1e-4
    steps = np.diag(d * b)
    differences = [(place(b + s) - place(b - s)) / (2 * np.max(s)) for s in steps]
    np.testing.assert_allclose(x_b, np.array(differences).T, rtol=1e-6, atol=1e-9)


def test_narrow_cantilever_buckles_where_the_closed_form_says():
    b = np.array([buckling._E, buckling._H, buckling._H / 100, buckling._L])
    # What it bends before it buckles is left out of the closed form: (w/h)^2 and J/I of it.
    assert buckling._reference(b, 1e-11) / buckling._unit(b) == pytest.approx(4.0126, rel=1e-3)


def test_elastic_catenary_reproduces_the_loaded_cable():
    b = np.array([cable._E, cable._WEIGHT, cable._LOAD])
    moved, sag = cable._displacement(b, hooke=True)
    # Printed to the millimetre.
    np.testing.assert_allclose(moved, (-5.626, -0.859), rtol=0, atol=5.1e-4)
    assert sag == pytest.approx(29.276, abs=5.1e-4)


def test_cable_of_the_elements_stretches_by_saint_venant_kirchhoff():
    # A light cable under a tension of 0.3 E A is straight.
    b = np.array([1.0, 1e-12, 0.0])
    x, _ = cable._part(0.3 * cable._A, 0.0, 1.0, b, hooke=False)
    assert x * (x**2 - 1) / 2 == pytest.approx(0.3, rel=1e-9)


def test_polynomials_reproduce_the_frequencies_of_the_rotating_beam():
    printed = rotating.PUBLISHED
    found = np.array([rotating._reference(speed) for speed in printed[:, 0]])
    # Half of the last printed digit, and as much again where the print is rounded twice.
    np.testing.assert_allclose(found, printed[:, 1:], rtol=0, atol=1e-4)


def test_closed_forms_reproduce_the_frequencies_of_the_supported_beam():
    b = np.array([supported._L, supported._H, supported._E, supported._RHO])
    np.testing.assert_allclose(supported.reference(b), supported._PUBLISHED, rtol=1e-9)
    # Their mesh of 256 elements: 1e-4 in the third mode.
    found = supported.reference(b, nu=0.3, factor=10 * 1.3 / (12 + 11 * 0.3))[:4]
    np.testing.assert_allclose(found, supported._PUBLISHED_POISSON, rtol=3e-4)


def test_rod_reproduces_the_limit_load_of_the_arch():
    # The print holds without extension, 3e-5 at h/R = 0.01, and has three digits.
    assert arch._reference_limit(6).load == pytest.approx(8.97, abs=5e-3)


def test_tangent_of_the_moving_rod_is_the_derivative_of_its_forces():
    rod = HubRod(10.0, 2.8e3, 1.0e3, 1.4e4, 1.2, 6e-4, degree=3)
    basis, u = rod._basis(), 0.3 * np.sin(np.arange(9.0))
    K = rod._inner(basis, u)[1]
    d = 1e-6
    differences = [
        (rod._inner(basis, u + s)[0] - rod._inner(basis, u - s)[0]) / (2 * d) for s in d * np.eye(9)
    ]
    # Central differences: round-off 1e-16/1e-6.
    np.testing.assert_allclose(K, np.array(differences).T, rtol=0, atol=1e-8 * np.max(np.abs(K)))


def test_moving_rod_at_constant_speed_has_the_extension_of_the_closed_form():
    rod = HubRod(10.0, 2.8e7, 1.0e7, 1.4e4, 1.2, 6e-4, degree=3)
    times = np.linspace(0, 32, 321)

    def slowly(t):
        # Up to 6 rad/s within 20 s, smooth.
        s = min(t / 20, 1.0)
        return 0.0, 6 * s**3 * (10 - 15 * s + 6 * s * s), 6 * 30 * s**2 * (1 - s) ** 2 / 20

    late = rod.tip(slowly, times)[0, times > 25].mean()
    k = 6 * 10 * np.sqrt(1.2 / 2.8e7)
    # Vibrations left over shorten it by their square.
    assert late == pytest.approx(10 * (np.tan(k) / k - 1), rel=2e-3)
