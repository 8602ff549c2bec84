"""Rows of a sweep, and their file: one JSON object a line, appended as they arrive.

The file is read to resume a sweep. Its first line has the digests of the model and of the function
that the rows belong to, every other line is a row. A line that was cut off by a crash is dropped.

Digests of models and functions are the same in every process. A function is described by its code,
its defaults, its closure and the globals that it reads; an object by its class and its attributes,
a user's class by its code. Imported packages are described by name, so that changes within them are
not detected; neither are changes of comments and line numbers.
"""

import dataclasses
import functools
import hashlib
import json
import os
import pickle
import sys
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, final

import numpy as np

from ancfdae.equations.files import saving
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText, listed
from ancfdae.sensitivity.method import Gradient

_PLAIN = (str, int, float, complex, bytes, np.generic, type(None), type(...))

# Packages whose functions and classes are described by name only.
_LIBRARIES = frozenset({"ancfdae", "numpy", "scipy"}) | sys.stdlib_module_names - {"__main__"}


def digest(where: str, value: object) -> str:
    """Return the SHA-256 digest of a value; InvalidInputError if it cannot be described.

    A lock, for example, cannot.
    """
    told = hashlib.sha256()
    for part in _Description(where).of(value):
        # With lengths, so that ("ab", "c") differs from ("a", "bc").
        told.update(len(part).to_bytes(8, "big") + part)
    return told.hexdigest()


@final
class _Description:
    """Description of values as bytes; a repeated value is named by its number."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._numbers: dict[int, int] = {}
        self._alive: list[object] = []  # so that no id is reused for another object

    def of(self, value: Any) -> Iterator[bytes]:
        """Yield the description of a value as bytes, piece by piece."""
        if isinstance(value, _PLAIN):
            yield repr(value).encode()
        elif id(value) in self._numbers:
            yield b"again %d" % self._numbers[id(value)]
        else:
            self._numbers[id(value)] = len(self._numbers)
            self._alive.append(value)
            yield type(value).__qualname__.encode()
            yield from self._held(value)

    def _held(self, value: Any) -> Iterator[bytes]:
        if isinstance(value, np.ndarray):
            yield from self._each(value.shape, str(value.dtype))
            numbers = value.dtype.kind != "O"
            yield from (value.tobytes(),) if numbers else self._each(*value.ravel().tolist())
        elif isinstance(value, Mapping):
            yield from self._each(*(part for item in value.items() for part in item))
        elif isinstance(value, list | tuple):
            yield from self._each(*value)
        elif isinstance(value, Set):
            yield from sorted(digest(self._where, each).encode() for each in value)
        elif isinstance(value, functools.partial):
            yield from self._each(value.func, value.args, value.keywords)
        elif isinstance(value, functools.cached_property):
            yield from self._each(value.func)
        elif isinstance(value, property):
            yield from self._each(value.fget, value.fset)
        elif isinstance(value, staticmethod | classmethod):
            yield from self._each(value.__func__)
        elif isinstance(value, MethodType):
            yield from self._each(value.__func__, value.__self__)
        elif isinstance(value, FunctionType):
            yield from self._function(value)
        elif isinstance(value, CodeType):
            names = value.co_names, value.co_varnames, value.co_freevars
            yield from self._each(value.co_code, value.co_consts, *names)
        elif isinstance(value, type):
            yield from self._class(value)
        elif isinstance(value, ModuleType):
            yield value.__name__.encode()
        elif isinstance(value, BuiltinFunctionType | np.ufunc):
            yield repr(getattr(value, "__qualname__", value)).encode()
        else:
            yield from self._object(value)

    def _each(self, *values: object) -> Iterator[bytes]:
        yield b"%d" % len(values)
        for value in values:
            yield from self.of(value)

    def _function(self, value: FunctionType) -> Iterator[bytes]:
        yield f"{value.__module__}.{value.__qualname__}".encode()
        if _package(value) in _LIBRARIES:
            return
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        yield from self._each(value.__code__, value.__defaults__, value.__kwdefaults__, *cells)
        for name in sorted(_names(value.__code__)):
            if name in value.__globals__:
                yield from self._global(name, value.__globals__[name], _package(value))

    def _global(self, name: str, value: object, package: str) -> Iterator[bytes]:
        """Yield the description of a global; functions and classes of other packages by name."""
        yield name.encode()
        if isinstance(value, FunctionType | type) and _package(value) != package:
            yield f"{value.__module__}.{value.__qualname__}".encode()
        else:
            yield from self.of(value)

    def _class(self, kind: type) -> Iterator[bytes]:
        yield f"{kind.__module__}.{kind.__qualname__}".encode()
        if _package(kind) in _LIBRARIES:
            return
        yield from self._each(*kind.__bases__)
        for name, held in vars(kind).items():
            # Attributes that Python adds to a class differ between processes.
            if not name.startswith("_") or isinstance(held, FunctionType):
                yield from self._global(name, held, _package(kind))

    def _object(self, value: Any) -> Iterator[bytes]:
        """Yield class and attributes of an object, without cached properties."""
        kind = type(value)
        try:
            held = vars(value)
        except TypeError:
            try:
                yield pickle.dumps(value)
            except Exception as error:
                raise InvalidInputError(
                    f"{self._where}, file",
                    "needs arguments that pickle, by which its rows are found again",
                    f"an object of type {kind.__name__} ({error})",
                    "Omit `file`, or make this object inside the function.",
                ) from error
            return
        yield from self.of(kind)
        computed = {
            name
            for each in kind.__mro__
            for name, member in vars(each).items()
            if isinstance(member, functools.cached_property)
        }
        for name in sorted(held.keys() - computed):
            yield name.encode()
            yield from self.of(held[name])


def _package(value: FunctionType | type) -> str:
    return (value.__module__ or "").partition(".")[0]


def _names(code: CodeType) -> set[str]:
    inner = (_names(each) for each in code.co_consts if isinstance(each, CodeType))
    return set(code.co_names).union(*inner)


# -- rows and their file -----------------------------------------------------------------------


@final
@dataclass(frozen=True)
class SweepRow:
    """One design of a sweep.

    Attributes
    ----------
    values : mapping of str to float
        Values by name of the design variable or target.
    result : object
        Result of the function; None if it failed.
    error : str
        Reason why there is no result; empty if there is one.
    """

    values: Mapping[str, float]
    result: Any = None
    error: str = ""

    @property
    def finished(self) -> bool:
        """Whether the row has a result rather than an error."""
        return not self.error


@final
@dataclass(frozen=True, repr=False)
class Sweep(PrintedTable):
    """Results at many designs, in the order of the designs.

    Attributes
    ----------
    rows : tuple of SweepRow
        Rows; the error of a row says if Ctrl-C came before it was computed.
    """

    rows: tuple[SweepRow, ...]

    @property
    def results(self) -> list[Any]:
        """Results of all rows; None for a row without a result."""
        return [row.result for row in self.rows]

    @property
    def failed(self) -> dict[int, str]:
        """Errors of the rows without a result, by number of the row."""
        return {k: row.error for k, row in enumerate(self.rows) if not row.finished}

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each design: its values, the result, the error.

        The columns for gradients are ``objective`` and ``d/d rod.height`` ...; for other results
        ``result``.
        """
        rows = [dict(row.values) | _cells(row.result) | {"error": row.error} for row in self.rows]
        return pandas().DataFrame(rows)

    def _printed(self) -> TableText:
        cells = [
            (
                str(k),
                listed(f"{name} = {x}" for name, x in row.values.items()),
                row.error or listed(str(row.result).split("\n")),
            )
            for k, row in enumerate(self.rows)
        ]
        head = f"Sweep: {len(self.rows)} designs, {len(self.failed)} without result"
        return head, [("row", "design", "result"), *cells], ""


def _cells(result: Any) -> dict[str, Any]:
    if not isinstance(result, Gradient):
        return {} if result is None else {"result": result}
    slopes = zip(result.names, result.gradient.tolist(), strict=True)
    return {"objective": result.value} | {f"d/d {name}": slope for name, slope in slopes}


_ARRAY = "array"
# Number of characters of a line that an error message quotes.
_SHOWN = 60
_OTHER = "Give another file, or remove this one to compute all rows anew."


@final
class SweepFile:
    """Rows of one sweep on disk; InvalidInputError if the file holds something else.

    The rows belong to `model` and `what`, at designs with these `values` by name.
    """

    def __init__(
        self, path: Path, model: object, what: object, values: Sequence[Mapping[str, float]]
    ) -> None:
        self._path, self._values = path, values
        self._head = {"sweep of": {"model": digest("model", model), "what": digest("what", what)}}
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
            os.truncate(path, len(whole.encode()))
        if not whole:
            self._write(self._head)

    def rows(self) -> dict[int, SweepRow]:
        """Return the rows in the file by number; InvalidInputError for a line that is no row."""
        rows = {}
        for number, line in enumerate(self._lines[1:], start=2):
            try:
                k, values, result, error = _row(line)
            except (ValueError, TypeError, KeyError, RecursionError) as cause:
                got = f"{line[:_SHOWN]!r} in line {number}"
                repair = "Remove this line to compute its row anew, or give another file."
                raise InvalidInputError(self._where, "must hold rows", got, repair) from cause
            if k >= len(self._values) or json.dumps(values) != json.dumps(
                self._values[k], default=_encoded
            ):
                raise self._refused("must hold rows of these designs", f"row {k} at {values}")
            rows[k] = SweepRow(self._values[k], result, error)
        return rows

    def append(self, k: int, row: SweepRow) -> SweepRow:
        """Write a row to the file; return it with the result as it will be read back."""
        part = {"result": row.result} if row.finished else {"error": row.error}
        line = self._write({"row": k, "values": row.values, **part})
        result = json.loads(line, object_hook=_decoded).get("result")
        return dataclasses.replace(row, result=result)

    def _write(self, record: object) -> str:
        try:
            line = json.dumps(record, default=_encoded)
        except (TypeError, ValueError) as error:
            raise InvalidInputError(
                "what, file",
                "results must be numbers, strings, arrays, or lists or mappings of them",
                str(error),
                "Return one of these types, or omit `file`.",
            ) from error
        with saving("file", self._path):
            size = self._path.stat().st_size if self._path.exists() else 0
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(line + "\n")
            except OSError:
                with suppress(OSError):
                    os.truncate(self._path, size)  # no part of a line stays
                raise
        return line

    def _require_same(self, line: str) -> None:
        try:
            known = json.loads(line)["sweep of"]
            marks = [known[part] for part in self._head["sweep of"]]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise self._refused("must be the file of a sweep", "something else") from None
        for (part, mark), known_mark in zip(self._head["sweep of"].items(), marks, strict=True):
            if known_mark != mark:
                raise self._refused(f"must be of the same {part}", f"rows of another {part}")

    def _refused(self, rule: str, got: str) -> InvalidInputError:
        return InvalidInputError(self._where, rule, got, _OTHER)

    @property
    def _where(self) -> str:
        return f"file {self._path}"


def _row(line: str) -> tuple[int, Any, Any, str]:
    """Return number, values, result and error of a sweep's line; raises if it is no row."""
    record = json.loads(line, object_hook=_decoded)
    k, error = record["row"], record.get("error", "")
    if not isinstance(k, int) or k < 0 or not isinstance(error, str):
        raise ValueError("no row")
    if ("result" in record) == bool(error):
        raise ValueError("no result, or one of a row that failed")
    return k, record["values"], record.get("result"), error


def _encoded(value: object) -> object:
    """Return arrays and NumPy numbers in a form that JSON can hold."""
    if isinstance(value, np.ndarray):
        return {_ARRAY: value.tolist()}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is none of them")


def _decoded(record: dict[str, Any]) -> object:
    return np.array(record[_ARRAY]) if record.keys() == {_ARRAY} else record
