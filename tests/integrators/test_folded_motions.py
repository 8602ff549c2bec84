"""Motions whose elements fold between their nodes end there in words, by every integrator.

Held against SciPy's Hermite splines and determinants at many places of an element.
"""

import warnings

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from ancfdae import (
    BEAM_2D,
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    DOP853,
    HHT,
    IDA,
    Beam,
    Clamp,
    Material,
    NodalState,
    Pin,
    PointOnLine,
    Radau,
    Scene,
    TranslationDriver,
    assemble,
    simulate,
)
from ancfdae.errors import LargeStrainWarning
from ancfdae.laws import SmoothStep
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle

RUBBER = Material(1000.0, 1e5, 0.3, damping_time=0.01)
EVERY = [HHT(1e-3), HHT(1e-2), Radau(step=1e-2), HHT(rtol=1e-3), IDA(1e-5), DOP853(1e-5)]


def sides(nodes, s, places):
    """Sides of the sections, or of the tangent and the chord, of all elements: (n, n_places).

    `nodes`, (n + 1, n_s, d), have the arc lengths s. A positive number is unfolded.
    """
    n, n_s, d = len(nodes) - 1, *nodes.shape[1:]
    values = np.empty((n, len(places)))
    for k in range(n):
        here = s[k] + (s[k + 1] - s[k]) * places
        r_x = CubicHermiteSpline(s[k : k + 2], nodes[k : k + 2, 0], nodes[k : k + 2, 1])(here, 1)
        if n_s == 2:
            values[k] = r_x @ (nodes[k + 1, 0] - nodes[k, 0])
            continue
        across = (1 - places)[:, None, None] * nodes[k, 2:] + places[:, None, None] * nodes[
            k + 1, 2:
        ]
        matrices = np.concatenate([r_x[:, None], across], axis=1)
        assert matrices.shape[1:] == (d, d)
        values[k] = np.linalg.det(matrices)
    return values


def squared_stretches(nodes, s, places):
    """|r_x|^2 of the axis of all elements, (n, n_places)."""
    line = CubicHermiteSpline(s, nodes[:, 0], nodes[:, 1])
    at = (s[:-1, None] + np.diff(s)[:, None] * places).ravel()
    return np.sum(line(at, 1) ** 2, axis=-1).reshape(len(s) - 1, -1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("element", [BEAM_2D, BEAM_3D, CABLE_2D, CABLE_3D], ids=lambda x: x.name)
def test_random_elements_are_judged_as_determinants_judge_them(element, seed):
    """100 states of three elements beside others, from nearly straight to wild."""
    random, d = np.random.default_rng(seed), element.d
    z, made = (0.0,) * (d - 1), (Rectangle(0.01, 0.01), RUBBER)
    first = Beam("first", (-2.0, *z), (0.0, *z), 1, *made, element=BEAM_2D if d == 2 else BEAM_3D)
    body = Beam("body", (0.0, *z), (1.5, *z), 3, *made, element=element)
    last = Beam("last", (1.5, *z), (2.0, *z), 2, *made, element=CABLE_2D if d == 2 else CABLE_3D)
    system = assemble(Scene([first, body, last], [Pin(body.at_end, last.at_start)]))
    q = system.start()[0]
    layout = system.naming.layout.body("body")
    nodes = q.reshape(-1, d)[layout.nodes]
    folded = 0
    for _ in range(100):
        moved = nodes + 10 ** random.uniform(-3, 0.5) * random.normal(size=nodes.shape)
        states = np.tile(q.reshape(-1, d), (3, 1, 1))
        states[1:, layout.nodes] = moved
        values = sides(moved, np.linspace(0.0, 1.5, 4), np.linspace(0, 1, 9))
        stretches = squared_stretches(moved, np.linspace(0.0, 1.5, 4), np.array([0.0, 0.5, 1.0]))
        # Cables have no first side; sections that are mirrored as a whole count as well.
        expected = bool(np.any(values <= 0) or np.any(stretches <= 1 / 3))
        found = system.mirrored(states.reshape(3, -1))
        assert (found is not None) == expected
        if expected:
            folded += 1
            assert found[0] == 1
            assert "'body'" in found[1]
            # What the first state has is not counted.
            assert system.mirrored(states[1:].reshape(2, -1)) is None
    assert 20 < folded < 90


@pytest.mark.parametrize("angle", [1.5, 1.570796, 1.570797, 1.8])
def test_a_cable_folds_when_its_end_turns_against_the_chord(angle):
    """End tangents at +-angle to the chord: folded beyond a right angle, pi/2 = 1.5707963."""
    rope = Beam("rope", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.01, 0.01), RUBBER, element=CABLE_2D)
    system = assemble(Scene([rope], [Pin(rope.at_start)]))
    c, s = np.cos(angle), np.sin(angle)
    q = np.stack([system.start()[0], [0, 0, c, s, 1.0, 0, c, -s]])
    assert (system.mirrored(q) is not None) == (angle > np.pi / 2)


@pytest.mark.parametrize(
    ("elements", "integrator"),
    [*((n, x) for n in (1, 2) for x in EVERY[:5]), (8, HHT(1e-2)), (8, Radau(step=5e-3))],
    ids=str,
)
def test_a_wire_whose_ends_are_driven_together(elements, integrator):
    """One or two elements bend by more than half a circle; eight hang as a narrow loop."""
    made = Rectangle(0.002, 0.002), Material(1000, 1e7, 0.3)
    wire = Beam("wire", (0.0, 0.0), (1.0, 0.0), elements, *made, element=CABLE_2D)
    joints = [Pin(wire.at_start), PointOnLine(wire.at_end, direction=(1, 0))]
    joints.append(TranslationDriver(wire.at_end, (1, 0), SmoothStep(0.0, -1.05, 1.0)))
    run = simulate(Scene([wire], joints, (0, -9.81)), 1.0, integrator)
    s = np.linspace(0.0, 1.0, elements + 1)
    kept = np.array([sides(x, s, np.linspace(0, 1, 101)).min() for x in run.nodes("wire")])
    assert np.all(kept > 0)
    if elements == 8:
        assert run.outcome.success
        return
    assert run.outcome.verdict is Verdict.FOLDED
    assert "an element of 'wire' back on itself" in run.outcome.advice
    # All integrators end at the same time, within the instants that they report.
    assert run.t[-1] == pytest.approx({1: 0.4093, 2: 0.7748}[elements], abs=0.012)


@pytest.mark.parametrize("integrator", EVERY, ids=str)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.filterwarnings("ignore", category=LargeStrainWarning)
def test_a_strip_that_is_pushed_through_itself(d, integrator):
    """Sections at the nodes stand upright while the middle of the element is crushed."""
    z = (0.0,) * (d - 1)
    strip = Beam("strip", (0.0, *z), (1.0, *z), 1, Rectangle(0.05, 0.05), RUBBER)
    joints = [Clamp(strip.at_start), PointOnLine(strip.at_end, direction=(1, *z))]
    joints.append(TranslationDriver(strip.at_end, (1, *z), SmoothStep(0.0, -1.2, 1.0)))
    run = simulate(Scene([strip], joints), 1.0, integrator)
    assert run.outcome.verdict is Verdict.FOLDED
    assert "crushes an element of 'strip'" in run.outcome.advice
    nodes = run.nodes("strip")
    assert np.all(np.linalg.det(nodes[:, :, 1:]) > 0)
    s, places = np.array([0.0, 1.0]), np.linspace(0, 1, 101)
    kept = np.array([squared_stretches(x, s, places).min() for x in nodes])
    # The force of a stretch, lambda (lambda^2 - 1)/2, is largest at 1/3.
    assert np.all(kept > 1 / 3)
    assert kept[-1] < 0.4


@pytest.mark.parametrize("strain", [0.0, 0.1, -0.2])
@pytest.mark.parametrize("integrator", EVERY, ids=str)
def test_a_cable_that_is_crushed_ends_at_the_largest_force_of_its_law(integrator, strain):
    """N = E A lambda (lambda^2 - 1 + 2 eps_i)/2 is least at lambda^2 = (1 - 2 eps_i)/3.

    Its end is driven slowly, so that it stays straight and is strained alike along itself.
    """
    made = Rectangle(0.02, 0.02), Material(1000, 1e7, 0.3, damping_time=1e-2)
    more = {"element": CABLE_2D, "initial_strain": strain}
    rope = Beam("rope", (0.0, 0.0), (1.0, 0.0), 2, *made, **more)
    joints = [Pin(rope.at_start), PointOnLine(rope.at_end, direction=(1, 0))]
    joints.append(TranslationDriver(rope.at_end, (1, 0), SmoothStep(0.0, -0.8, 1.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LargeStrainWarning)
        run = simulate(Scene([rope], joints), 1.0, integrator)
    assert run.outcome.verdict is Verdict.FOLDED
    assert "crushes an element of 'rope'" in run.outcome.advice
    end = np.sqrt((1 - 2 * strain) / 3)
    assert end < run.nodes("rope")[-1, -1, 0, 0] < end + 0.06


def test_an_element_that_starts_folded_is_the_users():
    """A declared start is not judged by the steps that follow."""
    rope = Beam("rope", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.01, 0.01), RUBBER, element=CABLE_2D)
    nodes = np.array([[[0, 0], [-0.1, 1]], [[1, 0], [-0.1, -1]]], dtype=float)
    scene = Scene([rope], [Pin(rope.at_start)], start=[NodalState("rope", nodes)])
    assert simulate(scene, 1e-3, HHT(1e-4)).outcome.success
