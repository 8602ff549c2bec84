"""Planar shear-deformable beam, 12 coordinates (Omar & Shabana 2001; eqs. 7-8).

Node vectors X = [r_1, r_x1, r_y1, r_2, r_x2, r_y2]. Plane strain of thickness
`width`; the section extends over `height` in y.
"""

from __future__ import annotations

from ancfdae.elements.continuum import ContinuumBeam

BEAM_2D = ContinuumBeam("BEAM_2D", 2)
