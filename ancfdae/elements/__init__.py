"""ANCF beam elements: shape functions, invariant matrices, batched elastic forces."""

from ancfdae.elements.beam2d import BEAM_2D
from ancfdae.elements.beam3d import BEAM_3D
from ancfdae.elements.element import BeamElement, ElementParameter, Quantity

__all__ = ["BEAM_2D", "BEAM_3D", "BeamElement", "ElementParameter", "Quantity"]
