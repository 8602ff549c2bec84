"""Mass, centre of mass, inertia and momentum: those of bodies in textbooks, and their derivatives.

Products of a dozen numbers carry 1e-15 of round-off; CLOSE leaves some room.
"""

import numpy as np
import pytest

from ancfdae import (
    Beam,
    InitialVelocity,
    Material,
    PointMass,
    RigidBody,
    Scene,
    assemble,
    mass_properties,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.sections import Circle, Rectangle
from ancfdae.sensitivity.observables.mass import (
    angular_momentum,
    centre_of_mass,
    inertia,
    linear_momentum,
    mass,
)
from ancfdae.sensitivity.observables.observable import States

STEEL = Material(density=7800.0, youngs_modulus=2e11, poisson_ratio=0.3)
CLOSE = 1e-13
H, W, R = 0.06, 0.04, 0.05


BLOCK = Rectangle(H, W)


def bar(name, start, end, section=BLOCK):
    return Beam(name, start, end, 3, section, STEEL)


def at_start(system):
    q, v = system.start()
    return States(np.zeros(1), q[None], v[None], np.zeros((1, system.n_lam)))


def seen(observable, system):
    return observable.value(system, at_start(system))[0]


def test_a_block_has_its_tensor_of_inertia():
    # Turned out of the axes: length along t, height along y, width along z.
    t = np.array([0.6, 0.64, -0.48])
    start, L = np.array([1.0, -2.0, 0.5]), 1.5
    rod = Beam(
        "rod", tuple(start), tuple(start + L * t), 3, Rectangle(H, W), STEEL, (0.8, -0.6, 0.3)
    )
    found = mass_properties(Scene([rod]))
    m = 7800 * L * H * W
    axes = rod.reference().slopes[0]
    own = m / 12 * np.array([H**2 + W**2, L**2 + W**2, L**2 + H**2])
    assert found.mass == pytest.approx(m, rel=CLOSE)
    assert np.allclose(found.centre, start + L / 2 * t, rtol=CLOSE, atol=0)
    # Squares of places, 5, less those of the centre.
    assert np.allclose(found.inertia, axes.T @ np.diag(own) @ axes, rtol=0, atol=1e-13 * m * 5)


def test_masses_and_moments_add_up_about_any_point():
    first, second = bar("first", (0.0, 0.0), (1.0, 0.0)), bar("second", (1.0, 0.0), (1.0, 0.5))
    system = assemble(Scene([first, second]))
    masses = [seen(mass(name), system) for name in ("first", "second")]
    assert seen(mass(), system) == pytest.approx(sum(masses), rel=CLOSE)
    for axis, places in ((0, (0.5, 1.0)), (1, (0.0, 0.25))):
        mean = np.dot(masses, places) / sum(masses)
        assert seen(centre_of_mass(axis), system) == pytest.approx(mean, rel=CLOSE)
    for about, place in ((first.at_end, (1.0, 0.0)), ((0.3, -0.4), (0.3, -0.4))):
        expected = 0.0
        for m, L, centre in zip(masses, (1.0, 0.5), ((0.5, 0.0), (1.0, 0.25)), strict=True):
            # Steiner's rule.
            expected += m * (L**2 + H**2) / 12 + m * np.sum(np.subtract(centre, place) ** 2)
        assert seen(inertia(about=about), system) == pytest.approx(expected, rel=CLOSE)


def test_a_body_that_spins_has_momentum_as_a_rigid_one():
    rod = bar("rod", (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), Circle(R))
    spin = np.array([0.5, -1.0, 2.0])
    system = assemble(Scene([rod], start=[InitialVelocity("rod", tuple(spin), (0.0, 0.0, 0.0))]))
    m = 7800 * np.pi * R**2
    for axis in range(3):
        expected = m * np.cross(spin, (1.5, 0.0, 0.0))[axis]
        assert seen(linear_momentum(axis), system) == pytest.approx(expected, rel=CLOSE, abs=1e-13)
        tensor = [seen(inertia(axis, other, about=(0.0, 0.0, 0.0)), system) for other in range(3)]
        found = seen(angular_momentum(axis, "rod"), system)
        assert found == pytest.approx(np.dot(tensor, spin), rel=CLOSE)


def test_rigid_bodies_and_point_masses_count():
    tensor = (2.0, 3.0, 4.0, 0.1, -0.2, 0.3)
    body = RigidBody("body", (1.0, 2.0, 3.0), mass=5.0, inertia=tensor, centre=(0.1, 0.0, -0.2))
    load = PointMass(body.at(0.0, 0.5, 0.0), 2.0, name="load")
    system = assemble(Scene(bodies=[body, load]), ["body.mass", "load.mass"])
    alone = mass_properties(system, "body")
    assert alone.mass == pytest.approx(5.0, rel=CLOSE)
    assert np.allclose(alone.centre, (1.1, 2.0, 2.8), rtol=CLOSE, atol=0)
    full = [[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]]
    # Squares of places, 9, times the mass, less those of the centre.
    assert np.allclose(alone.inertia, full, rtol=0, atol=1e-12)
    place = np.array([0.3, -0.4, 0.7])
    d = (1.1, 2.0, 2.8) - place
    # Steiner's rule, moments and products.
    steiner = full + 5 * (d @ d * np.eye(3) - np.outer(d, d))
    tensor = [
        [seen(inertia(i, j, beam="body", about=tuple(place)), system) for j in range(3)]
        for i in range(3)
    ]
    assert np.allclose(tensor, steiner, rtol=0, atol=1e-12)
    both = mass_properties(system)
    assert both.mass == pytest.approx(7.0, rel=CLOSE)
    assert np.allclose(both.mass_b, [1.0, 1.0], rtol=CLOSE, atol=0)
    mean = (5 * np.array([1.1, 2.0, 2.8]) + 2 * np.array([1.0, 2.5, 3.0])) / 7
    assert np.allclose(both.centre, mean, rtol=CLOSE, atol=0)
    expected = ((1.1, 2.0, 2.8) - mean) / 7, ((1.0, 2.5, 3.0) - mean) / 7
    assert np.allclose(both.centre_b, np.transpose(expected), rtol=0, atol=CLOSE)


def test_derivatives_are_those_of_the_formulas():
    L = 1.5
    scene = Scene([bar("rod", (0.2, 0.1), (0.2, 0.1 + L))])
    found = mass_properties(scene, design=["rod.length", "rod.height", "rod.density"])
    m, I = 7800 * L * H * W, 7800 * L * H * W * (L**2 + H**2) / 12
    assert np.allclose(found.mass_b, [m / L, m / H, m / 7800], rtol=CLOSE, atol=0)
    # The start of the rod stays.
    assert np.allclose(found.centre_b, [[0, 0, 0], [0.5, 0, 0]], rtol=0, atol=1e-13)
    expected = [I / L + m * L / 6, I / H + m * H / 6, I / 7800]
    assert np.allclose(found.inertia_b[0, 0], expected, rtol=1e-12, atol=0)


def test_what_does_not_exist_is_refused():
    scene = Scene([bar("rod", (0.0, 0.0), (1.0, 0.0))])
    with pytest.raises(UnknownNameError):
        mass_properties(scene, "rood")
    with pytest.raises(InvalidInputError, match="Scene"):
        mass_properties(scene.beams[0])
    for observable in (inertia(0), centre_of_mass(2), angular_momentum(1)):
        with pytest.raises(InvalidInputError, match="in the plane"):
            observable.check(assemble(scene))
    for action in (lambda: inertia(3), lambda: inertia(0, -1), lambda: linear_momentum("x")):
        with pytest.raises(InvalidInputError, match="from 0 to 2"):
            action()
    with pytest.raises(InvalidInputError, match="about"):
        inertia(about="rod")
