"""ANCF elements: shape functions, invariant matrices, batched elastic forces; one a file."""

from ancfdae.elements.cable2d import CABLE_2D
from ancfdae.elements.continuum import BEAM_2D, BEAM_3D
from ancfdae.elements.element import Batch, BeamElement, ElementParameter, ElementType, Quantity
from ancfdae.elements.energy import (
    EnhancedContinuum,
    PlaneStress,
    SaintVenantKirchhoff,
    StrainEnergy,
)

#: Every element, the default one of a dimension before others of it.
ALL_ELEMENTS: tuple[BeamElement, ...] = (BEAM_2D, BEAM_3D, CABLE_2D)
