"""Report on ladders of models."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from ancfdae import HHT, choose_model, gradient
from ancfdae.errors import NoAccurateModelError
from ancfdae.extend import Objective
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import ModelChoice, ModelComparison
from ancfdae.studies.ladder import KINDS, ErrorOf, error
from ancfdae.studies.meshes import with_mesh
from validation.drawing import log_log
from validation.models.scenes import CASES, Case
from validation.report import Agreement, Report

_TOLERANCES: Final = (1e-1, 1e-2, 1e-3)
_STEPS: Final = 4096
# A motion that is right to this, and a gradient that is wrong by that.
_RIGHT, _WRONG = 1e-2, 1e-1


@final
@dataclass(frozen=True)
class _Answer:
    """What was chosen for a tolerance; `exact` are errors against the finer mesh."""

    case: Case
    objective: str
    of: ErrorOf
    tolerance: float
    choice: ModelChoice
    exact: float
    reached: bool
    best: ModelChoice | None

    @property
    def ratio(self) -> float | None:
        """Cost of the chosen run over that of the cheapest run that is accurate enough."""
        return None if self.best is None else self.choice.run.seconds / self.best.run.seconds


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `models`; add its text, tables and figures."""
    report.say("method")
    answers, surprises = list[_Answer](), list[list[object]]()
    for make in CASES[:1] if quick else CASES:
        case = make()
        report.heading(case.title)
        panels = []
        for name, objective in list(case.objectives.items())[: 1 if quick else None]:
            ladder = choose_model(
                case.scene,
                objective,
                case.t_end,
                0.1 if quick else _TOLERANCES[-1],
                design=case.design,
                alternatives=case.alternatives,
                doublings=1 if quick else 2,
                max_steps=_STEPS,
            )
            truth = _truth(case, objective, ladder)
            report.heading(f"{case.title}: {name}", 3)
            _rungs(report, ladder, truth)
            answers += _answers(case, name, ladder, truth)
            surprises += _surprises(case, name, ladder, truth)
            panels.append(_panel(name, ladder, truth))
        _chosen(report, [each for each in answers if each.case is case])
        report.plot("{case.key}", panels, min(2, len(panels)), case=case)
    _told_wrong(report, surprises)
    _verdict(report, answers)
    report.say("limits")


def _truth(case: Case, objective: Objective, ladder: ModelComparison) -> Array:
    """Value and derivatives of the richest model with twice its elements and half its step."""
    rung = ladder.richest
    scene, design = with_mesh(rung.scene, rung.design, 1)  # type: ignore[arg-type]
    answer = gradient(scene, objective, case.t_end, HHT(rung.runs[-1].step / 2), design=design)
    b = [scene.value(variable) for variable in design]
    return np.array([answer.value, *(answer.gradient * b)])


def _rungs(report: Report, ladder: ModelComparison, truth: Array) -> None:
    head = ["model", "elements", "value: model", "mesh", "gradient: model", "mesh", "step [s]"]
    rows = []
    for rung in ladder.rungs:
        name = rung.name
        if lost := ladder.without_influence(rung):
            name += f" (no influence: {', '.join(lost)})"
        if not rung.runs:
            reason = rung.outcome.split(". ")[0].split("; got")[0]
            rows.append([name, rung.elements, f"not possible: {reason}", *["-"] * 6])
            continue
        cells: list[object] = [name, rung.elements]
        for of in KINDS:
            parts = ladder.choice(rung, rung.runs[-1], of).parts
            cells += [f"{parts['model']:.1e}", f"{parts['mesh']:.1e}"]
        steps = f"{rung.runs[-1].step:.2g}"
        away = error(rung.numbers - truth, truth, "gradient")
        rows.append([*cells, steps, f"{1e3 * rung.runs[-1].seconds:.0f}", f"{away:.1e}"])
    report.table([*head, "time [ms]", "gradient: against twice the mesh"], rows)
    exact = ladder.richest.numbers
    orders = ", ".join(f"{x:.2g}" for x in ladder.mesh_orders)
    bars = " and ".join(f"{error(ladder.mesh_bar, exact, of):.1e}" for of in KINDS)
    report.say("rungs", bars=bars, orders=orders)


def _answers(case: Case, name: str, ladder: ModelComparison, truth: Array) -> list[_Answer]:
    answers = []
    for of in KINDS:
        choices = [(each, _away(each, truth, of)) for each in ladder.choices(of)]
        for tolerance in _TOLERANCES:
            good = [each for each, away in choices if away <= tolerance]
            best = min(good, key=lambda each: each.run.seconds, default=None)
            try:
                choice, reached = ladder.recommend(tolerance, of), True
            except NoAccurateModelError as none:
                choice, reached = none.best, False
            away = _away(choice, truth, of)
            answers.append(_Answer(case, name, of, tolerance, choice, away, reached, best))
    return answers


def _away(choice: ModelChoice, truth: Array, of: ErrorOf) -> float:
    return error(choice.run.numbers - truth, truth, of)


def _chosen(report: Report, answers: Sequence[_Answer]) -> None:
    rows = []
    for each in answers:
        choice, parts = each.choice, each.choice.parts
        named = f"{choice.rung.name}, {choice.rung.elements}"
        best = each.best
        rows.append(
            [
                f"{each.objective}, {'value' if each.of == 'objective' else each.of}",
                f"{each.tolerance:g}",
                named if each.reached else f"none; nearest {named}",
                f"{choice.run.step:.2g}",
                ", ".join(f"{size:.0e}" for size in parts.values()),
                f"{each.exact:.1e}",
                f"{1e3 * choice.run.seconds:.0f}",
                "-" if best is None else f"{best.rung.name}, {best.rung.elements}",
                "-" if each.ratio is None else f"{each.ratio:.2g}",
            ]
        )
    head = ["objective", "tolerance", "chosen", "step [s]", "model, mesh, step, reference"]
    head += ["error", "time [ms]", "best in hindsight", "cost ratio"]
    report.table(head, rows)


def _surprises(case: Case, name: str, ladder: ModelComparison, truth: Array) -> list[list[object]]:
    """Return a row where rigid bodies give the value and not the gradient."""
    rigid = [rung for rung in ladder.rungs if rung.name == "rigid" and rung.runs]
    rows = list[list[object]]()
    for rung in rigid:
        value, slope = (error(rung.numbers - truth, truth, of) for of in KINDS)
        if value <= _RIGHT and slope >= _WRONG:
            lost = ", ".join(ladder.without_influence(rung))
            rows.append([case.title, name, f"{value:.1e}", f"{slope:.1e}", lost])
    return rows


def _told_wrong(report: Report, rows: Sequence[Sequence[object]]) -> None:
    report.heading("Rigid enough for the value and wrong for the gradient")
    if rows:
        head = ["scene", "objective", "error of the value", "of the gradient", "no influence"]
        report.table(head, rows)
    else:
        report.say("none")


def _panel(name: str, ladder: ModelComparison, truth: Array) -> Panel:
    """Return the best runs of every kind: error of the gradient over cost."""
    kinds = dict.fromkeys(rung.name for rung in ladder.rungs if rung.runs)
    series = []
    for kind in kinds:
        own = [each for each in ladder.choices("gradient") if each.rung.name == kind]
        points = sorted((x.run.seconds, _away(x, truth, "gradient")) for x in own)
        front, least = list[tuple[float, float]](), np.inf
        for seconds, away in points:
            if away < least:
                front.append((1e3 * seconds, away))
                least = away
        costs, errors = zip(*front, strict=True)
        series.append(Series(kind, list(costs), list(errors), marker=True))
    axes = ("processor time [ms]", "relative error [-]")
    return log_log(f"Gradient of: {name}", *axes, series)


def _verdict(report: Report, answers: Sequence[_Answer]) -> None:
    report.heading("Verdict")
    reached = [each for each in answers if each.reached]
    within = float(np.mean([each.exact <= each.tolerance for each in reached]))
    ratios = [each.ratio for each in reached if each.ratio is not None]
    missed = len(answers) - len(reached)
    report.figure("within", within)
    report.figure("reached", len(reached) / len(answers))
    median = report.figure("cost_ratio.median", float(np.median(ratios)))
    worst = report.figure("cost_ratio.worst", float(np.max(ratios)))
    rows = []
    for tolerance in _TOLERANCES:
        own = [each for each in answers if each.tolerance == tolerance]
        kept = [each for each in own if each.reached]
        costs = [each.ratio for each in kept if each.ratio is not None]
        median_of = f"{np.median(costs):.2g}" if costs else "-"
        held = sum(each.exact <= tolerance for each in kept)
        rows.append([f"{tolerance:g}", len(own), len(kept), held, median_of])
    head = ["tolerance", "asked", "chosen", "of them within it", "median cost ratio"]
    report.table(head, rows)
    report.judge(
        "verdict",
        Agreement.AGREES if within == 1 and not missed else Agreement.PARTLY,
        within=100 * within,
        chosen=len(reached),
        asked=len(answers),
        missed=missed,
    )
    report.judge("cost", median <= 2, median=median, worst=worst)
