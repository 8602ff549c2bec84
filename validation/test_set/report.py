"""Report on published problems: every integrator and method, motion beside gradient."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Self

import numpy as np

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    FiniteDifference,
    Radau,
)
from ancfdae.extend import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel
from ancfdae.sensitivity.method import GradientMethod
from validation.drawing import error_over_work
from validation.external.runs import Attempt, Problem, differentiated
from validation.integrator_runs import MANY
from validation.report import Report
from validation.test_set.car_axis import CarAxis
from validation.test_set.crank_with_spring import CrankWithSpring
from validation.test_set.flexible_crank import FlexibleCrank
from validation.test_set.pendulum import SimplePendulum
from validation.test_set.problem import TestProblem
from validation.test_set.roberts import Roberts
from validation.test_set.squeezer import Squeezer

_PROBLEMS: Final = (
    SimplePendulum, CrankWithSpring, CarAxis, Squeezer, FlexibleCrank, Roberts,
)  # fmt: skip
_METHODS: Final[dict[str, GradientMethod]] = {
    "direct": DirectDifferentiation(),
    "adjoint": Adjoint(),
    "continuous adjoint": ContinuousAdjoint(),
    "central difference": FiniteDifference(1e-4, central=True),
    "complex step": ComplexStep(),
}
# Two ways agree where their gradients differ by less than this.
_EQUAL = 1e-9
# Processor seconds; a family's tighter settings are left out after a run that took longer.
_PATIENCE = 5.0


class _Setting(NamedTuple):
    """An integrator at a step or a tolerance."""

    family: str
    words: str
    integrator: Integrator
    always: bool = False


class _Case:
    """A problem with its reference."""

    def __init__(self, system: TestProblem, t_end: float, rtol: float) -> None:
        self.system = system
        self.exact = system.reference(t_end, rtol)
        # How far the reference moves with its tolerance.
        self.settled = self.errors(system.reference(t_end, 10 * rtol))
        self.problem = Problem(system.title, system, system.objective(), t_end, self.exact)

    def shorter(self, rtol: float) -> Self:
        """Return the problem over a tenth of its time."""
        return type(self)(self.system, self.problem.t_end / 10, rtol)

    @property
    def key(self) -> str:
        """Name of figures and plots."""
        return self.system.title.replace("'", "").replace(" ", "-")

    def errors(self, value: Array) -> tuple[float, float]:
        """Return relative errors of the objective and of its gradient.

        Components of the gradient count by the size b_i of their variables, 1 where that is zero.
        """
        b = np.abs(np.asarray(self.system.b, dtype=float))
        sizes = np.where(b > 0, b, 1.0)
        apart, exact = value - self.exact, self.exact
        gradient = np.max(np.abs(apart[1:]) * sizes) / np.max(np.abs(exact[1:]) * sizes)
        return float(abs(apart[0] / exact[0])), float(gradient)


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `test-set`; add its text, tables and figures."""
    report.say("method")
    if quick:
        cases = [_Case(SimplePendulum(), 0.2, 1e-8)]
    else:
        cases = [_Case(kind(), kind.t_end, 1e-13) for kind in _PROBLEMS]
    _answers(report, cases)
    rtols = (1e-3,) if quick else (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
    for case in cases:
        report.heading(f"{case.system.title[0].upper()}{case.system.title[1:]}")
        best = _ladder(report, case, rtols, 1 if quick else 3)
        report.judge("two-ways", best <= _EQUAL, case=case, equal=_EQUAL, best=best)
        _methods(report, case.shorter(1e-8 if quick else 1e-12), 1e-3 if quick else 1e-6)
    report.say("limits")


def _answers(report: Report, cases: Sequence[_Case]) -> None:
    """Compare the reference with what the sources print."""
    report.heading("Published answers and the reference")
    rows = []
    for case in cases:
        system = case.system
        apart = float(abs(case.exact[0] - system.published) / abs(system.published))
        report.figure(f"{case.key}.published.apart", apart)
        report.figure(f"{case.key}.reference.settled", case.settled[1])
        printed = f"{system.published:.12g}"
        values = [f"{x:.10g}" for x in case.exact[1:]]
        names = ", ".join(system.design_names)
        rows.append([system.title, system.source, printed, f"{apart:.0e}", names, *values])
        # What a tenth of its tolerance still changed is no more than the reference's own error.
        known = max(system.digits, 2 * max(case.settled))
        report.judge(
            "answers", apart <= known, system=system, printed=printed, known=known, apart=apart
        )
    header = ["problem", "source", "printed", "SciPy, apart", "b", "d/db_1", "d/db_2", "d/db_3"]
    report.table(header, rows)
    settled = ", ".join(f"{c.system.title} {c.settled[1]:.0e}" for c in cases)
    report.say("answers", settled=settled)


def _settings(system: TestProblem, rtols: Sequence[float], halvings: int) -> list[_Setting]:
    settings = []
    for k in range(halvings + 1):
        h = system.step / 2**k
        settings.append(_Setting("HHT", f"h = {h:.3g}", HHT(step=h)))
    families: dict[str, Any] = {"Radau": Radau, "IDA": IDA, "IDAS": IDAS, "DOP853": DOP853}
    if system.stiff:
        del families["DOP853"]
    for name, kind in families.items():
        for rtol in rtols:
            options = {} if name == "Radau" else {"intervals": 1, "max_steps": MANY}
            always = name == "DOP853" and rtol == rtols[-1]
            integrator = kind(rtol=rtol, **options)
            settings.append(_Setting(name, f"rtol = {rtol:.0e}", integrator, always))
    return settings


def _ladder(report: Report, case: _Case, rtols: Sequence[float], halvings: int) -> float:
    """Add errors over work; return the least error of a gradient."""
    rows: list[list[object]] = []
    value: dict[str, list[tuple[float, float]]] = {}
    slope: dict[str, list[tuple[float, float]]] = {}
    slow: set[str] = set()
    for setting in _settings(case.system, rtols, halvings):
        if setting.family in slow and not setting.always:
            rows.append([setting.family, setting.words, "-", "-", "-", "not run: see Method"])
            continue
        attempt = differentiated(case.problem, setting.integrator, DirectDifferentiation())
        if attempt.seconds > _PATIENCE:
            slow.add(setting.family)
        rows.append([setting.family, setting.words, *_cells(case, attempt)])
        if attempt.value is None:
            continue
        errors = case.errors(attempt.value)
        name = f"{case.key}.{setting.family}.{setting.words.replace(' = ', '')}"
        report.figure(f"{name}.value", errors[0])
        report.figure(f"{name}.gradient", errors[1])
        for points, error in ((value, errors[0]), (slope, errors[1])):
            points.setdefault(setting.family, []).append((attempt.seconds, max(error, 1e-16)))
    report.table(_HEADER, rows)
    panels: list[Panel] = [
        error_over_work("Objective", value, "relative error of the objective [-]"),
        error_over_work("Gradient", slope, "relative error of the gradient [-]"),
    ]
    report.plot(case.key, panels, columns=2, title=case.system.title.capitalize())
    return min(error for points in slope.values() for _, error in points)


def _cells(case: _Case, attempt: Attempt) -> list[object]:
    if attempt.value is None:
        return ["-", "-", f"{attempt.seconds:.2f}", attempt.note]
    errors = case.errors(attempt.value)
    return [*(f"{x:.1e}" for x in errors), f"{attempt.seconds:.2f}", attempt.note]


def _methods(report: Report, case: _Case, rtol: float) -> None:
    """Add every method with every integrator at one setting; name the refused ones."""
    report.say("methods", case=case)
    settings = _settings(case.system, [rtol], 1)[1:]
    rows: list[list[object]] = []
    refused: dict[str, list[str]] = {}
    for setting in settings:
        for name, method in _METHODS.items():
            attempt = differentiated(case.problem, setting.integrator, method)
            if attempt.refused:
                refused.setdefault(name, []).append(setting.family)
                continue
            rows.append([setting.family, setting.words, name, *_cells(case, attempt)])
    report.table([*_HEADER[:2], "method", *_HEADER[2:]], rows)
    words = "; ".join(f"{name} ({', '.join(kinds)})" for name, kinds in refused.items())
    report.say("methods.refused", words=words)


_HEADER = ["integrator", "setting", "objective", "gradient", "CPU [s]", "outcome"]
