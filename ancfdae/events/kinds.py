"""Events of a run: impacts, switches to another model, and the end of the run."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, final

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import (
    require_each,
    require_kind,
    require_not_negative,
    require_text,
    require_unique,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.scene import Scene
from ancfdae.sensitivity.observables.observable import Observable


class Event(abc.ABC):
    """A function of the motion whose zero ends a phase of a run.

    Subclasses have a `name`, and define `crossing` and `leads_to`.
    """

    name: str

    @property
    @abc.abstractmethod
    def crossing(self) -> tuple[Observable, int]:
        """The function, and the direction of its zeros: 1 rising, -1 falling, 0 both."""

    @property
    def leads_to(self) -> tuple[str, ...]:
        """Names of the modes that the run may continue with; none if it stays in its mode."""
        return ()


def _require(event: Event) -> None:
    """Raise InvalidInputError unless an event has a function, a direction and a name."""
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
    """An event that ends the run where an observable becomes zero.

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
        """The function, and the direction of its zeros: 1 rising, -1 falling, 0 both."""
        return self.function, self.direction


@final
@dataclass(frozen=True, eq=False)
class Switch(Event):
    """An event after which the run continues with another model, where an observable becomes zero.

    Joints that the other model adds take an impulse where velocities do not satisfy them: the new
    velocities are the nearest ones in the metric of the mass matrix, as at every projected start.
    Joints that it lacks are released.

    Parameters
    ----------
    function : Observable
        For example ``multiplier("latch", 0)``.
    to : str
        Name of the mode, among the `modes` of the call, with which the run continues; ``"start"``
        is the model with which the run began.
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
        """The function, and the direction of its zeros: 1 rising, -1 falling, 0 both."""
        return self.function, self.direction

    @property
    def leads_to(self) -> tuple[str, ...]:
        """Name of the mode with which the run continues, as a tuple."""
        return (self.to,)


class ImpactLaw(Enum):
    """Laws of restitution of impacts.

    NEWTON relates the rates of a gap before and after an impact, u+ = -e u-. POISSON relates
    impulses: bodies are compressed until gaps do not close any more, and the expansion adds at
    least e times the impulse of the compression (Ch. Glocker and F. Pfeiffer, Multiple impacts with
    friction in rigid multibody systems, Nonlinear Dynamics 7, 1995).
    """

    NEWTON = "Newton's law"
    POISSON = "Poisson's law"


@final
@dataclass(frozen=True)
class RestModes:
    """Modes that a run may continue with where a gap with friction stays closed.

    Parameters
    ----------
    sticks : str, optional
        Name of the mode if the bodies stick together in the last impact.
    forward, backward : str, optional
        Names of the modes if they slide in it, with a positive or negative sliding velocity; with a
        cone of friction `forward` for all directions.
    """

    sticks: str | None = None
    forward: str | None = None
    backward: str | None = None

    def __post_init__(self) -> None:
        for field in ("sticks", "forward", "backward"):
            if getattr(self, field) is not None:
                require_text(f"RestModes.{field}", getattr(self, field))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the modes in which the gap stays closed."""
        return tuple(x for x in (self.sticks, self.forward, self.backward) if x is not None)

    def after(self, slides: float) -> str | None:
        """Return the mode after an impact whose sliding velocity has this sign; 0 for sticking."""
        if slides == 0:
            return self.sticks
        return self.forward if slides > 0 else self.backward


@final
@dataclass(frozen=True, eq=False)
class Impact(Event):
    """Bodies collide where a gap closes.

    With the gap g(q, t, b), its rate u = dg/dt, the sliding velocity s of the contact points and
    the restitution e, velocities jump by

        M (v+ - v-) + Phi_q^T mu = g_q^T P + s_v^T T,   Phi_q v+ = nu,   u+ = -e u-,
        |T| <= friction * P,   T = -friction * P * s+/|s+| where s+ is not zero.

    P is the impulse along the normal, and T along the line or in the plane of sliding. Gaps that
    close at the same time share one system of equations; with friction or by Poisson's law all
    closed gaps do.

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
    rest : str or RestModes, optional
        Name of the mode that the run continues with where impacts follow each other within 1e-8 of
        the duration of the run: with a joint that keeps the gap closed. Without it the run ends
        there, and its outcome says so. With friction `RestModes` names one mode for sticking and
        one for each direction of sliding.
    friction : float or Observable
        Coefficient of Coulomb's friction in the impact, from 0 on; dimensionless. An observable is
        taken in the state before the impact, as the restitution.
    sliding : Observable or pair of Observable, optional
        Velocity of one contact point relative to the other along the surface, linear in the
        velocities, for example ``velocity(ball.at(0, -0.1), 0)``. Friction needs it. In space two
        of them, along lines at a right angle, give a cone of friction; one gives a guide.
    law : ImpactLaw
        Law of restitution.
    """

    gap: Observable
    restitution: float | Observable = 1.0
    name: str = "impact"
    rest: str | RestModes | None = None
    friction: float | Observable = 0.0
    sliding: Observable | tuple[Observable, Observable] | None = None
    law: ImpactLaw = ImpactLaw.NEWTON

    def __post_init__(self) -> None:
        _require(self)
        for field, repair in (
            ("restitution", "0 keeps bodies together, 1 loses no energy."),
            ("friction", "0 is no friction."),
        ):
            value = getattr(self, field)
            if not isinstance(value, Observable):
                require_not_negative(f"Impact.{field}", value, repair)
        require_kind("Impact.law", self.law, (ImpactLaw,), "Use ImpactLaw.NEWTON or POISSON.")
        for line in self.lines:
            repair = "For example velocity(point, 0), or a pair of them in space."
            require_kind("Impact.sliding", line, (Observable,), repair)
        if len(self.lines) > 2:
            rule, repair = "must be one observable or two", "A surface has two directions."
            raise InvalidInputError("Impact.sliding", rule, len(self.lines), repair)
        if self.is_rough != (len(self.lines) > 0):
            rule = "must be given together with a friction coefficient above zero"
            got = "friction without it" if self.is_rough else "no friction"
            raise InvalidInputError("Impact.sliding", rule, got, "For example velocity(point, 0).")
        if isinstance(self.rest, RestModes):
            for mode in self.rest.names:
                require_text("Impact.rest", mode)
        elif self.rest is not None:
            require_text("Impact.rest", self.rest)

    @property
    def crossing(self) -> tuple[Observable, int]:
        """The gap, and -1, because an impact happens where the gap falls through zero."""
        return self.gap, -1

    @property
    def leads_to(self) -> tuple[str, ...]:
        """Names of the modes in which the gap stays closed; empty without any."""
        if isinstance(self.rest, RestModes):
            return self.rest.names
        return () if self.rest is None else (self.rest,)

    @property
    def lines(self) -> tuple[Observable, ...]:
        """The velocities of sliding: none, one along a line, two in a plane."""
        if self.sliding is None:
            return ()
        return self.sliding if isinstance(self.sliding, tuple) else (self.sliding,)

    @property
    def is_rough(self) -> bool:
        """Whether friction acts in the impact."""
        return isinstance(self.friction, Observable) or self.friction > 0

    @property
    def takes_all(self) -> bool:
        """Whether all closed gaps take part in the impact, even those that are not closing."""
        return self.is_rough or self.law is ImpactLaw.POISSON

    def rest_after(self, slides: float) -> str | None:
        """Return the mode in which the gap stays closed after an impact; None without one."""
        return self.rest.after(slides) if isinstance(self.rest, RestModes) else self.rest


@final
@dataclass(frozen=True, eq=False)
class Mode:
    """A model with the events that apply while the run is in this mode.

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
    """A mode of a run: its name, its assembled system, and its events."""

    name: str
    system: MechanicalSystem
    events: tuple[Event, ...]


def require_events(events: object) -> tuple[Event, ...]:
    """Return events as a tuple; raise InvalidInputError for other objects or equal names."""
    given = require_each("events", events, (Event,), "Pass Impact, EndEvent or Switch.")
    names = [event.name for event in given]
    require_unique("events", "must have different names", names, "Write name=...")
    return given
