"""Linear rods with a curved and twisted axis, by the principle of virtual forces.

Written from beam theory, independently of ``ancfdae``; it must never import it. The rod is a helix:
its frame (normal, y, z; columns) turns at constant rates (twist, about y, about z) in its own axes.
Clamped at its start, it carries a force and a moment at its end, so that its section forces are
known; strains follow from the compliance of the section, displacements from their work.
"""

import numpy as np
import scipy


def skew(k):
    """Return the matrix of k x."""
    return np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])


def helix(rates, s):
    """Return the place and the frame at arc length s, from the origin and unit axes on."""
    step = np.zeros((4, 4))
    step[:3, :3], step[0, 3] = skew(rates), 1.0
    motion = scipy.linalg.expm(s * step)
    return motion[:3, 3], motion[:3, :3]


def compliance(E, nu, area, I_y, I_z, J, factors, rates, centre=(0.0, 0.0)):
    """Strains (eps, shears, twist, curvatures) about the axis per (N, V_y, V_z, T, M_y, M_z).

    I_y = int y^2 dA resists M_z. Of the pretwist its first order counts, E twist (I_p - J) between
    stretch and twist; the section bends and twists about `centre`, whose line is longer or shorter
    than the axis.
    """
    G = E / (2 * (1 + nu))
    K = np.diag([E * area, factors[0] * G * area, factors[1] * G * area, G * J, E * I_z, E * I_y])
    K[0, 3] = K[3, 0] = E * rates[0] * (I_y + I_z - J)
    # Moments about the axis are those about the centre plus its arm times the forces.
    moved = np.eye(6)
    moved[3:, :3] = skew((0.0, *centre))
    length = 1 - rates[2] * centre[0] + rates[1] * centre[1]
    return length * np.linalg.inv(moved @ K @ moved.T)


def tip(rates, length, C, force, moment, pieces=200):
    """Return displacement and turn of the end."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    end, _ = helix(rates, length)
    displacement, turn = np.zeros(3), np.zeros(3)
    for k in range(pieces):
        for node, weight in zip(nodes, weights, strict=True):
            place, R = helix(rates, length * (k + (1 + node) / 2) / pieces)
            arm = end - place
            forces = np.concatenate([R.T @ force, R.T @ (np.cross(arm, force) + moment)])
            strains = C @ forces * weight / 2 * length / pieces
            bend = R @ strains[3:]
            displacement += R @ strains[:3] + np.cross(bend, arm)
            turn += bend
    return displacement, turn
