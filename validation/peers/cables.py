"""Planar cables: a pendulum, a slider-crank with a flexible rod, a cantilever."""

import importlib
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae import (
    CABLE_2D,
    Beam,
    Clamp,
    InitialVelocity,
    Material,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    RigidBody,
    RotationDriver,
    Scene,
)
from ancfdae.extend import MaterialPoint
from ancfdae.laws import ConstantAcceleration
from ancfdae.sections import Rectangle
from validation.peers.pair import GRAVITY, Model, Pair

# Axial strains stay below 1e-3: the two codes measure curvature in ways that differ by them.
_LENGTH, _SIDE, _DENSITY, _MODULUS = 1.2, 0.005, 1000.0, 2e8
_ROPE = Material(_DENSITY, _MODULUS, 0.0)


def _rod(name: str, start: float, end: float, cables: int, side: float = _SIDE) -> Beam:
    materials = [_ROPE] * cables
    section = Rectangle(side, side)
    return Beam(name, (start, 0), (end, 0), cables, section, materials, element=CABLE_2D)


def _ends(rod: Beam) -> list[float]:
    """Return where a rod along x begins and ends."""
    return [float(np.asarray(end)[0]) for end in (rod.start, rod.end)]


def _cables(
    items: Any, mbs: Any, rod: Beam, weight: float, held: list[int] | None = None
) -> tuple[list[int], list[int]]:
    """Add a rod of cables, whose first node keeps what is `held`; return nodes and elements."""
    section, (start, end) = rod.section, _ends(rod)
    assert isinstance(section, Rectangle)
    area = section.height * section.width
    template = items.Cable2D(
        massPerLength=_DENSITY * area,
        bendingStiffness=_MODULUS * area * section.height**2 / 12,
        axialStiffness=_MODULUS * area,
    )
    made = importlib.import_module("exudyn.beams").GenerateBeamElementsAlongLine(
        mbs,
        [start, 0, 0],
        [end, 0, 0],
        rod.elements,
        template,
        gravity=[0, -weight, 0],
        groundConstraintsStart=held,
    )
    return list(made["nodes"]), list(made["elements"])


@final
@dataclass(frozen=True)
class CablePendulum(Pair):
    """A rope, pinned at one end, let go from the horizontal."""

    cables: int

    @property
    def title(self) -> str:
        """Name of the model in the tables of the report."""
        return f"pendulum of {self.cables} cables"

    @property
    def newton(self) -> float:
        """Tolerance of Newton's method: of 1000 cables Exudyn's does not converge to 1e-8."""
        return 1e-8 if self.cables < 1000 else 1e-7

    def scene(self) -> Scene:
        """Return the model as a scene of this package."""
        rope = _rod("rope", 0, _LENGTH, self.cables)
        return Scene([rope], [Pin(rope.at_start)], gravity=(0, -GRAVITY))

    @property
    def point(self) -> MaterialPoint:
        """The point that is compared: the free end."""
        return MaterialPoint("rope", 1.0)

    def design(self) -> list[str]:
        """Return Young's modulus of every cable."""
        return [f"rope.youngs_modulus[{i}]" for i in range(self.cables)]

    def build(self, exu: Any, items: Any, mbs: Any) -> Model:
        """Pin two coordinates of the first node."""
        (rope,) = self.scene().beams
        assert isinstance(rope, Beam)
        nodes, cables = _cables(items, mbs, rope, GRAVITY, [1, 1, 0, 0])

        def vary(i: int, factor: float) -> None:
            axial = factor * _MODULUS * _SIDE**2
            mbs.SetObjectParameter(cables[i], "axialStiffness", axial)
            mbs.SetObjectParameter(cables[i], "bendingStiffness", axial * _SIDE**2 / 12)

        end = exu.OutputVariableType.Position
        return Model(lambda: mbs.GetNodeOutput(nodes[-1], end)[:2], vary)


@final
@dataclass(frozen=True)
class FlexibleSlider(Pair):
    """A rigid crank that turns at a constant rate, a rod of cables, a mass on a line."""

    cables: int
    crank: float = 0.3
    rod: float = 0.8
    side: float = 0.02
    slider: float = 0.2
    rate: float = 10.0

    @property
    def title(self) -> str:
        """Name of the model in the tables of the report."""
        return f"flexible slider-crank, {self.cables} cables"

    @property
    def _bar(self) -> tuple[float, float]:
        mass = _DENSITY * self.side**2 * self.crank
        return mass, mass * self.crank**2 / 12

    @property
    def _swing(self) -> float:
        """Rate of the rod at the start, about the slider."""
        return -self.rate * self.crank / self.rod

    def scene(self) -> Scene:
        """Return the model as a scene of this package."""
        end = self.crank + self.rod
        crank = RigidBody("crank", (self.crank / 2, 0), *self._bar)
        rod = _rod("rod", self.crank, end, self.cables, self.side)
        joints = [
            Pin(crank.at(-self.crank / 2)),
            RotationDriver(crank.origin, ConstantAcceleration(self.rate)),
            Pin(crank.at(self.crank / 2), rod.at_start),
            PointOnLine(rod.at_end, (1, 0)),
        ]
        start = [
            InitialVelocity("crank", self.rate, (0, 0)),
            InitialVelocity("rod", self._swing, (end, 0)),
        ]
        mass = PointMass(rod.at_end, self.slider)
        return Scene([rod], joints, (0, -GRAVITY), start, bodies=[crank, mass])

    @property
    def point(self) -> MaterialPoint:
        """The point that is compared: the slider."""
        return MaterialPoint("rod", 1.0)

    def build(self, exu: Any, items: Any, mbs: Any) -> Model:
        """Constrain the rate of the crank, which needs no function of time."""
        (rod,) = self.scene().beams
        assert isinstance(rod, Beam)
        nodes, _ = _cables(items, mbs, rod, GRAVITY)
        for i, node in enumerate(nodes):
            arm = -self.rod * (1 - i / self.cables)
            mbs.SetNodeParameter(node, "initialVelocities", [0, self._swing * arm, 0, self._swing])
        speed = [0, self.rate * self.crank / 2, self.rate]
        mass, inertia = self._bar
        node = mbs.AddNode(
            items.NodeRigidBody2D(
                referenceCoordinates=[self.crank / 2, 0, 0], initialVelocities=speed
            )
        )
        crank = mbs.AddObject(items.RigidBody2D(mass=mass, inertia=inertia, nodeNumber=node))

        def on_crank(x: float) -> int:
            marker = items.MarkerBodyRigid(bodyNumber=crank, localPosition=[x, 0, 0])
            return int(mbs.AddMarker(marker))

        def coordinate(node: int, which: int) -> int:
            marker = items.MarkerNodeCoordinate(nodeNumber=node, coordinate=which)
            return int(mbs.AddMarker(marker))

        weight = [0, -GRAVITY * mass, 0]
        mbs.AddLoad(items.Force(markerNumber=on_crank(0), loadVector=weight))
        end = mbs.AddNode(items.NodePoint2D(referenceCoordinates=[self.crank + self.rod, 0]))
        slider = mbs.AddObject(items.MassPoint2D(mass=self.slider, nodeNumber=end))
        ground = mbs.AddObject(items.ObjectGround())
        for markers in (
            [mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=ground)), on_crank(-self.crank / 2)],
            [
                on_crank(self.crank / 2),
                mbs.AddMarker(items.MarkerNodePosition(nodeNumber=nodes[0])),
            ],
            [
                mbs.AddMarker(items.MarkerNodePosition(nodeNumber=nodes[-1])),
                mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=slider)),
            ],
        ):
            mbs.AddObject(items.ObjectJointRevolute2D(markerNumbers=markers))
        still = mbs.AddNode(items.NodePointGround())
        line = [coordinate(still, 0), coordinate(end, 1)]
        mbs.AddObject(items.ObjectConnectorCoordinate(markerNumbers=line))
        turn = [coordinate(still, 0), coordinate(node, 2)]
        mbs.AddObject(
            items.ObjectConnectorCoordinate(
                markerNumbers=turn, velocityLevel=True, offset=self.rate
            )
        )
        return Model(lambda: mbs.GetNodeOutput(end, exu.OutputVariableType.Position)[:2])


@final
@dataclass(frozen=True)
class Elastica(Pair):
    """A cantilever with a force P = 3 E I / L^2 across its end."""

    asked = 2.0
    cables: int
    side: float = 0.02

    @property
    def title(self) -> str:
        """Name of the model in the tables of the report."""
        return f"cantilever of {self.cables} cables"

    @property
    def _force(self) -> float:
        return 3 * _MODULUS * self.side**4 / 12 / _LENGTH**2

    def scene(self) -> Scene:
        """Return the model as a scene of this package."""
        rod = _rod("rod", 0, _LENGTH, self.cables, self.side)
        load = PointForce(rod.at_end, (0, -self._force))
        return Scene([rod], [Clamp(rod.at_start)], loads=[load])

    @property
    def point(self) -> MaterialPoint:
        """The point that is compared: the free end."""
        return MaterialPoint("rod", 1.0)

    def build(self, exu: Any, items: Any, mbs: Any) -> Model:
        """Fix position and direction of the first node."""
        (rod,) = self.scene().beams
        assert isinstance(rod, Beam)
        nodes, _ = _cables(items, mbs, rod, 0.0, [1, 1, 0, 1])
        end = mbs.AddMarker(items.MarkerNodePosition(nodeNumber=nodes[-1]))
        mbs.AddLoad(items.Force(markerNumber=end, loadVector=[0, -self._force, 0]))
        return Model(lambda: mbs.GetNodeOutput(nodes[-1], exu.OutputVariableType.Position)[:2])
