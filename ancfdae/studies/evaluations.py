"""Designs that an optimiser asked for: each is computed once, and one may have no values."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeAlias, TypeVar, final

import numpy as np

from ancfdae.errors import AncfdaeError, FailedDesign, require_array
from ancfdae.numerics.arrays import Array
from ancfdae.studies.sweep_result import SweepRow

# What values come from at a design: a run, modes.
R = TypeVar("R")
# Takes the design values, whether derivatives are wanted, and the result there if it is kept.
Compute: TypeAlias = Callable[[Array, bool, R | None], tuple[Array, Array | None, R]]


@final
@dataclass(frozen=True)
class Evaluation:
    """What one design gave: values and, if they were asked for, derivatives in x.

    A design that has none has the error, and the last x before that had values; its values are
    infinite, its derivatives NaN.
    """

    x: Array
    values: Array
    jacobian: Array | None
    error: AncfdaeError | None = None
    near: Array | None = None


@final
class Evaluations(Generic[R]):
    """What was computed at designs x = b / scale, with the results of the last `kept` of them.

    The first design must have values, and with `strict` every one; of a later one without values
    the user is warned. `rows` are the designs in their order, with values or errors.
    """

    def __init__(
        self,
        names: Sequence[str],
        count: int,
        compute: Compute[R],
        *,
        scale: Array | float = 1.0,
        kept: int = 1,
        strict: bool = False,
    ) -> None:
        self._names, self._count, self._compute = tuple(names), count, compute
        self._scale, self._most, self._strict = scale, kept, strict
        self._known: dict[bytes, Evaluation] = {}
        self._results: dict[bytes, R] = {}
        self._good: list[Array] = []
        self.rows: list[SweepRow] = []

    def at(self, x: Array, *, derivatives: bool = True) -> Evaluation:
        """Return what a design gave; without `derivatives` perhaps its values only."""
        x = require_array("design values", x, (len(self._names),))
        known = self._known.get(x.tobytes())
        if known is None or (derivatives and known.jacobian is None):
            known = self._evaluated(x, derivatives)
        return known

    def result(self, x: Array) -> R:
        """Return what values at x come from; raises the error of a design that has none."""
        known = self.at(x, derivatives=False)
        if known.error is not None:
            raise known.error
        if known.x.tobytes() not in self._results:
            self._evaluated(known.x, derivatives=False)
        return self._results[known.x.tobytes()]

    def _evaluated(self, x: Array, derivatives: bool) -> Evaluation:
        key, b = x.tobytes(), x * self._scale
        at = dict(zip(self._names, b.tolist(), strict=True))
        others = [other for other in self._good if not np.array_equal(other, x)]
        try:
            values, jacobian, result = self._compute(b, derivatives, self._results.pop(key, None))
        except AncfdaeError as error:
            self.rows.append(SweepRow(at, None, f"{type(error).__name__}: {error}"))
            if self._strict or not others:
                raise
            warnings.warn(f"the design {at} has no values: {error}", FailedDesign, stacklevel=5)
            none = np.full(self._count, np.inf), np.full((self._count, len(x)), np.nan)
            evaluation = Evaluation(x, *none, error, others[-1])
        else:
            if key not in self._known:
                self.rows.append(SweepRow(at, values))
            self._good = [*others, x][-2:]
            if len(self._results) == self._most:
                del self._results[next(iter(self._results))]
            self._results[key] = result
            slopes = None if jacobian is None else jacobian * self._scale
            evaluation = Evaluation(x, values, slopes)
        self._known[key] = evaluation
        return evaluation
