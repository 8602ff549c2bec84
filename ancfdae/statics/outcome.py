"""Outcomes of a search for an equilibrium, and unrestrained motions, as text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import Naming
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.errors.text import listed
from ancfdae.numerics.arrays import Array

_GYROSCOPIC = "it is unstable unless gyroscopic forces hold it, which modes(scene, at=...) shows"


@final
class FreeMotionError(InvalidInputError):
    """Raised if a system has no equilibrium because nothing restrains a motion, which is named."""


def free_mechanism(naming: Naming | None, q: Array, motions: Array) -> FreeMotionError:
    """Return the error for motions, shape (n_q, k), that nothing restrains at q.

    A motion that changes the shape of a body has a stiffness, which round-off hides.
    """
    if naming is not None and naming.deforms(q, motions):
        return FreeMotionError(
            "equilibrium",
            "the stiffness of every motion must exceed the round-off of the stiffest one",
            f"a stiffness that round-off hides: {motions_in_words(naming, q, motions)}",
            "Take thicker sections (thinner than 1e-5 of the length is too thin for few elements), "
            "or a rigid body; at a critical load change the load by 1 %.",
        )
    return FreeMotionError(
        "equilibrium",
        "every motion must be held by a joint, a stiffness or the weight",
        f"a mechanism that is free to move: {motions_in_words(naming, q, motions)}",
        "Add a joint, a spring or gravity, or simulate the motion.",
    )


def motions_in_words(naming: Naming | None, q: Array, motions: Array) -> str:
    """Describe which parts move, and how, in motions without stiffness, shape (n_q, k)."""
    if naming is not None:
        return naming.motions_in_words(q, motions)
    share = np.sqrt(np.sum(motions**2, axis=1))
    moving = np.flatnonzero(share > 0.1 * np.max(share))
    return "motion of " + listed(f"coordinate {i + 1}" for i in moving)


@final
@dataclass(frozen=True)
class EquilibriumOutcome:
    """How a search for an equilibrium ended, and which fraction of the load is balanced.

    Attributes
    ----------
    verdict : Verdict
        The reason for which the search ended.
    fraction : float
        Load factor of the state found, dimensionless: one for an equilibrium. The load is the
        unbalanced force at the start (docs/theory/11-statics.md).
    step : int
        Number of converged steps, of the load or of pseudo-transient continuation.
    residual : float
        Norm of the last correction of Newton's method, relative to positions (where it failed, to
        forces too). At an equilibrium it is round-off: corrections have stopped shrinking, and the
        unbalanced forces are no more than the effect of rounding the coordinates.
    stable_to : float or None
        None if the state is stable; else the load factor, to one per cent, above which a motion has
        negative stiffness, as above a buckling load.
    downhill : bool
        Whether the system settled under the full load by pseudo-transient continuation, because no
        path of loads starts where it does (a mechanism, a slack cable) or it could not be followed.
    gyroscopic : bool
        Whether gyroscopic forces, as in a rotating frame, may stabilise a negative stiffness.
    folded : str
        Names of folded elements, of a balanced state that no body can have; else empty.
    flutter : complex or None
        Exponent s of the vibration that grows fastest without damping because follower loads feed
        it; 1/s. None without such a vibration.
    growth : complex or None
        Exponent s of a motion that grows with damping and controllers; 1/s. None if none grows, or
        none was searched.
    growth_searched : bool
        Whether `growth` was searched: `equilibrium` does where there are controllers with states,
        or damping beside loads that turn with the motion, which damping can make unstable.
    flutter_searched : bool
        Whether all motions were searched for flutter: False with follower loads on more than 1,500
        independent motions, of which only the twenty nearest to zero were searched.
    """

    verdict: Verdict
    fraction: float
    step: int
    residual: float
    stable_to: float | None = None
    downhill: bool = False
    gyroscopic: bool = False
    folded: str = ""
    flutter: complex | None = None
    growth: complex | None = None
    growth_searched: bool = False
    flutter_searched: bool = True

    @property
    def success(self) -> bool:
        """Whether the search found an equilibrium under the full load."""
        return self.verdict is Verdict.EQUILIBRIUM

    def of_run(self) -> RunOutcome:
        """Return this outcome as the outcome of a solution with one time point."""
        doubts = "; ".join(self._doubts()) if self.success else ""
        return RunOutcome(self.verdict, 0.0, self.step, self.residual, self.fraction, doubts)

    def __str__(self) -> str:
        """Return the outcome of the search as a sentence."""
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
        if self.verdict is Verdict.FOLDED:
            where = f" ({self.folded})" if self.folded else ""
            text = (
                f"{self.verdict.value}{where} after {steps}: turned inside out, bent back on "
                "itself or crushed, as no body can be; use more elements, or start from "
                "nodes near the equilibrium (NodalState)"
            )
        return "; ".join([text, *self._doubts()]) + "."

    def _doubts(self) -> Iterator[str]:
        """Yield what makes the state unstable, or leaves its stability unknown, as texts."""
        if self.stable_to is not None:
            above = f" above {100 * self.stable_to:.3g} % of the load" if self.stable_to else ""
            held = _GYROSCOPIC if self.gyroscopic else "it is unstable (buckled)"
            yield f"its stiffness is negative{above}: {held}"
        if self.flutter is not None and self.growth is None:
            held = "its damping holds it, without which" if self.growth_searched else ""
            yield (
                f"{held or 'unless damping holds it,'} it flutters: its loads turn with the "
                f"motion, and a vibration of {self.flutter.imag:.4g} rad/s grows by "
                f"{self.flutter.real:.3g} 1/s"
            )
        if self.growth is not None:
            vibrates = f" and vibrates with {self.growth.imag:.4g} rad/s"
            yield (
                "it is unstable with its damping and controllers: a motion grows by "
                f"{self.growth.real:.3g} 1/s{vibrates if self.growth.imag else ''}"
            )
        if not self.flutter_searched:
            yield (
                "of its many motions only the twenty next to zero were searched for flutter from "
                "loads that turn with the motion"
            )
