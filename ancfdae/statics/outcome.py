"""How a search for an equilibrium ended, in words."""

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
        is what was unbalanced at the start (docs/theory.md, section 11).
    step : int
        Steps of the load that converged.
    residual : float
        Size of the last correction of Newton's method, relative to positions and forces, zero
        where the search succeeded.
    unstable : bool
        Whether the tangent has an odd number of negative eigenvalues: this is an equilibrium that
        the least disturbance ends, as beyond a buckling load.
    """

    verdict: Verdict
    fraction: float
    step: int
    residual: float
    unstable: bool

    @property
    def success(self) -> bool:
        """Whether the full load is carried."""
        return self.verdict is Verdict.EQUILIBRIUM

    def of_run(self) -> Outcome:
        """Return it as the outcome of a solution of one instant."""
        return Outcome(self.verdict, 0.0, self.step, self.residual)

    def __str__(self) -> str:
        """Return the outcome as a sentence."""
        steps = f"{self.step} step{'s' if self.step != 1 else ''}"
        text = f"{self.verdict.value} in {steps}"
        if not self.success:
            text = (
                f"{self.verdict.value} at {100 * self.fraction:.6g} % of the load, after "
                f"{steps}, with a last relative correction of {self.residual:.3g}; what "
                "is in balance with that part is kept"
            )
        if self.unstable:
            text += "; it is unstable, a negative stiffness of the tangent (buckling) was met"
        return f"{text}."
