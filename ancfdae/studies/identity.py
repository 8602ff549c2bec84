"""Digests of models and functions, which are the same in every process.

A function is its code, its defaults, what it closes over and the globals that it reads; an object
is its class and its attributes, a class of a user's its code. Packages that are imported are known
by name, so that what changes within them is not seen; neither are comments and places in a file.
"""

import functools
import hashlib
import pickle
import sys
from collections.abc import Iterator, Mapping, Set
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError

_PLAIN = (str, int, float, complex, bytes, np.generic, type(None), type(...))

# What is known by name, wherever it is met.
_LIBRARIES = frozenset({"ancfdae", "numpy", "scipy"}) | sys.stdlib_module_names - {"__main__"}


def digest(where: str, value: object) -> str:
    """Return the SHA-256 digest of a value; refuse unreadable contents, as of a lock."""
    told = hashlib.sha256()
    for part in _Description(where).of(value):
        # Lengths, so that ("ab", "c") is not ("a", "bc").
        told.update(len(part).to_bytes(8, "big") + part)
    return told.hexdigest()


@final
class _Description:
    """Describes values one after the other; what comes again is known by its number."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._numbers: dict[int, int] = {}
        self._alive: list[object] = []  # or a number would be that of another object

    def of(self, value: Any) -> Iterator[bytes]:
        """Yield what a value is, piece by piece."""
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
        """Yield a global; a function or class of another package by its name."""
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
            # What Python keeps in a class beside what the user wrote differs between processes.
            if not name.startswith("_") or isinstance(held, FunctionType):
                yield from self._global(name, held, _package(kind))

    def _object(self, value: Any) -> Iterator[bytes]:
        """Yield class and attributes, without those that are computed when asked for."""
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
