"""Modes of very thin beams against cubic Hermite elements of Euler's beam, or a refusal."""

import numpy as np
import pytest

from ancfdae import MotionKind, modes
from ancfdae.errors import AncfdaeError
from validation.thin_beams import cantilever_frequencies, thin_cantilever

E, RHO = 1e9, 1000.0


@pytest.mark.parametrize("elements", [7, 8])
@pytest.mark.parametrize("slenderness", [1e-4, 3e-5, 1e-5])
def test_frequencies_of_thin_cantilevers_are_those_of_cubic_elements(slenderness, elements):
    found = modes(thin_cantilever(slenderness, elements), 3).frequencies
    unit = np.sqrt(E * slenderness**2 / 12 / RHO)
    # Shear and rotary inertia: (h/L)^2 times 10 and less. Nodes at sevenths are round-off.
    np.testing.assert_allclose(found / unit, cantilever_frequencies(elements)[:3], rtol=1e-6)


def test_a_nearly_incompressible_thin_cantilever_in_space_bends_as_euler_says():
    found = modes(thin_cantilever(1e-4, d=3, nu=0.49), 4).frequencies
    unit = np.sqrt(E * 1e-8 / 12 / RHO)
    np.testing.assert_allclose(found / unit, np.repeat(cantilever_frequencies(8)[:2], 2), rtol=1e-6)


@pytest.mark.parametrize("slenderness", [1e-4, 1e-5])
def test_pairs_of_thin_round_bars_coincide(slenderness):
    found = modes(thin_cantilever(slenderness, d=3, round_bar=True), 4)
    assert found.coincide[:2] == ((0, 1), (2, 3))
    np.testing.assert_allclose(found.frequencies[1::2], found.frequencies[::2], rtol=1e-8)


@pytest.mark.parametrize("slenderness", [1e-3, 1e-4])
def test_a_free_thin_beam_has_all_rigid_motions(slenderness):
    found = modes(thin_cantilever(slenderness, d=3, nu=0.49, free=True), 8)
    assert found.kinds == (MotionKind.RIGID,) * 6 + (MotionKind.VIBRATION,) * 2


def test_what_is_too_thin_for_its_matrix_is_refused_in_words():
    with pytest.raises(AncfdaeError, match="too thin"):
        modes(thin_cantilever(1e-5, damping_time=1e-4), 4)
