"""Trouble on the way is an outcome in words, and what was computed stays usable."""

import pickle
import re
import signal

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    Distance,
    InitialVelocity,
    Integral,
    Material,
    Pin,
    PointForce,
    PointOnLine,
    PrescribedSteps,
    Radau,
    Scene,
    assemble,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.errors import Interrupted, InvalidInputError
from ancfdae.observables import custom
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum
from tests.support.members import constraint_force
from validation.scenes import pendulum


class Failing(CartesianPendulum):
    """A pendulum whose force does something bad from a given time on."""

    def __init__(self, action, since):
        super().__init__(0.5, 3.0)
        self.action, self.since = action, since

    def force(self, t, q, v):
        if t >= self.since:
            return self.action()
        return super().force(t, q, v)


def interrupt():
    raise KeyboardInterrupt


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_forces_that_are_not_finite_end_the_run_with_its_results(value):
    run = simulate(Failing(lambda: np.full(2, value), 0.5), 1.0, HHT(2.0**-5))
    assert run.outcome.verdict is Verdict.NOT_FINITE
    assert run.outcome.step == len(run.t) - 1 == 15
    assert run.outcome.time == run.t[-1] == 15 / 32
    assert np.all(np.isfinite(run.q))
    good = simulate(CartesianPendulum(0.5, 3.0), 1.0, HHT(2.0**-5))
    np.testing.assert_array_equal(run.q, good.q[:16])
    assert "t = 0.46875" in str(run.outcome)


@pytest.mark.parametrize(
    "integrator",
    [HHT(2.0**-5), HHT(rtol=1e-3), Radau(2.0**-5), Radau(rtol=1e-3), DOP853(), IDA()],
)
def test_an_interrupt_is_raised_with_what_was_computed(integrator):
    for call in (simulate, differentiate):
        with pytest.raises(Interrupted, match="interrupted at t = ") as caught:
            call(Failing(interrupt, 0.5), 1.0, integrator)
        run = caught.value.result
        assert run.outcome.verdict is Verdict.INTERRUPTED
        assert len(run.t) > 1
        again = pickle.loads(pickle.dumps(caught.value))
        assert str(again) == str(caught.value)
        np.testing.assert_array_equal(again.result.q, run.q)


def test_ctrl_c_ends_a_loop_of_runs():
    pressed, done = Failing(lambda: signal.raise_signal(signal.SIGINT), 0.5), []

    def loop():
        for system in (CartesianPendulum(), pressed, CartesianPendulum()):
            try:
                done.append(simulate(system, 1.0, HHT(2.0**-5)))
            except Exception:  # noqa: BLE001  # What people write around a run that may fail.
                done.append(None)

    with pytest.raises(Interrupted) as caught:
        loop()
    assert [len(run.t) for run in done] == [33]
    assert len(caught.value.result.t) == 16


def test_too_few_iterations_are_told_with_time_and_size():
    run = simulate(pendulum(), 1.0, HHT(2.0**-7, max_iterations=1))
    assert run.outcome.verdict is Verdict.NO_CONVERGENCE
    assert not run.outcome.success
    assert run.outcome.residual > 0
    assert "did not converge at t = " in str(run.outcome)


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
def test_where_no_solution_is_near_the_outcome_tells_how_long_steps_may_be():
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.02, 0.02), Material(2700.0, 1e8, 0.3))
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at_end, (0, 1000.0))])
    run = simulate(scene, 0.1, HHT(0.05))
    assert run.outcome.verdict is Verdict.NO_CONVERGENCE
    longest = float(re.search(r"for steps up to ([0-9.e-]+[0-9])", run.outcome.advice).group(1))
    # Half of it passes where the run ended.
    assert longest < 0.05
    end = run.outcome.time + longest / 2
    assert simulate(scene, end, HHT(PrescribedSteps((*run.t.tolist(), end)))).outcome.success
    assert "periods" in run.outcome.advice


def test_no_step_is_named_where_forces_are_not_finite():
    run = simulate(Failing(lambda: np.full(2, np.nan), 0.5), 1.0, HHT(2.0**-5))
    assert "for steps up to" not in str(run.outcome)
    assert "tried" not in str(run.outcome)


# A run that reaches the end is said to be wrong by a multiple of its own size.
@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
def test_a_step_beyond_all_reason_ends_cleanly():
    run = simulate(pendulum(youngs_modulus=1e3), 40.0, HHT(10.0))
    assert isinstance(run.outcome.verdict, Verdict)
    assert np.all(np.isfinite(run.q))


def test_progress_bar_only_on_request(capsys):
    simulate(CartesianPendulum(), 0.25, HHT(2.0**-4))
    assert capsys.readouterr().err == ""
    simulate(CartesianPendulum(), 0.25, HHT(2.0**-4), progress=True)
    assert "0.25/0.25" in capsys.readouterr().err


def test_statistics_count_what_was_done():
    run = simulate(pendulum(), 0.25, HHT(2.0**-7))
    s = run.statistics
    assert s.steps == 32
    assert s.iterations == s.residuals >= 2 * s.steps
    assert 1 <= s.factorisations <= s.iterations
    assert s.wall_seconds > 0


def worst_defect(scene, run, integrator):
    """Largest constraint violation and residual of eq. (4) of accepted steps, relative."""
    system, alpha = assemble(scene), integrator.hht_alpha
    f = [
        constraint_force(system, t, q, lam) - system.force(t, q, v)
        for t, q, v, lam in zip(run.t, run.q, run.v, run.lam, strict=True)
    ]
    worst = 0.0
    for n in range(1, len(run.t)):
        inertia = system.mass_times(None, (1 + alpha) * run.a[n] - alpha * run.a[n - 1])
        residual = inertia + (1 + alpha) * f[n] - alpha * f[n - 1]
        scale = np.linalg.norm(inertia) + np.linalg.norm(system.force(0.0, run.q[n], run.v[n]))
        worst = max(worst, np.linalg.norm(residual) / scale)
        worst = max(worst, np.max(np.abs(system.constraint(run.t[n], run.q[n]))))
    return worst


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
def test_no_accepted_step_is_wrong_however_wild_the_motion():
    # Found by review: measured against an iterate that ran away, corrections looked converged.
    rng, finished = np.random.default_rng(3), 0
    for _ in range(40):
        modulus, spin = 10 ** rng.uniform(5, 8), 10 ** rng.uniform(-1, 2)
        rod = Beam("x", (0, 0), (1, 0), 3, Rectangle(0.05, 0.04), Material(4000.0, modulus, 0.3))
        start = [InitialVelocity("x", spin, (0, 0))]
        scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81), start)
        integrator = HHT(2.0**-5, hht_alpha=-0.05)
        run = integrator.integrate(assemble(scene), 1.0)
        finished += run.outcome.success
        assert worst_defect(scene, run, integrator) < 1e-8, str(run.outcome)
    assert 0 < finished < 40


def test_a_gap_too_wide_to_project_ends_cleanly():
    section, material = Rectangle(0.05, 0.04), Material(4000.0, 1e7, 0.3)
    a = Beam("a", (0, 0), (0.5, 0.1), 3, section, material)
    b = Beam("b", (0.5, 0.1), (1.1, 0), 2, section, material)
    link = Distance(a.at(0.8), 0.3, other=b.at(0.35))
    scene = Scene([a, b], [Pin(a.at_start), link], (0, -9.81), project_start=True)
    integrator = HHT(2.0**-7, max_iterations=40)
    run = simulate(scene, 0.125, integrator)
    assert worst_defect(scene, run, integrator) < 1e-8


def test_a_start_that_cannot_be_projected_is_refused():
    rod = Beam("x", (0, 0), (0.3, 0), 2, Rectangle(0.05, 0.04), Material(4000.0, 1e7, 0.3))
    # The line is 0.4 m from the ground of the rod.
    joints = [PointOnLine(rod.at_end, (1, 0)), Distance(rod.at_end, 0.39, ground=(0.5, 0.4))]
    with pytest.raises(InvalidInputError, match="start"):
        simulate(Scene([rod], joints, project_start=True), 0.125, HHT(2.0**-7))


def test_a_perturbed_run_that_ends_early_is_told_in_the_outcome():
    system = FailingWhenComplex()
    run = differentiate(system, 1.0, HHT(2.0**-5), method=ComplexStep())
    assert run.outcome.verdict is Verdict.NOT_FINITE
    assert run.outcome.step == len(run.t) - 1 == 15


def test_an_interrupt_of_the_pass_back_keeps_the_run(monkeypatch):
    monkeypatch.setattr(CartesianPendulum, "start_b", lambda self: interrupt())
    objective = Integral(custom(lambda t, q, v, lam, b: q[:, 0], "x"))
    with pytest.raises(Interrupted, match="interrupted") as caught:
        gradient(CartesianPendulum(), objective, 1.0, HHT(2.0**-5), method=Adjoint())
    assert len(caught.value.result.t) == 33


class FailingWhenComplex(CartesianPendulum):
    """A pendulum whose complex runs fail half-way."""

    def with_values(self, b):
        return FailingWhenComplex(self.angle, self.spin, b)

    def force(self, t, q, v):
        if t >= 0.5 and np.iscomplexobj(self.b):
            return np.full(2, np.nan)
        return super().force(t, q, v)
