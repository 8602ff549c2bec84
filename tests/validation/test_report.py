"""A report is written whole or not at all, and its numbers are there for programs as well."""

import json
import math
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import ancfdae
import validation.report
from ancfdae import plotting
from ancfdae.errors import InvalidInputError
from ancfdae.plotting import Panel, Series
from validation.__main__ import main
from validation.catalogue import CATALOGUE, Definition
from validation.prose import Prose
from validation.report import Agreement, Report, environment

REPORTS = Path(__file__).resolve().parents[2] / "docs" / "reports"
PANEL = Panel("Line", "t [s]", "y [m]", [Series("y", [0.0, 1.0], [0.0, 2.0])])


@pytest.fixture
def report(tmp_path: Path) -> Report:
    return Report(Prose("A title", "A question?"), tmp_path / "out", "python -m validation run it")


def written(report: Report) -> tuple[str, dict[str, dict[str, object]]]:
    return written_in(report.write().parent)


def written_in(folder: Path) -> tuple[str, dict[str, dict[str, object]]]:
    results = json.loads((folder / "results.json").read_text())
    return (folder / "report.md").read_text(), results


def fill(report: Report) -> None:
    report.heading("Motion")
    report.text("Words.")
    report.figure("tip_x", -1.125)
    report.plot("motion", [PANEL], caption="A caption.")


def test_write_makes_exactly_the_declared_files(report: Report, tmp_path: Path) -> None:
    fill(report)
    path = report.write()
    assert path == tmp_path / "out" / "report.md"
    names = sorted(entry.name for entry in path.parent.iterdir())
    assert names == ["motion.png", "motion.svg", "report.md", "results.json"]


def test_blocks_stand_in_the_order_of_the_calls(report: Report) -> None:
    fill(report)
    report.heading("Detail", level=3)
    text, _ = written(report)
    blocks = ["# A title", "A question?", "## Motion", "Words."]
    blocks += ["![Line](motion.svg)", "*A caption.*", "### Detail"]
    assert text.startswith("\n\n".join(blocks) + "\n\n---\n")


def test_results_follow_the_schema(report: Report) -> None:
    report.figure("b", 2.0)
    assert report.figure("a", np.float64(0.1)) == 0.1
    path = report.write()
    raw = (path.parent / "results.json").read_text()
    results = json.loads(raw)
    assert results["figures"] == {"a": 0.1, "b": 2.0}
    assert set(results["meta"]) == {
        *("python", "numpy", "scipy", "matplotlib", "scikit-sundae", "ancfdae"),
        *("processor", "commit", "dirty", "command", "started", "seconds"),
    }
    assert results["meta"]["command"] == "python -m validation run it"
    assert results["meta"]["numpy"] == np.__version__
    assert results["meta"]["seconds"] >= 0.0
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", results["meta"]["started"])
    assert raw == json.dumps(results, indent=2, sort_keys=True) + "\n"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_figure_that_is_not_finite_is_null_and_the_report_says_so(
    report: Report, value: float
) -> None:
    report.figure("fine", 1.0)
    report.figure("lost", value)
    text, results = written(report)
    assert results["figures"] == {"fine": 1.0, "lost": None}
    assert f"| lost | {value} |" in text
    assert "| fine |" not in text


def test_report_with_finite_figures_mentions_no_lost_ones(report: Report) -> None:
    report.figure("fine", 1.0)
    assert "not finite" not in written(report)[0]


def test_repeated_names_are_refused(report: Report) -> None:
    fill(report)
    with pytest.raises(InvalidInputError, match=r"Report\.figure: .*'tip_x'"):
        report.figure("tip_x", 1.0)
    with pytest.raises(InvalidInputError, match=r"Report\.plot: .*'motion'"):
        report.plot("motion", [PANEL])


@pytest.mark.parametrize("name", ["", "a/b", "../a", "1st", "a b", "a\n"])
def test_names_that_are_not_flat_are_refused(report: Report, name: str) -> None:
    with pytest.raises(InvalidInputError, match=r"Report\.figure"):
        report.figure(name, 1.0)
    with pytest.raises(InvalidInputError, match=r"Report\.plot"):
        report.plot(name, [PANEL])


@pytest.mark.parametrize("level", [1, 5])
def test_heading_level_outside_2_to_4_is_refused(report: Report, level: int) -> None:
    with pytest.raises(InvalidInputError, match=r"Report\.heading"):
        report.heading("Motion", level)


def test_table_formats_numbers_and_keeps_cells_apart(report: Report) -> None:
    report.table(
        ["h [s]", "steps", "note"],
        [(2.0**-7, 128, "a|b\nc"), (np.float32(0.5), np.int64(2), True)],
    )
    expected = [
        "| h [s] | steps | note |",
        "| ---: | ---: | --- |",
        "| 0.0078125 | 128 | a\\|b c |",
        "| 0.5 | 2 | True |",
    ]
    assert "\n".join(expected) in written(report)[0]


@pytest.mark.parametrize("rows", [[], [(1.0,)], [(1.0, 2.0), (1.0, 2.0, 3.0)]])
def test_table_with_missing_cells_is_refused(report: Report, rows: list[tuple[float, ...]]) -> None:
    with pytest.raises(InvalidInputError, match="rows of 2 cells"):
        report.table(["x", "y"], rows)


def test_claims_are_gathered_in_one_table_with_their_verdicts(report: Report) -> None:
    verdicts = list(Agreement)
    for verdict in verdicts:
        report.claim(f"claim {verdict.name}", "as printed", "as found", verdict)
        report.text("Something between the claims.")
    rows = [f"| claim {v.name} | as printed | as found | {v.value} |" for v in verdicts]
    assert "\n".join(rows) in written(report)[0]
    assert len({verdict.value for verdict in verdicts}) == 4


def test_nothing_is_on_disk_before_write(report: Report, tmp_path: Path) -> None:
    fill(report)
    assert list(tmp_path.iterdir()) == []


def test_failed_write_leaves_the_older_report_as_it_was(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(report)
    report.write()
    folder = tmp_path / "out"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    second = Report(Prose("Another title", "Why?"), folder, "python")
    second.figure("tip_x", 2.0)
    second.plot("motion", [PANEL], title="Another")
    second.plot("zebra", [PANEL])
    save: Callable[..., tuple[Path, Path]] = plotting.save

    def full_disk(figure: plotting.Figure, path: Path) -> tuple[Path, Path]:
        if path.name == "zebra":
            raise OSError("no space left on device")
        return save(figure, path)

    monkeypatch.setattr(validation.report.plotting, "save", full_disk)
    with pytest.raises(OSError, match="no space left"):
        second.write()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_second_write_replaces_the_first(report: Report, tmp_path: Path) -> None:
    fill(report)
    report.write()
    second = Report(Prose("Another title", "Why?"), tmp_path / "out", "python")
    text, results = written(second)
    assert text.startswith("# Another title\n")
    assert results["figures"] == {}


def test_commit_is_that_of_the_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation.report, "__file__", str(tmp_path / "report.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert (environment()["commit"], environment()["dirty"]) == (None, None)

    def git(*words: str) -> str:
        identity = ["-c", "user.name=A", "-c", "user.email=a@example.org"]
        command = ["git", *identity, *words]
        return subprocess.run(
            command, cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout.strip()

    git("init", "--quiet")
    git("commit", "--quiet", "--allow-empty", "--message", "A commit")
    assert (environment()["commit"], environment()["dirty"]) == (git("rev-parse", "HEAD"), False)
    (tmp_path / "new.txt").write_text("new")
    assert environment()["dirty"] is True


def definition(run: Callable[[Report, bool], None]) -> Definition:
    return Definition("sample", Prose("A sample", "Does it run?"), run)


def test_list_names_every_report_and_its_question(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    listed = capsys.readouterr().out
    for entry in CATALOGUE:
        assert f"{entry.name}: {entry.prose.title}\n" in listed
        assert entry.prose.question in listed


def test_names_in_the_catalogue_are_unique() -> None:
    names = [entry.name for entry in CATALOGUE]
    assert len(set(names)) == len(names) > 0


def test_unknown_report_exits_2_and_lists_the_known_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", "pendulums"]) == 2
    complaint = capsys.readouterr().err
    assert "'pendulums'" in complaint
    assert all(entry.name in complaint for entry in CATALOGUE)


@pytest.mark.parametrize("words", [[], ["walk"], ["run"]])
def test_wrong_usage_exits_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    assert "usage: python -m validation" in capsys.readouterr().err


@pytest.mark.parametrize("quick", [False, True])
def test_run_passes_quick_on_writes_and_says_where(
    quick: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["run", "sample"] + ["--quick"] * quick
    seen = []
    assert main(words, [definition(lambda report, quick: seen.append(quick))]) == 0
    assert seen == [quick]
    path = Path("out/sample/report.md")
    assert str(path) in capsys.readouterr().out
    assert ("not results" in path.read_text()) is quick
    meta = json.loads(path.with_name("results.json").read_text())["meta"]
    assert meta["command"] == "python -m validation " + " ".join(words)
    assert meta["ancfdae"] == ancfdae.__version__


def test_run_writes_to_the_folder_that_is_asked_for(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "folder"
    assert main(["run", "sample", "--out", str(folder)], [definition(lambda *_: None)]) == 0
    text, results = written_in(folder)
    assert text.startswith("# A sample\n\nDoes it run?\n")
    # A committed report names no folder of the machine that made it.
    assert results["meta"]["command"] == "python -m validation run sample"
    assert str(tmp_path) not in text


@pytest.mark.parametrize("path", sorted(REPORTS.glob("*/report.md")), ids=lambda x: x.parent.name)
def test_committed_reports_come_from_a_clean_checkout_of_a_known_version(path: Path) -> None:
    text, results = written_in(path.parent)
    meta = results["meta"]
    assert meta["command"] == f"python -m validation run {path.parent.name}"
    assert meta["dirty"] is False
    versions = f"with ancfdae {meta['ancfdae']} at commit {meta['commit']} without uncommitted"
    assert f"Made by `{meta['command']}`" in text.splitlines()[-1]
    assert versions in text.splitlines()[-1]


def test_failing_report_exits_1_with_its_error_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(report: Report, quick: bool) -> None:
        report.figure("a", 1.0)
        report.figure("a", 2.0)

    assert main(["run", "sample", "--out", str(tmp_path)], [definition(run)]) == 1
    assert "sample failed: Report.figure" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
