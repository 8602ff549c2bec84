"""Equilibria of slack wires and beams are those of the rod, and no element of them is folded.

The reference is the elastica under its weight by collocation, which knows no elements.
"""

import warnings
from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from ancfdae import (
    BEAM_2D,
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    Beam,
    Clamp,
    CurvedBeam,
    EquilibriumStart,
    Material,
    Moment,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Revolute,
    Scene,
    assemble,
    equilibrium,
    equilibrium_gradient,
)
from ancfdae.equations import saddle_points as prepared
from ancfdae.equations.system import called_plan
from ancfdae.errors import CoarseMeshWarning
from ancfdae.observables import reaction
from ancfdae.results import Equilibrium, Verdict
from ancfdae.sections import Circle, Rectangle
from ancfdae.statics.equilibrium import NoEquilibriumError, resting

G, LENGTH, RADIUS = 9.81, 1.0, 2e-4
STEEL = Material(7850.0, 2.1e11, 0.3)


def wire(element, n, span, origin=0.0, radius=RADIUS, **settings):
    """A wire declared straight whose supports are too near to each other."""
    d = element.d
    side = radius * np.sqrt(np.pi)
    section = Rectangle(side, side) if d == 2 else Circle(radius)
    start, end, ground = ((origin + x, origin, origin)[:d] for x in (0.0, LENGTH, span))
    beam = Beam("wire", start, end, n, section, STEEL, element=element)
    left = Pin(beam.at_start, name="left")
    if element is BEAM_3D:
        # A round rod between two pins could spin.
        left = Revolute(beam.at_start, (0.0, 0.0, 1.0), name="left")
    joints = [left, Pin(beam.at_end, ground=ground, name="right")]
    return Scene([beam], joints, gravity=(0.0, -G, 0.0)[:d], **settings)


@lru_cache
def elastica(EI, weight, span):
    """Horizontal pull of an inextensible rod between hinges under its weight per length.

    E I theta'' = H sin theta - V cos theta with V = w (s - L/2), over the left half.
    """

    def slopes(s, y):
        theta, curvature, _ = y
        V = weight * (s - LENGTH / 2)
        return [curvature, (y_H[0] * np.sin(theta) - V * np.cos(theta)) / EI, np.cos(theta)]

    y_H = [0.0]

    def with_pull(s, y, p):
        y_H[0] = p[0] * weight
        return np.array(slopes(s, y))

    def ends(a, b, p):
        return np.array([a[1], b[0], a[2], b[2] - span / 2])

    s = np.linspace(0.0, LENGTH / 2, 201)
    sag = np.sqrt(6 * (1 - span / LENGTH))
    guess = np.array([-sag * np.cos(np.pi * s), sag * np.pi * np.sin(np.pi * s), s * span])
    found = solve_bvp(with_pull, ends, s, guess, p=[0.5], tol=1e-9, max_nodes=20000)
    assert found.success
    return found.p[0] * weight


@pytest.mark.parametrize("element", [CABLE_2D, CABLE_3D, BEAM_2D, BEAM_3D])
@pytest.mark.parametrize(("n", "span"), [(8, 0.95), (10, 0.95), (24, 0.95), (32, 0.95), (16, 0.5)])
def test_a_slack_wire_hangs_as_the_elastica(element, n, span):
    found = equilibrium(wire(element, n, span))
    assert found.outcome.success
    assert found.outcome.stable_to is None
    area = np.pi * RADIUS**2
    I = area**2 / 12 if element.d == 2 else area**2 / (4 * np.pi)
    pull = elastica(STEEL.youngs_modulus * I, STEEL.density * area * G, span)
    force = -found.solution.reaction("left")[0]
    # The mesh leaves an error of third order, n^-3 of 1 to 6.3 weights (measured at both spans).
    weight = STEEL.density * area * G * LENGTH
    assert force[0] == pytest.approx(pull, abs=8 * weight / n**3)
    # Exact for any mesh; the round-off of E A = 3e4 N is 4e-12 N.
    assert -force[1] == pytest.approx(weight / 2, abs=1e-9 * weight + 4e-11)


@pytest.mark.parametrize("element", [CABLE_2D, BEAM_2D])
@pytest.mark.parametrize(
    ("span", "n"),
    [*((0.5, n) for n in (3, 4, 5, 6, 8, 12)), *((0.95, n) for n in (2, 3, 4)), (0.9, 3), (0.9, 6)],
)
def test_a_slack_wire_of_too_few_elements_is_warned_of(element, n, span):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = equilibrium(wire(element, n, span))
    assert found.outcome.success
    I = (np.pi * RADIUS**2) ** 2 / 12
    pull = elastica(STEEL.youngs_modulus * I, STEEL.density * np.pi * RADIUS**2 * G, span)
    error = abs(-found.solution.reaction("left")[0][0] / pull - 1)
    # A pull that errs by 2.9 % and more is warned of, one that is right to 1.4 % is not.
    assert error > 0.028 or error < 0.015
    assert [x.category for x in told] == [CoarseMeshWarning] * int(error > 0.02)
    if told:
        assert "'wire'" in str(told[0].message)
        assert told[0].filename == __file__


@pytest.mark.parametrize("n", [2, 3, 4, 8])
def test_a_limp_wire_of_few_elements_is_warned_of_where_it_pulls_wrongly(n):
    """The weight shapes the wire: 3 elements pull rightly to 2 %, whatever part of U is theirs."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = equilibrium(wire(CABLE_2D, n, 0.95, radius=2e-6))
    area = np.pi * 2e-6**2
    # The catenary: sinh(u) / u = 1 / 0.95 with u = w span / 2 H.
    u = brentq(lambda u: np.sinh(u) / u - 1 / 0.95, 0.1, 2.0)
    pull = STEEL.density * area * G * 0.95 / (2 * u)
    error = abs(-found.solution.reaction("left")[0][0] / pull - 1)
    assert error > 0.3 or error < 0.05
    assert [x.category for x in told] == [CoarseMeshWarning] * int(error > 0.3)


def test_gradients_and_starts_at_rest_warn_of_coarse_meshes():
    with pytest.warns(CoarseMeshWarning, match="too few elements for the bending of 'wire'"):
        equilibrium_gradient(wire(CABLE_2D, 2, 0.95), reaction("left", 0), design=["wire.density"])
    with pytest.warns(CoarseMeshWarning, match="too few elements for the bending of 'wire'"):
        assemble(wire(CABLE_2D, 2, 0.95, start=[EquilibriumStart()])).start()


def test_a_taut_wire_a_hanging_bar_and_a_thick_arc_are_fine():
    # None of their strain is an error of the mesh: loads along the axis are linear in it, tension
    # is large beside it, and thick elements bend sooner than they stretch.
    taut = wire(CABLE_2D, 2, 1.001)
    bar = Beam("bar", (0, 0), (0, -1), 2, Rectangle(1e-3, 1e-3), STEEL, element=CABLE_2D)
    hung = Scene([bar], [Clamp(bar.at_start)], gravity=(0.0, -G))
    arc = Beam("arc", (0, 0), (1, 0), 2, Rectangle(0.05, 0.05), STEEL)
    bend = Moment(arc.at_end, np.pi * 2.1e11 * 0.05**4 / 12, name="bend")
    half_circle = Scene([arc], [Clamp(arc.at_start)], loads=[bend])
    for scene in (taut, hung, half_circle):
        assert equilibrium(scene).outcome.success


@pytest.mark.parametrize("element", [CABLE_2D, BEAM_2D])
def test_equations_evaluated_by_python_have_the_same_equilibrium(element, monkeypatch):
    scene = wire(element, 8, 0.95)
    compiled = equilibrium(scene)
    monkeypatch.setattr(prepared, "planned", called_plan)
    plain = equilibrium(scene)
    assert plain.outcome.step == compiled.outcome.step
    # Round-off of E A over the pull times the length: 1e-9.
    np.testing.assert_allclose(plain.q, compiled.q, atol=1e-8)


def test_a_gradient_and_a_start_stand_on_the_wire_that_hangs():
    area = np.pi * RADIUS**2
    EI = STEEL.youngs_modulus * area**2 / 12
    pulls = [elastica(EI, x * STEEL.density * area * G, 0.95) for x in (0.999, 1.001)]
    slope = (pulls[1] - pulls[0]) / (0.002 * STEEL.density)
    scene = wire(CABLE_2D, 24, 0.95)
    found = equilibrium_gradient(scene, reaction("left", 0), design=["wire.density"])
    # The mesh, 6 n^-3 = 4e-4 of a weight of which the pull is a half.
    assert -found.gradient[0] == pytest.approx(slope, rel=1e-3)
    at_rest = assemble(wire(CABLE_2D, 24, 0.95, start=[EquilibriumStart()]))
    np.testing.assert_array_equal(at_rest.start()[0], equilibrium(scene).q)


def test_where_the_wire_hangs_does_not_matter():
    here, there = (equilibrium(wire(CABLE_2D, 10, 0.95, origin)) for origin in (0.0, 1e3))
    q = there.q.reshape(-1, 2, 2) - np.array([[1e3, 1e3], [0.0, 0.0]])
    # Coordinates carry 1e-13, which E A/l = 3e5 N/m makes 3e-8 N of a pull of 5e-3 N.
    np.testing.assert_allclose(q.ravel(), here.q, atol=1e-5)


# ---------------------------------------------------------------- what is folded


def one(element, X):
    """An element of 1 m and side 0.1 with other node vectors."""
    d = element.d
    section = Circle(0.05) if d == 3 else Rectangle(0.1, 0.1)
    end = (1.0, 0.0, 0.0)[:d]
    beam = Beam("rod", (0.0,) * d, end, 1, section, STEEL, element=element)
    system = assemble(Scene([beam], [Pin(beam.at_start)]))
    return system, np.asarray(X, dtype=float).ravel()


def straight(element):
    d, n_s = element.d, element.n_s
    node = np.zeros((2, n_s, d))
    node[1, 0, 0] = 1.0
    node[:, 1:] = np.eye(d)[: n_s - 1]
    return node


@pytest.mark.parametrize("element", [CABLE_2D, CABLE_3D, BEAM_2D, BEAM_3D])
def test_an_axis_is_compressed_no_farther_than_its_law_bears(element):
    # N = E A l (l^2 - 1)/2 is least at l = 1/sqrt(3).
    for stretch, folded in ((3**-0.5 + 1e-12, False), (3**-0.5 - 1e-12, True), (3.0, False)):
        X = straight(element)
        X[1, 0, 0] = X[:, 1, 0] = stretch
        system, q = one(element, X)
        assert bool(system.folded(q)) is folded
    # Far from the origin too.
    far = X.copy()
    far[:, 0] += 1e6
    assert system.folded(far.ravel()) == ""


@pytest.mark.parametrize("element", [BEAM_2D, BEAM_3D])
def test_a_section_that_is_turned_inside_out_is_folded(element):
    X = straight(element)
    X[1, 2] *= -1.0
    system, q = one(element, X)
    assert system.folded(q) == "'rod', element 1"
    # A bend of which the inner fibre, 0.05 off, has no length left: r_yx = 20.
    for bend, folded in ((19.9, False), (20.1, True)):
        X = straight(element)
        X[:, 2, 0] = 0.5 * bend, -0.5 * bend
        system, q = one(element, X)
        assert bool(system.folded(q)) is folded


@pytest.mark.parametrize("element", [CABLE_2D, CABLE_3D])
def test_a_cable_that_turns_back_is_folded(element):
    for angle, folded in ((1.5, False), (1.6, True)):
        X = straight(element)
        X[:, 1, 0] = np.cos(angle)
        X[:, 1, 1] = np.sin(angle), -np.sin(angle)
        system, q = one(element, X)
        assert bool(system.folded(q)) is folded


def test_a_helix_is_not_folded():
    angles = np.linspace(0.0, 12.0, 25)
    place = np.stack([np.cos(angles), np.sin(angles), 0.1 * angles], axis=1)
    along = np.stack([-np.sin(angles), np.cos(angles), 0.1 + 0 * angles], axis=1) / np.sqrt(1.01)
    inward = np.stack([-np.cos(angles), -np.sin(angles), 0 * angles], axis=1)
    frames = np.stack([along, inward, np.cross(along, inward)], axis=1)
    coil = CurvedBeam("coil", place, frames, Rectangle(0.1, 0.05), STEEL)
    system = assemble(Scene([coil], [Pin(coil.at_start)]))
    assert system.folded(system.start()[0]) == ""


def test_a_folded_state_is_no_equilibrium():
    """A bar that is pressed together to a tenth, by a search and taken as an equilibrium."""
    beam = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.1, 0.1), STEEL, element=CABLE_2D)
    scene = Scene([beam], [Pin(beam.at_start), Pin(beam.at_end, ground=(0.1, 0.0))])
    found = equilibrium(scene)
    system = assemble(scene)
    assert not (found.outcome.success and system.folded(found.q))
    X = straight(CABLE_2D)
    X[1, 0, 0] = X[:, 1, 0] = 0.1
    taken = resting(system, X.ravel(), np.zeros(system.n_lam), stable=True)
    assert isinstance(taken, Equilibrium)
    assert taken.outcome.verdict is Verdict.FOLDED
    assert not taken.outcome.success
    assert "folded" in str(taken.outcome)
    assert "'rod', element 1" in str(taken.outcome)


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
def test_a_bar_bears_no_more_than_the_largest_force_of_its_law():
    area = 0.01
    most = STEEL.youngs_modulus * area / (3 * np.sqrt(3.0))
    beam = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.1, 0.1), STEEL, element=CABLE_2D)
    # Held across, so that its end stays on the line. Its middle would buckle: Euler's load is a
    # tenth of this force, and the start says so.
    joints = [Clamp(beam.at_start), PointOnLine(beam.at_end, (1.0, 0.0))]

    def scene(share):
        force = PointForce(beam.at_end, (-share * most, 0.0))
        return Scene([beam], joints, loads=[force], start=[EquilibriumStart()])

    stretch = assemble(scene(0.9)).start()[0][4]
    force = STEEL.youngs_modulus * area * stretch * (1 - stretch**2) / 2
    # Round-off; the stiffness has fallen to a part of 0.3.
    assert force == pytest.approx(0.9 * most, rel=1e-12)
    with pytest.raises(NoEquilibriumError):
        assemble(scene(1.1)).start()


def meeting_wires(element, n, span, mass):
    """Two wires in line, declared straight, that meet at a mass between supports too near."""
    d = element.d
    side = RADIUS * np.sqrt(np.pi)
    section = Rectangle(side, side) if d == 2 else Circle(RADIUS)
    points = [(x, 0.0, 0.0)[:d] for x in (0.0, 0.5, 1.0, span)]
    a = Beam("a", points[0], points[1], n, section, STEEL, element=element)
    b = Beam("b", points[1], points[2], n, section, STEEL, element=element)
    ends = Pin(a.at_start, name="left"), Pin(b.at_end, ground=points[3], name="right")
    joints = [*ends, Pin(a.at_end, b.at_start, name="middle")]
    return Scene([a, b], joints, (0.0, -G, 0.0)[:d], bodies=[PointMass(a.at_end, mass)])


@pytest.mark.parametrize("element", [CABLE_2D, CABLE_3D, BEAM_2D])
@pytest.mark.parametrize("span", [0.95, 0.8, 0.5])
def test_slack_wires_that_meet_at_a_mass_hang_as_catenaries(element, span):
    """In line they hold the mass by nothing: they settle, and then their supports approach."""
    mass = 0.01
    found = equilibrium(meeting_wires(element, 4, span, mass))
    assert found.outcome.success
    assert found.outcome.stable_to is None
    w = STEEL.density * np.pi * RADIUS**2 * G
    low, high = mass * G / 2, mass * G / 2 + 0.5 * w

    def gap(H):
        return 2 * H / w * (np.arcsinh(high / H) - np.arcsinh(low / H)) - span

    pull = brentq(gap, 1e-3, 1.0, xtol=1e-14)
    force = -found.solution.reaction("left")[0]
    # Stretch and bending: 1e-4 at most, whatever the mesh.
    assert force[0] == pytest.approx(pull, rel=3e-4)
    assert -force[1] == pytest.approx(high, rel=1e-9)
