"""Motions that start from an equilibrium: at rest, released, and with its derivatives."""

import warnings

import numpy as np
import pytest

from ancfdae import (
    HHT,
    IDA,
    AdaptiveSteps,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    ContinuousAdjoint,
    DesignVariable,
    DirectDifferentiation,
    EquilibriumStart,
    FiniteDifference,
    InitialVelocity,
    Integral,
    Material,
    NodalState,
    Pin,
    PointForce,
    RotationDriver,
    Scene,
    SpringDamper,
    Terminal,
    assemble,
    differentiate,
    equilibrium,
    gradient,
    simulate,
    taylor_test,
)
from ancfdae.errors import FreeMotionError, InvalidInputError, NoEquilibriumError, StabilityWarning
from ancfdae.laws import Harmonic
from ancfdae.model.bodies import Quantity
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from ancfdae.statics import equilibrium as rest

GRAVITY = (0.0, -9.81)
ROD = Beam("rod", (0.0, 0.0), (1.0, 0.0), 3, Rectangle(0.05, 0.05), Material(1000.0, 1e7, 0.3))
PULL = PointForce(ROD.at_end, (2.0, 20.0), name="pull")
BIAS = PointForce(ROD.at(0.5), (0.0, 3.0), name="bias")
DESIGN = ["rod.youngs_modulus", "rod.height", "rod.length", "rod.density"]
TIP = Integral(position(ROD.at_end, 1) ** 2) + Terminal(position(ROD.at_end, 0))


def released():
    """Pulled by one load, biased by another that stays, and let go."""
    rest = EquilibriumStart(loads=[BIAS, PULL], gravity=(0.0, 0.0))
    clamp = Clamp(ROD.at_start, name="wall")
    return Scene([ROD], [clamp], GRAVITY, start=[rest], loads=[BIAS])


def hung():
    """Hangs by a pin and a spring, and is pushed from the start on."""
    spring = SpringDamper(ROD.at_end, 30.0, 0.1, 0.2, ground=(1.0, 0.5), name="spring")
    rest = EquilibriumStart(loads=[spring])
    loads = [spring, PointForce(ROD.at_end, (1.0, 0.0), name="push")]
    return Scene([ROD], [Pin(ROD.at_start, name="wall")], GRAVITY, start=[rest], loads=loads)


SCENES = {
    "released": (released, [*DESIGN, "pull.force_y", "bias.force_y"]),
    "hung": (hung, [*DESIGN, "spring.stiffness", "spring.free_length", "push.force_x"]),
}


def test_gravity_of_the_start_stays_where_that_of_the_motion_is_a_design_variable():
    joints, rest = [Clamp(ROD.at_start)], EquilibriumStart(gravity=(0.0, -3.0))
    system = assemble(Scene([ROD], joints, GRAVITY, start=[rest]), ["scene.gravity_y"])
    q, _ = system.start()
    other = assemble(Scene([ROD], joints, (0.0, -3.0), start=[EquilibriumStart()]))
    np.testing.assert_array_equal(q, other.start()[0])
    np.testing.assert_array_equal(q, system.with_values(np.array([-5.0])).start()[0])
    assert not np.any(system.start_b()[0])
    # Without gravity of its own it hangs under that of the motion.
    hanging = assemble(
        Scene([ROD], joints, GRAVITY, start=[EquilibriumStart()]), ["scene.gravity_y"]
    )
    assert np.any(hanging.start_b()[0])


@pytest.mark.parametrize("joint", [Pin, Clamp])
def test_what_starts_at_rest_stays_at_rest(joint):
    scene = Scene([ROD], [joint(ROD.at_start)], GRAVITY, start=[EquilibriumStart()])
    for integrator in (HHT(2.0**-7), IDA()):
        run = simulate(scene, 0.25, integrator)
        assert run.outcome.success
        # Round-off of E A / l over the mass, 1e-16 * 25000 / 0.6 m/s^2, in 0.25 s.
        assert np.max(np.abs(run.q - run.q[0])) < 1e-11
        assert np.max(np.abs(run.v)) < 1e-10
    found = equilibrium(scene)
    np.testing.assert_allclose(run.q[0], found.q, atol=1e-12)
    np.testing.assert_allclose(run.lam[0], found.lam, atol=1e-9)


def test_the_derivative_of_a_motion_at_rest_is_that_of_the_equilibrium():
    scene = Scene([ROD], [Clamp(ROD.at_start)], GRAVITY, start=[EquilibriumStart()])
    run = differentiate(scene, 0.125, HHT(2.0**-7), design=DESIGN)
    found = equilibrium(scene, design=DESIGN)
    for part in ("q_b", "lam_b"):
        ours, rest = getattr(run.sensitivities, part), getattr(found, part)
        # Waves of round-off: eps times the condition number of the tangent, 1e6, is 2e-10 of the
        # largest derivative, and every one of 16 steps adds as much again.
        size = np.max(np.abs(rest), axis=0)
        assert np.max(np.abs(ours - rest) / size) < 4e-9


@pytest.mark.parametrize("name", SCENES)
def test_every_method_differentiates_through_the_equilibrium(name):
    make, design = SCENES[name]
    scene, integrator = make(), HHT(2.0**-8)
    exact = gradient(scene, TIP, 0.125, integrator, design=design, method=ComplexStep())
    for method in (DirectDifferentiation(), Adjoint()):
        ours = gradient(scene, TIP, 0.125, integrator, design=design, method=method)
        assert ours.value == pytest.approx(exact.value, rel=1e-13)
        # Newton's tolerance 1e-13 at 16 steps, entry by entry.
        assert ours.gradient == pytest.approx(exact.gradient, rel=1e-9)
    central = FiniteDifference(1e-5, central=True)
    near = gradient(scene, TIP, 0.125, integrator, design=design, method=central).gradient
    values = assemble(scene, design).b
    # Round-off 1e-12 over 1e-5, relative to the largest relative derivative.
    noise = 1e-6 * np.max(np.abs(exact.gradient * values)) / np.abs(values)
    assert np.all(np.abs(near - exact.gradient) <= noise)


def test_the_gradient_is_the_limit_of_the_very_call():
    scene, integrator = released(), HHT(2.0**-8)
    ours = gradient(scene, TIP, 0.125, integrator, design=["pull.force_y", "bias.force_y"])
    for slope, name, value in zip(ours.gradient, ours.names, (20.0, 3.0), strict=True):
        ahead, behind = (
            gradient(
                scene.with_values({name: value + s}), TIP, 0.125, integrator, design=["rod.height"]
            ).value
            for s in (1e-4, -1e-4)
        )
        # (1e-4)^2 and round-off 1e-13 over 1e-4.
        assert (ahead - behind) / 2e-4 == pytest.approx(slope, rel=1e-6)
    order = taylor_test(scene, TIP, 0.125, integrator, design=["pull.force_y"]).order
    assert order == pytest.approx(2.0, abs=0.1)


def test_other_integrators_and_step_control_start_there_too():
    scene, tip = released(), Terminal(position(ROD.at_end, 1))
    accurate = gradient(scene, tip, 0.1, IDA(rtol=1e-9), design=["pull.force_y"])
    controlled = HHT(AdaptiveSteps(1e-4))
    found = gradient(scene, tip, 0.1, controlled, design=["pull.force_y"])
    # The tolerance of the steps, and its waves in the derivative.
    assert found.value == pytest.approx(accurate.value, abs=1e-3)
    assert found.gradient == pytest.approx(accurate.gradient, rel=0.05)
    design, integral = ["pull.force_y"], Integral(position(ROD.at_end, 1) ** 2)
    continuous, discrete = (
        gradient(scene, integral, 0.125, HHT(2.0**-9), design=design, method=method).gradient
        for method in (ContinuousAdjoint(), Adjoint())
    )
    # Second order in the step, which resolves the waves by few points only.
    assert continuous == pytest.approx(discrete, rel=0.02)


def test_a_released_beam_swings_about_its_other_equilibrium():
    scene = released()
    run = simulate(scene, 1.0, HHT(2.0**-9))
    y = run.position(ROD.at_end)[:, 1]
    other = equilibrium(Scene([ROD], scene.joints, GRAVITY, loads=[BIAS]))
    below = other.solution.position(ROD.at_end)[0, 1]
    assert y[0] == np.max(y) > below > np.min(y)
    # Strain and gravity have the energy of the start, less what hht_alpha takes.
    system = assemble(scene)
    energy = [
        system.energies.strain(q[None])[0]
        + system.energies.gravity(q)
        + 0.5 * v @ system.mass_times(q, v)
        - 3.0 * system.naming.vector(ROD.at(0.5), Quantity.POSITION).of(q, 2)[1]
        for q, v in zip(run.q, run.v, strict=True)
    ]
    assert np.ptp(energy) < 0.1 * np.ptp(system.energies.gravity(run.q))


def test_the_search_runs_once_and_only_for_scenes_that_ask(monkeypatch):
    calls, found = [], rest.find_equilibrium
    monkeypatch.setattr(rest, "find_equilibrium", lambda s: calls.append(s) or found(s))
    gradient(released(), TIP, 0.125, HHT(2.0**-8), design=DESIGN, method=Adjoint())
    assert len(calls) == 1
    simulate(Scene([ROD], [Pin(ROD.at_start)], GRAVITY), 0.125, HHT(2.0**-8))
    assert len(calls) == 1


def test_a_search_for_the_start_begins_at_given_nodes():
    there = equilibrium(Scene([ROD], [Clamp(ROD.at_start)], GRAVITY))
    start = [NodalState("rod", there.solution.nodes("rod")[0]), EquilibriumStart()]
    scene = Scene([ROD], [Clamp(ROD.at_start)], GRAVITY, start=start)
    np.testing.assert_allclose(assemble(scene).start()[0], there.q, atol=1e-12)


def test_values_of_loads_change_where_the_scene_and_its_start_share_them():
    scene = released().with_values({"bias.force_y": 5.0, "pull.force_x": 1.0, "rod.height": 0.04})
    assert scene.loads[0] is scene.rest.loads[0]
    assert [tuple(load.force_vector) for load in scene.rest.loads] == [(0.0, 5.0), (1.0, 20.0)]
    assert scene.value(DesignVariable("p", ("pull.force_x",))) == 1.0


def test_a_start_without_equilibrium_is_refused_before_anything_is_integrated():
    free = Scene([ROD], [Pin(ROD.at_start)], start=[EquilibriumStart()])
    with pytest.raises(FreeMotionError, match="rod turns about its start"):
        simulate(free, 0.1, HHT(0.01))
    weightless = Scene(
        [ROD], [Pin(ROD.at_start)], GRAVITY, start=[EquilibriumStart(gravity=(0.0, 0.0))]
    )
    with pytest.raises(FreeMotionError, match="rod turns about its start"):
        simulate(weightless, 0.1, HHT(0.01))
    bars = [
        Beam(name, *ends, 1, Rectangle(0.02, 0.02), Material(1000.0, 1e9, 0.0))
        for name, ends in (("l", ((-1.0, 0.0), (0.0, 0.1))), ("r", ((0.0, 0.1), (1.0, 0.0))))
    ]
    joints = [Pin(bars[0].at_start), Pin(bars[1].at_end), Pin(bars[0].at_end, bars[1].at_start)]
    push = EquilibriumStart(loads=[PointForce(bars[0].at_end, (0.0, -1e3))])
    scene, apex = Scene(bars, joints, start=[push]), Terminal(position(bars[0].at_end, 1))
    words = r"start at rest: the load has a limit point.* at 15\."
    with pytest.raises(NoEquilibriumError, match=words) as caught:
        gradient(scene, apex, 0.1, HHT(0.01), design=["l.height"])
    assert caught.value.equilibrium.outcome.verdict is Verdict.LIMIT_POINT


def test_a_driven_joint_that_moves_at_the_start_is_refused():
    joints = [Pin(ROD.at_start), RotationDriver(ROD.at_start, Harmonic(0.5, 4.0), name="motor")]
    scene = Scene([ROD], joints, GRAVITY, start=[EquilibriumStart()])
    with pytest.raises(
        InvalidInputError, match=r"zero velocity at t = 0; got a nonzero rate of 'motor'"
    ):
        simulate(scene, 0.1, HHT(0.01))


def test_nonsense_is_refused_in_words():
    joints, spin = [Clamp(ROD.at_start)], InitialVelocity("rod", 1.0, (0.0, 0.0))
    nodes = assemble(Scene([ROD], joints)).start()[0].reshape(4, 3, 2)
    moving = NodalState("rod", nodes, 0 * nodes)
    same = PointForce(ROD.at(0.5), (0.0, 3.0), name="bias")
    for action, words in (
        (
            lambda: Scene([ROD], joints, start=[EquilibriumStart(), EquilibriumStart()]),
            "EquilibriumStart stands alone",
        ),
        (
            lambda: Scene([ROD], joints, start=[spin, EquilibriumStart()]),
            "EquilibriumStart stands alone",
        ),
        (
            lambda: Scene([ROD], joints, start=[moving, EquilibriumStart()]),
            "EquilibriumStart stands alone",
        ),
        (
            lambda: Scene([ROD], joints, start=[EquilibriumStart(loads=[same])], loads=[BIAS]),
            "bias",
        ),
        (
            lambda: Scene([ROD], joints, start=[EquilibriumStart(gravity=(0.0, 0.0, 1.0))]),
            "EquilibriumStart.gravity",
        ),
        (lambda: Scene([ROD], joints, start=EquilibriumStart()), "Scene.start"),
        (lambda: EquilibriumStart(loads=PULL), "EquilibriumStart.loads"),
        (lambda: EquilibriumStart(loads=[ROD]), "EquilibriumStart.loads"),
        (lambda: EquilibriumStart(gravity="down"), "EquilibriumStart.gravity"),
        (
            lambda: Scene(
                [ROD],
                joints,
                start=[EquilibriumStart([PointForce(ROD.at(0.5, y=0.1), (0.0, 1.0))])],
            ),
            "must lie in the section",
        ),
        (lambda: released().with_values({"push.force_x": 1.0}), "push"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            action()


def test_a_start_that_is_unstable_is_warned_of():
    # Just above the load of Euler the straight column is in balance, and grows away from there.
    column = Beam("rod", (0.0, 0.0), (1.0, 0.0), 4, Rectangle(0.02, 0.02), Material(1e3, 1e7, 0.0))
    euler = np.pi**2 / 4 * 1e7 * 0.02**4 / 12
    for share, unstable in ((0.9, False), (1.2, True)):
        push = PointForce(column.at_end, (-share * euler, 0.0))
        scene = Scene([column], [Clamp(column.at_start)], loads=[push], start=[EquilibriumStart()])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            assemble(scene).start()
        assert [item.category for item in caught] == unstable * [StabilityWarning]
    assert "unstable (buckled)" in str(caught[0].message)
