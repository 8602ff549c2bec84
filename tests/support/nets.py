"""A net of cables, whose matrices are too wide for a band."""

import numpy as np

from ancfdae import CABLE_3D, Beam, Material, Scene, Spherical
from ancfdae.sections import Circle


def net(lines, youngs_modulus=1e7, gravity=-9.81, damping=0.0):
    """A square net of cables, hung at its corners, each crossing a spherical joint."""
    rubber, wire = Material(1000, youngs_modulus, 0.3, damping_time=damping), Circle(0.01)
    places = np.arange(lines) / (lines - 1)

    def cables(name, ends):
        return [
            Beam(f"{name}{k}", *ends(s), lines - 1, wire, rubber, element=CABLE_3D)
            for k, s in enumerate(places)
        ]

    along = cables("x", lambda s: ((0, s, 0), (1, s, 0)))
    across = cables("y", lambda s: ((s, 0, 0), (s, 1, 0)))
    joints = [
        Spherical(x.at(s), y.at(r))
        for x, r in zip(along, places, strict=True)
        for y, s in zip(across, places, strict=True)
    ]
    corners = [(x, s) for x in (along[0], along[-1]) for s in (0.0, 1.0)]
    joints += [Spherical(x.at(s), name=f"{x.name} {s}") for x, s in corners]
    return Scene([*along, *across], joints, gravity=(0, 0, gravity))
