"""Random mechanisms: chains, four-bars and crank-sliders of beams of mixed materials, by seeds."""

from itertools import pairwise

import numpy as np

from ancfdae import (
    Beam,
    InitialVelocity,
    Material,
    Pin,
    PointMass,
    PointOnLine,
    RotationDriver,
    Scene,
    Spherical,
)
from ancfdae.laws import RunUp
from ancfdae.sections import Rectangle

MATERIALS = {
    "rubber": (1100.0, 5e6, 0.4),
    "plastic": (1400.0, 2e9, 0.35),
    "aluminium": (2700.0, 7e10, 0.3),
    "steel": (7850.0, 2.1e11, 0.3),
}


def _beam(rng, name, start, end):
    density, modulus, nu = MATERIALS[rng.choice(list(MATERIALS))]
    damping = rng.choice([0.0, 0.0, 0.0, 1e-4])
    length = np.linalg.norm(np.subtract(end, start))
    height, width = length * rng.uniform(0.01, 0.05, 2)
    section, material = Rectangle(height, width), Material(density, modulus, nu, damping)
    return Beam(
        name, tuple(start), tuple(end), int(rng.integers(1, 5)), section, material,
        rigid=bool(rng.random() < 0.15),
    )  # fmt: skip


def _chain(rng, d):
    points, angle = [np.zeros(d)], rng.uniform(-np.pi, 0.3)
    for _ in range(rng.integers(1, 4)):
        angle += rng.uniform(-1.0, 1.0)
        along = [np.cos(angle), np.sin(angle), 0.3 * rng.uniform(-1, 1)][:d]
        points.append(points[-1] + rng.uniform(0.2, 0.6) * np.array(along))
    beams = [_beam(rng, f"b{k}", *points[k : k + 2]) for k in range(len(points) - 1)]
    kind = Pin if d == 2 else Spherical
    joints = [kind(beams[0].at_start)]
    joints += [kind(a.at_end, b.at_start) for a, b in pairwise(beams)]
    spin, start = rng.uniform(-6, 6), []
    if d == 2 and rng.random() < 0.5:
        start = [InitialVelocity(b.name, spin, (0, 0)) for b in beams]
    bodies = [PointMass(beams[-1].at_end, rng.uniform(0.05, 0.5))] if rng.random() < 0.4 else []
    return beams, joints, start, bodies, rng.uniform(0.5, 1.5)


def _four_bar(rng):
    base, crank = rng.uniform(0.5, 0.9), rng.uniform(0.1, 0.2)
    points = [(0, 0), (0, crank), (base, rng.uniform(0.4, 0.6)), (base, 0)]
    beams = [_beam(rng, n, points[k], points[k + 1]) for k, n in enumerate("abc")]
    a, b, c = beams
    joints = [Pin(a.at_start), Pin(a.at_end, b.at_start), Pin(b.at_end, c.at_start), Pin(c.at_end)]
    speed = rng.uniform(2, 15)
    if rng.random() < 0.6:
        joints.append(RotationDriver(a.at_start, RunUp(speed, rng.uniform(0.05, 0.3))))
    return beams, joints, [], [], 2 * np.pi / speed


def _slider(rng):
    crank, rod = rng.uniform(0.1, 0.2), rng.uniform(0.4, 0.7)
    a = _beam(rng, "a", (0, 0), (0, crank))
    b = _beam(rng, "b", (0, crank), (np.sqrt(rod**2 - crank**2), 0))
    joints = [Pin(a.at_start), Pin(a.at_end, b.at_start), PointOnLine(b.at_end, direction=(1, 0))]
    speed = rng.uniform(2, 20)
    joints.append(RotationDriver(a.at_start, RunUp(speed, rng.uniform(0.05, 0.3))))
    return [a, b], joints, [], [PointMass(b.at_end, rng.uniform(0.05, 0.5))], 2 * np.pi / speed


def mechanism(seed):
    """A scene and the time of a motion."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(["chain", "chain", "spatial", "four-bar", "slider"])
    parts = {
        "chain": lambda: _chain(rng, 2),
        "spatial": lambda: _chain(rng, 3),
        "four-bar": lambda: _four_bar(rng),
        "slider": lambda: _slider(rng),
    }
    beams, joints, start, bodies, t_end = parts[kind]()
    gravity = (0, -9.81, 0)[: beams[0].dimension]
    return Scene(beams, joints, gravity, start, bodies=bodies, project_start=True), float(t_end)
