"""Massless rope over pulleys: tension by stiffness and damping, capstan friction, a winch.

The rope runs from its start over pulleys to its end, along common tangents of circles and arcs on
them. Its unstretched length follows a law of time. With friction the tensions at both sides of a
pulley differ by exp(mu phi) at most (docs/theory/20-cables.md).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Self, TypeAlias, final

import numpy as np

from ancfdae.errors.checks import (
    require_count,
    require_direction,
    require_each,
    require_flag,
    require_not_negative,
    require_positive,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.loads.contact_law import moving_with, on_body
from ancfdae.model.loads.load import LAW_FIELD, Load, require_damping
from ancfdae.model.loads.sections import QUARTER_TURN
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import angle, concatenate, cross, dot, positive

# Largest motion of a point in a step, over the shortest tangent, without checks within the step.
# Otherwise points of the step are checked, _FINE of them on the way of a radius of the smallest
# pulley, so that a chord between two lies within 1/512 of the radius below its surface. _PLACES are
# the fewest and the most of them.
_LONG, _FINE, _PLACES = 0.1, 8, (33, 4096)
# Squared length of a tangent, over the squared distance of the centres, that counts as zero.
_LEAST = 1e-12
# Strain at which a rope counts as taut: a rope of its unstretched length, as by default at the
# start, is taut in every derivative, whatever the round-off of its length.
_JUST_TAUT = 2.0**-46

# : A point of a body, or a position on the ground.
Place: TypeAlias = MaterialPoint | Sequence[float]


def _require_place(where: str, value: object) -> None:
    """Raise InvalidInputError unless a value is a material point or a position."""
    if not isinstance(value, MaterialPoint):
        require_vector(where, value, (2, 3))


@final
@dataclass(frozen=True)
class Pulley:
    """A pulley, sheave, drum or bollard that a `Rope` runs over.

    Without friction the rope runs freely whether the pulley rotates or not, and `centre` is a point
    of the body that carries the pulley. With friction `centre` is a point of the body that the rope
    drags along: a wheel on a revolute joint, whose inertia counts, or a drum that does not rotate.

    Parameters
    ----------
    centre : MaterialPoint or sequence of float
        A point of a body, or a position on the ground; m. With friction, or in space, the body must
        be rigid.
    radius : float
        Distance from the centre to the middle of the rope; zero is a ring; m.
    clockwise : bool, optional
        Whether the rope passes clockwise around the centre on its way from start to end, in space
        seen against `axis`; by default counterclockwise.
    axis : sequence of float, optional
        In space: axis in the reference configuration, which rotates with the body; its length has
        no effect (dimensionless).
    friction : float, optional
        Coefficient of friction mu, not negative; dimensionless.
    turns : int, optional
        Whole turns around the pulley beyond the angle between the spans.
    """

    centre: Place
    radius: float
    clockwise: bool = False
    axis: Sequence[float] | None = None
    friction: float | None = None
    turns: int = 0

    def __post_init__(self) -> None:
        _require_place("Pulley, centre", self.centre)
        require_not_negative("Pulley, radius", self.radius)
        require_flag("Pulley, clockwise", self.clockwise)
        if self.axis is not None:
            require_direction("Pulley, axis", self.axis)
        if self.friction is not None:
            require_not_negative("Pulley, friction", self.friction)
        if self.turns != 0:
            require_count("Pulley, turns", self.turns, "Give the number of whole turns.")

    def numbers(self, k: int) -> dict[str, float]:
        """Return the design numbers of the k-th pulley of a rope, by target name."""
        of_friction = {} if self.friction is None else {f"friction[{k}]": self.friction}
        return {f"radius[{k}]": float(self.radius), **of_friction}

    def with_numbers(self, values: Iterator[float]) -> Self:
        """Return the same pulley with its `numbers` taken from the iterator `values`."""
        radius = next(values)
        return replace(
            self, radius=radius, friction=None if self.friction is None else next(values)
        )


class _Station(NamedTuple):
    """A point that the rope passes: centre, axes of its body, and their rates.

    In the formulas of a rope numbers have the shape (..., 1, 1), and vectors (..., 1, d).
    """

    U: Any  # (..., 1 + n_axes, d)
    V: Any
    radius: Any  # positive where the rope passes counterclockwise
    axis: Any  # None in the plane
    drags: bool  # whether the rope pulls at the surface and not at the centre

    def speed(self, arm: Any) -> Any:
        """Return the velocity of the point that the rope pulls at; m/s."""
        return moving_with(self.U, self.V, arm)[1] if self.drags else self.V[..., :1, :]

    def pulled(self, F: Any, arm: Any) -> Any:
        """Return the forces on a station's vectors from a rope force F at an arm or the centre."""
        if self.drags:
            return on_body(F, moving_with(self.U, self.V, arm)[0])
        return concatenate([F, 0.0 * self.U[..., 1:, :]]) if self.U.shape[-2] > 1 else F


class _Span(NamedTuple):
    """The straight part of a rope between two stations."""

    length: Any
    u: Any  # unit direction from the first station to the second
    tangents: tuple[Any, Any]  # directions of the rope in the planes of both stations
    arms: tuple[Any, Any]  # vectors from their centres to where the rope leaves and arrives
    rate: Any  # rate of the distance between the points of the bodies that the rope pulls at


class _Reeving(NamedTuple):
    """Path of a rope: its spans, wrapped angles, and total length."""

    spans: list[_Span]
    angles: list[Any]
    length: Any


def _require_pulleys(where: str, value: object) -> None:
    """Raise InvalidInputError unless all entries of a sequence are `Pulley` objects."""
    require_each(where, value, (Pulley,), "Give a Pulley.")


@final
@dataclass(frozen=True)
class Rope(Load):
    """A massless elastic rope from a start point over pulleys to an end point.

    With the length L along tangents and arcs, the unstretched length l = length + payout(t) and
    the strain e = L/l - 1 the tension is EA e + c e', and never negative. Over pulleys with
    friction it changes by exp(mu phi tanh(w / w_0)), with the wrapped angle phi and the speed w at
    which the rope slips forward. There is no sticking: below w_0 a difference of tensions
    makes the rope creep. A run in which the rope leaves a pulley ends there with a message. Design
    targets: ``stiffness``, ``damping``, ``length``, ``slip_speed``, the parameters of the law
    `payout`, ``radius[0]``, ``friction[0]`` and ``pulley_0_x`` ... of the pulleys, and ``start_x``
    ..., ``end_x`` ...

    Parameters
    ----------
    start, end : MaterialPoint or sequence of float
        Points of bodies, or positions on the ground; m.
    pulleys : sequence of Pulley
        Pulleys in the order in which the rope passes them; may be empty.
    stiffness : float
        EA, positive; N.
    damping : float, optional
        c, not negative; N s.
    length : float, optional
        Unstretched length at a payout of zero, positive; m. By default the length of the path in
        the reference configuration.
    payout : Law, optional
        Length that a winch at the start has paid out, negative if hauled in; m.
    slip_speed : float, optional
        w_0, positive; m/s. Given where a pulley has friction.
    """

    start: Place
    end: Place
    pulleys: Sequence[Pulley] = ()
    stiffness: float = field(kw_only=True)
    damping: float = field(default=0.0, kw_only=True)
    length: float | None = field(default=None, kw_only=True)
    payout: Law | None = field(default=None, kw_only=True)
    slip_speed: float | None = field(default=None, kw_only=True)

    kind = "rope"
    elastic = True
    refers = True
    routed = True
    has_efforts = True
    design_fields = (
        ("stiffness", require_positive),
        ("damping", require_damping),
        ("length", require_positive),
        ("slip_speed", require_positive),
        ("payout", require_law),
        ("pulleys", _require_pulleys),
        LAW_FIELD,
    )
    indexed_fields: ClassVar = {"pulleys": "radius"}

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"load {self.name!r}"
        object.__setattr__(self, "pulleys", tuple(self.pulleys))
        for name in ("start", "end"):
            _require_place(f"{where}, {name}", getattr(self, name))
        if self.law is not None:
            rule = "must be left out: a rope has no factor over time"
            raise InvalidInputError(f"{where}, law", rule, repr(self.law), "Give it as `payout`.")
        if not self.points:
            rule, repair = "must touch a body", "Give a point of a body as start, end or centre."
            raise InvalidInputError(where, rule, "places on the ground", repair)
        rubbed = any(pulley.friction is not None for pulley in self.pulleys)
        if rubbed != (self.slip_speed is not None):
            rule, repair = (
                "must be given where a pulley has friction, and only there",
                "Give both or leave both out.",
            )
            raise InvalidInputError(f"{where}, slip_speed", rule, self.slip_speed, repair)

    # -- points and design numbers -------------------------------------------------------------

    @cached_property
    def _places(self) -> dict[str, Place]:
        """Start, pulley centres and end of the rope, in order, by the names of their targets."""
        centres = {f"pulley_{k}": pulley.centre for k, pulley in enumerate(self.pulleys)}
        return {"start": self.start, **centres, "end": self.end}

    def point_fields(self) -> dict[str, MaterialPoint]:
        """Return the points of bodies among start, pulley centres and end, by name."""
        return {name: x for name, x in self._places.items() if isinstance(x, MaterialPoint)}

    def with_points(self, points: Mapping[str, MaterialPoint]) -> Self:
        """Return the same rope with other points of bodies, given by name."""
        start, *centres, end = (points.get(name, x) for name, x in self._places.items())
        pairs = zip(self.pulleys, centres, strict=True)
        pulleys = tuple(replace(pulley, centre=centre) for pulley, centre in pairs)
        return replace(self, start=start, end=end, pulleys=pulleys)

    def numbers_of(self, name: str) -> dict[str, float]:
        """Return the numbers of a design field; `pulleys` includes positions on the ground."""
        if name != "pulleys":
            return super().numbers_of(name)
        numbers = dict[str, float]()
        for k, pulley in enumerate(self.pulleys):
            numbers |= pulley.numbers(k)
        for which, place in self._places.items():
            if not isinstance(place, MaterialPoint):
                axes = zip("xyz", place, strict=False)
                numbers |= {f"{which}_{axis}": float(x) for axis, x in axes}
        return numbers

    def changed_fields(self, changes: Mapping[str, float]) -> dict[str, Any]:
        """Return the new values of the fields that the changed parameters belong to, by name."""
        new = super().changed_fields(changes)
        if "pulleys" in new:
            names = self.numbers_of("pulleys")
            given = iter(dict(zip(names, new["pulleys"], strict=True)).values())
            pulleys = [x.with_numbers(given) for x in self.pulleys]
            start, *centres, end = (
                x if isinstance(x, MaterialPoint) else tuple(next(given) for _ in x)
                for x in self._places.values()
            )
            pairs = zip(pulleys, centres, strict=True)
            new["pulleys"] = tuple(replace(pulley, centre=x) for pulley, x in pairs)
            new |= {"start": start, "end": end}
        return new

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Return whether the rope has damping or friction, or a variable drives its damping."""
        return self.damping != 0 or self.slip_speed is not None or "damping" in driven

    def vectors(self, elements: Elements) -> Vectors:
        """Return the positions of its points, with the axes of bodies pulled at a surface."""
        return tuple(
            (place, quantity)
            for place, pulley in zip(self._places.values(), self._stops, strict=True)
            if isinstance(place, MaterialPoint)
            for quantity in tuple(Quantity)[: 1 + _axis_count(pulley, elements.d)]
        )

    @property
    def _stops(self) -> tuple[Pulley | None, ...]:
        """The pulleys of the rope in order, between None for its start and None for its end."""
        return (None, *self.pulleys, None)

    def check_space(self, elements: Elements) -> None:
        """Raise InvalidInputError if pulleys do not fit the space or the rope misses one."""
        where, d = f"load {self.name!r}", elements.d
        for name, place in self._places.items():
            if not isinstance(place, MaterialPoint):
                require_vector(f"{where}, {name}", place, (d,))
        for k, pulley in enumerate(self.pulleys):
            if (pulley.axis is None) != (d == 2):
                rule = "must be given in space and left out in the plane"
                raise InvalidInputError(f"{where}, axis of pulley {k}", rule, pulley.axis)
            centre, count = pulley.centre, _axis_count(pulley, d)
            if count and isinstance(centre, MaterialPoint) and centre.fraction is not None:
                rule = "must belong to a rigid body or the ground, in space or with friction"
                repair = "Give a point of a RigidBody."
                raise InvalidInputError(f"{where}, pulley {k}", rule, str(centre), repair)
        super().check_space(elements)
        self._check_reference(elements)

    def _check_reference(self, elements: Elements) -> None:
        """Raise InvalidInputError if the rope does not run over its pulleys in the reference."""
        p = np.array(list(self.parameters().values()))
        rows = list[Array]()
        for place, pulley in zip(self._places.values(), self._stops, strict=True):
            if isinstance(place, MaterialPoint):
                # Directions of the body are not known yet; unit vectors keep the declared axis.
                count = _axis_count(pulley, elements.d)
                rows += [elements.place_of(place), *np.eye(elements.d)[:count]]
        U = np.array(rows)
        with np.errstate(all="ignore"):
            spans = self._reeving(U, np.zeros_like(U), p, U).spans
            off = self.off_route(np.zeros(1), U[None], np.zeros_like(U[None]), p, U)
        for k, span in enumerate(spans):
            if not np.all(span.length > 0):
                rule, repair = "must have a length", "Move one of its places."
                raise InvalidInputError(f"load {self.name!r}, span {k}", rule, 0.0, repair)
        if off is not None:
            rule = "must run over its pulleys in the reference configuration"
            repair = "Set clockwise, or move the pulley."
            raise InvalidInputError(f"load {self.name!r}", rule, f"a rope that {off[1]}", repair)

    # -- tension and forces ------------------------------------------------------------------------

    def signals(self, p: Array, t: Array, order: int) -> Array | None:
        """Return the paid-out length and its rate, or a time derivative of these, (k, 2)."""
        if self.payout is None:
            return None
        its = self.split(p)[4]
        return np.stack([self.payout.derivative(its, t, order + k) for k in (0, 1)], axis=-1)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return `force_at` with the payout at its value at t = 0; N."""
        signals = self.signals(p, np.zeros(1), 0)
        return self.force_at(U, V, np.zeros((1, 0)) if signals is None else signals, p, U_o)

    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return the pulls T u of the adjoining spans on each point, at centre or surface; N."""
        stations, reeving = self._stations(U, V, p, U_o), self._reeving(U, V, p, U_o)
        pulls = list[list[tuple[Any, Any]]]([[] for _ in stations])
        tensions = self._tensions(reeving, signals, p, U_o)
        for k, (span, T) in enumerate(zip(reeving.spans, tensions, strict=True)):
            pulls[k].append((T * span.u, span.arms[0]))
            pulls[k + 1].append((-T * span.u, span.arms[1]))
        forces = []
        for station, place, each in zip(stations, self._places.values(), pulls, strict=True):
            if not isinstance(place, MaterialPoint):
                continue
            on_vectors = [station.pulled(F, arm) for F, arm in each]
            forces.append(on_vectors[0] if len(each) == 1 else on_vectors[0] + on_vectors[1])
        return concatenate(forces)

    def effort_count(self, p: Array) -> int:
        """Return the number of tensions, one per span."""
        return len(self.pulleys) + 1

    def efforts_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return the tension of every span, (..., 1, 1) each; N."""
        return tuple(self._tensions(self._reeving(U, V, p, U_o), signals, p, U_o))

    def off_route(
        self, t: Array, U: Array, V: Array, p: Array, U_o: Array
    ) -> tuple[int, str] | None:
        """Return the index of the first state up to which the rope left a pulley, and a message.

        A rope also leaves its route if a point or centre enters a pulley. If points move by more
        than the fraction _LONG of the shortest tangent in a step, the cubic through the ends of the
        step is checked.
        """
        off = self._off_at(U, p, U_o)
        shape, h = (len(U), 1, 1), np.diff(t)[:, None, None]
        lengths = [np.broadcast_to(x.length, shape) for x in self._reeving(U, V, p, U_o).spans]
        rates = [np.sqrt(dot(x.V, x.V))[:, :1] for x in self._stations(U, V, p, U_o)]
        speeds = np.max([np.broadcast_to(x, shape) for x in rates], axis=0)
        short = np.min(lengths, axis=0)
        # Both of two points may move.
        way = h * (speeds[1:] + speeds[:-1])
        far = way > _LONG * np.minimum(short[1:], short[:-1])
        radii = [abs(x.radius.real) for x in self._stations(U, V, p, U_o) if x.radius != 0]
        parts = _FINE * way[:, 0, 0].real / min(radii, default=np.inf)
        counts = np.clip(np.ceil(parts), *_PLACES)
        for k in np.flatnonzero(far):
            if off is not None and k >= off[0]:
                break
            x, step = np.linspace(0.0, 1.0, int(counts[k]))[:, None, None], h[k]
            bend = (1 - x) * step * V[k] - x * step * V[k + 1] + (2 * x - 1) * (U[k + 1] - U[k])
            on_way = self._off_at((1 - x) * U[k] + x * U[k + 1] + x * (1 - x) * bend, p, U_o)
            if on_way is not None:
                return int(k) + 1, on_way[1]
        return off

    def _off_at(self, U: Array, p: Array, U_o: Array) -> tuple[int, str] | None:
        """Return the first state with a rope off a pulley or a point in one, and a message."""
        V = np.zeros_like(U)
        found, names = list[tuple[Any, str]](), tuple(self._places)
        for k, (a, b) in enumerate(pairwise(self._stations(U, V, p, U_o))):
            D, rises = _apart(a, b)
            words = (
                f"takes {names[k]} and {names[k + 1]} of load {self.name!r} so near to each other "
                "that no tangent is between them"
            )
            for station, rise in zip((a, b), rises, strict=True):
                if D.shape[-1] == 2 or station.axis is not None:
                    in_plane = _in_plane(D, station.axis)
                    found.append((dot(in_plane, in_plane) > rise * rise, words))
        for k, phi in enumerate(self._reeving(U, V, p, U_o).angles):
            words = (
                f"leaves pulley {k} of load {self.name!r}, around which the rope has an angle "
                "between 0 and 3/2 pi beside whole turns"
            )
            found.append((phi > 2 * np.pi * self.pulleys[k].turns, words))
        first = list[tuple[int, str]]()
        for on_route, words in found:
            off = np.flatnonzero(~np.broadcast_to(on_route, (len(U), 1, 1)))
            first += [(int(off[0]), words)] if len(off) else []
        return min(first, key=lambda one: one[0], default=None)

    def _stations(self, U: Any, V: Any, p: Array, U_o: Array) -> list[_Station]:
        numbers, first = dict(zip(self.numbers_of("pulleys"), self.split(p)[5], strict=True)), 0
        d, found = U_o.shape[1], list[_Station]()
        for k, (name, pulley) in enumerate(zip(self._places, self._stops, strict=True), start=-1):
            place, axis = self._places[name], None
            radius = 0.0 if pulley is None else numbers[f"radius[{k}]"]
            if isinstance(place, MaterialPoint):
                its = slice(first, first + 1 + _axis_count(pulley, d))
                first, at, rates, start = its.stop, U[..., its, :], V[..., its, :], U_o[its]
            else:
                at = np.array([[numbers[f"{name}_{x}"] for x in "xyz"[:d]]])
                rates, start = 0.0 * at.real, at
            if pulley is not None and d == 3:
                axis = _unit(pulley.axis)
                if len(start) > 1:
                    axis = ((start[1:] @ axis.T) * at[..., 1:, :]).sum(axis=-2, keepdims=True)
            drags = pulley is not None and pulley.friction is not None
            sign = -1.0 if pulley is not None and pulley.clockwise else 1.0
            found.append(_Station(at, rates, sign * radius, axis, drags))
        return found

    def _reeving(self, U: Any, V: Any, p: Array, U_o: Array) -> _Reeving:
        """Return the path of the rope for the vectors U and their rates V."""
        stations = self._stations(U, V, p, U_o)
        spans = [_span(*pair) for pair in pairwise(stations)]
        angles, length = list[Any](), sum((span.length for span in spans[1:]), spans[0].length)
        for pulley, station, (before, after) in zip(
            self.pulleys, stations[1:-1], pairwise(spans), strict=True
        ):
            t, u = before.tangents[1], after.tangents[0]
            sign = -1.0 if pulley.clockwise else 1.0
            s = sign * dot(_turned(t, station.axis), u)
            # From -pi/2 to 3/2 pi.
            phi = angle(-dot(t, u), s) + (np.pi / 2 + 2 * np.pi * pulley.turns)
            angles.append(phi)
            length = length + sign * station.radius * phi
        return _Reeving(spans, angles, length)

    def _tensions(self, reeving: _Reeving, signals: Any, p: Array, U_o: Array) -> list[Any]:
        """Return the tension of every span, (..., 1, 1) each; N."""
        stiffness, damping, length, slip_speed, *_ = self.split(p)
        L, rate = reeving.length, sum(span.rate for span in reeving.spans)
        l = self._reeving(U_o, np.zeros(U_o.shape), p, U_o).length if length is None else length
        l_t = 0.0
        if self.payout is not None:
            l, l_t = l + signals[..., 0, None, None], signals[..., 1, None, None]
        strain = L / l - 1 + _JUST_TAUT
        T = positive(stiffness * strain + damping * (rate - L / l * l_t) / l)
        if slip_speed is None:
            return [T] * len(reeving.spans)
        return self._shared(T, reeving, rate - l_t, slip_speed, p)

    def _shared(
        self, T: Any, reeving: _Reeving, stretch: Any, slip_speed: Any, p: Array
    ) -> list[Any]:
        """Return the tensions of the spans, with friction, whose mean along the rope is T; N.

        The rate of elongation `stretch` of the whole rope is distributed in proportion to length.
        """
        numbers = dict(zip(self.numbers_of("pulleys"), self.split(p)[5], strict=True))
        arcs = [numbers[f"radius[{k}]"] * phi / 2 for k, phi in enumerate(reeving.angles)]
        pairs = zip(reeving.spans, [0.0, *arcs], [*arcs, 0.0], strict=True)
        shares = [(span.length + a + b) / reeving.length for span, a, b in pairs]
        slip, ratios = 0.0, [1.0]
        # Backward from the end, where the rope does not slip.
        for k in range(len(self.pulleys) - 1, -1, -1):
            slip = slip + reeving.spans[k + 1].rate - shares[k + 1] * stretch
            mu = numbers.get(f"friction[{k}]", 0.0)
            ratios.append(ratios[-1] * np.exp(-mu * reeving.angles[k] * np.tanh(slip / slip_speed)))
        ratios.reverse()
        mean = sum(ratio * share for ratio, share in zip(ratios, shares, strict=True))
        return [T * ratio / mean for ratio in ratios]


def _axis_count(pulley: Pulley | None, d: int) -> int:
    """Return the number of body directions (d or 0) that the forces at a station depend on."""
    turns = pulley is not None and (d == 3 or pulley.friction is not None)
    return d if turns else 0


def _unit(axis: Sequence[float] | None) -> Array:
    """Return a direction with unit length, (1, 3); `axis` may have any length."""
    a = np.array([axis], dtype=float)
    return a / np.sqrt(dot(a, a))


def _turned(u: Any, axis: Any) -> Any:
    """Return a vector rotated by a right angle, in space about an axis."""
    return u @ QUARTER_TURN if axis is None else cross(axis + 0.0 * u, u)


def _in_plane(D: Any, axis: Any) -> Any:
    """Return the component of a vector perpendicular to an axis; in the plane the vector."""
    return D if axis is None else D - dot(D, axis) * axis


def _tangent(D: Any, rise: Any, axis: Any) -> Any:
    """Return the direction of the common tangent of two circles in the plane of one of them.

    D leads from centre to centre, and `rise` is the difference of the signed radii. Circles
    without such a tangent get a finite direction, so that a step may end there and is refused.
    """
    in_plane = _in_plane(D, axis)
    squared = dot(in_plane, in_plane)
    least, room = _LEAST * squared, squared - rise * rise
    along = np.sqrt(positive(room - least) + least)
    return (along * in_plane - rise * _turned(in_plane, axis)) / (squared + positive(-room))


def _apart(a: _Station, b: _Station) -> tuple[Any, tuple[Any, Any]]:
    """Return the vector from centre a to centre b, and the difference of radii for either axis."""
    D, alike = b.U[..., :1, :] - a.U[..., :1, :], 1.0
    if a.axis is not None and b.axis is not None:
        alike = dot(a.axis + 0.0 * b.axis, b.axis)
    return D, (b.radius * alike - a.radius, b.radius - a.radius * alike)


def _span(a: _Station, b: _Station) -> _Span:
    """Return the straight part of a rope between the stations a and b."""
    D, rises = _apart(a, b)
    tangents, arms = list[Any](), list[Any]()
    for station, rise in zip((a, b), rises, strict=True):
        if D.shape[-1] == 3 and station.axis is None:
            tangents.append(None)
            arms.append(0.0 * D)
            continue
        t = _tangent(D, rise, station.axis)
        tangents.append(t)
        arms.append(-station.radius * _turned(t, station.axis))
    e = D + arms[1] - arms[0]
    length = np.sqrt(dot(e, e))
    u, (w_a, w_b) = e / length, (x.speed(arm) for x, arm in zip((a, b), arms, strict=True))
    return _Span(length, u, (tangents[0], tangents[1]), (arms[0], arms[1]), dot(u, w_b - w_a))
