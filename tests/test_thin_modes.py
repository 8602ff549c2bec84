"""Modes of very thin beams against cubic Hermite elements of Euler's beam, or a refusal."""

import numpy as np
import pytest
import scipy

from ancfdae import Beam, Circle, Clamp, Material, MotionKind, Rectangle, Scene, modes
from ancfdae.errors import AncfdaeError

E, RHO = 1e9, 1000.0


def euler(elements):
    """Frequencies of a cantilever of cubic elements, in units of sqrt(E I / (rho A L^4))."""
    l = 1 / elements
    k = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / l**3
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
    size = 2 * elements + 2
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for e in range(elements):
        own = slice(2 * e, 2 * e + 4)
        K[own, own] += k
        M[own, own] += m * l / 420
    return np.sqrt(scipy.linalg.eigh(K[2:, 2:], M[2:, 2:], eigvals_only=True))


def scene(slenderness, elements=8, d=2, nu=0.3, free=False, round_bar=False, **damping):
    size = slenderness
    section = Circle(size / 2) if round_bar else Rectangle(size, size)
    end = (1.0,) + (0.0,) * (d - 1)
    rod = Beam("rod", (0.0,) * d, end, elements, section, Material(RHO, E, nu, **damping))
    return Scene([rod], [] if free else [Clamp(rod.at_start)])


@pytest.mark.parametrize("elements", [7, 8])
@pytest.mark.parametrize("slenderness", [1e-4, 3e-5, 1e-5])
def test_frequencies_of_thin_cantilevers_are_those_of_cubic_elements(slenderness, elements):
    found = modes(scene(slenderness, elements), 3).frequencies
    unit = np.sqrt(E * slenderness**2 / 12 / RHO)
    # Shear and rotary inertia: (h/L)^2 times 10 and less. Nodes at sevenths are round-off.
    np.testing.assert_allclose(found / unit, euler(elements)[:3], rtol=1e-6)


def test_a_nearly_incompressible_thin_cantilever_in_space_bends_as_euler_says():
    found = modes(scene(1e-4, d=3, nu=0.49), 4).frequencies
    unit = np.sqrt(E * 1e-8 / 12 / RHO)
    np.testing.assert_allclose(found / unit, np.repeat(euler(8)[:2], 2), rtol=1e-6)


@pytest.mark.parametrize("slenderness", [1e-4, 1e-5])
def test_pairs_of_thin_round_bars_coincide(slenderness):
    found = modes(scene(slenderness, d=3, round_bar=True), 4)
    assert found.coincide[:2] == ((0, 1), (2, 3))
    np.testing.assert_allclose(found.frequencies[1::2], found.frequencies[::2], rtol=1e-8)


@pytest.mark.parametrize("slenderness", [1e-3, 1e-4])
def test_a_free_thin_beam_has_all_rigid_motions(slenderness):
    found = modes(scene(slenderness, d=3, nu=0.49, free=True), 8)
    assert found.kinds == (MotionKind.RIGID,) * 6 + (MotionKind.VIBRATION,) * 2


def test_what_is_too_thin_for_its_matrix_is_refused_in_words():
    with pytest.raises(AncfdaeError, match="too thin"):
        modes(scene(1e-5, damping_time=1e-4), 4)
