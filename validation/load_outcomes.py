"""Truth of outcomes of runs with contacts, controllers and ropes: random scenes of extreme numbers.

    python -m validation.load_outcomes 1000
    python -m validation.load_outcomes 200 4000

draw 1,000 scenes from seeds 0, 1, ..., or 200 from seed 4000 on, and print those that do not end as
they must, as `event_outcomes` does for events. Bodies and beams meet obstacles and each other, in
the plane and in space, with stiffnesses from soft to absurd, apart, grazing or pressed in at the
start. Gains of controllers hold, diverge or are huge. Laws of loads are NaN or infinite from some
time on, controllers have bad equations, lags and joints close loops that are almost algebraic.
Ropes run over pulleys and are paid out by such laws. A part of the scenes has stops, ends and
switches as well. Where nothing drives a scene it must not gain energy beyond the errors of steps.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ancfdae import (
    BEAM_3D,
    CABLE_3D,
    DOP853,
    HHT,
    IDA,
    PID,
    Beam,
    BeamContact,
    BeamPairContact,
    Contact,
    Cylinder,
    EndEvent,
    FirstOrderLag,
    Impact,
    InitialVelocity,
    Material,
    Mode,
    Pin,
    Plane,
    Pulley,
    Radau,
    RigidBody,
    Rope,
    Scene,
    Sphere,
    SphereContacts,
    Switch,
    assemble,
)
from ancfdae.extend import (
    LAW_FIELD,
    Controller,
    FormulaJoint,
    RotationAxis,
    design_numbers,
)
from ancfdae.laws import Constant, Harmonic, UserLaw
from ancfdae.observables import (
    gravitational_energy,
    kinetic_energy,
    position,
    strain_energy,
    velocity,
)
from ancfdae.sections import Circle, Rectangle
from ancfdae.sensitivity.observables.observable import states_of
from validation.random_runs import RandomRun, tally

# Seconds of the processor after which a scene counts as one that hangs.
_PATIENCE = 20
# Largest difference of two methods, relative to the gradient.
_APART = 1e-6
# Energy gained by the errors of steps in contact, as a part of the kinetic energy.
_GAINED = 0.1


@dataclass(frozen=True)
class _Odd(Controller):
    """A controller whose state x has the rate of one of six bad or extreme formulas."""

    point: Any
    gain: float
    formula: int

    kind = "odd"
    states = ("x",)
    design_fields = (*design_numbers("gain"), LAW_FIELD)

    def axes(self, p: Any) -> Any:
        """Return the angle of the point."""
        return (RotationAxis(self.point),)

    def equations(self, at: Any, p: Any) -> Any:
        """Return the rate of x and a torque in proportion to it."""
        gain, x, angle, rate = self.split(p)[0], at.states[0], at.coordinates[0], at.rates[0]
        formulas = (
            gain * x, gain * x * x + 1.0, np.sqrt(x - 0.1) * gain, np.log(1e-3 - rate),
            gain * np.tanh(1e6 * (angle - x)), gain / (x - 0.01) - 1e3 * x,
        )  # fmt: skip
        return [formulas[self.formula]], [gain * (x - angle)]


@dataclass(frozen=True)
class _Curve(FormulaJoint):
    """A joint that holds a point on the curve y = f(x), one of five bad or extreme formulas."""

    point: Any
    factor: float
    formula: int

    kind = "curve"
    design_fields = design_numbers("factor")

    def equations(self, U: Any, p: Any, reference: Any, laws: Any) -> Any:
        """Return y - f(x)."""
        (k,), (x, y) = self.split(p), U[0]
        formulas = (
            np.sin(k * x) / k, k * x**3, np.sqrt(0.01 - x) - 0.1, x / (0.1 - x),
            np.tanh(1e6 * x) * k,
        )  # fmt: skip
        return y - formulas[self.formula]


class LoadScene(RandomRun):
    """A random scene with contacts, controllers and ropes, and perhaps with events."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.rng = rng = np.random.default_rng([41, seed])
        self.driven = False
        kinds = (self._bodies, self._rod, self._crossing, self._hoist, self._loop)
        self.model, self.design = kinds[int(rng.choice(5, p=[0.35, 0.15, 0.15, 0.2, 0.15]))]()
        if rng.random() < 0.3:
            self._add_events()
        self.t_end = float(rng.choice([1e-6, 0.1, 0.5, 1.0]))
        step = self.t_end / float(rng.choice([5, 40, 200]))
        self.integrator = [
            HHT(step), HHT(rtol=1e-4), Radau(step), Radau(rtol=1e-5), DOP853(1e-6), IDA(1e-6),
        ][int(rng.integers(0, 6))]  # fmt: skip

    def _numbers(self) -> dict[str, Any]:
        """Return the numbers of a contact."""
        rng = self.rng
        numbers: dict[str, Any] = {"stiffness": float(10.0 ** rng.uniform(-6, 16))}
        numbers["exponent"] = float(rng.choice([1.0, 1.5, 3.0]))
        if rng.random() < 0.5:
            numbers |= {"restitution": float(rng.choice([0.05, 0.5, 1.0]))}
            numbers |= {"impact_speed": float(10.0 ** rng.uniform(-6, 3))}
        if rng.random() < 0.4:
            numbers |= {"friction": float(rng.choice([1e-9, 0.3, 10.0]))}
            numbers |= {"slip_speed": float(10.0 ** rng.uniform(-9, 0))}
        return numbers

    def _obstacle(self) -> Any:
        """Return an obstacle at a height of zero, or just there, far in, or apart."""
        rng = self.rng
        y = float(rng.choice([0.0, 0.0, -1e-12, 1e-12, -0.3, 0.2, 0.6]))
        round_one = Sphere((0.0, y - 0.7), 0.7)
        return [Plane((0.0, y), (0.0, 1.0)), round_one][int(rng.integers(0, 2))]

    def _law(self) -> Any:
        """Return a law of time, which may be NaN or infinite from the middle of a second on."""
        rng = self.rng

        def nan(t: Any) -> Any:
            return np.sqrt(0.05 - t)

        def pole(t: Any) -> Any:
            return 1.0 / (0.05 - t)

        value = float(rng.choice([0.0, 1.0, 1e300]))
        laws = (Constant(value), Harmonic(value, 1e4), UserLaw(nan), UserLaw(pole))
        return laws[int(rng.integers(0, 4))]

    def _controller(self, point: Any) -> Any:
        rng = self.rng
        gain = float(rng.choice([-1.0, 1.0])) * float(10.0 ** rng.uniform(-3, 12))
        if rng.random() < 0.5:
            return PID(
                point, self._law(), gain, 10 * gain, float(rng.choice([0, 1, 1e6])), name="servo"
            )
        return _Odd(point, gain, int(rng.integers(0, 6)), name="servo")

    def _bodies(self) -> tuple[Scene, list[str]]:
        rng = self.rng
        names = "abcd"[: int(rng.integers(1, 5))]
        heights = 0.1 + np.cumsum(rng.choice([0.2, 0.2 + 1e-12, 0.15, 0.5], len(names))) - 0.2
        bodies = [
            RigidBody(x, (0.0, float(y)), mass=float(10.0 ** rng.uniform(-3, 3)), inertia=0.1)
            for x, y in zip(names, heights, strict=True)
        ]
        numbers = self._numbers()
        loads: list[Any] = [
            Contact(bodies[0].at(0, 0), self._obstacle(), radius=0.1, name="k", **numbers)
        ]
        if len(names) > 1:
            radii = [0.1] * len(names)
            loads.append(SphereContacts(names, radii, name="pairs", **self._numbers()))
        joints = []
        if rng.random() < 0.5:
            loads.append(self._controller(bodies[0].origin))
            joints = [Pin(bodies[0].origin)] if rng.random() < 0.5 else []
        v = (float(rng.normal()), float(rng.choice([0.0, -1.0, -1e3, 1.0])))
        start = (
            []
            if joints
            else [InitialVelocity("a", float(rng.normal()), about=(0.0, 0.1), velocity=v)]
        )
        settings: dict[str, Any] = {"bodies": bodies, "loads": loads, "start": start}
        return Scene([], joints, self._gravity(), **settings), ["a.position_y", "k.stiffness"]

    def _gravity(self) -> tuple[float, float]:
        return 0.0, -float(self.rng.choice([0.0, 1e-6, 9.81, 9.81, 1e4]))

    def _rod(self) -> tuple[Scene, list[str]]:
        rng = self.rng
        E = float(10.0 ** rng.uniform(6, 11))
        material = Material(1000.0, E, 0.3, damping_time=float(rng.choice([0.0, 1e-3])))
        rod = Beam("a", (-0.5, 0.01), (0.5, 0.01), 2, Rectangle(0.02, 0.02), material)
        loads: list[Any] = [
            BeamContact("a", self._obstacle(), radius=0.01, name="k", **self._numbers())
        ]
        if rng.random() < 0.5:
            loads.append(self._controller(rod.at_start))
        joints = [Pin(rod.at_start)] if rng.random() < 0.5 else []
        return Scene([rod], joints, self._gravity(), loads=loads), ["a.height", "k.stiffness"]

    def _crossing(self) -> tuple[Scene, list[str]]:
        """Return two beams or cables that cross, touch or lie side by side in space."""
        rng = self.rng
        material = Material(1000.0, float(10.0 ** rng.uniform(5, 11)), 0.3)
        element = [CABLE_3D, BEAM_3D][int(rng.integers(0, 2))]
        gap = float(rng.choice([0.02, 0.02 - 1e-12, 0.02 + 1e-12, 0.015, 0.03, 0.0]))
        along = float(rng.choice([0.0, 1.0, 1e-9]))
        one = Beam("a", (-0.5, 0, gap), (0.5, 0, gap), 2, Circle(0.01), material, element=element)
        ends = (-0.5 * along, -0.5, 0.0), (0.5 * along, 0.5, 0.0)
        two = Beam("b", *ends, 2, Circle(0.01), material, element=element)
        numbers = self._numbers()
        if element is CABLE_3D:
            numbers = {x: y for x, y in numbers.items() if x not in ("friction", "slip_speed")}
        points = int(rng.choice([2, 16]))
        loads: list[Any] = [
            BeamPairContact(
                "a", "b", radius=0.01, other_radius=0.01, points_per_element=points, name="k",
                **numbers,
            ),
            BeamContact("a", self._round(), radius=0.01, name="tube", **self._numbers()),
        ]  # fmt: skip
        joints = [Pin(two.at_start), Pin(two.at_end)] if rng.random() < 0.5 else []
        v = (0.0, 0.0, float(rng.choice([0.0, -1.0, -300.0])))
        start = [InitialVelocity("a", (0, 0, 0), (0, 0, 0), v)]
        gravity = (0.0, 0.0, self._gravity()[1])
        scene = Scene([one, two], joints, gravity, loads=loads, start=start)
        return scene, ["a.youngs_modulus", "k.stiffness"]

    def _round(self) -> Any:
        """Return a pipe around the scene, or a cylinder below it, apart or pressed in."""
        if self.rng.random() < 0.5:
            return Cylinder((0, 0, 0), (1.0, 0.3, 0.1), 0.6, inside=True)
        depth = float(self.rng.choice([0.52, 0.51, 0.5, 0.3]))
        return Cylinder((0, 0, -depth), (0.0, 1.0, 0.0), 0.5)

    def _hoist(self) -> tuple[Scene, list[str]]:
        """Return a weight on a rope over pulleys that a winch pays out, above an obstacle."""
        rng = self.rng
        wheel = RigidBody("wheel", (0.0, 0.0), mass=1.0, inertia=float(10.0 ** rng.uniform(-6, 1)))
        y = -float(rng.choice([1.0, 0.31, 0.7]))
        load = RigidBody("a", (0.2, y), mass=float(10.0 ** rng.uniform(-3, 3)), inertia=0.1)
        drags = rng.random() < 0.5
        friction = float(rng.choice([0.0, 0.3, 5.0])) if drags else None
        turns = int(rng.choice([0, 0, 1, 20])) if drags else 0
        pulleys = [Pulley(wheel.origin, 0.2, clockwise=True, friction=friction, turns=turns)]
        if rng.random() < 0.5:
            pulleys.insert(0, Pulley((-1.0, 0.0), float(rng.choice([0.0, 0.1])), clockwise=True))
        payout = self._law() if rng.random() < 0.5 else None
        self.driven = payout is not None
        rope = Rope(
            (-2.0, -0.5), load.origin, pulleys, stiffness=float(10.0 ** rng.uniform(0, 10)),
            damping=float(rng.choice([0.0, 1.0, 1e6])), payout=payout,
            slip_speed=float(10.0 ** rng.uniform(-9, 0)) if drags else None, name="rope",
        )  # fmt: skip
        numbers = self._numbers()
        floor = Plane((0.0, y - float(rng.choice([0.1, 0.0, 0.3]))), (0.0, 1.0))
        loads: list[Any] = [rope, Contact(load.origin, floor, radius=0.1, name="k", **numbers)]
        if rng.random() < 0.4:
            loads.append(self._controller(wheel.origin))
        velocity = float(rng.normal()), float(rng.choice([0.0, 1.0, -100.0]))
        start = [InitialVelocity("a", 0.0, about=(0.2, y), velocity=velocity)]
        joints, bodies = [Pin(wheel.origin)], [load, wheel]
        scene = Scene([], joints, self._gravity(), loads=loads, bodies=bodies, start=start)
        return scene, ["a.mass", "rope.stiffness"]

    def _loop(self) -> tuple[Scene, list[str]]:
        """Return a bead held on a curve by a joint of formulas, with a lag of any quickness."""
        rng = self.rng
        bead = RigidBody("a", (0.0, 0.0), mass=float(10.0 ** rng.uniform(-3, 3)), inertia=0.1)
        curve = _Curve(bead.origin, float(10.0 ** rng.uniform(-3, 3)), int(rng.integers(0, 5)))
        lag = FirstOrderLag(
            bead.origin, self._law(), float(10.0 ** rng.uniform(-15, 3)), direction=(1.0, 0.0),
            name="lag",
        )  # fmt: skip
        self.driven = True
        loads: list[Any] = [lag, self._controller(bead.origin)]
        if rng.random() < 0.5:
            wall = Plane((float(rng.choice([0.2, 0.1, 0.05])), 0.0), (-1.0, 0.0))
            loads.append(Contact(bead.origin, wall, radius=0.1, name="k", **self._numbers()))
        scene = Scene([], [curve], self._gravity(), loads=loads, bodies=[bead])
        return scene, ["a.mass", "lag.time_constant"]

    def _add_events(self) -> None:
        """Add a stop below the first node or body, an end, and a switch that drops a load."""
        rng = self.rng
        first: Any = (self.model.beams or self.model.bodies)[0]
        point = first.at_start if isinstance(first, Beam) else first.origin
        axis = 2 if len(self.model.gravity) == 3 else 1
        height = position(point, axis)
        corner: Any = first.start if isinstance(first, Beam) else first.position
        place = float(corner[axis])
        lower = place - float(rng.choice([1e-9, 0.01, 0.1, 1.0]))
        e = float(rng.choice([0.0, 0.5, 1.0]))
        events: list[Any] = [
            Impact(height - lower, e, "stop"),
            EndEvent(velocity(point, axis), int(rng.integers(-1, 2)), "end"),
            Switch(height - (place + 0.01), "bare", 0, "switch"),
        ]
        self.driven = self.driven or rng.random() < 0.5
        chosen = [x for x in events if rng.random() < 0.6] or events[:1]
        bare = replace(self.model, loads=self.model.loads[1:])
        dropped = self.model.loads[0].name
        self.design = [x for x in self.design if not x.startswith(f"{dropped}.")]
        self.given = {"events": chosen, "modes": {"bare": Mode(bare, events[:1])}}

    def wrong(self, run: Any) -> str:
        """Return the energy that a run without drives, apart at its start, has gained, or nothing.

        The energy that contacts and ropes store is not in the sum, so a run may only lose.
        """
        system = assemble(self.model)
        q, v = system.start()
        if self.driven or any(isinstance(x, Controller) for x in self.model.loads):
            return ""
        weight = assemble(replace(self.model, loads=())).force(0.0, q, v)
        if np.any(system.force(0.0, q, v) != weight):
            return ""
        phases = getattr(run, "phases", (run,))
        ends = [states_of(phases[0]), states_of(phases[-1])]
        sums = kinetic_energy() + gravitational_energy() + strain_energy()
        before, after = (x.value(system, ends[k])[-k] for k, x in ((0, sums), (1, sums)))
        moving = max(float(np.max(kinetic_energy().value(system, x))) for x in ends)
        gained = float(after - before)
        return f"energy of {gained:.3g} gained" if gained > _GAINED * moving else ""

    def apart(self, run: Any) -> float:
        """Return the largest difference of two methods, relative to the derivatives."""
        return _APART


if __name__ == "__main__":
    sys.exit(tally(LoadScene, _PATIENCE, *map(int, sys.argv[1:])) > 0)
