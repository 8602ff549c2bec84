"""Cross-sections of beams."""

from ancfdae.model.sections.circle import Circle, Tube
from ancfdae.model.sections.general import GeneralSection, QuadratureSection
from ancfdae.model.sections.rectangle import Rectangle
from ancfdae.model.sections.walled import Box, ISection

__all__ = [
    "Box",
    "Circle",
    "GeneralSection",
    "ISection",
    "QuadratureSection",
    "Rectangle",
    "Tube",
]
