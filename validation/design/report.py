"""Report on optimisations of mechanisms by adjoint gradients."""

from collections.abc import Callable, Sequence

from validation.design.case import Case, gradient_check, optimality
from validation.design.coupler_path import coupler_path
from validation.design.crank_rod import crank_rod
from validation.design.identification import identification
from validation.design.two_link_arm import two_link_arm
from validation.design.whirling_beam import whirling_beam
from validation.report import Report

# Each takes `quick`: few elements, steps and iterations.
_CASES: tuple[Callable[[bool], Case], ...] = (
    crank_rod,
    two_link_arm,
    whirling_beam,
    coupler_path,
    identification,
)

# Central differences of step 1e-5 are right to 1e-10, or to the round-off of a run, 1e-12 and
# less, over the step; responses of vibrating mechanisms curve more.
_GRADIENT = 1e-5
# SciPy ends where steps no longer change the objective by 1e-6 or so; slopes are then some 1e-3.
_OPTIMALITY = 1e-2
_VIOLATION = 1e-3


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `design`; add its text, tables and figures."""
    report.say("method")
    for case in _CASES:
        tell(report, case(quick), quick)
    report.heading("Verdict")
    report.say("yes" if report.verdict(quick) else "no")
    report.say("limits")


def tell(report: Report, case: Case, quick: bool) -> None:
    """Add the section of one optimisation."""
    found = case.found
    report.say(case.key)
    report.say("page", variables=_names(case.variables), case=case, page=case.key.replace("-", "_"))
    at_optimum = _responses(report, case)
    moved = 1 if quick else None
    at_start, at_end = (gradient_check(case, x, moved) for x in (found.start, found.optimum))
    checks = at_start, at_end
    left, on_bounds = optimality(case), case.on_bounds()
    _work(report, case, checks, left)
    report.plot(case.key, case.panels, 2)
    over = max([0.0, *_over(case, at_optimum)])
    _compare(report, case, over <= _VIOLATION)
    report.text(_ended(case, on_bounds) + " " + case.findings.strip())
    require, key = report.requirement, case.key
    require(f"{key}: gradient at the start", _GRADIENT, checks[0])
    require(f"{key}: gradient at the optimum", _GRADIENT, checks[1])
    require(f"{key}: conditions of an optimum", _OPTIMALITY, left)
    require(f"{key}: constraints exceeded by", _VIOLATION, over)
    require(f"{key}: variables on bounds", len(case.variables) / 2, len(on_bounds))
    for each in case.comparisons:
        require(f"{key}: {each.what}", each.tolerance, each.apart)


def _responses(report: Report, case: Case) -> list[float]:
    """Add the table of objective and constraints; return their values at the optimum."""
    places = ("start", case.found.start), ("optimum", case.found.optimum)
    values = [[float(x) for x in case.found.evaluate(place)[0]] for _, place in places]
    rows = []
    for response, start, optimum in zip(case.responses, *values, strict=True):
        word = _word(response.name)
        report.figure(f"{case.key}.{word}.start", start)
        report.figure(f"{case.key}.{word}.optimum", optimum)
        limit = "objective" if response.limit is None else f"at most {response.limit:g}"
        active = "active" if response.active(optimum) else ""
        name = f"{response.name} [{response.unit}]"
        rows.append([name, limit, f"{start:.6g}", f"{optimum:.6g}", active])
    report.table(["", "limit", "start", "optimum", ""], rows)
    return values[1]


def _work(report: Report, case: Case, checks: tuple[float, float], left: float) -> None:
    found = case.found
    figures = {
        "iterations": found.iterations,
        "runs": found.runs,
        "seconds": found.seconds,
        "gradient.start": checks[0],
        "gradient.optimum": checks[1],
        "optimality": left,
    }
    report.figures(f"{case.key}.{{}}", figures, figures.values())
    report.table(
        [
            "variables",
            "iterations",
            "runs",
            "CPU [s]",
            "gradient, start",
            "gradient, optimum",
            "optimality",
        ],
        [
            [
                len(case.variables),
                found.iterations,
                found.runs,
                f"{found.seconds:.1f}",
                *[f"{x:.1e}" for x in (*checks, left)],
            ]
        ],
    )


def _over(case: Case, values: Sequence[float]) -> list[float]:
    """Return by how much each limit is exceeded, relative; absolute for limits of zero."""
    return [
        (value - response.limit) / (abs(response.limit) or 1.0)
        for value, response in zip(values, case.responses, strict=True)
        if response.limit is not None
    ]


def _compare(report: Report, case: Case, feasible: bool) -> None:
    """Add the table of comparisons; a design that exceeds its limits agrees with nothing."""
    rows: list[list[object]] = []
    for each in case.comparisons:
        word = _word(each.what)
        report.figure(f"{case.key}.{word}.found", each.found)
        report.figure(f"{case.key}.{word}.other", each.other)
        rows.append([each.what, f"{each.found:.6g}", f"{each.other:.6g}", each.source])
        report.judge("comparison", feasible and each.apart <= each.tolerance, case=case, each=each)
    report.table(["comparison", "here", "other", "the other is from"], rows)


def _ended(case: Case, on_bounds: list[str]) -> str:
    test = "SciPy's test of convergence is met" if case.found.success else "SciPy gave up early"
    bounds = f"on bounds end {_names(on_bounds)}" if on_bounds else "no variable ends on a bound"
    return f"{test}; {bounds}."


def _names(names: Sequence[str]) -> str:
    return ", ".join(names)


def _word(name: str) -> str:
    return "-".join("".join(c if c.isascii() and c.isalnum() else " " for c in name).split())
