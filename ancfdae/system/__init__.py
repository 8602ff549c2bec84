"""Mechanical systems: the protocol that integrators see, and the ANCF assembler behind it."""

from ancfdae.system.ancf import AncfSystem, assemble
from ancfdae.system.contract import (
    DesignPartials,
    Linearisation,
    MechanicalSystem,
    OneByOneSystem,
)

__all__ = [
    "AncfSystem",
    "DesignPartials",
    "Linearisation",
    "MechanicalSystem",
    "OneByOneSystem",
    "assemble",
]
