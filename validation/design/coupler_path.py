"""Joints of a four-bar with a flexible coupler, so that its point follows a straight line."""

from typing import Final

import numpy as np
from scipy.optimize import least_squares

from ancfdae import HHT, Beam, Material, Misfit, Pin, PointMass, RotationDriver, Scene, simulate
from ancfdae.extend import MaterialPoint
from ancfdae.laws import ConstantAcceleration
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.results import RunResidualFunction
from ancfdae.sections import Rectangle
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Once, Optimisation, searched
from validation.drawing import dots

# Hoeken's linkage has crank, ground, half coupler and rocker of 1, 2, 2.5 and 2.5 units.
_UNIT, _SPEED = 0.1, 20.0
_PLASTIC: Final = Material(1200.0, 2e9, 0.35, damping_time=2e-3)
_STRIP: Final = Rectangle(0.008, 0.01)
_TIP: Final = MaterialPoint("coupler", 1.0)
_DESIGN: Final = (
    "crank.length",
    "coupler.length",
    "rocker.length",
    "right.ground_x",
    "right.ground_y",
)


def hoeken(elements: int, rigid: bool = False) -> Scene:
    """Return the linkage with its crank upright; a coupler of 48 g carries 20 g at its point."""
    u = _UNIT
    crank = Beam("crank", (0, 0), (0, u), 1, _STRIP, _PLASTIC, rigid=True)
    coupler = Beam("coupler", crank.at_end, (4 * u, 3 * u), elements, _STRIP, _PLASTIC, rigid=rigid)
    rocker = Beam("rocker", (2 * u, 0), (2 * u, 2.5 * u), 1, _STRIP, _PLASTIC, rigid=True)
    joints = [
        Pin(crank.at_start, ground=(0, 0), name="left"),
        RotationDriver(crank.at_start, ConstantAcceleration(_SPEED), name="motor"),
        Pin(crank.at_end, coupler.at_start, name="elbow"),
        Pin(coupler.at(0.5), rocker.at_end, name="knee"),
        Pin(rocker.at_start, ground=(2 * u, 0), name="right"),
    ]
    weight = PointMass(coupler.at_end, 0.02)
    beams = [crank, coupler, rocker]
    return Scene(beams, joints, (0, -9.81), assemble=True, bodies=[weight])


def path_fit(elements: int, steps: int) -> RunResidualFunction:
    """Return residuals, in mm, to a straight line, passed as the rigid linkage passes it."""
    t_end = np.pi / _SPEED
    integrator = HHT(t_end / steps)
    times = (t_end / steps * np.arange(3, steps + 1, 3)).tolist()
    rigid = simulate(hoeken(1, rigid=True), t_end, integrator).at(times).position(_TIP)
    wanted = np.array([rigid[:, 0], np.full(len(times), 4 * _UNIT)])
    misfit = Misfit([position(_TIP, 0), position(_TIP, 1)], times, wanted, 1e3)
    return misfit.fit(hoeken(elements), t_end, integrator, design=_DESIGN)


def evaluation(fit: RunResidualFunction) -> Once:
    """Return half the sum of squares over 100, by lengths over the unit."""

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        r, J = fit.residuals(_UNIT * x), _UNIT * fit.jacobian(_UNIT * x)
        return np.array([r @ r / 200]), (J.T @ r / 100)[None]

    return evaluate


def optimise(fit: RunResidualFunction, iterations: int) -> Optimisation:
    """Find the lengths by Gauss and Newton's method with a trust region."""
    evaluate, clock = evaluation(fit), stopwatch()
    result = least_squares(
        lambda x: fit.residuals(_UNIT * x),
        fit.start / _UNIT,
        lambda x: _UNIT * fit.jacobian(_UNIT * x),
        xtol=1e-10,
        ftol=1e-10,
        max_nfev=iterations,
    )
    seconds = clock()
    evaluate.runs = result.nfev
    return Optimisation.of(evaluate, fit.start / _UNIT, result, seconds)


def coupler_path(quick: bool) -> Case:
    """Return the case of the four-bar (coupler point on a line); coarse and short if `quick`."""
    elements, steps = (2, 24) if quick else (4, 48)
    fit = path_fit(elements, steps)
    found = optimise(fit, 2 if quick else 40)
    search = searched(found.evaluate, found.start, 0.1, 6 if quick else 150)
    before, after = (_rms(fit, x) for x in (found.start, found.optimum))
    return Case(
        key="coupler-path",
        title="Joints of a four-bar with a flexible coupler",
        method="least squares (trust region, reflective)",
        variables=[f"{name} over 0.1 m" for name in _DESIGN],
        responses=[Response("half the sum of squares, over 100 mm^2", "-")],
        found=found,
        comparisons=[
            Comparison.with_search("half the sum of squares, over 100 mm^2", found, search, 1e-2),
            Comparison(
                "rms distance from the path [mm]",
                after,
                before,
                "Hoeken's proportions, published for rigid links",
                0.0,
                lower=True,
            ),
        ],
        panels=_panels(fit, found),
        findings=f"With a flexible coupler Hoeken's proportions miss the path by {before:.3g} mm "
        f"rms; at the optimum {after:.3g} mm are left, the vibration of the coupler.",
    )


def _rms(fit: RunResidualFunction, x: Array) -> float:
    """Distance from the path; mm."""
    return float(np.sqrt(2 * np.mean(fit.residuals(_UNIT * x) ** 2)))


def _panels(fit: RunResidualFunction, found: Optimisation) -> list[Panel]:
    wanted = np.array(fit.misfit.data)
    bars, paths = [], [dots("wanted", wanted[0], wanted[1])]
    for name, x in (("Hoeken's proportions", found.start), ("optimum", found.optimum)):
        solution = fit.solution(_UNIT * x)
        right = (2.0 * _UNIT, 0.0) if name != "optimum" else tuple(_UNIT * found.optimum[3:])
        corners = [
            MaterialPoint("crank", 0.0),
            *(MaterialPoint("coupler", s) for s in np.linspace(0, 1, 9)),
        ]
        corners += [MaterialPoint("coupler", s) for s in np.linspace(1, 0.5, 5)]
        places = [solution.position(point)[0] for point in corners]
        bars.append(Series(name, *np.array([*places, right]).T))
        paths.append(Series(name, *solution.position(_TIP).T))
    return [
        Panel("Linkage at the start", "x [m]", "y [m]", bars),
        Panel("Path of the coupler point", "x [m]", "y [m]", paths),
    ]
