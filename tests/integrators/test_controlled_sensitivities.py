"""HHT-I3 whose tolerance bounds the design derivatives too: honesty, frozen steps, outcomes."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    AdaptiveSteps,
    Adjoint,
    Beam,
    ComplexStep,
    DirectDifferentiation,
    Material,
    Pin,
    Scene,
    Terminal,
    assemble,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.equations import DesignPartials
from ancfdae.errors import Interrupted, InvalidInputError, StabilityWarning
from ancfdae.extend import MaterialPoint
from ancfdae.integrators.step_control import contracts as sizing
from ancfdae.integrators.step_control import steps as controlled
from ancfdae.integrators.step_control.contracts import Tolerance
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum, NeverRight
from validation.external.slider_crank import SliderCrank
from validation.scenes import crank_slider, pendulum

STATES = ("q_b", "v_b", "a_b", "lam_b")


def both(rtol, **settings):
    return AdaptiveSteps(rtol, sensitivities=True, **settings)


@pytest.fixture
def no_estimates(monkeypatch):
    """Leave out the errors that a finished run states, which read the derivatives' sizes again."""
    monkeypatch.setattr(HHT, "_estimated", lambda self, solution, scales: solution)


def soft():
    return assemble(pendulum(), ("pendulum.height", "pendulum.density"))


def crank():
    return assemble(crank_slider(), ("rod.height", "rod.density"))


def error_of_derivatives(system, run, exact):
    """Largest error of any coordinate at any instant, as rtol and atol measure it if equal.

    In the weighted form of the coordinates, which has one unit for all of them.
    """
    root = np.sqrt(system.weights)[:, None]
    ours, theirs = (root * x.sensitivities.q_b for x in (run.at(exact.t[:-1]), exact))
    size = np.max(np.sqrt(np.mean(theirs**2, axis=1)), axis=0)
    return np.max(np.abs(ours - theirs[:-1]) / (size + np.max(np.abs(theirs), axis=0)))


@pytest.mark.parametrize(
    ("build", "t_end"), [(CartesianPendulum, 2.0), (SliderCrank, 10.0), (soft, 0.25), (crank, 0.05)]
)
def test_derivatives_keep_to_ten_times_the_tolerance(build, t_end):
    system = build()
    exact = differentiate(system, t_end, DOP853(1e-7))
    for rtol in (1e-2, 2e-3):
        run = differentiate(system, t_end, HHT(both(rtol)))
        assert run.outcome.success
        error = error_of_derivatives(system, run, exact)
        assert error < 10 * rtol, rtol


def test_what_the_tolerance_of_the_motion_does_not_bound():
    # Waves below the tolerance of the motion decide about this gradient.
    system, tip, rtol = soft(), Terminal(position(MaterialPoint("pendulum", 1.0), 1)), 1e-3
    exact = gradient(system, tip, 0.25, DOP853(1e-6)).gradient * system.b
    errors = []
    for along in (False, True):
        found = gradient(system, tip, 0.25, HHT(AdaptiveSteps(rtol, sensitivities=along)))
        errors.append(np.linalg.norm(found.gradient * system.b - exact) / np.linalg.norm(exact))
    assert errors[0] > 20 * rtol
    assert errors[1] < rtol


@pytest.mark.parametrize(
    ("build", "t_end"), [(lambda: CartesianPendulum(0.3, 1.0), 1.0), (soft, 0.1)]
)
def test_derivatives_along_are_those_of_the_frozen_steps(build, t_end):
    integrator = HHT(both(1e-2), newton_tolerance=1e-14)
    system = build()
    run = differentiate(system, t_end, integrator)
    batched = integrator.differentiate(system, run)
    check = differentiate(system, t_end, integrator, method=ComplexStep())
    np.testing.assert_array_equal(check.t, run.t)
    assert len(np.unique(np.round(np.diff(run.t), 12))) > 15
    for name in STATES:
        ours = getattr(run.sensitivities, name)
        # Complex runs take other operations: round-off in q counts 1/(beta h^2) times in a (another
        # Newton tolerance moves a_b by 1e-9).
        for other, bound in ((batched, 1e-11), (check, 1e-8)):
            theirs = getattr(other.sensitivities, name)
            assert np.max(np.abs(ours - theirs)) < bound * np.max(np.abs(theirs)), name


def test_a_solution_starts_with_the_derivatives_of_the_consistent_start():
    integrator, system = HHT(both(1e-2)), CartesianPendulum(0.3, 1.0)
    run = differentiate(system, 0.1, integrator)
    batched = integrator.differentiate(system, run)
    for name in STATES:
        ours, theirs = (getattr(x.sensitivities, name)[0] for x in (run, batched))
        assert np.any(ours != 0), name
        np.testing.assert_array_equal(ours, theirs)


def test_factorisations_of_the_derivatives_are_counted():
    # One for the derivatives of each step, and about one for its motion.
    run = differentiate(CartesianPendulum(), 1.0, HHT(both(1e-2)))
    tried = run.statistics.steps + run.statistics.rejected
    assert run.statistics.factorisations >= 2 * tried


def test_adjoint_and_direct_agree_on_the_same_steps():
    integrator, tip = HHT(both(1e-2)), position(MaterialPoint("rod", 0.5), 1)
    direct, adjoint = (
        gradient(crank(), Terminal(tip), 0.02, integrator, method=method)
        for method in (DirectDifferentiation(), Adjoint())
    )
    np.testing.assert_array_equal(direct.solution.t, adjoint.solution.t)
    size = np.linalg.norm(direct.gradient)
    assert np.linalg.norm(adjoint.gradient - direct.gradient) < 1e-11 * size


def test_sizes_that_were_too_large_are_replaced(monkeypatch, no_estimates):
    integrator = HHT(both(1e-3))
    expected = differentiate(CartesianPendulum(), 1.0, integrator)
    true_sizes, calls = sizing.derivative_sizes, []

    def exaggerated(scales, q_b):
        calls.append(len(q_b))
        return true_sizes(scales, q_b) * (1e3 if len(calls) == 1 else 1.0)

    monkeypatch.setattr(sizing, "derivative_sizes", exaggerated)
    run = differentiate(CartesianPendulum(), 1.0, integrator)
    # A rough run, one with the wrong sizes, which has too few steps, and one with its own sizes.
    assert len(calls) == 3
    assert calls[1] < 0.9 * calls[2]
    assert abs(run.statistics.steps - expected.statistics.steps) <= 2


def test_sizes_come_from_a_rough_run(monkeypatch, no_estimates):
    true_sizes, calls = sizing.derivative_sizes, []

    def seen(scales, q_b):
        calls.append(len(q_b))
        return true_sizes(scales, q_b)

    monkeypatch.setattr(sizing, "derivative_sizes", seen)
    differentiate(CartesianPendulum(), 0.3, HHT(both(1e-5)))
    assert len(calls) == 2
    assert 5 * calls[0] < calls[1]


def test_of_sizes_assumed_and_found_the_smaller_count(monkeypatch, no_estimates):
    found, used = iter([[8.0, 1.0], [1.0, 2.0], [1.0, 2.0]]), []

    def seen(rtol, atol, t_end, sizes, sizes_b):
        used.append(list(sizes_b))
        return Tolerance(rtol, atol, t_end, sizes, sizes_b)

    monkeypatch.setattr(sizing, "derivative_sizes", lambda scales, q_b: np.array(next(found)))
    monkeypatch.setattr(controlled, "Tolerance", seen)
    differentiate(CartesianPendulum(), 0.1, HHT(both(1e-2)))
    assert used == [[], [8.0, 1.0], [1.0, 1.0]]  # The first is the rough run.


@pytest.mark.parametrize("sizes", [[2e-12, 0.0] * 4, [0.0, 2e-12] * 4])
def test_sizes_at_the_threshold_of_round_off_do_not_alternate(monkeypatch, no_estimates, sizes):
    # Coarse steps find a size just above it, fine ones none: each would ask for the other's run.
    found = iter(sizes)
    monkeypatch.setattr(
        sizing, "derivative_sizes", lambda scales, q_b: np.array([1.0, next(found)])
    )
    integrator = HHT(both(1e-2))
    assert differentiate(CartesianPendulum(), 0.5, integrator).outcome.success
    assert len(list(found)) >= 5


def test_a_variable_without_influence_bounds_nothing():
    # In this plane the width of the section cancels: forces and masses are proportional to it.
    system = assemble(pendulum(), ("pendulum.width", "pendulum.height"))
    integrator = HHT(both(1e-2))
    run = differentiate(system, 0.05, integrator)
    assert run.outcome.success
    alone = differentiate(assemble(pendulum(), ("pendulum.height",)), 0.05, integrator)
    assert run.statistics.steps < 1.5 * alone.statistics.steps


def test_without_design_variables_the_motion_rules():
    system = assemble(pendulum(), ())
    runs = [simulate(system, 0.1, HHT(AdaptiveSteps(1e-2, sensitivities=x))) for x in (False, True)]
    np.testing.assert_array_equal(runs[0].t, runs[1].t)


def test_same_steps_for_other_units_of_the_design():
    # A modulus counted in other units has derivatives of another size, and the same steps.
    runs = [
        differentiate(
            pendulum_with(modulus),
            0.25 * time,
            HHT(both(1e-2)),
            design=("beam.youngs_modulus", "beam.height"),
        )
        for modulus, time in ((1e7, 1.0), (1e1, 1e3))
    ]
    assert runs[0].statistics.steps == runs[1].statistics.steps > 100
    ours, theirs = (run.sensitivities.q_b[-1, :, 0] * run.sensitivities.values[0] for run in runs)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8 * np.max(np.abs(theirs)))


def pendulum_with(modulus):
    """The paper's pendulum with time counted in units that make the modulus what it is."""
    beam = Beam("beam", (0, 0), (1.2, 0), 4, Rectangle(0.05, 0.04), Material(4000, modulus, 0.3))
    return Scene([beam], [Pin(beam.at_start)], (0, -9.81 * modulus / 1e7))


def test_the_limit_of_steps_is_an_outcome():
    run = differentiate(soft(), 0.25, HHT(both(1e-3, max_steps=99)))
    assert run.outcome.verdict is Verdict.STEP_LIMIT
    assert len(run.sensitivities.q_b) == len(run.t) <= 100


def test_complex_steps_repeat_a_run_without_a_step_too():
    integrator = HHT(both(1e-3))
    run = differentiate(NeverRight(), 1.0, integrator, method=ComplexStep())
    assert run.outcome.verdict is Verdict.NOT_FINITE
    assert len(run.sensitivities.q_b) == len(run.t) == 1


def test_complex_systems_are_refused():
    system = CartesianPendulum(b=(1.0 + 1e-40j, 9.81))
    with pytest.raises(InvalidInputError, match="needs real design values; got complex ones"):
        simulate(system, 1.0, HHT(both(1e-3)))


@pytest.mark.parametrize("after", [10, 200])
def test_an_interrupt_keeps_what_is_computed(monkeypatch, after):
    true_force, calls = CartesianPendulum.force, []

    def interrupted(self, t, q, v):
        # Complex ones differentiate what is computed.
        if not (np.iscomplexobj(q) or np.iscomplexobj(self.b)):
            calls.append(t)
            if len(calls) == after:
                raise KeyboardInterrupt
        return true_force(self, t, q, v)

    monkeypatch.setattr(CartesianPendulum, "force", interrupted)
    integrator = HHT(both(1e-3))
    with pytest.raises(Interrupted) as caught:
        differentiate(CartesianPendulum(), 2.0, integrator)
    run = caught.value.result
    assert len(run.sensitivities.q_b) == len(run.t) >= 1
    # Nothing goes on after it; linearising what is computed takes two forces a step: a residual
    # and its derivative count where the imaginary part begins.
    assert len(calls) <= after + 2 * len(run.t)


@pytest.mark.parametrize("start", [-1.0, 0.5])
def test_derivatives_that_are_no_numbers_are_an_outcome(monkeypatch, start):
    true_partials = CartesianPendulum.design_partials

    def undefined(self, t, *states):
        partials = true_partials(self, t, *states)
        late = np.where(t > start, np.nan, 1.0)[:, None, None]
        return DesignPartials(partials.f_b * late, partials.Phi_b)

    monkeypatch.setattr(CartesianPendulum, "design_partials", undefined)
    integrator = HHT(both(1e-2))
    run = differentiate(CartesianPendulum(), 1.0, integrator)
    assert run.outcome.verdict is Verdict.ERROR_TEST
    assert run.t[-1] == pytest.approx(max(start, 0.0))
    assert np.all(np.isfinite(run.sensitivities.q_b[1:]))


def test_a_setting_that_is_no_truth_value_is_refused_by_name():
    with pytest.raises(InvalidInputError, match=r"AdaptiveSteps\.sensitivities"):
        AdaptiveSteps(1e-3, sensitivities="yes")


def test_what_a_setting_is_warned_about_is_said_once():
    with pytest.warns(StabilityWarning):
        integrator = HHT(both(1e-2), hht_alpha=0.0)
    # From here on a warning is an error.
    run = differentiate(CartesianPendulum(), 0.5, integrator, method=ComplexStep())
    assert run.outcome.success
    assert integrator.refined(run).hht_alpha == 0


def test_a_rough_run_that_breaks_off_tells_no_sizes(monkeypatch):
    integrator = HHT(both(1e-3))
    expected = differentiate(CartesianPendulum(), 1.0, integrator)
    monkeypatch.setattr(HHT, "_rough", lambda self: HHT(AdaptiveSteps(1e-3, max_steps=3)))
    run = differentiate(CartesianPendulum(), 1.0, integrator)
    assert run.outcome.success
    assert abs(run.statistics.steps - expected.statistics.steps) <= 2
