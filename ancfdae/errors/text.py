"""Plain text and HTML for readers: shortened lists, tables with aligned columns."""

import abc
import html
from collections.abc import Iterable, Sequence
from typing import TypeAlias, final

# Most entries of a list that a message shows.
_SHOWN = 12

#: Text before a table, its rows with the titles first, and text after it.
TableText: TypeAlias = tuple[str, Sequence[Sequence[str]], str]


class PrintedTable(abc.ABC):
    """A result that prints as a table between two texts, and as an HTML table in a notebook."""

    @abc.abstractmethod
    def _printed(self) -> TableText:
        """Return the text before the table, its rows with the titles first, and the text after."""

    @final
    def __repr__(self) -> str:
        """Return the result as a table in plain text."""
        return plain(*self._printed())

    @final
    def _repr_html_(self) -> str:
        """Return the result as a table in HTML, for notebooks."""
        return page(*self._printed())


def plain(head: str, rows: Sequence[Sequence[str]], tail: str = "") -> str:
    """Return a table as lines of text between the texts `head` and `tail`; see `columns`."""
    return "\n".join(text for text in (head, columns(rows), tail) if text)


def listed(words: Iterable[object]) -> str:
    """Return the first twelve words, separated by commas, and how many are left out."""
    texts = [str(word) for word in words]
    more = f" and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    return (", ".join(texts[:_SHOWN]) + more) or "none"


def columns(rows: Sequence[Sequence[str]], shorten: bool = True) -> str:
    """Return rows of cells, all of one length, as text with aligned columns.

    If shortened, the titles and the first twelve rows are shown, with the number of omitted rows,
    which is never one.
    """
    shown = rows[: _SHOWN + 1] if shorten and len(rows) > _SHOWN + 2 else rows
    widths = [max(len(cell) for cell in column) for column in zip(*shown, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in shown
    ]
    if len(shown) < len(rows):
        lines.append(f"and {len(rows) - len(shown)} more")
    return "\n".join(lines)


def page(head: str, rows: Sequence[Sequence[str]], tail: str = "") -> str:
    """Return a table in HTML, for notebooks, between the texts `head` and `tail`.

    The first row has the titles; rows are omitted as in `columns`. If there are no rows, only the
    texts are returned.
    """
    shown = rows[: _SHOWN + 1] if len(rows) > _SHOWN + 2 else rows
    cells = "".join(
        f"<tr>{''.join(f'<{kind}>{html.escape(cell)}</{kind}>' for cell in row)}</tr>"
        for kind, row in zip(["th"] + ["td"] * len(shown), shown, strict=False)
    )
    more = f"and {len(rows) - len(shown)} more" if len(shown) < len(rows) else ""
    before, after = (f"<p>{html.escape(text)}</p>" if text else "" for text in (head, tail))
    return f"{before}{f'<table>{cells}</table>' if rows else ''}{more}{after}"
