"""Truth of outcomes of runs with contacts and controllers: random scenes with extreme numbers.

    python -m validation.load_outcomes 1000
    python -m validation.load_outcomes 200 4000

draw 1,000 scenes from seeds 0, 1, ..., or 200 from seed 4000 on, and print those that do not end as
they must, as `event_outcomes` does for events. Bodies and beams meet obstacles and each other with
stiffnesses from soft to absurd, apart, grazing or pressed in at the start. Gains of controllers
hold, diverge or are huge. Laws of loads are NaN or infinite from some time on, or controllers
have bad equations. A run that reaches its end must have finite states. A gradient must be finite
and equal by two methods.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    PID,
    Adjoint,
    Beam,
    BeamContact,
    Contact,
    DirectDifferentiation,
    InitialVelocity,
    Material,
    Pin,
    Plane,
    Radau,
    RigidBody,
    Scene,
    Sphere,
    SphereContacts,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.errors import AncfdaeError
from ancfdae.extend import LAW_FIELD, Controller, RotationAxis, design_numbers
from ancfdae.laws import Constant, Harmonic, UserLaw
from ancfdae.observables import (
    custom,
)
from ancfdae.results import Solution
from ancfdae.sections import Rectangle
from validation.event_outcomes import tally
from validation.events.minimal import Array

# Seconds of the processor after which a scene counts as one that hangs.
_PATIENCE = 20
# Largest difference of two methods, relative to the gradient.
_APART = 1e-6
# Derivatives of a height in m below this are compared with this.
_NOTHING = 1e-6


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


class _Scene:
    """A random scene with contacts, or with controllers, or with both."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([40, seed])
        self.model, self.design = self._rod() if rng.random() < 0.3 else self._bodies()
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

    def run(self) -> Solution:
        """Return the run."""
        return simulate(self.model, self.t_end, self.integrator)

    def gradient(self, method: Any) -> Array:
        """Return the gradient of the height of the first point."""
        objective = Terminal(custom(lambda t, q, v, lam, b: q[:, 1], "height"))
        found = gradient(
            self.model, objective, self.t_end, self.integrator, design=self.design, method=method
        )
        return found.gradient


def outcome(seed: int) -> tuple[str, str]:
    """Return how a scene ended, one word or two, and what is wrong with that, or nothing."""
    try:
        scene = _Scene(seed)
        run = scene.run()
    except AncfdaeError as error:
        return f"refused: {type(error).__name__}", "" if len(str(error)) > 20 else str(error)
    if not run.outcome.success:
        return run.outcome.verdict.name.lower(), ""
    if not (np.all(np.isfinite(run.q)) and np.all(np.isfinite(run.v))):
        return "finished", "states that are not finite"
    try:
        direct = scene.gradient(DirectDifferentiation())
        if isinstance(scene.integrator, DOP853 | IDA):
            return "finished, gradient", "" if np.all(np.isfinite(direct)) else "NaN in a gradient"
        other = scene.gradient(Adjoint())
    except AncfdaeError as error:
        return f"finished, gradient refused: {type(error).__name__}", ""
    apart = np.max(np.abs(direct - other) / np.maximum(np.abs(direct), _NOTHING))
    return "finished, gradient", "" if apart <= _APART else f"methods apart by {apart:.1e}"


if __name__ == "__main__":
    sys.exit(tally(outcome, _PATIENCE, *map(int, sys.argv[1:])) > 0)
