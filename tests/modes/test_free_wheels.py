"""Modes beside motions that nothing holds: a wheel that turns freely is a point mass.

Its terms are nothing beside those of the beam that carries it: what is rigid must not be decided by
round-off of the others, nor by units.
"""

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Bushing,
    Clamp,
    FollowerForce,
    Material,
    Pin,
    PointMass,
    RigidBody,
    RotationalFriction,
    Scene,
    Spherical,
    TorsionalSpringDamper,
    assemble,
    modes,
    suggest_step,
)
from ancfdae.modes.eigenpairs import with_zeros
from ancfdae.modes.linearised import Linearised
from ancfdae.results import LinearisationPoint, ModeKind
from ancfdae.sections import Rectangle

# Units of length, mass and time in their SI units, inverted.
UNITS = [(1.0, 1.0, 1.0), (1e3, 1e-3, 1.0), (1e3, 1.0, 1e3), (0.3, 1.0, 1e-3), (1.0, 3.0, 7.0)]
WHEEL = 0.2  # kg


def arm(d, elements, units, *, wheel=True, damped=False, follower=False, hung=False):
    """A clamped arm with a wheel, or with its mass, at the end; a block that hangs in springs."""
    m, kg, s = units
    zero = (0.0,) * (d - 2)
    newton, pascal = kg * m / s**2, kg / (m * s**2)
    rubber = Material(1200 * kg / m**3, 5e7 * pascal, 0.35, 1e-4 * s if damped else 0.0)
    end = (0.6 * m, 0.1 * m, *zero)
    beam = Beam("arm", (0.0, 0.0, *zero), end, elements, Rectangle(0.01 * m, 0.013 * m), rubber)
    inertia = 1e-4 * kg * m**2 * np.array([1.0, 1.1, 1.2])
    of_plane = {"inertia": inertia[0] if d == 2 else tuple(inertia)}
    bodies, joints, loads = [], [Clamp(beam.at_start)], []
    if wheel:
        body = RigidBody("wheel", end, mass=WHEEL * kg, **of_plane)
        bodies.append(body)
        joint = Pin if d == 2 else Spherical
        joints.append(joint(beam.at_end, body.at(*(0.0,) * d)))
    else:
        bodies.append(PointMass(beam.at_end, WHEEL * kg))
    if follower:
        loads.append(FollowerForce(beam.at_end, (0.0, 0.01 * newton, *zero)))
    if hung:
        body = RigidBody("block", (0.3 * m, 0.5 * m, *zero), mass=0.3 * kg, **of_plane)
        bodies.append(body)
        stiffness = np.array([10.0, 20.0, 30.0])[:d] * kg / s**2
        loads.append(Bushing(body.at(*(0.0,) * d), tuple(stiffness), other=beam.at(0.5)))
    return Scene([beam], joints, bodies=bodies, loads=loads)


@pytest.mark.parametrize("follower", [False, True])
@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize(
    ("d", "elements", "units"),
    [*((d, 4, units) for d in (2, 3) for units in UNITS), (2, 40, UNITS[3]), (3, 12, UNITS[4])],
)
def test_a_free_wheel_is_a_point_mass(d, elements, damped, follower, units):
    free = 1 if d == 2 else 3
    given = {"damped": damped, "follower": follower}
    found = modes(arm(d, elements, units, **given), 4 + free)
    assert found.kinds[:free] == (ModeKind.RIGID,) * free
    expected = modes(arm(d, elements, UNITS[0], wheel=False, **given), 4).exponents
    np.testing.assert_allclose(found.exponents[free : free + 4] * units[2], expected, rtol=1e-8)


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_what_hangs_in_springs_turns_freely(d, damped, units):
    free = 2 if d == 2 else 6
    scene = arm(d, 4, units, damped=damped, hung=True)
    assert modes(scene, free).kinds == (ModeKind.RIGID,) * free
    found = modes(scene, free + 3)
    assert found.kinds[:free] == (ModeKind.RIGID,) * free
    expected = modes(arm(d, 4, UNITS[0], wheel=False, damped=damped, hung=True), free + 3)
    slow = [s for s in expected.exponents if s.imag][:3]
    np.testing.assert_allclose(found.exponents[free : free + 3] * units[2], slow, rtol=1e-8)


@pytest.mark.parametrize("units", UNITS)
def test_friction_in_its_bearing_is_all_that_a_wheel_loses(units):
    m, kg, s = units
    scene = arm(2, 4, units, damped=True)
    viscous = 1e-6 * kg * m**2 / s
    bearing = RotationalFriction(scene.bodies[0].at(0.0, 0.0), coulomb=0.0, smooth_speed=1.0 / s,
                            viscous=viscous, name="bearing")  # fmt: skip
    with_friction = Scene(scene.beams, scene.joints, bodies=scene.bodies, loads=[bearing])
    found = modes(with_friction, 60)  # All: decays come after vibrations, the slowest first.
    decay = [e.real for e, kind in zip(found.exponents, found.kinds, strict=True)
             if kind is ModeKind.DECAYING]  # fmt: skip
    np.testing.assert_allclose(decay[0] * s, -1e-6 / 1e-4, rtol=1e-8)


def test_a_step_counts_no_motion_that_nothing_holds():
    for scene, expected in ((arm(3, 4, u), arm(3, 4, u, wheel=False)) for u in UNITS):
        found, other = (suggest_step(x, follow=3) for x in (scene, expected))
        np.testing.assert_allclose(
            [found.step, found.slowest], [other.step, other.slowest], rtol=1e-9
        )


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("units", UNITS)
def test_a_rod_that_topples_comes_before_its_wheel(units, damped):
    m, kg, s = units
    rod = RigidBody("rod", (0, 0.5 * m), mass=0.3 * kg, inertia=0.02 * kg * m**2)
    wheel = RigidBody("wheel", (0, m), mass=WHEEL * kg, inertia=1e-4 * kg * m**2)
    foot, top = rod.at(0, -0.5 * m), rod.at(0, 0.5 * m)
    damper = TorsionalSpringDamper(foot, 0.0, 0.1 * kg * m**2 / s)
    given = {"gravity": (0, -9.81 * m / s**2), "loads": [damper] if damped else []}
    pins = [Pin(foot), Pin(top, wheel.at(0, 0))]
    found = modes(Scene([], pins, bodies=[rod, wheel], **given), 4)
    assert found.kinds[:2] == (ModeKind.GROWING, ModeKind.RIGID)
    # (I + m l^2) s^2 + c s = (m_rod l/2 + m_wheel l) g
    inertia, stiffness = 0.02 + 0.3 * 0.25 + WHEEL, 9.81 * (0.15 + WHEEL)
    c = 0.1 if damped else 0.0
    grows = (np.sqrt(c**2 + 4 * inertia * stiffness) - c) / (2 * inertia)
    np.testing.assert_allclose(found.exponents[0].real * s, grows, rtol=1e-9)
    # Each shape belongs to its exponent: the wheel alone turns in the second.
    moved = np.abs(found.shapes[:6] / m ** np.array([1, 1, 0, 0, 0, 0])[:, None])
    assert np.max(moved[:, 1]) < 1e-9 * np.max(moved[:, 0])


def test_what_is_found_beside_rigid_motions_keeps_the_change_of_the_last_sweep():
    """Values of motions that were mixed are as doubtful as the worst of them."""
    scene = arm(2, 4, UNITS[0])
    system = assemble(scene)
    small = Linearised.of(
        system, LinearisationPoint(system.start()[0], np.zeros(system.n_lam)), None
    )
    X = modes(scene, 3).shapes
    # The wheel and the first bending, mixed, and named zero by the values that come with them.
    mixed = np.stack([X[:, 0] + X[:, 1], X[:, 0] - X[:, 1], X[:, 2]], axis=1) / np.sqrt([2, 2, 1])
    z = np.array([0.0, 0.0, 1e4])
    values, shapes, change = with_zeros(small, z, mixed, np.array([0.3, 0.7, 0.1]))
    assert values[0] == 0
    np.testing.assert_allclose(values[1], modes(scene, 3).frequencies[1] ** 2, rtol=1e-9)
    np.testing.assert_array_equal(change, [0.0, 0.7, 0.1])
    np.testing.assert_allclose(np.abs(shapes.T @ small.times(small.M, X)), np.eye(3), atol=1e-9)
