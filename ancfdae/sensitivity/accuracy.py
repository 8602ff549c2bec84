"""What a call to a tolerance tells: bars, what was chosen, what was spent."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

from ancfdae.errors.text import columns
from ancfdae.integrators import Integrator
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Trial:
    """One run of a search: its steps (zero if it did not end) and processor time, s.

    `error` is the largest relative bar that this run and the coarser ones of its kind give.
    """

    integrator: Integrator
    steps: int
    seconds: float
    error: float


@dataclass(frozen=True)
class Searched(abc.ABC):
    """What every call to a tolerance tells.

    Attributes
    ----------
    tolerance : float
    reached : bool
        Whether all bars are within it.
    integrator : Integrator
        Of the finest run of the chosen kind.
    why : str
        Why this one, or why the tolerance is out of reach and what it would cost.
    trials : tuple of Trial
        All runs in their order.
    """

    tolerance: float
    reached: bool
    integrator: Integrator
    why: str
    trials: tuple[Trial, ...]

    @property
    def seconds(self) -> float:
        """Processor time of all runs, s."""
        return sum(each.seconds for each in self.trials)

    def __repr__(self) -> str:
        verdict = "reached" if self.reached else "NOT reached"
        rows = [("run", "steps", "seconds", "error")]
        for each in self.trials:
            numbers = str(each.steps or "not ended"), f"{each.seconds:.2g}", f"{each.error:.1g}"
            rows.append((type(each.integrator).__name__, *numbers))
        head = f"tolerance {self.tolerance:g} {verdict}, {self.seconds:.2g} s. {self.why}"
        return f"{head}\n{columns(rows, shorten=False)}"


@final
@dataclass(frozen=True, repr=False)
class Accuracy(Searched):
    """How well value and gradient are known; also `Searched`.

    The tolerance is relative to the norm of the gradient scaled by the design values,
    (b_j dpsi/db_j); for a value to the larger of that and its own size.

    Attributes
    ----------
    value_bar : float
    gradient_bar : array, shape (n_b,)
        Estimated bounds of the errors; no proofs: docs/reports/tolerance says how often they hold.
    """

    value_bar: float
    gradient_bar: Array
