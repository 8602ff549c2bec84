"""Contact of a beam with itself: closed forms, an independent code, momenta, derivatives."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import minimize_scalar

from ancfdae import (
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    HHT,
    Beam,
    BeamPairContact,
    Radau,
    Scene,
    Terminal,
    assemble,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import (
    angular_momentum,
    kinetic_energy,
    linear_momentum,
    observe,
    position,
    strain_energy,
)
from ancfdae.results import Verdict
from ancfdae.sections import Circle
from tests.support.contacts import UNITS, agree
from tests.support.touching_lines import LAW, RUBS, SOFT, R, along, clash, coil, scene_of


def eight(u):
    """A figure of eight in space: both strands cross 12 mm above each other."""
    a = np.pi * (1.6 * u - 0.3)
    return np.stack([0.2 * np.sin(a), 0.1 * np.sin(2 * a), 0.0192 * u], axis=-1)


def noose(u):
    """A line in the plane: a bulb of 30 mm in radius, between legs at a distance of 18 mm."""
    radius, leg = 0.03, 0.08
    turn = np.arccos((0.018 / radius + 2) / 4)
    arcs = np.cumsum([0, leg, radius * turn, radius * (np.pi + 2 * turn), radius * turn, leg])
    s = np.linspace(0, arcs[-1], 40001)
    angle = np.interp(s, arcs, [0, 0, -turn, np.pi + turn, np.pi, np.pi])
    steps = np.diff(s)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)[1:]
    places = np.append(np.zeros((1, 2)), np.cumsum(steps, axis=0), axis=0)
    return CubicSpline(s, places)(u * arcs[-1])


def contact_force(scene):
    """The generalised contact force on node vectors at the start, (n + 1, 2, d)."""
    system = assemble(scene)
    (load,), (q, v) = system._loads.touching, system.start()
    return load.force(q[None], v[None], np.zeros(1)).reshape(-1, 2, system.vector_size)


def closest(far, low, high):
    """The argument between two numbers at which a distance is smallest."""
    return minimize_scalar(far, bounds=(low, high), method="bounded", options={"xatol": 1e-12}).x


def independent(nodes, length, radius, stiffness, points, exponent=1.5, first=0.3):
    """The same force by SciPy's spline and minimiser, without pairs nearer than `first` of it."""
    n = len(nodes) - 1
    s, l = np.linspace(0.0, length, n + 1), length / n
    line = CubicHermiteSpline(s, nodes[:, 0], nodes[:, 1])
    basis = [
        CubicHermiteSpline(s, values, slopes)
        for e in np.eye(n + 1)
        for values, slopes in ((e, 0 * e), (0 * e, e))
    ]
    gauss, weights = np.polynomial.legendre.leggauss(points)
    places = np.arange(n)[:, None] * l + l * (gauss + 1) / 2
    force = np.zeros((2 * (n + 1), nodes.shape[2]))
    for a, w in zip(places.ravel(), np.tile(weights * l / 2, n), strict=True):
        c = line(a)

        def far(b, c=c):
            return np.linalg.norm(line(b) - c)

        grid = np.arange(a + first * length, length, l / 20)
        near = np.array([far(b) for b in grid])
        for i in range(1, len(grid) - 1):
            if near[i] < min(near[i - 1], near[i + 1], 2 * radius + l / 10):
                b = closest(far, grid[i - 1], grid[i + 1])
                if far(b) < 2 * radius:
                    F = w * stiffness * (2 * radius - far(b)) ** exponent
                    weight = np.array([g(a) - g(b) for g in basis])[:, None]
                    force += weight * F * (c - line(b)) / far(b)
    return force.reshape(n + 1, 2, -1)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("n", [24, 40, 41])
def test_the_force_on_a_figure_of_eight_is_that_of_an_independent_code(n, unit):
    nodes, length = along(eight, n)
    found = contact_force(scene_of(nodes, length, unit=unit)[0])
    scale, mass, _ = UNITS[unit]
    found[:, 0] /= mass * scale
    found[:, 1] /= mass * scale**2
    expected = independent(nodes, length, R, 1e5, 8)
    size = np.abs(expected).max()
    assert size > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * size)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_coils_that_press_on_each_other_have_the_force_of_a_closed_form(exponent):
    # The energy k d^(m+1)/(m+1) per length of all turns but the last, d = 2 r - D, with the
    # distance D of a point at the angle 0 from the next turn: its derivative in the pitch.
    turns, pitch, k = 3.0, 0.018, 1e6
    per_turn = np.hypot(2 * np.pi * 0.1, pitch)

    def far(a):
        return np.sqrt(2 * 0.1**2 * (1 - np.cos(a)) + (pitch * a / (2 * np.pi)) ** 2)

    def beyond(x):
        return (2 * R - np.hypot(D, x)) ** exponent * D / np.hypot(D, x)

    a = closest(far, 5.5, 6.6)
    D, D_p = far(a), pitch * (a / (2 * np.pi)) ** 2 / far(a)
    expected = k * (2 * R - D) ** exponent * D_p * (turns - 1) * per_turn
    # Beyond its end the last turn is a sphere, over which the turn before it still touches.
    expected += k * D_p * quad(beyond, 0, np.sqrt(4 * R**2 - D**2))[0]
    nodes, length = along(coil, 48)
    force = contact_force(scene_of(nodes, length, stiffness=k, exponent=exponent)[0])
    wider = (along(lambda u: coil(u, pitch + 1e-5), 48)[0] - nodes) / 1e-5
    assert (force * wider).sum() == pytest.approx(expected, rel=2e-3)
    # In the middle, turns above and below press alike; inner turns carry no force.
    np.testing.assert_allclose(force[20:29, 0, 2], 0.0, atol=0.02 * np.abs(force[:16, 0, 2]).max())


@pytest.mark.parametrize("rubs", [{}, RUBS], ids=["smooth", "rough"])
def test_gradients_of_a_line_that_touches_itself_are_exact(rubs):
    scene, rope = clash(12, **LAW, **rubs)
    design = [f"touch.{name}" for name in scene.loads[0].parameters()]
    assert "touch.other_radius" not in design
    design += ["rope.length", "rope.youngs_modulus"]
    objective = Terminal(position(rope.at(0.3), 2) + position(rope.at(0.7), 0))
    agree(scene, objective, 0.012, design, [HHT(2.5e-4)], difference=not rubs)


@pytest.mark.parametrize("element", [CABLE_3D, BEAM_3D])
@pytest.mark.parametrize("damped", [False, True])
def test_a_line_that_strikes_itself_keeps_its_momenta(element, damped):
    law = LAW if damped else {}
    scene, _ = clash(12, element, **law)
    run, system = simulate(scene, 0.03, Radau(rtol=1e-5)), assemble(scene)
    assert run.outcome.success, run.outcome
    for axis in range(3):
        assert np.ptp(observe(linear_momentum(axis), run, system)) < 1e-10
        assert np.ptp(observe(angular_momentum(axis), run, system)) < 1e-8
    energy = observe(kinetic_energy() + strain_energy(), run, system)
    lost = 1 - energy[-1] / energy[0]
    assert abs(energy / energy[0] - 1).max() > 5e-3  # it touches
    assert 1e-3 < lost < 0.5 if damped else abs(lost) < 1e-4


def test_a_noose_in_the_plane_presses_as_an_independent_code_says():
    nodes, length = along(noose, 36)
    scene, _ = scene_of(nodes, length, element=CABLE_2D)
    assemble(scene).contacts()
    found, expected = contact_force(scene), independent(nodes, length, R, 1e5, 8)
    # Points of the first leg touch, and beyond its end the last element is a sphere.
    # Beside a node an element goes on as its cubic, where the curvature jumps as here.
    size = np.abs(expected).max()
    np.testing.assert_allclose(found[3:-3], expected[3:-3], rtol=0, atol=5e-4 * size)
    np.testing.assert_allclose(found[:, 0].sum(axis=0), 0.0, atol=1e-12)
    assert found[2, 0, 1] < 0 < found[-3, 0, 1]


def test_a_line_that_only_bends_does_not_touch_itself():
    # A ring of 34 mm in radius, and elements from a diameter to a tenth of one.
    for n in (9, 14, 96):
        nodes, length = along(lambda u: coil(u, 0.0, 0.9)[:, :2] * 0.34, n)
        scene, _ = scene_of(nodes, length, element=CABLE_2D, points_per_element=2)
        assert not np.any(contact_force(scene))
        assemble(scene).contacts()


def test_elements_that_turn_too_much_are_refused_before_the_run():
    for n, why in ((5, "right angle"), (7, "nine or more"), (9, None)):
        nodes, length = along(lambda u: coil(u, 0.05, 1.0), n)
        scene, _ = scene_of(nodes, length)
        if why is None:
            assert simulate(scene, 1e-4, HHT(1e-5)).outcome.success
            continue
        with pytest.raises(InvalidInputError, match=why):
            simulate(scene, 1e-4, HHT(1e-5))
    # Elements shorter than the radius, and a bend that is sharper than the line is thick.
    nodes, length = along(lambda u: coil(u, 0.0, 0.5) * 0.1, 20)
    with pytest.raises(InvalidInputError, match="bends wider than the radius"):
        simulate(scene_of(nodes, length)[0], 1e-4, HHT(1e-5))


def test_tangents_within_elements_are_looked_at():
    # Nodes at 0.3 of their distance, with tangents along the line: it runs back within elements.
    for part, refused in ((0.3, True), (0.8, False)):
        nodes, length = along(lambda u: coil(u, 0.05, 0.5), 8)
        nodes[:, 0] *= part
        system = assemble(scene_of(nodes, length)[0])
        if refused:
            with pytest.raises(InvalidInputError, match="right angle"):
                system.contacts()
        else:
            system.contacts()


def test_a_run_ends_where_elements_turn_too_much():
    # A straight line whose halves turn towards each other.
    n = 8
    nodes = np.zeros((n + 1, 2, 2))
    nodes[:, 0, 0], nodes[:, 1, 0] = np.linspace(0, 1, n + 1), 1.0
    V = np.zeros_like(nodes)
    V[:, 0, 1], V[:, 1, 1] = 20 * abs(nodes[:, 0, 0] - 0.5), 20 * np.sign(nodes[:, 0, 0] - 0.5)
    scene, _ = scene_of(nodes, 1.0, V, element=CABLE_2D)
    run = simulate(scene, 0.1, HHT(2e-4))
    assert run.outcome.verdict is Verdict.MISSED_CONTACT
    assert "must turn by less than a right angle" in str(run.outcome)
    ends = run.nodes("rope")[:, :, 1]
    turned = np.einsum("tnd,tnd->tn", ends[:, :-2], ends[:, 2:]).min(axis=1) <= 0
    # The tangents at nodes alone are a weaker check.
    assert run.outcome.time <= run.t[np.argmax(turned)]


def test_one_beam_has_one_radius():
    with pytest.raises(InvalidInputError, match="left out for a beam that touches itself"):
        BeamPairContact("a", "a", stiffness=1.0, radius=0.1, other_radius=0.1)
    with pytest.raises(InvalidInputError, match="must be given for two beams"):
        BeamPairContact("a", "b", stiffness=1.0, radius=0.1)
    with pytest.raises(InvalidInputError, match="radius of the first beam"):
        BeamPairContact("a", "a", stiffness=1.0)
    short = Beam("rope", (0, 0), (1, 0), 2, Circle(R), SOFT, element=CABLE_2D)
    touch = BeamPairContact("rope", "rope", stiffness=1.0, radius=R)
    with pytest.raises(InvalidInputError, match="that do not adjoin"):
        assemble(Scene([short], loads=[touch]))
