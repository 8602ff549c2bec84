"""Vectors of points and turns of sections by the shape functions of the oracle."""

import numpy as np

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
)
from tests.support.oracle import plain_ancf as ancf
from tests.support.oracle import plain_cable

ALL_COLUMNS = ("E", "nu", "rho", "l", "tau", "strain", "h", "w")


def plain_elements(scene):
    """(rows of q, parameters, reference node vectors, oracle rule) of every element."""
    n_s = scene.beams[0].element.n_s
    size, node = n_s * scene.dimension, 0
    for beam in scene.beams:
        shape, parameters = beam.reference(), beam.element_parameters()
        positions = [np.asarray(beam.place, float)]
        for length, chord in zip(shape.lengths, shape.chords, strict=True):
            positions.append(positions[-1] + length * chord)
        rule = {} if shape.straight else {"n_xi": 12, "n_y": 6, "n_z": 6}
        for k in range(beam.element_count):
            slopes = shape.slopes[:, : n_s - 1]
            X_o = [positions[k], *slopes[k], positions[k + 1], *slopes[k + 1]]
            rows = np.arange((node + k) * size, (node + k + 2) * size)
            yield rows, dict(zip(ALL_COLUMNS, parameters[k], strict=False)), np.array(X_o), rule
        node += beam.element_count + 1


def oracle_of(element):
    """The oracle of an element."""
    return plain_cable if element in (CABLE_2D, CABLE_3D) else ancf


def vector_by_hand(system, q, point, quantity):
    """Position (0) or slope (1, 2, 3) of a point by the oracle's shape functions."""
    d = system.naming.layout.d
    place = system.naming.layout.beam(point.beam)
    fractions = np.array(place.fractions)
    k = max(int(np.sum(fractions < point.fraction)) - 1, 0)
    xi = (point.fraction - fractions[k]) / (fractions[k + 1] - fractions[k])
    l = system.naming.lengths[place.first_element + k]
    oracle = oracle_of(system.naming.layout.beams[0].element)
    size = system.naming.layout.bodies[0].stride * d
    first = system.naming.layout.body(point.beam).first_vector * d + k * size
    X = q[first : first + 2 * size].reshape(-1, d)
    if quantity == 0:
        return oracle.shape(d, xi, point.y, point.z, l) @ X
    return oracle.shape_gradient(d, xi, point.y, point.z, l)[:, quantity - 1] @ X


def turns_by_hand(system, q, q_o, point):
    """Turns of a section from the reference: two tilts and those of its two axes, or one turn.

    Of the tangent of a cable in space: two tilts, towards the coordinate axis that is most across.
    """
    n_s, d = system.naming.layout.bodies[0].stride, system.naming.layout.d
    spanning = range(2, n_s) if n_s > 2 else [1]
    now, then = (
        np.array([vector_by_hand(system, x, point, k) for k in spanning]).T for x in (q, q_o)
    )
    y = then[:, 0] / np.linalg.norm(then[:, 0])
    if d == 2:
        return np.array([now[1, 0] * y[0] - now[0, 0] * y[1]])
    if n_s == 2:
        most = np.eye(3)[np.argmin(np.round(np.abs(y), 12))]
        first = most - (most @ y) * y
        first = first / np.linalg.norm(first)
        return np.array([first, np.cross(y, first)]) @ now[:, 0]
    normal = np.cross(*then.T) / np.linalg.norm(np.cross(*then.T))
    map_of_section, z = now @ np.linalg.pinv(then), np.cross(normal, y)
    return np.array([*(normal @ now), z @ map_of_section @ y, y @ map_of_section @ z])
