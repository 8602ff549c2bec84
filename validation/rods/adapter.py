"""Scenes of cosseratbench's scenarios, and their motion as its trajectories.

Rods that are clamped are spatial beams, others cables. Beams have a Poisson ratio of 0.3: the shear
modulus of the scenarios, a third of Young's modulus, belongs to an incompressible material. Where
an end is turned, the torsion constant of the section makes up for it. Results of scenarios that ask
for an equilibrium are equilibria. Where rods cross, a damped motion lays them on each other before.
Rods on a cylinder, rods with an end that is turned, and a rope that is lowered and touches itself
are damped motions.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ancfdae import (
    BEAM_3D,
    CABLE_3D,
    HHT,
    AdaptiveSteps,
    Beam,
    BeamContact,
    BeamPairContact,
    Clamp,
    Cylinder,
    Cylindrical,
    Material,
    MovingSupport,
    NodalState,
    Pin,
    Plane,
    PointForce,
    Radau,
    RotationDriver,
    Scene,
    equilibrium,
    simulate,
)
from ancfdae.laws import Spline
from ancfdae.numerics.arrays import Array
from ancfdae.sections import Circle, GeneralSection

# Depth of a contact under a line load, over the radius of the rod, and the slip over the duration,
# in radii, of a contact at its limit of friction; its restitution.
_DEPTH, _SLIP = 1e-2, 0.2
_BOUNCE: dict[str, Any] = {"restitution": 0.2, "impact_speed": 0.1}
# Steps of the motion of a rope that heaps up in a frame, its slip speed, m/s, the time in which its
# clamp starts and stops, s, and the reach of its neighbours, in radii.
_HEAP_STEPS, _HEAP_SLIP, _EASED, _REACH = 90, 5e-3, 0.1, 8.0
# Steps of a motion in a frame, and damping time of rods on their way to rest, s.
_STEPS, _REST_STEPS, _DAMPED = 4, 8, 0.02
# Part of the duration in which rods come to lie on each other.
_LANDING = 0.05
# Poisson's ratio, and the largest twist of an element, rad (docs/howto/elements.md).
_NU, _TWIST = 0.3, 0.1


class AncfSolver:
    """The package as a solver of cosseratbench."""

    name = "ancfdae"

    def __init__(self, capabilities: frozenset[Any], trajectory: Any, transport: Any) -> None:
        """Take the classes of the package that results are made of."""
        self.capabilities, self._trajectory, self._transport = capabilities, trajectory, transport

    def run(self, scenario: Any, *, n_elements: int, n_frames: int) -> Any:
        """Return the trajectory of a scenario."""
        # Elements that are twisted must be short; trajectories have the nodes that are asked for.
        finer = max(_finer(rod, n_elements) for rod in scenario.rods)
        times = np.linspace(0.0, scenario.duration, n_frames)
        frames = _frames(scene_of(scenario, finer * n_elements), scenario, times)
        nodes = [each[:, ::finer] for each in frames]
        directors = [
            np.stack([self._director(rod, x) for x in each])
            for rod, each in zip(scenario.rods, nodes, strict=True)
        ]
        return self._trajectory(times, tuple(x[:, :, 0] for x in nodes), tuple(directors))

    def _director(self, rod: Any, nodes: Array) -> Any:
        """Return directions across the elements, (n, 3), from vectors of the nodes, (n + 1, k, 3).

        They turn with the sections of a rod that is twisted, whose normal is the section's z.
        """
        if rod.end_motion is None:
            return self._transport(nodes[:, 0], np.asarray(rod.normal, float))
        z = nodes[:-1, 3] + nodes[1:, 3]
        return z / np.linalg.norm(z, axis=1, keepdims=True)


def _finer(rod: Any, n: int) -> int:
    """Return into how many elements each of n is divided, so that none twists much."""
    turns = 0.0 if rod.end_motion is None else np.linalg.norm(rod.end_motion.rotation, axis=1).max()
    return max(1, int(np.ceil(turns / (n * _TWIST))))


def _frames(scene: Scene, scenario: Any, times: Array) -> list[Array]:
    """Return vectors of the nodes of each rod at times, (n_t, n + 1, vectors, 3)."""
    frame = float(times[1])
    turned = any(rod.end_motion for rod in scenario.rods)
    if scenario.obstacles and scenario.self_contact:
        return _motion(scene, times, HHT(frame / _HEAP_STEPS))
    if scenario.obstacles:
        return _motion(scene, times, Radau(AdaptiveSteps(1e-4)))
    if turned or not scenario.quasi_static:
        return _motion(scene, times, HHT(frame / _STEPS, hht_alpha=-0.05 if turned else -0.01))
    if len(scenario.rods) == 1:
        path = equilibrium(scene).solution.nodes(scene.beams[0].name)
        return [path[[0] + [-1] * (len(times) - 1)]]
    landing = times[times <= _LANDING * times[-1]]
    landed = _motion(scene, landing, HHT(frame / _REST_STEPS, hht_alpha=-0.3))
    names = [beam.name for beam in scene.beams]
    states = [NodalState(name, x[-1]) for name, x in zip(names, landed, strict=True)]
    at_rest = equilibrium(replace(scene, start=states)).solution
    held = [at_rest.nodes(name)[[-1] * (len(times) - len(landing))] for name in names]
    return [np.concatenate(both) for both in zip(landed, held, strict=True)]


def _motion(scene: Scene, times: Array, integrator: HHT | Radau) -> list[Array]:
    """Return vectors of the nodes of each rod in a motion; FloatingPointError with its outcome."""
    run = simulate(scene, float(times[-1]), integrator)
    if not run.outcome.success:
        raise FloatingPointError(str(run.outcome))
    at = run.at(np.minimum(times, run.t[-1]))
    return [at.nodes(beam.name) for beam in scene.beams]


def scene_of(scenario: Any, n: int) -> Scene:
    """Return the scene of a scenario, with n elements in each rod."""
    beams, starts = list[Beam](), list[NodalState]()
    joints, loads = list[Any](), list[Any]()
    turned = any(rod.end_motion for rod in scenario.rods)
    moving = bool(scenario.obstacles) or len(scenario.rods) > 1 or turned
    damping = _DAMPED if scenario.quasi_static and moving else 0.0
    for number, rod in enumerate(scenario.rods):
        beam, state = _beam(f"rod{number}", rod, n, damping)
        beams.append(beam)
        starts += [] if state is None else [state]
        ends = (rod.start, beam.at_start, 0), (rod.end, beam.at_end, -1)
        for end, at, index in ends:
            place = rod.centerline[index]
            if index == 0 and rod.start_motion is not None:
                joints.append(_lowered(beam, rod.start_motion, scenario.duration))
            elif end.value == "pinned":
                joints.append(Pin(at, ground=tuple(map(float, place))))
            elif end.value == "clamped" and (index == 0 or rod.end_motion is None):
                joints.append(Clamp(at))
        joints += _turning(beam, rod.end_motion)
        loads += [
            PointForce(beam.at_start if x.at.value == "start" else beam.at_end, x.force)
            for x in rod.loads
        ]
        loads += [_touching(beam.name, rod, x, scenario) for x in scenario.obstacles]
        loads += (
            [_heaped(beam.name, rod, scenario)]
            if scenario.obstacles and scenario.self_contact
            else []
        )
    # Rods without weight do not press on each other.
    for k, rod in enumerate(scenario.rods if any(scenario.gravity) else ()):
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


def _lowered(beam: Beam, motion: Any, duration: float) -> MovingSupport:
    """Return the support of a clamp that moves, without the corners of its motion."""
    t = np.linspace(0.0, duration, 1 + int(2 * duration / _EASED))
    before = np.linspace(0.0, _EASED, 101)[:, None]
    way = np.linalg.norm(motion.displacement, axis=1)
    travel = np.interp(t - before, motion.times, way).mean(axis=0)
    return MovingSupport(beam.at_start, motion.displacement[-1], Spline(t, travel))


def _heaped(beam: str, rod: Any, scenario: Any) -> BeamPairContact:
    """Return the contact of a rope with itself: a tenth of its weight on a crossing."""
    k_n = 0.1 * _weight(rod, scenario) * rod.length / (2 * rod.radius)
    return BeamPairContact(
        beam,
        beam,
        points_per_element=8,
        stiffness=k_n / (10 * _DEPTH * rod.radius),
        exponent=1.0,
        **_BOUNCE,
        radius=rod.radius,
        friction=rod.friction,
        slip_speed=_HEAP_SLIP,
        reach=_REACH * rod.radius,
        name="own",
    )


def _turning(beam: Beam, motion: Any) -> list[Any]:
    """Return the joints of an end that is turned about its axis and slides along it."""
    if motion is None:
        return []
    axis = tuple(map(float, motion.slides_along))
    angle = Spline(motion.times, np.asarray(motion.rotation) @ np.asarray(axis))
    return [Cylindrical(beam.at_end, axis), RotationDriver(beam.at_end, angle, axis)]


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
    material = Material(m.density, m.youngs_modulus, _NU, damping_time=damping)
    along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    if rod.start_motion is not None:  # The clamp holds its section straight.
        tangents[0] = along
    element = BEAM_3D if clamped else CABLE_3D
    end = points[0] + rod.length * along
    beam = Beam(name, points[0], end, n, _section(rod), material, element=element)
    if spline is None and clamped:  # It starts straight.
        return beam, None
    vectors = [places, tangents]
    if clamped:  # The section's z is the rod's normal.
        z = np.tile(np.asarray(rod.normal, float), (n + 1, 1))
        vectors += [np.cross(z, tangents), z]
    return beam, NodalState(name, np.stack(vectors, axis=1))


def _section(rod: Any) -> Circle | GeneralSection:
    """Return the circle; where the rod is twisted, with the torsional stiffness of its material."""
    if rod.end_motion is None:
        return Circle(rod.radius)
    m, I = rod.material, rod.second_moment_of_area
    G = m.youngs_modulus / (2 * (1 + _NU))
    return GeneralSection(rod.area, I, I, 2 * I * m.shear_modulus / G)


def _touching(beam: str, rod: Any, obstacle: Any, scenario: Any) -> BeamContact:
    """Return the contact of a rod with a fixed obstacle."""
    friction = max(rod.friction, obstacle.friction)
    if obstacle.kind == "cylinder":
        shape: Any = Cylinder(obstacle.center, obstacle.axis, obstacle.radius)
        load = _weight(rod, scenario) * (rod.length / obstacle.radius)
    else:
        shape, load = Plane(obstacle.point, obstacle.normal), _weight(rod, scenario)
    law: dict[str, Any] = (
        {}
        if not friction
        else {
            "friction": friction,
            "slip_speed": _HEAP_SLIP
            if scenario.self_contact
            else _SLIP * rod.radius / scenario.duration,
        }
    )
    return BeamContact(
        beam,
        shape,
        stiffness=load / (_DEPTH * rod.radius),
        exponent=1.0,
        radius=rod.radius,
        **_BOUNCE,
        **law,
    )
