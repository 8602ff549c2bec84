"""Stresses in sections against elasticity: Saint-Venant, Bredt, Jourawski, Golovin."""

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    CurvedBeam,
    Material,
    Moment,
    PointForce,
    SaintVenantKirchhoff,
    Scene,
    assemble,
    equilibrium,
)
from ancfdae.assembly import section_results as stress_points
from ancfdae.errors import InvalidInputError
from ancfdae.model.sections.spread import rectangle_torsional_shear
from ancfdae.sections import (
    Box,
    Circle,
    GeneralSection,
    ISection,
    QuadratureSection,
    Rectangle,
    Tube,
)
from ancfdae.sensitivity.observables.observable import States, observe
from ancfdae.sensitivity.observables.sections import maximum_von_mises, von_mises

STEEL = Material(density=7800.0, youngs_modulus=2e11, poisson_ratio=0.3)
G = 2e11 / 2.6
PLACES = np.linspace(-0.5, 0.5, 401)


def torsion(section):
    return section.torsion(np.array([section.sizes()]))[0]


def cantilever(section, load, d=3, length=1.0, **changes):
    end = (length, 0.0, 0.0)[:d]
    rod = Beam("rod", (0.0,) * d, end, 4, section, STEEL, **changes)
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[load(rod)])
    found = equilibrium(scene)
    assert found.outcome.success
    return rod, found.solution, assemble(scene)


# ---------------------------------------------------------------- torsion


def rectangle(h, w, y, z):
    """Torsional shear in one rectangle."""
    arrays = [np.reshape(x, (1, -1)) for x in (h, w, y, z)]
    t_y, t_z = rectangle_torsional_shear(*map(np.asarray, arrays))
    return t_y[0], t_z[0]


@pytest.mark.parametrize(
    # Torque over (long side, square of short side, largest shear), shear of the short side over
    # that of the long one: Timoshenko & Goodier, sec. 109; Roark, table 10.1.
    ("ratio", "alpha", "share"),
    [(1.0, 0.208, 1.0), (1.5, 0.231, 0.858), (2.0, 0.246, 0.796), (4.0, 0.282, 0.745)],
)
@pytest.mark.parametrize("upright", [True, False])
def test_torsional_shear_of_rectangles_as_published(ratio, alpha, share, upright):
    h, w = (ratio, 1.0) if upright else (1.0, ratio)
    t_y, t_z = rectangle(h, w, [0.0, h / 2], [w / 2, 0.0])
    long, short = (-t_y[0], t_z[1]) if upright else (t_z[1], -t_y[0])
    # Half of the last digit printed; that of the share is off by one.
    assert abs(torsion(Rectangle(h, w)) / (ratio * long) - alpha) < 5e-4
    assert abs(short / long - share) < 1.5e-3


@pytest.mark.parametrize(("h", "w"), [(1.0, 1.0), (3.0, 1.0), (1.0, 7.0)])
def test_torsional_shear_of_rectangles_solves_its_equations(h, w):
    y, z = (x.ravel() for x in np.meshgrid([-0.43, 0.1, 0.3], [-0.2, 0.01, 0.49], indexing="ij"))
    y, z = h * y, w * z
    step = 1e-20j
    in_y = np.array(rectangle(h, w, y + step, z + 0j)).imag / 1e-20
    in_z = np.array(rectangle(h, w, y + 0j, z + step)).imag / 1e-20
    # Balance along x, and a rate of twist of 1: curl of the shear strains.
    assert np.max(np.abs(in_y[0] + in_z[1])) < 1e-12
    assert np.max(np.abs(in_y[1] - in_z[0] - 2.0)) < 1e-12
    # No stress on the surface.
    side = np.array([-0.5, -0.3, 0.0, 0.2, 0.5])
    assert np.max(np.abs(rectangle(h, w, 0 * side + h / 2, w * side)[0])) < 1e-14 * max(h, w)
    assert np.max(np.abs(rectangle(h, w, h * side, 0 * side + w / 2)[1])) < 1e-14 * max(h, w)
    # The torque is G J; 40 points leave 3e-7 of it, for the corners.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    Y, Z = (x.ravel() for x in np.meshgrid(h / 2 * nodes, w / 2 * nodes, indexing="ij"))
    t_y, t_z = rectangle(h, w, Y, Z)
    torque = h * w / 4 * np.outer(weights, weights).ravel() @ (Y * t_z - Z * t_y)
    assert abs(torque / torsion(Rectangle(h, w)) - 1) < 1e-6


IN_TORSION = {
    # Largest shear over the torque, where it is, and where it is another share of it.
    "strip": (Rectangle(0.05, 0.005), lambda J: 1 / (0.3123 * 0.05 * 0.005**2), (0, 0.0025), 3e-4),
    "square": (Rectangle(0.02, 0.02), lambda J: 1 / (0.2082 * 0.02**3), (0.01, 0), 3e-4),
    "circle": (Circle(0.01), lambda J: 0.01 / J, (0.006, 0.008), 1e-5),
    "tube": (Tube(0.02, 0.002), lambda J: 0.02 / J, (0, 0.02), 1e-5),
    # Bredt's T/(2 A t) on middle lines in the thinner wall.
    "box": (Box(0.1, 0.06, 0.003, 0.004), lambda J: 1 / (2 * 0.096 * 0.057 * 0.003), (0, 0.03), 0),
    # T t/J in the thicker wall of an open section.
    "I": (ISection(0.1, 0.055, 0.0041, 0.0057), lambda J: 0.0057 / J, (0.05, 0), 1e-4),
}


@pytest.mark.parametrize("name", IN_TORSION)
@pytest.mark.parametrize("energy", [{}, {"energy": SaintVenantKirchhoff()}])
def test_stress_of_torsion_is_that_of_the_torque(name, energy):
    section, formula, place, tolerance = IN_TORSION[name]
    T = 1e-4 * G * torsion(section)
    rod, *state = cantilever(section, lambda rod: Moment(rod.at_end, (T, 0, 0)), **energy)
    expected = np.sqrt(3) * T * formula(torsion(section))
    found = observe(von_mises(rod.at(0.6, *place)), *state)[0]
    # The ends turn by 1e-4: strains of the section leave 2e-5 in the box, and less elsewhere.
    assert abs(found / expected - 1) < 5e-5 + tolerance
    # 500 takes at most log(192)/500 = 1.05 % of the aggregate.
    largest = observe(maximum_von_mises("rod", 500 / expected), *state)[0]
    assert 1 - 5e-5 - tolerance < largest / expected < 1.0106 + tolerance


def test_a_declared_torsion_constant_leaves_the_stress_of_the_torque():
    plain, other = Rectangle(0.05, 0.005), Rectangle(0.05, 0.005, torsion_constant=1e-9)
    found = []
    for section in (plain, other):
        rod, *state = cantilever(section, lambda rod: Moment(rod.at_end, (0.01, 0, 0)))
        found.append(observe(von_mises(rod.at(0.6, z=0.0025)), *state)[0])
    assert found[1] == pytest.approx(found[0], rel=1e-5)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 5.0, 20.0])
def test_no_stress_on_the_sides_is_larger_than_that_of_the_outline(ratio):
    section = Rectangle(ratio, 1.0)
    sizes, random = np.array([section.sizes()]), np.random.default_rng(3)
    one = np.ones_like(PLACES)
    y = np.concatenate([ratio * PLACES, 0.5 * ratio * one])
    z = np.concatenate([0.5 * one, PLACES])
    outline = tuple(x[0] for x in section.outline(sizes))
    stresses = []
    forces = random.standard_normal((2000, 4)) * 10 ** random.uniform(-1, 1, (2000, 4))
    for at in ((y, z), (-y, -z), (y, -z), outline):
        shear = np.hypot(*rectangle(ratio, 1.0, *at))
        normal = forces[:, :3] @ np.stack([0 * at[0] + 1, 2 * at[0] / ratio, 2 * at[1]])
        stresses.append(np.max(normal**2 + 3 * (forces[:, 3:] * shear) ** 2, axis=1))
    everywhere = np.max(stresses[:3], axis=0)
    assert np.max(np.sqrt(everywhere / stresses[3])) < 1.035


# ---------------------------------------------------------------- shear and radial stress

SECTIONS = [
    Rectangle(0.04, 0.02),
    Circle(0.01),
    Tube(0.02, 0.003),
    Box(0.04, 0.02, 2e-3, 3e-3),
    ISection(0.04, 0.02, 2e-3, 3e-3),
    GeneralSection(2e-4, 2e-8, 1e-8, 2e-8),
]


@pytest.mark.parametrize("section", SECTIONS)
def test_shares_of_shear_are_one_in_the_mean(section):
    sizes = np.array([section.sizes()])
    points = section.points(sizes, True)
    if isinstance(section, GeneralSection):  # a rectangle: four points know no mean of squares
        h, w = 2 * np.array(section.half_extents)
        points = Rectangle(h, w).points(np.array([[h, w]]), True)
    y, z, dA = points
    for share in section.shares(sizes, y, z):
        # Gauss points do not know where webs end across flanges.
        if not isinstance(section, Box | ISection):
            assert np.sum(share * dA) / np.sum(dA) == pytest.approx(1.0, rel=1e-12)
    half_y, half_z = (np.array([[half]]) for half in section.half_extents)
    none = np.zeros((1, 1))
    assert abs(section.shares(sizes, half_y, none)[0][0, 0]) < 1e-14
    assert abs(section.shares(sizes, none, half_z)[1][0, 0]) < 1e-14


def test_shares_of_walls_are_one_in_the_mean():
    nodes, weights = np.polynomial.legendre.leggauss(8)
    for section in (Box(0.04, 0.02, 2e-3, 3e-3), ISection(0.04, 0.02, 2e-3, 3e-3)):
        sizes = np.array([section.sizes()])
        web = 2e-3 if isinstance(section, ISection) else 4e-3
        flanges = (0.017, 0.02, 0.02), (-0.02, -0.017, 0.02)
        along_y = [(-0.017, 0.017, web), *flanges]
        along_z = [(-0.008, 0.008, 6e-3), (-0.01, -0.008, 0.04), (0.008, 0.01, 0.04)]
        if isinstance(section, ISection):
            along_z = [(-1e-3, 1e-3, 0.04), (-0.01, -1e-3, 6e-3), (1e-3, 0.01, 6e-3)]
        for axis, parts in enumerate((along_y, along_z)):
            total, area = 0.0, 0.0
            for low, high, width in parts:
                at = (low + high) / 2 + (high - low) / 2 * nodes[None]
                share = section.shares(sizes, at, at)[axis][0]
                total += width * (high - low) / 2 * (weights @ share)
                area += width * (high - low)
            assert total / area == pytest.approx(1.0, rel=1e-12)


def test_shear_in_the_middle_is_one_and_a_half_times_the_mean():
    for d in (2, 3):
        load = (0.0, 1e3, 0.0)[:d]
        rod, *state = cantilever(Rectangle(0.02, 0.01), lambda rod: PointForce(rod.at_end, load), d)  # noqa: B023
        found = observe(von_mises(rod.at(0.6)), *state)[0]
        # Strains of up to 1e-2 (deflection of 0.25) turn 1e-2 of the axis' force into shear.
        assert found == pytest.approx(np.sqrt(3) * 1.5 * 1e3 / 2e-4, rel=0.05)


@pytest.mark.parametrize("name", ["square", "circle", "tube", "box", "I"])
@pytest.mark.parametrize("axis", [1, 2])
def test_torsion_and_shear_add_on_one_side_and_oppose_on_the_other(name, axis):
    # A twist t moves places at z > 0 along -y and those at y > 0 along z. Half way along there is
    # no bending: a force at the end, a moment that takes its own away there.
    section = IN_TORSION[name][0]
    T, F = 0.05, 5.0
    bending = (0.0, 0.3 * F, 0.0) if axis == 2 else (0.0, 0.0, -0.3 * F)
    force = tuple(F * np.eye(3)[axis])
    half = section.half_extents[2 - axis]
    if name == "I":
        half = [section.half_extents[0], section.web_thickness / 2][axis % 2]
    sums = []
    for torque in (T, -T, 0.0):
        rod = Beam("rod", (0, 0, 0), (1, 0, 0), 4, section, STEEL)
        loads = [PointForce(rod.at_end, force)]
        loads.append(Moment(rod.at_end, tuple(np.add((torque, 0, 0), bending))))
        scene = Scene([rod], [Clamp(rod.at_start)], loads=loads)
        state = equilibrium(scene).solution, assemble(scene)
        place = {"z": half} if axis == 1 else {"y": half}
        sums.append(observe(von_mises(rod.at(0.7, **place)), *state)[0] / np.sqrt(3))
    shear, twist = sums[2], T * IN_TORSION[name][1](torsion(section))
    if name == "box" and axis == 2:
        twist *= 3 / 4  # the thicker wall
    if name == "I" and axis == 1:
        twist *= 0.7193  # the web, as thin as it is and with its ends
    sign = 1 if axis == 2 else -1
    assert sums[0] == pytest.approx(abs(shear + sign * twist), rel=2e-3)
    assert sums[1] == pytest.approx(abs(shear - sign * twist), rel=2e-3)


def golovin(a, b, M, r):
    """Radial and hoop stress in a curved bar of unit width in bending (Timoshenko, sec. 29)."""
    log = np.log(b / a)
    N = (b**2 - a**2) ** 2 - 4 * a**2 * b**2 * log**2
    ring = a**2 * b**2 / r**2 * log
    both = b**2 * np.log(r / b) + a**2 * np.log(a / r)
    return -4 * M / N * np.array([ring + both, -ring + both + b**2 - a**2])


@pytest.mark.parametrize(("ratio", "error"), [(1.0, 0.036), (2.0, 0.0105), (5.0, 0.003)])
@pytest.mark.parametrize("d", [2, 3])
def test_stress_in_a_curved_bar(ratio, error, d):
    h, n = 0.01, 24
    R, turn = ratio * h, np.linspace(0, np.pi / 2, n + 1)
    c, s = np.cos(turn), np.sin(turn)
    places, frames = np.zeros((n + 1, 3)), np.zeros((n + 1, 3, 3))
    places[:, 0], places[:, 1] = R * s, R * (1 - c)
    frames[:, 0, :2], frames[:, 1, :2] = np.stack([c, s], 1), np.stack([-s, c], 1)
    frames[:, 2, 2] = 1.0
    rod = CurvedBeam("rod", places[:, :d], frames[:, :d, :d], Rectangle(h, h), STEEL)
    M = 0.2e6 * h**3 / 6  # strains of 1e-6
    load = Moment(rod.at_end, M if d == 2 else (0, 0, M))
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[load])
    found = equilibrium(scene)
    y = h * np.linspace(-0.5, 0.5, 9)
    points = [rod.at((n / 2 + 0.5) / n, y=x) for x in y]
    state = found.solution, assemble(scene)
    stresses = np.array([observe(von_mises(point), *state)[0] for point in points])
    radial, hoop = golovin(R - h / 2, R + h / 2, M / h, R - y)
    exact = np.sqrt(radial**2 + hoop**2 - radial * hoop)
    assert np.max(np.abs(stresses - exact)) < error * np.max(exact)
    # The largest is at the surface, where the radial stress is none: Winkler's error only.
    largest = observe(maximum_von_mises("rod", 5000 / np.max(exact)), *state)[0]
    assert abs(largest / np.max(exact) - 1) < 0.008


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("section", "inside", "outside"),
    [
        (Rectangle(0.04, 0.02), (0.02, 0.01), (0.0201, 0.0)),
        (Circle(0.01), (0.006, 0.008), (0.008, 0.008)),
        (Tube(0.01, 0.003), (0.0, 0.007), (0.0, 0.0)),
        (Box(0.04, 0.02, 2e-3, 3e-3), (0.0, 0.008), (0.0, 0.007)),
        (ISection(0.04, 0.02, 2e-3, 3e-3), (0.017, 0.01), (0.016, 0.01)),
    ],
)
def test_places_without_material_are_refused(section, inside, outside):
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 1, section, STEEL)
    system = assemble(Scene([rod]))
    von_mises(rod.at(0.5, *inside)).check(system)
    with pytest.raises(InvalidInputError, match=r"material|in the section"):
        von_mises(rod.at(0.5, *outside)).check(system)


def test_a_section_of_moments_reaches_as_far_as_their_rectangle():
    # The rectangle of 4 by 2 cm.
    section = GeneralSection(8e-4, 8e-4 * 16e-4 / 12, 8e-4 * 4e-4 / 12, 1e-8)
    np.testing.assert_allclose(section.half_extents, (0.02, 0.01), rtol=1e-14)
    rod = Beam("rod", (0, 0), (1, 0), 1, section, STEEL)
    system = assemble(Scene([rod]))
    von_mises(rod.at(0.5, 0.02)).check(system)
    with pytest.raises(InvalidInputError, match="in the section"):
        von_mises(rod.at(0.5, 0.021)).check(system)


@pytest.mark.parametrize(
    "section",
    [
        GeneralSection(2e-4, 2e-8, 1e-8, 2e-8),
        QuadratureSection(places=[(0.01, 0.0), (-0.01, 0.01), (-0.01, -0.01)], areas=[1e-4] * 3),
    ],
)
def test_sections_without_a_shape_have_no_stress_in_space(section):
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 1, section, STEEL)
    system = assemble(Scene([rod]))
    for stress in (von_mises(rod.at(0.5)), maximum_von_mises("rod", 1.0)):
        with pytest.raises(InvalidInputError, match="torsion"):
            stress.check(system)


def test_stresses_of_many_states_are_those_of_each(monkeypatch):
    # Three packets: velocities of a damped beam belong to their states in each.
    damped = Material(density=7800.0, youngs_modulus=2e11, poisson_ratio=0.3, damping_time=1e-3)
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.02, 0.01), damped)
    system, random = assemble(Scene([rod])), np.random.default_rng(1)
    q, v = (x + 1e-2 * random.standard_normal((7, len(x))) for x in system.start())
    stress = maximum_von_mises("rod", 1e-9)
    rows = [slice(k, k + 1) for k in range(7)]
    states = [States(np.zeros(1), q[k], v[k], np.zeros((1, 0))) for k in rows]
    each = [stress.partials(system, state) for state in states]
    points = system.sections.stress_over("rod")
    monkeypatch.setattr(stress_points, "_TOGETHER", 3 * points._law.count)
    whole = stress.partials(system, States(np.zeros(7), q, v, np.zeros((7, 0))))
    for name in ("value", "q", "v"):
        expected = np.concatenate([getattr(one, name) for one in each])
        np.testing.assert_allclose(getattr(whole, name), expected, rtol=1e-12, atol=0)
