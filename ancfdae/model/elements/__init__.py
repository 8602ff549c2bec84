"""ANCF elements, one a file: shape functions, invariant matrices and section forces."""

from ancfdae.model.elements.cable import CABLE_2D, CABLE_3D
from ancfdae.model.elements.continuum import BEAM_2D, BEAM_3D, default_element
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
    StrainEnergyFunction,
)

#: Every element.
ALL_ELEMENTS: tuple[BeamElement, ...] = (BEAM_2D, BEAM_3D, CABLE_2D, CABLE_3D)
