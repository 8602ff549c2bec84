"""How a search for an equilibrium ended, as text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.errors import Outcome, Verdict


@final
@dataclass(frozen=True)
class LoadOutcome:
    """How a search ended and how much of the load it carries.

    Attributes
    ----------
    verdict : Verdict
        The kind of ending.
    fraction : float
        Part of the load that what was found is in balance with: one for an equilibrium. The load
        is what was unbalanced at the start (docs/theory/11-statics.md).
    step : int
        Steps that converged, of the load or downhill.
    residual : float
        Size of the last correction of Newton's method, relative to positions (where it failed, to
        forces too). Of an equilibrium it is round-off: corrections have stopped to shrink, and the
        forces left are no more than what rounding the coordinates changes in them.
    stable_to : float or None
        None if it is stable; else the part of the load above which a motion meets a negative
        stiffness, as above a buckling load, to one per cent.
    downhill : bool
        Whether the system settled under the full load, since no path of loads begins where it
        starts (a mechanism, a slack cable) or it could not be followed.
    """

    verdict: Verdict
    fraction: float
    step: int
    residual: float
    stable_to: float | None = None
    downhill: bool = False

    @property
    def success(self) -> bool:
        """Whether the full load is carried."""
        return self.verdict is Verdict.EQUILIBRIUM

    def of_run(self) -> Outcome:
        """Return it as the outcome of a solution of one instant."""
        return Outcome(self.verdict, 0.0, self.step, self.residual, self.fraction)

    def __str__(self) -> str:
        """Return the outcome as a sentence."""
        steps = f"{self.step} step{'s' if self.step != 1 else ''}"
        steps += " downhill" if self.downhill else ""
        text = f"{self.verdict.value} in {steps}"
        if self.downhill and not self.success:
            text = f"{self.verdict.value} after {steps}; where it has come is kept"
        elif not self.success:
            text = (
                f"{self.verdict.value} at {100 * self.fraction:.6g} % of the load, after "
                f"{steps}; what is in balance with that part is kept"
            )
            if self.residual:
                text += f"; the last relative correction was {self.residual:.3g}"
        if self.stable_to is not None:
            above = f" above {100 * self.stable_to:.3g} % of the load" if self.stable_to else ""
            text += f"; unless it turns, it is unstable (buckled), with a negative stiffness{above}"
        return f"{text}."
