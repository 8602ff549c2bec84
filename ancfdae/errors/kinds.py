"""Exceptions and warnings of the package. Invalid input is reported before any integration.

Messages of InvalidInputError read ``where: rule; got value. Repair.``
"""

import pickle
from collections.abc import Iterable
from typing import Any, final

# Characters of a wrong argument that a message repeats.
_LONGEST = 100


class AncfdaeError(Exception):
    """Base class of all errors raised by this package.

    All of them pickle, so that worker processes can pass them on.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle message and attributes, without a call of `__init__`, whose arguments differ."""
        kept = {name: _sendable(value) for name, value in self.__dict__.items()}
        return _restored, (type(self), self.args), kept


def _restored(kind: type[AncfdaeError], args: tuple[Any, ...]) -> AncfdaeError:
    return kind.__new__(kind, *args)


def _sendable(value: object) -> object:
    """Return the value, or its text if it does not pickle, such as a rejected function."""
    try:
        pickle.dumps(value)
    except (pickle.PicklingError, AttributeError, TypeError):
        return repr(value)
    return value


@final
class MissingPackageError(AncfdaeError, ImportError):
    """Raised if an optional package is not installed; the message says how to install it."""


class InvalidInputError(AncfdaeError, ValueError):
    """Input that does not meet a requirement, with the message "where: rule; got value. repair".

    Parameters
    ----------
    where : str
        Name of the argument or object that is not accepted, as the user wrote it.
    rule : str
        The requirement.
    got : object
        The value found instead.
    repair : str
        A remedy that the rule does not say already; empty if there is none.
    """

    def __init__(self, where: str, rule: str, got: object, repair: str = "") -> None:
        super().__init__(f"{where}: {rule}; got {got}. {repair}".rstrip())
        self.where, self.rule, self.got, self.repair = where, rule, got, repair


@final
class UnknownNameError(InvalidInputError):
    """Raised for a name that nothing in the scene has; the message lists the known names."""

    def __init__(self, where: str, name: object, known: Iterable[str]) -> None:
        listed = ", ".join(sorted(known)) or "(none)"
        super().__init__(where, "must be a known name", repr(name), f"Known names: {listed}.")


@final
class RedundantConstraintsError(InvalidInputError):
    """Raised for constraints that are linearly dependent at the start; names the joints."""


@final
class InconsistentStartError(InvalidInputError):
    """Raised for a start that violates a constraint; names the joint and the violation."""


@final
class SingularMatrix(AncfdaeError):
    """Raised if a matrix cannot be factorised; integrators turn it into an outcome."""


@final
class StabilityWarning(UserWarning):
    """A setting that is admissible but known to lose accuracy or stability."""


@final
class ManyStepsWarning(UserWarning):
    """A run will take many more steps than suitable methods, or thousands of events; it goes on."""


@final
class CoarseMeshWarning(UserWarning):
    """A state has too few elements for its curvature; the message names the beams."""


@final
class LargeStrainWarning(UserWarning):
    """Fibres are strained beyond the validity of their elements; the message names them."""


@final
class FailedDesignWarning(UserWarning):
    """A design that an optimiser tried has no objective value; the message says why."""


@final
class UnlikelyValueWarning(UserWarning):
    """An admissible value that looks like a mistake; the message says why.

    ``warnings.simplefilter("ignore", UnlikelyValueWarning)`` silences it.
    """


@final
class ToleranceWarning(UserWarning):
    """A tolerance is out of reach; the message gives the error reached and the cost of more."""


@final
class NotTracedWarning(UserWarning):
    """Formulas of a user need numbers and run in Python, slowly; the message names the line."""
