"""Outcomes of runs and searches, which keep what was computed, and interruptions."""

from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol, TypeVar, final

from ancfdae.errors.kinds import AncfdaeError


class Verdict(Enum):
    """The reason for which a run or search ended; the value is the sentence that a reader sees."""

    FINISHED = "the end time was reached"
    NO_CONVERGENCE = "the Newton iteration did not converge"
    SINGULAR = "the iteration matrix is singular"
    NOT_FINITE = "the residual is not finite"
    INTERRUPTED = "the run was interrupted"
    STEP_LIMIT = "the limit of steps (max_steps) was reached"
    ERROR_TEST = "no step, however small, passed the error test"
    STEPS_TOO_SHORT = "the steps became too short to reach the end time"
    OFF_ROOT = "a step ended at another solution of the joints than the motion leads to"
    TOO_ACCURATE = "the tolerance is below what round-off allows"
    EVENTS_ACCUMULATE = "events follow each other without a time between them"
    EVENT_NOT_LOCATED = "no time was found at which the function of an event is zero"
    EVENT_LIMIT = "the limit of events was reached"
    EQUILIBRIUM = "the equilibrium was reached"
    FOLDED = "elements are folded"
    OFF_ROUTE = "a guide is beyond the end of its beam, or a rope off its pulley"
    OPENED = "a joint opens of which equations are left out"
    POLE = "the next step passes over a pole of the equations"
    INDEFINITE = "the mass matrix ceases to be positive definite"
    MISSED_CONTACT = "the steps do not resolve a contact"
    LEFT_OUT = "bodies touch that a contact load leaves out"
    LIMIT_POINT = "the load has a limit point, above which there is no equilibrium nearby"


@final
class PassFailed(AncfdaeError):
    """Raised if a forward or backward pass over a finished run fails; turned into an outcome."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(verdict.value)
        self.verdict = verdict


@final
@dataclass(frozen=True)
class RunOutcome:
    """How a run ended, at which time, and after how many accepted steps.

    Attributes
    ----------
    verdict : Verdict
        The reason for which the run ended.
    time : float
        Time that the run reached; s.
    step : int
        Number of accepted steps.
    residual : float
        Norm of the last Newton correction relative to the motion, for integrators other than HHT of
        the residual of the equations in their scales (dimensionless); zero when the run finished.
    load : float or None
        Load factor that a search for an equilibrium reached, dimensionless; None for a motion.
    advice : str
        Hint at a remedy, as text; of an equilibrium why it is unstable. May be empty.
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
        moving = self.load is None
        if self.success:
            when = f"t = {self.time:.6g}, " if moving else ""
            text = f"{self.verdict.value} ({when}{self.step} steps)"
            return f"{text}; {self.advice}." if self.advice else f"{text}."
        where = f"t = {self.time:.6g}" if moving else f"{100 * (self.load or 0):.6g} % of the load"
        text = (
            f"{self.verdict.value} at {where}, after {self.step} accepted steps, with "
            f"a last relative residual of {self.residual:.3g}; results up to there are kept."
        )
        return f"{text} {self.advice}" if self.advice else text


@final
class Interrupted(KeyboardInterrupt):
    """Raised if Ctrl-C ends a computation; it holds the results computed so far.

    Every call raises it, also in worker processes. It is a KeyboardInterrupt, so that ``except
    Exception`` lets it pass.

    Attributes
    ----------
    result : object
        The results so far, of the kind that the call returns: a `Solution` (for gradients the run),
        an `Equilibrium`, a `Sweep` or a `WorkPrecision`. In an interactive session it is
        ``sys.last_value.result``.
    """

    def __init__(self, result: Any, how: str) -> None:
        super().__init__(how)
        self.result = result

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the exception by its result and text, the arguments of `__init__`."""
        return Interrupted, (self.result, str(self))


class _Ended(Protocol):
    @property
    def outcome(self) -> Any:
        """The outcome of a run or of a search for an equilibrium."""


_Result = TypeVar("_Result", bound=_Ended)


def uninterrupted(result: _Result) -> _Result:
    """Return a result; raise `Interrupted` with one that Ctrl-C cut short."""
    if result.outcome.verdict is Verdict.INTERRUPTED:
        raise Interrupted(result, str(result.outcome))
    return result
