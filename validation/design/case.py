"""What the report says of one optimisation, and the checks that are the same for all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.optimize import nnls

from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel
from validation.design.optimisation import Optimisation

# Distances to a bound or a limit below which it counts as reached, relative; a limit of zero is
# one on a logarithm.
_ACTIVE: Final = 1e-3


@final
@dataclass(frozen=True)
class Response:
    """A computed quantity: the objective, or a constraint if it has an upper limit."""

    name: str
    unit: str
    limit: float | None = None

    def active(self, value: float) -> bool:
        """Whether the limit is reached."""
        return self.limit is not None and value > self.limit - _ACTIVE * (abs(self.limit) or 1.0)


@final
@dataclass(frozen=True)
class Comparison:
    """The optimum held against another one, from a source.

    `found` may differ from `other` by the tolerance, relative to `other`; with `lower`, less is as
    good.
    """

    what: str
    found: float
    other: float
    source: str
    tolerance: float
    lower: bool = False

    @classmethod
    def with_search(
        cls,
        what: str,
        found: Optimisation,
        search: Optimisation,
        tolerance: float,
        told: Callable[[float], float] = float,
    ) -> "Comparison":
        """Compare the objective, as `told`, with what a search without gradients reached."""
        begin = "from the start" if np.array_equal(search.start, found.start) else "from here"
        source = f"COBYQA, without gradients, {begin}, {search.runs} runs, {search.seconds:.0f} s"
        here, there = (told(each.evaluate(each.optimum)[0][0]) for each in (found, search))
        return cls(what, here, there, source, tolerance, lower=True)

    @property
    def apart(self) -> float:
        """Relative difference; what is less where that is as good counts as zero."""
        apart = (self.found - self.other) / abs(self.other)
        return max(apart, 0.0) if self.lower else abs(apart)


@final
@dataclass(frozen=True)
class Case:
    """One optimisation as reported.

    The key is the first word of its figures, the name of its plot and of its words in `report.md`.
    There is one variable for each number, with its unit, and one response for each row of the
    evaluated values. Panels show mechanism and optimum; findings are Markdown. `sizes` of the
    variables serve for the steps of differences; if None, the start counts where it is not zero.
    """

    key: str
    title: str
    method: str
    variables: Sequence[str]
    responses: Sequence[Response]
    found: Optimisation
    comparisons: Sequence[Comparison]
    panels: Sequence[Panel]
    findings: str
    sizes: Array | None = None

    def sizes_or_start(self) -> Array:
        """Return the size of every variable."""
        if self.sizes is not None:
            return self.sizes
        start = np.abs(self.found.start)
        return np.where(start > 0, start, 1.0)

    def on_bounds(self) -> list[str]:
        """Return the variables that end on a bound."""
        bounds = self.found.bounds
        if bounds is None:
            return []
        near = _ACTIVE * (bounds[:, 1] - bounds[:, 0])
        low, high = self.found.optimum - bounds[:, 0], bounds[:, 1] - self.found.optimum
        on = np.minimum(low, high) < near
        return [name for name, is_on in zip(self.variables, on, strict=True) if is_on]


def gradient_check(case: Case, x: Array, variables: int | None = None, step: float = 1e-5) -> float:
    """Return how far the Jacobian is from central differences of the very call.

    The largest entry of the difference, relative to the largest of its row there or at the start,
    as a gradient vanishes where nothing constrains an optimum; columns are scaled by the sizes of
    the variables. Only the first `variables` are moved, if given.
    """
    sizes = case.sizes_or_start()
    exact = (case.found.evaluate(x)[1] * sizes)[:, :variables]
    columns = []
    for move in np.diag(step * sizes)[:variables]:
        above, below = case.found.evaluate(x + move)[0], case.found.evaluate(x - move)[0]
        columns.append((above - below) / (2 * step))
    apart = np.max(np.abs(np.transpose(columns) - exact), axis=1)
    slopes = np.abs([exact, (case.found.evaluate(case.found.start)[1] * sizes)[:, :variables]])
    return float(np.max(apart / np.max(slopes, axis=(0, 2))))


def optimality(case: Case) -> float:
    """Return how far the optimum is from the conditions of Karush, Kuhn and Tucker.

    The gradient of the objective less its best part in the gradients of active constraints and
    bounds with multipliers of the right sign, relative to that gradient at the start; columns are
    scaled by the sizes of the variables.
    """
    found, sizes = case.found, case.sizes_or_start()
    values, jacobian = found.evaluate(found.optimum)
    rows = [
        row * sizes
        for row, value, response in zip(jacobian, values, case.responses, strict=True)
        if response.active(value)
    ]
    if found.bounds is not None:
        near = _ACTIVE * (found.bounds[:, 1] - found.bounds[:, 0])
        eye = np.eye(len(sizes))
        rows += list(-eye[found.optimum - found.bounds[:, 0] < near])
        rows += list(eye[found.bounds[:, 1] - found.optimum < near])
    slope = jacobian[0] * sizes
    left = nnls(np.transpose(rows), -slope)[1] if rows else np.linalg.norm(slope)
    return float(left / np.linalg.norm(found.evaluate(found.start)[1][0] * sizes))
