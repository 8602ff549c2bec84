"""The words of a report: a Markdown file beside its code, with named places for figures.

The file begins with the title and the question. `<!-- key -->` on a line of its own opens a block,
which `Report.say` adds under that key. The rows of three tables are data. A claim has a key, the
statement, what the source says and what the run shows. A requirement has a key, a figure and its
limit. A plot has its name, title and caption. Places have the form that `str.format` fills:
``{error:.1e}``.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self, final

_BLOCK = re.compile(r"^<!-- (\S+) -->\n", re.MULTILINE)
_CELL = re.compile(r"(?<!\\)\|")
_SOURCE = re.compile(r"\| what the ([\w ]+) says \|")


@final
@dataclass(frozen=True)
class Prose:
    """Title, question and source of a report, its blocks, claims and captions by key."""

    title: str
    question: str
    source: str = "paper"
    blocks: dict[str, str] = field(default_factory=dict)
    claims: dict[str, list[str]] = field(default_factory=dict)
    requirements: dict[str, list[str]] = field(default_factory=dict)
    plots: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the file of a report."""
        head, *parts = _BLOCK.split(path.read_text(encoding="utf-8"))
        title, question = head.removeprefix("# ").strip().split("\n\n", 1)
        blocks = dict(zip(parts[::2], map(str.strip, parts[1::2]), strict=True))
        claims, *others = (blocks.pop(x, "") for x in ("claims", "requirements", "plots"))
        source = _SOURCE.search(claims)
        words = " ".join(question.split())
        tables = (_rows(table) for table in (claims, *others))
        return cls(title, words, source[1] if source else "paper", blocks, *tables)


def _rows(table: str) -> dict[str, list[str]]:
    """Return the cells of each row by the first, without the two lines of the header."""
    rows = [[cell.strip() for cell in _CELL.split(line)[1:-1]] for line in table.splitlines()[2:]]
    return {key: [cell.replace(r"\|", "|") for cell in cells] for key, *cells in rows}
