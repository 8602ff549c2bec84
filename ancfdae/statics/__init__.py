"""Equilibria of mechanical systems under load, and their design derivatives."""

from ancfdae.statics.balance import Balance
from ancfdae.statics.critical import CriticalLoad, NoCriticalPoint, find_critical
from ancfdae.statics.derivatives import Tangent
from ancfdae.statics.equilibrium import (
    MAX_STEPS,
    Equilibrium,
    NoEquilibrium,
    RestingStart,
    find_equilibrium,
)
from ancfdae.statics.outcome import FreeMechanism, LoadOutcome, motions_in_words
from ancfdae.statics.softness import stiffness_of_coordinates
