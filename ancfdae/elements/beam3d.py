"""Spatial fully parameterised beam, 24 coordinates (Yakoub & Shabana 2001).

Node vectors X = [r_1, r_x1, r_y1, r_z1, r_2, r_x2, r_y2, r_z2]. The section
extends over `height` in y and `width` in z.
"""

from __future__ import annotations

from ancfdae.elements.continuum import ContinuumBeam

BEAM_3D = ContinuumBeam("BEAM_3D", 3)
