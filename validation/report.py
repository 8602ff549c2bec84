"""A report as Markdown for people and JSON for programs, written whole or not at all."""

import importlib.metadata
import json
import math
import numbers
import platform
import re
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path
from typing import Final, cast, final

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

import ancfdae
from ancfdae import plotting
from ancfdae.errors import InvalidInputError
from ancfdae.numerics.timing import stopwatch
from validation.prose import Prose

_FLAT_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")
_PACKAGES: Final = ("numpy", "scipy", "matplotlib", "scikit-sundae")


class Agreement(Enum):
    """How a finding compares with a claim of the source paper."""

    AGREES = "agrees"
    PARTLY = "partly"
    DISAGREES = "disagrees"
    NOT_CHECKABLE = "not checkable"


# A verdict; True agrees and False disagrees.
Verdict = Agreement | bool | np.bool | npt.NDArray[np.bool]


@final
class Report:
    """A report under construction; nothing is on disk before `write`.

    Parameters
    ----------
    prose : Prose
        Title, question, and the words that `say`, `judge` and `plot` take by key.
    directory : Path
        Where `write` puts the files; created if missing.
    command : str
        Command that makes this report; kept with the results.
    """

    def __init__(self, prose: Prose, directory: Path, command: str) -> None:
        self._prose = prose
        self._directory = directory
        self._command = command
        self._started = datetime.now(UTC)
        self._clock = stopwatch(wall=True)
        self._body: list[str] = []
        self._claims: list[tuple[str, str, str, str]] = []
        self.requirements: list[tuple[str, float, float | None]] = []
        self._figures: dict[str, float] = {}
        self._plots: dict[str, plotting.Figure] = {}
        # In a terminal only; how many parts there will be nobody knows.
        self._bar = tqdm(desc=prose.title, disable=None, unit=" parts")

    def heading(self, text: str, level: int = 2) -> None:
        """Start a section; `level` is 2 to 4, as 1 is the title of the report."""
        if not 2 <= level <= 4:
            raise InvalidInputError("Report.heading", "level must be 2, 3 or 4", level)
        self._body.append(f"{'#' * level} {text}")
        self._bar.update()

    def say(self, key: str, **values: object) -> None:
        """Add a block of the report's Markdown file, its places filled with the values."""
        self._body.append(self._prose.blocks[key].format(**values))
        self._bar.update(self._body[-1].startswith("#"))

    def text(self, markdown: str) -> None:
        """Add a paragraph, list or other block of Markdown."""
        self._body.append(markdown.strip())

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Add a table.

        Parameters
        ----------
        header : sequence of str
            Column titles.
        rows : sequence of sequences
            Cells; real numbers are shown with six significant digits, anything else as `str` does.

        Raises
        ------
        InvalidInputError
            If there are no rows or a row has not as many cells as the header.
        """
        self._body.append(_table(header, rows))

    def figure(self, name: str, value: float) -> float:
        """Keep a number under `name` in results.json and return it as a plain float.

        A value that is not finite becomes ``null`` there, and the report says so.

        Raises
        ------
        InvalidInputError
            If the name is taken or is not letters, digits, ``_``, ``.`` and ``-`` from a letter on.
        """
        _check_name("Report.figure", name, name in self._figures)
        self._figures[name] = float(value)
        return self._figures[name]

    def figures(self, name: str, keys: Iterable[object], values: Iterable[float]) -> None:
        """Keep numbers under a name whose ``{}`` is replaced by the key of each."""
        for key, value in zip(keys, values, strict=True):
            self.figure(name.format(key), value)

    def plot(
        self,
        name: str,
        panels: Sequence[plotting.Panel],
        columns: int = 1,
        title: str = "",
        caption: str = "",
        **values: object,
    ) -> None:
        """Add a plot, written as name.svg (embedded) and name.png.

        Title and caption come from the report's Markdown file if it names the plot; places in all
        three are filled with the values.

        Raises
        ------
        InvalidInputError
            If the name is taken or cannot be a file name, or if `plotting.draw` refuses the panels.
        """
        words = self._prose.plots.get(name, (title, caption))
        name, title, caption = (x.format(**values) for x in (name, *words))
        _check_name("Report.plot", name, name in self._plots)
        self._plots[name] = plotting.draw(panels, columns, title)
        self._body.append(f"![{title or panels[0].title}]({name}.svg)")
        if caption:
            self._body.append(f"*{caption.strip()}*")

    def judge(self, key: str, verdict: Verdict, **values: object) -> None:
        """Add a claim of the report's Markdown file, its places filled with the values."""
        statement, source, found = (x.format(**values) for x in self._prose.claims[key])
        self.claim(statement, source, found, verdict)

    def claim(self, statement: str, paper: str, found: str, verdict: Verdict) -> None:
        """Add a row to the table that compares the source with what is found here.

        Parameters
        ----------
        statement : str
            What is compared.
        paper : str
            What the paper, or another source, says, with its place.
        found : str
            What this run shows.
        verdict : Agreement or bool
            Whether the two agree.
        """
        if not isinstance(verdict, Agreement):
            verdict = Agreement.AGREES if verdict else Agreement.DISAGREES
        self._claims.append((statement, paper, found, verdict.value))

    def require(self, key: str, found: float | None, **values: object) -> None:
        """Ask a figure to be at most the limit that the report's Markdown file names."""
        what, limit = self._prose.requirements[key]
        self.requirement(what.format(**values), float(limit), found)

    def requirement(self, what: str, limit: float, found: float | None) -> None:
        """Ask a figure to be at most a limit; it is None where a package is not installed."""
        self.requirements.append((what, limit, found))

    def verdict(self, quick: bool) -> bool:
        """Add how many required figures are reached, and their table; return whether all are."""
        measured = [(limit, found) for _, limit, found in self.requirements if found is not None]
        reached = self.figure("verdict.reached", sum(found <= limit for limit, found in measured))
        self.figure("verdict.required", len(self.requirements))
        missing = len(self.requirements) - len(measured)
        lost = f"; {missing} could not be measured for want of a package" if missing else ""
        settings = " (coarse settings: not results)" if quick else ""
        self.text(f"{reached:.0f} of {len(measured)} figures are reached{settings}{lost}.")
        header = ["figure", "limit", "found", "reached"]
        self.table(header, [_required(*each) for each in self.requirements])
        return reached == len(measured)

    def write(self) -> Path:
        """Write plots, results.json and report.md, and return the path of the last.

        All files are made in a temporary folder first and then moved into place one by one, so that
        no reader meets half a file and a failure leaves an older report as it was.
        """
        self._bar.close()
        seconds = self._clock()
        meta = environment() | {
            "command": self._command,
            "started": self._started.isoformat(timespec="seconds"),
            "seconds": round(seconds, 3),
        }
        self._directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._directory, prefix=".report-") as folder:
            staging = Path(folder)
            made: list[Path] = []
            for name, drawing in self._plots.items():
                made += plotting.save(drawing, staging / name)
            for name, content in (
                ("results.json", self._results(meta)),
                ("report.md", self._markdown(meta)),
            ):
                made.append(staging / name)
                made[-1].write_text(content, encoding="utf-8")
            for path in made:
                path.replace(self._directory / path.name)
        return self._directory / "report.md"

    def _results(self, meta: dict[str, object]) -> str:
        figures = {
            name: value if math.isfinite(value) else None for name, value in self._figures.items()
        }
        content = {"figures": figures, "meta": meta}
        return json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n"

    def _markdown(self, meta: dict[str, object]) -> str:
        source = self._prose.source
        blocks = [f"# {self._prose.title}", self._prose.question]
        if self._claims:
            header = ("claim", f"what the {source} says", "what we see", "agrees?")
            blocks += [f"## The {source} and this run", _table(header, self._claims)]
        blocks += self._body
        lost = {name: value for name, value in self._figures.items() if not math.isfinite(value)}
        if lost:
            blocks += [
                "## Figures that are not finite",
                "`results.json` holds `null` for these.",
                _table(("figure", "value"), list(lost.items())),
            ]
        return "\n\n".join([*blocks, _colophon(meta)]) + "\n"


def _required(what: str, limit: float, found: float | None) -> list[object]:
    """Return the row of a requirement."""
    if found is None:
        return [what, limit, "-", "sundials4py is not installed"]
    return [what, limit, found, "yes" if found <= limit else "NO"]


def _check_name(where: str, name: str, taken: bool) -> None:
    if taken or not _FLAT_NAME.fullmatch(name):
        raise InvalidInputError(
            where,
            "a name must be new and consist of letters, digits, '_', '.' and '-'",
            repr(name),
            "Choose another name, for example motion_2.",
        )


def environment() -> dict[str, object]:
    """Describe what the figures depend on besides the code: versions, processor and commit.

    Returns
    -------
    dict
        Versions of ``ancfdae``, ``python`` and each package (None if not installed),
        ``processor``, ``commit``
        (None outside a git checkout) and ``dirty`` (None likewise): whether the checkout differs
        from that commit.
    """
    found: dict[str, object] = {
        # Of the checkout that runs, which need not be installed.
        "ancfdae": ancfdae.__version__,
        "python": platform.python_version(),
        "processor": _processor(),
    }
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = None
    commit, changes = _git("rev-parse", "HEAD"), _git("status", "--porcelain")
    found["commit"] = commit
    found["dirty"] = None if commit is None or changes is None else bool(changes)
    return found


def _processor() -> str:
    """Name the processor; Linux gives its model only in /proc/cpuinfo."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def _git(*words: str) -> str | None:
    """Return what git says about the checkout of this file, or None if it has nothing to say."""
    try:
        answer = subprocess.run(
            ["git", *words], cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()


def _colophon(meta: dict[str, object]) -> str:
    trees = {None: "", True: " with uncommitted changes", False: " without uncommitted changes"}
    commit = f"{meta['commit'] or 'unknown'}{trees[cast('bool | None', meta['dirty'])]}"
    versions = ", ".join(f"{name} {meta[name]}" for name in ("python", *_PACKAGES))
    return (
        f"---\n\nMade by `{meta['command']}` on {meta['started']} in {meta['seconds']} s with "
        f"ancfdae {meta['ancfdae']} at commit {commit}; {versions}; {meta['processor']}. "
        "The figures are in `results.json`."
    )


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    if not rows or any(len(row) != len(header) for row in rows):
        raise InvalidInputError(
            "Report.table",
            f"there must be rows of {len(header)} cells each",
            [len(row) for row in rows],
            "Give every row one cell for each column.",
        )
    numeric = [all(_is_number(row[column]) for row in rows) for column in range(len(header))]
    rule = ["---:" if right else "---" for right in numeric]
    cells = [[_cell(value) for value in row] for row in (header, *rows)]
    lines = [cells[0], rule, *cells[1:]]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _is_number(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def _cell(value: object) -> str:
    if isinstance(value, numbers.Real) and not isinstance(value, numbers.Integral):
        return f"{float(value):.6g}"
    return " ".join(str(value).replace("|", "\\|").split())
