"""Sliding joints: beads on wires and cables, beams that run through guides, and their friction."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
    DOP853,
    HHT,
    IDA,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    DirectDifferentiation,
    EndEvent,
    FiniteDifference,
    InitialVelocity,
    Integral,
    Material,
    Pin,
    Radau,
    RigidBody,
    Scene,
    SlidingFriction,
    SlidingJoint,
    Terminal,
    TorsionalSpringDamper,
    assemble,
    check_system,
    equilibrium,
    gradient,
    load_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.observables import (
    gravitational_energy,
    kinetic_energy,
    load_power,
    observe,
    position,
    reaction,
    slide_distance,
    slide_speed,
    strain_energy,
)
from ancfdae.results import Verdict
from ancfdae.sections import Circle

G = 9.81
STEEL = Material(density=1000.0, youngs_modulus=1e9, poisson_ratio=0.3)
INTEGRATORS = [HHT(2.0**-9), Radau(rtol=1e-8), IDA(1e-10), DOP853(1e-10)]
MASS, ROLLING = 0.1, 0.02


def bead(place, mass=MASS):
    d = len(place)
    return RigidBody("bead", place, mass=mass, inertia=1e-4 if d == 2 else (1e-4,) * 3)


def slide(beam, body, fraction, **given):
    given = {"rolling_mass": ROLLING, "name": "slide"} | given
    return SlidingJoint(beam, body.origin, fraction=fraction, **given)


def wire(d=2, angle=0.3, length=2.0, start=(0.0, 0.0, 0.0), fraction=0.1, **given):
    """A bead on a straight rigid wire that falls at an angle."""
    along = length * np.array([np.cos(angle), -np.sin(angle), 0.0])[:d]
    start = np.array(start)[:d]
    rod = Beam("rod", start, start + along, 4, Circle(0.1), STEEL, rigid=True)
    body = bead(tuple(start + fraction * along))
    joints = [Clamp(rod.at_start, name="wall"), slide("rod", body, fraction, **given)]
    return Scene([rod], joints, gravity=(0, -G, 0)[:d], bodies=[body])


# -- closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("integrator", INTEGRATORS, ids=repr)
def test_a_bead_falls_along_a_straight_wire(d, integrator):
    run = simulate(wire(d), 0.6, integrator)
    fall = G * np.sin(0.3) * MASS / (MASS + ROLLING) * 0.6
    assert observe(slide_distance("slide"), run)[-1] == pytest.approx(fall * 0.3, rel=1e-7)
    assert observe(slide_speed("slide"), run)[-1] == pytest.approx(fall, rel=1e-7)
    # Across the wire the beam carries the weight, along it the inertia of the rollers.
    force = np.array([observe(reaction("slide", k), run)[-1] for k in range(2)])
    along, across = np.array([np.cos(0.3), -np.sin(0.3)]), np.array([np.sin(0.3), np.cos(0.3)])
    assert force @ across == pytest.approx(MASS * G * np.cos(0.3), rel=1e-6)
    assert force @ along == pytest.approx(-ROLLING * fall / 0.6, rel=1e-6)


@pytest.mark.parametrize("where", [(2e3, -1e3, 5e2), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("d", [2, 3])
def test_digits_do_not_depend_on_place_or_units(where, d):
    found = []
    for unit in (1.0, 1e3):  # m and kg, then mm and t
        base = wire(d, start=where)
        rod = base.beams[0]
        rod = replace(
            rod,
            start=tuple(unit * np.array(rod.start)),
            end=tuple(unit * np.array(rod.end)),
            section=Circle(0.1 * unit),
            material=Material(1e-3 / unit**3 * 1000, 1e9 * 1e-3 / unit, 0.3),
        )
        body = RigidBody(
            "bead",
            tuple(unit * np.array(base.bodies[0].position)),
            mass=MASS * 1e-3,
            inertia=1e-7 * unit**2 if d == 2 else (1e-7 * unit**2,) * 3,
        )
        joints = [Clamp(rod.at_start), slide("rod", body, 0.1, rolling_mass=ROLLING * 1e-3)]
        gravity = tuple(unit * np.array((0, -G, 0)[:d]))
        run = simulate(Scene([rod], joints, gravity, bodies=[body]), 0.6, HHT(2.0**-7))
        found.append(observe(slide_distance("slide"), run)[-1] / unit)
    expected = G * np.sin(0.3) * MASS / (MASS + ROLLING) * 0.18
    # A thousand lengths away positions of 2,000 m have a round-off of 2e-13 m.
    assert found == pytest.approx([expected, expected], rel=1e-10)


def hermite(nodes, slopes, s, l, order):
    """Position or derivatives of a line of cubics between nodes with unit slopes, by hand."""
    k = min(int(s // l), len(nodes) - 2)
    x = s / l - k
    weights = [
        ([1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2]),
        ([6 * x**2 - 6 * x, 1 - 4 * x + 3 * x**2, 6 * x - 6 * x**2, 3 * x**2 - 2 * x]),
        ([12 * x - 6, 6 * x - 4, 6 - 12 * x, 6 * x - 2]),
    ][order]
    a, b, c, e = weights
    r = a * nodes[k] + b * l * slopes[k] + c * nodes[k + 1] + e * l * slopes[k + 1]
    return r / l**order


class Line:
    """A line of cubics of the same length."""

    def __init__(self, nodes, slopes, l):
        self.parts, self.start = (nodes, slopes, l), 0.1 * l * (len(nodes) - 1)

    def __call__(self, s, order):
        nodes, slopes, l = self.parts
        return hermite(nodes, slopes, s, l, order)


def bowl(d=2, elements=5, **given):
    """A bead in a rigid bowl, an arc of a circle of 1 m whose cubics are not quite round."""
    angles = np.linspace(-1.2, 1.2, elements + 1)
    z = np.zeros((len(angles), d - 2))
    nodes = np.column_stack([np.sin(angles), 1 - np.cos(angles), z])
    slopes = np.column_stack([np.cos(angles), np.sin(angles), z])
    frames = np.zeros((len(angles), d, d))
    frames[:, 0], frames[:, 1, :2] = slopes, np.column_stack([-np.sin(angles), np.cos(angles)])
    if d == 3:
        frames[:, 2, 2] = 1.0
    rod = CurvedBeam("rod", nodes, frames, Circle(0.05), STEEL, rigid=True)
    l = rod.reference().lengths[0]
    body = bead(tuple(hermite(nodes, slopes, 0.1 * elements * l, l, 0)))
    joints = [Clamp(rod.at_start), slide("rod", body, 0.1, **given)]
    scene = Scene([rod], joints, gravity=(0, -G, 0)[:d], bodies=[body])
    return scene, Line(nodes, slopes, l)


def in_the_bowl(line, mass, t):
    """The travel by minimal coordinates: (m |r_s|^2 + m_r) s'' + m r_s . r_ss s'^2 = m g . r_s."""

    def rates(_, y):
        s, speed = y
        r_1, r_2 = line(s, 1), line(s, 2)
        pull = -mass * G * r_1[1] - mass * (r_1 @ r_2) * speed**2
        return [speed, pull / (mass * r_1 @ r_1 + ROLLING)]

    found = solve_ivp(
        rates, (0, t), [line.start, 0.0], "DOP853", rtol=1e-12, atol=1e-13, max_step=5e-3
    )
    return found.y[0, -1] - line.start


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("integrator", [Radau(rtol=1e-8), IDA(1e-10), DOP853(1e-10)], ids=repr)
def test_a_bead_in_a_bowl_moves_as_in_minimal_coordinates(d, integrator):
    scene, line = bowl(d)
    # Through all five elements and back: nodes are passed eight times.
    run = simulate(scene, 2.0, integrator)
    expected = in_the_bowl(line, MASS, 2.0)
    assert observe(slide_distance("slide"), run).max() > 0.7 * 2.4
    # The curvature jumps at nodes, which DOP853 and IDA step over with errors above their rtol.
    assert observe(slide_distance("slide"), run)[-1] == pytest.approx(expected, abs=3e-5)


def test_hht_and_its_derivatives_are_of_second_order_past_nodes():
    _, line = bowl()
    step = 1e-4 * MASS
    around = [in_the_bowl(line, MASS + x, 0.8) for x in (step, -step)]
    exact = np.array([in_the_bowl(line, MASS, 0.8), (around[0] - around[1]) / (2 * step)])
    errors = []
    for power in (8, 10):
        found = gradient(
            bowl()[0],
            Terminal(slide_distance("slide")),
            0.8,
            HHT(2.0**-power),
            design=["bead.mass"],
        )
        errors.append(np.abs([found.value, found.gradient[0]] - exact))
    assert np.all(errors[1] < errors[0] / 9)
    assert np.all(errors[1] < 1e-4 * np.abs(exact))


@pytest.mark.parametrize("d", [2, 3])
def test_a_rod_slides_through_a_guide_on_the_ground(d):
    """Two coordinates: the place of the guide on the rod, and the angle of the rod."""
    L, mass, angle, fraction = 2.0, 3.0, 0.4, 0.7
    along = np.array([np.cos(angle), np.sin(angle), 0.0])[:d]
    section, density = Circle(0.05), mass / (np.pi * 0.05**2 * L)
    start = -fraction * L * along
    rod = Beam("rod", start, start + L * along, 3, section, Material(density, 1e9, 0.3), rigid=True)
    guide = SlidingJoint(
        "rod", ground=np.zeros(d), fraction=fraction, rolling_mass=ROLLING, name="slide"
    )
    run = simulate(Scene([rod], [guide], (0, -G, 0)[:d]), 0.4, Radau(rtol=1e-9))
    # About the guide, u from it to the centre: T = m (u'^2 + u^2 w^2)/2 + I w^2/2 + m_r u'^2/2.
    inertia = mass * (L**2 / 12 + 0.05**2 / 4)

    def rates(_, y):
        u, theta, u_t, w = y
        u_tt = (mass * u * w**2 - mass * G * np.sin(theta)) / (mass + ROLLING)
        turn = -mass * G * u * np.cos(theta) - 2 * mass * u * u_t * w
        return [u_t, w, u_tt, turn / (inertia + mass * u**2)]

    y = [(0.5 - fraction) * L, angle, 0.0, 0.0]
    end = solve_ivp(rates, (0, 0.4), y, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert observe(slide_distance("slide"), run)[-1] == pytest.approx(y[0] - end[0], rel=1e-6)
    assert observe(position(rod.at_start, 1), run)[-1] == pytest.approx(
        (end[0] - L / 2) * np.sin(end[1]), rel=1e-6
    )


def test_a_bead_swings_on_a_soft_cable_with_its_energy():
    cable = Beam("rod", (0, 0), (2, 0), 6, Circle(0.02), Material(1000, 1e7, 0.3), element=CABLE_2D)
    body = bead((0.5, 0.0), mass=0.5)
    ends = [Pin(cable.at_start), Pin(cable.at_end)]
    scene = Scene([cable], [*ends, slide("rod", body, 0.25)], (0, -G), bodies=[body])
    run = simulate(scene, 1.5, Radau(rtol=1e-8))
    parts = strain_energy(), kinetic_energy(), gravitational_energy()
    system = assemble(scene)
    strain, kinetic, weight = (observe(x, run, system) for x in parts)
    # The rollers have a twentieth of the kinetic energy along the cable: seen if it were left out.
    assert observe(slide_distance("slide"), run).max() > 0.5
    assert np.max(np.abs(np.diff(strain + kinetic + weight))) < 1e-6 * np.max(kinetic)
    assert kinetic[0] == 0
    assert np.max(kinetic) > 1.0
    without = kinetic - ROLLING * observe(slide_speed("slide"), run) ** 2 / 2
    assert np.max(np.abs(np.diff(strain + without + weight))) > 1e-5 * np.max(kinetic)


def test_an_equilibrium_has_the_bead_at_the_lowest_place():
    scene, line = bowl()
    # The bead itself must not turn freely.
    scene = replace(scene, loads=[TorsionalSpringDamper(scene.bodies[0].origin, 0.1)])
    found = equilibrium(scene)
    assert found.outcome.success
    s = brentq(lambda s: line(s, 1)[1], 1.0, 1.4)
    assert observe(slide_distance("slide"), found.solution)[-1] == pytest.approx(
        s - line.start, abs=1e-9
    )


# -- friction ----------------------------------------------------------------------------------


def rubbed(**given):
    load = SlidingFriction("slide", **({"coulomb": 0.0, "smooth_speed": 1e-3} | given), name="drag")
    return replace(wire(), loads=[load])


def test_viscous_friction_brakes_a_bead_as_in_the_closed_form():
    c, m, pull = 0.3, MASS + ROLLING, MASS * G * np.sin(0.3)
    found = gradient(
        rubbed(viscous=c),
        Terminal(slide_speed("slide")),
        0.5,
        Radau(rtol=1e-9),
        design=["drag.viscous"],
    )
    decay = np.exp(-c / m * 0.5)
    assert found.value == pytest.approx(pull / c * (1 - decay), rel=1e-7)
    slope = -pull / c**2 * (1 - decay) + pull / c * 0.5 / m * decay
    assert found.gradient[0] == pytest.approx(slope, rel=1e-7)


def test_dry_friction_takes_its_level_and_power():
    scene = rubbed(coulomb=0.1)
    run = simulate(scene, 0.5, HHT(2.0**-11))
    speed = observe(slide_speed("slide"), run)
    pull = (MASS * G * np.sin(0.3) - 0.1) / (MASS + ROLLING)
    # The speed grows as without regularisation, except below smooth_speed, 1e-3 m/s.
    assert speed[-1] == pytest.approx(pull * 0.5, abs=2e-3)
    assert observe(load_power("drag"), run, assemble(scene))[-1] == pytest.approx(
        -0.1 * speed[-1], rel=1e-12
    )


# -- derivatives -------------------------------------------------------------------------------


def cableway(d=2, joint_given=None):
    """A bead that starts with a speed on a cable of two elements."""
    z = (0.1,) * (d - 2)
    end, element = (1.0, 0.1, *z), CABLE_2D if d == 2 else CABLE_3D
    cable = Beam("rod", (0, 0, *(0 for _ in z)), end, 2, Circle(0.02), STEEL, element=element)
    along = np.array(end) / np.linalg.norm(end)
    body = bead(tuple(0.3 * np.array(end)))
    ends = [Pin(cable.at_start, name="a"), Pin(cable.at_end, name="b")]
    loads = [SlidingFriction("slide", 0.05, 0.2, 0.1, 0.08, 0.3, name="drag")]
    return Scene(
        [cable],
        [*ends, slide("rod", body, 0.3, speed=0.8)],
        (0, -G, 0)[:d],
        [InitialVelocity("bead", 0.0 if d == 2 else (0, 0, 0), (0, 0, 0)[:d], tuple(0.8 * along))],
        loads,
        bodies=[body],
    )


DESIGN = ["bead.mass", "rod.youngs_modulus", "drag.coulomb", "drag.viscous", "drag.breakaway"]


@pytest.mark.parametrize("d", [2, 3])
def test_every_derivative_of_the_equations_is_that_of_their_values(d):
    report = check_system(assemble(cableway(d), [*DESIGN, "slide.fraction"]), samples=1)
    assert report.passed, report


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("integrator", [HHT(2.0**-7), Radau(2.0**-6)], ids=repr)
def test_gradients_are_exact(d, integrator):
    scene = cableway(d)
    objective = Integral(slide_distance("slide") * position(scene.bodies[0].origin, 1))
    call = scene, objective, 0.25, integrator
    direct, adjoint, stepped = (
        gradient(*call, design=DESIGN, method=method()).gradient
        for method in (DirectDifferentiation, Adjoint, ComplexStep)
    )
    size = np.maximum(np.abs(stepped), 1e-4 * np.max(np.abs(stepped)))
    assert np.max(np.abs(direct - stepped) / size) < 1e-10
    assert np.max(np.abs(adjoint - stepped) / size) < 1e-10
    method = FiniteDifference(1e-4, central=True)
    differences = gradient(*call, design=DESIGN, method=method).gradient
    size = np.max(np.abs(stepped))
    assert differences == pytest.approx(stepped, rel=1e-5, abs=1e-7 * size)


@pytest.mark.parametrize("d", [2, 3])
def test_geometry_moves_the_bead_along(d):
    """Derivatives in the length of the wire, its place and the fraction have closed forms."""
    design, x = ["slide.fraction", "rod.length", "rod.start_x"], None
    scene = wire(d)
    x = position(scene.bodies[0].origin, 0)
    for method in (DirectDifferentiation(), Adjoint(), ComplexStep()):
        found = gradient(scene, Terminal(x), 0.5, HHT(2.0**-7), design=design, method=method)
        expected = [2 * np.cos(0.3), 0.1 * np.cos(0.3), 1.0]
        assert found.gradient == pytest.approx(expected, rel=1e-9)


# -- ends, files, refusals ---------------------------------------------------------------------


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=repr)
def test_a_run_ends_in_words_where_the_guide_leaves_the_beam(integrator):
    run = simulate(wire(), 2.0, integrator)
    assert not run.outcome.success
    assert "takes the guide of joint 'slide' beyond the end of beam 'rod'" in str(run.outcome)
    travel = observe(slide_distance("slide"), run)
    # The last step that is kept ends on the beam, within a step of its end.
    assert travel[-1] <= 1.8
    assert run.t[-1] < np.sqrt(2 * 1.8 / (G * np.sin(0.3) * MASS / (MASS + ROLLING)))


@pytest.mark.parametrize(
    "integrator", [HHT(2.0), Radau(2.0), Radau(rtol=1e-6), DOP853(1e-6)], ids=repr
)
@pytest.mark.parametrize(("fraction", "leaves"), [(0.4, True), (0.6, False)])
def test_a_guide_that_leaves_and_returns_within_a_step_is_seen(integrator, fraction, leaves):
    """A bead thrown up a wire of 2 m turns 1 m higher and comes back: the run may be one step."""
    pull = G * np.sin(0.3) * MASS / (MASS + ROLLING)
    speed = np.sqrt(2 * pull)
    scene = wire(fraction=fraction, speed=-speed)
    velocity = (-speed * np.cos(0.3), speed * np.sin(0.3))
    thrown = [InitialVelocity("bead", 0.0, about=(0.0, 0.0), velocity=velocity)]
    run = simulate(replace(scene, start=thrown), 2 * speed / pull, integrator)
    assert run.outcome.success is not leaves
    if leaves:
        assert run.outcome.verdict is Verdict.OFF_ROUTE
        assert "beyond the start of beam 'rod'" in str(run.outcome)


def test_an_event_ends_a_run_before_the_end_of_the_beam():
    stop = EndEvent(slide_distance("slide") - 1.5)
    found = gradient(
        wire(),
        Terminal(slide_speed("slide")),
        2.0,
        HHT(2.0**-8),
        design=["bead.mass"],
        events=[stop],
    )
    pull = G * np.sin(0.3) * MASS / (MASS + ROLLING)
    assert found.value == pytest.approx(np.sqrt(2 * 1.5 * pull), rel=1e-9)
    slope = found.value / 2 * ROLLING / (MASS * (MASS + ROLLING))
    assert found.gradient[0] == pytest.approx(slope, rel=1e-8)


def test_a_saved_run_knows_its_slide(tmp_path):
    run = simulate(wire(3), 0.25, HHT(2.0**-6))
    run.save(tmp_path / "run.npz")
    again = load_solution(tmp_path / "run.npz")
    assert np.array_equal(
        observe(slide_distance("slide"), again), observe(slide_distance("slide"), run)
    )
    assert "slide.travel.x" in run.naming.coordinate_names()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"fraction": 0.0}, "must lie between 0 and 1"),
        ({"fraction": np.nan}, "finite"),
        ({"rolling_mass": 0.0}, "positive"),
        ({"speed": np.inf}, "finite"),
        ({"other": None}, "needs either"),
        ({"ground": (0.0, 0.0)}, "needs either"),
        ({"beam": 3}, "beam"),
    ],
)
def test_a_joint_refuses_what_does_not_fit(given, words):
    good = {"beam": "rod", "other": bead((0, 0)).origin, "fraction": 0.5, "rolling_mass": 0.1}
    with pytest.raises(InvalidInputError, match=words):
        SlidingJoint(**(good | given))


def test_names_that_do_not_exist_are_refused():
    scene = wire()
    with pytest.raises(UnknownNameError, match="beam"):
        replace(scene, joints=[slide("cable", scene.bodies[0], 0.1)])
    with pytest.raises(UnknownNameError, match="'sled'"):
        assemble(replace(scene, loads=[SlidingFriction("sled", 0.1, 0.01)]))
    with pytest.raises(UnknownNameError, match="sliding joint"):
        gradient(scene, Terminal(slide_distance("wall")), 0.1, HHT(0.01), design=["bead.mass"])
    with pytest.raises(InvalidInputError, match="breakaway"):
        SlidingFriction("slide", 0.1, 0.01, breakaway=0.2)
