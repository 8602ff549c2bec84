"""Mechanical systems: the protocol that integrators see, and the ANCF assembler behind it."""

from ancfdae.system.ancf import AncfSystem, assemble
from ancfdae.system.complex_step import ComplexStepSystem
from ancfdae.system.conformance import Conformance, Finding, check_system
from ancfdae.system.contract import (
    DesignPartials,
    Linearisation,
    MechanicalSystem,
    OneByOneSystem,
)

__all__ = [
    "AncfSystem",
    "ComplexStepSystem",
    "Conformance",
    "DesignPartials",
    "Finding",
    "Linearisation",
    "MechanicalSystem",
    "OneByOneSystem",
    "assemble",
    "check_system",
]
