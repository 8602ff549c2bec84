"""Cross-sections, one family a file."""

from ancfdae.sections.circle import Circle, Tube
from ancfdae.sections.general import MomentSection, PointSection
from ancfdae.sections.rectangle import Rectangle
from ancfdae.sections.section import Section
from ancfdae.sections.walled import Box, ISection
