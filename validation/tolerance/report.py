"""Report on gradients to a tolerance: errors, bars and prices on scenes that set nothing."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ancfdae import DOP853, HHT, Radau, gradient
from ancfdae.errors import AncfdaeError
from ancfdae.extend import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import timed
from ancfdae.plotting import Panel, Series
from ancfdae.results import Gradient
from validation.report import Report
from validation.tolerance.generator import FAMILIES, Generated
from validation.tolerance.generator import case as generated
from validation.tolerance.scenes import HELD_OUT, Case
from validation.work_precision_scenes import cases

_TOLERANCES = (1e-2, 1e-4, 1e-6)
# Random scenes of each family: those with which the rules were made, and others.
_SETS = {"Random scenes": range(14), "Random scenes of other seeds": range(1000, 1007)}
# Settings of a kind are tried until one takes so long, s, or errs by so little.
_LONG, _EXACT = 2.0, 1e-7
# A call that takes less than _SHORT, s, is timed _TIMES times, and the least time counts.
_SHORT, _TIMES = 0.15, 3


@dataclass(frozen=True)
class _Run:
    """A setting in hindsight, or a call to a tolerance: its error over the wanted sizes."""

    setting: str
    seconds: float
    error: float


@dataclass(frozen=True)
class _Row:
    """A call to a tolerance; `held` are the bars that hold, `best` the cheapest setting."""

    case: str
    tolerance: float
    done: _Run
    reached: bool
    held: Sequence[bool]
    best: _Run | None


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `tolerance`; add its text, tables and figures."""
    report.say("method")
    tolerances = _TOLERANCES[:2] if quick else _TOLERANCES
    rows = [row for case in _cases(quick) for row in _measured(case, tolerances, quick)]
    _table(report, rows)
    _picture(report, rows)
    _verdict(report, rows)
    for (title, seeds), key in zip(_SETS.items(), ("random", "others"), strict=True):
        report.heading(title)
        report.say("random")
        random_scenes(report, seeds[:1] if quick else seeds, key, quick)


def random_scenes(report: Report, seeds: Sequence[int], key: str, quick: bool) -> None:
    """Add calls on random scenes: what errs without a word, and how many bars hold."""
    families = ("pulse", "window") if quick else FAMILIES
    cases = [generated(x, seed) for x in families for seed in seeds]
    rows = [row for each in cases for row in _asked(each, _exact(each), _TOLERANCES[:2], quick)]
    header = [
        "scene",
        "tolerance",
        "reached",
        "error / tolerance",
        "bars that hold",
        "by",
        "CPU [s]",
    ]
    cells: list[list[object]] = []
    for row in rows:
        said = "yes" if row.reached else "no, and said"
        numbers = f"{row.done.error / row.tolerance:.2g}", f"{sum(row.held)} of {len(row.held)}"
        seconds = f"{row.done.seconds:.2g}"
        cells.append([row.case, f"{row.tolerance:g}", said, *numbers, row.done.setting, seconds])
    report.table(header, cells)
    over = np.array([row.done.error / row.tolerance for row in rows if row.reached])
    silent = report.figure(f"{key}.above_three", float(np.sum(over > 3)))
    held = report.figure(f"{key}.held", float(np.mean([x for row in rows for x in row.held])))
    said = f"{len(rows) - len(over)} calls say that the tolerance is out of reach"
    report.judge(
        "random-scenes",
        held >= 0.95 and not silent,
        seeds=seeds,
        last=seeds[-1],
        silent=silent,
        calls=len(over),
        largest=np.max(over),
        said=said,
        held=100 * held,
    )


def _exact(case: Generated) -> Gradient:
    """Return the answer of a fine run that is told of pulses."""
    return gradient(case.told, case.objective, case.t_end, case.reference)


def _cases(quick: bool) -> list[Case]:
    """Return the rows of report work-precision, then the scenes that were held out."""
    if quick:
        names = ("masses on springs", "spring of SUNDIALS, short")
        return [replace(x, t_end=0.5) for x in HELD_OUT() if x.name in names]
    known = [
        Case(f"{each.title}, {kind}", each.system, objective, each.t_end, each.reference)
        for each in cases(quick=False)
        for kind, objective in zip(("integrated", "pointwise"), each.objectives, strict=True)
    ]
    return [*known, *HELD_OUT()]


def _measured(case: Case, tolerances: Sequence[float], quick: bool) -> Iterator[_Row]:
    exact = gradient(case.system, case.objective, case.t_end, case.reference)
    known = list(_hindsight(case, exact, quick))
    for row in _asked(case, exact, tolerances, quick):
        kept = [x for x in known if x.error <= row.tolerance]
        best = min(kept, key=lambda x: x.seconds, default=None)
        yield replace(row, best=best)


def _asked(case: Case, exact: Gradient, tolerances: Sequence[float], quick: bool) -> Iterator[_Row]:
    """Call with tolerances; the best settings are not known."""
    for tolerance in tolerances:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            asked = partial(gradient, case.system, case.objective, case.t_end, tolerance=tolerance)
            seconds, found = timed(asked, 1 if quick else _TIMES, long=_SHORT)
        accuracy = found.accuracy
        assert accuracy is not None
        held = [abs(found.value - exact.value) <= accuracy.value_bar]
        held += list(np.abs(found.gradient - exact.gradient) <= accuracy.gradient_bar)
        done = _Run(type(accuracy.integrator).__name__, seconds, _error(case, found, exact))
        yield _Row(case.name, tolerance, done, accuracy.reached, held, None)


def _hindsight(case: Case, exact: Gradient, quick: bool) -> Iterator[_Run]:
    """Measure settings of every kind, from coarse to fine."""
    T = case.t_end
    kinds: list[list[Integrator]] = [
        [HHT(T / 2**k, alpha) for k in range(4, 15)] for alpha in (-0.05, -0.3)
    ]
    kinds += [[Radau(T / 2**k) for k in range(3, 11)]]
    kinds += [[DOP853(10.0**-k, max_steps=2500) for k in range(3, 11, 2)]]
    for kind in kinds[2:] if quick else kinds:
        for setting in kind:
            call = partial(gradient, case.system, case.objective, T, setting)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    seconds, found = timed(call, 1 if quick else _TIMES, long=_SHORT)
            except (AncfdaeError, ArithmeticError):
                if isinstance(setting, DOP853):  # Tighter tolerances take more steps.
                    break
                continue
            error = _error(case, found, exact)
            yield _Run(repr(setting), seconds, error)
            if seconds > _LONG or error < _EXACT:
                break


def _error(case: Case, found: Gradient, exact: Gradient) -> float:
    """Return the larger of the errors of value and gradient, as tolerances measure them."""
    scale: Array = np.where(case.system.b == 0, 1.0, np.abs(case.system.b))
    slope = float(np.linalg.norm(exact.gradient * scale))
    wrong = float(np.linalg.norm((found.gradient - exact.gradient) * scale))
    return max(abs(found.value - exact.value) / max(abs(exact.value), slope), wrong / slope)


def _table(report: Report, rows: Sequence[_Row]) -> None:
    report.heading("Every call")
    header = ["scene", "tolerance", "reached", "error / tolerance", "bars that hold"]
    header += ["by", "CPU [s]", "best setting in hindsight", "its CPU [s]", "ratio"]
    cells: list[list[object]] = []
    for row in rows:
        best = ("none", "-", "-")
        if row.best is not None:
            ratio = f"{row.done.seconds / row.best.seconds:.1f}"
            best = row.best.setting.split(", newton")[0], f"{row.best.seconds:.2g}", ratio
        held = f"{sum(row.held)} of {len(row.held)}"
        said = "yes" if row.reached else "no, and said"
        ratio = f"{row.done.error / row.tolerance:.2g}"
        mine = [row.case, f"{row.tolerance:g}", said, ratio, held]
        cells.append([*mine, row.done.setting, f"{row.done.seconds:.2g}", *best])
    report.table(header, cells)


def _picture(report: Report, rows: Sequence[_Row]) -> None:
    errors, prices = [], []
    for tolerance in sorted({row.tolerance for row in rows}, reverse=True):
        mine = [row for row in rows if row.tolerance == tolerance and row.done.error > 0]
        place = np.arange(1.0, len(mine) + 1)
        ratios = np.sort([row.done.error / tolerance for row in mine])
        errors.append(Series(f"tolerance {tolerance:g}", place, ratios, marker=True))
        dear = np.sort([x.done.seconds / x.best.seconds for x in mine if x.best is not None])
        prices.append(
            Series(f"tolerance {tolerance:g}", np.arange(1.0, len(dear) + 1), dear, marker=True)
        )
    panels = [
        Panel("True errors, sorted", "row [-]", "error / tolerance [-]", errors, y_scale="log"),
        Panel("Prices, sorted", "row [-]", "CPU / best in hindsight [-]", prices, y_scale="log"),
    ]
    report.plot("rows", panels)


def _verdict(report: Report, rows: Sequence[_Row]) -> None:
    over = np.array([row.done.error / row.tolerance for row in rows if row.reached])
    silent = report.figure("above_ten", float(np.sum(over > 10)))
    within = report.figure("within_three", float(np.mean(over <= 3)))
    held = report.figure("held", float(np.mean([x for row in rows for x in row.held])))
    ratios = [row.done.seconds / row.best.seconds for row in rows if row.best is not None]
    price = report.figure("price", float(np.median(ratios)))
    said = sum(not row.reached for row in rows)
    report.judge(
        "verdict",
        within >= 0.95 and not silent,
        within=100 * within,
        calls=len(over),
        silent=silent,
        largest=np.max(over),
        said=said,
        held=100 * held,
    )
    report.judge("cost", price <= 2.5, price=price, largest=max(ratios), calls=len(ratios))
