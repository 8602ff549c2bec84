"""Scenes and settings of the report on work and precision."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    AdaptiveSteps,
    Integral,
    Radau,
    Terminal,
    assemble,
    work_precision,
)
from ancfdae.errors import StabilityWarning
from ancfdae.extend import Integrator, MaterialPoint, MechanicalSystem
from ancfdae.observables import custom, position
from ancfdae.results import WorkPrecision
from ancfdae.sensitivity.objectives import Objective
from validation.external.slider_crank import SliderCrank, kinetic_energy_integral
from validation.integrator_runs import MANY
from validation.scenes import crank_slider, pendulum

#: Numerical damping of HHT-I3.
ALPHAS = (0.0, -0.05, -0.1, -0.3)
#: Kinds of sensitivity that every scene is asked for.
OBJECTIVES = ("integrated", "pointwise")

# More than any controlled run needs that gets to its end, of the motion and with derivatives.
_FEW, _FEW_BOTH = 10_000, 60_000
_REPEATS = 2
# Tolerance of Newton's method against that of the step, as one might choose it.
_LOOSE = 1e-3


class Settings(NamedTuple):
    """Integrators that are measured on a scene.

    `steps` are numbers of steps of HHT, as powers of two; `rtols` are tolerances of HHT and Radau
    under control of the motion, `both` tolerances of HHT under control of motion and derivatives;
    `high` are integrators of high order.
    """

    steps: range
    rtols: Sequence[float]
    both: Sequence[float] = ()
    high: Sequence[Integrator] = ()


@dataclass(frozen=True)
class Case:
    """A scene with what is asked of it and how; objectives are in the order of `OBJECTIVES`.

    The name is for keys of figures and names of plots.
    """

    name: str
    title: str
    system: MechanicalSystem
    t_end: float
    objectives: tuple[Objective, Objective]
    settings: Settings
    reference: Integrator


@dataclass(frozen=True)
class Measured:
    """A case with its tables, in the order of `OBJECTIVES`."""

    case: Case
    tables: tuple[WorkPrecision, ...]


def measured(case: Case, quick: bool) -> Measured:
    """Measure every setting for both objectives."""
    radau = [Radau(rtol=x) for x in case.settings.rtols]
    settings = [*_second_order(case, ALPHAS), *radau, *case.settings.high]
    tables = tuple(
        work_precision(
            case.system,
            objective,
            case.t_end,
            settings,
            reference=case.reference,
            repeats=1 if quick else _REPEATS,
        )
        for objective in case.objectives
    )
    return Measured(case, tables)


def newton_tolerances(rtols: Sequence[float], quick: bool) -> tuple[str, list[WorkPrecision]]:
    """Measure the controlled step with a loose tolerance of Newton's method and the default.

    Return the scene in words, and one table for each tolerance; the loose one, rtol/1000, first.
    """
    case = _pendulum("newton", 2e11, 1e-3, 2.0**-6 if quick else 1.0, Settings(range(1), rtols))
    reference = HHT(rtol=1e-4 if quick else 1e-6, newton_tolerance=1e-12)
    settings: list[Integrator] = []
    settings += [HHT(rtol=rtol, newton_tolerance=_LOOSE * rtol) for rtol in rtols]
    settings += [HHT(rtol=rtol) for rtol in rtols]
    table = work_precision(
        case.system, case.objectives[0], case.t_end, settings, reference=reference
    )
    halves = table.rows[: len(rtols)], table.rows[len(rtols) :]
    return case.title, [WorkPrecision(rows, table.reference) for rows in halves]


def _second_order(case: Case, alphas: Sequence[float]) -> list[Integrator]:
    settings: list[Integrator] = []
    with warnings.catch_warnings():
        # At hht_alpha = 0 it is the subject of this report.
        warnings.simplefilter("ignore", StabilityWarning)
        for alpha in alphas:
            settings += [HHT(case.t_end / 2**k, hht_alpha=alpha) for k in case.settings.steps]
            controls = [AdaptiveSteps(rtol, max_steps=_FEW) for rtol in case.settings.rtols]
            controls += [
                AdaptiveSteps(rtol, max_steps=_FEW_BOTH, sensitivities=True)
                for rtol in case.settings.both
            ]
            settings += [HHT(steps, alpha) for steps in controls]
    return settings


def _high(
    ida: Sequence[float], explicit: Sequence[float] = (), intervals: int = 64
) -> list[Integrator]:
    settings: list[Integrator] = []
    settings += [IDA(rtol, intervals=intervals, max_steps=MANY) for rtol in ida]
    settings += [IDAS(rtol, intervals=intervals, max_steps=MANY) for rtol in ida]
    return [*settings, *(DOP853(r, intervals, max_steps=MANY) for r in explicit)]


def cases(quick: bool) -> list[Case]:
    """Return the scenes; quick ones are short and coarse."""
    if quick:
        coarse = (1e-2, 1e-3), (1e-2,), [IDA(1e-5), DOP853(1e-5)]
        return [
            _pendulum("soft", 1e7, 0.0, 2.0**-6, Settings(range(2, 5), *coarse)),
            _slider(0.5, Settings(range(4, 7), *coarse)),
        ]
    rtols, high = (1e-2, 1e-3, 1e-4, 1e-5), _high((1e-5, 1e-7), (1e-5, 1e-7))
    dense = (1e-2, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)
    three, two, one = (1e-2, 1e-3, 1e-4), (1e-2, 1e-3), (1e-2,)
    stiff, few = _high((1e-4,), (1e-5,)), [IDA(1e-5, max_steps=1000)]
    return [
        _pendulum("soft", 1e7, 0.0, 0.25, Settings(range(5, 11), rtols, three, high)),
        _pendulum("soft-damped", 1e7, 1e-3, 0.25, Settings(range(4, 10), rtols, three, high)),
        _pendulum("stiff", 2e11, 0.0, 2.0**-6, Settings(range(3, 11), rtols, one, stiff)),
        _pendulum("medium-damped", 1e9, 4e-3, 2.0, Settings(range(8, 13), dense, three)),
        _pendulum("stiff-damped", 2e11, 1e-3, 1.0, Settings(range(9, 13), dense, three, few)),
        _slider(10.0, Settings(range(7, 12), rtols, three, high)),
        _crank(0.125, Settings(range(4, 9), rtols, two, stiff)),
    ]


def _pendulum(name: str, modulus: float, damping: float, t_end: float, settings: Settings) -> Case:
    """Return the flexible pendulum; height and density are its design."""
    scene = pendulum(youngs_modulus=modulus, damping_time=damping)
    system = assemble(scene, ("pendulum.height", "pendulum.density"))
    tip = position(MaterialPoint("pendulum", 1.0), 1)
    words = f", retardation time {damping:g} s" if damping else ""
    reference: Integrator = DOP853(1e-10 if modulus < 1e8 else 1e-7, max_steps=MANY)
    if modulus > 1e8 and damping:
        reference = Radau(t_end / 2**10)
    title = f"Pendulum, E = {modulus:.0e} N/m²{words}, {t_end:g} s"
    objectives = Integral((tip + 0.5) ** 2), Terminal(tip)
    return Case(name, title, system, t_end, objectives, settings, reference)


def _crank(t_end: float, settings: Settings) -> Case:
    """Return the paper's crank-slider; height and density of the rod are its design."""
    slider = position(MaterialPoint("rod", 1.0), 0)
    middle = position(MaterialPoint("rod", 0.5), 1)
    system = assemble(crank_slider(), ("rod.height", "rod.density"))
    objectives = Integral((slider - 1.8) ** 2), Terminal(middle)
    title, exact = f"Crank-slider of the paper, {t_end:g} s", DOP853(1e-7, max_steps=MANY)
    return Case("crank", title, system, t_end, objectives, settings, exact)


def _slider(t_end: float, settings: Settings) -> Case:
    """Return the slider-crank of SUNDIALS; stiffness and damping of its spring are its design."""
    angle = custom(lambda t, q, v, lam, b: q[:, 0], "crank angle")
    objectives = kinetic_energy_integral(), Terminal(angle)
    title, exact = f"Slider-crank of SUNDIALS, {t_end:g} s", DOP853(1e-10, max_steps=MANY)
    return Case("slider-crank", title, SliderCrank(), t_end, objectives, settings, exact)
