"""Rows of a sweep: designs, results and errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from ancfdae.equations.tables import pandas
from ancfdae.errors.text import columns, listed, page
from ancfdae.sensitivity import Gradient


@final
@dataclass(frozen=True)
class SweepRow:
    """One design of a sweep.

    Attributes
    ----------
    values : mapping of str to float
        Values by name of the design variable or target.
    result : object
        What was computed; None if it failed.
    error : str
        Why there is no result; empty if there is one.
    """

    values: Mapping[str, float]
    result: Any = None
    error: str = ""

    @property
    def finished(self) -> bool:
        """Whether there is a result."""
        return not self.error


@final
@dataclass(frozen=True)
class Sweep:
    """What was computed at many designs, in the order of the designs.

    Attributes
    ----------
    rows : tuple of SweepRow
        Those that Ctrl-C left out are marked.
    """

    rows: tuple[SweepRow, ...]

    @property
    def results(self) -> list[Any]:
        """The results of all rows, None where there is none."""
        return [row.result for row in self.rows]

    @property
    def failed(self) -> dict[int, str]:
        """The errors, by number of the row."""
        return {k: row.error for k, row in enumerate(self.rows) if not row.finished}

    def to_dataframe(self) -> Any:
        """Return a table of pandas with a row for each design: its values, the result, the error.

        Of a gradient the columns are ``objective`` and ``d/d rod.height`` ...; of anything else
        ``result``.
        """
        rows = [dict(row.values) | _cells(row.result) | {"error": row.error} for row in self.rows]
        return pandas().DataFrame(rows)

    def __repr__(self) -> str:
        return f"{self._head}\n{columns(self._cells())}"

    def _repr_html_(self) -> str:
        return page(self._head, self._cells())

    @property
    def _head(self) -> str:
        return f"Sweep: {len(self.rows)} designs, {len(self.failed)} without result"

    def _cells(self) -> list[tuple[str, str, str]]:
        cells = [
            (
                str(k),
                listed(f"{name} = {x}" for name, x in row.values.items()),
                row.error or listed(str(row.result).split("\n")),
            )
            for k, row in enumerate(self.rows)
        ]
        return [("row", "design", "result"), *cells]


def _cells(result: Any) -> dict[str, Any]:
    if not isinstance(result, Gradient):
        return {} if result is None else {"result": result}
    slopes = zip(result.names, result.gradient.tolist(), strict=True)
    return {"objective": result.value} | {f"d/d {name}": slope for name, slope in slopes}
