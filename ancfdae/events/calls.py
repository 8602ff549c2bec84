"""Calls of a user with events: solutions, their derivatives, and gradients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from ancfdae.assembly.system import assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.complex_steps import at_values
from ancfdae.equations.event_solution import START, EventRecord, EventSolution, at_held_times
from ancfdae.errors.checks import require_flag, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.events.adjoint import PhaseAdjoint, states_in
from ancfdae.events.derivatives import (
    PhaseDerivatives,
    differentiated,
    require_one_time,
)
from ancfdae.events.kinds import Event, Impact, Mode, ModeSystem, require_events
from ancfdae.events.objectives import (
    FollowedObjective,
    PhasePartials,
    PhaseStates,
    require_reductions,
    value_of,
)
from ancfdae.events.perturbed import at_complex
from ancfdae.events.phases import Beginning, Jump, Phase, PhasedRun
from ancfdae.events.run import PhaseMarch
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.step_control import AdaptiveSteps, PrescribedSteps
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation, size_of
from ancfdae.sensitivity.method import GradientMethod, Run
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.perturbation import ComplexStep, FiniteDifference, Perturbation

#: Name of the end time as a design variable.
END = "t_end"


@final
@dataclass(frozen=True)
class EventRun:
    """Instructions for a run with events: assembled modes, end time, s, and integrator.

    It begins in the first mode. If `free_end` is true the end time is the last design variable.
    """

    modes: Mapping[str, ModeSystem]
    t_end: float
    integrator: Integrator
    progress: bool = False
    free_end: bool = False

    @staticmethod
    def of(
        system: MechanicalSystem,
        t_end: float,
        integrator: object,
        events: object,
        modes: Mapping[str, Mode] | None,
        design: Sequence[str | DesignVariable] | None,
        progress: bool,
        free_end: bool = False,
    ) -> EventRun:
        """Return the run after checking the arguments of a call and assembling its modes."""
        require_positive("t_end", t_end)
        require_flag("progress", progress)
        require_kind("integrator", integrator, (Integrator,), "For example HHT(step=0.01).")
        assert isinstance(integrator, Integrator)
        steps = integrator.steps if isinstance(integrator, SteppedIntegrator) else None
        if isinstance(steps, PrescribedSteps):
            rule = "must choose steps itself with events, or with t_end in the design"
            repair = "Give HHT(step=...) or HHT(rtol=...)."
            raise InvalidInputError("integrator.steps", rule, repr(steps), repair)
        if isinstance(steps, AdaptiveSteps) and steps.sensitivities:
            rule = (
                "must control errors of the motion alone with events, or with t_end in the design"
            )
            repair = "Leave out sensitivities=True, and compare with a smaller rtol."
            raise InvalidInputError("integrator.steps", rule, repr(steps), repair)
        known = {START: ModeSystem(START, system.in_all_states(), require_events(events))}
        require_kind("modes", modes or {}, (Mapping,), 'For example {"closed": Mode(scene)}.')
        if START in (modes or {}):
            rule = f"must not name a mode {START!r}, the model that the run begins with"
            raise InvalidInputError("modes", rule, repr(START), "Give that mode another name.")
        for name, mode in (modes or {}).items():
            require_kind(f"modes[{name!r}]", mode, (Mode,), "For example Mode(scene, events).")
            whole = assembled(mode.model, design).in_all_states()
            known[name] = ModeSystem(name, whole, tuple(mode.events))
        for name, each in known.items():
            _require_mode(name, each, system, known)
        return EventRun(known, float(t_end), integrator, progress, free_end)

    @property
    def system(self) -> MechanicalSystem:
        """The system of the mode in which the run begins."""
        return self.modes[START].system

    @property
    def b(self) -> Array:
        """Design values, (n_b,), followed by the end time if it is a design variable."""
        return np.append(self.system.b, self.t_end) if self.free_end else self.system.b

    @property
    def design_names(self) -> tuple[str, ...]:
        """Names of the design variables, with "t_end" last if the end time is one of them."""
        return (*self.system.design_names, *((END,) if self.free_end else ()))

    @in_one_thread
    def phased(
        self,
        begins: Beginning | None = None,
        thin: Callable[[Phase], Phase] | None = None,
    ) -> PhasedRun:
        """Integrate all phases, from the start or from where an earlier run ended.

        The run keeps what `thin` returns of each phase.
        """
        march = PhaseMarch(self.modes, self.t_end, self.integrator, thin)
        return march.run(self.modes[START], self.progress, begins)

    def at(self, b: Array) -> EventRun:
        """Return the same run with events at other design values b, shape (n_b,)."""
        t_end = float(b[-1]) if self.free_end else self.t_end
        require_positive(END, t_end)
        own = b[: self.system.n_b]
        moved = {
            name: mode._replace(system=at_values(mode.system, own))
            for name, mode in self.modes.items()
        }
        return replace(self, modes=moved, t_end=t_end, progress=False)

    @in_one_thread
    def differentiated(self, run: PhasedRun) -> EventSolution:
        """Return the solution of a finished run with its design derivatives."""
        done, phases = differentiated(run)
        return solution(done, phases)

    @in_one_thread
    def gradients(
        self, objectives: Sequence[Objective], method: GradientMethod
    ) -> tuple[PhasedRun, list[tuple[float, Array]]]:
        """Integrate; return the run, and values and gradients of objectives if it is finished."""
        require_reductions(objectives)
        if isinstance(method, Adjoint):
            return self._adjoint(objectives, method)
        run = self.phased()
        if not run.outcome.success:
            return run, []
        if isinstance(method, DirectDifferentiation):
            return run, self._direct(run, objectives)
        if isinstance(method, ComplexStep | FiniteDifference):
            if isinstance(method, ComplexStep):
                require_one_time(run, run.phases)
            return run, self._perturbed(run, objectives, method)
        raise InvalidInputError(
            "method",
            "must be one that differentiates runs with events",
            repr(method),
            "Use DirectDifferentiation(), Adjoint(), ComplexStep() or FiniteDifference().",
        )

    def _direct(self, run: PhasedRun, objectives: Sequence[Objective]) -> list[tuple[float, Array]]:
        done, phases = differentiated(run)
        states, results = states_of(done), []
        for objective in objectives:
            followed = FollowedObjective.along(objective, states)
            value = followed.close()
            partials = [followed.partials(k, phase) for k, phase in enumerate(states)]
            pairs = zip(partials, phases, strict=True)
            slopes = np.sum([_total(p, x) for p, x in pairs], axis=0)
            in_end = partials[-1].along(phases[-1].in_duration) if self.free_end else 0.0
            results.append((value, self._with_end(slopes, in_end)))
        return results

    def _with_end(self, slopes: Array, in_end: float) -> Array:
        """Append the derivative in the end time, if that is variable, to a gradient, (n_b,)."""
        return np.append(slopes, in_end) if self.free_end else slopes

    def _adjoint(
        self, objectives: Sequence[Objective], method: Adjoint
    ) -> tuple[PhasedRun, list[tuple[float, Array]]]:
        if not isinstance(self.integrator, SteppedIntegrator):
            rule = "needs HHT or Radau with events, or with t_end in the design"
            repair = "Take one of them, or DirectDifferentiation()."
            raise InvalidInputError("Adjoint", rule, repr(self.integrator), repair)
        memory = np.inf if method.memory is None else size_of(method.memory)
        adjoint = PhaseAdjoint(objectives, memory)
        run = self.phased(thin=adjoint.leave)
        if not run.outcome.success:
            return run, []
        found = adjoint.gradients(run)
        return run, [(value, self._with_end(slopes, in_end)) for value, slopes, in_end in found]

    def _perturbed(
        self, run: PhasedRun, objectives: Sequence[Objective], method: Perturbation
    ) -> list[tuple[float, Array]]:
        method.check(Run(self.system, self.t_end, self.integrator))
        base = self._values(objectives, states_of(run))
        b, n = self.b, self.system.n_b
        slopes = np.zeros((len(objectives), len(b)))
        sizes = np.append(method.sizes_of(self.system), b[n:])
        for i, size in enumerate(sizes.tolist()):
            unit = np.eye(len(b))[i]
            moved = []
            for change in method.changes(size):
                if isinstance(method, ComplexStep):
                    at = b + change * unit
                    phases = at_complex(run, at[:n], float(np.sum(at[n:].imag)))
                else:
                    phases = states_of(self.at(b + np.real(change) * unit).phased())
                moved.append(self._values(objectives, phases))
            slopes[:, i] = method.quotient(size, base, moved)
        return [(float(value.real), slope) for value, slope in zip(base, slopes, strict=True)]

    def _values(self, objectives: Sequence[Objective], phases: Sequence[PhaseStates]) -> Array:
        values = np.array([value_of(each, phases) for each in objectives])
        return values if np.any(values.imag) else values.real


def states_of(run: PhasedRun) -> list[PhaseStates]:
    """Return the states of all phases of a run."""
    return [states_in(phase) for phase in run.phases]


def solution(run: PhasedRun, derivatives: Sequence[PhaseDerivatives] = ()) -> EventSolution:
    """Return the solution of a run as users get it, with derivatives of its phases if given."""
    phases, records = [], []
    if run.before is not None:
        records += _records(run.before, 0.0, None)
    for k, phase in enumerate(run.phases):
        known = derivatives[k] if derivatives else None
        if known is None:
            phases.append(replace(phase.run, t=phase.times))
        else:
            phases.append(at_held_times(phase.run, phase.times, known.states, known.t_b))
        if phase.jump is not None:
            records += _records(phase.jump, phase.t_end, known)
        elif phase.event is not None:
            records.append(EventRecord(phase.event.name, phase.t_end, phase.mode.name))
    return EventSolution(tuple(phases), tuple(records), run.outcome)


def _records(jump: Jump, time: float, known: PhaseDerivatives | None) -> list[EventRecord]:
    """Return the event records of all events that happen at one time."""
    records, pushing, time_b = [], set[Event](), None if known is None else known.t_b[-1]
    for k, strike in enumerate(jump.strikes):
        found, name = strike.struck.after.impulses.real, jump.mode.name
        slopes_b = None if known is None else known.strikes_b[k]
        for impact, normal, along in strike.struck.impulses():
            pushing.add(impact)
            P, T = float(found[normal]), _in_directions(found, along)
            if slopes_b is None:
                records.append(EventRecord(impact.name, time, name, P, sliding_impulse=T))
                continue
            P_b, T_b = slopes_b[1][normal], _in_directions(slopes_b[1], along)
            records.append(EventRecord(impact.name, time, name, P, slopes_b[0], P_b, T, T_b))
    others = [x for x in jump.events if x not in pushing]
    records += [EventRecord(x.name, time, jump.mode.name, None, time_b) for x in others]
    return records


def _in_directions(found: Array, places: list[int]) -> Any:
    """Return the entries of friction impulses: None, of one line, or of both lines of a cone."""
    if len(places) == 1:
        return found[places[0]].tolist() if found.ndim == 1 else found[places[0]]
    return found[places] if places else None


def _total(p: PhasePartials, x: PhaseDerivatives) -> Array:
    """Return the contribution of a phase to the gradient of an objective, (n_b,)."""
    total = p.b + p.start * x.start_b + p.duration * x.duration_b
    for rows, x_b in ((p.q, x.states.q_b), (p.v, x.states.v_b), (p.lam, x.states.lam_b)):
        if rows is not None:
            total = total + np.tensordot(rows, x_b, axes=2)
    return np.asarray(total)


def assembled(
    model: Scene | MechanicalSystem, design: Sequence[str | DesignVariable] | None
) -> MechanicalSystem:
    """Return the system of the model of a mode."""
    if isinstance(model, Scene):
        model = assemble(model, () if design is None else design)
    return model


def _require_mode(
    name: str, mode: ModeSystem, first: MechanicalSystem, known: Mapping[str, ModeSystem]
) -> None:
    """Raise unless a mode has the coordinates, design and events that the run needs."""
    system, where = mode.system, f"modes[{name!r}]"
    ours, theirs = ((x.n_q, x.design_names) for x in (first, system))
    rule = "must have the coordinates and the design of the model that the run begins with"
    if ours != theirs:
        got = f"{system.n_q} coordinates, design {system.design_names}"
        raise InvalidInputError(where, rule, got, "Declare the same bodies in the same order.")
    for design, ours_b, theirs_b in zip(first.design_names, first.b, system.b, strict=True):
        if ours_b != theirs_b:
            got = f"{theirs_b:.6g} in place of {ours_b:.6g} for design variable {design!r}"
            repair = "A number that a mode changes cannot be a design variable."
            raise InvalidInputError(where, rule, got, repair)
    names, others = (x.naming.coordinate_names() if x.naming else [] for x in (first, system))
    for number, (name, other) in enumerate(zip(names, others, strict=False)):
        if name != other:
            got = f"{other!r} in place of {name!r} at place {number}"
            repair = "Declare the same bodies and the same controllers, by name, in the same order."
            raise InvalidInputError(where, rule, got, repair)
    for event in mode.events:
        event.crossing[0].check(system)
        for line in event.lines if isinstance(event, Impact) else ():
            line.check(system)
        if event.crossing[0].remembers_any:
            rule = "must follow from one state"
            got = "one that counts turns, as slope_angle does"
            repair = "Take slope(...) or custom(...), which have the same zeros."
            raise InvalidInputError(f"function of event {event.name!r}", rule, got, repair)
        for target in event.leads_to:
            if target not in known:
                raise UnknownNameError(f"mode that {event.name!r} leads to", target, list(known))
