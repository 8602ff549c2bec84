"""Runs that pass the check of contacts are right, and right runs pass, by every kind of call."""

import dataclasses
import re

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    Contact,
    EndEvent,
    InitialVelocity,
    Plane,
    Radau,
    RigidBody,
    Scene,
    SphereContacts,
    Terminal,
    assemble,
    differentiate,
    gradient,
    record_observables,
    simulate,
    taylor_test,
)
from ancfdae.extend import Integrator
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sensitivity.method import UnfinishedRunError

# Durations of undamped free impacts of the exponents m, over (largest depth) / (speed).
LASTS = {1.0: np.pi, 1.5: 2.9432, 2.0: 2.8044, 3.0: 2.622}


def ball(name, at, mass=1.0):
    return RigidBody(name, at, mass=mass, inertia=0.1 * mass)


def flying(body, velocity):
    return InitialVelocity(body.name, 0.0, (0.0, 0.0), velocity=velocity)


def impact(exponent, restitution, far):
    """A point of 1 kg that meets a plane at 1 m/s, from a distance; and how long it touches."""
    body, k = ball("ball", (0.0, far)), 1e6
    law = {"restitution": restitution, "impact_speed": 1.0} if restitution < 1 else {}
    floor = Contact(
        body.at(0, 0), Plane((0, 0), (0, 1)), stiffness=k, exponent=exponent, name="floor", **law
    )
    depth = ((exponent + 1) / 2 / k) ** (1 / (exponent + 1))
    start = [flying(body, (0.0, -1.0))]
    return Scene([], [], (0, 0), bodies=[body], loads=[floor], start=start), LASTS[exponent] * depth


@pytest.mark.parametrize("restitution", [1.0, 0.6, 0.3])
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize(
    ("kind", "counts"), [(HHT, np.linspace(4, 16, 5)), (Radau, np.linspace(1, 6, 5))]
)
def test_what_passes_has_the_speed_of_a_free_impact(kind, counts, exponent, restitution):
    # It leaves at the speed e v (Hunt & Crossley 1975), whatever the exponent.
    _, lasts = impact(exponent, restitution, 1.0)
    passed = np.zeros(len(counts))
    for number, count in enumerate(counts):
        h = lasts / count
        for phase in np.arange(5) / 5:
            scene, _ = impact(exponent, restitution, (2 + phase) * h)
            run = simulate(scene, (np.ceil(2 * count) + 6) * h, kind(h))
            if run.outcome.success:
                passed[number] += 1
                assert run.v[-1, 1] == pytest.approx(restitution, rel=0.05)
    # Two steps of Radau, or five of HHT, are too few; six, or sixteen, are enough.
    assert not passed[0]
    assert passed[-1] == 5


def drop():
    """A ball that falls to a floor at 0.42 s, and stays there for 11 ms."""
    body = ball("ball", (0.0, 1.0))
    floor = Contact(
        body.at(0, 0),
        Plane((0, 0), (0, 1)),
        stiffness=1e5,
        radius=0.1,
        restitution=0.5,
        impact_speed=3.0,
        name="floor",
    )
    return Scene([], [], (0, -10.0), bodies=[body], loads=[floor]), position(body.at(0, 0), 1)


LONG = HHT(0.02)
FINE = [0.98994, 0.159655]


def test_no_kind_of_run_returns_a_number_for_a_contact_that_it_misses():
    scene, height = drop()
    end, design = Terminal(height), ["floor.radius"]
    calls = [
        lambda: gradient(scene, end, 0.6, LONG, design=design),
        lambda: gradient(scene, end, 0.6, LONG, design=[*design, "t_end"]),
        lambda: gradient(scene, end, 0.6, LONG, design=design, memory="10 MB"),
        lambda: gradient(scene, end, 0.6, LONG, design=design, method=Adjoint("4 kB")),
        lambda: gradient(scene, end, 0.6, LONG, design=design, events=[EndEvent(height - 5)]),
        lambda: gradient(scene, end, 0.6, LONG, design=design, after=simulate(scene, 0.42, LONG)),
        lambda: taylor_test(scene, end, 0.6, LONG, design=design),
    ]
    for call in calls:
        with pytest.raises(UnfinishedRunError, match="do not resolve a contact"):
            call()
    runs = [
        simulate(scene, 0.6, LONG),
        simulate(scene, 0.6, LONG, keep=5),
        simulate(scene, 0.6, LONG, keep=[0.3, 0.6]),
        # The border of the runs, and of packets, lies in the contact or before it.
        *(simulate(scene, 0.6, LONG, after=simulate(scene, t, LONG)) for t in (0.3, 0.42, 0.44)),
        simulate(scene, 0.6, LONG, events=[EndEvent(height - 5)]),
        differentiate(scene, 0.6, LONG, design=design),
        record_observables(scene, [height], 0.6, LONG, keep=[0.3, 0.6]),
    ]
    for run in runs:
        assert run.outcome.verdict is Verdict.MISSED_CONTACT
        assert run.outcome.time == pytest.approx(0.42)
        assert "'floor' with 'ball' from t = 0.42 s" in str(run.outcome)


def test_a_contact_across_the_border_of_parts_is_judged_as_a_whole():
    scene, height = drop()
    end, call = Terminal(height), (0.6, HHT(1e-3))
    whole = gradient(scene, end, *call, design=["floor.radius"])
    # Parts of some ten steps: the contact of eleven lies in two of them at least.
    parts = gradient(scene, end, *call, design=["floor.radius"], method=Adjoint("8 kB"))
    assert parts.gradient == pytest.approx(whole.gradient, rel=1e-10)
    split = simulate(scene, 0.6, HHT(1e-3), after=simulate(scene, 0.425, HHT(1e-3)))
    assert split.outcome.success


@pytest.mark.parametrize("integrator", [DOP853(1e-8), IDA(1e-8)])
def test_few_output_times_do_not_make_a_right_gradient_refused(integrator):
    scene, height = drop()
    found = gradient(scene, Terminal(height), 0.6, integrator, design=["floor.radius", "t_end"])
    # By HHT(2e-5), whose error in the step is 3e-4.
    assert found.gradient == pytest.approx(FINE, rel=2e-3)
    assert gradient(
        scene, Terminal(height), 0.6, integrator, design=["floor.radius"]
    ).gradient == pytest.approx(found.gradient[:1], rel=1e-4)


@pytest.mark.parametrize("ratio", [1.0, 1e3, 1e5])
@pytest.mark.parametrize("touching", [False, True])
def test_a_light_ball_is_judged_beside_a_heavy_one(ratio, touching):
    # The heavy one falls on a soft floor, or lies on it; the light one meets a wall in one step.
    heavy, light = ball("heavy", (0.0, 0.1 if touching else 1.0), ratio), ball("light", (5.0, 1.0))
    floor = Contact(
        heavy.at(0, 0), Plane((0, 0), (0, 1)), stiffness=300 * ratio, radius=0.1, name="floor"
    )
    wall = Contact(light.at(0, 0), Plane((6, 0), (-1, 0)), stiffness=1e9, radius=0.02, name="wall")
    start = [flying(light, (10.0, 0.0))]
    scene = Scene([], [], (0, -9.81), bodies=[heavy, light], loads=[floor, wall], start=start)
    run = simulate(scene, 0.6, HHT(0.005))
    assert run.outcome.verdict is Verdict.MISSED_CONTACT
    assert "'wall' with 'light'" in str(run.outcome)
    assert simulate(
        Scene([], [], (0, -9.81), bodies=[heavy, light], loads=[floor]), 0.6, HHT(0.005)
    ).outcome.success


@pytest.mark.parametrize("speed", [10.0, 1e3, 1e5])
@pytest.mark.parametrize("moving", [0.0, 50.0])
def test_no_ball_is_too_small_or_too_fast_to_be_seen(speed, moving):
    # Two balls of 1 mm meet at x = 0.731 m; both move with the same velocity beside that.
    pair = ball("a", (0.0, 0.0)), ball("b", (0.733, 0.0005))
    touch = SphereContacts(["a", "b"], [1e-3, 1e-3], stiffness=1e9 * speed**2, name="pair")
    start = [flying(pair[0], (speed, moving)), flying(pair[1], (0.0, moving))]
    scene = Scene([], [], (0, 0), bodies=pair, loads=[touch], start=start)
    for integrator in (HHT(0.3 / speed), Radau(0.3 / speed)):
        run = simulate(scene, 1.2 / speed, integrator)
        assert run.outcome.verdict is Verdict.MISSED_CONTACT
        assert run.outcome.time == pytest.approx(0.731 / speed, rel=1e-3)
    # They pass each other at a distance of 0.1 mm.
    passing = Scene(
        [], [], (0, 0), bodies=[pair[0], ball("b", (0.733, 0.0021))], loads=[touch], start=start
    )
    assert simulate(passing, 1.2 / speed, HHT(0.3 / speed)).outcome.success


def test_the_bound_of_the_rate_of_a_depth_holds_on_the_path():
    # An obstacle on a body that turns fast: random states of steps, depths at a hundred places.
    rng = np.random.default_rng(5)
    carrier, body = ball("carrier", (0.3, 0.2)), ball("ball", (1.0, 0.4))
    touch = Contact(
        body.at(0.2, 0.1),
        Plane((1.5, 0.0), (-1.0, 0.3)),
        stiffness=1.0,
        radius=0.1,
        other=carrier.at(0.1, 0.0),
        friction=0.2,
        slip_speed=0.1,
    )
    system = assemble(Scene([], [], (0, 0), bodies=[carrier, body], loads=[touch]))
    (load,) = system._loads.touching
    item = load.item
    for _ in range(40):
        angles, rates = rng.normal(size=2), 3 * rng.normal(size=2)

        u = rng.normal(size=(2, 2))

        def state(t, angles=angles, rates=rates, u=u):
            rows = []
            for k in range(2):
                phi = angles[k] + rates[k] * t
                c, s = np.cos(phi), np.sin(phi)
                rows.append([*(u[k] * (1 + t + t * t)), c, s, -s, c])
            return np.concatenate(rows)

        h, e = 0.3, 1e-6
        q = np.array([state(0.0), state(h)])
        v = np.array([(state(x + e) - state(x - e)) / (2 * e) for x in (0.0, h)])
        U, V = (item.by_copies(item.vectors.of(x)) for x in (q, v))
        signals = item.signals_of_copies(np.zeros(1))
        M = np.stack([h * V[:1], 3 * np.diff(U, axis=0) - h * (V[:1] + V[1:]), h * V[1:]])
        bound = item.closing(U[:1], M, signals)[0, 0]
        s = np.linspace(0, 1, 101)[:, None]
        bend, twist = (
            3 * (q[1] - q[0]) - h * (2 * v[0] + v[1]),
            h * (v[0] + v[1]) - 2 * (q[1] - q[0]),
        )
        path = q[0] + s * (h * v[0] + s * (bend + s * twist))
        depth = item.depth(item.by_copies(item.vectors.of(path)), np.repeat(signals, 101, 0))[:, 0]
        assert np.abs(np.diff(depth)).max() * 100 <= bound * (1 + 1e-9)
        assert bound < 30 * np.abs(np.diff(depth)).max() * 100 + 1e-9


@pytest.mark.parametrize("speed", [10.0, 1e3])
@pytest.mark.parametrize("integrator", [HHT(rtol=1e-5), Radau(rtol=1e-6)])
def test_error_control_shortens_steps_that_would_pass_over_a_contact(integrator, speed):
    # Undamped, equal masses: the first ball stops, and the other one flies on at its speed.
    pair = ball("a", (0.0, 0.0)), ball("b", (1.03, 0.0))
    touch = SphereContacts(["a", "b"], [0.1, 0.1], stiffness=1e7 * speed**2, name="pair")
    start = [flying(pair[0], (speed, 0.0))]
    scene = Scene([], [], (0, 0), bodies=pair, loads=[touch], start=start)
    run = simulate(scene, 1.0 / speed, integrator)
    assert run.outcome.success
    speeds = run.v[-1].reshape(2, 3, 2)[:, 0, 0] / speed
    np.testing.assert_allclose(speeds, [0.0, 1.0], atol=2e-3)


def test_a_stop_that_a_message_names_lets_a_long_step_see_a_contact():
    # A small ball meets another one in free flight, which takes DOP853 a step or two.
    pair = ball("a", (0.0, 0.0)), ball("b", (0.7313, 0.0))
    touch = SphereContacts(["a", "b"], [1e-3, 1e-3], stiffness=1e12, name="pair")
    start = [flying(pair[0], (10.0, 0.0))]
    scene = Scene([], [], (0, 0), bodies=pair, loads=[touch], start=start)
    run = simulate(scene, 0.1, DOP853(1e-8))
    assert run.outcome.verdict is Verdict.MISSED_CONTACT
    stop = float(re.search(r"stops=\((\S+),\)", str(run.outcome))[1])
    again = simulate(scene, 0.1, DOP853(1e-8, stops=(stop,)))
    assert again.outcome.success
    speeds = again.v[-1].reshape(2, 3, 2)[:, 0, 0]
    np.testing.assert_allclose(speeds, [0.0, 10.0], atol=1e-4)


class Own(Integrator):
    """An integrator from outside the package, which knows nothing of contacts."""

    def refined(self, solution):
        return self

    def integrate(self, system, t_end, *, sensitivities=False, progress=False):
        run = LONG.integrate(system, t_end, sensitivities=sensitivities, progress=progress)
        outcome = dataclasses.replace(run.outcome, verdict=Verdict.FINISHED, advice="")
        return dataclasses.replace(run, outcome=outcome)


def test_runs_of_an_integrator_of_ones_own_are_checked():
    scene, height = drop()
    assert simulate(scene, 0.6, Own()).outcome.verdict is Verdict.MISSED_CONTACT
    with pytest.raises(UnfinishedRunError, match="do not resolve a contact"):
        gradient(scene, Terminal(height), 0.6, Own(), design=["floor.radius"])


def test_a_path_that_is_fast_between_its_ends_is_followed():
    # At rest at both ends of a step of 1 s, and at 1.5 m/s in the middle, through a small ball.
    pair = ball("a", (0.0, 0.0)), ball("b", (0.37, 0.0))
    touch = SphereContacts(["a", "b"], [1e-3, 1e-3], stiffness=1e6, name="pair")
    system = assemble(Scene([], [], (0, 0), bodies=pair, loads=[touch]))
    q, _ = system.start()
    later = q.copy()
    later[0] += 1.0
    for end, missed in ((later, True), (q, False)):
        contacts = system.contacts()
        contacts.follow(np.array([0.0, 1.0]), np.array([q, end]), np.zeros((2, len(q))))
        assert (contacts.missed() is not None) == missed
    # 3 s^2 - 2 s^3 = 0.368 at the begin of the contact.
    first = system.contacts()
    first.follow(np.array([0.0, 1.0]), np.array([q, later]), np.zeros((2, len(q))))
    s = first.missed().time
    assert 3 * s**2 - 2 * s**3 == pytest.approx(0.368, abs=1e-9)
