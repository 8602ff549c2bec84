"""What the outcome of a stopped run names was tried: followed literally, it reaches the end."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    Integral,
    Material,
    PointForce,
    Radau,
    Scene,
    assemble,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.equations.solution import Solution
from ancfdae.errors import Interrupted, UnfinishedRunError
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from ancfdae.studies import remedies
from tests.support.mechanisms import NeverRight
from tests.support.random_mechanisms import mechanism

# Seeds of mechanisms, and numbers of steps, two of nine that stop among sixty.
STOPS = [(33, 100), (59, 100)]


def whip(load=500.0, damping=0.0):
    material = Material(2700.0, 1e8, 0.3, damping_time=damping)
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.02, 0.02), material)
    force = PointForce(rod.at_end, (0, load))
    return Scene([rod], [Clamp(rod.at_start)], loads=[force]), position(rod.at_end, 1)


def tried(outcome, integrator="HHT"):
    return float(re.search(rf"{integrator}\(step=([^)]+)\) was tried", str(outcome))[1])


def with_damping(scene, time):
    values = {f"{x.name}.damping_time": time for x in scene.beams if not x.rigid}
    return scene.with_values(values)


@pytest.mark.parametrize(("seed", "steps"), STOPS)
def test_the_step_that_is_named_reaches_the_end_and_so_does_the_damping(seed, steps):
    scene, t_end = mechanism(seed)
    run = simulate(scene, t_end, HHT(t_end / steps))
    # A whirl of steps too long crushes elements, or is not solved at all.
    assert run.outcome.verdict in (Verdict.NO_CONVERGENCE, Verdict.FOLDED)
    assert run.outcome.time < t_end
    assert simulate(scene, t_end, HHT(step=tried(run.outcome))).outcome.success
    (time,) = re.findall(r"with damping_time=([0-9.e-]+) where", str(run.outcome))
    assert simulate(with_damping(scene, float(time)), t_end, HHT(t_end / steps)).outcome.success


def test_a_shorter_step_is_named_only_where_the_longer_ones_stop():
    scene, _ = whip()
    run = simulate(scene, 0.1, HHT(0.05))
    named = tried(run.outcome)
    assert named < 0.05
    longer = 0.05 / 2
    while longer > named * 1.01:
        assert not HHT(longer).integrate(assemble(scene), 0.1).outcome.success
        longer /= 2
    # The run itself is not replaced.
    assert run.t[-1] < 0.1
    assert len(run.t) == run.outcome.step + 1


@pytest.mark.filterwarnings("ignore:the errors of this run:ancfdae.errors.StabilityWarning")
def test_gradients_at_the_step_that_is_named_are_exact():
    scene, tip = whip()
    call = scene, Integral(tip), 0.1
    with pytest.raises(UnfinishedRunError, match="was tried then and reached the end") as caught:
        gradient(*call, HHT(0.05), design=["rod.height"])
    integrator = HHT(step=tried(caught.value.solution.outcome))
    found = [
        gradient(*call, integrator, design=["rod.height"], method=method).gradient
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    # Newton's tolerance of 1e-14, amplified by the condition of the matrix, over 1e2 steps.
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-9)
    short = differentiate(scene, 0.1, HHT(0.05), design=["rod.height"])
    assert "was tried then" in str(short.outcome)


def test_steps_that_stop_too_are_said(monkeypatch):
    monkeypatch.setattr(remedies, "_HALVINGS", 1)
    words = str(simulate(whip(1e5)[0], 0.1, HHT(0.05)).outcome)
    assert "Steps of 0.025 were tried then and stopped, too." in words
    assert "reached" not in words


def test_an_attempt_that_would_take_long_is_not_made(monkeypatch):
    scene, _ = whip()
    system = assemble(scene)
    # Two steps of the run, four of the first attempt: it is left out, as is that with damping.
    monkeypatch.setattr(remedies, "_MOST", 3.9 * (system.n_q + system.n_lam))
    run = simulate(system, 0.1, HHT(0.05))
    assert "tried" not in str(run.outcome)
    assert "for steps up to" in str(run.outcome)


def test_nothing_is_tried_after_what_no_step_mends(monkeypatch):
    monkeypatch.setattr(remedies, "_shorter", None)
    for system, integrator in (
        (NeverRight(), HHT(2.0**-5)),
        (assemble(whip()[0]), HHT(rtol=1e-3)),
        (assemble(whip(1.0)[0]), HHT(2.0**-8)),
    ):
        simulate(system, 0.0625, integrator)


def test_other_integrators_at_a_fixed_step_are_tried_alike():
    # One iteration of Newton's method is not enough for any step.
    run = simulate(whip()[0], 0.1, Radau(0.05, max_iterations=1))
    assert "Steps of 0.025, 0.0125" in str(run.outcome)


def test_ctrl_c_in_an_attempt_keeps_the_run(monkeypatch):
    scene, _ = whip()
    stopped = simulate(scene, 0.1, HHT(0.05))
    real, calls = HHT.integrate, []

    def pressed(self, *arguments, **settings):
        calls.append(self)
        run = real(self, *arguments, **settings)
        if len(calls) == 1:
            return run
        return replace(run, outcome=replace(run.outcome, verdict=Verdict.INTERRUPTED))

    monkeypatch.setattr(HHT, "integrate", pressed)
    with pytest.raises(Interrupted) as caught:
        simulate(scene, 0.1, HHT(0.05))
    assert isinstance(caught.value.result, Solution)
    np.testing.assert_array_equal(caught.value.result.q, stopped.q)


def test_attempts_end_where_the_next_one_would_take_too_long(monkeypatch):
    scene, t_end = mechanism(STOPS[0][0])
    monkeypatch.setattr(remedies, "_SECONDS", 1e-6)
    run = simulate(scene, t_end, HHT(t_end / STOPS[0][1]))
    assert not run.outcome.success
    assert "HHT(step" not in str(run.outcome)
