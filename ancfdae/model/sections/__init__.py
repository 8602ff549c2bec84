"""Cross-sections, one family a file."""

from ancfdae.model.sections.circle import Circle, Tube
from ancfdae.model.sections.general import MomentSection, PointSection
from ancfdae.model.sections.rectangle import Rectangle
from ancfdae.model.sections.section import Section
from ancfdae.model.sections.walled import Box, ISection
