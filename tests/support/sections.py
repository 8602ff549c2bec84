"""Forces and axes of the sections of beams."""

import numpy as np

from ancfdae import (
    CABLE_2D,
)
from ancfdae.sensitivity.observables.sections import (
    axial_force,
    bending_moment,
    shear_force,
    torsional_moment,
)


def forces(point, d):
    """All forces and moments of a section of a beam in d dimensions."""
    if d == 2:
        return [axial_force(point), shear_force(point), bending_moment(point)]
    shears = [shear_force(point, along) for along in (1, 2)]
    moments = [bending_moment(point, about) for about in (1, 2)]
    return [axial_force(point), *shears, torsional_moment(point), *moments]


def section_axes(solution, point):
    """Normal, height and width axis of a section."""
    if solution.naming.layout.d == 2:
        if solution.naming.layout.beams[0].element is CABLE_2D:
            n = solution.slope(point)[0]
            n = n / np.linalg.norm(n)
            return np.array([n, [-n[1], n[0]]])
        y = solution.slope(point, 1)[0]
        y = y / np.linalg.norm(y)
        return np.array([[y[1], -y[0]], y])
    y, z = (solution.slope(point, along)[0] for along in (1, 2))
    n, y = np.cross(y, z), y / np.linalg.norm(y)
    n = n / np.linalg.norm(n)
    return np.array([n, y, np.cross(n, y)])
