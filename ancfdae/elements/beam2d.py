"""Planar shear-deformable beam, 12 coordinates (Omar & Shabana 2001; eqs. 7-8).

Node vectors X = [r_1, r_x1, r_y1, r_2, r_x2, r_y2]. Plane strain of thickness
`width`; the section extends over `height` in y.
"""

from __future__ import annotations

from typing import final

from ancfdae.elements.continuum import ContinuumBeam
from ancfdae.elements.element import Quantity


@final
class Beam2D(ContinuumBeam):
    """The planar element."""

    name = "BEAM_2D"
    d = 2
    quantities = tuple(Quantity)[:3]
    voigt = ((0, 0), (1, 1), (0, 1))


BEAM_2D = Beam2D()
