"""Meshes too coarse to bend are warned of: elastica, Castigliano's arc, the ring's vibrations.

An estimate that is below the error by more than a factor would miss cases here, and one above it
would warn of meshes that are right: both sides are checked against closed forms.
"""

import warnings
from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import simpson, solve_bvp

from ancfdae import (
    CABLE_2D,
    HHT,
    Beam,
    Clamp,
    CurvedBeam,
    Material,
    Pin,
    PointForce,
    Scene,
    Terminal,
    Weld,
    assemble,
    critical_load,
    equilibrium,
    equilibrium_gradient,
    gradient,
    modes,
    simulate,
)
from ancfdae.errors import CoarseMeshWarning
from ancfdae.observables import position
from ancfdae.sections import Rectangle

E, RHO = 2e11, 7800.0
HALF = np.sqrt(0.5)


def warned(call):
    """Return the result of a call, and whether it warned of the mesh."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call()
    assert {x.category for x in caught} <= {CoarseMeshWarning}
    return result, len(caught) > 0


@lru_cache
def elastica(load):
    """Tip deflection over L of a cantilever under F L^2/EI = load: theta'' = -load cos theta."""
    found = solve_bvp(
        lambda s, y: [y[1], -load * np.cos(y[0])],
        lambda a, b: [a[0], b[1]],
        np.linspace(0, 1, 200),
        np.zeros((2, 200)),
        tol=1e-10,
        max_nodes=100_000,
    )
    s = np.linspace(0, 1, 4001)
    return float(simpson(np.sin(found.sol(s)[0]), x=s))


def cantilever(h, n, load, **material):
    rod = Beam("rod", (0, 0), (1, 0), n, Rectangle(h, 0.02), Material(RHO, E, 0.3, **material))
    force = load * E * 0.02 * h**3 / 12
    return rod, Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at_end, (0, force))])


@pytest.mark.parametrize("h", [2e-2, 2e-3, 2e-4])
@pytest.mark.parametrize("load", [0.03, 0.1, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("n", [1, 2, 4, 8])
def test_a_thin_cantilever_that_misses_the_elastica_is_warned_of(h, load, n):
    rod, scene = cantilever(h, n, load)
    found, told = warned(lambda: equilibrium(scene))
    error = abs(found.solution.position(rod.at_end)[0, 1] / elastica(load) - 1)
    if error > 0.025:
        assert told
    if error < 0.008:
        assert not told


@pytest.mark.parametrize("moved", [(0.0, 0.0), (300.0, -200.0)])
@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_the_estimate_has_no_unit_and_no_place(unit, moved):
    """Lengths in m or mm, here or 360 lengths away; the deflection is 5.7 % too small."""
    start = unit * np.array(moved)
    end = start + np.array([unit, 0.0])
    rod = Beam(
        "rod", start, end, 2, Rectangle(2e-3 * unit, 0.02 * unit), Material(1.0, E / unit**2, 0.3)
    )
    load = PointForce(rod.at_end, (0, 0.3 * E * 0.02 * 8e-9 / 12))
    system = assemble(Scene([rod], [Clamp(rod.at_start)], loads=[load]))
    with pytest.warns(CoarseMeshWarning):
        found = equilibrium(system)
    assert system.coarse(found.q[None])["rod"] == pytest.approx(0.0091788125, rel=1e-8)


def arc(dimension, h, n):
    """A quarter circle of radius 1 from (1, 0) to (0, 1), clamped at its start."""
    points = ((1, 0), (HALF, HALF), (0, 1))
    points = [(*x, *[0] * (dimension - 2)) for x in points]
    return CurvedBeam.arc("arc", *points, n, Rectangle(h, h), Material(RHO, E, 0.0))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("h", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("n", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_thin_arc_that_misses_castigliano_is_warned_of(dimension, h, n, axis):
    """F R^3/EI times pi/4 along the chord of the load, 3 pi/4 - 2 across; and N and V."""
    force = 1e-6 * E * h**4 / 12
    beam = arc(dimension, h, n)
    loads = [PointForce(beam.at_end, force * np.eye(dimension)[axis])]
    scene = Scene([beam], [Clamp(beam.at_start)], loads=loads)
    found, told = warned(
        lambda: equilibrium_gradient(scene, position(beam.at_end, axis), design=["arc.height"])
    )
    exact = 1e-6 * (np.pi / 4 if axis else 3 * np.pi / 4 - 2)
    exact += force / (E * h * h) * np.pi / 4 * (1 + 2.4)
    error = abs((found.value - axis) / exact - 1)
    if error > 0.025:
        assert told
    if error < 0.015:
        assert not told


@pytest.mark.parametrize(
    ("h", "n", "lost"), [(1e-2, 1, 0.955), (1e-2, 2, 0.126), (1e-3, 2, 0.907), (1e-4, 4, 0.795)]
)
def test_curvature_in_the_reference_tells_what_an_unloaded_arc_lacks(h, n, lost):
    """The missing part of the deflection under an end force, as measured (docs/measurements.md)."""
    system = assemble(Scene([beam := arc(2, h, n)], [Clamp(beam.at_start)]))
    assert 5 * system.coarse(system.start()[0][None])["arc"] == pytest.approx(lost, abs=0.04)


@pytest.mark.parametrize("h", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("n", [8, 16, 32, 64])
def test_a_ring_that_vibrates_too_fast_is_warned_of(h, n):
    """omega = 6/sqrt(5) sqrt(E I/rho A)/R^2 (Hoppe 1871, two waves, without extension)."""
    material, section = Material(RHO, E, 0.0), Rectangle(h, h)
    upper = CurvedBeam.arc("upper", (1, 0), (0, 1), (-1, 0), n // 2, section, material)
    lower = CurvedBeam.arc("lower", (-1, 0), (0, -1), (1, 0), n // 2, section, material)
    welds = [Weld(upper.at_end, lower.at_start), Weld(upper.at_start, lower.at_end)]
    found, told = warned(lambda: modes(Scene([upper, lower], welds), 5))
    bending = found.frequencies[found.exponents != 0][0] / np.sqrt(E * h * h / 12 / RHO)
    error = bending / (6 / np.sqrt(5)) - 1
    if error > 0.02:
        assert told
    if error < 0.01:
        assert not told


@pytest.mark.parametrize(("n", "expected"), [(8, True), (16, True), (32, False)])
def test_a_semicircle_that_buckles_too_late_is_warned_of(n, expected):
    """P = 5.864 E I/R^2 between pins (64 elements); 8 elements find 6.74, 16 5.965, 32 5.88."""
    h = 1e-3
    beam = CurvedBeam.arc(
        "arc", (-1, 0), (0, 1), (1, 0), n, Rectangle(h, 2 * h), Material(RHO, E, 0.3)
    )
    crown = PointForce(beam.at(0.5), (0, 0.0), name="crown")
    scene = Scene([beam], [Pin(beam.at_start), Pin(beam.at_end)], loads=[crown])
    EI = E * 2 * h**4 / 12
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = critical_load(scene, "crown.force_y", to=-60 * EI)
    error = -found.value / EI / 5.864 - 1
    assert (error > 0.01) == expected
    assert bool(caught) == expected
    assert not expected or caught[-1].filename == __file__


@pytest.mark.parametrize(("n", "told"), [(1, True), (2, True), (4, False)])
def test_a_motion_of_a_thin_beam_of_few_elements_is_warned_of_once(n, told):
    """The swing under a sudden end force: 24 % short with 1 element, 3.9 % with 2, 0.3 % with 4."""
    _, scene = cantilever(2e-3, n, -0.1, damping_time=1e-3)
    _, found = warned(lambda: simulate(scene, 0.6, HHT(2e-3)))
    assert found == told


def test_ropes_that_fall_are_no_coarse_meshes():
    """A folded rope is 25 % off in its bending energy, which does not shape its fall."""
    rope = Beam("rope", (0, 0), (1, 0), 6, Rectangle(1e-3, 1e-3), Material(RHO, 1e7, 0.0),
                element=CABLE_2D)  # fmt: skip
    system = assemble(Scene([rope], [Pin(rope.at_start)], gravity=(0, -9.81)))
    run, told = warned(lambda: simulate(system, 0.3, HHT(1e-3)))
    assert not told
    assert "rope" in system.coarse(run.q[-1:])


def test_warnings_name_the_line_of_the_call():
    _, scene = cantilever(2e-3, 1, 0.3)
    ring = arc(2, 1e-3, 4)
    calls = (
        lambda: equilibrium(scene),
        lambda: simulate(scene, 0.3, HHT(2e-2)),
        lambda: modes(Scene([ring], [Clamp(ring.at_start)]), 2),
    )
    for call in calls:
        with pytest.warns(CoarseMeshWarning, match="too few elements for the bending") as caught:
            call()
        assert [x.filename for x in caught] == [__file__]


def test_a_bar_that_vibrates_along_its_axis_is_no_coarse_mesh():
    """Waves along the axis strain elements unevenly, but by what their stretch can follow."""
    rod = Beam("rod", (0, 0), (1, 0), 4, Rectangle(2e-3, 0.02), Material(RHO, E, 0.3))
    pull = PointForce(rod.at_end, (1000.0, 0.0))
    weight = Scene([rod], [Clamp(rod.at_start)], (0, -1e-3), loads=[pull])
    _, told = warned(lambda: simulate(weight, 2e-3, HHT(1e-5)))
    assert not told


@pytest.mark.parametrize(("n", "told"), [(1, True), (2, True), (4, False)])
def test_gradients_of_runs_of_thin_beams_of_few_elements_are_warned_of(n, told):
    rod, scene = cantilever(2e-3, n, -0.1, damping_time=1e-3)
    end = Terminal(position(rod.at_end, 1))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gradient(scene, end, 0.6, HHT(2e-3), design=["rod.height"])
    assert [x.category for x in caught] == [CoarseMeshWarning] * told
    assert all(x.filename == __file__ for x in caught)
