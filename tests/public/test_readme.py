"""What the documents tell people to run does run, and CI runs the same."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.documents import README, ROOT, Block, python_blocks

RUN = ROOT / ".ci" / "run"
MARKED = re.compile(r"^<!-- command: (\w+) -->\n```bash\n([^\n]+)\n```$", re.MULTILINE)
MARK = "<!-- command:"


DOCUMENTS = [README, *sorted((ROOT / "docs").glob("**/*.md"))]
BLOCKS = [
    block
    for path in DOCUMENTS
    for block in python_blocks(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
]


def run_block(block: Block) -> dict[str, object]:
    """Execute a block; line numbers in a traceback are those of the document."""
    source = "\n" * (block.line - 1) + block.code
    namespace: dict[str, object] = {"__name__": "__main__"}
    exec(compile(source, block.document, "exec"), namespace)
    return namespace


@pytest.mark.parametrize(
    "block", [pytest.param(block, id=f"{block.document}:{block.line}") for block in BLOCKS]
)
def test_python_in_the_documents_runs(
    block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_block(block)


@pytest.mark.parametrize("path", [README, ROOT / "docs" / "index.md"], ids=["readme", "site"])
def test_the_output_under_the_first_program_is_what_it_prints(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = path.read_text(encoding="utf-8")
    shown = re.search(r"^```text\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert shown is not None
    run_block(python_blocks(path.name, text)[0])
    assert capsys.readouterr().out == shown[1]


def test_modules_that_documents_name_exist() -> None:
    for path in DOCUMENTS:
        if path.name == "changelog.md":  # It names modules that are gone.
            continue
        for name in re.findall(r"`([\w/]+\.py)`", path.read_text(encoding="utf-8")):
            assert (ROOT / name).exists() or (ROOT / "ancfdae" / name).exists(), (path.name, name)


def test_every_python_fence_in_the_documents_is_found() -> None:
    fences = sum(
        line.lstrip().startswith(("```py", "~~~py"))
        for path in DOCUMENTS
        for line in path.read_text(encoding="utf-8").splitlines()
    )
    assert len(BLOCKS) == fences


def test_blocks_are_found_indented_or_not_and_other_languages_left_out() -> None:
    text = "```bash\nls\n```\n\n```python\na = 1\n```\n\n- item\n\n  ```py\n  b = 2\n  ```\n"
    assert python_blocks("x.md", text) == [
        Block("x.md", 6, "a = 1\n"),
        Block("x.md", 12, "b = 2\n"),
    ]


def test_failing_block_fails_at_its_line_and_sees_nothing_of_other_blocks() -> None:
    first, second = python_blocks("x.md", "```python\na = 1\n```\n```python\nprint(a)\n```\n")
    assert run_block(first)["a"] == 1
    with pytest.raises(NameError) as error:
        run_block(second)
    assert error.traceback[-1].lineno + 1 == 5


def test_readme_has_exactly_the_two_marked_commands() -> None:
    text = README.read_text(encoding="utf-8")
    names = [name for name, _ in MARKED.findall(text)]
    assert sorted(names) == ["report", "test"]
    assert text.count(MARK) == 2


def test_commands_start_from_nothing_but_a_checkout_and_python3() -> None:
    for name, command in MARKED.findall(README.read_text(encoding="utf-8")):
        first, install, last = command.split(" && ")
        assert first == "python3 -m venv .venv", name
        assert install.startswith(".venv/bin/python -m pip install "), name
        assert last.startswith(".venv/bin/python -m "), name


def checkout(folder: Path, command: str) -> Path:
    """Lay out a checkout whose tools only note how they were called."""
    (folder / ".ci").mkdir()
    shutil.copy(RUN, folder / ".ci" / "run")
    (folder / "README.md").write_text(
        "```bash\nexit 9\n```\n<!-- command: report -->\n```bash\nexit 8\n```\n\n"
        f"<!-- command: test -->\n```bash\n{command}\n```\n\n```bash\nexit 7\n```\n"
    )
    tools = folder / ".venv" / "bin"
    tools.mkdir(parents=True)
    # Answers that sundials4py is there, so that the stage of IDAS installs nothing.
    interpreter = tools / "python"
    interpreter.write_text("#!/bin/sh\nexit 0\n")
    interpreter.chmod(0o755)
    # Is there already, so that the stage of ffmpeg installs nothing.
    (folder / "names").mkdir()
    (folder / "names" / "ffprobe").symlink_to(interpreter)
    for name in ("ruff", "mypy", "lint-imports"):
        tool = tools / name
        tool.write_text(f'#!/bin/sh\necho {name} "$@" >> calls\n[ ! -e "break-{name}" ]\n')
        tool.chmod(0o755)
    return folder


def run_ci(folder: Path, python: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the script with `python`, or this interpreter, as the python3 on PATH."""
    names = folder / "names"
    (names / "python3").symlink_to(python or sys.executable)
    return subprocess.run(
        ["bash", str(folder / ".ci" / "run")],
        env={**os.environ, "PATH": f"{names}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )


def calls(folder: Path) -> list[str]:
    record = folder / "calls"
    return record.read_text().splitlines() if record.exists() else []


CHECKS = ["ruff check .", "ruff format --check .", "lint-imports", "mypy"]


def test_ci_runs_the_test_command_of_the_readme_and_then_the_checks(tmp_path: Path) -> None:
    command = 'echo "threads $OPENBLAS_NUM_THREADS $OMP_NUM_THREADS" > calls && echo "a b" >> calls'
    done = run_ci(checkout(tmp_path, command))
    assert done.returncode == 0, done.stderr
    assert calls(tmp_path) == ["threads 1 1", "a b", *CHECKS]
    assert len(re.findall(r"^(?:\w+: )?== .+ passed in \d+ s$", done.stdout, re.MULTILINE)) == 16
    assert "the tests of IDAS ran with the others" in done.stdout


def test_ci_fails_with_the_test_command(tmp_path: Path) -> None:
    done = run_ci(checkout(tmp_path, "echo tests > calls && false"))
    assert done.returncode != 0
    assert calls(tmp_path) == ["tests"]
    assert "test command of README.md failed" in done.stderr


@pytest.mark.parametrize(("tool", "made"), [("ruff", 1), ("lint-imports", 3), ("mypy", 4)])
def test_ci_fails_with_each_check(tmp_path: Path, tool: str, made: int) -> None:
    folder = checkout(tmp_path, "true")
    (folder / f"break-{tool}").touch()
    assert run_ci(folder).returncode != 0
    assert calls(folder) == CHECKS[:made]


@pytest.mark.parametrize("lane", ["documents", "installed"])
def test_ci_fails_with_each_lane(tmp_path: Path, lane: str) -> None:
    folder = checkout(tmp_path, "true")
    breaks = {"documents": "sphinx", "installed": "installed_wheel"}[lane]
    interpreter = folder / ".venv" / "bin" / "python"
    interpreter.write_text(f'#!/bin/sh\ncase "$*" in *{breaks}*) exit 1;; esac\n')
    done = run_ci(folder)
    assert done.returncode != 0
    assert f"failed: {lane}" in done.stderr


def test_ci_without_a_marked_test_command_says_so(tmp_path: Path) -> None:
    folder = checkout(tmp_path, "true")
    (folder / "README.md").write_text("```bash\ntrue\n```\n")
    done = run_ci(folder)
    assert done.returncode != 0
    assert "'<!-- command: test -->'" in done.stderr
    assert calls(folder) == []


def test_ci_refuses_a_python_that_is_too_old_in_a_sentence(tmp_path: Path) -> None:
    folder = checkout(tmp_path, "true")
    old = tmp_path / "old-python"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo Python 3.10.13\nexit 1\n')
    old.chmod(0o755)
    done = run_ci(folder, old)
    assert done.returncode != 0
    assert "must be Python 3.11 or newer; got Python 3.10.13" in done.stderr
    assert calls(folder) == []


def test_warning_from_a_document_is_an_error() -> None:
    with pytest.raises(UserWarning, match="old"):
        run_block(Block("x.md", 1, "import warnings\nwarnings.warn('old')"))


def test_the_film_at_the_top_is_made_by_its_script_and_small(tmp_path: Path) -> None:
    kept = ROOT / "docs" / "moving-mechanism.gif"
    assert f"({kept.relative_to(ROOT)})" in README.read_text(encoding="utf-8")
    assert kept.stat().st_size < 600_000
    source = (ROOT / "docs" / "moving_mechanism.py").read_text(encoding="utf-8")
    script: dict[str, Any] = {"__name__": "film"}
    exec(compile(source, "moving_mechanism.py", "exec"), script)
    run = script["derivatives"](8 / 512)
    assert script["film"](tmp_path / "film.gif", run, frames=2).stat().st_size > 5_000
