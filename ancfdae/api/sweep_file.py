"""The file of a sweep: one JSON object a line, appended as rows arrive, read to resume.

The first line tells of which model and function the rows are, every other line is a row. A line
that was cut off by a crash is dropped.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, final

import numpy as np

from ancfdae.api.sweep_result import SweepRow
from ancfdae.errors import InvalidInput
from ancfdae.protocol import MechanicalSystem

_ARRAY = "array"
_OTHER = "Give another file, or remove this one to compute all rows anew."


@final
class SweepFile:
    """Rows of one sweep on disk; InvalidInput if the file holds something else.

    They belong to `model` and `what`, at designs with these values by name.
    """

    def __init__(
        self, path: Path, model: object, what: object, values: Sequence[Mapping[str, float]]
    ) -> None:
        self._path, self._values = path, values
        self._head = {"sweep of": {"model": _mark(model), "what": _mark(what)}}
        try:
            text = path.read_text(encoding="utf-8") if path.exists() else ""
        except UnicodeDecodeError:
            raise self._refused("must be the file of a sweep", "something else") from None
        whole = text[: text.rfind("\n") + 1]
        self._lines = whole.splitlines()
        if self._lines:
            self._require_same(self._lines[0])
        elif text:
            raise self._refused("must be the file of a sweep", "something else")
        if whole != text:
            path.write_text(whole, encoding="utf-8")
        if not whole:
            self._write(self._head)

    def rows(self) -> dict[int, SweepRow]:
        """Return the rows that are there, by number."""
        found = {}
        for line in self._lines[1:]:
            record = json.loads(line, object_hook=_decoded)
            k, values = record["row"], record["values"]
            if k >= len(self._values) or json.dumps(values) != _text(self._values[k]):
                raise self._refused("must hold rows of these designs", f"row {k} at {values}")
            found[k] = SweepRow(self._values[k], record.get("result"), record.get("error", ""))
        return found

    def append(self, k: int, row: SweepRow) -> SweepRow:
        """Write a row; return it with its result as it will be read."""
        part = {"result": row.result} if row.finished else {"error": row.error}
        line = self._write({"row": k, "values": row.values, **part})
        result = json.loads(line, object_hook=_decoded).get("result")
        return dataclasses.replace(row, result=result)

    def _write(self, record: object) -> str:
        try:
            line = _text(record)
        except (TypeError, ValueError) as error:
            raise InvalidInput(
                "what, file",
                "must return numbers, texts, arrays, and lists or mappings of these",
                str(error),
                "Return such, or leave the file out.",
            ) from error
        with self._path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        return line

    def _require_same(self, line: str) -> None:
        try:
            known = json.loads(line)["sweep of"]
        except (json.JSONDecodeError, TypeError, KeyError):
            raise self._refused("must be the file of a sweep", "something else") from None
        for part, mark in self._head["sweep of"].items():
            if known.get(part) != mark:
                raise self._refused(f"must be of the same {part}", f"rows of another {part}")

    def _refused(self, rule: str, got: str) -> InvalidInput:
        return InvalidInput(f"file {self._path}", rule, got, _OTHER)


def _text(record: object) -> str:
    return json.dumps(record, default=_encoded)


def _encoded(value: object) -> object:
    """Return arrays and NumPy's numbers as JSON has them."""
    if isinstance(value, np.ndarray):
        return {_ARRAY: value.tolist()}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is none of them")


def _decoded(record: dict[str, Any]) -> object:
    return np.array(record[_ARRAY]) if record.keys() == {_ARRAY} else record


def _mark(value: object) -> str:
    return hashlib.sha256(_described(value).encode()).hexdigest()


def _described(value: object) -> str:
    """Describe a value by what it holds, the same in every process; functions by their name."""
    kind = type(value).__qualname__
    if isinstance(value, partial):
        return _described((value.func, value.args, value.keywords))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return kind + _described(
            {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        )
    if isinstance(value, MechanicalSystem):
        return kind + _described((value.design_names, value.b, value.n_q, value.n_lam))
    if isinstance(value, Mapping):
        return _described(list(value.items()))
    if isinstance(value, np.ndarray):
        return _described(value.tolist())
    if isinstance(value, list | tuple):
        return "[" + ",".join(map(_described, value)) + "]"
    if value is None or isinstance(value, str | int | float | complex | np.generic):
        return repr(value)
    return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', kind)}"
