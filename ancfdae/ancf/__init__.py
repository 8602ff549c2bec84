"""The ANCF assembler: where a scene becomes a mechanical system."""

from ancfdae.ancf.section_force import SectionForce
from ancfdae.ancf.stress_points import StressPoints
from ancfdae.ancf.system import AncfSystem, assemble

__all__ = ["AncfSystem", "SectionForce", "StressPoints", "assemble"]
