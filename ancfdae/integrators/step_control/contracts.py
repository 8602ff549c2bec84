"""Contracts of step control: sizes, errors against tolerances, and the loop over the steps.

Sizes that derivatives reach in a run, which error control of them needs beforehand.

Derivatives in parameters start from zero, so that the start does not tell their sizes S_j
but a run before does.

Error of a step against its tolerance.

With delta what the positions miss in a step, the rates delta / h add up to the error of the run, so
that is what the tolerance bounds (error per unit step):

    e^2 = mean over i of (T delta_i / h / (rtol |r_i| + atol Q_i))^2

with T the length of the run, |r_i| the root mean square of the vector to which coordinate i
belongs, positions from the place of the system, and Q_i the size of coordinate i (`Problem`,
`Scales`). A step is accepted if e <= 1.

Where derivatives are integrated too, each design variable j has its own e, from the derivative of
delta in the design, with

    rtol |r_b,ij| + atol S_j Q_i

below the fraction and twice the value, because errors of the motion feed into those of its
derivatives as much again; the largest e is that of the step. S_j is the largest size of
derivative j in the run, relative to the coordinates .

A method offers, a controller decides, a user sets; `march` brings them to the end.
"""

from __future__ import annotations

import abc
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, final

import numpy as np

from ancfdae.equations import ErrorEstimates, MechanicalSystem, Sensitivities
from ancfdae.equations.contact_record import ContactRecord
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.integrators.prescribed_motion import Watch, half_a_turn_off, lock
from ancfdae.integrators.problem import Scales
from ancfdae.integrators.recorder import Rows, SolutionRecorder
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.progress import progress_bar

_TWICE = 2.0
# A change of the design by its own size that moves the coordinates by less than this part of
# theirs is none (measured where the influence is zero, E = 1e7 to 1e13 Pa: 1e-15 at most).
_ROUND_OFF = 1e-12


def with_own_sizes(rough: Solution, run: Callable[[Array], Solution], scales: Scales) -> Solution:
    """Repeat a run until its derivatives have the sizes that it was controlled under.

    They come from a rough run under error control of the motion alone. Where that had them too
    large the tolerance was too loose; then the sizes found count, and all is run again.
    """
    solution, sizes_b = rough, None
    while solution.outcome.verdict is not Verdict.INTERRUPTED:
        assert solution.sensitivities is not None
        shown = derivative_sizes(scales, solution.sensitivities.q_b)
        if sizes_b is None:
            # A rough run that broke off may have seen the beginning of a derivative only.
            sizes_b = shown if solution.outcome.success else np.full(len(shown), np.inf)
        elif not solution.outcome.success or sizes_hold(sizes_b, shown):
            break
        else:
            sizes_b = smaller_sizes(sizes_b, shown)
        solution = run(sizes_b)
    return solution


def derivative_sizes(scales: Scales, q_b: Array) -> Array:
    """Return S_j of the derivatives of a run, shape (n_t, n_q, n_b).

    Infinite if they are not finite, and zero if they are round-off.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        squares = mean_squares(q_b, scales.q)
        sizes = np.sqrt(np.max(squares, axis=0, initial=0.0))
    sizes = np.where(np.isfinite(sizes), sizes, np.inf)
    return np.where(sizes * scales.b > _ROUND_OFF, sizes, 0.0)


def mean_squares(x: Array, sizes: Array) -> Array:
    """Return means of (x / sizes)^2 over coordinates, shape (n, n_q, ...) to (n, ...)."""
    rows = x if x.ndim == 2 else np.moveaxis(x, 1, -1)
    return np.asarray(np.square(rows) @ (1 / (sizes**2 * x.shape[1])))


def sizes_hold(assumed: Array, shown: Array) -> bool:
    """Whether the sizes by which a run was controlled are at most twice the sizes it reached.

    Round-off has no size to compare with, and no error either.
    """
    return bool(np.all((shown == 0) | ((assumed > 0) & (assumed <= _TWICE * shown))))


def smaller_sizes(assumed: Array, shown: Array) -> Array:
    """Return the smaller ones; zero, which bounds nothing, counts as none.

    Where `sizes_hold` is false one of them at least falls to half or stops being zero, which none
    becomes again, so that repeating a run ends.
    """
    smaller = np.where(assumed > 0, np.minimum(assumed, shown), shown)
    return np.where(shown > 0, smaller, assumed)


# Errors of the motion add as much to the derivatives' errors as their own:
# docs/theory/13-errors.md.
_FED = 2.0


@final
@dataclass(frozen=True)
class Tolerance:
    """Measure of the error of a step: sizes Q_i, and sizes_b S_j, zero without influence."""

    rtol: float
    atol: float
    t_end: float
    sizes: Array
    sizes_b: Array

    def of_motion(self, h: float, delta: Array, size: Array, blur: Array | float = 0.0) -> float:
        """Return e of the motion; `size` is |r|, and delta below `blur` is round-off."""
        return self._of(h, delta, self.rtol * size + self.atol * self.sizes + blur)

    def of_derivatives(
        self, h: float, delta_b: Array, size_b: Array, blur_b: Array | float = 0.0
    ) -> float:
        """Return the largest e of the derivatives; `size_b` is |r_b|."""
        seen = self.sizes_b > 0
        least = self.sizes[:, None] * self.sizes_b
        allowed = self.rtol * size_b + self.atol * least + blur_b
        return _FED * self._of(h, delta_b[:, seen], allowed[:, seen])

    def _of(self, h: float, delta: Array, allowed: Array) -> float:
        ratio = delta * (self.t_end / h) / allowed
        return float(np.sqrt(np.max(np.mean(ratio * ratio, axis=0), initial=0.0)))


def estimated_errors(
    scales: Scales, scale: Array, rise: Array, sensitivities: Sensitivities | None
) -> ErrorEstimates:
    """Add up the errors of all n steps of a run, relative to Q_i and Q_i S_j.

    They are the scale, (n,), times the rises of the accelerations, (n, n_q), and of a_b of the
    derivatives.
    """
    # A run that diverged overflows; its error counts as infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        motion = float(_added_up(scale, rise, scales.q))
        if sensitivities is None:
            return ErrorEstimates(motion)
        sums = _FED * _added_up(scale, np.diff(sensitivities.a_b, axis=0), scales.q)
        sizes_b = derivative_sizes(scales, sensitivities.q_b)
        relative = np.divide(sums, sizes_b, out=np.full_like(sums, np.nan), where=sizes_b > 0)
    relative = np.where(np.isfinite(sizes_b), relative, np.inf)
    return ErrorEstimates(motion, tuple(float(x) for x in relative))


def _added_up(scale: Array, rises: Array, sizes: Array) -> Array:
    """Add up, over steps, root mean squares over coordinates; infinite where that is no number."""
    total = np.abs(scale) @ np.sqrt(mean_squares(rises, sizes))
    return np.where(np.isfinite(total), total, np.inf)


# What a method knows at an instant.
State = TypeVar("State")
# Time, q, v, a, lam and, where derivatives are integrated too, q_b, v_b, a_b, lam_b; or rows of
# several instants.
Record = tuple[float | Array, Array, Array, Array, Array, tuple[Array, ...]]


_NONE = np.zeros(0)
_UNSEEN = "However short the steps are, they pass over the contact."
# Steps that a controller may take back, one after another.
BACK = 4
# Ends of runs for which joints that lock may be the reason.
_STUCK = (Verdict.NO_CONVERGENCE, Verdict.ERROR_TEST)


class Failure(NamedTuple):
    """Why a step was not solved: the size of the last correction, and what may help, in words."""

    verdict: Verdict
    correction: float
    remedy: str = ""


class Reached(NamedTuple):
    """Progress of a run: index, time, size of the last step, and state of the method."""

    n: int
    t: float
    last: float
    now: Any


_NOWHERE = Reached(0, 0.0, 0.0, None)
# Steps under control that are taken at once.
_TOGETHER = 64


class Batch(NamedTuple):
    """Steps under control that were taken at once: ends, and the numbers of the filter after each.

    `states` returns the state after a number of steps. After them `why` says that no step helps,
    or the run goes on from an earlier time point with the index `again`.
    """

    ends: Array
    filters: Array
    states: Callable[[int], Any]
    again: int | None
    why: Failure | None


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

    def controlled(
        self, begin: Reached, controller: Controller, recorder: SolutionRecorder, most: int
    ) -> Batch | None:
        """Take up to `most` steps under control, and write their states to the next rows.

        None where steps are taken one by one, which is the rule.
        """
        return None

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
    """Decides the steps of a run; of the method it sees numbers only.

    Kernels choose steps by the `numbers` of a filter (`StepFilter` in `control.h`), which they
    change, and by the `stops` at which steps end. Known steps have an empty array of numbers.
    """

    numbers: Array = _NONE
    stops: Array = _NONE

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

    def passed(self, ends: Array, anew: bool) -> int:
        """Count accepted steps with these ends; return how many of them lead on.

        After them the run may begin anew.
        """
        return len(ends)

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
    # Steps under control are shorter where they would pass over a contact.
    contacts = method.system.contacts()
    path = deque([reached], maxlen=1 + BACK)
    with progress_bar(progress, total=t_end, initial=reached.t, unit="s") as bar:
        try:
            # A run that diverges overflows; its outcome reports it, so NumPy's warnings are off.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                tools = method, controller, recorder, contacts
                while isinstance(end := _next(*tools, path), Reached):
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
    contacts: ContactRecord | None,
    path: deque[Reached],
) -> Reached | Failure:
    """Try a step; return where the run stands then, or how it ends there.

    The path ends where the run stands, with some places before; a step that counts is added.
    """
    n, t, _, now = reached = path[-1]
    planned = controller.plan(n, t)
    if isinstance(planned, Verdict):
        return Failure(planned, 0.0)
    h, end = planned
    begin = Reached(n, t, h, method.start(h)) if now is None else reached
    if len(controller.numbers):
        taken = _controlled(method, controller, recorder, contacts, begin, path)
        if taken is not None:
            return taken
    before = begin.now if now is None else method.resized(now, h / begin.last)
    sizes, ends = controller.known(n)
    if len(sizes):
        count, after = method.march(before, sizes, ends)
        if count:
            path.append(Reached(n + count, float(ends[count - 1]), float(sizes[count - 1]), after))
            return path[-1]
    after = method.advance(h, before, end)
    if not isinstance(after, Failure) and not len(sizes):
        # A shorter step finds the right root.
        instants, q, v, *_ = method.recorded(after)
        rows = Rows(np.atleast_1d(instants), np.atleast_2d(q), np.atleast_2d(v))
        why = half_a_turn_off(method.system, t, rows.t, rows.q)
        after = Failure(Verdict.OFF_ROOT, 0.0, why) if why else after
        if contacts and contacts.passes(
            *map(np.concatenate, zip(recorder.last(1), rows, strict=True))
        ):
            after = Failure(Verdict.MISSED_CONTACT, 0.0, _UNSEEN)
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
    return _again(judged, recorder, path)


def _again(judged: int, recorder: SolutionRecorder, path: deque[Reached]) -> Reached:
    """Return to the time point with the index `judged`: the last, the one before, or the start."""
    if judged == path[-1].n:
        return path[-1]
    if judged > 0:
        recorder.back()
        path.pop()
    else:
        recorder.restart()
        path.append(_NOWHERE)
    return path[-1]


def _controlled(
    method: OneStepMethod[Any],
    controller: Controller,
    recorder: SolutionRecorder,
    contacts: ContactRecord | None,
    begin: Reached,
    path: deque[Reached],
) -> Reached | Failure | None:
    """Take steps under control at once; return as `_next`, None where they go one by one.

    Steps are kept up to one that is judged anew: it left the root of a drive, or it passed over a
    contact.
    """
    first, before = controller.numbers.copy(), recorder.last(1)
    batch = method.controlled(begin, controller, recorder, 1 if contacts else _TOGETHER)
    if batch is None:
        return None
    ends, why = batch.ends, batch.why
    q, v, *_ = recorder.room(len(ends))
    found = method.system.off_root(ends, q)
    good = len(ends) if found is None else found[0]
    wrong = found is not None
    if contacts and len(ends) and not wrong:
        rows = zip(before, (ends, q, v), strict=True)
        wrong = contacts.passes(*map(np.concatenate, rows))
        good -= wrong
    kept = controller.passed(ends[:good], batch.again == 0)
    instants = np.append(begin.t, ends)
    sizes = np.append(begin.last, np.diff(instants))
    if kept < len(ends):
        controller.numbers[:] = batch.filters[kept - 1] if kept else first
    recorder.take(ends[:kept], controller.state())
    for k in range(max(kept - BACK, 1), kept + 1):
        path.append(Reached(begin.n + k, float(instants[k]), float(sizes[k]), batch.states(k)))
    if kept < good:
        recorder.rejected += 1
        return Failure(Verdict.ERROR_TEST, 0.0)
    if wrong:
        recorder.rejected += 1
        n, t, *_ = path[-1]
        why = Failure(Verdict.MISSED_CONTACT, 0.0, _UNSEEN)
        if found is not None:
            words = half_a_turn_off(method.system, t, ends[kept:], q[kept:])
            why = Failure(Verdict.OFF_ROOT, 0.0, words)
        judged = controller.judge(n, t, float(sizes[kept + 1]), None)
        return why if isinstance(judged, Verdict) else _again(judged, recorder, path)
    if why is not None:
        return why
    return path[-1] if batch.again is None else _again(batch.again, recorder, path)
