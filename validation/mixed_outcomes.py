"""Truth of outcomes of runs that mix contacts, ropes, controllers, events and ways to call.

    python -m validation.mixed_outcomes 1000
    python -m validation.mixed_outcomes 200 4000

draw 1,000 scenes from seeds 0, 1, ..., or 200 from seed 4000 on, and print those that do not end as
they must, as `load_outcomes` does. Bodies hit stops inside a contact, coils touch themselves beside
events, weights on ropes over pulleys hit the floor, controllers diverge until an event ends or
switches them. Boxes with cones of friction strike the floor and each other. Heaps of spheres search
for neighbours with a `reach` from tiny to huge. Latches lock and open at the same time. A part of
the runs has its end time as a design variable, goes on `after` a shorter run, or is stored in parts
by `keep`: derivatives, states at the end and states that are kept must be equal.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ancfdae import (
    CABLE_3D,
    DOP853,
    HHT,
    IDA,
    PID,
    Beam,
    BeamContact,
    BeamPairContact,
    Contact,
    DirectDifferentiation,
    Distance,
    EndEvent,
    Impact,
    ImpactLaw,
    InitialVelocity,
    Material,
    Mode,
    NodalState,
    Pin,
    Plane,
    Radau,
    RigidBody,
    Scene,
    SphereContacts,
    Switch,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.errors import AncfdaeError
from ancfdae.integrators.step_control import FixedSteps
from ancfdae.laws import UserLaw
from ancfdae.observables import position, velocity
from ancfdae.sections import Circle
from validation.load_outcomes import LoadScene
from validation.random_runs import tally

# Seconds of the processor after which a scene counts as one that hangs.
_PATIENCE = 8
# Largest differences of a continued run and of kept states, relative to the coordinates, at fixed
# steps, and of the derivative in the end time from the velocity, relative to velocities.
_APART, _RATE = 1e-7, 1e-2

# A model, the names of its design variables, and what `simulate` takes beside them.
_Drawn = tuple[Scene, list[str], dict[str, Any]]


class _Mixed(LoadScene):
    """A random scene of one of seven kinds, and how it is called."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([43, seed])
        self.driven = True
        kinds: tuple[Callable[[], _Drawn], ...] = (
            self._struck, self._coil, self._weight, self._servo, self._cones, self._heap,
            self._latches,
        )  # fmt: skip
        odds = [0.2, 0.04, 0.16, 0.16, 0.16, 0.12, 0.16]
        self.model, self.design, self.given = kinds[int(rng.choice(7, p=odds))]()
        self.t_end = float(rng.choice([1e-5, 0.05, 0.3]))
        step = self.t_end / float(rng.choice([4, 40, 100]))
        self.integrator = [
            HHT(step), HHT(rtol=1e-4), Radau(step), Radau(rtol=1e-5), DOP853(1e-6), IDA(1e-6),
        ][int(rng.choice(6, p=[0.25, 0.2, 0.2, 0.15, 0.1, 0.1]))]  # fmt: skip
        self.way = str(rng.choice(["plain", "t_end", "after", "keep"]))
        if self.way == "t_end":
            self.design = [*self.design, "t_end"]

    def _point(self) -> tuple[RigidBody, list[Any], dict[str, Any]]:
        """Return a body with a start, and the numbers of a contact."""
        rng = self.rng
        body = RigidBody("a", (0.0, 0.1), mass=float(10.0 ** rng.uniform(-2, 2)), inertia=0.1)
        v = float(rng.normal()), float(rng.choice([0.0, -1.0, -30.0, 1.0]))
        start = [InitialVelocity("a", float(rng.normal()), about=(0.0, 0.1), velocity=v)]
        return body, start, self._numbers()

    def _struck(self) -> _Drawn:
        """Return a body that sinks into a contact, with a stop and an end inside it."""
        rng = self.rng
        body, start, numbers = self._point()
        loads: list[Any] = [Contact(body.origin, self._obstacle(), radius=0.1, name="k", **numbers)]
        depth = float(rng.choice([0.0, 1e-12, 1e-6, 1e-3, 0.05]))
        height, sinks = position(body.origin, 1), velocity(body.origin, 1)
        e = float(rng.choice([0.0, 0.5, 1.0]))
        stop = Impact(
            height - (0.1 - depth), e, "stop", friction=0.3, sliding=velocity(body.at(0, -0.1), 0)
        )
        events: list[Any] = [stop, EndEvent(sinks, int(rng.integers(-1, 2)), "turns")]
        events.append(Switch(height - (0.1 - 0.5 * depth), "bare", -1, "inside"))
        events = [x for x in events if rng.random() < 0.6] or [stop]
        scene = Scene((), (), self._gravity(), bodies=[body], loads=loads, start=start)
        modes = {"bare": Mode(replace(scene, loads=[]), [stop])}
        return scene, ["a.mass"], {"events": events, "modes": modes}

    def _coil(self) -> _Drawn:
        """Return a cable of 1.3 turns that touches itself and a floor, with an end or a stop."""
        rng = self.rng
        n, pitch, speed = (
            12,
            float(rng.choice([0.0205, 0.019, 0.03])),
            float(rng.choice([0.1, 5.0])),
        )
        a = np.linspace(0.0, 2.6 * np.pi, n + 1)
        slope = pitch / (2 * np.pi)
        nodes = np.stack([0.1 * np.cos(a), 0.1 * np.sin(a), slope * a], axis=1)
        tangents = np.stack([-0.1 * np.sin(a), 0.1 * np.cos(a), slope + 0 * a], axis=1)
        size = float(np.hypot(0.1, slope))
        V = np.zeros((n + 1, 2, 3))
        V[:, 0, 2] = -speed * np.linspace(-1.0, 1.0, n + 1)
        V[:, 1, 2] = -2 * speed / (2.6 * np.pi * size)
        material = Material(1000.0, float(10.0 ** rng.uniform(4, 8)), 0.3)
        end = (2.6 * np.pi * size, 0.0, 0.0)
        rope = Beam("a", (0.0, 0.0, 0.0), end, n, Circle(0.01), material, element=CABLE_3D)
        numbers = self._numbers() | {"stiffness": float(10.0 ** rng.uniform(2, 7))}
        reach = float(10.0 ** rng.uniform(-4, 1)) if rng.random() < 0.5 else None
        touch = BeamPairContact("a", "a", radius=0.01, name="k", reach=reach, **numbers)
        floor = Plane((0.0, 0.0, -0.02), (0.0, 0.0, 1.0))
        loads = [touch, BeamContact("a", floor, radius=0.01, name="floor", stiffness=1e4)]
        start = [NodalState("a", np.stack([nodes, tangents / size], axis=1), V)]
        tip = position(rope.at_end, 2)
        events: list[Any] = [
            EndEvent(tip - 0.022, -1, "near"), Impact(tip - 0.018, 0.5, "stop"),
        ]  # fmt: skip
        chosen = [x for x in events if rng.random() < 0.7] or events[:1]
        scene = Scene([rope], loads=loads, start=start)
        return scene, ["a.youngs_modulus", "k.stiffness"], {"events": chosen}

    def _weight(self) -> _Drawn:
        """Return the weight on a rope over pulleys, which hits a stop, and perhaps a switch."""
        rng = self.rng
        scene, design = self._hoist()
        load: Any = scene.bodies[0]
        height, y = position(load.origin, 1), float(load.position[1])
        stop = Impact(
            height - (y - float(rng.choice([1e-9, 0.01, 0.1]))), float(rng.choice([0.0, 0.5, 1.0])),
            "stop", friction=float(rng.choice([1e-9, 0.3])), sliding=velocity(load.origin, 0),
        )  # fmt: skip
        cut = Switch(velocity(load.origin, 1), "cut", int(rng.integers(-1, 2)), "cut")
        modes = {"cut": Mode(replace(scene, loads=[scene.loads[1]]), [stop])}
        events: list[Any] = [stop, cut] if rng.random() < 0.5 else [stop]
        return scene, design[:1], {"events": events, "modes": modes}

    def _servo(self) -> _Drawn:
        """Return a pinned body under a controller that may diverge, and events of its angle."""
        rng = self.rng
        body = RigidBody("a", (0.0, 0.0), mass=1.0, inertia=float(10.0 ** rng.uniform(-4, 1)))
        controller = self._controller(body.origin)
        if isinstance(controller, PID) and rng.random() < 0.5:
            grows = float(10.0 ** rng.uniform(0, 4))
            controller = replace(controller, reference=UserLaw(lambda t: np.exp(grows * t)))
        gain = "proportional" if isinstance(controller, PID) else "gain"
        idle = replace(controller, **{gain: 1e-3})
        tip = body.at(1.0, 0.0)
        rise, rate = position(tip, 1), velocity(tip, 1)
        at = float(rng.choice([0.0, 1e-9, 0.1, 0.9, 1.0]))
        events: list[Any] = [
            EndEvent(rise - at, int(rng.integers(-1, 2)), "end"),
            Switch(rate - float(rng.choice([0.0, 1.0, 1e3])), "free", 0, "trips"),
            Impact(rise + at + 1e-9, float(rng.choice([0.0, 0.8, 1.0])), "stop"),
        ]
        chosen = [x for x in events if rng.random() < 0.6] or events[:1]
        scene = Scene((), [Pin(body.origin)], self._gravity(), bodies=[body], loads=[controller])
        modes = {"free": Mode(replace(scene, loads=[idle]), events[2:])}
        return scene, ["a.inertia"], {"events": chosen, "modes": modes}

    def _cones(self) -> _Drawn:
        """Return two boxes in space that strike a floor, and each other, with cones of friction."""
        rng = self.rng
        bodies, start, events = [], [], []
        law = ImpactLaw.POISSON if rng.random() < 0.3 else ImpactLaw.NEWTON
        for k, name in enumerate("ab"):
            place = (0.0, 0.0, 0.11 + 0.25 * k)
            inertias = tuple((0.01 * rng.uniform(0.8, 1.2, 3)).tolist())
            bodies.append(
                RigidBody(name, place, mass=float(10.0 ** rng.uniform(-2, 2)), inertia=inertias)
            )
            spin, v = (
                rng.normal(size=3),
                [*rng.normal(size=2), -float(rng.choice([0.0, 1.0, 50.0]))],
            )
            start.append(InitialVelocity(name, tuple(spin.tolist()), place, tuple(v)))
        lower = bodies[0].at(0.1, 0.0, -0.1), bodies[0].at(-0.1, 0.0, -0.1)
        mu = float(rng.choice([1e-12, 1e-9, 0.3, 5.0]))
        rests = str(rng.choice(["", "held"])) or None
        for k, point in enumerate(lower):
            slides = velocity(point, 0), velocity(point, 1)
            e = float(rng.choice([0.0, 0.5, 1.0]))
            gap = position(point, 2)
            events.append(Impact(gap, e, f"floor {k}", rests, mu, slides, law))
        one, two = bodies[0].at(0.0, 0.0, 0.1), bodies[1].at(0.0, 0.0, -0.1)
        slides = (
            velocity(two, 0) - velocity(one, 0), velocity(two, 1) - velocity(one, 1),
        )  # fmt: skip
        gap = position(two, 2) - position(one, 2)
        events.append(Impact(gap, float(rng.choice([0.0, 0.7])), "pair", None, mu, slides, law))
        gravity = (0.0, 0.0, self._gravity()[1])
        scene = Scene((), (), gravity, bodies=bodies, start=start)
        held = replace(scene, joints=[Pin(lower[0])], start=())
        return scene, ["a.mass"], {"events": events, "modes": {"held": Mode(held, events[2:])}}

    def _heap(self) -> _Drawn:
        """Return spheres that fall on each other and a floor, with a tiny, right or huge reach."""
        rng = self.rng
        count = int(rng.integers(3, 9))
        names = [f"s{k}" for k in range(count)]
        places = rng.uniform(-0.15, 0.15, (count, 2)) + np.array([0.0, 0.2])
        places[:, 1] += 0.22 * np.arange(count)
        bodies = [
            RigidBody(x, tuple(y), mass=float(10.0 ** rng.uniform(-1, 1)), inertia=0.01)
            for x, y in zip(names, places.tolist(), strict=True)
        ]
        speeds = rng.choice([0.0, -3.0, -50.0], count).tolist()
        start = [
            InitialVelocity(x.name, 0.0, about=x.position, velocity=(0.0, v))
            for x, v in zip(bodies, speeds, strict=True)
        ]
        reach = float(10.0 ** rng.choice([-12.0, -6.0, -3.0, -1.0, 0.0, 3.0, 12.0]))
        numbers = self._numbers() | {"stiffness": float(10.0 ** rng.uniform(2, 7))}
        loads: list[Any] = [SphereContacts(names, [0.1] * count, name="k", reach=reach, **numbers)]
        floor = Plane((0.0, 0.0), (0.0, 1.0))
        loads += [
            Contact(x.origin, floor, radius=0.1, name=f"floor {x.name}", stiffness=1e5)
            for x in bodies
        ]
        scene = Scene((), (), self._gravity(), bodies=bodies, loads=loads, start=start)
        return scene, ["s0.mass", "k.stiffness"], {}

    def _latches(self) -> _Drawn:
        """Return a double pendulum whose latches close and open at the same time."""
        rng = self.rng
        one = RigidBody("a", (0.0, 0.0), mass=1.0, inertia=0.1)
        two = RigidBody("b", (1.0, 0.0), mass=float(10.0 ** rng.uniform(-2, 2)), inertia=0.1)
        joints: list[Any] = [Pin(one.origin), Pin(one.at(1.0, 0.0), two.origin)]
        tip = two.at(1.0, 0.0)
        ground = float(rng.choice([1.5, 2.0, 2.0 + 1e-9]))
        latch = Distance(tip, ground, ground=(0.0, 0.0), name="latch")
        base = Scene((), joints, (0.0, -9.81), bodies=[one, two], start=[])
        locked = replace(base, joints=[*joints, latch])
        at = float(rng.choice([-1e-3, -0.02, -0.1]))
        height = position(one.at(1.0, 0.0), 1) - at
        factor = float(rng.choice([1.0, -1.0, 1e6]))
        late = float(rng.choice([0.0, 1e-15, 1e-9]))
        events = [
            Switch(height, "locked", 0, "lock"),
            Switch(factor * (height + late), "start", 0, "release"),
            Switch(position(tip, 1) - 2 * at, "locked", 0, "tip"),
            Impact(height + float(rng.choice([0.0, 0.01])), 0.5, "stop"),
        ]
        chosen = [x for x in events if rng.random() < 0.7] or events[:1]
        modes = {"locked": Mode(locked, [x for x in events if rng.random() < 0.5])}
        return base, ["b.mass"], {"events": chosen, "modes": modes}

    def wrong(self, run: Any) -> str:
        """Name a part, a continuation or a derivative in time that differs from the run."""
        try:
            if self.way == "t_end":
                return self._rate(run)
            if self.way == "after":
                return self._continued(run)
            if self.way == "keep":
                return self._kept(run)
        except AncfdaeError as error:
            return "" if len(str(error)) > 20 else str(error)
        return ""

    def _rate(self, run: Any) -> str:
        """Compare the derivative of a height in the end time with the velocity at the end.

        Where an event ends the run it is zero. Fixed steps change with the end time; coarse ones
        leave it the error of the method: there the judge compares two methods only.
        """
        if isinstance(getattr(self.integrator, "steps", None), FixedSteps):
            return ""
        axis = self.model.dimension - 1
        objective = Terminal(position(self._first(), axis))
        found = gradient(
            self.model, objective, self.t_end, self.integrator, design=self.design,
            method=DirectDifferentiation(), **self.given,
        ).gradient[-1]  # fmt: skip
        t, v = float(run.t[-1]), float(run.v[-1][axis])
        expected = v if t >= self.t_end * (1 - 1e-12) else 0.0
        size = abs(expected) + float(np.max(np.abs(run.v)))
        right = abs(found - expected) <= _RATE * size
        return "" if right else f"derivative in t_end of {found:.6g} with velocity {expected:.6g}"

    def _first(self) -> Any:
        first: Any = (self.model.beams or self.model.bodies)[0]
        return first.at_start if isinstance(first, Beam) else first.origin

    def _continued(self, run: Any) -> str:
        """Compare a run in two parts with the run in one."""
        half = simulate(self.model, self.t_end / 2, self.integrator, **self.given)
        if not half.outcome.success:
            return f"half of the run: {half.outcome}"
        whole = simulate(self.model, self.t_end, self.integrator, after=half, **self.given)
        return self._differs("continued run", run.q[-1], whole.q[-1], whole)

    def _kept(self, run: Any) -> str:
        """Compare the states that a run keeps with the states of the whole run."""
        part = simulate(self.model, self.t_end, self.integrator, keep=3, **self.given)
        if not np.all(np.isin(part.t, run.t)):
            return "times that the whole run does not have"
        first = np.searchsorted(run.t, part.t[0])
        return self._differs("kept start", run.q[first], part.q[0], part) or self._differs(
            "kept end", run.q[-1], part.q[-1], part
        )

    def _differs(self, name: str, one: Any, two: Any, run: Any) -> str:
        """Return how far states at fixed steps are apart, if they are, or that a run failed."""
        if not run.outcome.success:
            return f"{name}: {run.outcome}"
        steps = getattr(self.integrator, "steps", None)
        if not isinstance(steps, FixedSteps):
            return ""
        apart = float(np.max(np.abs(one - two)) / np.max(np.abs(one)))
        return "" if apart <= _APART else f"{name} apart by {apart:.1e}"


if __name__ == "__main__":
    sys.exit(tally(_Mixed, _PATIENCE, *map(int, sys.argv[1:])) > 0)
