"""ANCF elements: shape functions, invariant matrices, batched elastic forces; one a file."""

from ancfdae.model.elements.cable2d import CABLE_2D
from ancfdae.model.elements.continuum import BEAM_2D, BEAM_3D
from ancfdae.model.elements.element import (
    Batch,
    BeamElement,
    ElementParameter,
    ElementType,
    Quantity,
)
from ancfdae.model.elements.energy import (
    EnhancedContinuum,
    PlaneStress,
    SaintVenantKirchhoff,
    StrainEnergy,
)

#: Every element, the default one of a dimension before others of it.
ALL_ELEMENTS: tuple[BeamElement, ...] = (BEAM_2D, BEAM_3D, CABLE_2D)
