"""Contracts of step control, and the loop over the steps of a run.

A method offers, a controller decides, a user sets; `march` brings them to the end.
"""

from __future__ import annotations

import abc
from collections import deque
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.integrators.prescribed_motion import half_a_turn_off, lock
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.tolerance import Tolerance
from ancfdae.integrators.watch import Watch
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.progress import progress_bar

# What a method knows at an instant.
State = TypeVar("State")
# Time, q, v, a, lam and, where derivatives are integrated too, q_b, v_b, a_b, lam_b; or rows of
# several instants.
Record = tuple[float | Array, Array, Array, Array, Array, tuple[Array, ...]]


_NONE = np.zeros(0)
# Steps that a controller may take back, one after another.
BACK = 4
# Ends of runs for which joints that lock may be the reason.
_STUCK = (Verdict.NO_CONVERGENCE, Verdict.ERROR_TEST)


class Failure(NamedTuple):
    """Why a step was not solved: the size of the last correction, and what may help, in words."""

    verdict: Verdict
    correction: float
    remedy: str = ""


class OneStepMethod(abc.ABC, Generic[State]):
    """A run of a method that goes from state to state of a system; how far, others decide.

    Its e falls with the step to the power `order`. Where accelerations and multipliers suffer from
    a step that jumps, which is the rule, steps change slowly. Controlled steps end at breakpoints.
    A run under control that will take more steps than `many` warns, with the remedy in words.
    """

    order: ClassVar[int]
    bears_jumps: ClassVar[bool] = False
    many: ClassVar[int] = 20_000
    remedy: ClassVar[str] = ""
    breakpoints: tuple[float, ...] = ()
    system: MechanicalSystem

    @abc.abstractmethod
    def consistent(self) -> Record:
        """Return the consistent start as a row of the solution."""

    @abc.abstractmethod
    def start(self, h: float) -> State:
        """Return the start of a run whose first step has the size h."""

    @abc.abstractmethod
    def resized(self, state: State, ratio: float) -> State:
        """Return a state for a step whose size is `ratio` times that of the step before."""

    @abc.abstractmethod
    def advance(self, h: float, before: State, t: float) -> State | Failure:
        """Return the state at t, after a step of size h, or why it was not solved."""

    def march(self, before: State, sizes: Array, ends: Array) -> tuple[int, State]:
        """Take and record as many of the given steps as go at once; by default none.

        Returns their number and the state after them.
        """
        return 0, before

    @abc.abstractmethod
    def recorded(self, state: State) -> Record:
        """Return a state as a row of the solution."""

    @abc.abstractmethod
    def error(self, h: float, before: State, after: State) -> float:
        """Return e of a step (`Tolerance`); zero where there is no tolerance."""

    @abc.abstractmethod
    def start_error(self) -> float:
        """Return e of a first step of size 1, estimated from the start; it goes with h^order."""


class Controller(abc.ABC):
    """Decides the steps of a run; of the method it sees numbers only."""

    @abc.abstractmethod
    def plan(self, n: int, t: float) -> tuple[float, float] | Verdict:
        """Return size and end of the step after instant n at time t, or how the run ends there."""

    def known(self, n: int) -> tuple[Array, Array]:
        """Return sizes and ends of some steps from instant n on that any step leads to; or none."""
        return _NONE, _NONE

    @abc.abstractmethod
    def judge(self, n: int, t: float, h: float, error: float | None) -> int | Verdict:
        """Judge a step of size h from instant n at time t by its e; None if it was not solved.

        Returns the instant to go on from: n + 1 if the step counts, n if another size is to be
        tried, n - 1 if the step before is to be repeated, 0 if the run begins anew; or why no step
        helps.
        """

    @abc.abstractmethod
    def state(self) -> tuple[float, ...]:
        """Return the numbers with which `StepControl.controller` continues a run."""


class StepControl(abc.ABC):
    """Frozen settings of how the steps of a run are chosen; `kind` says it in a word."""

    kind: ClassVar[str] = "fixed"

    @abc.abstractmethod
    def count(self, t_end: float) -> int:
        """Return the number of steps to `t_end`, which must fit, or a guess."""

    @abc.abstractmethod
    def tolerance(self, t_end: float, sizes: Array, sizes_b: Array) -> Tolerance | None:
        """Return the tolerance for the error of a step; None if steps do not depend on it."""

    @abc.abstractmethod
    def controller(
        self, t_end: float, method: OneStepMethod[Any], state: tuple[float, ...] = ()
    ) -> Controller:
        """Return the controller of the steps of one run; `state` is that of a run to continue."""

    @abc.abstractmethod
    def continues(self, t: Array, state: tuple[float, ...], t_end: float) -> bool:
        """Whether a run with the instants t, which left this state, can go on to `t_end`."""

    @abc.abstractmethod
    def sizes(self, t: Array) -> Array:
        """Return the steps of a run with the instants t."""

    @abc.abstractmethod
    def frozen(self, t: Array) -> StepControl:
        """Return the control that repeats the steps of a run with times t, whatever the design."""

    @abc.abstractmethod
    def refined(self, t: Array) -> StepControl:
        """Return the control that halves every step of a run with times t."""


class Reached(NamedTuple):
    """Progress of a run: index, time, size of the last step, and state of the method."""

    n: int
    t: float
    last: float
    now: Any


_NOWHERE = Reached(0, 0.0, 0.0, None)


def march(
    method: OneStepMethod[Any],
    controller: Controller,
    recorder: SolutionRecorder,
    t_end: float,
    progress: bool,
    reached: Reached = _NOWHERE,
) -> tuple[Solution, Reached]:
    """Step to the end; after a failure or an interrupt the solution holds the steps so far.

    The recorder has what was reached before.
    """
    if reached is _NOWHERE:
        recorder.record(*method.consistent())
    watch, lost = Watch(method.system, recorder), None
    path = deque([reached], maxlen=1 + BACK)
    with progress_bar(progress, total=t_end, initial=reached.t, unit="s") as bar:
        try:
            # A run that diverges overflows; its outcome reports it, so NumPy's warnings are off.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                while isinstance(end := _next(method, controller, recorder, path), Reached):
                    bar.update(end.t - reached.t)
                    reached = end
                    if lost := watch.missed():
                        break
                lost = lost or watch.missed(all_of_them=True)
        except SingularMatrix:
            end = Failure(Verdict.SINGULAR, 0.0)
        except KeyboardInterrupt:
            end = Failure(Verdict.INTERRUPTED, 0.0)
    # What ended before this check was reached is checked all the same.
    lost = lost or watch.missed(all_of_them=True)
    if lost is not None:
        end = Failure(lost.verdict, 0.0, lost.remedy)
    assert isinstance(end, Failure)
    verdict, correction, remedy = end
    if verdict in _STUCK:
        t, q, _ = recorder.last(1)
        remedy = f"{lock(method.system, float(t[0]), q[0], t_end)} {remedy}".strip()
    outcome = RunOutcome(verdict, recorder.time, recorder.steps, correction, advice=remedy)
    return recorder.solution(outcome), reached


def _next(
    method: OneStepMethod[Any],
    controller: Controller,
    recorder: SolutionRecorder,
    path: deque[Reached],
) -> Reached | Failure:
    """Try a step; return where the run stands then, or how it ends there.

    The path ends where the run stands, with some places before; a step that counts is added.
    """
    n, t, last, now = reached = path[-1]
    planned = controller.plan(n, t)
    if isinstance(planned, Verdict):
        return Failure(planned, 0.0)
    h, end = planned
    before = method.start(h) if now is None else method.resized(now, h / last)
    sizes, ends = controller.known(n)
    if len(sizes):
        taken, after = method.march(before, sizes, ends)
        if taken:
            path.append(Reached(n + taken, float(ends[taken - 1]), float(sizes[taken - 1]), after))
            return path[-1]
    after = method.advance(h, before, end)
    if not isinstance(after, Failure) and not len(sizes):
        # A shorter step finds the right root.
        instants, q, *_ = method.recorded(after)
        why = half_a_turn_off(method.system, t, np.atleast_1d(instants), np.atleast_2d(q))
        after = Failure(Verdict.OFF_ROOT, 0.0, why) if why else after
    failed = isinstance(after, Failure)
    if failed and after.verdict is Verdict.SINGULAR:
        return after
    judged = controller.judge(n, t, h, None if failed else method.error(h, before, after))
    if isinstance(judged, int) and judged > n:
        recorder.record(*method.recorded(after), control=controller.state())
        path.append(Reached(judged, end, h, after))
        return path[-1]
    recorder.rejected += 1
    if isinstance(judged, Verdict):
        return after if failed else Failure(judged, 0.0)
    if judged == n:
        return reached
    if judged > 0:
        recorder.back()
        path.pop()
    else:
        recorder.restart()
        path.append(_NOWHERE)
    return path[-1]
