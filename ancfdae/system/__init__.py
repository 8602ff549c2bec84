"""Mechanical systems: the protocol that integrators see, and the ANCF assembler behind it."""

from ancfdae.system.ancf import AncfSystem, assemble
from ancfdae.system.complex_step import ComplexStepSystem
from ancfdae.system.contract import (
    DesignPartials,
    Linearisation,
    MechanicalSystem,
    OneByOneSystem,
)

__all__ = [
    "AncfSystem",
    "ComplexStepSystem",
    "DesignPartials",
    "Linearisation",
    "MechanicalSystem",
    "OneByOneSystem",
    "assemble",
]
