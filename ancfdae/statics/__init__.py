"""Equilibria of mechanical systems under load, and their design derivatives."""

from ancfdae.statics.equilibrium import Equilibrium, NoEquilibrium, find_equilibrium
from ancfdae.statics.mobility import FreeMechanism
from ancfdae.statics.outcome import LoadOutcome

__all__ = ["Equilibrium", "FreeMechanism", "LoadOutcome", "NoEquilibrium", "find_equilibrium"]
