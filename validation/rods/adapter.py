"""Scenes of cosseratbench's scenarios, and their motion as its trajectories.

Rods that are clamped are spatial beams, others cables. Beams have a Poisson ratio of 0.3: the shear
modulus of the scenarios, a third of Young's modulus, belongs to an incompressible material. Results
of scenarios that ask for an equilibrium are equilibria. Where rods touch something they are motions
that come to rest, with material damping and numerical damping.
"""

from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ancfdae import (
    BEAM_3D,
    CABLE_3D,
    HHT,
    Beam,
    BeamContact,
    BeamPairContact,
    Clamp,
    Cylinder,
    Material,
    NodalState,
    Pin,
    Plane,
    PointForce,
    Scene,
    equilibrium,
    simulate,
)
from ancfdae.sections import Circle

# Depth of a contact under a line load, over the radius of the rod, and the slip over the duration,
# in radii, of a contact at its limit of friction; its restitution.
_DEPTH, _SLIP = 1e-2, 0.2
_BOUNCE: dict[str, Any] = {"restitution": 0.2, "impact_speed": 0.1}
# Steps of a motion in a frame, and damping time of rods that touch on their way to rest, s.
_STEPS, _REST_STEPS, _DAMPED = 4, {"cylinder": 20, "rods": 8}, 0.02


class AncfSolver:
    """The package as a solver of cosseratbench; other scenarios raise NotImplementedError."""

    name = "ancfdae"

    def __init__(self, capabilities: frozenset[Any], trajectory: Any, transport: Any) -> None:
        """Take the classes of the package that results are made of."""
        self.capabilities, self._trajectory, self._transport = capabilities, trajectory, transport

    def run(self, scenario: Any, *, n_elements: int, n_frames: int) -> Any:
        """Return the trajectory of a scenario."""
        if any(rod.start_motion or rod.end_motion for rod in scenario.rods):
            raise NotImplementedError("ends that are turned and slide under a load")
        if scenario.self_contact:
            raise NotImplementedError("rods that touch themselves")
        scene = scene_of(scenario, n_elements)
        times = np.linspace(0.0, scenario.duration, n_frames)
        touching = bool(scenario.obstacles) or len(scenario.rods) > 1
        if scenario.quasi_static and not touching:
            solution = equilibrium(scene).solution
            places = [solution.nodes(beam.name)[-1, :, 0] for beam in scene.beams]
            first = [rod.nodes(n_elements) for rod in scenario.rods]
            positions = [
                np.stack([x, *[y] * (n_frames - 1)]) for x, y in zip(first, places, strict=True)
            ]
        else:
            kind = "cylinder" if scenario.obstacles else "rods"
            parts = _REST_STEPS[kind] if touching else _STEPS
            step = scenario.duration / (parts * (n_frames - 1))
            integrator = HHT(step, hht_alpha=-0.3 if scenario.quasi_static else -0.01)
            run = simulate(scene, scenario.duration, integrator)
            if run.t[-1] < 0.999 * scenario.duration:
                raise FloatingPointError(str(run.outcome))
            at = run.at(times)
            positions = [at.nodes(beam.name)[:, :, 0] for beam in scene.beams]
        directors = [
            np.stack([self._transport(x, np.asarray(rod.normal, float)) for x in each])
            for rod, each in zip(scenario.rods, positions, strict=True)
        ]
        return self._trajectory(times, tuple(positions), tuple(directors))


def scene_of(scenario: Any, n: int) -> Scene:
    """Return the scene of a scenario, with n elements in each rod."""
    beams, starts = list[Beam](), list[NodalState]()
    joints, loads = list[Any](), list[Any]()
    touching = bool(scenario.obstacles) or len(scenario.rods) > 1
    damping = _DAMPED if scenario.quasi_static and touching else 0.0
    for number, rod in enumerate(scenario.rods):
        beam, state = _beam(f"rod{number}", rod, n, damping)
        beams.append(beam)
        starts += [] if state is None else [state]
        ends = (rod.start, beam.at_start, 0), (rod.end, beam.at_end, -1)
        for end, at, index in ends:
            place = rod.centerline[index]
            if end.value == "pinned":
                joints.append(Pin(at, ground=tuple(map(float, place))))
            elif end.value == "clamped":
                joints.append(Clamp(at))
        loads += [
            PointForce(beam.at_start if x.at.value == "start" else beam.at_end, x.force)
            for x in rod.loads
        ]
        loads += [_touching(beam.name, rod, x, scenario) for x in scenario.obstacles]
    for k, rod in enumerate(scenario.rods):
        for j in range(k):
            # All of its weight on a part of the length of a diameter.
            k_n = _weight(rod, scenario) * rod.length / (2 * rod.radius)
            loads.append(
                BeamPairContact(
                    beams[k].name,
                    beams[j].name,
                    points_per_element=16,
                    stiffness=k_n / (_DEPTH * rod.radius),
                    exponent=1.0,
                    **_BOUNCE,
                    radius=rod.radius,
                    other_radius=scenario.rods[j].radius,
                    reach=0.2 * rod.length,
                    name=f"pair{k}{j}",
                )
            )
    return Scene(beams, joints, scenario.gravity, starts, loads)


def _weight(rod: Any, scenario: Any) -> float:
    """Return the weight of a rod per length, N/m."""
    return float(rod.material.density * rod.area * np.linalg.norm(scenario.gravity))


def _beam(name: str, rod: Any, n: int, damping: float) -> tuple[Beam, NodalState | None]:
    """Return a rod as a straight beam, and its nodes at the start."""
    points = np.asarray(rod.centerline, dtype=float)
    arc = rod._arc()
    spline = CubicSpline(arc, points) if len(points) > 3 else None
    s = np.linspace(0.0, arc[-1], n + 1)
    places = rod.nodes(n) if spline is None else spline(s)
    chord = (points[-1] - points[0]) / arc[-1]
    tangents = np.tile(chord, (n + 1, 1)) if spline is None else spline(s, 1)
    clamped = "clamped" in (rod.start.value, rod.end.value)
    m = rod.material
    material = Material(m.density, m.youngs_modulus, 0.3, damping_time=damping)
    along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    element = BEAM_3D if clamped else CABLE_3D
    end = points[0] + rod.length * along
    beam = Beam(name, points[0], end, n, Circle(rod.radius), material, element=element)
    if clamped:  # It starts straight.
        return beam, None
    return beam, NodalState(name, np.stack([places, tangents], axis=1))


def _touching(beam: str, rod: Any, obstacle: Any, scenario: Any) -> BeamContact:
    """Return the contact of a rod with a fixed obstacle."""
    friction = max(rod.friction, obstacle.friction)
    if obstacle.kind == "cylinder":
        shape: Any = Cylinder(obstacle.center, obstacle.axis, obstacle.radius)
        load = _weight(rod, scenario) * (rod.length / obstacle.radius)
    else:
        shape, load = Plane(obstacle.point, obstacle.normal), _weight(rod, scenario)
    law: dict[str, Any] = {} if not friction else {
        "friction": friction, "slip_speed": _SLIP * rod.radius / scenario.duration
    }  # fmt: skip
    return BeamContact(
        beam,
        shape,
        stiffness=load / (_DEPTH * rod.radius),
        exponent=1.0,
        radius=rod.radius,
        **_BOUNCE,
        **law,
    )
