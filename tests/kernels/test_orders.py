"""Orders of unknowns: coordinates before their multipliers, narrow bands, little fill."""

import numpy as np
import pytest
import scipy

from ancfdae import Beam, Clamp, Material, Scene, Spherical, assemble
from ancfdae.kernels import narrow_order
from ancfdae.numerics.linear_solvers import SaddlePoint, little_fill
from ancfdae.sections import Rectangle

SECTION, MATERIAL = Rectangle(height=0.05, width=0.05), Material(2770, 1e9, 0.3)
# Coordinates of a spatial element: two nodes of a position and three slopes.
OF_ELEMENT = 24


def chain(elements):
    beam = Beam("beam", (0, 0, 0), (1, 0, 0), elements, SECTION, MATERIAL)
    return assemble(Scene([beam], [Clamp(beam.at_start)]))


def star(arms, elements):
    angles = 2 * np.pi * np.arange(arms) / arms
    ends = [(float(np.cos(x)), float(np.sin(x)), 0.0) for x in angles]
    beams = [
        Beam(f"arm{k}", (0, 0, 0), end, elements, SECTION, MATERIAL) for k, end in enumerate(ends)
    ]
    first, *others = beams
    joints = [Spherical(arm.at_start, first.at_start) for arm in others]
    return assemble(Scene(beams, [Clamp(first.at_end), *joints]))


def solver_of(system):
    values = system.constraint_q(0.0, system.start()[0])
    return SaddlePoint(system.pattern, system.constraint_pattern, system.weights, values)


def narrow_band(pattern, constraint_pattern):
    return narrow_order(*pattern.places, *constraint_pattern.places)


@pytest.mark.parametrize("order", [narrow_band, little_fill])
@pytest.mark.parametrize("system", [chain(4), star(3, 2)], ids=["chain", "star"])
def test_multipliers_stand_behind_their_coordinates(order, system):
    found = order(system.pattern, system.constraint_pattern)
    place = np.empty_like(found)
    place[found] = np.arange(len(found))
    assert np.array_equal(np.sort(found), np.arange(system.n_q + system.n_lam))
    B = system.constraint_pattern
    assert np.all(place[system.n_q + B.rows] > place[B.columns])


def test_a_star_fills_nothing_but_blocks_of_elements():
    system = star(5, 20)
    B = system.constraint_q(0.0, system.start()[0])
    # No entry is zero, as in tangents of deformed elements.
    weights = np.sqrt(system.weights)
    size = weights[system.pattern.rows] * weights[system.pattern.columns]
    K = system.mass(None) + 0.003 * np.random.default_rng(1).uniform(-1, 1, len(size)) * size
    lu = solver_of(system).factor(K, B).solver.args[0]
    assert isinstance(lu, scipy.sparse.linalg.SuperLU)
    entries = system.pattern.size + 2 * system.constraint_pattern.size
    # From the ends of arms to the middle, elimination of a node fills only what its element
    # couples; joints add their few rows. In the order of SuperLU's choice it is 2.5 times.
    assert lu.L.nnz + lu.U.nnz < 1.2 * entries
