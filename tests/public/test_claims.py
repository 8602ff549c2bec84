"""Costs that pages quote come from results of reports, and none is typed."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.documents import README, ROOT

DOCS = ROOT / "docs"
#: Pages for readers. Reports are generated, theory derives its numbers, and `measurements` compares
#: two ways on one day, which it says.
PAGES = [
    path
    for path in (README, *sorted(DOCS.glob("*.md")), *sorted((DOCS / "howto").glob("*.md")))
    if path.stem != "measurements"
]
NAME = re.compile(r"\{\{ (\w+) \}\}")
CODE = re.compile(r"^\s*```.*?^\s*```", re.MULTILINE | re.DOTALL)
#: Times of a machine, and work in units of runs: what a faster program makes wrong.
COST = re.compile(
    r"\b\d[\d.,]* ?(?:ms|us|µs)\b(?= (?:a|an|per|for)\b)"
    r"|\b(?:takes?|took|costs?|cost of|needs?|in) (?:about |only )?\d[\d.,]*(?: to \d[\d.,]*)?"
    r" ?(?:ms|us|µs|s|minutes|seconds)\b"
    r"|(?<![\w/.,-])\d[\d.,]*(?: to \d[\d.,]*)? (?:of the (?:run|motion)\b|steps a second)"
    r"|\b\d[\d.,]*(?: to \d[\d.,]*)? runs? for (?:each|every)"
    r"|\bcosts? (?:about )?\d[\d.,]*(?: to \d[\d.,]*)? (?:times|%)"
    r"|\b\d[\d.,]*(?: to \d[\d.,]*)? times the (?:cost|time|processor time|cheapest|run)\b"
)
#: Costs that are no measurements of a report, and what they are.
TYPED = {
    "howto/events.md": ["3.3 to 3.6 times the processor time"],  # HHT repeats a phase 2.3 times.
    "howto/step.md": ["70 times the time"],  # 727 steps for 64, and their iterations.
}


def claims() -> ModuleType:
    """Return docs/claims.py, which is no module of a package."""
    spec = importlib.util.spec_from_file_location("claims", DOCS / "claims.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def typed_costs(text: str) -> list[str]:
    """Return the costs that a page writes in figures outside its programs."""
    return [found[0] for found in COST.finditer(" ".join(CODE.sub("", text).split()))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_page_types_what_something_costs(page: Path) -> None:
    allowed = TYPED.get(str(page.relative_to(DOCS)) if page != README else "", [])
    assert typed_costs(page.read_text(encoding="utf-8")) == allowed


def test_a_typed_cost_is_found() -> None:
    stale = """
    | `DirectDifferentiation()` | 0.5 of the run, 7 % more |
    | `ComplexStep()` | about 3 runs for each variable |
    order 5, implicit: 20 to 90 steps a second; a step takes about 0.07 ms, and all takes 0.1 s.
    `HHT(step=0.01)` for 5 s, 20 steps give 1 %; 3.7 times the cheapest setting.
    """
    assert typed_costs(stale) == [
        "0.5 of the run",
        "3 runs for each",
        "20 to 90 steps a second",
        "takes about 0.07 ms",
        "takes 0.1 s",
        "3.7 times the cheapest",
    ]
    assert typed_costs("costs {{ adjoint }} of the run") == []


def test_pages_quote_claims_that_exist_and_every_claim_is_quoted() -> None:
    known = claims().CLAIMS
    quoted = {name for page in PAGES for name in NAME.findall(page.read_text(encoding="utf-8"))}
    assert sorted(quoted - known.keys()) == []
    assert sorted(known.keys() - quoted) == []


def test_the_readme_quotes_none_as_it_is_read_without_the_site() -> None:
    assert "{{" not in README.read_text(encoding="utf-8")


def test_claims_follow_the_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six variables of a complex step at 19 motions are 3 runs each; a step of 28 us is 0.03 ms."""
    module = claims()
    real = module._figures
    changed = {
        "crank-slider": {"cost.complex_step.ratio": 19.0},
        "performance": {
            "a_step_and_its_derivatives.step_of_the_crank_slider_newton_1e_08": 42.0,
            "a_step_and_its_derivatives.six_variables_directly_against_the_motion": 3.0,
            "a_step_and_its_derivatives.each_further_variable": 20.0,
        },
        "elements": {"deflection.2d.nu0.3.h0.01.full-law.n64": -0.2},
        "integrators": {
            f"pendulum.HHT-I3.2-{k}.{what}": error
            for k in range(7, 17)
            for what, error in (
                ("deflection", 0.02 if k < 9 else 0.01),
                ("h-sensitivity", 0.4 if k < 11 else 1e-3),
                ("E-sensitivity", 0.02 if k < 16 else 1e-3),
            )
        },
    }
    monkeypatch.setattr(module, "_figures", lambda name: real(name) | changed.get(name, {}))
    found = module._methods() | module._speeds() | module._elements() | module._steps()
    steps = [found[f"step_of_{name}"] for name in ("deflection", "height", "modulus")]
    assert steps == ["2⁻⁹", "2⁻¹¹", "2⁻¹⁶"]
    assert found["missed_at_this_step"] == "40"
    assert found["full_law"] == "1.25"
    assert found["complex_step"] == "3"
    assert found["direct_first"] == "1"  # 3 - 1 - 5 x 0.2
    assert found["step_crank"] == "0.04"


def test_numbers_are_shown_with_their_digits() -> None:
    module = claims()
    assert [module._shown(x) for x in (0.0374, 2.144, 103.0, 1e-6)] == [
        "0.037",
        "2.1",
        "100",
        "1e-06",
    ]
    assert module._range([0.011, 0.0104]) == "0.01"
    assert module._range([0.3, 0.04]) == "0.04 to 0.3"
    assert module._range([]) == "not reached"
