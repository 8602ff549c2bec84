"""The ANCF assembler: where a scene becomes a mechanical system."""

from ancfdae.ancf.beam_elements import StatePartials
from ancfdae.ancf.stress_points import StressPoints
from ancfdae.ancf.system import AncfSystem, assemble
