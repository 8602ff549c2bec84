"""Strain energies against beam theory: what bends, stretches, shears and twists how far.

Tolerances: where an element is exact for small loads, what is left is the square of the load
(1e-5 of the length, so 1e-10 relative) and the condition number of the static system, up to 1e10,
times round-off: 1e-6. Elsewhere the comment says what discretisation error is expected.
"""

import numpy as np
import pytest

from ancfdae import (
    BEAM_2D,
    BEAM_3D,
    Beam,
    Clamp,
    CurvedBeam,
    EnhancedContinuum,
    Material,
    Moment,
    PlaneStress,
    PointForce,
    Scene,
    assemble,
)
from ancfdae.errors import InvalidInputError
from ancfdae.model.elements import Batch, ElementParameter
from ancfdae.model.elements.invariants import prepare
from ancfdae.sections import (
    Box,
    Circle,
    GeneralSection,
    ISection,
    QuadratureSection,
    Rectangle,
    Tube,
)
from tests.support.element_kinds import ENERGIES, SECTIONS, arc, kind_of, straight
from tests.support.members import force_q

E, NU = 1e9, 0.3
ONE_POINT = QuadratureSection(places=[(0.1, 0.2)], areas=[1.0])
A_LINE = QuadratureSection(places=[(-0.01, -0.02), (0.02, 0.04), (0.0, 0.0)], areas=[1.0, 1.0, 1.0])


#: Every energy in every dimension that it knows.
ENERGIES_OF_SPACES = [(name, d) for name, x in ENERGIES.items() for d in x.dimensions]


def rest(scene, steps=1):
    """Static equilibrium by plain Newton steps with dense matrices, loads grown in steps."""
    system = assemble(scene)
    q, v = system.start()
    n, n_lam, pattern = system.n_q, system.n_lam, system.pattern
    load = system.force(0.0, q, v)
    lam = np.zeros(n_lam)
    for k in range(1, steps + 1):
        for _ in range(60):
            K, B = np.zeros((n, n)), np.zeros((n_lam, n))
            K[pattern.rows, pattern.columns] = -force_q(system, 0.0, q, v)
            own = system.constraint_pattern
            B[own.rows, own.columns] = system.constraint_q(0.0, q)
            residual = system.force(0.0, q, v) - B.T @ lam - (1 - k / steps) * load
            matrix = np.block([[K, B.T], [B, np.zeros((n_lam, n_lam))]])
            step = np.linalg.solve(matrix, np.append(residual, -system.constraint(0.0, q)))
            q, lam = q + step[:n], lam + step[n:]
            if np.max(np.abs(step[:n])) < 1e-13 * np.max(np.abs(q)):
                break
    return system, q.reshape(-1, system.naming.layout.bodies[0].stride, system.naming.layout.d)


def moments(section):
    sizes = np.array([section.sizes()])
    y, z, dA = section.points(sizes, False)
    k_y, k_z, J = section.properties(sizes, np.array([NU]))
    A, I = dA.sum(), (np.sum(dA * y * y), np.sum(dA * z * z))
    return A, I, (k_y[0], k_z[0]), J[0]


def cantilever(section, n, load, length=1.0, energy=None, nu=NU, moment=None):
    d = len(load) if load is not None else 3 if np.ndim(moment) else 2
    end = (length,) + (0.0,) * (d - 1)
    beam = Beam("beam", (0.0,) * d, end, n, section, Material(1000.0, E, nu), energy=energy)
    tip = Moment(beam.at_end, moment) if load is None else PointForce(beam.at_end, load)
    return Scene([beam], [Clamp(beam.at_start)], loads=[tip])


# ---------------------------------------------------------------- sections


@pytest.mark.parametrize("name", SECTIONS)
def test_sections_bend_stretch_and_twist_as_beams_of_their_properties(name):
    section = SECTIONS[name]
    A, I, k, J = moments(section)
    G, F = E / (2 * (1 + NU)), 1e-7 * E * min(I)
    for axis in (1, 2):
        load = np.eye(3)[axis] * F
        X = rest(cantilever(section, 2, tuple(load)))[1]
        expected = F / (3 * E * I[axis - 1]) + F / (k[axis - 1] * G * A)
        assert abs(X[-1, 0, axis] / expected - 1) < 1e-6
    X = rest(cantilever(section, 2, (1e-6 * E * A, 0.0, 0.0)))[1]
    # F = E A eps (1 + 3/2 eps) with the strain of Green and Lagrange, eps = 1e-6; digits of 1 m.
    assert abs((X[-1, 0, 0] - 1) / 1e-6 - 1) < 5e-6
    X = rest(cantilever(section, 2, None, moment=(1e-5 * G * J, 0.0, 0.0)))[1]
    turn = np.arctan2(X[-1, 2, 2], X[-1, 2, 1])
    # What turns is the skew part of the slopes; the free end of a section of unequal axes may shear
    # in its plane besides, a part that the torsion constant does not know.
    assert abs(turn / 1e-5 - 1) < 1e-3


def test_torsion_constants_of_rectangles():
    # Timoshenko & Goodier, table 7: J/(a b^3) for b <= a, printed to three digits.
    published = {1: 0.1406, 1.2: 0.166, 1.5: 0.196, 2: 0.229, 2.5: 0.249, 3: 0.263, 4: 0.281}
    published |= {5: 0.291, 10: 0.312}
    for ratio, expected in published.items():
        for sizes in ([ratio, 1.0], [1.0, ratio]):
            J = Rectangle(1, 1).torsion(np.array([sizes]))[0] / ratio
            assert abs(J - expected) < 6e-4  # half of the last digit printed
    for ratio in (1.0, 1.7):
        n = np.arange(1, 2001, 2)  # the rest is below 1/(8 n^4) = 1e-14
        series = np.sum(np.tanh(n * np.pi * ratio / 2) / n**5)
        J = Rectangle(1, 1).torsion(np.array([[ratio, 1.0]]))[0]
        assert abs(J / ratio - (1 / 3 - 64 / np.pi**5 / ratio * series)) < 1e-13
    # A thin strip: b^3 a / 3 (1 - 0.63 b/a).
    J = Rectangle(1, 1).torsion(np.array([[1000.0, 1.0]]))[0]
    assert abs(J / (1000 / 3 * (1 - 0.630249e-3)) - 1) < 1e-8


def test_a_section_off_its_axis_bends_and_twists_about_its_centroid():
    # A quarter circle, phi = 0.2 per element: the same error of fourth order wherever the axis is,
    # up to the finite strain of the axis, the square of 0.03. Then the declared torsion constant
    # under a small torque.
    grid = 0.005 * np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)])
    weights = np.array([(a, b) for a in (1, 4, 1) for b in (1, 4, 1)]).prod(axis=1) / 36
    turn, found = np.pi / 2, []
    for centre in ([0.0, 0.0], [0.02, 0.0]):
        section = QuadratureSection(places=np.add(grid, centre), areas=1e-4 * weights)
        scene = cantilever(section, 8, None, moment=turn * E * 0.01**4 / 12)
        X = rest(scene, 12)[1]
        found.append(np.arctan2(-X[-1, 2, 0], X[-1, 2, 1]) / turn - 1)
    assert max(map(abs, found)) < 1e-3
    section = QuadratureSection(
        places=np.add(grid, [0.02, 0.01]), areas=1e-4 * weights, torsion_constant=1e-9
    )
    torque = 1e-5 * E / (2 * (1 + NU)) * 1e-9
    X = rest(cantilever(section, 2, None, moment=(torque, 0.0, 0.0)))[1]
    # A warping part as in the test above.
    assert abs(np.arctan2(X[-1, 2, 2], X[-1, 2, 1]) / 1e-5 - 1) < 1e-3


@pytest.mark.parametrize("name", SECTIONS)
def test_points_of_sections_have_their_moments(name):
    section = SECTIONS[name]
    sizes = np.array([section.sizes()])
    exact = {
        "rectangle": (2e-4, 0.01 * 0.02**3 / 12, 0.02 * 0.01**3 / 12),
        "circle": (np.pi * 1e-4, np.pi / 4 * 1e-8, np.pi / 4 * 1e-8),
        "tube": 2 * (np.pi / 4 * (1e-8 - 0.008**4),),
        "box": (
            0.02 * 0.03 - 0.016 * 0.028,
            (0.03 * 0.02**3 - 0.028 * 0.016**3) / 12,
            (0.02 * 0.03**3 - 0.016 * 0.028**3) / 12,
        ),
        "I": (
            0.04 * 0.03 - 0.034 * 0.028,
            (0.03 * 0.04**3 - 0.028 * 0.034**3) / 12,
            (0.006 * 0.03**3 + 0.034 * 0.002**3) / 12,
        ),
        "moments": (1e-4, 2e-9, 1e-9),
        "points": (8e-5, 8e-5 * 0.006**2, 8e-5 * 0.004**2),
    }[name]
    for fine in (False, True):
        y, z, dA = section.points(sizes, fine)
        found = (dA.sum(), np.sum(dA * y * y), np.sum(dA * z * z))[-len(exact) :]
        np.testing.assert_allclose(found, exact, rtol=1e-13)
        for odd in (y, z, y * z, y**3, y * y * z):  # all of them are doubly symmetric
            assert abs(np.sum(dA * odd)) < 1e-15 * np.sum(dA)
    y, z = np.max(np.abs(y)), np.max(np.abs(z))
    assert y <= section.half_extents[0] * (1 + 1e-12)
    assert z <= section.half_extents[1] * (1 + 1e-12)


def test_fourth_moments_of_round_sections():
    # Circle: int y^4 = pi R^6 / 8 is of degree 4, exact in both rules; an annulus the difference.
    for fine in (False, True):
        y, z, dA = Tube(0.01, 0.002).points(np.array([[0.01, 0.002]]), fine)
        expected = np.pi / 8 * (0.01**6 - 0.008**6)
        assert abs(np.sum(dA * y**4) / expected - 1) < 1e-13
        assert abs(np.sum(dA * y**2 * z**2) / (expected / 3) - 1) < 1e-13


def test_shear_factors_meet_in_their_limits():
    nu = np.array([NU])
    solid = 6 * (1 + NU) / (7 + 6 * NU)
    thick = Tube(1.0, 0.99).shear(np.array([[1.0, 1 - 1e-9]]), nu)[0][0]
    assert abs(thick / solid - 1) < 1e-8
    thin = Tube(1.0, 0.1).shear(np.array([[1.0, 1e-9]]), nu)[0][0]
    assert abs(thin / (2 * (1 + NU) / (4 + 3 * NU)) - 1) < 1e-8  # Cowper's thin tube
    assert Circle(1.0).shear(np.ones((1, 1)), nu)[0][0] == pytest.approx(solid, rel=1e-15)
    # Flanges that vanish leave webs, a rectangle.
    alone = Rectangle(1, 1).shear(np.array([[1.0, 0.1]]), nu)[0][0]
    for section in (Box(1, 1, 0.1, 0.1), ISection(1, 1, 0.1, 0.1)):
        bare = section.shear(np.array([[1.0, 0.1, 0.01, 1e-9]]), nu)[0][0]
        assert abs(bare / alone - 1) < 1e-6


def wall_shear(h, w, t_w, t_f, webs):
    """Shear factor I^2/(A int Q^2/t ds) of thin walls, webs of the height h between flanges."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    y, part = h / 2 * nodes, w / 4 * (nodes + 1)
    inertia = webs * t_w * h**3 / 12 + w * t_f * h**2 / 2
    web = w * t_f * h / (2 * webs) + t_w / 2 * (h**2 / 4 - y**2)
    flange = part * t_f * h / 2  # from its free ends to the web, or from its middle to the webs
    energy = webs * (h / 2) * (weights @ web**2) / t_w + w * (weights @ flange**2) / t_f
    return inertia**2 / ((webs * h * t_w + 2 * w * t_f) * energy)


@pytest.mark.parametrize("sizes", [(1.0, 0.7, 0.01, 0.03), (0.6, 0.9, 0.04, 0.01)])
def test_shear_factors_of_thin_walls(sizes):
    # Without Poisson's effect Cowper's factors are those of the energy of the shear flow.
    h, w, t_w, t_f = sizes
    outer, nu = np.array([[h + t_f, w + t_w, t_w, t_f]]), np.zeros(1)
    k_y, k_z = Box(1, 1, 0.1, 0.1).shear(outer, nu)
    assert abs(k_y[0] / wall_shear(h, w, t_w, t_f, 2) - 1) < 1e-13
    assert abs(k_z[0] / wall_shear(w, h, t_f, t_w, 2) - 1) < 1e-13
    outer = np.array([[h + t_f, w, t_w, t_f]])
    k_y, k_z = ISection(1, 1, 0.1, 0.1).shear(outer, nu)
    assert abs(k_y[0] / wall_shear(h, w, t_w, t_f, 1) - 1) < 1e-13
    flanges = 2 * w * t_f / (2 * w * t_f + (h - t_f) * t_w)  # share of the area
    assert abs(k_z[0] / (5 / 6 * flanges) - 1) < 1e-13
    # What nu adds to the denominators, as printed in Cowper (1966).
    nu = np.array([NU])
    for section, area, own in (
        (Box(1, 1, 0.1, 0.1), w * t_f / (h * t_w), lambda m, n: 10 * n**2 * m),
        (ISection(1, 1, 0.1, 0.1), 2 * w * t_f / (h * t_w), lambda m, n: n**2 * m * (40 + 45 * m)),
    ):
        outer = np.array([[h + t_f, w + (t_w if type(section) is Box else 0), t_w, t_f]])
        bottoms = [
            10 * (1 + x) * (1 + 3 * area) ** 2 / section.shear(outer, x)[0][0] for x in (0 * nu, nu)
        ]
        printed = np.polyval([90, 135, 66, 11], area) + own(area, w / h)
        assert abs((bottoms[1] - bottoms[0])[0] / (NU * printed) - 1) < 1e-12


def test_thin_square_box_as_published():
    # Cowper (1966): 20 (1 + nu)/(48 + 39 nu); a^3 t is the torsion constant.
    t, sizes = 1e-9, np.array([[1.0, 1.0, 1e-9, 1e-9]])
    box = Box(1, 1, 0.1, 0.1)
    k_y, k_z = box.shear(sizes, np.array([NU]))
    for k in (k_y, k_z):
        assert abs(k[0] / (20 * (1 + NU) / (48 + 39 * NU)) - 1) < 1e-8
    assert abs(box.torsion(sizes)[0] / t - 1) < 1e-8


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("circle", np.pi / 2 * 1e-8),
        ("tube", np.pi / 2 * (1e-8 - 0.008**4)),
        # Of the middle line 0.018 x 0.029.
        ("box", 4 * (0.018 * 0.029) ** 2 / (2 * 0.018 / 0.001 + 2 * 0.029 / 0.002)),
        # b^3 (a - 0.6302 b)/3 for a much longer than b.
        ("I", 2 * 0.003**3 * (0.03 - 0.6302 * 0.003) / 3 + 0.002**3 * (0.034 - 0.00126) / 3),
        ("moments", 3e-9),
        ("points", 8e-5 * (0.006**2 + 0.004**2)),
    ],
)
def test_torsion_constants(name, expected):
    section = SECTIONS[name]
    J = section.torsion(np.array([section.sizes()]))[0]
    assert abs(J / expected - 1) < 1e-4  # digits of 0.6302


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Tube(0.01, 0.01), "less than the radius"),
        (lambda: Box(0.02, 0.03, 0.015, 0.002), "thinner than the width"),
        (lambda: Box(0.02, 0.03, 0.001, 0.010), "thinner than the height"),
        (lambda: ISection(0.02, 0.03, 0.03, 0.001), "thinner than the width"),
        (lambda: Circle(-1.0), "positive"),
        (lambda: Beam("b", (0, 0), (1, 0), 1, ONE_POINT, STEEL), "spread along y"),
        (lambda: Beam("b", (0, 0, 0), (1, 0, 0), 1, A_LINE, STEEL), "one line"),
        (lambda: EnhancedContinuum("no"), "bool"),
        (lambda: Rectangle(0.1, 0.1, shear_factors=(1.0, 0.0)), "positive"),
        (lambda: Rectangle(0.1, 0.1, shear_factors=(1.0,)), "2 components"),
        (lambda: Rectangle(0.1, 0.1, torsion_constant=-1.0), "positive"),
        (lambda: GeneralSection(1.0, 1.0, 1.0, 0.0), "positive"),
        (lambda: QuadratureSection(places=[(0, 0)], areas=[1.0, 1.0]), "shape"),
        (lambda: QuadratureSection(places=[(0, 0)], areas=[-1.0]), "positive sum"),
        (
            lambda: QuadratureSection(places=[(0, 0)], areas=[1.0], shear_centre=(0.1,)),
            "2 components",
        ),
        (lambda: Beam("b", (0, 0, 0), (1, 0, 0), 1, Circle(0.1), STEEL, energy=PlaneStress()), "3"),
        (
            lambda: Beam("b", (0, 0), (1, 0), 1, Circle(0.1), STEEL, energy="beam"),
            "StrainEnergyFunction",
        ),
        (lambda: Beam("b", (0, 0), (1, 0), 2, (Circle(0.1), Tube(0.1, 0.01)), STEEL), "sizes only"),
        (lambda: Beam("b", (0, 0), (1, 0), 1, Circle(0.1), Material(1.0, 1.0, 0.5)), "0.5"),
    ],
)
def test_nonsense_is_refused(make, text):
    with pytest.raises(InvalidInputError, match=text):
        make()


STEEL = Material(7850.0, 2.1e11, 0.3)


def test_points_on_a_line_are_a_section_of_the_plane():
    flat = QuadratureSection(places=[(-0.01, 0), (0.01, 0)], areas=[1e-4, 1e-4])
    assert Beam("b", (0, 0), (1, 0), 1, flat, STEEL).energy == EnhancedContinuum()


def test_sizes_change_together():
    beam = Beam("rod", (0, 0), (1, 0), 2, Tube(0.01, 0.002), STEEL)
    scene = Scene([beam])
    small = {"rod.radius": 0.001, "rod.thickness": 0.0002}
    for values in (small, dict(reversed(small.items()))):
        assert scene.with_values(values).beams[0].section[1].sizes() == (0.001, 0.0002)
    one = scene.with_values({"rod.radius[1]": 0.003, "rod.thickness": 0.001}).beams[0]
    assert [section.sizes() for section in one.section] == [(0.01, 0.001), (0.003, 0.001)]
    with pytest.raises(InvalidInputError, match=r"rod.thickness: must be less than the radius"):
        scene.with_values({"rod.radius": 0.003, "rod.thickness": 0.004})
    with pytest.raises(InvalidInputError, match=r"rod.radius: must be less than the radius"):
        scene.with_values({"rod.radius": 0.001})
    system = assemble(scene, design=list(small))
    assert np.all(system.with_values(np.array([0.001, 0.0002])).b == [0.001, 0.0002])
    with pytest.raises(InvalidInputError, match=r"'rod.thickness'.* less than the radius"):
        system.with_values(np.array([0.003, 0.004]))


def test_a_point_between_elements_may_lie_in_the_larger_section():
    beam = Beam("rod", (0, 0), (1, 0), 2, (Rectangle(0.1, 0.1), Rectangle(0.02, 0.1)), STEEL)
    for fraction, y in ((0.5, 0.04), (0.9, 0.009)):
        Scene([beam], [Clamp(beam.at(fraction, y=y))])
    with pytest.raises(InvalidInputError, match="section"):
        Scene([beam], [Clamp(beam.at(0.9, y=0.04))])


def test_properties_may_be_arrays():
    section = Rectangle(0.1, 0.1, shear_factors=np.array([0.8, 0.9]))
    assert section == Rectangle(0.1, 0.1, shear_factors=[0.8, 0.9])
    assemble(Scene([Beam("b", (0, 0), (1, 0), 1, section, STEEL)]))


# ---------------------------------------------------------------- elements


@pytest.mark.parametrize(("name", "d"), ENERGIES_OF_SPACES)
@pytest.mark.parametrize("length", [0.02, 1.0])
def test_only_rigid_motions_cost_nothing(name, d, length):
    energy = ENERGIES[name]
    beam = Beam("b", (0,) * d, (length,) + (0,) * (d - 1), 1, SECTIONS["box"], STEEL, energy=energy)
    system = assemble(Scene([beam]))
    q, v = system.start()
    K = np.zeros((system.n_q, system.n_q))
    K[system.pattern.rows, system.pattern.columns] = -force_q(system, 0.0, q, v)
    # In coordinates of one unit and size: slopes times the height.
    unit = np.where(np.arange(system.n_q) % (d * (d + 1)) < d, 1.0, 1 / 0.02)
    values = np.linalg.eigvalsh(K * unit * unit[:, None])
    rigid = d * (d + 1) // 2
    # Round-off against the smallest stiffness, bending: (h/L)^2 / 10 of the largest.
    assert np.all(np.abs(values[:rigid]) < 1e-13 * values[-1])
    assert values[rigid] > 1e-6 * values[-1]


@pytest.mark.parametrize(("name", "d"), ENERGIES_OF_SPACES)
def test_small_pure_bending_is_exact_where_poisson_does_not_lock(name, d):
    energy = ENERGIES[name]
    section, k = Rectangle(0.02, 0.01), 1e-5
    moment = k * E * 0.01 * 0.02**3 / 12
    scene = cantilever(
        section, 3, None, energy=energy, nu=NU, moment=moment if d == 2 else (0.0, 0.0, moment)
    )
    turn = -rest(scene)[1][-1, 2, 0]
    locked = {"SVK": 1.346153846, "plane stress": 1 / (1 - NU**2)}
    factor = locked.get(name.removesuffix(" assumed"), 1.0)
    assert abs(turn / k * factor - 1) < 1e-6


def test_large_pure_bending_is_that_of_a_rod():
    # A quarter circle, phi = 0.39 and 0.2 per element: error of fourth order, phi^4/64. What is
    # left of the finite strain is (h kappa)^2/28 = 1e-5 at most.
    section, turn, errors = Rectangle(0.01, 0.01), np.pi / 2, []
    for n in (4, 8):
        scene = cantilever(section, n, None, moment=turn * E * 0.01**4 / 12)
        X = rest(scene, 12)[1]
        errors.append(abs(np.arctan2(-X[-1, 2, 0], X[-1, 2, 1]) / turn - 1))
        np.testing.assert_allclose(X[-1, 0], [2 / np.pi, 2 / np.pi], rtol=1e-3)
    assert errors[0] < 5e-4
    assert errors[1] < errors[0] / 12


@pytest.mark.parametrize("nu", [0.0, 0.3])
@pytest.mark.parametrize("slenderness", [0.1, 0.01, 0.001])
def test_one_element_is_a_cantilever(slenderness, nu):
    h, F = slenderness, 1e-7 * E * slenderness**4
    X = rest(cantilever(Rectangle(h, h), 1, (0.0, -F), nu=nu))[1]
    k = 10 * (1 + nu) / (12 + 11 * nu)
    expected = F * 4 / (E * h**4) + F * 2 * (1 + nu) / (k * E * h**2)
    # Deflection 3e-8, of which the condition number 1e8 at h = 0.001 takes digits.
    assert abs(-X[-1, 0, 1] / expected - 1) < 1e-6


def test_thin_cantilever_needs_few_elements():
    # Large deflection, h/L = 0.01, load 3 E I/L^2: 16 elements against 64.
    tips = []
    for n in (16, 64):
        load = (0.0, -3 * E * 0.01**4 / 12)
        tips.append(rest(cantilever(Rectangle(0.01, 0.01), n, load), 8)[1][-1, 0])
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-4)


# ---------------------------------------------------------------- derivatives


# Of curved beams two sections, which differ in their points only.
FORMS = [("straight", section) for section in SECTIONS]
FORMS += [("curved", section) for section in ("rectangle", "tube")]


@pytest.mark.parametrize(("form", "section"), FORMS)
@pytest.mark.parametrize(("name", "d"), ENERGIES_OF_SPACES)
def test_partials_are_complex_steps_and_differences(form, section, name, d):
    element = {2: BEAM_2D, 3: BEAM_3D}[d]
    energy, own = ENERGIES[name], SECTIONS[section]
    Y = (straight if form == "straight" else arc)(element.d)
    kind = kind_of(element.d, energy, own, form == "straight")
    values = np.zeros(len(ElementParameter))
    values[:6] = E, NU, 1000.0, 0.3, 0.0, 0.02
    values[6 : 6 + len(own.sizes())] = own.sizes()
    wanted = [w for w in ElementParameter if values[w] != 0]
    inv = prepare(element, Batch(kind, values[None], Y))
    # One direction of all parameters by random parts of their sizes.
    along, partials = np.zeros_like(values), inv.partials(wanted)
    along[wanted] = np.random.default_rng(1).uniform(0.3, 1, len(wanted)) * values[wanted]
    by_step, low, high = (
        prepare(element, Batch(kind, (values + step * along)[None], Y))
        for step in (1e-30j, -1e-5, 1e-5)
    )
    for part in ("A", "m"):
        sizes = [getattr(partials[w], part) * along[w] for w in wanted]
        scale = sum(np.max(np.abs(x)) for x in sizes) + np.max(np.abs(getattr(inv, part)))
        exact = getattr(by_step, part).imag / 1e-30
        # Two evaluations of one derivative: round-off of sums of some hundred terms.
        assert np.max(np.abs(sum(sizes) - exact)) < 1e-11 * scale
        # Central differences with 1e-5: error of powers p of the parameters p^3/6 1e-10, p up
        # to 6, and round-off 1e-14/1e-5.
        slope = (getattr(high, part) - getattr(low, part)) / 2e-5
        assert np.max(np.abs(sum(sizes) - slope)) < 2e-8 * scale


def test_partials_of_tiny_sections_keep_their_digits():
    # In units of 1e9 m second moments are 2e-45, far below an imaginary step of 1e-40.
    values, found = np.zeros((1, len(ElementParameter))), []
    which, own = ElementParameter.SIZE_2, SECTIONS["moments"]
    for unit in (1.0, 1e-9):
        sizes = own.sizes() * unit ** np.array([2, 4, 4, 4])
        values[0] = (E, NU, 1000.0, 0.3 * unit, 0.0, 0.0, *sizes)
        batch = Batch(kind_of(2, EnhancedContinuum(), own), values, straight(2))
        inv = prepare(BEAM_2D, batch)
        # The entry of r_y.r_y, which is integrated over the volume.
        found.append(inv.partials([which])[which].A[0, -1, -1] * sizes[1] / unit**3)
    assert found[1] == pytest.approx(found[0], rel=1e-12)


def test_curved_and_straight_rules_agree():
    # The two terms of the assumed strains that a curved reference changes are left out.
    for d, element in ((2, BEAM_2D), (3, BEAM_3D)):
        values = np.zeros((1, len(ElementParameter)))
        values[0, :8] = E, NU, 1000.0, 0.3, 0.0, 0.0, 0.06, 0.04
        for energy in ENERGIES.values():
            if d in energy.dimensions and not energy.assumed_strains:
                one, other = (
                    prepare(element, Batch(kind_of(d, energy, None, flag), values, straight(d)))
                    for flag in (True, False)
                )
                assert np.max(np.abs(one.A - other.A)) < 1e-13 * np.max(np.abs(one.A))
                assert np.max(np.abs(one.m - other.m)) < 1e-13 * np.max(np.abs(one.m))


def test_a_curved_beam_is_free_of_stress_and_bends_about_its_shape():
    # A quarter circle opened by an end moment turns by M L/(E I) (1 + O(h/R)^2), here h/R = 0.02;
    # eight elements, phi = 0.2, error of fourth order in phi.
    n, h = 8, 0.02
    angle = np.linspace(0, np.pi / 2, n + 1)
    places = np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
    tangents = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    frames = np.stack([tangents, np.stack([-np.sin(angle), np.cos(angle)], axis=1)], axis=1)
    beam = CurvedBeam("arch", places, frames, Rectangle(h, h), Material(1000.0, E, NU))
    system = assemble(Scene([beam], [Clamp(beam.at_start)]))
    q, v = system.start()
    assert np.max(np.abs(system.force(0.0, q, v))) < 1e-12 * E * h * h
    turn = 1e-5
    moment = turn * E * h**4 / 12 / (np.pi / 2)
    X = rest(Scene([beam], [Clamp(beam.at_start)], loads=[Moment(beam.at_end, moment)]))[1]
    found = -X[-1, 2] @ tangents[-1] / turn
    assert abs(found - 1) < 1e-4
