"""Growing motions and groups of equal parts, against the parts alone: nothing joins them."""

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    DesignVariable,
    FollowerForce,
    Material,
    PointForce,
    RotatingFrame,
    Scene,
    assemble,
    equilibrium,
    modes,
)
from ancfdae.modes import undamped
from ancfdae.modes.linearised import LinearisationPoint, Linearised
from ancfdae.numerics import inertia
from ancfdae.sections import Rectangle

STEEL, RUBBER = Material(7850, 2.1e11, 0.3), Material(1100, 5e6, 0.3)
HEIGHT = 0.01
EULER = np.pi**2 * 2.1e11 * HEIGHT**4 / 12 / 4


def columns(loads, material=STEEL):
    """Return straight clamped columns under parts of Euler's load, and the beams and forces."""
    beams = [
        Beam(f"b{k}", (0, 0.1 * k), (1, 0.1 * k), 6, Rectangle(HEIGHT, HEIGHT), material)
        for k in range(len(loads))
    ]
    forces = [
        PointForce(beam.at_end, (-load * EULER, 0)) for beam, load in zip(beams, loads, strict=True)
    ]
    return beams, forces


def scene(beams, forces):
    return Scene(beams, [Clamp(beam.at_start) for beam in beams], loads=forces)


def growing_alone(beams, forces):
    """Return the growing exponents of each column by itself, fastest first."""
    found = []
    for beam, force in zip(beams, forces, strict=True):
        alone = scene([beam], [force])
        s = modes(alone, 6, at=equilibrium(alone)).exponents
        found += list(s[s.real > 1.0].real)
    return np.sort(found)[::-1]


@pytest.mark.parametrize("elements", [100, 300])
def test_a_column_that_buckles_is_seen_beside_a_soft_strip(elements):
    """Twenty motions of the strip lie nearer to zero than either growing one."""
    beams, forces = columns([12.0])
    wanted = growing_alone(beams, forces)
    assert len(wanted) == 2
    strip = Beam("strip", (0, 1), (3, 1), elements, Rectangle(HEIGHT, HEIGHT), RUBBER)
    both = scene([*beams, strip], forces)
    at = equilibrium(both)
    for count in (1, 6, 12):
        s = modes(both, count, at=at).exponents
        np.testing.assert_allclose(s[: min(count, 2)].real, wanted[:count], rtol=2e-3)
        assert np.sum(s.real > 1.0) == min(count, 2)


@pytest.mark.parametrize("damping_time", [0.0, 1e-5])
def test_growing_motions_come_first_and_fastest_first(damping_time):
    material = Material(7850, 2.1e11, 0.3, damping_time=damping_time)
    loads = np.random.default_rng(0).uniform(0.5, 14, 12)
    beams, forces = columns(loads, material)
    wanted = growing_alone(beams, forces)
    together = scene(beams, forces)
    at = equilibrium(together)
    for count in (1, 3, len(wanted) + 3):
        s = modes(together, count, at=at).exponents
        assert np.sum(s.real > 1.0) == min(count, len(wanted))
        first = min(count, len(wanted))
        np.testing.assert_allclose(s[:first].real, wanted[:first], rtol=1e-4)


def test_equal_columns_grow_together():
    """Eight of each: a Krylov space holds one, and the count shows that others lack."""
    beams, forces = columns([0.5, 1.5, 12.0] * 8)
    wanted = growing_alone(beams[:3], forces[:3])
    together = scene(beams, forces)
    at = equilibrium(together)
    for count in (1, 9, 25):
        s = modes(together, count, at=at).exponents
        first = min(len(s), 24)
        np.testing.assert_allclose(s[:first].real, np.repeat(wanted, 8)[:first], rtol=1e-6)


def test_lanczos_finds_them_without_dense_matrices():
    beams, forces = columns([0.5, 1.5, 12.0] * 8)
    together = scene(beams, forces)
    at = equilibrium(together)
    point = LinearisationPoint(at.q, at.lam)
    small = Linearised.of(assemble(together), point, None)
    z = undamped.lowest_of_all(small, 26, 24)[0]
    assert np.sum(z < 0) == 24
    np.testing.assert_allclose(z[:8], z[0], rtol=1e-9)


@pytest.mark.parametrize("copies", [25, 40])
def test_highest_modes_of_equal_parts_have_all_digits(copies):
    def cantilevers(number):
        beams = [
            Beam(f"b{k}", (0, 0.1 * k), (1, 0.1 * k), 3, Rectangle(0.03, 0.03), STEEL)
            for k in range(number)
        ]
        return scene(beams, [])

    one = modes(cantilevers(1), 2, highest=True).natural_frequencies
    for count in (copies + 1, copies + 5, 2 * copies):
        found = modes(cantilevers(copies), count, highest=True).natural_frequencies
        np.testing.assert_allclose(found, np.repeat(one, copies)[: len(found)], rtol=1e-10)


@pytest.mark.parametrize("count", [5, 50])
def test_free_bodies_are_free_however_many(count):
    beams = [
        Beam(f"b{k}", (0, 0.1 * k), (1, 0.1 * k), 3, Rectangle(0.03, 0.03), STEEL)
        for k in range(28)
    ]
    found = modes(Scene(beams, []), count)
    assert len(found.exponents) == count
    assert np.all(found.exponents == 0)


def blades(number, elements):
    """Equal blades around an axis about which they rotate."""
    beams = []
    for k in range(number):
        angle = 2 * np.pi * k / number
        along = np.array([np.cos(angle), np.sin(angle), 0])
        beams.append(
            Beam(
                f"b{k}",
                tuple(0.2 * along),
                tuple(1.2 * along),
                elements,
                Rectangle(0.01, 0.05),
                STEEL,
                height_axis=(-along[1], along[0], 0),
            )
        )
    joints = [Clamp(beam.at_start) for beam in beams]
    return Scene(beams, joints, frame=RotatingFrame(rate=60.0))


def test_the_lowest_mode_of_more_blades_than_arnoldi_looks_for_is_that_of_one():
    """Forty blades have 40 exponents that coincide, more than 1,500 motions, and one is asked for.

    One, two, four and eight times as many vectors as for one mode do not hold all 40.
    """
    one, many = (
        modes(turning, 1, at=equilibrium(turning)) for turning in (blades(1, 3), blades(40, 3))
    )
    np.testing.assert_allclose(many.frequencies, one.frequencies, rtol=1e-7)


def test_blades_that_coincide_have_the_derivatives_of_one():
    def of_rate_and_height(number):
        turning = blades(number, 2)
        height = DesignVariable("h", [f"b{k}.height" for k in range(number)])
        return modes(turning, number, at=equilibrium(turning), design=["scene.rate", height])

    one, many = of_rate_and_height(1), of_rate_and_height(30)
    assert np.all(one.frequencies_b > 0.1)
    np.testing.assert_allclose(many.frequencies, np.repeat(one.frequencies, 30), rtol=1e-7)
    np.testing.assert_allclose(
        many.frequencies_b, np.repeat(one.frequencies_b, 30, axis=0), rtol=1e-5
    )
    np.testing.assert_allclose(many.natural_frequencies_b, many.frequencies_b, rtol=1e-5)


def beck(beams, loads):
    """Return clamped columns whose tips are pushed along them, by parts of E I / L^2."""
    stiffness = 2.1e11 * HEIGHT**4 / 12
    forces = [
        FollowerForce(beam.at_end, (-load * stiffness, 0), name=f"push {beam.name}")
        for beam, load in zip(beams, loads, strict=True)
    ]
    return scene(beams, forces)


@pytest.mark.parametrize("elements", [20, 40])
def test_flutter_is_seen_beside_a_soft_strip(elements):
    """Beck's column flutters above 20.05; thirty motions of the strip are slower."""
    beams, _ = columns([0.0])
    alone, strip = (
        beck(beams, [25.0]),
        Beam("strip", (0, 1), (3, 1), elements, Rectangle(HEIGHT, HEIGHT), RUBBER),
    )
    joints = [Clamp(beams[0].at_start), Clamp(strip.at_start)]
    both = Scene([*beams, strip], joints, loads=alone.loads)
    wanted = modes(alone, 1, at=equilibrium(alone)).exponents[0]
    assert wanted.real > 50
    at = equilibrium(both)
    assert at.outcome.flutter == pytest.approx(wanted, rel=1e-6)
    assert at.outcome.flutter_searched
    for count in (1, 6, 12):
        s = modes(both, count, at=at).exponents
        assert s[0] == pytest.approx(wanted, rel=1e-6)
        assert np.sum(s.real > 1.0) == 1
    calm = Scene([*beams, strip], joints, loads=beck(beams, [19.0]).loads)
    assert equilibrium(calm).outcome.flutter is None


@pytest.mark.parametrize("damping_time", [0.0, 1e-5])
def test_columns_that_flutter_come_first_as_each_alone(damping_time):
    material = Material(7850, 2.1e11, 0.3, damping_time=damping_time)
    loads = np.random.default_rng(3).uniform(15, 30, 10)
    beams, _ = columns(loads, material)
    wanted = []
    for beam, load in zip(beams, loads, strict=True):
        alone = beck([beam], [load])
        s = modes(alone, 4, at=equilibrium(alone)).exponents
        wanted += list(s[s.real > 1.0])
    wanted = np.array(sorted(wanted, key=lambda s: -s.real))
    assert len(wanted) > 3
    together = beck(beams, loads)
    at = equilibrium(together)
    for count in (1, 2, 5):
        first = min(count, len(wanted))
        found = modes(together, count, at=at).exponents[:first]
        np.testing.assert_allclose(found, wanted[:first], rtol=1e-5)


def test_a_verdict_on_part_of_the_motions_says_so(monkeypatch):
    monkeypatch.setattr(inertia, "WHOLE", 50)
    beams, _ = columns([0.0] * 3)
    found = equilibrium(beck(beams, [5.0] * 3)).outcome
    assert not found.flutter_searched
    assert "only the twenty next to zero" in str(found)
