"""Events that a run may meet: impacts, switches to another model, and its end."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import (
    require_each,
    require_finite,
    require_kind,
    require_text,
    require_unique,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.scene import Scene
from ancfdae.sensitivity.observables.observable import Observable


class Event(abc.ABC):
    """A function of the motion whose zero ends a phase of a run.

    `direction` says which zeros count: 1 where the function rises through zero, -1 where it falls,
    0 for both. `leads_to` are names of modes that the run may continue with.
    """

    name: str

    @property
    @abc.abstractmethod
    def crossing(self) -> tuple[Observable, int]:
        """The function, and the direction in which it crosses zero."""

    @property
    def leads_to(self) -> tuple[str, ...]:
        """Names of the modes that the run may continue with; none if it stays in its mode."""
        return ()


def _require(event: Event) -> None:
    """Refuse an event without a function of the motion, a direction or a name."""
    where, (function, direction) = type(event).__name__, event.crossing
    repair = "For example position(ball.origin, 1) - 0.1, or custom(function)."
    require_kind(f"{where}, function of the event", function, (Observable,), repair)
    require_text(f"{where}.name", event.name)
    if direction not in (-1, 0, 1):
        rule, repair = "must be -1, 0 or 1", "0 counts every zero."
        raise InvalidInputError(f"{where}.direction", rule, repr(direction), repair)


@final
@dataclass(frozen=True, eq=False)
class EndEvent(Event):
    """The run ends where an observable becomes zero.

    Parameters
    ----------
    function : Observable
        For example ``position(slider.origin, 0) - 1.2``.
    direction : int
        1: the zero counts where the function rises, -1: where it falls, 0: in both cases.
    name : str
        Name of the event in `EventSolution.events` and in messages.
    """

    function: Observable
    direction: int = 0
    name: str = "end"

    def __post_init__(self) -> None:
        _require(self)

    @property
    def crossing(self) -> tuple[Observable, int]:
        """The function, and the direction in which it crosses zero."""
        return self.function, self.direction


@final
@dataclass(frozen=True, eq=False)
class Switch(Event):
    """The run continues with another model from where an observable becomes zero.

    Joints that the other model adds take an impulse where velocities do not satisfy them: the new
    velocities are the nearest ones in the metric of the mass matrix, as at every projected start.
    Joints that it lacks are released.

    Parameters
    ----------
    function : Observable
        For example ``multiplier("latch", 0)``.
    to : str
        Name of the mode, among the `modes` of the call, that the run continues with; ``"start"`` is
        the model that the run began with.
    direction : int
        As in `EndEvent`.
    name : str
        Name of the event in `EventSolution.events` and in messages.
    """

    function: Observable
    to: str
    direction: int = 0
    name: str = "switch"

    def __post_init__(self) -> None:
        _require(self)
        require_text("Switch.to", self.to)

    @property
    def crossing(self) -> tuple[Observable, int]:
        """The function, and the direction in which it crosses zero."""
        return self.function, self.direction

    @property
    def leads_to(self) -> tuple[str, ...]:
        """The mode that the run continues with."""
        return (self.to,)


@final
@dataclass(frozen=True, eq=False)
class Impact(Event):
    """Bodies collide where a gap closes (Newton's law of impact).

    With the gap g(q, t, b), its rate u = dg/dt and the restitution e, velocities jump by

        M (v+ - v-) + Phi_q^T mu = g_q^T P,   Phi_q v+ = nu,   u+ = -e u-,

    where P is the impulse. Gaps that close at the same time share one system of equations.

    Parameters
    ----------
    gap : Observable
        Distance of the bodies, positive where they are apart; a function of positions, time and
        design, for example ``position(ball.origin, 1) - 0.1``.
    restitution : float or Observable
        e, from 0 on; dimensionless. An observable may depend on the motion before the impact and on
        the design, for example ``design_value(name)``.
    name : str
        Name of the event in `EventSolution.events` and in messages.
    rest : str, optional
        Name of the mode that the run continues with where impacts follow each other within 1e-8 of
        the duration of the run: with a joint that keeps the gap closed. Without it the run ends
        there, and its outcome says so.
    """

    gap: Observable
    restitution: float | Observable = 1.0
    name: str = "impact"
    rest: str | None = None

    def __post_init__(self) -> None:
        _require(self)
        e = self.restitution
        if not isinstance(e, Observable):
            require_finite("Impact.restitution", e)
            if e < 0:
                rule, repair = "must not be negative", "0 keeps bodies together, 1 loses no energy."
                raise InvalidInputError("Impact.restitution", rule, e, repair)
        if self.rest is not None:
            require_text("Impact.rest", self.rest)

    @property
    def crossing(self) -> tuple[Observable, int]:
        """The gap, which falls through zero."""
        return self.gap, -1

    @property
    def leads_to(self) -> tuple[str, ...]:
        """The mode in which the gap stays closed, if there is one."""
        return () if self.rest is None else (self.rest,)


@final
@dataclass(frozen=True, eq=False)
class Mode:
    """A model with the events that count while the run is on it.

    All modes of a run have the same bodies in the same order, so that they have the same
    coordinates, and the same design variables. They differ in joints, loads and laws.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    events : sequence of Event
    """

    model: Scene | MechanicalSystem
    events: Sequence[Event] = ()

    def __post_init__(self) -> None:
        require_kind("Mode.model", self.model, (Scene, MechanicalSystem), "Pass one of them.")
        object.__setattr__(self, "events", require_events(self.events))


class ModeSystem(NamedTuple):
    """A mode of a run: its name, its system, and its events."""

    name: str
    system: MechanicalSystem
    events: tuple[Event, ...]


def require_events(events: object) -> tuple[Event, ...]:
    """Return events as a tuple; refuse other things, and two of one name."""
    given = require_each("events", events, (Event,), "Pass Impact, EndEvent or Switch.")
    names = [event.name for event in given]
    require_unique("events", "must have different names", names, "Write name=...")
    return given
