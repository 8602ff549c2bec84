"""Stiffness and damping found from a noisy record, and how often their intervals hold."""

from typing import Final

import numpy as np
from scipy.optimize import least_squares

from ancfdae import HHT, Beam, Clamp, DesignVariable, Material, Misfit, Scene, simulate
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.results import RunResidualFunction
from ancfdae.sections import Rectangle
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Once, Optimisation, searched
from validation.drawing import dots

_TRUE: Final = np.array([2e6, 4e-3])
_NOISE, _STEP, _STEPS = 2e-3, 2.0**-6, 32
# Two standard deviations, and a bit less.
_QUANTILE = 1.959964
_DESIGN: Final = (
    DesignVariable("E", ["rod.youngs_modulus"], (1e5, 1e8)),
    DesignVariable("tau", ["rod.damping_time"], (0.0, 0.1)),
)


def cantilever() -> Scene:
    """Return a rubber strip that falls under its weight."""
    material = Material(1100.0, float(_TRUE[0]), 0.3, damping_time=float(_TRUE[1]))
    rod = Beam("rod", (0, 0), (0.5, 0), 1, Rectangle(0.02, 0.02), material)
    return Scene([rod], [Clamp(rod.at_start)], (0, -9.81))


def record(noise: Array | float) -> RunResidualFunction:
    """Return the fit to a simulated record of the tip with this noise."""
    scene, t_end = cantilever(), _STEP * _STEPS
    tip = scene.beams[0].at_end
    times = (_STEP * np.arange(1, _STEPS + 1)).tolist()
    clean = simulate(scene, t_end, HHT(_STEP)).at(times).position(tip)[:, 1]
    misfit = Misfit([position(tip, 1)], times, (clean + noise)[None], 1 / _NOISE)
    return misfit.fit(scene, t_end, HHT(_STEP), design=_DESIGN)


def gauss_newton(fit: RunResidualFunction, x: Array, iterations: int) -> tuple[Array, Array, int]:
    """Return values over the true ones, where the last run was, and the number of runs."""
    runs = 0
    while runs < iterations:
        runs += 1
        r, J = fit.residuals(_TRUE * x), fit.jacobian(_TRUE * x) * _TRUE
        d = np.linalg.lstsq(J, -r, rcond=None)[0]
        last, x = x, x + d
        # A step of a thousandth of a standard deviation, whose length here is |J d| = 1.
        if np.linalg.norm(J @ d) < 1e-3:
            break
    return x, last, runs


def coverage(records: int) -> tuple[Array, Array, int]:
    """Return estimates over the truth, whether their intervals hold it, and the runs.

    Shapes (records, 2). The run at the truth serves the first step of all.
    """
    noises = _NOISE * np.random.default_rng(7).standard_normal((records, _STEPS))
    truth = record(0.0)
    first = np.linalg.pinv(truth.jacobian(_TRUE) * _TRUE)
    estimates, holds, runs = [], [], 1
    for noise in noises:
        fit = record(noise)
        x, last, count = gauss_newton(fit, 1 + first @ (noise / _NOISE), 2)
        half = _QUANTILE * np.sqrt(np.diag(fit.covariance(_TRUE * last))) / _TRUE
        runs += count
        estimates.append(x)
        holds.append(np.abs(x - 1) <= half)
    return np.array(estimates), np.array(holds), runs


def optimise(fit: RunResidualFunction, start: Array, iterations: int) -> Optimisation:
    """Find stiffness and damping over the true ones, from afar."""
    clock = stopwatch()

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        r, J = fit.residuals(_TRUE * x), fit.jacobian(_TRUE * x) * _TRUE
        return np.array([r @ r / 2]), (J.T @ r)[None]

    result = least_squares(
        lambda x: fit.residuals(_TRUE * x),
        start,
        lambda x: fit.jacobian(_TRUE * x) * _TRUE,
        xtol=1e-10,
        ftol=1e-12,
        max_nfev=iterations,
    )
    seconds = clock()
    evaluate.runs = result.nfev
    return Optimisation.of(evaluate, start, result, seconds)


def identification(quick: bool) -> Case:
    """Return the case of the identification; coarse and short if `quick`."""
    noise = _NOISE * np.random.default_rng(1).standard_normal(_STEPS)
    fit = record(noise)
    found = optimise(fit, np.array([1.5, 0.5]), 2 if quick else 40)
    search = searched(found.evaluate, found.start, 0.2, 5 if quick else 100)
    estimates, holds, runs = coverage(2 if quick else 100)
    shares = 100 * np.mean(holds, axis=0)
    half = 100 * _QUANTILE * np.sqrt(np.diag(fit.covariance(_TRUE * found.optimum))) / _TRUE
    return Case(
        key="identification",
        title="Stiffness and damping from a noisy record",
        method="least squares (trust region, reflective)",
        variables=["Young's modulus over the true one", "damping time over the true one"],
        responses=[Response("half the sum of squares over the noise", "-")],
        found=found,
        comparisons=[
            Comparison.with_search("half the sum of squares", found, search, 1e-3),
            # Of 100 records 95 +- 2.2 hold, so 86 to 104 within four standard deviations.
            *(
                Comparison(f"intervals that hold the true {name} [%]", share, 95.0, "theory", 0.095)
                for name, share in zip(("modulus", "damping"), map(float, shares), strict=True)
            ),
        ],
        panels=_panels(fit, found, estimates),
        findings=f"The 95 % intervals from the Jacobian have half widths of {half[0]:.2g} % of the "
        f"modulus and {half[1]:.2g} % of the damping time. Of {len(holds)} records ({runs} runs of "
        f"Gauss and Newton's method) {shares[0]:.0f} % of the intervals hold the true modulus and "
        f"{shares[1]:.0f} % the true damping time.",
        sizes=np.ones(2),
    )


def _panels(fit: RunResidualFunction, found: Optimisation, estimates: Array) -> list[Panel]:
    tip = cantilever().beams[0].at_end
    series = [dots("record", fit.misfit.times, fit.misfit.data[0])]
    for name, x in (("start", found.start), ("found", found.optimum)):
        solution = fit.solution(_TRUE * x)
        series.append(Series(name, solution.t, solution.position(tip)[:, 1]))
    cloud = [
        dots("one of the records", estimates[:, 0], estimates[:, 1]),
        dots("truth", [1.0], [1.0]),
    ]
    return [
        Panel("Tip of the strip", "t [s]", "y [m]", series),
        Panel("Estimates", "modulus over the true one [-]", "damping time [-]", cloud),
    ]
