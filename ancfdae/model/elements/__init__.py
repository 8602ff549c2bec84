"""ANCF elements: shape functions, invariant matrices, batched elastic forces; one a file."""

from ancfdae.model.elements.cable import CABLE_2D, CABLE_3D
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
ALL_ELEMENTS: tuple[BeamElement, ...] = (BEAM_2D, BEAM_3D, CABLE_2D, CABLE_3D)


def default_element(dimension: int) -> BeamElement:
    """Return the beam of a dimension."""
    return next(each for each in ALL_ELEMENTS if each.d == dimension)
