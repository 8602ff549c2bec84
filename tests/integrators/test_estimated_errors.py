"""What a run of HHT-I3 tells about its own errors."""

import math
import re

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    AdaptiveSteps,
    ComplexStep,
    Terminal,
    assemble,
    differentiate,
    error_bars,
    load_solution,
    simulate,
)
from ancfdae.extend import FormulaSystem, MaterialPoint, SystemProperties
from ancfdae.observables import custom
from ancfdae.results import ErrorEstimates
from tests.support.mechanisms import CartesianPendulum
from validation.external.slider_crank import SliderCrank
from validation.scenes import pendulum
from validation.tolerance.generator import case


def soft():
    return assemble(pendulum(), ("pendulum.height", "pendulum.density"))


def rms(x):
    return np.sqrt(np.mean(x**2, axis=1))


def true_errors(system, run, exact):
    root, same = np.sqrt(system.weights), run.at(exact.t[1:-1])
    motion = rms((same.q - exact.q[1:-1]) * root).max() / rms(exact.q[:1] * root)[0]
    ours, theirs = (x.sensitivities.q_b * root[:, None] for x in (same, exact))
    return motion, rms(ours - theirs[1:-1]).max(axis=0) / rms(theirs).max(axis=0)


@pytest.mark.parametrize(
    ("build", "t_end", "settings"),
    [
        (CartesianPendulum, 2.0, [HHT(2.0**-4), HHT(2.0**-8), HHT(rtol=1e-3)]),
        (SliderCrank, 10.0, [HHT(2.0**-2), HHT(2.0**-5, hht_alpha=-0.05), HHT(rtol=1e-3)]),
        # At 2^-6 s the waves of the soft beam are not resolved: q is right to 1e-3, q_b to 0.2.
        (soft, 0.25, [HHT(2.0**-6), HHT(2.0**-9), HHT(AdaptiveSteps(1e-2, sensitivities=True))]),
    ],
)
def test_estimates_are_of_the_size_of_the_errors(build, t_end, settings):
    system = build()
    exact = differentiate(system, t_end, DOP853(1e-7))
    for integrator in settings:
        run = differentiate(system, t_end, integrator)
        motion, derivatives = true_errors(system, run, exact)
        assert 1 / 3 < run.estimated_errors.motion / motion < 3, integrator
        ratios = np.array(run.estimated_errors.derivatives) / derivatives
        assert np.all((ratios > 1 / 5) & (ratios < 5)), (integrator, ratios)


def test_first_steps_of_a_stiff_damped_beam_are_unremarkable():
    # Its waves decay within a millionth of the step, which once threw the middle 0.1 m off.
    stiff = assemble(pendulum(youngs_modulus=2e11, damping_time=1e-3), ())
    for step, steps in ((2.0**-6, 1), (2.0**-7, 4)):
        run = simulate(stiff, steps * step, HHT(step, hht_alpha=-0.1))
        away = abs(np.linalg.norm(run.position(MaterialPoint("pendulum", 0.5))[-1]) - 0.6)
        # The rod bends and stretches by less than a micrometre.
        assert away < 1e-6
        assert run.estimated_errors.motion < 1e-3


def test_a_run_that_is_far_off_says_so():
    # Seven steps per swing.
    coarse = simulate(CartesianPendulum(), 2.0, HHT(0.25))
    fine = simulate(CartesianPendulum(), 2.0, HHT(2.0**-10))
    away = np.linalg.norm(coarse.q[-1] - fine.q[-1]) / np.linalg.norm(fine.q[-1])
    assert away > 0.05
    assert coarse.estimated_errors.motion > away / 5


def test_a_run_says_where_errors_grow_that_its_estimates_leave_out():
    """Ends of a spring nearly meet: errors of positions become errors of velocities.

    The error grows from then on, while what is added up does not.
    """
    linkage = case("kinked", 6)
    run = simulate(linkage.system, linkage.t_end, HHT(rtol=1e-3))
    exact = simulate(linkage.system, linkage.t_end, DOP853(1e-9))
    root, same = np.sqrt(linkage.system.weights), run.at(exact.t[1:-1])
    off = rms((same.q - exact.q[1:-1]) * root) / rms(exact.q[:1] * root)[0]
    (said,) = re.findall(r"steps fell to 1/\d+ at t = ([\d.]+):", repr(run))
    before = off[same.t < float(said)].max()
    assert off.max() > 3 * before
    assert off.max() > 2 * run.estimated_errors.motion
    # Nothing of it where steps are given, where a run is sampled, and in a smooth one.
    for other in (
        simulate(linkage.system, linkage.t_end, HHT(linkage.t_end / 200)),
        run.at([0.0, 0.1, 0.1001, 0.3]),
        simulate(CartesianPendulum(), 2.0, HHT(rtol=1e-3)),
    ):
        assert "steps fell" not in repr(other)


def test_a_variable_without_influence_has_no_error():
    # In the plane the width cancels.
    system = assemble(pendulum(), ("pendulum.width", "pendulum.height"))
    errors = differentiate(system, 2.0**-5, HHT(2.0**-8)).estimated_errors
    assert math.isnan(errors.derivatives[0])
    assert errors.derivatives[1] > 0


def test_motion_alone_has_no_error_of_derivatives():
    run = simulate(CartesianPendulum(), 1.0, HHT(2.0**-5))
    both = differentiate(CartesianPendulum(), 1.0, HHT(2.0**-5))
    assert run.estimated_errors.derivatives is None
    assert run.estimated_errors.motion == both.estimated_errors.motion > 0
    assert simulate(CartesianPendulum(), 1.0, DOP853(1e-4)).estimated_errors is None
    other = differentiate(CartesianPendulum(), 1.0, HHT(2.0**-5), method=ComplexStep())
    assert other.estimated_errors.motion == pytest.approx(run.estimated_errors.motion, rel=1e-9)


class Runaway(FormulaSystem):
    """A coordinate that grows exponentially, by 1e6 b1 b2 times itself."""

    n_q, n_lam = 1, 0
    design_names = ("b1", "b2")
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def with_values(self, b):
        return Runaway(b)

    def start(self):
        return np.ones(1), np.zeros(1)

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return 1e6 * self.b[0] * self.b[1] * q

    def position_constraint(self, t, q):
        return np.zeros(0)


@pytest.mark.filterwarnings("ignore:the errors of this run:ancfdae.errors.StabilityWarning")
def test_what_blew_up_has_infinite_errors():
    # Squares of the coordinates, 1e160 in the end, are no numbers; no error may pass for none.
    system, step = Runaway((1.0, 1.0)), 2.0**-10
    run = differentiate(system, 340 * step, HHT(step))
    assert run.outcome.success
    assert np.max(run.q) > 1e160
    assert run.estimated_errors == ErrorEstimates(math.inf, (math.inf, math.inf))
    place = Terminal(custom(lambda t, q, v, lam, b: q[:, 0] / 1e160, "place"))
    assert error_bars(system, place, 340 * step, HHT(step)).resolved is False


def test_files_keep_them(tmp_path):
    run = differentiate(CartesianPendulum(), 1.0, HHT(2.0**-5))
    again = load_solution(run.save(tmp_path / "run.npz"))
    assert again.estimated_errors == run.estimated_errors
    plain = simulate(CartesianPendulum(), 1.0, DOP853(1e-4))
    assert load_solution(plain.save(tmp_path / "plain.npz")).estimated_errors is None
