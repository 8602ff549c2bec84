"""Report on optimisations of mechanisms by adjoint gradients."""

from collections.abc import Callable, Sequence

from validation.design.case import Case, gradient_check, optimality
from validation.design.coupler_path import coupler_path
from validation.design.crank_rod import crank_rod
from validation.design.identification import identification
from validation.design.two_link_arm import two_link_arm
from validation.design.whirling_beam import whirling_beam
from validation.external.runs import Requirement, add_verdict
from validation.report import Agreement, Report

__all__ = ["run"]

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
    report.heading("Method")
    report.text(_METHOD)
    requirements = [each for case in _CASES for each in tell(report, case(quick), quick)]
    report.heading("Verdict")
    report.text(_YES if add_verdict(report, requirements, quick) else _NO)
    report.heading("Limits")
    report.text(_LIMITS)


def tell(report: Report, case: Case, quick: bool) -> list[Requirement]:
    """Add the section of one optimisation; return what it had to reach."""
    found = case.found
    report.heading(case.title)
    report.text(case.question)
    report.text(
        f"Variables: {_names(case.variables)}. Method: {case.method}. The page to copy: "
        f"`validation/design/{case.key.replace('-', '_')}.py`."
    )
    at_optimum = _responses(report, case)
    moved = 1 if quick else None
    at_start, at_end = (gradient_check(case, x, moved) for x in (found.start, found.optimum))
    checks = at_start, at_end
    left, on_bounds = optimality(case), case.on_bounds()
    _work(report, case, checks, left)
    report.plot(case.key, case.panels, 2, case.title, case.caption)
    over = max([0.0, *_over(case, at_optimum)])
    _compare(report, case, over <= _VIOLATION)
    report.text(_ended(case, on_bounds) + " " + case.findings.strip())
    requirements = [
        Requirement(f"{case.key}: gradient at the start", _GRADIENT, checks[0]),
        Requirement(f"{case.key}: gradient at the optimum", _GRADIENT, checks[1]),
        Requirement(f"{case.key}: conditions of an optimum", _OPTIMALITY, left),
        Requirement(f"{case.key}: constraints exceeded by", _VIOLATION, over),
        Requirement(f"{case.key}: variables on bounds", len(case.variables) / 2, len(on_bounds)),
    ]
    return requirements + [
        Requirement(f"{case.key}: {each.what}", each.tolerance, each.apart)
        for each in case.comparisons
    ]


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
    for name, value in figures.items():
        report.figure(f"{case.key}.{name}", value)
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
        report.claim(
            f"{case.title}: {each.what}",
            f"{each.other:.5g} ({each.source})",
            f"{each.found:.5g}",
            Agreement.AGREES if feasible and each.apart <= each.tolerance else Agreement.DISAGREES,
        )
    report.table(["comparison", "here", "other", "the other is from"], rows)


def _ended(case: Case, on_bounds: list[str]) -> str:
    test = "SciPy's test of convergence is met" if case.found.success else "SciPy gave up early"
    bounds = f"on bounds end {_names(on_bounds)}" if on_bounds else "no variable ends on a bound"
    return f"{test}; {bounds}."


def _names(names: Sequence[str]) -> str:
    return ", ".join(names)


def _word(name: str) -> str:
    return "-".join("".join(c if c.isascii() and c.isalnum() else " " for c in name).split())


_METHOD = """
One file each in `validation/design/`: a page that builds scene and variables and calls SciPy, to
be copied, and below it what is drawn and compared. What the pages share is in
`validation/design/optimisation.py`: `Once` answers objective, constraints and derivatives at one
place from one run, and `constrained` is SLSQP within boxes that follow it, because far from where
it linearised mechanisms vibrate differently. Searches without gradients are COBYQA of SciPy; their
runs compute gradients, too, and do not use them.
Gradients are discrete adjoints, but those of sums of squares, which are by direct differentiation.
*Gradient* is the largest difference of an entry of the Jacobian from central differences of the
very call, over the largest entry of its row there or at the start. *Optimality* is what remains of
the gradient of the objective when active constraints and bounds have taken their part with
multipliers of the right sign, over that gradient at the start. A run is one simulation with all
its gradients. CPU is processor time of the optimisation alone.
"""

_YES = """
To the question: yes. Every optimisation ends where the conditions of an optimum hold, with
gradients that are those of the very call, and is no worse than what it is compared with.
"""

_NO = """
To the question: not everywhere; see the rows with NO.
"""

_LIMITS = """
- Optima belong to the meshes and steps named in the pages: two to six elements a beam.
- The search without gradients for the arm starts at the optimum: it shows that nothing near it is
  better, not that nothing else is.
- Optima are local. Where vibrations matter the constraints have several valleys, and another start
  may end in another.
- Smooth maxima over time lie below the largest value, by some per cent at the sharpness used;
  those over places lie above.
"""
