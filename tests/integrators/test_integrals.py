"""Integrals of the paths of high order: the tolerance rules them, not the reported instants."""

import dataclasses
import functools

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    Adjoint,
    Beam,
    DirectDifferentiation,
    FiniteDifference,
    Integral,
    Material,
    Pin,
    PointForce,
    Scene,
    SmoothMaximum,
    Terminal,
    assemble,
    differentiate,
    error_bars,
    gradient,
    work_precision,
)
from ancfdae.errors import Interrupted, NonFiniteObjectiveError
from ancfdae.integrators.integrator import Points
from ancfdae.integrators.quadrature import KRONROD, SHARES
from ancfdae.integrators.sundials.index_reduced import _between, _panels
from ancfdae.laws import Harmonic
from ancfdae.observables import custom, multiplier, position, reaction
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.objectives.reductions import Total
from ancfdae.sensitivity.observables.observable import states_of
from ancfdae.sensitivity.observables.quantities import elapsed_time
from tests.support.mechanisms import CartesianPendulum
from validation.external.slider_crank import SliderCrank, kinetic_energy_integral
from validation.scenes import crank_slider

RTOL = 1e-6
KINDS = [
    pytest.param(IDA, id="IDA"),
    pytest.param(IDAS, id="IDAS", marks=pytest.mark.idas),
    pytest.param(DOP853, id="DOP853"),
]


ROD = Beam("rod", (0.0, 0.0), (1.2, 0.0), 3, Rectangle(0.05, 0.05), Material(4000, 1e8, 0.3))


def soft_pendulum():
    scene = Scene([ROD], [Pin(ROD.at_start, name="pin")], gravity=(0.0, -9.81))
    return assemble(scene, ("rod.youngs_modulus", "rod.density"))


def crank():
    return assemble(crank_slider(), ("crank.youngs_modulus",))


TIP = position(ROD.at_end, 0)
SLIDER = position(crank_slider().beams[1].at_end, 0)
CASES = {
    "pendulum": (soft_pendulum, Integral((TIP - 0.3) ** 2), 0.05),
    "crank-slider": (crank, Integral((SLIDER - 1.8) ** 2), 2.0**-7),
    "smooth maximum": (soft_pendulum, SmoothMaximum(TIP, 30.0), 0.05),
    "function": (
        soft_pendulum,
        Integral(TIP) ** 2 * Terminal(TIP) + SmoothMaximum(-TIP, 5.0),
        0.05,
    ),
    "multipliers": (
        CartesianPendulum,
        Integral(custom(lambda t, q, v, lam, b: lam[:, 0] ** 2)),
        2.0,
    ),
}


def numbers(found):
    return np.array([found.value, *found.gradient])


@functools.cache
def of_many_panels(build, t_end, integrator):
    """A system with its run in many panels, for all objectives of it."""
    system = build()
    return system, differentiate(system, t_end, integrator)


def over_panels(system, objective, solution):
    """Value and gradient by quadrature over the instants of a run."""
    partials, s = objective.partials(system, states_of(solution)), solution.sensitivities
    total = partials.b
    for rows, x_b in ((partials.q, s.q_b), (partials.v, s.v_b), (partials.lam, s.lam_b)):
        if rows is not None:
            total = total + np.tensordot(rows, x_b, axes=2)
    return np.array([partials.value, *total])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", CASES)
def test_one_interval_gives_what_a_thousand_panels_give(name, kind):
    build, objective, t_end = CASES[name]
    system, run = of_many_panels(build, t_end, kind(RTOL, intervals=256))
    ours = numbers(
        gradient(system, objective, t_end, kind(RTOL, intervals=1), method=DirectDifferentiation())
    )
    panels = over_panels(system, objective, run)
    # Both are integrals of the same steps, each within its own error of the order of RTOL; the
    # nine instants of one panel alone miss the gradient by 1e-3 to 1.
    assert np.max(np.abs(ours / panels - 1)) < 10 * RTOL


@pytest.mark.idas
@pytest.mark.parametrize("name", ["pendulum", "function", "multipliers"])
def test_adjoint_of_idas_takes_densities_at_its_own_states(name):
    build, objective, t_end = CASES[name]
    t_end /= 4
    exact = gradient(build(), objective, t_end, DOP853(1e-10)).gradient
    found = gradient(build(), objective, t_end, IDAS(1e-8, intervals=1), method=Adjoint()).gradient
    # The error of a run is 10 to 200 times the tolerance, and there are two, forward and back.
    assert np.max(np.abs(found / exact - 1)) < 1e-5


def test_differences_of_runs_see_the_same_integral():
    system, objective = CartesianPendulum(), Integral(custom(lambda t, q, v, lam, b: q[:, 0] ** 2))
    integrator = DOP853(1e-12, intervals=1)
    exact = gradient(system, objective, 5.0, integrator)
    found = gradient(
        system, objective, 5.0, integrator, method=FiniteDifference(1e-4, central=True)
    )
    assert found.value == pytest.approx(exact.value, rel=1e-10)  # other steps, same tolerance
    # Central differences of 1e-4 leave 1e-8 times third derivatives, large after some swings.
    np.testing.assert_allclose(found.gradient, exact.gradient, rtol=1e-6)


@pytest.mark.parametrize("kind", [IDA, DOP853])
@pytest.mark.parametrize("sharpness", [30.0, 3000.0])
def test_integrands_sharper_than_the_motion_are_resolved(kind, sharpness):
    # exp(3000 x) has a peak of 1e-2 s, passed in one step or two; the steps of DOP853 are 0.1 s.
    objective = SmoothMaximum(custom(lambda t, q, v, lam, b: q[:, 0]), sharpness)
    system, fine = of_many_panels(CartesianPendulum, 2.0, kind(1e-8, intervals=400))
    panels = over_panels(system, objective, fine)
    found = numbers(gradient(system, objective, 2.0, kind(1e-8, intervals=1)))
    # Errors of x between steps, of the order of the tolerance, change exp(k x) by k times as much.
    assert np.max(np.abs(found / panels - 1)) < 10 * sharpness * 1e-8


@pytest.mark.parametrize("kind", KINDS)
def test_error_bars_hold(kind):
    system, objective, t_end = soft_pendulum(), CASES["pendulum"][1], 0.05
    exact = numbers(gradient(system, objective, t_end, DOP853(1e-11)))
    held = []
    for rtol in (2e-5, 1.3e-5, 1e-5, 7e-6):
        found = error_bars(system, objective, t_end, kind(rtol, intervals=1))
        error = np.abs(numbers(found) - exact)
        bar = np.array([found.value_bar, *found.gradient_bar])
        held.append(error <= bar + 1e-13 * np.abs(exact))
    # A bar is the difference of two runs, and these may err alike by chance: of IDA two of twelve,
    # in the derivative that is below the tolerance.
    assert np.sum(held) >= 10, held


def test_tradeoff_ranks_by_the_integral_itself():
    objective = Integral(custom(lambda t, q, v, lam, b: q[:, 0] ** 2))
    rough, fine, finest = work_precision(
        CartesianPendulum(),
        objective,
        2.0,
        [HHT(2.0**-5), HHT(2.0**-8), IDA(1e-9, intervals=1)],
        reference=DOP853(1e-10, intervals=1),
    ).rows
    assert finest.gradient < fine.gradient < 0.1 * rough.gradient
    assert finest.objective < fine.objective < 0.1 * rough.objective


# ---- cost


class Counted(SliderCrank):
    """Counts how often forces are evaluated, moved systems included."""

    forces = 0

    def force(self, t, q, v):
        Counted.forces += 1
        return super().force(t, q, v)


def forces_of(call, *arguments, **options):
    Counted.forces = 0
    call(*arguments, **options)
    return Counted.forces


SQUARED_MULTIPLIER = Integral(custom(lambda t, q, v, lam, b: lam[:, 0] ** 2, "multiplier"))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("objective", "most"),
    # Without multipliers no state between the steps needs the system. With them it costs a solve.
    [(kinetic_energy_integral(), 1.02), (SQUARED_MULTIPLIER, 1.5)],
    ids=["energy", "multiplier"],
)
def test_integrals_of_a_system_of_ones_own_cost_little_beside_its_motion(kind, objective, most):
    system, integrator = Counted(), kind(1e-8, intervals=64)
    motion = forces_of(differentiate, system, 2.0, integrator)
    both = forces_of(gradient, system, objective, 2.0, integrator, method=DirectDifferentiation())
    # DOP853 keeps the dense output of steps whose stages are too few: three stages beside twelve,
    # and the repetition of the first steps that need it.
    assert motion <= both < (max(most, 1.3) if kind is DOP853 else most) * motion


def test_steps_whose_stages_are_too_few_are_not_all_repeated():
    system, integrator = CartesianPendulum(), DOP853(1e-8, intervals=1)
    objective = Integral(custom(lambda t, q, v, lam, b: np.sin(20 * q[:, 0])))
    plain = differentiate(system, 5.0, integrator)
    run = gradient(system, objective, 5.0, integrator).solution
    # Dense output takes three evaluations beside the twelve or more of a step, a repetition 16:
    # a quarter more; three quarters where every step is repeated.
    assert plain.statistics.residuals < run.statistics.residuals < 1.3 * plain.statistics.residuals


@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=pytest.mark.idas)])
def test_reactions_to_forces_that_move_nothing_are_seen_between_the_steps(kind):
    # A force on the pin itself: the solver's steps of 2e-5 s do not follow its period of 3e-5 s.
    force, t_end = 500.0, 0.02
    design = ("rod.youngs_modulus",)
    quiet = Scene([ROD], [Pin(ROD.at_start, name="pin")], gravity=(0.0, -9.81))
    hidden = PointForce(ROD.at_start, (0.0, force), law=Harmonic(1.0, 2e5))
    loaded = dataclasses.replace(quiet, loads=[hidden])
    squared = Integral(reaction("pin", 1) ** 2)
    found, without = (
        gradient(
            assemble(scene, design), squared, t_end, kind(1e-5), method=DirectDifferentiation()
        )
        for scene in (loaded, quiet)
    )
    # Of 4000 rad the mean of sin^2 is 1/2 to 1e-4; the product with the other reaction, of 100 N,
    # is left by an end at most: 2 F R / omega. Polynomials through the steps are wrong by 0.1.
    assert found.value - without.value == pytest.approx(force**2 * t_end / 2, rel=1e-3)


@pytest.mark.parametrize("kind", [IDA, DOP853])
def test_a_function_may_read_multipliers_later(kind):
    system, integrator = CartesianPendulum(), kind(1e-8, intervals=1)
    late = custom(lambda t, q, v, lam, b: np.where(t < 1.5, q[:, 0], q[:, 0] + 0 * lam[:, 0]))
    plain = custom(lambda t, q, v, lam, b: q[:, 0])
    found, exact = (numbers(gradient(system, Integral(x), 2.0, integrator)) for x in (late, plain))
    np.testing.assert_allclose(found, exact, rtol=1e-13)  # the same numbers at the same points


# ---- rules


def test_the_rule_of_a_panel_is_of_degree_nine_and_its_estimate_of_degree_five():
    t = SHARES
    for k in range(10):
        assert KRONROD.weights @ t**k == pytest.approx(1 / (k + 1), rel=1e-14)
    assert abs(KRONROD.weights @ t**10 - 1 / 11) > 1e-8
    for k in range(6):
        assert abs(KRONROD.error @ t**k) < 1e-15
    assert abs(KRONROD.error @ t**6) > 1e-5
    for k in range(4):
        assert abs(KRONROD.coarse @ t**k) < 1e-15
    assert abs(KRONROD.coarse @ t**4) > 1e-3


def test_steps_are_joined_by_quintics():
    t = np.array([0.0, 0.3, 0.4, 1.0])
    power = np.arange(6)

    def motion(t):
        q = t[:, None] ** power
        v = power * t[:, None] ** np.maximum(power - 1, 0)
        return q, v, power * (power - 1) * t[:, None] ** np.maximum(power - 2, 0)

    q, v, a = (x[:, None] for x in motion(t))
    times = np.array([0.0, 0.1, 0.3, 0.35, 0.77, 1.0])
    step = np.array([0, 0, 1, 1, 2, 2])
    found = _between(times, t, step, q, (np.diff(q, axis=0), v[:-1], v[1:], a[:-1], a[1:]))
    for ours, exact in zip(found, motion(times), strict=False):
        np.testing.assert_allclose(ours[:, 0], exact, rtol=1e-13, atol=1e-14)


def test_panels_cover_the_steps():
    t = np.array([0.0, 1.0, 2.0, 4.0])
    np.testing.assert_array_equal(_panels(t, 0.5), [0.0, 2.0, 4.0])
    np.testing.assert_array_equal(_panels(t, 1 / 8), [0.0, 4.0])
    np.testing.assert_array_equal(_panels(t, 2), [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0])


def test_errors_of_panels_do_not_cancel():
    h, x = np.array([1.0, 1.0]), np.concatenate([SHARES**6, -(SHARES**6)])[:, None]
    nothing = np.zeros((14, 0))
    points = Points(KRONROD, h, np.zeros(14), nothing, nothing)
    fine, coarse = abs(KRONROD.error @ SHARES**6), abs(KRONROD.coarse @ SHARES**6)
    assert points.errors(x)[0] == pytest.approx(2 * fine**2 / np.hypot(fine, 0.1 * coarse))


def estimated(values, h):
    nothing = np.zeros((len(values), 0))
    points = Points(KRONROD, np.array([h]), np.zeros(len(values)), nothing, nothing)
    return points.errors(values[:, None])[0]


@pytest.mark.parametrize("share", [0.5, 1e-4])
def test_errors_of_derivatives_are_relative_to_them_or_to_a_hundredth_of_the_value(share):
    observable = custom(lambda t, q, v, lam, b: 1 + share * b[0] * t**6)
    total = Total(CartesianPendulum(b=(2.0, 9.81)), Integral(observable), differentiated=True)
    # The value is 1 + 2 share/7, its derivative in ln b_0 2 share/7: 12 and 3e-3 per cent of it.
    scale = max(2 * share / 7, 1e-2 * (1 + 2 * share / 7))
    error = 2 * share * estimated(SHARES**6, 1.0)
    assert total.part(panel(1.0)).error == pytest.approx(error / scale, rel=1e-9, abs=0)


def test_errors_are_relative_to_a_usual_part_of_the_same_duration():
    total = Total(CartesianPendulum(), Integral(custom(lambda t, *_: t**6)), differentiated=False)
    large, small = panel(2.0), panel(1e-3)
    total.add(total.part(large))
    # The first part has the size 2^7/7 in 2 s; in 1e-3 s one would have 5e-4 of it.
    usual = 2.0**7 / 7 * 1e-3 / 2
    error = estimated(small.t**6, 1e-3)
    assert total.part(small).error == pytest.approx(error / usual, rel=1e-9, abs=0)


def panel(h):
    """Points of one panel from zero to h."""
    nothing = np.zeros((7, 2))
    return Points(KRONROD, np.array([h]), h * SHARES, nothing, nothing)


# ---- trouble


def test_a_value_that_is_not_finite_is_named_with_its_time():
    objective = Integral(np.sqrt(0.5 - elapsed_time()))
    for kind in (IDA, DOP853):
        with pytest.raises(NonFiniteObjectiveError, match="the observable is not finite") as caught:
            gradient(CartesianPendulum(), objective, 1.0, kind(1e-6))
        assert caught.value.time == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("kind", [IDA, DOP853])
def test_an_interrupt_in_an_integrand_keeps_the_run(kind):
    def x(t, q, v, lam, b):
        if np.any(t.real > 1.0):
            raise KeyboardInterrupt
        return q[:, 0]

    with pytest.raises(Interrupted) as caught:
        gradient(CartesianPendulum(), Integral(custom(x)), 4.0, kind(1e-6))
    assert caught.value.result.outcome.verdict is Verdict.INTERRUPTED
    assert caught.value.result.t[-1] > 0.0


@pytest.mark.parametrize(
    "leaf", [multiplier("pin", 0), reaction("pin", 1), custom(lambda *x: x[3][:, 0])]
)
def test_leaves_that_read_multipliers_say_so(leaf):
    # Without their word multipliers are not given: the integral is then not a number.
    for integrator in (DOP853(1e-6, intervals=1), IDA(1e-6, intervals=1)):
        found = gradient(soft_pendulum(), Integral(leaf**2), 2.0**-10, integrator)
        assert np.all(np.isfinite(numbers(found)))
