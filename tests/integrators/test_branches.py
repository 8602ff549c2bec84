"""Runs stay on the branch of the joints that the motion is on, held against closed forms.

A slider-crank that is driven at its slider, x(t), has two branches: the elbow is above the line of
the slider or below it. By the law of cosines its height is +-r sqrt(1 - c^2) with c = (r^2 + x^2 -
l^2)/(2 r x). A law that turns back a distance d before the dead point r + l keeps its side,
whatever d.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.interpolate import make_interp_spline

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Beam,
    InitialVelocity,
    Material,
    Pin,
    PointOnLine,
    Radau,
    RotationDriver,
    Scene,
    TranslationDriver,
    assemble,
    simulate,
)
from ancfdae.integrators import recorder
from ancfdae.integrators.branch import CHANGED, Form, Place, closed, followed
from ancfdae.integrators.prescribed_motion import Watch
from ancfdae.laws import ConstantAcceleration, Harmonic, Spline
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle

STEEL = Material(density=7800.0, youngs_modulus=2e11, poisson_ratio=0.3)
SECTION = Rectangle(height=0.02, width=0.02)
R, L, STROKE, RATE = 0.1, 0.3, 0.02, 20.0


def height(x):
    """Height of the elbow where the slider stands at x."""
    c = (R * R + x * x - L * L) / (2 * R * x)
    return R * np.sqrt(1 - c * c)


def pushed(begin, law, origin=(0.0, 0.0), hangs=False):
    """A rigid slider-crank whose slider a law pushes from x = begin; a pendulum may hang on it."""
    o, y = np.array(origin), height(begin)
    elbow = tuple(o + np.array([np.sqrt(R * R - y * y) * np.sign(R * R + begin**2 - L * L), y]))
    slider = tuple(o + np.array([begin, 0.0]))
    crank, rod = (
        Beam(name, tuple(a), b, 1, SECTION, STEEL, rigid=True)
        for name, a, b in (("crank", o, elbow), ("rod", elbow, slider))
    )
    beams = [crank, rod]
    joints = [
        Pin(crank.at_start),
        Pin(crank.at_end, rod.at_start),
        PointOnLine(rod.at_end, direction=(1, 0)),
        TranslationDriver(rod.at_end, (1, 0), law, name="push"),
    ]
    if hangs:
        end = slider[0], slider[1] - 0.2
        beams.append(Beam("pendulum", slider, end, 1, SECTION, STEEL, rigid=True))
        joints.append(Pin(beams[-1].at_start, rod.at_end))
    gravity = (0.0, -9.81 if hangs else 0.0)
    return crank, Scene(beams, joints, gravity, project_start=True)


def error(run, crank, x, y=0.0):
    """Largest error of the height of the elbow over all instants that a run kept."""
    return np.max(np.abs(run.position(crank.at_end)[:, 1] - y - height(x)))


FIXED = [Radau(step=0.01), HHT(0.01), HHT(0.002), HHT(0.0005)]
CONTROLLED = [Radau(rtol=1e-4), HHT(rtol=1e-4), IDA(1e-6), DOP853(1e-4), IDA(1e-4)]


@pytest.mark.parametrize(
    ("distance", "hangs"), [(1e-3, True), (1e-5, False), (1e-6, True), (1e-7, True), (1e-7, False)]
)
@pytest.mark.parametrize("integrator", FIXED + CONTROLLED, ids=str)
def test_no_success_on_the_other_side_of_a_dead_point(integrator, distance, hangs):
    """Fixed steps once went on below the line, 0.145 m off, with success.

    All instants are right that a run keeps, to round-off near the dead point, 1e-16/sqrt(d); IDA
    and DOP853 leave joints open by their tolerance, which the dead point magnifies by up to
    1/sqrt(d/l).
    """
    begin = R + L - distance - STROKE
    crank, scene = pushed(begin, Harmonic(STROKE, RATE), hangs=hangs)
    run = simulate(scene, 0.25, integrator)
    least = 1e-3 if isinstance(integrator, IDA | DOP853) else 1e-12
    assert error(run, crank, begin + STROKE * np.sin(RATE * run.t)) <= least
    # Whether one of the few steps of Radau passes over the last 1e-7 is chance; it says so.
    if integrator in CONTROLLED[:3] and (distance > 1e-7 or not isinstance(integrator, Radau)):
        assert run.outcome.success
    elif not run.outcome.success:
        assert run.t[-1] >= 0.06  # the last instants before the dead point, at 0.0785 s
    if run.outcome.verdict is Verdict.OFF_ROOT and integrator in FIXED:
        assert "tried" in run.outcome.advice


class Rows:
    """Recorded states of a run, handed to `Watch` as a recorder does."""

    def __init__(self, run):
        self.rows, self.instants, self.kept = [run.t, run.q.copy(), run.v], 1, len(run.t)

    def last(self, count):
        return recorder.Rows(*(x[self.instants - count : self.instants] for x in self.rows))

    def cut(self, count):
        self.kept = count


@pytest.mark.parametrize("distance", [1e-3, 1e-5])
def test_a_linkage_on_its_other_branch_is_found_beside_a_free_pendulum(distance):
    """The crank is reflected after the dead point, as IDA(1e-4) once left it with success."""
    begin = R + L - distance - STROKE
    _, scene = pushed(begin, Harmonic(STROKE, RATE), hangs=True)
    run = simulate(scene, 0.1, HHT(0.0005))
    system, first = assemble(scene), int(np.argmax(run.t > np.pi / 2 / RATE))
    for reflected in (False, True):
        rows = Rows(run)
        if reflected:
            after = rows.rows[1][first:].reshape(len(run.t) - first, -1, 2)
            # Positions and axes along two rigid bars, (c, s); axes across them, (-s, c).
            after[:, [0, 1, 3, 4], 1] *= -1
            after[:, [2, 5], 0] *= -1
        closed = system.constraint(run.t[-1], rows.rows[1][-1])
        np.testing.assert_allclose(closed, 0.0, atol=1e-12)
        watch = Watch(system, rows)
        rows.instants = len(run.t)
        lost = watch.missed(all_of_them=True)
        assert (lost is not None) == reflected
    assert lost.verdict is Verdict.OFF_ROOT
    assert rows.kept == first


@pytest.mark.parametrize(
    ("rtol", "distance"), [(1e-4, 6.8e-7), (1e-4, 1.9e-6), (2.2e-4, 6.8e-7), (3.3e-4, 8.5e-8)]
)
def test_joints_open_by_more_than_the_distance_to_a_dead_point(rtol, distance):
    """Runs that ended 0.145 m off with success, as a pendulum hung free; or stop in words."""
    begin = R + L - distance - STROKE
    crank, scene = pushed(begin, Harmonic(STROKE, RATE), hangs=True)
    run = simulate(scene, 0.25, IDA(rtol))
    assert error(run, crank, begin + STROKE * np.sin(RATE * run.t)) <= 1e-3
    if not run.outcome.success:
        assert run.outcome.verdict is Verdict.OFF_ROOT
        assert "leaves the joints open too far" in run.outcome.advice
    tight = simulate(scene, 0.25, IDA(rtol / 100))
    assert tight.outcome.success
    assert error(tight, crank, begin + STROKE * np.sin(RATE * tight.t)) <= 1e-4


@pytest.mark.parametrize("integrator", [HHT(0.01), HHT(0.002), Radau(step=0.01)], ids=str)
def test_a_lock_between_two_steps_is_seen_beside_a_free_pendulum(integrator):
    """The law passes the dead point by 1e-6 m for 1 ms, and the joints close again behind it."""
    begin = R + L + 1e-6 - STROKE
    _, scene = pushed(begin, Harmonic(STROKE, RATE), hangs=True)
    run = simulate(scene, 0.25, integrator)
    locked = np.arcsin(1 - 1e-6 / STROKE) / RATE
    assert run.outcome.verdict is Verdict.OFF_ROOT
    said = re.search(r"The joints lock at t = ([\d.]+):", run.outcome.advice)
    assert said
    assert float(said[1]) == pytest.approx(locked, rel=1e-5)
    assert run.t[-1] < locked


@pytest.mark.parametrize("seed", range(20))
def test_the_determined_part_against_ranks(seed):
    """Random patterns: what is determined has full rank, and every other coordinate can move.

    With random numbers the null space of the whole matrix is zero there and nowhere else.
    """
    random = np.random.default_rng(seed)
    shape = random.integers(3, 9), 9
    B = random.normal(size=shape) * (random.uniform(size=shape) < 0.35)
    B = B[np.any(B, axis=1)]
    if np.linalg.matrix_rank(B) < len(B):
        B = B[:1]
    taken, known = SparsityPattern(B.shape, *np.nonzero(B)).determined
    free = np.linalg.norm(scipy.linalg.null_space(B), axis=1)
    np.testing.assert_array_equal(known, free < 1e-12)
    assert np.sum(taken) == np.sum(known)
    assert not np.any(B[taken][:, ~known])


def test_the_step_that_an_outcome_names_is_right():
    """An outcome names HHT(step=0.00125); its run agrees with the closed form to 1e-12 m."""
    begin = R + L - 1e-6 - STROKE
    crank, scene = pushed(begin, Harmonic(STROKE, RATE))
    advice = simulate(scene, 0.25, HHT(0.01)).outcome.advice
    assert "HHT(step=0.00125) was tried then and reached the end." in advice
    run = simulate(scene, 0.25, HHT(step=0.00125))
    assert run.outcome.success
    assert error(run, crank, begin + STROKE * np.sin(RATE * run.t)) <= 1e-12


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("integrator", [HHT(0.7 / 60), Radau(step=0.7 / 60)], ids=["HHT", "Radau"])
def test_what_a_run_keeps_is_right_wherever_it_stops(integrator, seed):
    """Splines through places 1e-7 to 3e-2 from the dead point, and over it: joints then lock."""
    random = np.random.default_rng(seed)
    times = np.linspace(0.0, 0.7, 9)
    places = R + L - 10 ** random.uniform(-7, -1.5, len(times))
    law = Spline(times, places - places[0])
    crank, scene = pushed(places[0], law)
    run = simulate(scene, 0.7, integrator)
    # The law never leads to the dead point and back but on the same side: it stays above the line.
    assert np.all(run.position(crank.at_end)[:, 1] > 0)


@pytest.mark.parametrize("integrator", [Radau(step=0.01), HHT(0.002)], ids=["Radau", "HHT"])
def test_the_check_does_not_depend_on_the_place(integrator):
    """Moved by a thousand lengths: the dead point is seen at the same step."""
    begin, ends = R + L - 1e-6 - STROKE, []
    for origin in ((0.0, 0.0), (300.0, -200.0)):
        crank, scene = pushed(begin, Harmonic(STROKE, RATE), origin)
        run = simulate(scene, 0.25, integrator)
        ends.append((run.outcome.verdict, len(run.t)))
        # Round-off of 300 m, 1e-13, over the slope at the dead point, sqrt(d/l) = 2e-3.
        assert error(run, crank, begin + STROKE * np.sin(RATE * run.t), origin[1]) <= 1e-9
    assert ends[0] == ends[1]


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
@pytest.mark.parametrize("turns", [2.0, 5.0, 15.0])
def test_fast_free_turns_raise_no_alarm(turns):
    """A pendulum that spins freely by up to 0.75 rad in a step leaves no branch."""
    beam = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, SECTION, STEEL, rigid=True)
    other = Beam("tail", (1.0, 0.0), (1.5, 0.0), 1, SECTION, STEEL, rigid=True)
    start = [InitialVelocity("rod", turns, (0, 0)), InitialVelocity("tail", turns, (0, 0))]
    joints = [Pin(beam.at_start), Pin(beam.at_end, other.at_start)]
    run = simulate(Scene([beam, other], joints, (0.0, -9.81), start=start), 1.0, HHT(0.05))
    assert run.outcome.success


def test_the_change_of_a_place_against_its_definition():
    """norm(X) by dense matrices, with eigenvalues: (B_1 - B_0) B_0^-1 of n_lam = n_q."""
    begin = R + L - 1e-2 - STROKE
    _, scene = pushed(begin, ConstantAcceleration(0.1))
    system, run = assemble(scene), simulate(scene, 0.28, HHT(0.001))
    values = system.constraints_q(run.t, run.q)
    form = Form(system, values[0])
    changes = Place(form, values[0]).changes(values)
    B = [system.constraint_pattern.csr(x).toarray() for x in values]
    exact = [np.max(np.abs(np.linalg.eigvals(x @ np.linalg.inv(B[0]) - np.eye(12)))) for x in B]
    # Above the limit the eighth root of a norm of the eighth power: n^(1/8), and less than a
    # quarter more. Below it, a norm: not less than the eigenvalue.
    assert np.all(changes >= np.array(exact) * (1 - 1e-9) - 1e-12)
    first = int(np.argmax(changes > CHANGED))
    assert first > 0
    assert changes[first] <= 1.7 * exact[first]


@pytest.mark.parametrize("short", [0.5, 1e-2, 1e-4, 1e-7])
def test_a_chain_whose_second_link_is_free_has_one_branch(short):
    """A double pendulum with a driven first link: the places of the second are a circle.

    A long step may lead to the other side of the circle, an angle `short` of half a turn away from
    where the path ends that aims through it. Once "the joints close in more than one way".
    """
    one = Beam("one", (0.0, 0.0), (1.0, 0.0), 1, SECTION, STEEL, rigid=True)
    two = Beam("two", (1.0, 0.0), (1.5, 0.0), 1, SECTION, STEEL, rigid=True)
    joints = [
        Pin(one.at_start),
        RotationDriver(one.at_start, ConstantAcceleration(0.0)),
        Pin(one.at_end, two.at_start),
    ]
    system = assemble(Scene([one, two], joints))
    first = system.start()[0]
    c, s = np.cos(np.pi - short), np.sin(np.pi - short)
    found = np.append(first[:6], [1.0, 0.0, c, s, -s, c])
    np.testing.assert_allclose(system.constraint(1.0, found), 0.0, atol=1e-14)
    reached, place = followed(system, 0.0, first, 1.0, lambda t: (1 - t) * first + t * found)
    assert reached == 1.0
    np.testing.assert_allclose(place, found, atol=1e-3)


def test_the_law_of_the_splines_is_that_of_scipy():
    """Degree seven with three derivatives that vanish at both ends; no cubic spline."""
    random = np.random.default_rng(1)
    times = np.linspace(0.0, 0.7, 9)
    places = R + L - 10 ** random.uniform(-7, -1.5, len(times))
    law, t = Spline(times, places - places[0]), np.linspace(0.0, 0.7, 1001)
    still = [(k, 0.0) for k in (1, 2, 3)]
    same = make_interp_spline(times, places, k=7, bc_type=(still, still))
    np.testing.assert_allclose(places[0] + law.at(t), same(t), atol=1e-12)
    # The run follows it, and stops before it is over the dead point.
    crank, scene = pushed(places[0], law)
    run = simulate(scene, 0.7, HHT(0.7 / 600))
    assert error(run, crank, same(run.t)) < 1e-9
    assert run.t[-1] == pytest.approx(t[np.argmax(same(t) > R + L)], abs=2 * 0.7 / 600)


# -- a parallelogram, which is stretched twice in each turn ---------------------------------------


A, D, START, SPEED = 0.3, 1.0, 0.5, 2.0


def parallelogram(start, crossed=False, place=(0.0, 0.0)):
    """A driven parallelogram at the angle `start`, or its crossed form, and its rocker.

    The pivot of its crank is at `place`.
    """
    crank_end = np.array([A * np.cos(start), A * np.sin(start)])
    rocker_end = crank_end + np.array([D, 0.0])
    if crossed:
        # Reflected in the line from the end of the crank to the pivot of the rocker.
        line = (np.array([D, 0.0]) - crank_end) / np.linalg.norm([D - crank_end[0], crank_end[1]])
        across = rocker_end - crank_end
        rocker_end = crank_end + 2 * (across @ line) * line - across
    ends = ((0, 0), crank_end), (crank_end, rocker_end), ((D, 0), rocker_end)
    crank, coupler, rocker = (
        Beam(name, tuple(np.add(a, place)), tuple(np.add(b, place)), 1, SECTION, STEEL, rigid=True)
        for name, (a, b) in zip(("crank", "coupler", "rocker"), ends, strict=True)
    )
    joints = [
        Pin(crank.at_start),
        Pin(rocker.at_start),
        Pin(crank.at_end, coupler.at_start),
        Pin(coupler.at_end, rocker.at_end),
        RotationDriver(crank.at_start, ConstantAcceleration(SPEED), name="motor"),
    ]
    return rocker, Scene([crank, coupler, rocker], joints, (0, -9.81), project_start=True)


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
@pytest.mark.parametrize(
    "integrator",
    [
        HHT(0.01),
        HHT(0.0137),
        HHT(rtol=1e-4),
        Radau(0.01),
        Radau(rtol=1e-5),
        IDA(1e-6),
        DOP853(1e-6),
    ],
    ids=repr,
)
def test_a_parallelogram_stays_one_where_it_is_stretched(integrator):
    """The rocker turns as the crank does: x = (D + A cos s, A sin s), s = START + SPEED t.

    It is stretched at s = pi, 2 pi, 3 pi and 4 pi, where it could go on crossed, with a jump of the
    rocker's velocity.
    """
    rocker, scene = parallelogram(START)
    run = simulate(scene, 6.0, integrator)
    assert run.outcome.success
    s = START + SPEED * run.t
    exact = np.stack([D + A * np.cos(s), A * np.sin(s)], axis=1)
    assert np.max(np.abs(run.position(rocker.at_end) - exact)) < 1e-5


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
@pytest.mark.parametrize("place", [(1e3, 500.0), (3e4, -2e4)])
@pytest.mark.parametrize("start", [0.5, 1.2, 2.1, 2.8])
def test_a_parallelogram_stays_one_far_from_the_origin(start, place):
    """One turn as at the origin; coordinates have a round-off of 1e-11 of their lengths there."""
    for integrator in (HHT(0.0157), Radau(0.0523), HHT(rtol=1e-5), Radau(rtol=1e-5)):
        rocker, scene = parallelogram(start, place=place)
        run = simulate(scene, np.pi, integrator)
        assert run.outcome.success, (integrator, run.outcome)
        s = start + SPEED * run.t
        exact = np.add(place, np.stack([D + A * np.cos(s), A * np.sin(s)], axis=1))
        assert np.max(np.abs(run.position(rocker.at_end) - exact)) < 1e-7


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
@pytest.mark.parametrize("back", [True, False])
def test_words_of_a_lock_tell_of_a_law_that_turns_back(back):
    """The parallelogram turns back 1e-7 rad before it is stretched: nothing locks.

    A slider that is pushed through its dead point locks.
    """
    if back:
        _, scene = parallelogram(np.pi - 1e-7 - 0.5)
        law = Harmonic(0.5, 3.0)
        joints = [replace(x, angle=law) if x.name == "motor" else x for x in scene.joints]
        scene = replace(scene, joints=joints)
    else:
        _, scene = pushed(R + L - 1e-2, ConstantAcceleration(0.1))
    run = HHT(0.01).integrate(assemble(scene), 0.6)
    assert not run.outcome.success
    assert "The joints lock at t = " in run.outcome.advice
    assert ("A law that turns back" in run.outcome.advice) == back


@pytest.mark.parametrize("place", [0.0, 1e4, 1e8])
def test_joints_close_to_the_last_place_of_coordinates(place):
    system = assemble(parallelogram(START, place=(place, -place))[1])
    q, random = system.start()[0], np.random.default_rng(1)
    for _ in range(20):
        found = closed(system, 0.0, q + 1e-5 * random.standard_normal(len(q)), None)
        assert found is not None
        assert np.max(np.abs(system.constraint(0.0, found))) <= 1e-14 + 1e-15 * place


def test_a_parallelogram_that_goes_on_crossed_is_found():
    _, scene = parallelogram(START)
    run = simulate(scene, 1.6, HHT(0.01))
    first = int(np.argmax(run.t > (np.pi - START) / SPEED))
    system = assemble(scene)
    for crossed in (False, True):
        rows = Rows(run)
        if crossed:
            _, other = parallelogram(START + SPEED * run.t[first], crossed=True)
            after = simulate(other, float(run.t[-1] - run.t[first]), HHT(0.01))
            count = len(run.t) - first
            rows.rows[1][first:], rows.rows[2][first:] = after.q[:count], after.v[:count]
        np.testing.assert_allclose(system.constraint(run.t[-1], rows.rows[1][-1]), 0.0, atol=1e-9)
        watch = Watch(system, rows)
        rows.instants = len(run.t)
        lost = watch.missed(all_of_them=True)
        assert (lost is not None) == crossed
    assert lost.verdict is Verdict.OFF_ROOT
    assert rows.kept == first
