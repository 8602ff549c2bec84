"""Neighbours searched again during a run: the same motion and derivatives as with all pairs."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    AdaptiveSteps,
    Adjoint,
    Clamp,
    InitialVelocity,
    Prismatic,
    Radau,
    RigidBody,
    Scene,
    SphereContacts,
    SpringDamper,
    Switch,
    Terminal,
    assemble,
    equilibrium,
    gradient,
    simulate,
)
from ancfdae.observables import elapsed_time, load_power, observe, position
from ancfdae.results import Verdict
from tests.support.contacts import agree
from tests.support.touching_lines import clash

LAW = {"restitution": 0.9, "impact_speed": 3.0}


def plough(reach=0.05, speed=5.0, count=6, away=0.0):
    """A heavy ball that flies through two rows of light ones, and touches each of them."""
    bodies = [
        RigidBody(
            f"b{k}",
            (away + 0.5 * k, away + (0.12 * (-1) ** k if k else 0.0)),
            mass=1.0 if k else 20.0,
            inertia=0.004,
        )
        for k in range(count)
    ]
    names, radii = [body.name for body in bodies], [0.1] * count
    touch = SphereContacts(names, radii, stiffness=1e5, reach=reach, name="touch", **LAW)
    start = [InitialVelocity("b0", 1.0, bodies[0].position, (speed, 0.0))]
    return Scene([], [], bodies=bodies, loads=[touch], start=start), bodies


def loop(reach=0.03):
    """A loop of a cable whose ends fly at each other."""
    scene, rope = clash(20)
    return replace(scene, loads=[replace(scene.loads[0], reach=reach)]), rope


def renewals(monkeypatch):
    """The numbers of pairs of the systems that are made during runs from now on."""
    from ancfdae.assembly.system import AncfSystem

    found, along = [], AncfSystem.along

    def noted(system, *args):
        other = along(system, *args)
        if other is not system:
            found.append(len(other.inputs.elements.pairs["touch"]))
        return other

    monkeypatch.setattr(AncfSystem, "along", noted)
    return found


@pytest.mark.parametrize("integrator", [HHT(5e-4), Radau(2e-3)])
@pytest.mark.parametrize(("make", "t_end"), [(plough, 0.6), (loop, 0.03)])
def test_a_run_with_renewed_neighbours_is_that_with_all_pairs(make, t_end, integrator, monkeypatch):
    whole, near = (simulate(make(reach)[0], t_end, integrator) for reach in (None, 0.05))
    assert whole.outcome.success
    assert near.outcome.success
    np.testing.assert_array_equal(near.t, whole.t)
    for name in ("q", "v", "a"):
        x, y = getattr(near, name), getattr(whole, name)
        np.testing.assert_allclose(x, y, rtol=0, atol=1e-9 * np.abs(y).max())
    assert near.statistics.steps == whole.statistics.steps
    # The lists are short, and made again where balls come near.
    found = renewals(monkeypatch)
    simulate(make(0.05)[0], t_end, integrator)
    if make is plough:
        assert len(found) >= 5
        assert min(found) == 1


@pytest.mark.parametrize("away", [0.0, 1e3])
@pytest.mark.parametrize("integrator", [Radau(rtol=1e-6), Radau(rtol=1e-7), HHT(rtol=1e-5)])
@pytest.mark.parametrize("reach", [0.01, 0.05])
def test_steps_under_error_control_are_those_with_all_pairs(integrator, away, reach):
    # Through the second collision; each of them multiplies round-off by a hundred. Steps that are
    # tried after the free flight reach over the first ball to the second one, and are rejected.
    runs = [simulate(plough(x, away=away)[0], 0.19, integrator) for x in (None, reach)]
    whole, near = runs
    assert near.outcome.success
    assert near.statistics.steps == whole.statistics.steps
    assert near.statistics.rejected == whole.statistics.rejected
    np.testing.assert_allclose(near.t, whole.t, rtol=0, atol=1e-6 if away else 1e-9)
    np.testing.assert_allclose(near.q, whole.q, rtol=0, atol=1e-5 if away else 1e-8)


def test_a_loop_has_the_steps_with_all_pairs():
    runs = [simulate(loop(reach)[0], 0.012, Radau(rtol=1e-5)) for reach in (None, 0.01)]
    whole, near = runs
    np.testing.assert_allclose(near.t, whole.t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(near.q, whole.q, rtol=0, atol=1e-10)


def test_long_free_flights_do_not_pass_over_pairs_out_of_reach():
    # Steps under error control are as long as the flight; the repeated steps are the same run.
    scene, _ = plough(0.01)
    run = simulate(scene, 0.6, Radau(rtol=1e-6))
    assert run.outcome.success
    for reach in (None, 1e-4):
        again = simulate(plough(reach)[0], 0.6, Radau(rtol=1e-6).frozen(run))
        np.testing.assert_allclose(again.q, run.q, rtol=0, atol=1e-12)


@pytest.mark.parametrize("make", [plough, loop])
def test_gradients_with_renewed_neighbours_are_exact(make):
    scene, _ = make()
    if make is plough:
        body = scene.bodies[3].origin
        objective, t_end, step = Terminal(position(body, 0) + position(body, 1)), 0.4, 5e-4
        design = [
            "touch.stiffness",
            "touch.restitution",
            "b1.position_y",
            "b2.mass",
            "touch.radius[3]",
        ]
    else:
        rope = scene.beams[0]
        objective, t_end, step = Terminal(position(rope.at(0.3), 2)), 0.012, 2.5e-4
        design = ["touch.stiffness", "touch.radius", "rope.length", "rope.youngs_modulus"]
    agree(scene, objective, t_end, design, [HHT(step)], difference=False)
    near = gradient(scene, objective, t_end, HHT(step), design=design)
    whole = gradient(make(None)[0], objective, t_end, HHT(step), design=design)
    np.testing.assert_allclose(near.gradient, whole.gradient, rtol=1e-8)


def test_a_run_goes_on_with_the_neighbours_of_its_end():
    scene, _ = plough()
    whole = simulate(scene, 0.6, HHT(5e-4))
    first = simulate(scene, 0.3, HHT(5e-4))
    run = simulate(scene, 0.6, HHT(5e-4), after=first)
    np.testing.assert_allclose(run.q, whole.q, rtol=0, atol=1e-10)


@pytest.mark.parametrize("reach", [None, 0.05])
def test_a_run_that_is_stopped_after_any_attempt_goes_on_as_the_whole_run(reach):
    # Three steps of the run are taken back and repeated with half their size.
    scene, t_end, tol = plough(reach)[0], 0.15, 1e-3
    whole = simulate(scene, t_end, Radau(rtol=tol))
    attempts = whole.statistics.steps + whole.statistics.rejected
    assert attempts > 30
    for most in range(1, attempts):
        first = simulate(scene, t_end, Radau(AdaptiveSteps(tol, max_steps=most)))
        assert first.outcome.verdict is Verdict.STEP_LIMIT
        run = simulate(scene, t_end, Radau(rtol=tol), after=first)
        np.testing.assert_allclose(run.t, whole.t, rtol=0, atol=1e-11)
        np.testing.assert_allclose(run.q, whole.q, rtol=0, atol=1e-10)


def test_a_step_that_is_tried_leaves_no_trace():
    # The first ball is tried from close to the third one, far back, and then meets it. The second
    # ball, next to the first one in the reference, is in the list.
    bodies = [
        RigidBody(x, (y, 0.0), mass=1.0, inertia=0.1)
        for x, y in zip("abc", (0, 0.5, 60.0), strict=True)
    ]
    touch = SphereContacts(list("abc"), [0.1] * 3, stiffness=1e5, reach=0.5, name="touch")
    system = assemble(Scene([], [], bodies=bodies, loads=[touch]))
    (pairs,), (q, v) = system.left_out(), system.start()

    def path(*places):
        t, rows = np.arange(2.0), np.repeat(q[None], 2, axis=0)
        rows[:, 0] = places
        speeds = np.repeat(v[None], 2, axis=0)
        speeds[:, 0] = places[1] - places[0]
        return t, rows, speeds

    assert pairs.tried(*path(59.0, 9.0)) is None  # Its length is 100 times the reach.
    assert pairs.tried(*path(59.0, 9.1)) is None
    met, _ = pairs.tried(*path(59.0, 60.2))
    assert met[0, 0] == pytest.approx(59.8, abs=1e-2)
    assert pairs.tried(*path(59.0, 9.1)) is None
    assert pairs.missed() is None
    pairs.follow(*path(59.0, 59.85))
    assert pairs.missed().time == pytest.approx(0.8 / 0.85, abs=1e-2)


def test_observables_of_a_load_have_all_pairs():
    works = []
    for reach in (None, 0.05):
        scene, _ = plough(reach)
        run, system = simulate(scene, 0.6, HHT(5e-4)), assemble(scene)
        works.append(observe(load_power("touch"), run, system))
    assert np.ptp(works[0]) > 0
    np.testing.assert_allclose(works[1], works[0], rtol=1e-8, atol=1e-8 * np.ptp(works[0]))


@pytest.mark.parametrize(
    ("integrator", "more"),
    [
        (HHT(5e-4), {"memory": "4 MB"}),
        (HHT(5e-4), {"method": Adjoint("60 kB")}),
        (Radau(2e-3), {"method": Adjoint("60 kB")}),
        (Radau(2e-3), {"events": [Switch(elapsed_time() - 0.2, to="start", name="switch")]}),
        (Radau(AdaptiveSteps(1e-6, sensitivities=True)), {}),
    ],
)
def test_runs_that_do_not_search_again_have_all_pairs(integrator, more):
    found = []
    for reach in (None, 0.05):
        scene, bodies = plough(reach)
        objective = Terminal(position(bodies[2].origin, 1))
        design = ["touch.restitution", "b1.mass"]
        found.append(gradient(scene, objective, 0.4, integrator, design=design, **more))
    whole, near = found
    assert near.value == pytest.approx(whole.value, rel=1e-9)
    np.testing.assert_allclose(near.gradient, whole.gradient, rtol=1e-7)


def test_other_integrators_end_where_a_pair_comes_close():
    run = simulate(plough()[0], 0.6, DOP853(1e-8))
    assert run.outcome.verdict in (Verdict.LEFT_OUT, Verdict.MISSED_CONTACT)
    assert "Raise `reach`" in str(run.outcome)
    # The second ball stands 1 m away, and the first one is thrown out of the way.
    assert run.outcome.time < 0.2


def test_equilibria_have_all_pairs():
    # A ball on a spring that presses on another one, out of reach in the reference.
    shapes = []
    for reach in (None, 1e-4):
        bodies = [
            RigidBody(x, (0, y), mass=1.0, inertia=0.1) for x, y in (("a", 0.201), ("b", 0.0))
        ]
        touch = SphereContacts(["a", "b"], [0.1, 0.1], stiffness=1e5, reach=reach, name="touch")
        third = RigidBody("c", (0.2005, 0.0), mass=1.0, inertia=0.1)
        touch = replace(touch, bodies=["a", "b", "c"], radii=[0.1] * 3)
        spring = SpringDamper(bodies[0].origin, ground=(0, 1.0), stiffness=1e3, free_length=0.799)
        joints = [Clamp(bodies[1].origin), Clamp(third.origin), Prismatic(bodies[0].origin, (0, 1))]
        scene = Scene([], joints, (0, -9.81), bodies=[*bodies, third], loads=[touch, spring])
        shapes.append(equilibrium(scene).solution.position(bodies[0].origin)[-1])
    np.testing.assert_allclose(shapes[1], shapes[0], rtol=1e-9)
    assert 0.19 < shapes[0][1] < 0.2  # pressed


def crowd(reach):
    """Sixteen balls of a square that fly apart and at each other."""
    rng = np.random.default_rng(1)
    places = 0.25 * np.stack(np.divmod(np.arange(16), 4), axis=1) + rng.uniform(
        -0.02, 0.02, (16, 2)
    )
    speeds = 3 * rng.normal(size=(16, 2))
    bodies = [RigidBody(f"b{k}", tuple(x), mass=1.0, inertia=0.004) for k, x in enumerate(places)]
    names = [body.name for body in bodies]
    touch = SphereContacts(names, [0.1] * 16, stiffness=1e5, reach=reach, name="touch", **LAW)
    start = [
        InitialVelocity(body.name, 0.0, body.position, tuple(v))
        for body, v in zip(bodies, speeds, strict=True)
    ]
    return Scene([], [], bodies=bodies, loads=[touch], start=start)


def test_a_reach_far_below_the_path_of_a_step_grows(monkeypatch):
    """Steps of 3 to 8 mm: with a reach of 1e-9 m parts of 1e-10 m were once searched."""
    from ancfdae.model.loads.pair_contact import SphereContacts as Load

    searched, within = [], Load.within

    def counted(load, places, reach):
        searched.append(reach)
        return within(load, places, reach)

    whole = simulate(crowd(None), 0.12, HHT(1e-3))
    monkeypatch.setattr(Load, "within", counted)
    for reach in (0.1, 1e-9):
        searched.clear()
        near = simulate(crowd(reach), 0.12, HHT(1e-3))
        assert near.outcome.success
        np.testing.assert_allclose(near.q, whole.q, rtol=0, atol=1e-9)
    # Once 18,700; a reach of 0.1 m searches 600 times, of 1 mm 4,400 times.
    assert len(searched) < 8000
