"""Spatial fully parameterised beam, 24 coordinates (Yakoub & Shabana 2001).

Node vectors X = [r_1, r_x1, r_y1, r_z1, r_2, r_x2, r_y2, r_z2]. The section
extends over `height` in y and `width` in z.
"""

from __future__ import annotations

from typing import final

from ancfdae.elements.continuum import ContinuumBeam
from ancfdae.elements.element import Quantity


@final
class Beam3D(ContinuumBeam):
    """The spatial element."""

    name = "BEAM_3D"
    d = 3
    quantities = tuple(Quantity)
    voigt = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


BEAM_3D = Beam3D()
