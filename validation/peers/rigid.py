"""Rigid bodies: one, chains, a slider-crank."""

import math
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae import (
    InitialVelocity,
    Pin,
    PointMass,
    PointOnLine,
    Revolute,
    RigidBody,
    RigidBox,
    Scene,
    Spherical,
)
from ancfdae.extend import Joint, MaterialPoint
from validation.peers.pair import GRAVITY, Model, Pair

DENSITY, LENGTH, THICKNESS = 1000.0, 0.2, 0.02


@final
@dataclass(frozen=True)
class Chain(Pair):
    """Bars that hang from one another, let go from the horizontal.

    With hinges across the plane of motion, or with spherical joints and a spin about the vertical.
    """

    bodies: int
    revolute: bool

    @property
    def title(self) -> str:
        """Name of the model in the tables of the report."""
        joint = "revolute" if self.revolute else "spherical"
        return f"rigid bodies: {self.bodies}, {joint}"

    def scene(self) -> Scene:
        """Return the model as a scene of this package."""
        box = RigidBox(LENGTH, THICKNESS, THICKNESS)
        bars = [
            RigidBody(f"bar {i}", ((i + 0.5) * LENGTH, 0, 0), shape=box, density=DENSITY)
            for i in range(self.bodies)
        ]
        joints = [self._joint(bars[i], bars[i - 1] if i else None) for i in range(self.bodies)]
        turn = [InitialVelocity(bar.name, (0, 0, self._spin), (0, 0, 0)) for bar in bars]
        return Scene(bodies=bars, joints=joints, gravity=(0, 0, -GRAVITY), start=turn)

    @property
    def _spin(self) -> float:
        return 0.0 if self.revolute else 1.0

    def _joint(self, bar: RigidBody, before: RigidBody | None) -> Revolute | Spherical:
        here = bar.at(-LENGTH / 2)
        other = None if before is None else before.at(LENGTH / 2)
        return Revolute(here, (0, 1, 0), other) if self.revolute else Spherical(here, other)

    @property
    def point(self) -> MaterialPoint:
        """The end of the last bar."""
        return MaterialPoint(f"bar {self.bodies - 1}", x=LENGTH / 2, y=0, z=0)

    def design(self) -> list[str]:
        """Return the densities."""
        return [f"bar {i}.density" for i in range(self.bodies)]

    def build(self, exu: Any, items: Any, mbs: Any) -> Model:
        """Angles of Cardan: fewer coordinates than Euler parameters, and faster."""
        last, spin, bars = mbs.CreateGround(), np.array([0, 0, self._spin]), []
        for i in range(self.bodies):
            centre = [(i + 0.5) * LENGTH, 0, 0]
            bar = mbs.CreateRigidBody(
                referencePosition=centre,
                initialVelocity=list(np.cross(spin, centre)),
                initialAngularVelocity=list(spin),
                inertia=items.InertiaCuboid(DENSITY, [LENGTH, THICKNESS, THICKNESS]),
                gravity=[0, 0, -GRAVITY],
                nodeType=exu.NodeType.RotationRxyz,
            )
            pair, place = [last, bar], [i * LENGTH, 0, 0]
            if self.revolute:
                mbs.CreateRevoluteJoint(itemNumbers=pair, position=place, axis=[0, 1, 0])
            else:
                mbs.CreateSphericalJoint(itemNumbers=pair, position=place)
            bars.append(bar)
            last = bar

        def vary(i: int, factor: float) -> None:
            inertia = items.InertiaCuboid(factor * DENSITY, [LENGTH, THICKNESS, THICKNESS])
            mbs.SetObjectParameter(bars[i], "mass", inertia.mass)
            mbs.SetObjectParameter(bars[i], "inertia", inertia.GetInertia6D())

        place = exu.OutputVariableType.Position
        return Model(lambda: mbs.GetObjectOutputBody(last, place, [LENGTH / 2, 0, 0]), vary)


@final
@dataclass(frozen=True)
class RigidSlider(Pair):
    """A planar slider-crank under gravity: two bars, and a mass on a horizontal line."""

    crank: float = 0.3
    rod: float = 0.8
    slider: float = 0.5
    angle: float = 1.0
    section: float = 4e-4

    @property
    def title(self) -> str:
        """Name of the model in the tables of the report."""
        return "rigid slider-crank"

    @property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Where crank and rod meet, and where the slider is."""
        elbow = self.crank * np.array([math.cos(self.angle), math.sin(self.angle)])
        return elbow, np.array([elbow[0] + math.sqrt(self.rod**2 - elbow[1] ** 2), 0.0])

    def _inertia(self, length: float) -> tuple[float, float]:
        mass = DENSITY * self.section * length
        return mass, mass * length**2 / 12

    def scene(self) -> Scene:
        """Return the model as a scene of this package."""
        elbow, end = self._places
        tilt = -math.asin(elbow[1] / self.rod)
        bars = []
        for name, length, centre, angle in (
            ("crank", self.crank, elbow / 2, self.angle),
            ("rod", self.rod, (elbow + end) / 2, tilt),
        ):
            axes = ((math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle)))
            bars.append(RigidBody(name, tuple(centre), *self._inertia(length), frame=axes))
        crank, rod = bars
        here, there = crank.at(self.crank / 2), rod.at(-self.rod / 2)
        joints: list[Joint] = [Pin(crank.at(-self.crank / 2)), Pin(here, there)]
        joints.append(PointOnLine(self.point, (1.0, 0.0)))
        mass = PointMass(self.point, self.slider)
        return Scene(bodies=[*bars, mass], joints=joints, gravity=(0, -GRAVITY))

    @property
    def point(self) -> MaterialPoint:
        """The point that is compared: the slider."""
        return MaterialPoint("rod", x=self.rod / 2, y=0)

    def build(self, exu: Any, items: Any, mbs: Any) -> Model:
        """Build the model in Exudyn: three coordinates per bar, two of the slider."""
        elbow, end = self._places

        def marker(body: int, x: float) -> int:
            return int(
                mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localPosition=[x, 0, 0]))
            )

        def bar(length: float, centre: np.ndarray, angle: float) -> int:
            mass, inertia = self._inertia(length)
            node = mbs.AddNode(items.NodeRigidBody2D(referenceCoordinates=[*centre, angle]))
            body = mbs.AddObject(items.RigidBody2D(mass=mass, inertia=inertia, nodeNumber=node))
            weight = [0, -GRAVITY * mass, 0]
            mbs.AddLoad(items.Force(markerNumber=marker(body, 0), loadVector=weight))
            return int(body)

        crank = bar(self.crank, elbow / 2, self.angle)
        rod = bar(self.rod, (elbow + end) / 2, -math.asin(elbow[1] / self.rod))
        node = mbs.AddNode(items.NodePoint2D(referenceCoordinates=list(end)))
        slider = mbs.AddObject(items.MassPoint2D(mass=self.slider, nodeNumber=node))
        on_slider = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=slider))
        ground = mbs.AddMarker(
            items.MarkerBodyPosition(bodyNumber=mbs.AddObject(items.ObjectGround()))
        )
        for markers in (
            [ground, marker(crank, -self.crank / 2)],
            [marker(crank, self.crank / 2), marker(rod, -self.rod / 2)],
            [marker(rod, self.rod / 2), on_slider],
        ):
            mbs.AddObject(items.ObjectJointRevolute2D(markerNumbers=markers))
        height = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=1))
        fixed = mbs.AddMarker(
            items.MarkerNodeCoordinate(
                nodeNumber=mbs.AddNode(items.NodePointGround()), coordinate=0
            )
        )
        mbs.AddObject(items.ObjectConnectorCoordinate(markerNumbers=[fixed, height]))
        return Model(lambda: mbs.GetNodeOutput(node, exu.OutputVariableType.Position))
