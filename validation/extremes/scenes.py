"""Scenes of the report `extremes`, in any units."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ancfdae import Beam, InitialVelocity, Material, Pin, PointOnLine, Scene
from ancfdae.extend import MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.results import Solution
from ancfdae.sections import Rectangle


@dataclass(frozen=True)
class Units:
    """What a metre, a kilogram and a second are in the units of the scene."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0

    @property
    def pressure(self) -> float:
        """One pascal."""
        return self.mass / (self.length * self.time**2)

    @property
    def force(self) -> float:
        """One newton."""
        return self.mass * self.length / self.time**2


SI = Units()


@dataclass(frozen=True)
class Rod:
    """The paper's pendulum, planar, with everything that a row may change; SI."""

    modulus: float = 1e7
    length: float = 1.2
    slenderness: float = 0.05 / 1.2
    density: float = 4000.0
    gravity: float = 9.81
    elements: int = 4
    spin: float = 2.0
    at: float = 0.0
    dimension: int = 2

    def scene(self, units: Units = SI) -> Scene:
        """Return it, pinned at (at, -at), horizontal and turning at the start."""
        L, T = units.length, units.time
        height = self.slenderness * self.length * L
        rest = (-self.at * L, 0.0)[: self.dimension - 1]
        beam = Beam(
            "rod",
            (self.at * L, *rest),
            ((self.at + self.length) * L, *rest),
            self.elements,
            Rectangle(height, height),
            Material(self.density * units.mass / L**3, self.modulus * units.pressure, 0.3),
        )
        gravity = (0.0, -self.gravity * L / T**2, 0.0)[: self.dimension]
        axis = self.spin / T if self.dimension == 2 else (0.0, 0.0, self.spin / T)
        start = [InitialVelocity("rod", axis, (self.at * L, *rest))]
        return Scene([beam], [Pin(beam.at_start)], gravity=gravity, start=start)

    def natural(self) -> Units:
        """Return units in which the length, the density and Young's modulus are 1."""
        L = 1 / self.length
        mass = L**3 / self.density
        return Units(L, mass, np.sqrt(self.modulus * mass / L))

    def arm(self, run: Solution, units: Units = SI) -> Array:
        """Return the vector from pin to tip in lengths of the rod, shape (n_t, d)."""
        arm = run.position(MaterialPoint("rod", 1.0)) - run.position(MaterialPoint("rod", 0.0))
        return arm / (self.length * units.length)


@dataclass(frozen=True)
class Crank:
    """A planar crank-slider; SI.

    `angle` is the angle of the crank at the start; the slider stands on the x axis at the far or,
    with `folded`, at the near side. `spin` turns crank and rod as one body, zero unless stretched
    out. `turned` is the angle by which the whole mechanism is turned about the bearing.
    """

    crank: float = 0.9
    rod: float = 1.8
    angle: float = 0.0
    folded: bool = False
    mass_ratio: float = 1.0
    stiffness_ratio: float = 1.0
    modulus: float = 1e8
    spin: float = 0.0
    turned: float = 0.0

    def scene(self) -> Scene:
        """Return it; the ratios are those of the crank to the rod."""
        cos, sin = np.cos(self.turned), np.sin(self.turned)
        turn = np.array([[cos, -sin], [sin, cos]])
        elbow = self.crank * np.array([np.cos(self.angle), np.sin(self.angle)])
        reach = np.sqrt(self.rod**2 - elbow[1] ** 2) * (-1 if self.folded else 1)
        slider = np.array([elbow[0] + reach, 0.0])
        section = Rectangle(0.05, 0.05)
        light = Material(2770.0 * self.mass_ratio, self.modulus * self.stiffness_ratio, 0.3)
        elbow, slider, line = turn @ elbow, turn @ slider, turn @ [1.0, 0.0]
        crank = Beam("crank", (0.0, 0.0), tuple(elbow), 2, section, light)
        rod = Beam(
            "rod", tuple(elbow), tuple(slider), 4, section, Material(2770.0, self.modulus, 0.3)
        )
        joints = [
            Pin(crank.at_start, name="bearing"),
            Pin(crank.at_end, rod.at_start, name="elbow"),
            PointOnLine(rod.at_end, direction=tuple(line), name="slider"),
        ]
        start = [InitialVelocity("crank", self.spin, (0.0, 0.0))] if self.spin else []
        gravity = tuple(turn @ [0.0, -9.81])
        return Scene([crank, rod], joints, gravity, start, project_start=bool(self.spin))

    def with_turn(self, angle: float) -> Self:
        """Return it turned about the bearing."""
        return replace(self, turned=angle)

    def reach(self, run: Solution) -> Array:
        """Return the distance of the slider from the bearing along its line, shape (n_t,)."""
        line = np.array([np.cos(self.turned), np.sin(self.turned)])
        return run.position(MaterialPoint("rod", 1.0)) @ line
