"""Errors of the project's own kind, and outcomes of a run in words.

An error is raised before anything is integrated and reads
``where: rule; got value. Repair.`` Trouble *during* a run is not an
exception but an `Outcome`, so that what was computed stays usable.
"""

from __future__ import annotations

import importlib
import math
import os
import pickle
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Protocol, TypeVar, final

import numpy as np
import numpy.typing as npt

# Characters of a wrong argument that a message repeats.
_LONGEST = 100


class AncfdaeError(Exception):
    """Base class of every error that this package raises on purpose.

    All of them pickle, so that they arrive from worker processes.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Restore message and attributes without `__init__`, whose arguments differ."""
        kept = {name: _sendable(value) for name, value in self.__dict__.items()}
        return _restored, (type(self), self.args), kept


def _restored(kind: type[AncfdaeError], args: tuple[Any, ...]) -> AncfdaeError:
    error: AncfdaeError = kind.__new__(kind, *args)
    return error


def _sendable(value: object) -> object:
    """Return the value, or its text if it does not pickle, such as a function that was refused."""
    try:
        pickle.dumps(value)
    except (pickle.PicklingError, AttributeError, TypeError):
        return repr(value)
    return value


@final
class MissingPackage(AncfdaeError, ImportError):
    """An optional package that is not installed; the message says how to install it."""


class InvalidInput(AncfdaeError, ValueError):
    """Input that breaks a rule.

    Parameters
    ----------
    where : str
        The argument or object at fault, as the user wrote it.
    rule : str
        What is required.
    got : object
        The value that came instead.
    repair : str
        What to change.
    """

    def __init__(self, where: str, rule: str, got: object, repair: str) -> None:
        super().__init__(f"{where}: {rule}; got {got}. {repair}")
        self.where, self.rule, self.got, self.repair = where, rule, got, repair


@final
class UnknownName(InvalidInput):
    """A name that nothing in the scene has; the message lists the known ones."""

    def __init__(self, where: str, name: object, known: Iterable[str]) -> None:
        listed = ", ".join(sorted(known)) or "(none)"
        super().__init__(where, "must be a known name", repr(name), f"Known names: {listed}.")


@final
class RedundantConstraints(InvalidInput):
    """Constraints that are linearly dependent at the start; the message names the joints."""


@final
class InconsistentStart(InvalidInput):
    """A start that violates a constraint; the message names the joint and the size."""


@final
class SingularMatrix(AncfdaeError):
    """A matrix that cannot be factorised; caught by integrators and turned into an outcome."""


@final
class StabilityWarning(UserWarning):
    """A setting that is admissible but known to lose accuracy or stability."""


@final
class ManySteps(UserWarning):
    """A run that will take many more steps than a method that suits the scene; it goes on."""


@final
class FailedDesign(UserWarning):
    """A design that an optimiser tried has no values; the message says why."""


class Verdict(Enum):
    """How a run ended; the value is the sentence that a reader sees."""

    FINISHED = "the end time was reached"
    NO_CONVERGENCE = "the Newton iteration did not converge"
    SINGULAR = "the iteration matrix is singular"
    NOT_FINITE = "the residual is not finite"
    INTERRUPTED = "the run was interrupted"
    STEP_LIMIT = "the limit of steps (max_steps) was reached"
    ERROR_TEST = "no step, however small, passed the error test"
    TOO_ACCURATE = "the tolerance is below what round-off allows"
    EQUILIBRIUM = "the equilibrium was reached"
    LIMIT_POINT = "the load has a limit point, above which there is no equilibrium nearby"


@final
class PassFailed(AncfdaeError):
    """A pass over a finished run that broke off; caught and turned into an outcome."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(verdict.value)
        self.verdict = verdict


@final
@dataclass(frozen=True)
class Outcome:
    """How a run ended, at which time, and after how many accepted steps.

    Attributes
    ----------
    verdict : Verdict
    time : float
    step : int
    residual : float
        Size of the last Newton correction relative to the motion, for integrators other than HHT
        of the residual of the equations in their scales (dimensionless); zero when the run
        finished.
    load : float or None
        Part of the load that was reached, of a search for an equilibrium; None for a motion.
    advice : str
        What may help, in words.
    """

    verdict: Verdict
    time: float
    step: int
    residual: float
    load: float | None = None
    advice: str = ""

    @property
    def success(self) -> bool:
        """Whether the end time, or an equilibrium, was reached."""
        return self.verdict in (Verdict.FINISHED, Verdict.EQUILIBRIUM)

    def __str__(self) -> str:
        """Return the outcome as a sentence."""
        moving = self.load is None
        if self.success:
            when = f"t = {self.time:.6g}, " if moving else ""
            return f"{self.verdict.value} ({when}{self.step} steps)."
        where = f"t = {self.time:.6g}" if moving else f"{100 * (self.load or 0):.6g} % of the load"
        text = (
            f"{self.verdict.value} at {where}, after {self.step} accepted steps, with "
            f"a last relative residual of {self.residual:.3g}; results up to there are kept."
        )
        return f"{text} {self.advice}" if self.advice else text


def require_package(where: str, module: str, extra: str) -> Any:
    """Import a module of an optional package; raise MissingPackage, naming the extra with it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise MissingPackage(
            f'{where}: needs the package {package}. Install it with pip install "ancfdae[{extra}]".'
        ) from error


@final
class Interrupted(KeyboardInterrupt):
    """Ctrl-C came; no loop goes on, and nothing is lost.

    Every call raises it, also in worker processes. It is a KeyboardInterrupt, so that
    ``except Exception`` lets it pass.

    Attributes
    ----------
    result : object
        What was computed up to there, of the kind that the call returns: a `Solution` (of
        gradients the run), an `Equilibrium`, a `Sweep` or a `Tradeoff`. In an interactive session
        it is ``sys.last_value.result``.
    """

    def __init__(self, result: Any, how: str) -> None:
        super().__init__(how)
        self.result = result

    def __reduce__(self) -> tuple[Any, ...]:
        """Make it anew from result and text."""
        return Interrupted, (self.result, str(self))


class _Ended(Protocol):
    @property
    def outcome(self) -> Any:
        """`Outcome`, or one of a search."""


_Result = TypeVar("_Result", bound=_Ended)


def uninterrupted(result: _Result) -> _Result:
    """Return a result; raise `Interrupted` with one that Ctrl-C cut short."""
    if result.outcome.verdict is Verdict.INTERRUPTED:
        raise Interrupted(result, str(result.outcome))
    return result


class _Named(Protocol):
    @property
    def name(self) -> str:
        """By which it is found."""


_Thing = TypeVar("_Thing", bound=_Named)


def named(where: str, name: str, things: Sequence[_Thing]) -> _Thing:
    """Return the thing of this name; raise UnknownName where none has it."""
    require_text(where, name)
    for thing in things:
        if thing.name == name:
            return thing
    raise UnknownName(where, name, (thing.name for thing in things))


def require_unique(where: str, rule: str, names: Sequence[str], repair: str) -> None:
    """Raise InvalidInput for names that are there twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidInput(where, rule, twice, repair)


def require_kind(where: str, value: object, kinds: tuple[type, ...], repair: str) -> None:
    """Raise InvalidInput for an object that is of none of the given classes."""
    if not isinstance(value, kinds):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InvalidInput(where, f"must be of type {names}", _shown(value), repair)


def _shown(value: object) -> str:
    """Return the beginning of what may be as long as a beam or a solution."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def require_text(where: str, value: object) -> None:
    """Raise InvalidInput for what is no text, where a name is expected."""
    require_kind(where, value, (str,), "Give the name, as in rod.name.")


def require_path(where: str, value: object) -> Path:
    """Return the path of a file; raise InvalidInput for what is none, or is a folder."""
    require_kind(where, value, (str, os.PathLike), "Give the name of a file.")
    path = Path(value)  # type: ignore[arg-type]  # as was just seen
    if path.is_dir():
        raise InvalidInput(where, "must be a file", f"the folder {value!r}", "Name a file in it.")
    return path


def require_folder(where: str, path: Path) -> Path:
    """Return a path; raise InvalidInput if there is no folder to write it to."""
    if not path.parent.is_dir():
        rule, repair = "must lie in a folder that exists", "Create the folder, or correct the path."
        raise InvalidInput(where, rule, repr(os.fspath(path)), repair)
    return path


def require_index(where: str, value: object, count: int, repair: str) -> None:
    """Raise InvalidInput for what is no whole number from 0 to `count` - 1."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not 0 <= value < count:  # type: ignore[operator]
        raise InvalidInput(where, f"must lie in 0 to {count - 1}", repr(value), repair)


def require_flag(where: str, value: object) -> None:
    """Raise InvalidInput for what is neither True nor False."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidInput(where, "must be True or False", repr(value), "Give one of both.")


def require_function(where: str, value: object) -> None:
    """Raise InvalidInput for what cannot be called."""
    if not callable(value):
        raise InvalidInput(where, "must be a function", repr(value), "Give its name, uncalled.")


def require_name(where: str, value: object) -> None:
    """Raise InvalidInput for what cannot stand before the parameter of a design target."""
    if not isinstance(value, str) or not value or "." in value or "[" in value:
        raise InvalidInput(
            where,
            "must be a non-empty string without '.' and '['",
            repr(value),
            "Names appear in design targets such as 'rod.height[2]'.",
        )


def require_sequence(
    where: str, value: object, rule: str = "must be a sequence", repair: str = "Put it in a list."
) -> tuple[Any, ...]:
    """Return the entries of a sequence; raise InvalidInput for what has none."""
    try:
        # An iterator has no length: it could be read only once.
        return tuple(value) if len(value) else ()  # type: ignore[arg-type]
    except TypeError:
        raise InvalidInput(where, rule, _shown(value), repair) from None


def require_each(
    where: str, values: object, kinds: tuple[type, ...], repair: str
) -> tuple[Any, ...]:
    """Return the entries of a sequence, which must be of one of the given classes."""
    entries = require_sequence(where, values)
    for entry in entries:
        require_kind(where, entry, kinds, repair)
    return entries


def require_finite(where: str, value: object, repair: str = "Give a finite number.") -> None:
    """Raise InvalidInput for what is no finite real number.

    A truth value is none, nor is an integer that does not fit a float.
    """
    try:
        is_number = isinstance(value, int | float | np.integer | np.floating)
        good = is_number and not isinstance(value, bool) and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:
        good = False
    if not good:
        raise InvalidInput(where, "must be a finite real number", repr(value), repair)


def require_count(where: str, value: object, repair: str) -> None:
    """Raise InvalidInput for a value that is not a positive whole number."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < 1:  # type: ignore[operator]
        raise InvalidInput(where, "must be a positive integer", repr(value), repair)


def require_positive(where: str, value: float) -> None:
    """Raise InvalidInput for a value that is not a finite positive number."""
    require_finite(where, value, "Give a positive number.")
    if value <= 0:
        raise InvalidInput(where, "must be positive", repr(value), "Give a positive number.")


def require_vector(where: str, value: object, sizes: tuple[int, ...] = (2, 3)) -> None:
    """Raise InvalidInput for anything but finite numbers, as many as one of `sizes`."""
    allowed = " or ".join(str(size) for size in sizes)
    rule, repair = f"must have {allowed} components", f"Give {allowed} numbers."
    components = require_sequence(where, value, rule, repair)
    if len(components) not in sizes:
        raise InvalidInput(where, rule, components, repair)
    for component in components:
        require_finite(where, component)


def require_direction(where: str, value: object, sizes: tuple[int, ...] = (2, 3)) -> None:
    """Raise InvalidInput for anything but a vector, as in `require_vector`, that is not zero."""
    require_vector(where, value, sizes)
    if not any(value):  # type: ignore[arg-type]  # a sequence, as was just seen
        raise InvalidInput(where, "must not be zero", value, "Give a direction.")


def require_axial(where: str, value: object, dimension: int | None = None) -> None:
    """Raise InvalidInput for what is neither a number, as in the plane, nor three components.

    Where the dimension of space is given, for the other one of both, too.
    """
    is_number = np.ndim(value) == 0  # type: ignore[arg-type]
    if dimension is not None and is_number != (dimension == 2):
        rule = "must be a number in the plane and have 3 components in space"
        raise InvalidInput(where, rule, repr(value), f"Here space has {dimension} dimensions.")
    if is_number:
        require_finite(where, value)
    else:
        require_vector(where, value, (3,))


def require_array(
    where: str, value: object, shape: tuple[int, ...] | None = None
) -> npt.NDArray[np.float64]:
    """Return a copy as an array of floats; raise InvalidInput for what is none.

    So it does if entries are not finite, rows differ in length, or the shape is another.
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
    raise InvalidInput(where, rule, got, "Give nested lists of numbers, or an array.")
