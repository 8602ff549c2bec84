"""The words of each report stand in a Markdown file, and each of its entries is used."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import validation
from validation.catalogue import CATALOGUE
from validation.prose import Prose
from validation.report import Agreement, Report

FOLDER = Path(validation.__file__).parent
WORDS = """# A title

A question
on two lines?

<!-- method -->
## Method

With {n} elements.

<!-- claims -->
| claim | statement | what the theory says | what we see |
| --- | --- | --- | --- |
| tip | the tip, \\|u\\| | {asked} | {found:.1e}, {places[0]:g} |

<!-- requirements -->
| requirement | figure | at most |
| --- | --- | --- |
| tip | tip, {n} elements | 2e-3 |

<!-- plots -->
| plot | title | caption |
| --- | --- | --- |
| motion | Motion | |
"""


def test_file_is_read_into_title_blocks_claims_and_plots(tmp_path: Path) -> None:
    file = tmp_path / "report.md"
    file.write_text(WORDS)
    prose = Prose.read(file)
    assert (prose.title, prose.question) == ("A title", "A question on two lines?")
    assert prose.source == "theory"
    assert prose.blocks == {"method": "## Method\n\nWith {n} elements."}
    assert prose.claims == {"tip": ["the tip, |u|", "{asked}", "{found:.1e}, {places[0]:g}"]}
    assert prose.requirements == {"tip": ["tip, {n} elements", "2e-3"]}
    assert prose.plots == {"motion": ["Motion", ""]}


def test_places_are_filled_and_a_truth_value_is_a_verdict(tmp_path: Path) -> None:
    file = tmp_path / "report.md"
    file.write_text(WORDS)
    report = Report(Prose.read(file), tmp_path, "python -m validation run it")
    report.say("method", n=4)
    report.judge("tip", True, asked="0", found=1e-9, places=[0.5])
    report.judge("tip", False, asked="0", found=1.0, places=[0.5])
    report.judge("tip", Agreement.PARTLY, asked="0", found=0.1, places=[0.5])
    text = report.write().read_text()
    assert "\n\n## Method\n\nWith 4 elements.\n\n" in text
    assert "| the tip, \\|u\\| | 0 | 1.0e-09, 0.5 | agrees |" in text
    assert "| 1.0e+00, 0.5 | disagrees |" in text
    assert "| 1.0e-01, 0.5 | partly |" in text


def test_value_without_which_a_place_stays_empty_is_missed(tmp_path: Path) -> None:
    file = tmp_path / "report.md"
    file.write_text(WORDS)
    with pytest.raises(KeyError, match="n"):
        Report(Prose.read(file), tmp_path, "python").say("method")


@pytest.mark.parametrize(("found", "reached"), [(1e-3, True), (2e-3, True), (2.1e-3, False)])
def test_requirement_is_reached_up_to_its_limit(
    tmp_path: Path, found: float, reached: bool
) -> None:
    file = tmp_path / "report.md"
    file.write_text(WORDS)
    report = Report(Prose.read(file), tmp_path, "python")
    report.require("tip", found, n=8)
    report.requirement("of a package that is not installed", 1.0, None)
    assert report.verdict(quick=False) is reached
    text = report.write().read_text()
    assert f"{reached:d} of 1 figures are reached; 1 could not be measured" in text
    assert f"| tip, 8 elements | 0.002 | {found:g} | {'yes' if reached else 'NO'} |" in text


def nodes() -> Iterator[ast.AST]:
    """Yield the nodes of the code of all reports."""
    for file in FOLDER.rglob("*.py"):
        yield from ast.walk(ast.parse(file.read_text()))


def keys_of(call: str) -> set[object]:
    """Return the constants that a call of `Report` takes, or a table of keys may give it."""
    found: list[ast.AST] = []
    for node in nodes():
        match node:
            case ast.Call(ast.Attribute(attr=name), [first, *_]) if name == call:
                found.append(first)
            case ast.Dict(keys=keys):
                found += [key for key in keys if key is not None]
            case ast.keyword(arg="key", value=value):
                found.append(value)
            case ast.Call(ast.Name(id="_compare" | "_fill"), arguments):
                found += arguments
    constants = (part for node in found for part in ast.walk(node))
    return {part.value for part in constants if isinstance(part, ast.Constant)}


@pytest.mark.parametrize(
    ("call", "table"),
    [("say", "blocks"), ("judge", "claims"), ("require", "requirements"), ("plot", "plots")],
)
def test_every_entry_of_every_report_is_used(call: str, table: str) -> None:
    used = keys_of(call)
    entries = {(x.name, key) for x in CATALOGUE for key in getattr(x.prose, table)}
    assert {(name, key) for name, key in entries if key not in used} == set()


@pytest.mark.parametrize("file", sorted(FOLDER.rglob("*.md")), ids=lambda file: file.parent.name)
def test_every_key_stands_once(file: Path) -> None:
    keys, table = list[object](), ""
    for line in file.read_text().splitlines():
        if line.startswith("<!-- "):
            table = line.split()[1]
            keys.append(table)
        elif line.startswith("| ") and table in ("claims", "requirements", "plots"):
            keys.append((table, line.split(" | ")[0]))
    assert [key for key, times in Counter(keys).items() if times > 1] == []


def places(texts: list[str]) -> set[str]:
    """Return the names of the values that the places of texts ask for."""
    fields = [field for text in texts for _, field, _, _ in Formatter().parse(text) if field]
    return {field.split(".")[0].split("[")[0] for field in fields}


def test_every_call_passes_the_values_of_its_places() -> None:
    words = [entry.prose for entry in CATALOGUE]
    known = {
        "say": [(key, places([text])) for x in words for key, text in x.blocks.items()],
        "judge": [(key, places(cells)) for x in words for key, cells in x.claims.items()],
        "require": [(key, places(text)) for x in words for key, text in x.requirements.items()],
    }
    for node in nodes():
        match node:
            case ast.Call(
                ast.Attribute(attr="say" | "judge" | "require" as call), [ast.Constant(key), *_]
            ):
                assert (key, {word.arg for word in node.keywords}) in known[call]
