"""Misfit to deflections and natural frequencies, and to several experiments at once."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

from ancfdae import (
    HHT,
    AtTimes,
    Beam,
    Clamp,
    FrequencyMisfit,
    Material,
    Misfit,
    Pin,
    PointForce,
    Scene,
    StaticMisfit,
    assemble,
    equilibrium,
    equilibrium_gradient,
    modes,
    simulate,
)
from ancfdae.errors import FailedDesignWarning, InvalidInputError
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.observables.observable import states_of
from ancfdae.sensitivity.observables.points import position

RUBBER = Material(density=1100.0, youngs_modulus=2e6, poisson_ratio=0.3, damping_time=2e-3)
DESIGN = ["rod.youngs_modulus", "rod.density", "rod.damping_time"]
STEP, END = 2**-7, 0.25


def shelf(joint=Clamp, **changes):
    material = dataclasses.replace(RUBBER, **changes)
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 3, Rectangle(0.06, 0.04), material)
    return Scene([rod], [joint(rod.at_start, name="held")], (0.0, -9.81))


TIP = position(shelf().beams[0].at_end, 1)
GUESS = {"youngs_modulus": 3e6, "density": 900.0, "damping_time": 4e-3}


def tip_at_rest(scene):
    return float(equilibrium(scene).solution.position(scene.beams[0].at_end)[-1, 1])


def test_residuals_at_rest_are_those_of_the_equilibrium():
    fit = StaticMisfit([TIP, TIP], [-0.1, np.nan], [3.0, 1.0]).fit(shelf(), design=DESIGN)
    exact = equilibrium_gradient(shelf(), TIP, design=DESIGN)
    assert fit.residuals(fit.start) == pytest.approx([3.0 * (exact.value + 0.1)], rel=1e-12)
    assert fit.jacobian(fit.start) == pytest.approx(3.0 * exact.gradient[None], rel=1e-12)


@pytest.mark.parametrize(("joint", "under_load"), [(Clamp, True), (Clamp, False), (Pin, False)])
def test_jacobian_of_frequencies_is_that_of_differences_of_the_residuals(joint, under_load):
    # A pinned rod turns freely: its rigid motion is not counted.
    data = [10.0, np.nan, 50.0]
    fit = FrequencyMisfit(data, [1.0, 1.0, 2.0], under_load).fit(shelf(joint), design=DESIGN[:2])
    J = fit.jacobian(fit.start)
    assert J.shape == (2, 2)
    for k, b in enumerate(fit.start):
        step = 1e-4 * b * np.eye(2)[k]
        change = fit.residuals(fit.start + step) - fit.residuals(fit.start - step)
        # 1e-4 squared, and 1e-11 of a frequency over 1e-4.
        assert J[:, k] == pytest.approx(change / (2e-4 * b), rel=1e-6)


def test_only_vibrations_are_compared_with_measured_frequencies():
    """A free beam: pi 22.3733 Euler's unit, behind three rigid motions and before what decays."""
    material = Material(1000.0, 1e9, 0.0, damping_time=1e-4)
    free = Beam("rod", (0.0, 0.0), (1.0, 0.0), 8, Rectangle(0.01, 0.01), material)
    first, second = np.array([22.37329, 61.67282]) * np.sqrt(1e9 * 0.01**2 / 12 / 1000.0)
    fit = FrequencyMisfit([first, second]).fit(Scene([free]), design=["rod.density"])
    # Shear, rotary inertia and eight elements: 1e-3 of each.
    assert fit.residuals(fit.start) == pytest.approx([0.0, 0.0], abs=3e-3 * first)
    # omega ~ rho^(-1/2)
    expected = -np.array([[first], [second]]) / 2 / 1000.0
    assert fit.jacobian(fit.start) == pytest.approx(expected, rel=3e-3)


def test_frequencies_are_those_of_modes():
    found = modes(shelf(), 2).natural_frequencies
    fit = FrequencyMisfit(np.add(found, [0.5, -0.25])).fit(shelf(), design=DESIGN)
    assert fit.residuals(fit.start) == pytest.approx([-0.5, 0.25], abs=1e-9 * found[1])


def test_several_experiments_find_what_none_of_them_finds():
    truth, guess = shelf(), shelf(**GUESS)
    # A known force bends the rod without its weight: E; frequencies: E/rho; a run: the damping.
    pushed, pushed_guess = (
        dataclasses.replace(x, gravity=(0.0, 0.0), loads=[PointForce(x.beams[0].at_end, (0, 0.2))])
        for x in (truth, guess)
    )
    times = np.array([0.05, 0.1, 0.15, 0.2, 0.24])
    motion = simulate(truth, END, HHT(STEP))
    # As `Misfit` does between the steps.
    states, system = states_of(motion), assemble(truth)
    swing = [AtTimes(TIP, t).value(system, states) for t in times]
    deflection = StaticMisfit([TIP], [tip_at_rest(pushed)], 1e6).fit(pushed_guess, design=DESIGN)
    sound = FrequencyMisfit(modes(truth, 2).natural_frequencies, 1e3).fit(guess, design=DESIGN)
    run = Misfit([TIP], times, [swing], 1e6).fit(guess, END, HHT(STEP), design=DESIGN)
    fit = deflection + sound + run
    # One of its first steps makes the damping negative: the search steps back.
    with pytest.warns(FailedDesignWarning, match="must not be negative"):
        found = least_squares(
            fit.residuals, fit.start, fit.jacobian, x_scale="jac", gtol=None, xtol=1e-12
        )
    # Newton's method of each step stops at 1e-9 of the motion.
    assert found.x == pytest.approx([2e6, 1100.0, 2e-3], rel=1e-6)
    for name, (low, high) in fit.intervals(found.x).items():
        value = found.x[DESIGN.index(name)]
        assert low < value < high
        # More experiments tell more.
        one = (sound + run).intervals(found.x)[name]
        assert high - low < one[1] - one[0]


def test_a_design_out_of_range_is_stepped_back_from():
    fit = StaticMisfit([TIP], [-0.1]).fit(shelf(), design=DESIGN[:1])
    total = fit + FrequencyMisfit([10.0]).fit(shelf(), design=DESIGN[:1])
    assert np.all(np.isfinite(total.residuals(total.start)))
    with pytest.warns(FailedDesignWarning):
        assert np.all(np.isinf(total.residuals([-1.0])))
    with pytest.raises(InvalidInputError):
        total.covariance([-1.0])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: StaticMisfit([TIP], [0.1, 0.2]), "one per observable"),
        (lambda: StaticMisfit([TIP], "ab"), "must be numbers"),
        (lambda: StaticMisfit([TIP], [0.1], [1.0, 2.0]), "spread"),
        (lambda: FrequencyMisfit([np.nan]), "some of them finite"),
        (lambda: FrequencyMisfit([1.0], under_load=1), "under_load"),
        (lambda: FrequencyMisfit(np.arange(40.0)).fit(shelf(), design=DESIGN).residuals(
            [2e6, 1100.0, 2e-3]), "vibrations that the model has"),
        (lambda: FrequencyMisfit([1.0]).fit(shelf(), design=DESIGN)
            + StaticMisfit([TIP], [0.1]).fit(shelf(), design=DESIGN[:1]), "same start"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(call, words):
    with pytest.raises(InvalidInputError, match=words):
        call()
