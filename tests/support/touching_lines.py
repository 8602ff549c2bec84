"""Cables and beams that touch themselves: lines, the scenes of them, and a loop that closes."""

import numpy as np

from ancfdae import BEAM_3D, CABLE_3D, Beam, BeamPairContact, Material, NodalState, Scene
from ancfdae.sections import Circle
from tests.support.contacts import UNITS

SOFT = Material(1000.0, 1e5, 0.3)
LAW = {"restitution": 0.7, "impact_speed": 1.0}
RUBS = {"friction": 0.3, "slip_speed": 0.05}
R = 0.01


def along(curve, n, a=0.0, b=1.0):
    """Nodes of a line in n elements of equal length: positions, unit tangents, and its length."""
    u = np.linspace(a, b, 20001)
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve(u), axis=0), axis=1)))
    at, e = np.interp(np.linspace(0.0, arc[-1], n + 1), arc, u), 1e-5
    tangents = curve(at + e) - curve(at - e)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    return np.stack([curve(at), tangents], axis=1), arc[-1]


def coil(u, pitch=0.018, turns=3.0):
    a = 2 * np.pi * turns * u
    return np.stack([0.1 * np.cos(a), 0.1 * np.sin(a), pitch * turns * u], axis=-1)


def scene_of(nodes, length, velocities=None, unit="m", element=CABLE_3D, start=(), **law):
    """A line that touches itself, in its own reference length and without gravity."""
    scale, mass, away = UNITS[unit]
    n, d = len(nodes) - 1, nodes.shape[2]
    end = np.eye(d)[0] * length * scale
    soft = Material(SOFT.density * mass / scale**3, SOFT.youngs_modulus * mass / scale, 0.3)
    rope = Beam("rope", (0.0,) * d, end, n, Circle(R * scale), soft, element=element)
    law = {"stiffness": 1e5, "radius": R * scale, "points_per_element": 8, **law}
    exponent = law.get("exponent", 1.5)
    # A force per length over a length^m.
    law["stiffness"] *= mass / scale ** (1 + exponent) * scale
    speeds = ("impact_speed", "slip_speed")
    law = {x: y * scale if x in speeds else y for x, y in law.items()}
    touch = BeamPairContact("rope", "rope", name="touch", **law)
    units = np.array([scale, *[1.0] * (nodes.shape[1] - 1)])[:, None]
    X = nodes * units
    X[:, 0] += away
    V = None if velocities is None else velocities * units
    return Scene([rope], loads=[touch], start=[NodalState("rope", X, V), *start]), rope


def clash(n=16, element=CABLE_3D, speed=0.5, unit="m", **law):
    """A loop of 1.3 turns without gravity, the ends of which fly at each other."""
    nodes, length = along(lambda u: coil(u, 0.022, 1.3), n)
    V = np.zeros_like(nodes)
    V[:, 0, 2] = -speed * np.linspace(-1.0, 1.0, n + 1)
    V[:, 1, 2] = -2 * speed / length
    if element is BEAM_3D:
        z = np.array([0.0, 0.0, 1.0])
        y = np.cross(z, nodes[:, 1])
        y /= np.linalg.norm(y, axis=1)[:, None]
        nodes = np.concatenate([nodes, y[:, None], np.cross(nodes[:, 1], y)[:, None]], axis=1)
        V = np.concatenate([V, 0 * V], axis=1)
    return scene_of(nodes, length, V, unit, element, **law)
