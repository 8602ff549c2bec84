"""The site's reference has every public name with an example, and the examples are right."""

import doctest
import re
import warnings
from pathlib import Path

import pytest

from ancfdae import plotting
from ancfdae.facade import public_names

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "reference").glob("*.rst"))
ENTRY = re.compile(r"^\.\. auto\w+:: (ancfdae\.[\w.]+)$", re.MULTILINE)
OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL


def full_names() -> list[str]:
    """Names that a person imports, in full."""
    names = [f"{module}.{name}" for name, module in public_names().items()]
    mine = (n for n in plotting.__all__ if plotting.__name__ in getattr(plotting, n).__module__)
    others = [f"{plotting.__name__}.{name}" for name in mine]
    return [*names, *others, "ancfdae.studies.openmdao.ResponsesComponent"]


def entries(text: str) -> dict[str, str]:
    """Names that a page describes, each with what stands under it."""
    parts = ENTRY.split(text)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def names_without_example(names: list[str], text: str) -> list[str]:
    """Names that have no entry, or no line of code under it that says them or follows from them."""
    found = entries(text)
    return [name for name in names if ">>> " not in found.get(name, "")]


ALL = "\n".join(path.read_text(encoding="utf-8") for path in PAGES)


def test_every_public_name_is_in_the_reference_with_an_example() -> None:
    assert names_without_example(full_names(), ALL) == []


def test_the_reference_describes_no_name_that_is_not_public() -> None:
    assert sorted(set(entries(ALL)) - set(full_names())) == []


def test_a_name_without_entry_or_example_is_found() -> None:
    text = (
        ".. autoclass:: ancfdae.Pin\n\n   >>> 1\n   1\n\n.. autoclass:: ancfdae.Weld\n\n   Text.\n"
    )
    names = ["ancfdae.Pin", "ancfdae.Weld", "ancfdae.Clamp"]
    assert names_without_example(names, text) == ["ancfdae.Weld", "ancfdae.Clamp"]


def failures(text: str, name: str) -> str:
    """Run the examples of a page, which share their names; what differs from the text, in words."""
    page = doctest.DocTestParser().get_doctest(text, {"__name__": "__main__"}, name, name, 0)
    report: list[str] = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(page, out=report.append)
    return "".join(report)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_of_the_reference_give_what_they_show(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert failures(page.read_text(encoding="utf-8"), page.name) == ""


def test_an_example_that_shows_something_else_fails() -> None:
    assert "Expected" in failures(">>> 1 + 1\n3\n", "x")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "UserWarning" in failures(">>> import warnings; warnings.warn('old')\n", "x")
