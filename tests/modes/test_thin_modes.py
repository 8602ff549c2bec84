"""Modes of very thin beams against cubic Hermite elements of Euler's beam, or a refusal."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ancfdae import Beam, Material, Pin, Revolute, Scene, Spherical, SpringDamper, Weld, modes
from ancfdae.errors import AncfdaeError
from ancfdae.modes.precise import NoModes
from ancfdae.results import ModeKind
from ancfdae.sections import Rectangle
from validation.thin_beams import cantilever_frequencies, euler_frequencies, thin_cantilever

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


@pytest.mark.parametrize("nu", [0.3, 0.49])
@pytest.mark.parametrize("elements", [3, 8, 9])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("slenderness", [1e-3, 3e-4, 1e-4, 3e-5])
def test_a_free_thin_beam_has_all_rigid_motions(slenderness, d, elements, nu):
    rigid = 3 * (d - 1)
    found = modes(thin_cantilever(slenderness, elements, d, nu, free=True), rigid + d - 1)
    assert found.kinds == (ModeKind.RIGID,) * rigid + (ModeKind.VIBRATION,) * (d - 1)
    unit = np.sqrt(E * slenderness**2 / 12 / RHO)
    # Three elements are 0.3 % too stiff.
    np.testing.assert_allclose(found.frequencies[rigid:] / unit, 22.3733, rtol=3e-3)


def free_beam(slenderness, elements, nu, turned):
    """A free square bar of 1 m in space, along x or in a direction without a zero component."""
    rotation = Rotation.from_rotvec((0.3, -1.1, 0.7)).as_matrix() if turned else np.eye(3)
    section, material = Rectangle(slenderness, slenderness), Material(RHO, E, nu)
    return Scene([Beam("rod", (0, 0, 0), tuple(rotation[:, 0]), elements, section, material)], [])


@pytest.mark.rounding
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("nu", [0.0, 0.49])
@pytest.mark.parametrize("elements", [2, 3, 4])
@pytest.mark.parametrize(
    "slenderness", [3e-4, 2.06e-4, 1.53e-4, 1.33e-4, 1.16e-4, 3e-5, 1.24e-5, 5.17e-6, 1.98e-6]
)
def test_free_thin_beams_in_space_bend_as_cubic_elements_or_are_refused(
    slenderness, elements, nu, turned
):
    """Round-off of the spin, of next to no inertia, is larger than the stiffness of bending."""
    try:
        found = modes(free_beam(slenderness, elements, nu, turned), 8)
    except NoModes:
        assert slenderness < 1e-5
        return
    assert found.kinds == (ModeKind.RIGID,) * 6 + (ModeKind.VIBRATION,) * 2
    unit = np.sqrt(E * slenderness**2 / 12 / RHO)
    expected = euler_frequencies(elements)[2:4]
    # Half of the 2e-6 of omega^2 that are promised; shear and rotary inertia are 4 (h/L)^2 = 4e-7.
    np.testing.assert_allclose(found.frequencies[6:] / unit, expected[0], rtol=1.4e-6)


def linkage(kind, d, slenderness, elements):
    """Two beams at an angle, free or hinged to the ground, with a hinge or a weld between them."""
    section, plane = Rectangle(slenderness, slenderness), (0.0,) * (d - 2)
    material = Material(RHO, E, 0.3)
    a = Beam("a", (0.0, 0.0, *plane), (1.0, 0.0, *plane), elements, section, material)
    b = Beam("b", (1.0, 0.0, *plane), (1.7, 0.4, *plane), elements, section, material)
    if kind == "weld":
        return Scene([a, b], [Weld(a.at_end, b.at_start)])
    if d == 2:
        hinge, held = Pin(a.at_end, b.at_start), Pin(a.at_start)
    else:
        hinge, held = Spherical(a.at_end, b.at_start), Revolute(a.at_start, axis=(0, 0, 1))
    return Scene([a, b], [hinge, held] if kind == "chain" else [hinge])


@pytest.mark.parametrize("slenderness", [1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    ("kind", "rigid"), [("weld", (3, 6)), ("hinge", (4, 9)), ("chain", (2, 4))]
)
def test_thin_linkages_keep_their_rigid_motions_and_the_law_of_similarity(
    kind, rigid, d, slenderness
):
    """Frequencies of bending are proportional to the height; a spin has next to no inertia."""
    number = rigid[d - 2]
    found = modes(linkage(kind, d, slenderness, 3), number + 2)
    thick = modes(linkage(kind, d, 2e-3, 3), number + 2)
    assert [k == ModeKind.RIGID for k in found.kinds[: number + 2]] == [True] * number + [False] * 2
    scale = slenderness / 2e-3
    bending = thick.frequencies[number : number + 2] * scale
    np.testing.assert_allclose(found.frequencies[number : number + 2], bending, rtol=1e-3)


@pytest.mark.parametrize("slenderness", [3e-6, 1e-6])
def test_values_below_the_digits_of_those_of_the_section_are_found_beside_them(slenderness):
    found = modes(thin_cantilever(slenderness, 3), 7).frequencies
    unit = np.sqrt(E * slenderness**2 / 12 / RHO)
    np.testing.assert_allclose(found[:6] / unit, cantilever_frequencies(3)[:6], rtol=1e-6)
    assert found[6] / unit > 1e6  # Of the bar along its axis.


@pytest.mark.parametrize("slenderness", [1e-4, 1e-5])
def test_a_thin_cantilever_of_one_damped_material_keeps_its_digits(slenderness):
    tau = 1e-4
    found = modes(thin_cantilever(slenderness, damping_time=tau), 2).exponents
    omega = np.sqrt(E * slenderness**2 / 12 / RHO) * cantilever_frequencies(8)[:2]
    half = 0.5 * tau * omega**2
    # Shear and rotary inertia: (h/L)^2 times 10 and less; the damping of bending is its square.
    np.testing.assert_allclose(found, -half + 1j * np.sqrt(omega**2 - half**2), rtol=1e-6)


def test_what_is_too_thin_for_its_matrix_is_refused_in_words():
    scene = thin_cantilever(1e-6, damping_time=1e-4)
    tip = SpringDamper(scene.beams[0].at_end, 0.0, 1e-9, ground=(1.0, 1.0))
    with pytest.raises(AncfdaeError, match="too thin"):
        modes(replace(scene, loads=[tip]), 4)
