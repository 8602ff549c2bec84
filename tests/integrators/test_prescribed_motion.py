"""Prescribed motions against closed forms: circles, four-bars (two circles), minimal coordinates.

Position on a prescribed path is exact at instants, so that only a wrong root, or what lies between
instants, can be wrong.
"""

import numpy as np
import pytest
import scipy

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    AdaptiveSteps,
    Adjoint,
    Beam,
    DirectDifferentiation,
    Integral,
    Material,
    Pin,
    PointMass,
    PointOnLine,
    PrescribedSteps,
    Radau,
    Revolute,
    RotationDriver,
    Scene,
    TranslationDriver,
    assemble,
    gradient,
    simulate,
)
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.laws import ConstantAcceleration, Harmonic, RunUp
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.observables.observable import observe
from ancfdae.sensitivity.observables.quantities import driver_torque

STEEL = Material(density=7800.0, youngs_modulus=2e11, poisson_ratio=0.3)
SECTION = Rectangle(height=0.02, width=0.02)
# Crank, coupler, rocker and ground; the first turns round, the second locks.
TURNS, LOCKS = (0.1, 0.3, 0.25, 0.3), (0.25, 0.3, 0.2, 0.3)
FIRST = 0.5


def rod(law, d=2, gravity=0.0):
    z = (0.0,) * (d - 2)
    beam = Beam("rod", (0.0, 0.0, *z), (1.0, 0.0, *z), 1, SECTION, STEEL, rigid=True)
    holds = Pin(beam.at_start) if d == 2 else Revolute(beam.at_start, axis=(0, 0, 1))
    drive = RotationDriver(beam.at_start, law, name="motor")
    return beam, Scene([beam], [holds, drive], (0.0, gravity, *z), project_start=True)


def knee(lengths, angles):
    """Where coupler and rocker meet: the upper one of two circles' points; NaN where none is."""
    a, b, c, d = lengths
    A = a * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    r = np.array([d, 0.0]) - A
    L = np.sqrt(np.sum(r * r, axis=-1))
    u, x = r / L[..., None], (b * b - c * c + L * L) / (2 * L)
    with np.errstate(invalid="ignore"):
        h = np.sqrt(b * b - x * x)
    return A, A + x[..., None] * u + h[..., None] * np.stack([-u[..., 1], u[..., 0]], axis=-1)


def four_bar(lengths, law):
    A, B = (tuple(x) for x in knee(lengths, np.array(FIRST)))
    crank, coupler, rocker = (
        Beam(name, start, end, 1, SECTION, STEEL, rigid=True)
        for name, start, end in (
            ("crank", (0.0, 0.0), A),
            ("coupler", A, B),
            ("rocker", (lengths[3], 0.0), B),
        )
    )
    joints = [
        Pin(crank.at_start, name="bearing"),
        RotationDriver(crank.at_start, law, name="motor"),
        Pin(crank.at_end, coupler.at_start, name="elbow"),
        Pin(coupler.at_end, rocker.at_end, name="knee"),
        Pin(rocker.at_start, name="foot"),
    ]
    return rocker, Scene([crank, coupler, rocker], joints, project_start=True)


def locking_time(rate):
    """The crank's angle at which crank end and foot are b + c apart (or b - c), by cosines."""
    a, b, c, d = LOCKS
    return (np.arccos((a * a + d * d - (b + c) ** 2) / (2 * a * d)) - FIRST) / rate


@pytest.mark.parametrize("rate", [4.0, 40.0])
@pytest.mark.parametrize("rtol", [1e-2, 1e-3, 1e-8])
def test_a_driven_rod_is_on_its_circle_between_instants_too(rate, rtol):
    """Two turns at the higher rate; once it took as many steps whatever rtol, half a turn off."""
    beam, scene = rod(ConstantAcceleration(rate))
    end = min(1.0, 12.0 / rate)
    run = simulate(scene, end, Radau(rtol=rtol))
    t = np.linspace(0.0, end, 999)
    tip = run.at(t).position(beam.at_end)
    exact = np.stack([np.cos(rate * t), np.sin(rate * t)], axis=1)
    # The estimate per step is 0.05 rtol^(4/5), of the embedded formula of order 3; the cubic
    # between instants is of its order and measured within its double.
    assert np.max(np.abs(tip - exact)) <= 0.1 * rtol**0.8
    assert run.statistics.steps >= rate * end  # at most a radian in a step


@pytest.mark.parametrize(("d", "t_end"), [(2, 0.5), (3, 0.25)])
def test_integrals_over_a_prescribed_swing_and_their_gradient(d, t_end):
    """Integral of sin^2(sin w t): quadrature of the closed form, once 0.42110 for 0.38621."""
    beam, scene = rod(Harmonic(1.0, 60.0), d)

    def swing(t, w=60.0):
        return np.sin(np.sin(w * t)) ** 2

    def by_rate(t):
        return np.sin(2 * np.sin(60 * t)) * np.cos(60 * t) * t

    value, slope = (scipy.integrate.quad(f, 0, t_end, limit=400)[0] for f in (swing, by_rate))
    objective, design = Integral(position(beam.at_end, 1) ** 2), ["motor.frequency"]
    integrator = Radau(rtol=1e-4)
    run = gradient(scene, objective, t_end, integrator, design=design, method=Adjoint())
    # The sum over 60/2pi periods of errors of order five, each below the tolerance.
    assert run.value == pytest.approx(value, rel=1e-4)
    assert run.gradient[0] == pytest.approx(slope, abs=1e-4)
    direct = gradient(
        scene, objective, t_end, integrator, design=design, method=DirectDifferentiation()
    )
    assert run.gradient[0] == pytest.approx(direct.gradient[0], rel=1e-11)


def test_a_prescribed_travel_is_in_the_estimate():
    """A guide has no angle: the integral of sin^2(60 t) is 1/2 - sin(120)/240."""
    beam = Beam("rod", (0.0, 0.0), (0.1, 0.0), 1, SECTION, STEEL, rigid=True)
    joints = [
        TranslationDriver(beam.at_start, (1, 0), Harmonic(1.0, 60.0), name="shaker"),
        PointOnLine(beam.at_start, (1, 0)),
        PointOnLine(beam.at_end, (1, 0)),
    ]
    scene = Scene([beam], joints, project_start=True)
    objective = Integral(position(beam.at_start, 0) ** 2)
    run = gradient(scene, objective, 1.0, Radau(rtol=1e-4), design=["shaker.amplitude"])
    assert run.value == pytest.approx(0.5 - np.sin(120.0) / 240, rel=1e-4)
    assert run.gradient[0] == pytest.approx(2 * run.value, rel=1e-12)  # quadratic


def test_a_four_bar_with_its_torque():
    """Coupler and rocker by two circles, torque by d(kinetic energy)/dt over the crank's rate."""
    law = RunUp(40.0, 0.05)
    rocker, scene = four_bar(TURNS, law)
    run, system = simulate(scene, 0.5, Radau(rtol=1e-4)), assemble(scene)
    p = np.array([law.rate, law.duration, law.initial, law.begin])
    angle, rate, growth = (law.derivative(p, run.t, k) for k in range(3))
    # At instants positions are those of the joints: round-off of lengths of 0.3 m.
    assert np.max(np.abs(run.position(rocker.at_end) - knee(TURNS, FIRST + angle)[1])) <= 1e-13

    def inertia(angle):
        """Twice the kinetic energy at one rad/s of uniform bars whose ends move by u and w.

        m (|u|^2 + u . w + |w|^2)/3 of the axis, m (height^2/12) |w - u|^2/l^2 of the sections.
        """
        h = 1e-3  # the sixth-order difference leaves (h / 0.1)^6 = 1e-12
        shares = ((1, 0.75), (2, -0.15), (3, 1 / 60))
        A_B = [
            sum(s * (end(angle + k * h) - end(angle - k * h)) for k, s in shares) / h
            for end in (lambda x: knee(TURNS, FIRST + x)[0], lambda x: knee(TURNS, FIRST + x)[1])
        ]
        A, B, none = *A_B, np.zeros_like(A_B[0])
        mass, flat = STEEL.density * SECTION.height * SECTION.width, SECTION.height**2 / 12
        bars = zip(TURNS[:3], ((none, A), (A, B), (none, B)), strict=True)
        squares = (l * (u * u + u * w + w * w) / 3 + flat * (w - u) ** 2 / l for l, (u, w) in bars)
        return mass * sum(np.sum(x, axis=-1) for x in squares)

    h = 1e-3
    slope = (inertia(angle + h) - inertia(angle - h)) / (2 * h)
    torque = inertia(angle) * growth + slope * rate**2 / 2
    found = observe(driver_torque("motor"), run, system)
    # Differences of the inertia: h^2/6 of its third derivative, measured 2e-5.
    assert np.max(np.abs(found - torque)) <= 1e-4 * np.max(np.abs(torque))


STEADY = [
    Radau(rtol=1e-2),
    Radau(rtol=1e-6),
    Radau(step=0.01),
    Radau(step=0.05),
    HHT(0.002),
    HHT(0.01),
    HHT(0.05),
    HHT(rtol=1e-2),
    IDA(1e-3),
    DOP853(1e-4),
]


@pytest.mark.filterwarnings("ignore::ancfdae.errors.ManyStepsWarning")
@pytest.mark.parametrize(
    ("integrator", "end"),
    [(x, end) for x in STEADY for end in ((0.2, 0.9) if isinstance(x, Radau) else (0.9,))],
)
def test_a_linkage_that_locks_stops_in_words(integrator, end):
    """At the angle of the cosine law; behind a gap the joints would close again."""
    rocker, scene = four_bar(LOCKS, ConstantAcceleration(20.0))
    run, at = simulate(scene, end, integrator), locking_time(20.0)
    assert not run.outcome.success
    assert run.t[-1] <= at * (1 + 1e-9)
    # IDA follows velocities that grow without bound; the others end on the circles.
    exact = knee(LOCKS, FIRST + 20.0 * run.t)[1]
    error = np.max(np.abs(run.position(rocker.at_end) - exact))
    assert error <= (1e-3 if isinstance(integrator, IDA) else 1e-9)
    if run.outcome.verdict is not Verdict.OFF_ROOT:
        assert f"joints lock at t = {at:.6g}: they cannot be closed" in str(run.outcome)


@pytest.mark.parametrize(
    ("integrator", "stands"), [(HHT(1.0), "t = 1"), (Radau(step=1.0), "t = 0.155")], ids=repr
)
def test_half_a_turn_off_is_no_success(integrator, stands):
    """Steps of four and forty radians."""
    rate = 4.0 if isinstance(integrator, HHT) else 40.0
    _, scene = rod(ConstantAcceleration(rate))
    run = simulate(scene, 1.0, integrator)
    assert run.outcome.verdict is Verdict.OFF_ROOT
    text = str(run.outcome)
    assert "'motor'" in text
    assert stands in text
    assert f"{1 / rate:.2g} s or less" in text


@pytest.mark.parametrize(("d", "other"), [(2, False), (3, True)])
def test_a_wrong_root_within_a_packet_of_steps_is_found_at_its_step(d, other):
    """A drive that speeds up, in space and against another body too: what is kept is right."""
    z = (0.0,) * (d - 2)
    arm = Beam("arm", (0.0, 0.0, *z), (1.0, 0.0, *z), 1, SECTION, STEEL, rigid=True)
    base = Beam("base", (0.0, 0.0, *z), (-1.0, 0.0, *z), 1, SECTION, STEEL, rigid=True)

    def hold(point, **other):
        return Pin(point, **other) if d == 2 else Revolute(point, axis=(0, 0, 1), **other)

    law = ConstantAcceleration(1.0, acceleration=40.0)
    bodies, carrier = [arm], {"other": base.at_start} if other else {}
    joints = [
        hold(arm.at_start, **carrier),
        RotationDriver(arm.at_start, law, name="motor", **carrier),
    ]
    if other:
        # The base turns by a drive of its own, at a steady rate.
        bodies.append(base)
        joints += [
            hold(base.at_start),
            RotationDriver(base.at_start, ConstantAcceleration(0.5), name="base drive"),
        ]
    # Steps turn by half a turn at 1.55 s.
    run = simulate(Scene(bodies, joints, project_start=True), 1.8, HHT(0.05))
    angle = run.t + 20.0 * run.t**2 + (0.5 * run.t if other else 0.0)
    tip = run.position(arm.at_end)[:, :2]
    assert run.outcome.verdict is not Verdict.FINISHED
    assert len(run.t) > 3
    assert np.max(np.abs(tip - np.stack([np.cos(angle), np.sin(angle)], axis=1))) <= 1e-9


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
@pytest.mark.parametrize("step", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("method", [HHT, Radau])
def test_success_of_a_four_bar_is_its_own_branch(method, step):
    """Linkages at random, up to one radian a step: the crossed branch is never a success."""
    random, ends = np.random.default_rng(5), []
    while len(ends) < 8:
        lengths = tuple(random.uniform(0.1, 0.4, 4))
        if np.any(np.isnan(knee(lengths, FIRST + np.linspace(0, 2 * np.pi, 721))[1])):
            continue
        rocker, scene = four_bar(lengths, ConstantAcceleration(10.0))
        run = simulate(scene, 1.0, method(step=step))
        exact = knee(lengths, FIRST + 10.0 * run.t)[1]
        assert np.max(np.abs(run.position(rocker.at_end) - exact)) <= 1e-9
        ends.append(run.outcome.success)
    # Without the check all end, and half of them on the other branch at the longer steps.
    assert any(ends)


@pytest.mark.parametrize("kind", [IDA, DOP853])
def test_high_order_checks_the_root_too(kind, monkeypatch):
    """No step of theirs leaves a root; the system says so here."""
    _, scene = rod(ConstantAcceleration(4.0))
    system = assemble(scene)

    def late(self, t, q):
        (k,) = np.nonzero(t > 0.5)
        return (int(k[0]), "motor") if len(k) else None

    monkeypatch.setattr(type(system), "off_root", late)
    run = simulate(scene, 1.0, kind(1e-4))
    assert run.outcome.verdict is Verdict.OFF_ROOT
    assert 0.48 < run.t[-1] <= 0.5


def test_controlled_steps_that_leave_the_root_are_shortened_up_to_where_they_leave_it(monkeypatch):
    """A crank with a free pendulum, on a root that ends at 0.5 s: the system says so here.

    Steps of the core, taken in packets, are 2 ms long there. Unless each is looked at, the run ends
    at the last one before 0.5 s; else shorter ones lead up to it.
    """
    arm, _ = rod(ConstantAcceleration(4.0))
    pendulum = Beam("pendulum", (1.0, 0.0), (1.0, -0.5), 1, SECTION, STEEL, rigid=True)
    joints = [
        Pin(arm.at_start),
        RotationDriver(arm.at_start, ConstantAcceleration(4.0), name="motor"),
        Pin(pendulum.at_start, arm.at_end),
    ]
    scene = Scene([arm, pendulum], joints, (0, -9.81), project_start=True)
    assert simulate(scene, 1.0, HHT(rtol=1e-4)).statistics.rejected == 0

    def late(self, t, q):
        (k,) = np.nonzero(t > 0.5)
        return (int(k[0]), "motor") if len(k) else None

    monkeypatch.setattr(type(assemble(scene)), "off_root", late)
    run = simulate(scene, 1.0, HHT(rtol=1e-4))
    assert run.outcome.verdict is Verdict.OFF_ROOT
    assert 0.5 - 1e-6 < run.t[-1] <= 0.5
    assert run.statistics.rejected > 0


@pytest.mark.parametrize("integrator", [Radau(rtol=1e-2), HHT(rtol=1e-2)], ids=repr)
def test_controlled_steps_turn_by_less_than_a_radian(integrator):
    """Whatever the tolerance: atol takes all of the estimate."""
    loose = type(integrator)(AdaptiveSteps(1e-2, atol=1e6))
    _, scene = rod(ConstantAcceleration(4.0))
    run = simulate(scene, 1.0, loose)
    assert np.max(np.diff(run.t[:: loose.degree])) <= 0.25


def slider_crank(law=RunUp(60.0, 0.05)):  # noqa: B008  # frozen
    nylon = Material(density=1150, youngs_modulus=2.5e9, poisson_ratio=0.4, damping_time=1e-4)
    crank = Beam("crank", (0, 0), (0.15, 0), 1, Rectangle(0.03, 0.02), nylon, rigid=True)
    bar = Beam("rod", crank.at_end, (0.4, 0), 4, Rectangle(0.012, 0.01), nylon)
    joints = [
        Pin(crank.at_start),
        RotationDriver(crank.at_start, law, name="motor"),
        Pin(crank.at_end, bar.at_start),
        PointOnLine(bar.at_end, direction=(1, 0)),
    ]
    mass = PointMass(bar.at_end, 0.1, name="slider")
    return Scene([crank, bar], joints, bodies=[mass], assemble=True)


@pytest.mark.parametrize("atol", [None, 1e-16])
def test_a_start_from_rest_without_forces_does_not_shrink_the_step(atol):
    """A start without any size, and an atol that gives none: round-off is no error to control.

    Once 1,500 steps of 5e-10 s, from where the crank had turned by sqrt(eps).
    """
    run = simulate(slider_crank(), 0.02, Radau(AdaptiveSteps(1e-5, atol=atol, max_steps=400)))
    assert run.outcome.success


@pytest.mark.parametrize(("duration", "t_end"), [(0.1, 0.3), (0.02, 0.3)])
def test_a_step_whose_velocities_miss_what_is_prescribed_is_repeated(duration, t_end):
    """The first step of a run-up is long, and what it leaves disturbs any step after it alike.

    Once "no step, however small, passed the error test" behind t = 0.05.
    """
    law = RunUp(40.0, duration, initial=0.2, begin=0.05)
    scene = slider_crank(law)
    run = simulate(scene, t_end, HHT(rtol=1e-4))
    assert run.outcome.success
    assert run.statistics.rejected < 0.1 * run.statistics.steps
    slider = run.position(scene.beams[1].at_end)[:, 0]
    angle = law.at(run.t)
    rigid = 0.15 * np.cos(angle) + np.sqrt(0.4**2 - (0.15 * np.sin(angle)) ** 2)
    # The rod is elastic: an independent method follows its bending.
    same = simulate(scene, t_end, Radau(PrescribedSteps(tuple(run.t.tolist()))))
    assert np.max(np.abs(slider - same.position(scene.beams[1].at_end)[::3, 0])) < 10 * 1e-4 * 0.4
    assert np.max(np.abs(slider - rigid)) < 5e-3
    # The same steps give the same run: what was taken back has left nothing.
    again = simulate(scene, t_end, HHT(PrescribedSteps(tuple(run.t.tolist()))))
    np.testing.assert_allclose(again.q, run.q, atol=1e-7)


def test_forces_that_are_round_off_give_no_scale():
    """At rest without loads speeds are sized by the run: position / t_end."""
    scales = InitialValueProblem.of(assemble(slider_crank()), 0.21).scales
    assert scales.speed == pytest.approx(scales.position / 0.21)
