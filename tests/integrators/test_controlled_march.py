"""Steps under error control that the kernel takes are those that Python takes one by one."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    AdaptiveSteps,
    Contact,
    InitialVelocity,
    RigidBody,
    Scene,
    Sphere,
    assemble,
)
from ancfdae.integrators.hht import method
from ancfdae.integrators.hht.equations import Coefficients
from ancfdae.integrators.hht.step import HHTStepper
from ancfdae.integrators.prescribed_motion import turn_error
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.results import Verdict
from tests.support.controlled_motions import (
    called_pendulum,
    driven_crank,
    kicked_pendulum,
    soft_pendulum,
)
from tests.support.one_by_one import OneByOne


def thrown_ball():
    """A ball that flies freely, with steps as long as they like, until it meets a small sphere."""
    ball = RigidBody("ball", (0, 0, 0), mass=1.0, inertia=(0.004,) * 3)
    obstacle = Sphere((1.0, 0.01, 0.0), 0.02)
    touch = Contact(ball.at(0, 0, 0), obstacle, stiffness=1e6, radius=0.02, name="wall")
    start = [InitialVelocity("ball", (0, 0, 0), (0, 0, 0), (10.0, 0, 0))]
    return assemble(Scene([], [], bodies=[ball], loads=[touch], start=start), ["ball.mass"]), 0.2


SYSTEMS = [soft_pendulum, driven_crank, kicked_pendulum, called_pendulum]


class Alone(HHTStepper, OneByOne):
    """HHT-I3 by `Model.march` for each step, and by the error that `step.py` states."""

    controlled = OneByOne.controlled

    def __init__(self, problem, alpha, newton, tolerance, recorder):
        super().__init__(problem, alpha, newton, tolerance, recorder)
        self.given, self.alpha, self.recorder = (problem, tolerance), alpha, recorder

    def advance(self, h, before, t):
        node = self._solver.advance((Coefficients(h, self.alpha), before[0], t))
        return node if isinstance(node, Failure) else (node, None)

    def error(self, h, before, after):
        (old, _), (new, _), (problem, tolerance) = before, after, self.given
        size = np.maximum(problem.size(old.q), problem.size(new.q))
        rise = -(1 + 3 * self.alpha**2) / 12 * h**2 * (new.a - old.a)
        turn = turn_error(self.system, new.t, h, 2)
        return max(turn, tolerance.of_motion(h, rise, size))


@pytest.mark.parametrize("rtol", [1e-2, 1e-4])
@pytest.mark.parametrize("made", SYSTEMS)
def test_the_kernel_takes_the_steps_of_a_loop_in_python(made, rtol, monkeypatch):
    system, t_end = made()
    integrator = HHT(AdaptiveSteps(rtol), hht_alpha=-0.05)
    together = integrator.integrate(system, t_end)
    monkeypatch.setattr(method, "HHTStepper", Alone)
    alone = integrator.integrate(system, t_end)
    assert together.outcome.success
    counts = [
        (x.steps, x.rejected, x.iterations, x.factorisations, x.round_off_steps)
        for x in (together.statistics, alone.statistics)
    ]
    assert counts[0] == counts[1]
    # Means of squares are added up in another order; the filter does not amplify it.
    np.testing.assert_allclose(together.t, alone.t, rtol=1e-9)
    np.testing.assert_allclose(together.q, alone.q, rtol=0, atol=1e-9 * np.max(np.abs(alone.q)))
    np.testing.assert_allclose(together.control, alone.control, rtol=1e-7)


def test_complex_designs_take_the_steps_of_real_ones():
    system, t_end = soft_pendulum()
    integrator = HHT(AdaptiveSteps(1e-4), hht_alpha=-0.05)
    real = integrator.integrate(system, t_end)
    moved = integrator.integrate(system.with_values(system.b * (1 + 1e-20j)), t_end)
    np.testing.assert_allclose(moved.t, real.t, rtol=1e-9)
    given = integrator.frozen(real).integrate(system.with_values(system.b * (1 + 1e-20j)), t_end)
    # The imaginary part is the derivative at the steps as they were taken.
    np.testing.assert_allclose(moved.q.imag, given.q.imag, rtol=0, atol=1e-7 * np.max(given.q.imag))


def test_a_run_goes_on_as_if_it_had_not_stopped():
    system, t_end = kicked_pendulum()
    integrator = HHT(AdaptiveSteps(1e-3), hht_alpha=-0.05)
    whole = integrator.integrate(system, t_end)
    part = integrator.integrate(system, 0.05)
    assert len(part.control) == 20
    more = integrator.resume(system, t_end, part)
    assert more.outcome.success
    assert np.max(np.abs(more.q[-1] - whole.q[-1])) < 1e-2 * np.max(np.abs(whole.q))


def test_a_limit_of_steps_ends_a_run_there():
    system, t_end = soft_pendulum()
    run = HHT(AdaptiveSteps(1e-4, max_steps=30), hht_alpha=-0.05).integrate(system, t_end)
    assert run.outcome.verdict is Verdict.STEP_LIMIT
    assert run.statistics.steps + run.statistics.rejected == 30


def test_a_law_that_raises_ends_the_run_with_its_error(monkeypatch):
    system, t_end = kicked_pendulum()

    def broken(self, t, end, h):
        raise ZeroDivisionError("law")

    monkeypatch.setattr(HHTStepper, "_laws", broken)
    with pytest.raises(ZeroDivisionError, match="law"):
        HHT(AdaptiveSteps(1e-3)).integrate(system, t_end)


def test_a_step_that_would_pass_over_a_contact_is_shortened():
    system, t_end = thrown_ball()
    run = HHT(AdaptiveSteps(1e-4), hht_alpha=-0.05).integrate(system, t_end)
    assert run.outcome.success
    assert run.statistics.rejected > 0
    # It bounces off the sphere: without the check a step leads past it and the run is refused.
    assert np.max(np.abs(run.v[-1] - run.v[0])) > 1.0
