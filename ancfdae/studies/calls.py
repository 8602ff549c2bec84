"""The main calls: simulate, differentiate, gradient(s) and evaluate."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast, overload

import numpy as np

from ancfdae.assembly.system import AncfSystem, assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.event_solution import EventSolution
from ancfdae.equations.meshes import warn_of_mesh
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import require_kind, require_positive, require_sequence
from ancfdae.errors.kinds import InvalidInputError, LargeStrainWarning, StabilityWarning
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.errors.text import listed
from ancfdae.integrators.integrator import AdjointIntegrator, Integrator
from ancfdae.integrators.recorder import Rows
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.time_grid import LOBATTO_DEGREE
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.sensitivity.method import (
    Gradient,
    GradientMethod,
    Method,
    Run,
    UnfinishedRunError,
    warn_near_singular,
)
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import Observable, states_of
from ancfdae.studies.parts import Keep, RunOfParts
from ancfdae.studies.remedies import with_remedies

if TYPE_CHECKING:
    from ancfdae.events.kinds import Event, Mode
    from ancfdae.studies.accuracy.search import ObservableEstimates

# Number of states of a run at which strains are checked, with the end: all would cost half a run.
_LOOKS = 9
# Number of states of a run, the last one included, in which the mesh is checked.
_FEW_LOOKS = 3


@overload
def simulate(
    model: Scene | MechanicalSystem,
    t_end: float,
    integrator: Integrator,
    *,
    after: Solution | None = None,
    keep: Keep | None = None,
    progress: bool = False,
) -> Solution: ...


@overload
def simulate(
    model: Scene | MechanicalSystem,
    t_end: float,
    integrator: Integrator,
    *,
    after: EventSolution | None = None,
    keep: Keep | None = None,
    events: Sequence[Event],
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> EventSolution: ...


@overload
def simulate(
    model: Scene | MechanicalSystem,
    t_end: float,
    *,
    tolerance: float,
    observables: Sequence[Observable],
    at: Sequence[float] | Array | None = None,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> ObservableEstimates: ...


def simulate(
    model: Scene | MechanicalSystem,
    t_end: float,
    integrator: Integrator | None = None,
    *,
    tolerance: float | None = None,
    observables: Sequence[Observable] | None = None,
    at: Sequence[float] | Array | None = None,
    after: Solution | EventSolution | None = None,
    keep: Keep | None = None,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> Solution | EventSolution | ObservableEstimates:
    """Integrate a scene, or any mechanical system, from t = 0 to `t_end`.

    Warns of errors estimated larger than the motion, or large near a singular position of joints
    (`StabilityWarning`), of very many steps under error control (`ManyStepsWarning`), and of a
    tolerance that cannot be reached (`ToleranceWarning`). Beams strained beyond the validity of
    their elements at one of nine times, the end included, give a `LargeStrainWarning`; those with
    too few elements for their curvature at three of these times give a `CoarseMeshWarning`.

    Parameters
    ----------
    t_end : float
        End time; s.
    integrator : Integrator
        `HHT`, `Radau`, `IDA`, `IDAS` or `DOP853`, for example ``HHT(step=2**-7)``.
    tolerance : float, optional
        In place of an integrator, with `observables`: integrator and setting are chosen so that the
        estimated errors of the observables are below it; the result is `ObservableEstimates`. The
        error of each observable, its norm over the times `at`, is relative to the norm of its
        values.
    observables, at : sequences, optional
        Observables to which the tolerance applies, ``[position(rod.at_end, 1)]``, and their times,
        ascending in [0, t_end], by default 65 equidistant ones; s.
    after : Solution or EventSolution, optional
        A run of this model by the same integrator that ended before `t_end`, early or at Ctrl-C: it
        is continued, equal to one run to round-off, under error control within the tolerance. A run
        with events needs the same events and modes, and integrates its last phase again.
    keep : int or sequence of float, optional
        Store only part of a run with prescribed steps. An int k stores the start, every k-th step
        and the end; a sequence of ascending times in [0, t_end], s, stores states interpolated as
        by `Solution.at`. A run with events takes all integrators here, and each of its phases also
        stores its start and its end.
    events : sequence of Event, optional
        `Impact`, `EndEvent` and `Switch`, at each of which a phase of the motion ends; the result
        is then an `EventSolution`.
    modes : mapping of str to Mode, optional
        Models that the run continues with after events, by name.
    progress : bool
        Whether to show a progress bar.
    """
    system = as_system(model)
    if events is not None or modes is not None:
        if tolerance is not None:
            _require_alone("tolerance", integrator=integrator, after=after, keep=keep)
            from ancfdae.studies.accuracy.event_search import events_observed_within

            model_with_events = system, t_end, events or (), modes
            return events_observed_within(model_with_events, observables, at, tolerance, progress)
        _require_alone("an integrator with events", observables=observables, at=at)
        from ancfdae.events.calls import EventRun
        from ancfdae.studies.events import simulated

        run_with_events = EventRun.of(
            system, t_end, integrator, events or (), modes, None, progress
        )
        phased = simulated(run_with_events, after, keep)
        _warn_of_states(system, phased.q)
        return phased
    if tolerance is not None:
        _require_alone("tolerance", integrator=integrator, after=after, keep=keep)
        from ancfdae.studies.accuracy.search import observed_within

        return observed_within(system, observables, at, t_end, tolerance, progress)
    if observables is not None or at is not None:
        rule, repair = "need `tolerance`", "Call observe(observable, solution)."
        raise InvalidInputError("observables, at", rule, "an integrator", repair)
    run = Run(
        system, t_end, cast("Integrator", integrator), progress, cast("Solution | None", after)
    )
    if keep is not None:
        return _thinned(run, keep)
    solution = with_remedies(model, run, uninterrupted(run.solution()))
    if solution.outcome.success:
        _warn_of_states(system, solution.q)
    return _warned(system, solution)


def _warn_of_states(system: MechanicalSystem, q: Array) -> None:
    """Warn the caller of `simulate` of few elements and of large strains in some of its states."""
    some = q[np.linspace(0, len(q) - 1, min(len(q), _LOOKS)).round().astype(int)]
    warn_of_strains("simulate", system, some, stacklevel=4)
    few = some[:: -(_LOOKS // _FEW_LOOKS)]
    warn_of_mesh("simulate", system, few, stacklevel=4, moving=True)


def warn_of_strains(call: str, system: MechanicalSystem, q: Array, stacklevel: int = 3) -> None:
    """Warn the caller of the call, once, of bodies strained too far at some states, rows of q."""
    strained: dict[str, float] = {}
    for state in q:
        for name, strain in system.strained(state).items():
            strained[name] = max(strain, strained.get(name, 0.0))
    if strained:
        worst = max(strained.values())
        warnings.warn(
            f"{call}: fibres of {listed(map(repr, strained))} are strained by up to "
            f"{100 * worst:.2g} %, beyond what beam elements are made for. A force in such a "
            f"stretch differs from Hooke's law by {150 * worst:.2g} %, a shape bent so by about "
            f"{100 * worst**2:.2g} % (its gradient by twice that; cables bend exactly): take the "
            "results as estimates.",
            LargeStrainWarning,
            stacklevel=stacklevel,
        )


def _thinned(run: Run, keep: Keep) -> Solution:
    """Return the run with its states at the time indices `keep` only."""
    if run.after is not None:
        rule = "a run that continues another must keep all its states"
        repair = "Leave out `keep`, or run again from t = 0 without `after`."
        raise InvalidInputError("keep", rule, "`after` too", repair)
    parts = RunOfParts(run.system, run.t_end, run.integrator, keep, run.progress)
    return uninterrupted(parts.solution())


def _warned(system: MechanicalSystem, solution: Solution) -> Solution:
    """Return the run after warning the caller's caller if its errors are large."""
    if solution.outcome.success and not _is_off(system, solution, 4):
        rows = Rows(solution.t, solution.q, solution.v)
        warn_near_singular(system, rows, solution.estimated_errors, stacklevel=4)
    return solution


def _is_off(system: MechanicalSystem, solution: Solution, level: int) -> bool:
    """Return whether the estimated errors of a finished run exceed its motion; if so, warn.

    So do steps that turn a rigid body otherwise than its angular velocity.
    """
    errors = solution.estimated_errors
    if not solution.outcome.success:
        return False
    if errors is not None and errors.motion > 1:
        found = (
            f"the errors of this run are estimated at {errors.motion:.2g} times the size of the "
            "coordinates: its steps are too long to follow the motion. Take shorter ones "
            "(suggest_step tells which), or rtol."
        )
    elif (
        isinstance(system, AncfSystem)
        and solution.degree != LOBATTO_DEGREE
        and any(body.count == body.stride for body in system.naming.layout.bodies)
    ):
        from ancfdae.studies.turns import turned_apart

        apart = turned_apart(system, solution)
        if apart is None:
            return False
        found = (
            f"body {apart[0]!r} turns by up to {apart[1]:.2g} rad in a step, and its rotation and "
            "its angular velocity differ: the rotation may be wrong by turns. Take steps in which "
            "it turns by 0.1 rad (HHT) or 0.5 rad (Radau), or rtol."
        )
    else:
        return False
    warnings.warn(found, StabilityWarning, stacklevel=level)
    return True


@overload
def differentiate(
    model: Scene | MechanicalSystem,
    t_end: float,
    integrator: Integrator,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: Method | None = None,
    after: Solution | None = None,
    progress: bool = False,
) -> Solution: ...


@overload
def differentiate(
    model: Scene | MechanicalSystem,
    t_end: float,
    integrator: Integrator,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: Method | None = None,
    events: Sequence[Event],
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> EventSolution: ...


def differentiate(
    model: Scene | MechanicalSystem,
    t_end: float,
    integrator: Integrator,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: Method | None = None,
    after: Solution | None = None,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> Solution | EventSolution:
    """Return the trajectory of a model with its derivatives in the design variables.

    Parameters
    ----------
    model, t_end, integrator, after, events, modes, progress
        As in `simulate`.
    design : sequence of str or DesignVariable
        For a scene: targets such as ``"pendulum.youngs_modulus"``. A mechanical system has its
        own design variables, so leave it out there.
    method : Method
        `DirectDifferentiation` (default), `FiniteDifference` or `ComplexStep`.

    Returns
    -------
    Solution
        The trajectory with `sensitivities`.
    """
    method = DirectDifferentiation() if method is None else method
    require_kind(
        "method", method, (Method,), "For example DirectDifferentiation() or ComplexStep()."
    )
    system = differentiable(model, design)
    if events is not None or modes is not None:
        _require_alone("events", after=after)
        from ancfdae.events.calls import EventRun
        from ancfdae.studies.events import differentiated

        made = EventRun.of(system, t_end, integrator, events or (), modes, design, progress)
        return differentiated(made, method)
    run = Run(system, t_end, integrator, progress, after)
    solution = with_remedies(model, run, uninterrupted(method.differentiate(run)))
    _is_off(system, solution, 3)
    return solution


def gradient(
    model: Scene | MechanicalSystem,
    objective: Objective,
    t_end: float,
    integrator: Integrator | None = None,
    *,
    tolerance: float | None = None,
    design: Sequence[str | DesignVariable] | None = None,
    method: GradientMethod | None = None,
    memory: str | float | None = None,
    after: Solution | None = None,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> Gradient:
    """Return the value of an objective and its gradient in the design variables.

    Parameters
    ----------
    model, t_end, integrator, design, after, events, modes, progress
        As in `differentiate`; with a finished run as `after` its gradients are computed. The design
        may contain ``"t_end"``, the end time, which is then the last variable.
    objective : Objective
        For example ``Integral((position(rod.at_end, 0) - 1.8) ** 2)``.
    tolerance : float, optional
        In place of an integrator: integrator and setting are chosen so that the estimated error of
        this gradient is below it; `Gradient.accuracy` has the error bars, the choice and its cost.
        The tolerance is relative: derivatives times their variables to the norm of all of these,
        the value to the larger of that norm and the value.
    method : GradientMethod, optional
        `DirectDifferentiation`, `Adjoint`, `ContinuousAdjoint`, `FiniteDifference` or
        `ComplexStep`; by default `cheapest` of the first two, or `DirectDifferentiation` for
        integrators without an adjoint (IDA, DOP853).
    memory : str or float, optional
        ``Adjoint(memory)``: a limit such as ``"200 MB"`` for the states of a run.

    Warns
    -----
    StabilityWarning
        If the estimated errors of the run are larger than its motion.
    CoarseMeshWarning
        If thin beams (elements longer than 14 heights) have too few elements for their curvature in
        the middle or at the end of the run. `simulate` checks all beams.
    ToleranceWarning
        If the tolerance cannot be reached; the most accurate gradient found is returned.
    """
    return gradients(
        model,
        [objective],
        t_end,
        integrator,
        tolerance=tolerance,
        design=design,
        method=method,
        memory=memory,
        after=after,
        events=events,
        modes=modes,
        progress=progress,
    )[0]


def gradients(
    model: Scene | MechanicalSystem,
    objectives: Sequence[Objective],
    t_end: float,
    integrator: Integrator | None = None,
    *,
    tolerance: float | None = None,
    design: Sequence[str | DesignVariable] | None = None,
    method: GradientMethod | None = None,
    memory: str | float | None = None,
    after: Solution | None = None,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> list[Gradient]:
    """Return values and gradients of several objectives of one run, as `gradient` does for one."""
    objectives = require_sequence("objectives", objectives)
    design, free_end = without_end(design)
    system = as_system(model, design) if free_end else differentiable(model, design)
    require_objectives(system, objectives, t_end)
    if memory is not None and tolerance is None:
        method = _limited(method, memory)
    if events is not None or modes is not None or free_end:
        what = "design with t_end" if free_end else "events"
        _require_alone(what, after=after)
        if tolerance is not None:
            _require_alone("tolerance", integrator=integrator, memory=memory)
            from ancfdae.studies.accuracy.event_search import event_gradients_within

            parts = system, t_end, events or (), modes
            return event_gradients_within(
                parts, objectives, tolerance, (design, free_end), method, progress
            )
        from ancfdae.events.calls import EventRun
        from ancfdae.studies.events import gradients as gradients_with_events

        made = EventRun.of(
            system, t_end, integrator, events or (), modes, design, progress, free_end
        )
        return gradients_with_events(made, objectives, method)
    if tolerance is not None:
        _require_alone("tolerance", integrator=integrator, memory=memory, after=after)
        from ancfdae.studies.accuracy.search import gradients_within

        return gradients_within(system, objectives, t_end, tolerance, method, progress)
    if method is None:
        adjoint = isinstance(integrator, AdjointIntegrator)
        method = cheapest(system.n_b, len(objectives)) if adjoint else DirectDifferentiation()
    require_kind(
        "method", method, (GradientMethod,), "For example Adjoint() or DirectDifferentiation()."
    )
    run = Run(system, t_end, cast("Integrator", integrator), progress, after)
    try:
        found = method.gradients(run, objectives)
    except UnfinishedRunError as error:
        raise UnfinishedRunError(with_remedies(model, run, error.solution)) from error
    solution = found[0].solution
    if not _is_off(system, solution, 4) and system.traits.slender:
        some = np.linspace(0, len(solution.q) - 1, 1 + _FEW_LOOKS).round().astype(int)[1:]
        warn_of_mesh("gradient", system, solution.q[some], stacklevel=4, moving=True)
    return found


def _limited(method: GradientMethod | None, memory: str | float) -> Adjoint:
    """Return the adjoint method within a limit of memory, if given, otherwise the method."""
    if method is not None:
        rule, repair = "limits the adjoint method only", "Write method=Adjoint(memory=...)."
        raise InvalidInputError("memory", rule, f"method={method!r} too", repair)
    return Adjoint(memory)


def _require_alone(where: str, **others: object) -> None:
    """Raise InvalidInputError if one of the arguments `others` is given together with `where`."""
    for name, given in others.items():
        if given is not None:
            repair = "A tolerance chooses its own runs." if where == "tolerance" else ""
            raise InvalidInputError(where, f"must be given without `{name}`", "both", repair)


@in_one_thread
def evaluate(
    objective: Objective,
    solution: Solution | EventSolution,
    model: Scene | MechanicalSystem,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    modes: Mapping[str, Mode] | None = None,
) -> float:
    """Return the value of an objective on a finished run; `observe` is for observables.

    Integrals are quadratures over the time points of the solution; in `gradient` without events
    IDA, IDAS and DOP853 integrate them with the motion, which differs within their tolerance.

    Parameters
    ----------
    objective : Objective
    solution : Solution or EventSolution
        A finished run, from a call or a file; `gradient` with ``after=solution`` differentiates one
        without events.
    model, design
        The model that was run, as in `gradient`.
    modes : mapping of str to Mode, optional
        The modes that a run with events passed, as in `simulate`.
    """
    kinds = Solution, EventSolution
    require_kind("solution", solution, kinds, "Call simulate, or load_solution.")
    system = as_system(model, design)
    t_end = float(solution.t[-1])
    require_objectives(system, [objective], t_end)
    if isinstance(solution, EventSolution):
        from ancfdae.studies.events import evaluated

        return evaluated(objective, solution, system, modes, design)
    if modes is not None:
        rule = "must be left out for a run without events"
        repair = "Call evaluate(objective, solution, model)."
        raise InvalidInputError("modes", rule, repr(modes), repair)
    from ancfdae.integrators.problem import InitialValueProblem

    InitialValueProblem.of(system, t_end).require_run(solution, t_end, "solution")
    if not solution.outcome.success:
        raise UnfinishedRunError(solution)
    return float(objective.value(system, states_of(solution)))


def require_objectives(
    system: MechanicalSystem, objectives: Sequence[Objective], t_end: float
) -> None:
    """Raise InvalidInputError for objectives that a run of this system cannot have."""
    require_positive("t_end", t_end)
    repair = "Wrap an observable in Integral, Terminal, AtTimes, SmoothMaximum or SmoothUpperBound."
    if not objectives:
        raise InvalidInputError("objectives", "must be one or more", "none", repair)
    for objective in objectives:
        require_kind("objective", objective, (Objective,), repair)
    for objective in objectives:
        objective.check(system, t_end)


def cheapest(variables: int, objectives: int) -> GradientMethod:
    """Return direct differentiation or the discrete adjoint, whichever costs less.

    Both factorise once per step; direct differentiation then solves for every variable, the adjoint
    repeats its backward pass for every objective. Measured on the crank-slider, direct
    differentiation costs less than a backward pass up to two variables; from there to six the two
    differ by a few per cent of the cost of the run (report `performance`).
    """
    return DirectDifferentiation() if variables <= 2 * objectives else Adjoint()


def differentiable(
    model: Scene | MechanicalSystem, design: Sequence[str | DesignVariable] | None
) -> MechanicalSystem:
    """Return the system of a model; InvalidInputError if it has no design variables."""
    system = as_system(model, design)
    if not system.n_b:
        raise InvalidInputError(
            "design",
            "must name one or more variables to differentiate in",
            "none",
            'For a scene write design=["rod.height"]; a mechanical system needs design_names.',
        )
    return system


def without_end(
    design: Sequence[str | DesignVariable] | None,
) -> tuple[Sequence[str | DesignVariable] | None, bool]:
    """Return a design without the end time ``"t_end"``, and whether it was there."""
    if not isinstance(design, (list, tuple)) or "t_end" not in design:
        return design, False
    return [variable for variable in design if variable != "t_end"] or None, True


def design_bounds(
    system: MechanicalSystem, design: Sequence[str | DesignVariable] | None
) -> tuple[Array, Array]:
    """Return lower and upper bounds of the design values, (n_b,) each; infinite if undeclared."""
    known = {x.name: x.bounds for x in design or () if isinstance(x, DesignVariable)}
    pairs = [known.get(name) or (-np.inf, np.inf) for name in system.design_names]
    lower, upper = np.array(pairs, dtype=float).reshape(-1, 2).T
    return lower, upper


def as_system(
    model: Scene | MechanicalSystem, design: Sequence[str | DesignVariable] | None = None
) -> MechanicalSystem:
    """Return the mechanical system of a scene, or a system itself.

    InvalidInputError for design variables with a system, which has its own.
    """
    if isinstance(model, Scene):
        return assemble(model, () if design is None else design)
    require_kind("model", model, (Scene, MechanicalSystem), "Pass one of them.")
    if design is not None and require_sequence("design", design):
        rule = "must be left out for a system, which has its own design variables"
        raise InvalidInputError("design", rule, repr(design))
    return model
