"""Errors that a run of HHT-I3 estimates itself, against the true ones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae import DOP853, HHT, AdaptiveSteps, assemble, differentiate
from ancfdae.extend import Integrator, MechanicalSystem
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Series
from ancfdae.results import Solution
from validation.drawing import dots, log_log
from validation.external.slider_crank import SliderCrank
from validation.report import Agreement, Report
from validation.scenes import crank_slider, pendulum

_ALPHAS = (-0.05, -0.3)
# Runs with larger errors are left out, since no estimate can be right.
_LARGEST = 1.0
_NEAR, _FAR = 3.0, 10.0


@dataclass(frozen=True)
class _Case:
    """A scene and the numbers of steps, as powers of two, of its runs."""

    name: str
    system: MechanicalSystem
    t_end: float
    steps: range
    rtols: Sequence[float]
    both: Sequence[float]
    reference: Integrator
    damped: bool = False

    @property
    def key(self) -> str:
        """The name as part of the name of a figure."""
        return self.name.replace(" ", "_").replace(",", "").replace("'", "")


@dataclass(frozen=True)
class _Pairs:
    """True and estimated errors of the runs of a case; one column per design variable."""

    case: _Case
    motion: Array
    derivatives: Array


def estimates(report: Report, quick: bool) -> None:
    """Fill the section."""
    report.say("estimates")
    measured = [_measured(case) for case in _cases(quick)]
    rows: list[list[object]] = []
    for each in measured:
        cells = []
        for name, pairs in (("motion", each.motion), ("derivatives", each.derivatives)):
            ratio = pairs[1] / pairs[0]
            for end, value in (("least", np.min(ratio)), ("largest", np.max(ratio))):
                report.figure(f"estimate.{each.case.key}.{name}.{end}", float(value))
            cells += [f"{np.min(pairs[0]):.1g} to {np.max(pairs[0]):.1g}"]
            cells += [f"{np.min(ratio):.2g} to {np.max(ratio):.2g}"]
        rows.append([each.case.name, each.motion.shape[1], *cells])
    header = ["scene", "runs", "errors of motion", "estimated / true, motion"]
    report.table([*header, "errors of derivatives", "estimated / true, derivatives"], rows)
    _plot(report, measured)
    motion, derivatives = (
        np.concatenate([_ratios(getattr(each, name)) for each in measured if not each.case.damped])
        for name in ("motion", "derivatives")
    )
    near = np.mean((derivatives > 1 / _NEAR) & (derivatives < _NEAR))
    report.figure("estimate.derivatives.near", float(near))
    least = min(_ratios(x).min() for each in measured for x in (each.motion, each.derivatives))
    good = _within(motion, _NEAR) and _within(derivatives, _FAR) and least > 1 / _FAR
    report.judge(
        "estimates",
        Agreement.AGREES if good else Agreement.PARTLY,
        motion_least=motion.min(),
        motion_largest=motion.max(),
        b_least=derivatives.min(),
        b_largest=derivatives.max(),
        near=100 * near,
        least=least,
    )
    report.say("estimates.notes")


def _within(ratios: Array, factor: float) -> bool:
    return bool(np.all((ratios > 1 / factor) & (ratios < factor)))


def _ratios(pairs: Array) -> Array:
    return np.asarray(pairs[1] / pairs[0])


def _cases(quick: bool) -> list[_Case]:
    design = ("pendulum.height", "pendulum.density")
    soft = assemble(pendulum(), design)
    rigid = _Case(
        "SUNDIALS slider-crank",
        SliderCrank(),
        10.0,
        range(6, 8) if quick else range(5, 11),
        (1e-3,) if quick else (1e-2, 1e-3, 1e-4),
        (1e-2,) if quick else (1e-2, 1e-3, 1e-4),
        DOP853(1e-9),
    )
    if quick:
        short = _Case("soft pendulum", soft, 2.0**-4, range(4, 6), (1e-2,), (), DOP853(1e-6))
        return [rigid, short]
    waves, rtols = DOP853(1e-6, max_steps=1_000_000), (1e-2, 1e-3, 1e-4)
    crank = assemble(crank_slider(), ("rod.height", "rod.density"))
    stiff, t_stiff = assemble(pendulum(youngs_modulus=2e11), design), 2.0**-6
    damped = assemble(pendulum(damping_time=1e-3), design)
    stiff_damped = assemble(pendulum(youngs_modulus=2e11, damping_time=1e-3), design)
    fine = HHT(2.0**-15, hht_alpha=-0.05)
    return [
        rigid,
        _Case("soft pendulum", soft, 0.5, range(4, 12), rtols, (1e-2, 1e-3), waves),
        _Case("paper's crank-slider", crank, 0.125, range(4, 11), rtols, (1e-2,), waves),
        _Case("stiff pendulum", stiff, t_stiff, range(5, 11), rtols, (), waves),
        _Case("soft pendulum, damped", damped, 0.5, range(4, 11), rtols, rtols, waves, True),
        _Case(
            "stiff pendulum, damped", stiff_damped, 0.25, range(8, 12), rtols, (1e-2,), fine, True
        ),
    ]


def _measured(case: _Case) -> _Pairs:
    exact = differentiate(case.system, case.t_end, case.reference)
    motion, derivatives = [], []
    for integrator in _settings(case):
        run = differentiate(case.system, case.t_end, integrator)
        if not run.outcome.success:
            continue
        assert run.estimated_errors is not None
        assert run.estimated_errors.derivatives is not None
        of_q, of_q_b = _true(case.system, run, exact)
        motion.append((of_q, run.estimated_errors.motion))
        derivatives += list(zip(of_q_b, run.estimated_errors.derivatives, strict=True))
    columns = (np.array(pairs).T for pairs in (motion, derivatives))
    return _Pairs(case, *(x[:, x[0] < _LARGEST] for x in columns))


def _settings(case: _Case) -> list[Integrator]:
    settings: list[Integrator] = []
    for alpha in _ALPHAS:
        settings += [HHT(case.t_end / 2**k, hht_alpha=alpha) for k in case.steps]
        settings += [HHT(rtol=rtol, hht_alpha=alpha) for rtol in case.rtols]
        settings += [HHT(AdaptiveSteps(rtol, sensitivities=True), alpha) for rtol in case.both]
    return settings


def _true(system: MechanicalSystem, run: Solution, exact: Solution) -> tuple[float, Array]:
    """Return the errors of q and q_b, the largest over the instants of the reference.

    Root mean squares over the coordinates in their weighted form; q relative to its start, q_b to
    the largest of the reference.
    """
    root = np.sqrt(system.weights)
    same = run.at(list(exact.t[1:-1]))
    error = _rms((same.q - exact.q[1:-1]) * root).max() / _rms(exact.q[:1] * root)[0]
    ours, theirs = (_derivatives(x) * root[:, None] for x in (same, exact))
    sizes = _rms(theirs).max(axis=0)
    return float(error), np.asarray(_rms(ours - theirs[1:-1]).max(axis=0) / sizes)


def _derivatives(run: Solution) -> Array:
    assert run.sensitivities is not None
    return run.sensitivities.q_b


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(x**2, axis=1)))


def _plot(report: Report, measured: Sequence[_Pairs]) -> None:
    panels = []
    for title, name in (("Motion", "motion"), ("Derivatives", "derivatives")):
        series = []
        for each in measured:
            true, estimated = getattr(each, name)
            series.append(dots(each.case.name, true, estimated))
        both = np.concatenate([getattr(each, name) for each in measured], axis=1)
        ends = np.array([both[0].min(), both[0].max()])
        series.append(Series("estimated = true", ends, ends))
        panels.append(log_log(title, "true error [-]", "estimated [-]", series))
    report.plot("estimates", panels, 2)
