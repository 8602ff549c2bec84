"""Plain text for readers: shortened lists, aligned columns."""

import html
from collections.abc import Iterable, Sequence

# Most entries of a list that a message shows.
_SHOWN = 12


def listed(words: Iterable[object]) -> str:
    """Return the first twelve words, separated by commas, and how many are left out."""
    texts = [str(word) for word in words]
    more = f" and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    return (", ".join(texts[:_SHOWN]) + more) or "none"


def columns(rows: Sequence[Sequence[str]], shorten: bool = True) -> str:
    """Return rows of cells, all of one length, as lines, cells of a column below each other.

    Shortened, the first twelve are shown, with the number of those left out.
    """
    shown = rows[:_SHOWN] if shorten else rows
    widths = [max(len(cell) for cell in column) for column in zip(*shown, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in shown
    ]
    if len(shown) < len(rows):
        lines.append(f"and {len(rows) - len(shown)} more")
    return "\n".join(lines)


def page(head: str, rows: Sequence[Sequence[str]], tail: str = "") -> str:
    """Return a table in HTML, as notebooks show it, between two texts.

    The first row has the titles; of the others the first twelve are shown.
    """
    left = len(rows) - _SHOWN - 1
    cells = "".join(
        f"<tr>{''.join(f'<{kind}>{html.escape(cell)}</{kind}>' for cell in row)}</tr>"
        for kind, row in zip(["th"] + ["td"] * _SHOWN, rows, strict=False)
    )
    more = f"and {left} more" if left > 0 else ""
    before, after = (f"<p>{html.escape(text)}</p>" if text else "" for text in (head, tail))
    return f"{before}<table>{cells}</table>{more}{after}"
