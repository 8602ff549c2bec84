"""Truth of outcomes of runs with events: random scenes with bad or extreme events.

    python -m validation.event_outcomes 1000
    python -m validation.event_outcomes 200 4000

draw 1,000 scenes from seeds 0, 1, ..., or 200 from seed 4000 on, and print those that do not end as
they must. Events happen at once or never, touch zero, have poles, are NaN, steep, or closed at the
start. Restitutions are 0, 1, tiny, or above one. A part of the impacts has friction or Poisson's
law. Modes lead to each other, or hold joints that are open. Beside what `random_runs` asks of all
scenes, a run that reaches its end must have gaps that are not negative beyond round-off. Where no
impact adds energy it must not gain any.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import Any

import numpy as np

from ancfdae import (
    DOP853,
    HHT,
    Beam,
    EndEvent,
    Impact,
    ImpactLaw,
    InitialVelocity,
    Material,
    Mode,
    Pin,
    PointMass,
    PointOnLine,
    Radau,
    RigidBody,
    Scene,
    Switch,
    assemble,
)
from ancfdae.extend import Observable
from ancfdae.observables import (
    custom,
    gravitational_energy,
    kinetic_energy,
    position,
    strain_energy,
    velocity,
)
from ancfdae.results import EventSolution
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.observables.observable import states_of
from validation.random_runs import RandomRun, tally

# Seconds of the processor after which a scene counts as one that hangs.
_PATIENCE = 60
# Negative gaps and gained energy up to this part of their sizes are errors of the steps.
_ROUND_OFF, _GAINED, _APART, _LOST = 1e-8, 1e-2, 1e-7, 1e-15


class _Scene(RandomRun):
    """A random scene: its model, events and modes, and what its gaps are."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.rng = rng = np.random.default_rng([38, seed])
        # Numbers of their own, so that the rest of a scene does not change with them.
        self.rough = np.random.default_rng([39, seed])
        self.laws = [ImpactLaw(x) for x in self.rough.permutation([x.value for x in ImpactLaw])]
        self.design = ["a.position_y"]
        self.adds_energy = False
        gravity = (0.0, -float(rng.choice([0.0, 1e-6, 9.81, 9.81, 1e4])))
        if rng.random() < 0.25:
            points, self.model, self.other = self._rod(gravity)
        else:
            points, self.model, self.other = self._bodies(gravity)
        self.gaps = self._gaps(points)
        self.events: list[Any] = [self._impact(k, gap, points) for k, gap in enumerate(self.gaps)]
        self.events += [self._odd(k, points) for k in range(int(rng.integers(0, 3)))]
        rng.shuffle(self.events)
        modes = {"other": Mode(self.other, self.events[: int(rng.integers(0, 3))])}
        self.given = {"events": self.events, "modes": modes}
        self.t_end = float(rng.choice([1e-6, 0.3, 1.0, 1.0, 3.0]))
        step = self.t_end / float(rng.choice([5, 20, 40]))
        self.integrator = [HHT(step), HHT(rtol=1e-4), Radau(step), Radau(rtol=1e-6), DOP853(1e-7)][
            int(rng.integers(0, 5))
        ]

    def _bodies(self, gravity: tuple[float, float]) -> tuple[list[Any], Scene, Scene]:
        rng = self.rng
        names = "abc"[: int(rng.integers(1, 4))]
        heights = 1.0 + np.cumsum(rng.choice([1.0, 1.0 + 1e-12, 1.3], len(names))) - 1.0
        bodies = [
            RigidBody(x, (0.0, float(y)), mass=float(10.0 ** rng.uniform(-3, 3)), inertia=0.1)
            for x, y in zip(names, heights, strict=True)
        ]
        start = []
        if rng.random() < 0.7:
            v = (float(rng.normal()), float(rng.choice([0.0, -1.0, -1e3, 1.0])))
            start = [InitialVelocity("a", float(rng.normal()), about=(0.0, 1.0), velocity=v)]
        points = [body.at(0.0, 0.0) for body in bodies]
        through = (0.0, float(rng.choice([0.5, 1.0, 7.0])))
        line = PointOnLine(points[0], (1.0, 0.0), through=through, name="line")
        settings: dict[str, Any] = {"gravity": gravity, "bodies": bodies}
        return points, Scene(start=start, **settings), Scene(joints=[line], **settings)

    def _rod(self, gravity: tuple[float, float]) -> tuple[list[Any], Scene, Scene]:
        rng = self.rng
        E = float(10.0 ** rng.uniform(6, 11))
        material = Material(1000.0, E, 0.3, damping_time=float(rng.choice([0.0, 1e-3])))
        rod = Beam("a", (0.0, 1.0), (1.0, 1.0), 2, Rectangle(0.03, 0.03), material)
        self.design = ["a.height"]
        bodies = [PointMass(rod.at_end, float(rng.choice([0.1, 1.0, 100.0])))]
        pin = Pin(rod.at_start)
        line = PointOnLine(rod.at_end, (1.0, 0.0), through=(0.0, 0.5), name="line")
        settings: dict[str, Any] = {"gravity": gravity, "bodies": bodies}
        free, held = Scene([rod], [pin], **settings), Scene([rod], [pin, line], **settings)
        return [rod.at_end, rod.at(0.5)], free, held

    def _gaps(self, points: list[Any]) -> list[Observable]:
        rng = self.rng
        floor = float(rng.choice([0.5, 0.5, 0.99, 1.0, 1.0 - 1e-12, 1.5]))
        gaps = [position(points[0], 1) - floor]
        for one, two in pairwise(points):
            gaps.append(position(two, 1) - position(one, 1) - float(rng.choice([1.0, 0.5])))
        if rng.random() < 0.2:
            # The same gap once more, in other units.
            gaps.append(1e3 * gaps[0])
        return gaps

    def _impact(self, k: int, gap: Observable, points: list[Any]) -> Impact:
        e = float(self.rng.choice([0.0, 1e-8, 0.5, 0.9, 1.0, 1.5]))
        self.adds_energy = self.adds_energy or e > 1
        rest = str(self.rng.choice(["", "", "other"])) or None
        law = self.laws[int(self.rough.random() < 0.05)]
        if self.rough.random() < 0.6:
            return Impact(gap, e, f"gap {k}", rest, law=law)
        # With friction Newton's law may gain energy.
        self.adds_energy = self.adds_energy or law is ImpactLaw.NEWTON
        friction, sliding = float(self.rough.choice([1e-9, 0.1, 0.5, 3.0])), velocity(points[0], 0)
        if 0 < k < len(points):
            sliding = velocity(points[k], 0) - velocity(points[k - 1], 0)
        return Impact(gap, e, f"gap {k}", rest, friction, sliding, law)

    def _odd(self, k: int, points: list[Any]) -> Any:
        """Return an event whose function is bad or extreme."""
        rng = self.rng
        y, u = position(points[0], 1), velocity(points[0], 1)
        place, kind = float(rng.choice([0.5, 0.9, 1.0, 1.0 + 1e-9])), int(rng.integers(0, 10))

        def formula(t: Any, q: Any, v: Any, lam: Any, b: Any) -> Any:
            x = q[:, 1] - place
            odd = (np.sqrt(x), np.log(x), 1.0 / x, np.tanh(1e9 * x), np.sin(1e3 * t), t * np.inf)
            return odd[kind % 6]

        function = (
            custom(formula, f"odd {k}"), custom(formula, f"odd {k}"), custom(formula, f"odd {k}"),
            (y - place) ** 2, (y - place) ** 3, u, 0 * y, 1e-300 * (y - place),
            1e200 * (y - place), y - place,
        )[kind]  # fmt: skip
        direction = int(rng.integers(-1, 2))
        if rng.random() < 0.5:
            return EndEvent(function, direction, f"end {k}")
        return Switch(function, str(rng.choice(["other", "start"])), direction, f"switch {k}")

    def wrong(self, run: EventSolution) -> str:
        """Return which gap is negative, or what energy the run gains, or an empty text."""
        modes = {event.mode for event in run.events}
        if "other" in modes:
            # Another mode may have no impacts, and its joints take energy.
            return ""
        system = assemble(self.model)
        for k, gap in enumerate(self.gaps):
            for phase in run.phases:
                g = gap.value(system, states_of(phase))
                if np.min(g) < -_ROUND_OFF * (np.max(np.abs(g)) + np.max(np.abs(phase.q))):
                    return f"gap {k} of {np.min(g):.1e}"
        if not self.adds_energy:
            ends = run.phases[0], run.phases[-1]
            kinetic, total = (
                [
                    float(x.value(system, states_of(phase))[k])
                    for phase, k in zip(ends, (0, -1), strict=True)
                ]
                for x in (
                    kinetic_energy(),
                    kinetic_energy() + gravitational_energy() + strain_energy(),
                )
            )
            if total[1] - total[0] > _GAINED * (max(kinetic) + abs(total[0])):
                return f"energy of {total[1]:.3g} after {total[0]:.3g}"
        return ""

    def apart(self, run: EventSolution) -> float:
        """Return the largest difference of two methods, relative to the derivatives.

        Derivatives after a phase have the round-off of coordinates over the distance moved in it.
        """
        moved = min(float(np.max(np.abs(phase.q[-1] - phase.q[0]))) for phase in run.phases)
        return max(_APART, _LOST * float(np.max(np.abs(run.q))) / (moved or np.inf))


if __name__ == "__main__":
    sys.exit(tally(_Scene, _PATIENCE, *map(int, sys.argv[1:])) > 0)
