"""The ANCF assembler: where a scene becomes a mechanical system."""

from ancfdae.assembly.beam_elements import StatePartials
from ancfdae.assembly.saved import load_solution
from ancfdae.assembly.section_results import StressPoints
from ancfdae.assembly.system import AncfSystem, assemble
