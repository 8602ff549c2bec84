"""Modes of chains of steel and rubber beams against a frame of cubic elements in 40 digits.

Forces that the rounding of coordinates leaves in steel are a geometric stiffness of 1e-4 to 0.1 of
what bends rubber.
"""

import decimal
from itertools import pairwise

import numpy as np
import pytest
import scipy

from ancfdae import Beam, Clamp, Material, Pin, Revolute, Scene, Spherical, Weld, modes
from ancfdae.modes import precise
from ancfdae.modes.precise import NoModes
from ancfdae.sections import Rectangle

pytestmark = pytest.mark.rounding
STEEL, RUBBER = 2e11, 5e6


def planar_chain(seed, gravity=0.0):
    """A chain of four or six beams in the plane, pinned or clamped at its start."""
    rng = np.random.default_rng([77, seed])
    place, beams = np.zeros(2), []
    for k in range(rng.choice([4, 6])):
        length, along = rng.uniform(0.2, 1.0), rng.standard_normal(2)
        end = place + length * along / np.linalg.norm(along)
        height = length * 10 ** rng.uniform(-3, -2.5)
        modulus = STEEL if (k + seed) % 2 else RUBBER * rng.uniform(0.2, 2.0)
        material = Material(7850.0 if modulus == STEEL else 1100.0, modulus, 0.3)
        section, n = Rectangle(height, height), int(rng.integers(1, 4))
        beams.append(
            Beam(f"b{k}", tuple(place.tolist()), tuple(end.tolist()), n, section, material)
        )
        place = end
    joints = [(Clamp if rng.random() < 0.5 else Pin)(beams[0].at_start)]
    joints += [
        (Weld if rng.random() < 0.5 else Pin)(a.at_end, b.at_start) for a, b in pairwise(beams)
    ]
    return Scene(beams, joints, (0.0, -gravity))


def frame_values(scene, count):
    """The lowest omega^2 of Euler beams with cubic bending, by the inverse in 40 digits."""
    ends, n, elements, held = [], 0, [], []
    for k, beam in enumerate(scene.beams):
        joint = scene.joints[k]
        # u, v at the start are those of the end before, and so is the angle at a weld.
        start = list(ends[-1]) if ends else [0, 1, 2]
        n = max(n, 3)
        if ends and isinstance(joint, Pin):
            start[2], n = n, n + 1
        if not ends:
            held = [0, 1] if isinstance(joint, Pin) else [0, 1, 2]
        for _ in range(beam.elements):
            end = [n, n + 1, n + 2]
            n += 3
            elements.append((beam, start + end))
            start = end
        ends.append(start)
    K, M = digits(np.zeros((n, n))), digits(np.zeros((n, n)))
    for beam, places in elements:
        along = np.subtract(beam.end, beam.start)
        whole = np.linalg.norm(along)
        c, s, l = *(along / whole), whole / beam.elements
        h, E = beam.section.height, beam.material.youngs_modulus
        k, m = np.zeros((6, 6)), np.zeros((6, 6))
        axial, bending = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
        k[axial] = np.array([[1, -1], [-1, 1]])
        m[axial] = np.array([[2, 1], [1, 2]]) / 6
        # In the angles times l.
        m[bending] = (
            np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
            / 420
        )
        k, m = digits(E * h * h / l) * digits(k), digits(beam.material.density * h * h * l * m)
        bent = [[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]
        k[bending] += digits(E * h**4 / 12 / l**3) * digits(np.array(bent, float))
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, l]])
        T = digits(scipy.linalg.block_diag(turn, turn))
        rows = np.ix_(places, places)
        K[rows] += T.T @ k @ T
        M[rows] += T.T @ m @ T
    free = np.setdiff1d(np.arange(n), held)
    K, M = K[np.ix_(free, free)], M[np.ix_(free, free)]
    C, root = inverse(K + M), np.linalg.cholesky(M.astype(float))
    return 1 / np.linalg.eigvalsh(root.T @ C.astype(float) @ root)[::-1][:count] - 1


digits = np.vectorize(decimal.Decimal, otypes=[object])


def inverse(A):
    """The inverse of a positive definite matrix of decimals, by elimination."""
    n = len(A)
    both = np.hstack([A, digits(np.eye(n))])
    for i in range(n):
        both[i] = both[i] / both[i, i]
        for j in np.flatnonzero(both[:, i]):
            if j != i:
                both[j] = both[j] - both[j, i] * both[i]
    return both[:, n:]


@pytest.mark.parametrize("gravity", [0.0, 9.81])
@pytest.mark.parametrize("seed", range(10))
def test_chains_of_steel_and_rubber_vibrate_as_a_frame_of_euler_beams(seed, gravity):
    """Weight out of balance is held there: its reactions at pins and welds turn nothing."""
    with decimal.localcontext(prec=40):
        expected = frame_values(planar_chain(seed), 6)
    found = modes(planar_chain(seed, gravity), 6)
    rigid = np.sum(expected < 1e-7)
    assert np.sum(found.exponents == 0) == rigid
    omega = np.sqrt(expected[rigid:])
    np.testing.assert_allclose(found.frequencies[rigid : len(expected)], omega, rtol=3e-4)


def spatial_chain(seed, gravity=0.0, softer=1.0):
    """A chain of four beams in space, clamped or held by a ball, with welds, hinges and balls."""
    rng = np.random.default_rng([78, seed])
    place, beams = np.zeros(3), []
    for k in range(4):
        length, along = rng.uniform(0.2, 1.0), rng.standard_normal(3)
        end = place + length * along / np.linalg.norm(along)
        height = length * 10 ** rng.uniform(-3, -2)
        steel = (k + seed) % 2
        modulus = STEEL / softer if steel else RUBBER * rng.uniform(0.2, 2.0)
        material = Material(7850.0 if steel else 1100.0, modulus, 0.3)
        section, n = Rectangle(height, 1.3 * height), int(rng.integers(1, 4))
        beams.append(
            Beam(f"b{k}", tuple(place.tolist()), tuple(end.tolist()), n, section, material)
        )
        place = end
    joints = [(Clamp if rng.random() < 0.5 else Spherical)(beams[0].at_start)]
    for a, b in pairwise(beams):
        kind = rng.integers(3)
        hinge = Revolute(a.at_end, (0, 0, 1), b.at_start)
        joints.append([Weld(a.at_end, b.at_start), hinge, Spherical(a.at_end, b.at_start)][kind])
    return Scene(beams, joints, (0.0, -gravity, 0.0))


@pytest.mark.parametrize("seed", range(12))
def test_chains_in_space_are_as_stiff_as_their_rubber_or_the_loads_are_to_be_left_out(seed):
    """Steel ten times softer is as rigid beside rubber; the repair that a refusal names is one."""
    message = ""
    free = modes(spatial_chain(seed), 3)
    softer = modes(spatial_chain(seed, softer=10.0), 3)
    np.testing.assert_allclose(free.frequencies, softer.frequencies, rtol=2e-2)
    try:
        modes(spatial_chain(seed, 9.81), 3)
    except NoModes as refused:
        message = str(refused)
    assert not message or "leave out the loads that are not in balance" in message


@pytest.mark.parametrize("seed", [1, 7, 11, 15, 21])
def test_weight_that_is_held_turns_chains_in_space_whatever_the_steel_is(seed):
    """Joints that turn take the multipliers of the weight, not those of rounded coordinates."""
    hard = modes(spatial_chain(seed, 9.81), 3).exponents ** 2
    soft = modes(spatial_chain(seed, 9.81, softer=10.0), 3).exponents ** 2
    np.testing.assert_allclose(hard, soft, rtol=2e-2, atol=1e-8)


@pytest.mark.parametrize("count", [3, 10])
def test_vectors_beside_the_modes_asked_for_end_the_sweeps_soon(count, monkeypatch):
    """Three sweeps; without the vectors beside them modes took 17 of the same chain."""
    sweeps, ritz = [], precise._ritz
    monkeypatch.setattr(precise, "_ritz", lambda *each: sweeps.append(1) or ritz(*each))
    assert len(modes(spatial_chain(19), count).exponents) >= count
    assert len(sweeps) <= 5
