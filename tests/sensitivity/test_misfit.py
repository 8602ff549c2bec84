"""Misfit to measured data: residuals, Jacobian, and what SciPy finds with them."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

from ancfdae import (
    HHT,
    IDA,
    AtTimes,
    Beam,
    ComplexStep,
    DesignVariable,
    DirectDifferentiation,
    Material,
    Misfit,
    Pin,
    Scene,
    assemble,
    gradient,
    simulate,
)
from ancfdae.errors import (
    FailedDesignWarning,
    InvalidInputError,
    NonFiniteObjectiveError,
    UnfinishedRunError,
    UnknownNameError,
)
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.observables.mass import mass
from ancfdae.sensitivity.observables.observable import observe, states_of
from ancfdae.sensitivity.observables.points import position, slope_angle
from ancfdae.sensitivity.observables.quantities import elapsed_time, reaction

RUBBER = Material(density=1100.0, youngs_modulus=2e6, poisson_ratio=0.3, damping_time=2e-3)
STEP, END = 2**-7, 0.5
TIMES = np.array([0.05, 0.11, 0.2, 0.25, 0.31, 0.4, 0.47])
DESIGN = [
    DesignVariable("E", ["rod.youngs_modulus"], (1e5, 1e8)),
    DesignVariable("tau", ["rod.damping_time"], (0.0, 0.1)),
    DesignVariable("rho", ["rod.density"], (100.0, 1e4)),
]


def pendulum(**changes):
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 3, Rectangle(0.06, 0.04), RUBBER)
    rod = dataclasses.replace(rod, material=dataclasses.replace(RUBBER, **changes))
    return Scene([rod], [Pin(rod.at_start, name="pin")], (0.0, -9.81))


ROD = pendulum().beams[0]
SEEN = [position(ROD.at_end, 0), position(ROD.at_end, 1), reaction("pin", 1)]


def record(scene, observables, times, integrator):
    solution, system = simulate(scene, END, integrator), assemble(scene)
    states = states_of(solution)
    return np.array([[AtTimes(x, t).value(system, states) for t in times] for x in observables])


def test_least_squares_finds_what_made_the_data():
    data = record(pendulum(), SEEN, TIMES, HHT(STEP))
    guess = pendulum(youngs_modulus=3e6, damping_time=4e-3, density=900.0)
    fit = Misfit(SEEN, TIMES, data, [[1.0], [1.0], [0.1]]).fit(guess, END, HHT(STEP), design=DESIGN)
    found = least_squares(
        fit.residuals, fit.start, fit.jacobian, fit.bounds, x_scale="jac", xtol=1e-12, ftol=1e-12
    )
    # Newton's method of each step stops at 1e-9 of the motion.
    assert np.allclose(found.x, [2e6, 2e-3, 1100.0], rtol=1e-6)
    assert np.all(fit.covariance(found.x) > -np.inf)


def test_the_recommended_call_finds_a_modulus_in_pascal():
    data = record(pendulum(youngs_modulus=2.1e11), SEEN[:1], TIMES, HHT(STEP))
    misfit = Misfit(SEEN[:1], TIMES, data)
    fit = misfit.fit(pendulum(youngs_modulus=1.5e11), END, HHT(STEP), design=["rod.youngs_modulus"])
    call = fit.residuals, fit.start, fit.jacobian, fit.bounds
    stopped = least_squares(*call, x_scale="jac")
    found = least_squares(*call, x_scale="jac", gtol=None)
    assert stopped.nfev == 1, "gtol=None is no longer needed: say so in the documents"
    # The tolerance xtol, and round-off of a run in which the rod bends by small angles.
    assert found.x == pytest.approx([2.1e11], rel=1e-4)


def test_residuals_and_jacobian_are_those_of_every_measurement():
    data = np.arange(3.0 * len(TIMES)).reshape(3, -1)
    data[1, 2:5] = np.nan
    weights = 1.0 + np.arange(3.0)[:, None]
    for integrator in (HHT(STEP), IDA(rtol=1e-8)):
        fit = Misfit(SEEN, TIMES, data, weights).fit(pendulum(), END, integrator, design=DESIGN)
        residuals, J = fit.residuals(fit.start), fit.jacobian(fit.start)
        assert residuals.shape == (18,)
        assert J.shape == (18, 3)
        rows = [(i, k) for i in range(3) for k in range(len(TIMES)) if not np.isnan(data[i, k])]
        for number in (0, 8, 17):
            i, k = rows[number]
            single = AtTimes(SEEN[i], TIMES[k])
            exact = gradient(
                pendulum(), single, END, integrator, design=DESIGN, method=DirectDifferentiation()
            )
            expected = weights[i, 0] * (exact.value - data[i, k])
            assert residuals[number] == pytest.approx(expected, rel=1e-9)
            assert np.allclose(J[number], weights[i, 0] * exact.gradient, rtol=1e-9, atol=0)


def test_the_jacobian_is_that_of_the_complex_step():
    # Interpolated between steps, too.
    fit = Misfit(SEEN, TIMES, np.zeros((3, len(TIMES)))).fit(
        pendulum(), END, HHT(STEP), design=DESIGN
    )
    J = fit.jacobian(fit.start).reshape(3, len(TIMES), 3)
    for i in range(3):
        objective = AtTimes(SEEN[i], TIMES[1:4])
        found = gradient(pendulum(), objective, END, HHT(STEP), design=DESIGN, method=ComplexStep())
        assert np.allclose(J[i, 1:4].sum(axis=0), found.gradient, rtol=1e-9, atol=0)


def test_between_steps_values_differ_from_the_solution_by_less_than_the_run_errs():
    fine = simulate(pendulum(), END, HHT(2.0**-11))
    apart = []
    for h in (2.0**-6, 2.0**-7):
        run, times = simulate(pendulum(), END, HHT(h)), np.arange(2.5, 0.4 / h, 3.0) * h
        fit = Misfit(SEEN[:2], times, np.zeros((2, len(times)))).fit(
            pendulum(), END, HHT(h), design=DESIGN
        )
        four = fit.residuals(fit.start).reshape(2, -1)
        smooth, exact = (np.array([observe(x, s.at(times)) for x in SEEN[:2]]) for s in (run, fine))
        change = np.array([observe(x, run) for x in SEEN[:2]])
        # Differences four times over a step, over its fourth power, are the fourth derivative.
        # In the middle the cubic of the solution is off by 1/384 of it, that through four by 9/384.
        most = np.abs(np.diff(change, 4)).max(axis=1) * 10 / 384
        assert np.all(np.abs(four - smooth).max(axis=1) < 1.5 * most)
        apart.append(np.abs(four - smooth).max())
        assert apart[-1] < 0.03 * np.abs(smooth - exact).max()
    # Fourth order; the time points differ.
    assert 8 < apart[0] / apart[1] < 32


def test_both_functions_share_one_run_per_design():
    fit = Misfit([SEEN[0]], [0.1], [[0.5]]).fit(pendulum(), END, HHT(STEP), design=DESIGN)
    fit.residuals(fit.start)
    run = fit.solution(fit.start)
    fit.jacobian(fit.start.copy())
    assert fit.solution(fit.start) is run
    fit.residuals(1.01 * fit.start)
    assert fit.solution(1.01 * fit.start) is not run
    # What a caller does to the arrays stays with the caller.
    fit.residuals(fit.start)[:] = 7.0
    assert fit.residuals(fit.start)[0] != 7.0


def test_the_covariance_is_that_of_linear_least_squares():
    fit = Misfit(SEEN, TIMES, np.zeros((3, len(TIMES))), 10.0).fit(
        pendulum(), END, HHT(STEP), design=DESIGN
    )
    J = fit.jacobian(fit.start)
    size = np.sqrt(np.sum(J * J, axis=0))
    expected = np.linalg.inv((J / size).T @ (J / size)) / np.outer(size, size)
    # The inverse of a matrix of condition 1e4 or less, squared.
    assert np.allclose(fit.covariance(fit.start), expected, rtol=1e-6, atol=0)
    # 68.27 % of a normal distribution lie within one standard deviation.
    intervals = fit.intervals(fit.start, level=0.6826894921370859)
    assert tuple(intervals) == fit.design_names
    half = np.sqrt(np.diag(expected))
    limits = np.transpose([fit.start - half, fit.start + half])
    assert np.allclose(list(intervals.values()), limits, rtol=1e-6, atol=0)
    with pytest.raises(InvalidInputError, match="level: must be below 1"):
        fit.intervals(fit.start, 95.0)
    # A rod under gravity tells E and rho apart by forces only.
    alone = Misfit([SEEN[0]], [0.4], [[0.0]]).fit(pendulum(), END, HHT(STEP), design=DESIGN)
    assert np.all(np.isinf(alone.covariance(alone.start)))


def test_bounds_are_those_of_the_variables_and_of_what_a_length_can_be():
    fit = Misfit([SEEN[0]], [0.1], [[0.0]]).fit(
        pendulum(), END, HHT(STEP), design=[DESIGN[0], "rod.length"]
    )
    assert np.array_equal(fit.bounds, [[1e5, 0], [1e8, np.inf]])
    assert np.array_equal(fit.start, [2e6, 1.0])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"observables": SEEN[0]}, "observables"),
        ({"observables": ["x"]}, "observables"),
        ({"times": []}, "times"),
        ({"times": [-0.1, 0.2]}, "times"),
        ({"times": [0.1, np.nan]}, "times"),
        ({"data": [0.0, 1.0]}, "data"),
        ({"data": [[np.nan, np.nan]]}, "data"),
        ({"data": [[np.inf, 0.0]]}, "data"),
        ({"weights": [1.0, 2.0, 3.0]}, "weights"),
        ({"weights": np.nan}, "weights"),
    ],
)
def test_what_does_not_fit_together_is_refused(change, text):
    given = {"observables": [SEEN[0]], "times": [0.1, 0.2], "data": [[0.0, 1.0]]} | change
    with pytest.raises(InvalidInputError, match=f"Misfit.{text}"):
        Misfit(**given)


def test_bad_calls_are_refused_in_words():
    misfit = Misfit([reaction("pins", 0)], [0.1], [[0.0]])
    with pytest.raises(UnknownNameError, match="pin"):
        misfit.fit(pendulum(), END, HHT(STEP), design=DESIGN)
    good = Misfit([SEEN[0]], [0.1], [[0.0]])
    with pytest.raises(InvalidInputError, match="design"):
        good.fit(pendulum(), END, HHT(STEP))
    with pytest.raises(InvalidInputError, match="integrator"):
        good.fit(pendulum(), END, 0.01, design=DESIGN)
    with pytest.raises(InvalidInputError, match="let it go on"):
        good.fit(pendulum(), 0.05, HHT(STEP), design=DESIGN)
    fit = good.fit(pendulum(), END, HHT(STEP), design=DESIGN)
    with pytest.raises(InvalidInputError, match="design values"):
        fit.residuals([1e6, 1e-3])
    with pytest.raises(InvalidInputError, match="'E': must be positive"):
        fit.residuals([-1e6, 1e-3, 1e3])
    infinite = Misfit([1.0 / (elapsed_time() - 0.0)], [0.1], [[0.0]])
    with pytest.raises(NonFiniteObjectiveError):
        infinite.fit(pendulum(), END, HHT(STEP), design=DESIGN).residuals(fit.start)


def test_a_fit_steps_back_from_designs_without_residuals():
    """Densities are positive; Newton's step for a root of the mass goes from 3000 to -1900."""
    root = [np.sqrt(mass("rod"))]
    data = record(pendulum(density=100.0), root, [0.05], HHT(STEP))
    fit = Misfit(root, [0.05], data).fit(
        pendulum(density=3000.0),
        2**-4,
        HHT(STEP),
        # The other variable makes the first trust region so large that it holds this step.
        design=["rod.density", "rod.youngs_modulus"],
    )
    assert fit.design_names == ("rod.density", "rod.youngs_modulus")
    with pytest.warns(FailedDesignWarning, match=r"'rod.density': -\d.* has no values: .*positive"):
        found = least_squares(fit.residuals, fit.start, fit.jacobian, gtol=None)
    assert found.x == pytest.approx([100.0, 2e6], rel=1e-3)
    with pytest.warns(FailedDesignWarning):
        assert np.all(np.isposinf(fit.residuals([-1.0, 2e6])))
    assert np.all(np.isnan(fit.jacobian([-1.0, 2e6])))
    for call in (fit.solution, fit.covariance):
        with pytest.raises(InvalidInputError, match="must be positive"):
            call([-1.0, 2e6])


def test_a_run_that_ends_early_is_told():
    stiff = HHT(STEP, max_iterations=1)
    fit = Misfit([slope_angle(ROD.at_end)], [0.4], [[0.0]]).fit(
        pendulum(), END, stiff, design=DESIGN
    )
    with pytest.raises(UnfinishedRunError):
        fit.residuals(fit.start)
