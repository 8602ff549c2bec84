"""Checks of arguments, which raise InvalidInputError with a message that names the rule."""

import importlib
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from ancfdae.errors.kinds import _LONGEST, InvalidInputError, MissingPackageError, UnknownNameError


def require_package(where: str, module: str, extra: str) -> Any:
    """Return an imported module of an optional package; MissingPackageError names its extra."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise MissingPackageError(
            f'{where}: needs the package {package}. Install it with pip install "ancfdae[{extra}]".'
        ) from error


class _Named(Protocol):
    @property
    def name(self) -> str:
        """The name by which the function `named` finds an object in a sequence."""


_Thing = TypeVar("_Thing", bound=_Named)


def named(where: str, name: str, things: Sequence[_Thing]) -> _Thing:
    """Return the object whose name is `name`; raise UnknownNameError if none has that name."""
    require_text(where, name)
    for thing in things:
        if thing.name == name:
            return thing
    raise UnknownNameError(where, name, (thing.name for thing in things))


def require_unique(where: str, rule: str, names: Sequence[str], repair: str) -> None:
    """Raise InvalidInputError if a name occurs twice in `names`."""
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise InvalidInputError(where, rule, twice, repair)


def require_kind(where: str, value: object, kinds: tuple[type, ...], repair: str) -> None:
    """Raise InvalidInputError unless `value` is an object of one of the given classes."""
    if not isinstance(value, kinds):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InvalidInputError(where, f"must be of type {names}", _shown(value), repair)


def _shown(value: object) -> str:
    """Return the `repr` of a value, cut after _LONGEST characters."""
    try:
        text = repr(value)
    except ValueError:  # an integer of more than 4,300 digits
        text = f"a number of type {type(value).__name__} that is too long to write"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def require_text(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is a string, where a name is expected."""
    require_kind(where, value, (str,), "Give the name, as in rod.name.")


def require_path(where: str, value: object) -> Path:
    """Return `value` as a path; raise InvalidInputError for folders and other types of value."""
    require_kind(where, value, (str, os.PathLike), "Give the name of a file.")
    path = Path(value)  # type: ignore[arg-type]  # as was just seen
    if path.is_dir():
        raise InvalidInputError(
            where, "must be a file", f"the folder {value!r}", "Name a file in it."
        )
    return path


def require_folder(where: str, path: Path) -> Path:
    """Return a path; raise InvalidInputError if there is no folder to write it to."""
    if not path.parent.is_dir():
        rule, repair = "must lie in a folder that exists", "Create the folder, or correct the path."
        raise InvalidInputError(where, rule, repr(os.fspath(path)), repair)
    return path


def require_index(where: str, value: object, count: int, repair: str) -> None:
    """Raise InvalidInputError unless `value` is an integer from 0 to `count` - 1."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not 0 <= value < count:  # type: ignore[operator]
        raise InvalidInputError(where, f"must lie in 0 to {count - 1}", _shown(value), repair)


def require_flag(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is True or False."""
    if type(value) is not bool and not isinstance(value, np.bool_):
        raise InvalidInputError(where, "must be True or False", _shown(value))


def require_together(where: str, given: Mapping[str, object]) -> None:
    """Raise InvalidInputError if some of the values, by name, are None and others are not."""
    missing = [name for name, value in given.items() if value is None]
    if missing and len(missing) < len(given):
        rule = f"{' and '.join(given)} belong together"
        raise InvalidInputError(where, rule, f"no {missing[0]}", "Give both, or neither.")


def require_function(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` can be called."""
    if not callable(value):
        raise InvalidInputError(where, "must be a function", _shown(value), "Pass f, not f(x).")


def require_name(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` can name a part in targets like 'rod.height[2]'."""
    if not isinstance(value, str) or not value or "." in value or "[" in value:
        raise InvalidInputError(
            where,
            "must be a non-empty string without '.' and '['",
            _shown(value),
            "Names appear in design targets such as 'rod.height[2]'.",
        )


def require_sequence(
    where: str, value: object, rule: str = "must be a sequence", repair: str = "Put it in a list."
) -> tuple[Any, ...]:
    """Return the entries of a sequence; raise InvalidInputError if `value` is not a sequence."""
    try:
        # An iterator has no length: it could be read only once.
        return tuple(value) if len(value) else ()  # type: ignore[arg-type]
    except TypeError:
        raise InvalidInputError(where, rule, _shown(value), repair) from None


def require_each(
    where: str, values: object, kinds: tuple[type, ...], repair: str
) -> tuple[Any, ...]:
    """Return the entries of a sequence; raise InvalidInputError for an entry of another class."""
    entries = require_sequence(where, values)
    for entry in entries:
        require_kind(where, entry, kinds, repair)
    return entries


def require_finite(where: str, value: object, repair: str = "") -> None:
    """Raise InvalidInputError unless `value` is a finite real number.

    Booleans and integers too large for a float are rejected.
    """
    if type(value) is float and math.isfinite(value):
        return
    try:
        is_number = isinstance(value, int | float | np.integer | np.floating)
        good = is_number and not isinstance(value, bool) and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:
        good = False
    if not good:
        raise InvalidInputError(where, "must be a finite real number", _shown(value), repair)


# Largest integer up to which all integers are exact as floats.
_LARGEST = 2**53


def require_count(where: str, value: object, repair: str, most: int = _LARGEST) -> None:
    """Raise InvalidInputError unless `value` is a whole number from 1 to `most`."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < 1:  # type: ignore[operator]
        raise InvalidInputError(where, "must be a positive integer", _shown(value), repair)
    if value > most:  # type: ignore[operator]
        raise InvalidInputError(where, f"must be at most {most}", _shown(value), repair)


def require_positive(where: str, value: float) -> None:
    """Raise InvalidInputError for a value that is not a finite positive number."""
    require_finite(where, value)
    if value <= 0:
        raise InvalidInputError(where, "must be positive", _shown(value))


def require_not_negative(where: str, value: object, repair: str = "") -> None:
    """Raise InvalidInputError unless `value` is a finite number of at least zero."""
    require_finite(where, value)
    if value < 0:  # type: ignore[operator]
        raise InvalidInputError(where, "must not be negative", value, repair)


def require_vector(where: str, value: object, sizes: tuple[int, ...] = (2, 3)) -> None:
    """Raise InvalidInputError unless `value` has finite components, one of `sizes` in number."""
    allowed = " or ".join(str(size) for size in sizes)
    rule = f"must have {allowed} components"
    components = require_sequence(where, value, rule, "")
    if len(components) not in sizes:
        raise InvalidInputError(where, rule, components)
    for component in components:
        require_finite(where, component)


def require_direction(where: str, value: object, sizes: tuple[int, ...] = (2, 3)) -> None:
    """Raise InvalidInputError unless `value` is a vector, as in `require_vector`, and not zero."""
    require_vector(where, value, sizes)
    if not any(value):  # type: ignore[arg-type]  # a sequence, as was just seen
        raise InvalidInputError(where, "must be a direction, a vector that is not zero", value)


def require_axial(where: str, value: object, dimension: int | None = None) -> None:
    """Raise InvalidInputError unless `value` is a number (plane) or has three components (space).

    If the dimension is given, only the form for it is accepted.
    """
    is_number = np.ndim(value) == 0  # type: ignore[arg-type]
    if dimension is not None and is_number != (dimension == 2):
        rule = "must be a number in the plane and have 3 components in space"
        raise InvalidInputError(
            where, rule, _shown(value), f"Here space has {dimension} dimensions."
        )
    if is_number:
        require_finite(where, value)
    else:
        require_vector(where, value, (3,))


def require_array(
    where: str, value: object, shape: tuple[int, ...] | None = None
) -> np.ndarray[tuple[Any, ...], np.dtype[np.float64]]:
    """Return a copy of `value` as an array of floats.

    Raises InvalidInputError if an entry is not a finite number, rows differ in length, or the shape
    is not `shape`.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        got = "rows of different lengths"
    else:
        if array.dtype.kind not in "iuf":
            got = f"entries of type {array.dtype}"
        elif not np.all(np.isfinite(array)):
            got = "NaN or infinity"
        elif shape is not None and array.shape != shape:
            got = f"shape {array.shape}"
        else:
            return array.astype(float)
    rule = "must be an array of finite numbers" + ("" if shape is None else f" of shape {shape}")
    raise InvalidInputError(where, rule, got, "Give nested lists of numbers, or an array.")
