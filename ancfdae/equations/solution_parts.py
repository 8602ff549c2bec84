"""Parts of a solution: cost, error estimates, derivatives, contacts; and its pandas tables."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, final

import numpy as np

from ancfdae.errors.checks import require_array, require_kind, require_package
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText, listed
from ancfdae.numerics.arrays import Array


def pandas() -> Any:
    """Return the module pandas; MissingPackageError, with a remedy, if it is not installed."""
    return require_package("to_dataframe", "pandas", "pandas")


def states_table(
    t: Array,
    q: Array,
    q_b: Array | None,
    names: list[str],
    variables: tuple[str, ...],
    more: object,
) -> Any:
    """Return coordinates, their derivatives and further columns over time as a DataFrame."""
    table = dict(zip(names, q.T, strict=True))
    if q_b is not None:
        for i, variable in enumerate(variables):
            derivative_names = (f"d {name}/d {variable}" for name in names)
            table |= dict(zip(derivative_names, q_b[..., i].T, strict=True))
    more = {} if more is None else more
    require_kind("to_dataframe, columns", more, (Mapping,), "For example {'tip [m]': values}.")
    assert isinstance(more, Mapping)
    for name, values in more.items():
        column = require_array(f"to_dataframe, column {name!r}", values, t.shape)
        if name in table:
            rule = "must differ from the names of all other columns"
            raise InvalidInputError("to_dataframe, columns", rule, repr(name))
        table[name] = column
    pd = pandas()
    return pd.DataFrame(table, index=pd.Index(t, name="t"))


def sensitivity_table(q_b: Array, names: tuple[str, ...]) -> Any:
    """Return q_b as a DataFrame: rows (time index, coordinate), one column per variable."""
    pd, (n_t, n_q, n_b) = pandas(), q_b.shape
    rows = pd.MultiIndex.from_product(
        [np.arange(n_t), np.arange(n_q)], names=["instant", "coordinate"]
    )
    return pd.DataFrame(q_b.reshape(n_t * n_q, n_b), index=rows, columns=list(names))


@final
@dataclass(frozen=True)
class Statistics:
    """Counters and elapsed time of a run.

    Attributes
    ----------
    steps, rejected : int
        Accepted steps, and steps of `HHT` repeated with a smaller size.
    iterations, residuals : int
        Newton iterations, and evaluations of the residual.
    factorisations : int
        Matrix factorisations, including passes for derivatives, except the backward pass of IDAS,
        which does not report them.
    round_off_steps : int
        Steps of `HHT` whose Newton corrections stopped decreasing, by round-off, above the
        tolerance, or in which round-off of the elastic forces leaves less than seven digits.
    continued : int
        Steps of `HHT` that Newton's method solved only through shorter steps, which the counts
        above include.
    wall_seconds : float
        Elapsed time of the run; s.
    """

    steps: int
    iterations: int
    factorisations: int
    residuals: int
    round_off_steps: int
    wall_seconds: float
    rejected: int = 0
    continued: int = 0


@final
@dataclass(frozen=True)
class ErrorEstimates:
    """Discretisation errors that a run of HHT-I3 estimates itself (docs/theory/13-errors.md).

    The errors of all steps are summed. On undamped scenes the sums are within a factor of three
    (motion) and ten (derivatives) of the true errors, also if steps do not resolve the elastic
    waves; with strong damping, which removes errors again, they are too large
    (docs/reports/error-bars). If the motion amplifies errors, or steps pass over a kink or a pulse
    of a law, they are too small: of 130 runs of ``HHT(rtol)`` on random scenes 126 erred by at most
    three times the estimate, the others by 3.5, 18, 22 and 670 times. For an objective and its
    gradient see `error_bars`.

    Attributes
    ----------
    motion : float
        Estimated error of q, relative to the norm of the coordinates.
    derivatives : tuple of float, or None
        Estimated errors of q_b, one per design variable, relative to the largest norm of that
        derivative in the run; nan if the variable has no influence above round-off, inf if the
        motion grew without bound. None unless the run was differentiated by
        `DirectDifferentiation` or `AdaptiveSteps(sensitivities=True)`.
    """

    motion: float
    derivatives: tuple[float, ...] | None = None

    def __repr__(self) -> str:
        derivatives = (
            "not computed"
            if self.derivatives is None
            else listed(f"{x:.3g}" for x in self.derivatives)
        )
        return f"estimated errors: motion {self.motion:.3g}; derivatives {derivatives}"


@final
@dataclass(frozen=True, repr=False)
class Sensitivities(PrintedTable):
    """Total design derivatives of a trajectory, with names and values of the design variables.

    q_b, v_b, a_b have the shape (n_t, n_q, n_b), lam_b (n_t, n_lam, n_b).
    """

    names: tuple[str, ...]
    values: Array
    q_b: Array
    v_b: Array
    a_b: Array
    lam_b: Array

    def to_dataframe(self) -> Any:
        """Return q_b as a pandas table: rows (time index, coordinate), a column per variable.

        `Solution.to_dataframe` gives tables with names and times.
        """
        return sensitivity_table(self.q_b, self.names)

    def _printed(self) -> TableText:
        return f"Sensitivities at {len(self.q_b)} instants", rows_of_design(self), ""


def rows_of_design(sensitivities: Sensitivities) -> list[tuple[str, str, str]]:
    """Return a row for each design variable: name, value, largest derivative of a coordinate."""
    largest = np.max(np.abs(sensitivities.q_b), axis=(0, 1), initial=0.0)
    values, sizes = ([f"{x:.6g}" for x in column] for column in (sensitivities.values, largest))
    rows = zip(sensitivities.names, values, sizes, strict=True)
    return [("design variable", "value", "largest |q_b|"), *rows]


@final
class MissedContact(NamedTuple):
    """The time, s, from which on a run is unreliable because of a missed contact, with advice."""

    time: float
    advice: str


class LeftOut(Protocol):
    """Protocol of searches along a run for pairs of bodies that touch but are left out."""

    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine consecutive time points, (k,), the first of which was the last before."""

    def missed(self) -> MissedContact | None:
        """Return the first time at which such a pair touches, or None."""

    def tried(self, t: Array, q: Array, v: Array) -> tuple[Array, MissedContact] | None:
        """Return the first state, (1, n_q), of a tried step at which such a pair touches, or None.

        The time points begin with the last one examined, and are not followed.
        """


class ContactRecord(abc.ABC):
    """Base class of objects that follow the states of one run and check its contacts."""

    @abc.abstractmethod
    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine the next time points, (k,), with rows of q and v, (k, n_q).

        Time points before the last one examined are skipped, so that packets may overlap or be
        repeated. The last one may have other velocities, after an impact.
        """

    @abc.abstractmethod
    def passes(self, t: Array, q: Array, v: Array) -> bool:
        """Return whether surfaces touch between two time points, (2,), but at neither of them."""

    @abc.abstractmethod
    def missed(self) -> MissedContact | None:
        """Return the first contact that the steps do not resolve; None if all are resolved."""
