"""The planar cable: beam theory, the catenary, and what a cable does not have."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
    HHT,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    FollowerForce,
    InitialVelocity,
    Material,
    Moment,
    NodalState,
    Pin,
    PointForce,
    Prismatic,
    RigidBody,
    RotationDriver,
    Scene,
    Terminal,
    Weld,
    assemble,
    equilibrium,
    gradient,
    load_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.laws import ConstantAcceleration
from ancfdae.model.elements import ALL_ELEMENTS
from ancfdae.observables import position, slope
from ancfdae.sections import Circle, Rectangle

STRIP = Rectangle(height=0.02, width=0.05)
SOFT = Material(density=1000.0, youngs_modulus=1e7, poisson_ratio=0.3)


def cable(n=2, **changes):
    arguments = {"start": (0.0, 0.0), "end": (1.0, 0.0), "section": STRIP, "material": SOFT}
    return Beam("rod", elements=n, **(arguments | {"element": CABLE_2D} | changes))


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize(("kind", "factor"), [(PointForce, 1 / 3), (Moment, 1 / 2)])
def test_cantilever_bends_as_in_beam_theory_without_any_locking(n, kind, factor):
    # Cubic deflections are exact, whatever the number of elements and Poisson's ratio.
    rod, F = cable(n), 1e-7
    load = kind(rod.at_end, (0.0, F) if kind is PointForce else F)
    found = equilibrium(Scene([rod], [Clamp(rod.at_start)], loads=[load]))
    tip = found.solution.position(rod.at_end)[0]
    # The force stiffens by F L / (E h w) = 1e-11; the stiffest direction is (L/h)^2 n^4 times
    # as stiff as the softest: 1e6 eps.
    bending = SOFT.youngs_modulus * STRIP.width * STRIP.height**3 / 12
    assert tip[1] == pytest.approx(factor * F / bending, rel=1e-8)
    assert abs(tip[0] - 1.0) <= 1e-12


def hanging(n, span=0.8):
    """Sag and horizontal pull of a thin cable of length and weight one between two supports."""
    a = brentq(lambda a: 2 * a * np.sinh(span / (2 * a)) - 1.0, 0.1, 10.0, xtol=1e-15)
    # The weight stretches it by 1e-6.
    thin = Rectangle(height=1e-5, width=1.0)
    rope = cable(n, section=thin, material=Material(1e5, 1e11, 0.3))
    ends = [Pin(rope.at_start, ground=(0.0, 0.0)), Pin(rope.at_end, ground=(span, 0.0))]
    # From a V: slack, and with a kink that no cable carries.
    half = np.abs(np.linspace(-1.0, 1.0, n + 1))
    place = np.stack([np.linspace(0.0, span, n + 1), 0.3 * (half - 1.0)], axis=1)
    tangent = np.stack([np.full(n + 1, 0.8), 0.6 * np.sign(np.linspace(-1.0, 1.0, n + 1))], axis=1)
    tangent[n // 2] = 1.0, 0.0
    start = NodalState("rod", np.stack([place, tangent], axis=1))
    found = equilibrium(Scene([rope], ends, (0.0, -1.0), start=[start]))
    assert found.outcome.success
    assert found.outcome.downhill
    middle = found.solution.position(rope.at(0.5))[0]
    return middle[1] + np.hypot(a, 0.5) - a, abs(found.lam[0]) - a


def test_hanging_cable_is_a_catenary():
    coarse, fine = (np.abs(hanging(n)) for n in (8, 16))
    # Bending carries E h^3/12 = 8e-6 of a pull of 0.3 over curvatures of up to 4: 1e-4 of the
    # pull; it smooths the ends and leaves the sag, where 6e-6 are left of the mesh.
    assert fine[0] <= 1e-5
    assert fine[1] <= 2e-4
    assert np.all(fine < coarse / 4)


def test_swinging_cable_has_the_exact_gradient_of_its_steps():
    rod = cable()
    scene = Scene([rod], [Pin(rod.at_start)], gravity=(0.0, -9.81))
    names = ["density", "youngs_modulus", "height", "width", "length", "damping_time"]
    design, tip = [f"rod.{name}" for name in names], Terminal(position(rod.at_end, 1))
    exact = gradient(scene, tip, 0.125, HHT(2**-8), design=design, method=ComplexStep()).gradient
    # One complex run against a linear pass of 32 steps, both at converged states.
    ours = gradient(scene, tip, 0.125, HHT(2**-8), design=design).gradient
    b = np.append(assemble(scene, design).b[:-1], 1e-3)  # Undamped.
    size = np.max(np.abs(exact * b))
    assert np.all(np.abs(ours - exact) * b < 1e-9 * size)
    # Of a wider one masses and forces grow alike.
    felt = [name for name, x in zip(names, exact * b, strict=True) if abs(x) > 1e-9 * size]
    assert felt == [name for name in names if name != "width"]


def test_saved_solution_knows_its_element(tmp_path):
    rod = cable()
    solution = simulate(Scene([rod], [Pin(rod.at_start)], gravity=(0.0, -9.81)), 0.125, HHT(2**-7))
    solution.save(tmp_path / "swing.npz")
    again = load_solution(tmp_path / "swing.npz")
    assert again.naming.layout.beams[0].element is CABLE_2D
    assert np.array_equal(again.nodes("rod"), solution.nodes("rod"))
    assert again.nodes("rod").shape == (len(solution.t), 3, 2, 2)


def test_names_of_elements_are_their_own():
    assert len({element.name for element in ALL_ELEMENTS}) == len(ALL_ELEMENTS)


def test_what_a_cable_does_not_have_is_refused_in_words():
    rod = cable()
    arc = (np.array([[0.0, 0.0], [1.0, 0.2]]), np.repeat(np.eye(2)[None], 2, axis=0))
    bow = CurvedBeam("bow", *arc, STRIP, SOFT, element=CABLE_2D)
    space = {"start": (0.0,) * 3, "end": (1.0, 0.0, 0.0)}
    wire = cable(**space, section=Circle(0.01), element=CABLE_3D)
    mast = Beam("mast", (1.0, 0.0, 0.0), (1.0, 0.0, 1.0), 1, STRIP, SOFT)
    for action, words in (
        (lambda: Scene([rod], loads=[FollowerForce(rod.at_end, (0.0, 1.0))]), "SLOPE_Y"),
        (lambda: Scene([rod], [Pin(rod.at(0.5, y=0.01))]), "no section"),
        (lambda: assemble(Scene([bow])), "straight"),
        (lambda: cable(**space), "3 dimensions"),
        (lambda: cable(**space, element=CABLE_3D), "about every axis"),
        (lambda: Scene([wire], [Weld(wire.at_end, mast.at_start)]), "SLOPE_Y"),
        (lambda: Scene([wire], loads=[Moment(wire.at_end, (0, 0, 1))]), "SLOPE_Y"),
        (
            lambda: Scene([wire], [RotationDriver(wire.at_start, ConstantAcceleration(1.0))]),
            "SLOPE_Y",
        ),
        (lambda: cable().with_length("x"), "rod.length"),
        (lambda: Beam("b", (0, 0), (1, 0), 1, STRIP, SOFT, element="cable"), "'cable'"),
        (lambda: slope(rod.at_end, 1, 0).check(assemble(Scene([rod]))), "SLOPE_Y"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            action()


# ---- a cable turns with its tangent: joints of sections


@pytest.mark.parametrize("angle", [np.pi / 3, np.pi / 2, -2.0])
def test_a_welded_frame_bends_as_by_castigliano(angle):
    """Cantilever and an arm at its end, force F across the first: v = dU/dF of linear theory."""
    F, c, s = 1e-6, np.cos(angle), np.sin(angle)
    first = cable(2)
    arm = cable(1, start=(1.0, 0.0), end=(1.0 + c, s))
    arm = dataclasses.replace(arm, name="arm")
    joints = [Clamp(first.at_start), Weld(first.at_end, arm.at_start)]
    found = equilibrium(Scene([first, arm], joints, loads=[PointForce(arm.at_end, (0.0, F))]))
    area = STRIP.width * STRIP.height
    bending, axial = (SOFT.youngs_modulus * x for x in (area * STRIP.height**2 / 12, area))
    # M = F (c + u) along the cantilever, F c u along the arm; N = F s in the arm.
    v = F / bending * (c**2 + c + 1 / 3 + c**2 / 3) + F * s**2 / axial
    # The solver's round-off is 1e6 eps, as above; products of displacements are 1e-5 of them.
    assert found.solution.position(arm.at_end)[0, 1] - s == pytest.approx(v, rel=3e-5)


def tangent_angle(solution, point):
    x, y = solution.slope(point).T
    return np.unwrap(np.arctan2(y, x))


def test_a_weld_keeps_its_angle_in_motion():
    """Two cables and a body, welded at 60 degrees each, bend and spin; the angles stay."""
    first = cable(2)
    arm = dataclasses.replace(cable(2, start=(1, 0), end=(1.5, np.sqrt(0.75))), name="arm")
    ball = RigidBody("ball", (1.5, np.sqrt(0.75)), mass=0.5, inertia=0.01, turn=0.4)
    joints = [
        Pin(first.at_start),
        Weld(first.at_end, arm.at_start),
        Weld(ball.at(0, 0), arm.at_end),
    ]
    scene = Scene([first, arm], joints, (0.0, -9.81), bodies=[ball])
    solution = simulate(scene, 0.25, HHT(2.0**-7))
    a, b, c = (tangent_angle(solution, x) for x in (first.at_end, arm.at_start, arm.at_end))
    assert np.ptp(a) > 0.05
    assert b - a == pytest.approx(np.full(len(a), np.pi / 3), abs=1e-9)
    assert tangent_angle(solution, ball.at(0, 0)) - c == pytest.approx(0.4 - np.pi / 3, abs=1e-9)


@pytest.mark.parametrize("carried", [False, True])
def test_a_cable_slides_without_turning_as_a_falling_point(carried):
    """x = g t^2 / 2 along the axis for every point: gravity has no part across it."""
    rod = cable(2, end=(0.6, 0.8))
    rail = RigidBody("rail", (0.0, 0.0), mass=1.0, inertia=1.0)
    fixed = [Clamp(rail.at(0, 0))] if carried else []
    slide = Prismatic(rod.at_start, (0.8, -0.6), rail.at(0, 0) if carried else None)
    bodies = [rail] if carried else []
    scene = Scene([rod], [*fixed, slide], (8.0, -6.0), bodies=bodies)
    solution = simulate(scene, 0.5, HHT(2.0**-5))
    fall = 10 * solution.t[:, None] ** 2 / 2 * (0.8, -0.6)
    for point, place in ((rod.at_start, (0.0, 0.0)), (rod.at_end, (0.6, 0.8))):
        assert solution.position(point) == pytest.approx(fall + place, abs=1e-9)


def test_a_drive_against_a_body_adds_its_angle():
    """A wheel turns at 3 rad/s, a stiff light cable against it at 2 rad/s, from 30 degrees on."""
    stiff = Material(density=1e-3, youngs_modulus=1e7, poisson_ratio=0.3)
    rod = cable(1, end=(np.cos(np.pi / 6), 0.5), material=stiff)
    wheel = RigidBody("wheel", (0.0, 0.0), mass=1.0, inertia=1.0)
    joints = [
        Pin(wheel.at(0, 0), ground=(0.0, 0.0)),
        RotationDriver(wheel.at(0, 0), ConstantAcceleration(3.0), name="axle"),
        Pin(rod.at_start, wheel.at(0, 0)),
        RotationDriver(rod.at_start, ConstantAcceleration(2.0), other=wheel.at(0, 0), name="elbow"),
    ]
    start = [InitialVelocity("wheel", 3.0, (0, 0)), InitialVelocity("rod", 5.0, (0, 0))]
    solution = simulate(Scene([rod], joints, bodies=[wheel], start=start), 1.0, HHT(2.0**-7))
    angle = np.pi / 6 + 5.0 * solution.t
    assert tangent_angle(solution, rod.at_start) == pytest.approx(angle, abs=1e-9)
    # The pull stretches it by rho w^2 L^2 / (2 E) = 1e-9; the start bends it by 1e-7 (measured).
    tip = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert solution.position(rod.at_end) == pytest.approx(tip, abs=1e-6)


def test_a_gradient_through_welded_cables_is_that_of_the_complex_step():
    first = cable(2)
    arm = dataclasses.replace(cable(1, start=(1, 0), end=(1.4, 0.3)), name="arm")
    scene = Scene([first, arm], [Pin(first.at_start), Weld(first.at_end, arm.at_start)], (0, -9.81))
    call = scene, Terminal(position(arm.at_end, 1)), 2.0**-3, HHT(2.0**-6)
    design = ["rod.height", "arm.length", "arm.turn"]
    exact = gradient(*call, design=design, method=ComplexStep()).gradient
    assert gradient(*call, design=design).gradient == pytest.approx(exact, rel=1e-8)
