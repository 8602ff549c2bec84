"""Cross-sections of beams."""

from ancfdae.model.sections.shapes import Circle, GeneralSection, QuadratureSection, Rectangle, Tube
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
