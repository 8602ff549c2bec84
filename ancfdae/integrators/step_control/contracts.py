"""Interfaces of step control, errors against tolerances, and the loop over the steps.

**Error of a step against its tolerance.** With delta the defect of the positions in a step, the
rates delta / h add up to the error of the run, so they are what the tolerance bounds (error per
unit step):

    e^2 = mean over i of (T delta_i / h / (rtol |r_i| + atol Q_i))^2

with T the length of the run, |r_i| the root mean square of the vector to which coordinate i
belongs, positions from the place of the system, and Q_i the size of coordinate i (`Scales`). A step
is accepted if e <= 1.

Where derivatives are integrated too, each design variable j has its own e, from the derivative of
delta in the design, with

    rtol |r_b,ij| + atol S_j Q_i

below the fraction and twice the value, because errors of the motion add as much again to those of
its derivatives; the largest e is that of the step. S_j is the largest size of derivative j in the
run, relative to the coordinates.

**Sizes S_j** must be known before the run. Derivatives in parameters start from zero, so that the
start does not show them; a rough run determines them.
"""

from __future__ import annotations

import abc
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, final

import numpy as np

from ancfdae.equations import ErrorEstimates, MechanicalSystem, Sensitivities
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import ContactRecord
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.integrators.prescribed_motion import (
    Lost,
    TriedOver,
    Watch,
    half_a_turn_off,
    lock,
    lost_mass,
)
from ancfdae.integrators.problem import Scales
from ancfdae.integrators.recorder import Rows, SolutionRecorder
from ancfdae.kernels import March
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import progress_bar

_TWICE = 2.0
# A design variable has no influence if a change by its own size moves the coordinates by less than
# this, relatively (measured where the influence is zero, E = 1e7 to 1e13 Pa: 1e-15 at most).
_ROUND_OFF = 1e-12


def with_own_sizes(rough: Solution, run: Callable[[Array], Solution], scales: Scales) -> Solution:
    """Repeat a run until its derivatives have the sizes that controlled its steps.

    The first sizes come from `rough`, a run under error control of the motion alone. If they were
    too large the tolerance was too loose; then the sizes found are used, and the run is repeated.
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
    """Return S_j, (n_b,), of the derivatives of a run, shape (n_t, n_q, n_b).

    S_j is infinite if derivatives are not finite, and zero if they are round-off.
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
    """Return whether assumed sizes of derivatives are at most twice the sizes reached.

    Sizes of round-off are not compared, because they bound no error.
    """
    return bool(np.all((shown == 0) | ((assumed > 0) & (assumed <= _TWICE * shown))))


def smaller_sizes(assumed: Array, shown: Array) -> Array:
    """Return the smaller of both sizes, (n_b,); zero, which bounds nothing, does not count.

    Where `sizes_hold` is false at least one of them falls to half or stops being zero, and none
    becomes zero again, so that repeating a run ends.
    """
    smaller = np.where(assumed > 0, np.minimum(assumed, shown), shown)
    return np.where(shown > 0, smaller, assumed)


# Errors of the motion add as much to the derivatives' errors as their own:
# docs/theory/13-errors.md.
_FED = 2.0


@final
@dataclass(frozen=True)
class Tolerance:
    """Tolerance of the error of a step; see the module.

    `sizes` are the sizes Q_i of coordinates, (n_q,), `sizes_b` the sizes S_j of derivatives,
    (n_b,), zero for design variables without influence.
    """

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
        """Return the largest e of the derivatives; `size_b` is |r_b|, `blur_b` round-off."""
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
    """Return the summed errors of all n steps of a run, relative to Q_i and Q_i S_j.

    The error of a step is `scale`, (n,), times the increment of the accelerations, (n, n_q), or of
    a_b for the derivatives.
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
    """Return sums over steps, (n_b,) or a scalar, of root mean squares; infinite if not finite."""
    total = np.abs(scale) @ np.sqrt(mean_squares(rises, sizes))
    return np.where(np.isfinite(total), total, np.inf)


# Internal state of a method after a step.
State = TypeVar("State")
# Time, q, v, a, lam and, where derivatives are integrated too, q_b, v_b, a_b, lam_b; or rows of
# several time points.
Record = tuple[float | Array, Array, Array, Array, Array, tuple[Array, ...]]


_UNSEEN = "However short the steps are, they pass over the contact."
# Most steps in a row that a controller may take back.
BACK = 4
# Reasons for the end of a run that locking joints may explain.
_STUCK = (Verdict.NO_CONVERGENCE, Verdict.ERROR_TEST)
#: Verdicts on steps that kernels do not solve.
VERDICTS = {
    March.NOT_FINITE: Verdict.NOT_FINITE,
    March.SINGULAR: Verdict.SINGULAR,
    March.NO_CONVERGENCE: Verdict.NO_CONVERGENCE,
    March.INACCURATE: Verdict.ERROR_TEST,
}


class Failure(NamedTuple):
    """Why a step was not solved: the size of the last correction, and a remedy in words."""

    verdict: Verdict
    correction: float
    remedy: str = ""


class Reached(NamedTuple):
    """Progress of a run: index of the next step, time, size of the last step, and state.

    `tried` are coordinates, (k, n_q), of a step that was tried next over pairs that are left out.
    """

    n: int
    t: float
    last: float
    now: Any
    tried: Array | None = None


#: Progress of a run at its start.
NOWHERE = Reached(0, 0.0, 0.0, None)
_NO_TIMES = np.zeros(0)
# Most steps under error control of one call of the kernel.
_TOGETHER = 64


# Raises an exception if a step must not be judged.
Tries = Callable[[Rows], None]


class Batch(NamedTuple):
    """Steps under error control of one call of a kernel: times of all their states, end times.

    `filters` are `Controller.numbers` after each step, and `states` returns the state after the
    first k steps. `end` is the reason for the end of the call, and `size` the size of the
    last correction.
    """

    t: Array
    ends: Array
    filters: Array
    states: Callable[[int], Any]
    end: March
    size: float

    def again(self, first: int) -> int | None:
        """Return the index of the earlier step from which the run is to continue, if any.

        `first` is the index of the first step of the call.
        """
        if self.end == March.BEGIN_ANEW:
            return 0
        return first - 1 if self.end == March.STEP_BEFORE else None

    @property
    def failure(self) -> Failure | None:
        """The reason why no further step helps; None if the run continues."""
        if self.end not in VERDICTS:
            return None
        return Failure(VERDICTS[self.end], 0.0 if self.end == March.INACCURATE else self.size)


class OneStepMethod(abc.ABC, Generic[State]):
    """A one-step method applied to a system; a `Controller` decides the step sizes.

    Its error e falls with the step to the power `order`. Unless it `bears_jumps`, accelerations and
    multipliers suffer from jumps of the step size, so that steps change slowly. Controlled steps
    end at breakpoints. A run under control that will take more steps than `many` warns, with the
    remedy.
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
        """Return the start of a run whose first step has the size h, s."""

    @abc.abstractmethod
    def resized(self, state: State, ratio: float) -> State:
        """Return a state for a step of `ratio` times the size of the step before."""

    @abc.abstractmethod
    def advance(self, h: float, before: State, t: float) -> State | Failure:
        """Return the state at t, after a known step of size h, s, or why it was not solved."""

    def march(self, before: State, sizes: Array, ends: Array) -> tuple[int, State]:
        """Take and record as many of the known steps as one call can; by default none.

        Returns their number and the state after them.
        """
        return 0, before

    @abc.abstractmethod
    def controlled(
        self, begin: Reached, controller: ErrorController, most: int, tries: Tries | None
    ) -> Batch:
        """Take up to `most` steps under error control, and write them to the recorder's next rows.

        A step is planned and judged by the controller's `numbers`. `tries` is called with the
        states of every step that is tried, before it is judged; then there is one step.
        """

    @abc.abstractmethod
    def recorded(self, state: State) -> Record:
        """Return a state as a row of the solution, or as several rows."""

    @abc.abstractmethod
    def start_error(self) -> float:
        """Return e of a first step of size 1 s, estimated at the start; e falls with h^order."""


class Controller(abc.ABC):
    """Chooses the step sizes of a run."""

    @abc.abstractmethod
    def plan(self, n: int, t: float) -> tuple[float, float] | Verdict:
        """Return size and end of the step after step n at time t, or why the run ends there."""


class KnownController(Controller):
    """Knows the step sizes of a run before it."""

    @abc.abstractmethod
    def known(self, n: int) -> tuple[Array, Array]:
        """Return sizes and ends of further steps from step n on; s."""


class ErrorController(Controller):
    """Chooses step sizes from the times and errors of the steps.

    Kernels choose sizes by `numbers` (`StepFilter` in `kernels/control.h`), which they change, and
    by `stops`, times at which steps must end, s.
    """

    numbers: Array
    stops: Array

    @abc.abstractmethod
    def judge(self, n: int, t: float, h: float, error: float | None) -> int | Verdict:
        """Judge step n, of size h from time t, by its e; None if it was not solved.

        Return why no step helps, or the index of the next step: n + 1 after an accepted step, n to
        try another size, n - 1 to repeat the step before, 0 to start the run anew.
        """

    @abc.abstractmethod
    def passed(self, ends: Array, anew: bool) -> tuple[int, Failure | None]:
        """Note accepted steps with these end times; return how many count, and why not all do.

        With `anew` the run starts anew after them.
        """

    @abc.abstractmethod
    def state(self) -> tuple[float, ...]:
        """Return the numbers with which `StepControl.controller` continues a run."""


class StepControl(abc.ABC):
    """Immutable settings of how the steps of a run are chosen; `kind` names it in a word."""

    kind: ClassVar[str] = "fixed"

    @abc.abstractmethod
    def count(self, t_end: float) -> int:
        """Return the number of steps to `t_end`, s, which must fit, or a guess."""

    @abc.abstractmethod
    def tolerance(self, t_end: float, sizes: Array, sizes_b: Array) -> Tolerance | None:
        """Return the tolerance for the error of a step; None if steps do not depend on it."""

    @abc.abstractmethod
    def controller(
        self, t_end: float, method: OneStepMethod[Any], state: tuple[float, ...] = ()
    ) -> Controller:
        """Return the controller of the steps of one run; `state` continues an earlier run."""

    @abc.abstractmethod
    def continues(self, t: Array, state: tuple[float, ...], t_end: float) -> bool:
        """Return whether a run with times t, which left this state, can go on to `t_end`."""

    @abc.abstractmethod
    def sizes(self, t: Array) -> Array:
        """Return the step sizes of a run with end times t of its steps; s."""

    @abc.abstractmethod
    def frozen(self, t: Array) -> StepControl:
        """Return the control that repeats the steps of a run with times t, at any design."""

    @abc.abstractmethod
    def refined(self, t: Array) -> StepControl:
        """Return the control that halves every step of a run with times t."""


def march(
    method: OneStepMethod[Any],
    controller: Controller,
    recorder: SolutionRecorder,
    t_end: float,
    progress: bool,
    before: Sequence[Reached] = (),
) -> tuple[Solution, Reached]:
    """Step to the end; after a failure or an interrupt the solution holds the steps so far.

    A run that goes on has its progress `before`, after its last steps that may be taken back, and a
    recorder that holds its states.
    """
    if not before:
        recorder.record(*method.consistent())
    # `_lost` checks the mass matrix of steps under control.
    controlled = isinstance(controller, ErrorController)
    watch, lost = Watch(method.system, recorder, controlled), None
    # Steps under control are shorter where they would pass over a contact.
    contacts = method.system.contacts()
    path = deque(before or [NOWHERE], maxlen=1 + BACK)
    reached = path[-1]
    with progress_bar(progress, total=t_end, initial=reached.t, unit="s") as bar:
        try:
            # A run that diverges overflows; its outcome reports it, so NumPy's warnings are off.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                tools = method, controller, recorder, contacts, watch.tries
                while isinstance(end := _next(*tools, path), Reached):
                    bar.update(end.t - reached.t)
                    reached = end
                    if lost := watch.missed():
                        break
                lost = lost or watch.missed(all_of_them=True)
        except SingularMatrix:
            end = Failure(Verdict.SINGULAR, 0.0)
        except TriedOver as tried:
            # All that was tried from here is tried again with the pairs that the step met.
            reached = path[-1]._replace(tried=tried.q)
            end = Failure(Verdict.LEFT_OUT, 0.0, tried.advice)
        except KeyboardInterrupt:
            end = Failure(Verdict.INTERRUPTED, 0.0)
    # Also check states of a run that ended before the check in the loop.
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
    tries: Tries | None,
    path: deque[Reached],
) -> Reached | Failure:
    """Take steps; return the progress of the run after them, or how the run ends.

    `path` ends with the present progress, after some earlier ones; accepted steps are appended.
    """
    n, t, _, now, _ = reached = path[-1]
    planned = controller.plan(n, t)
    if isinstance(planned, Verdict):
        return Failure(planned, 0.0)
    h, end = planned
    begin = Reached(n, t, h, method.start(h)) if now is None else reached
    if isinstance(controller, ErrorController):
        return _controlled(method, controller, recorder, contacts, tries, begin, path)
    assert isinstance(controller, KnownController)
    before = begin.now if now is None else method.resized(now, h / begin.last)
    sizes, ends = controller.known(n)
    count, after = method.march(before, sizes, ends)
    if count:
        path.append(Reached(n + count, float(ends[count - 1]), float(sizes[count - 1]), after))
        return path[-1]
    after = method.advance(h, before, end)
    if isinstance(after, Failure):
        recorder.rejected += after.verdict is not Verdict.SINGULAR
        return after
    recorder.record(*method.recorded(after))
    path.append(Reached(n + 1, end, h, after))
    return path[-1]


def _go_back(again: int, recorder: SolutionRecorder, path: deque[Reached]) -> None:
    """Go on from step `again`: the last, the one before, or the start of the run."""
    if again == path[-1].n:
        return
    if again > 0:
        recorder.back()
        path.pop()
    else:
        recorder.restart()
        path.append(NOWHERE)


def _controlled(
    method: OneStepMethod[Any],
    controller: ErrorController,
    recorder: SolutionRecorder,
    contacts: ContactRecord | None,
    tries: Tries | None,
    begin: Reached,
    path: deque[Reached],
) -> Reached | Failure:
    """Take several steps by one call of the method; return as `_next`.

    Steps count up to the first that is `_lost`; that one is judged as not solved.
    """
    first, before = controller.numbers.copy(), recorder.last(1)
    batch = method.controlled(begin, controller, 1 if contacts else _TOGETHER, tries)
    ends, again = batch.ends, batch.again(begin.n)
    q, v, *_ = recorder.room(len(batch.t))
    lost = _lost(method.system, contacts, before, Rows(batch.t, q, v))
    degree = len(batch.t) // max(len(ends), 1)
    good = len(ends) if lost is None else lost.first // degree
    kept, too_slow = controller.passed(ends[:good], again == 0)
    instants = np.append(begin.t, ends)
    sizes = np.append(begin.last, np.diff(instants))
    if kept < len(ends):
        controller.numbers[:] = batch.filters[kept - 1] if kept else first
    recorder.take(batch.t[: degree * kept], controller.state())
    for k in range(max(kept - BACK, 1), kept + 1):
        path.append(Reached(begin.n + k, float(instants[k]), float(sizes[k]), batch.states(k)))
    if too_slow is not None:
        recorder.rejected += 1
        return too_slow
    if lost is not None:
        recorder.rejected += 1
        n, t, *_ = path[-1]
        judged = controller.judge(n, t, float(sizes[kept + 1]), None)
        if isinstance(judged, Verdict):
            return Failure(lost.verdict, 0.0, lost.remedy)
        again = judged
    elif batch.failure is not None:
        return batch.failure
    if again is not None:
        _go_back(again, recorder, path)
        recorder.take(_NO_TIMES, controller.state())
    return path[-1]


def _lost(
    system: MechanicalSystem, contacts: ContactRecord | None, before: Rows, rows: Rows
) -> Lost | None:
    """Return the first of the states `rows` that a step under error control must not reach.

    It stands half a turn off the root of a driven joint, has a mass matrix that is not positive
    definite, left a guide or a pulley, or was reached over a contact that no state sees.
    """
    found, lost = system.off_root(rows.t, rows.q), None
    if found is not None:
        begin = float(before.t[-1])
        lost = Lost(found[0], Verdict.OFF_ROOT, half_a_turn_off(system, begin, rows.t, rows.q))
    routed, inert = system.traits.routed, system.traits.constant_mass
    if not len(rows.t) or (inert and not (routed or contacts)):
        return lost
    path = Rows(*map(np.concatenate, zip(before, rows, strict=True)))
    lighter = None if inert else lost_mass(system, path)
    if lighter is not None and (lost is None or lighter.first <= lost.first):
        lost = lighter
    off = system.off_route(*path) if routed else None
    if off is not None and (lost is None or off[0] <= lost.first):
        lost = Lost(max(off[0] - 1, 0), Verdict.OFF_ROUTE, f"The next step {off[1]}.")
    if lost is None and contacts and contacts.passes(*path):
        lost = Lost(0, Verdict.MISSED_CONTACT, _UNSEEN)
    return lost
