"""The protocol between a mechanical system and everything that integrates it."""

from ancfdae.naming import Naming
from ancfdae.protocol.solution import Solution
from ancfdae.protocol.solution_parts import EstimatedErrors, Sensitivities, Statistics
from ancfdae.protocol.system import (
    DesignPartials,
    Direction,
    Linearisation,
    MechanicalSystem,
    Traits,
    reaction,
)
