"""Integrators: HHT-I3, and the consistent start that all of them share."""

from ancfdae.integrators.contract import Integrator
from ancfdae.integrators.hht import HHT
from ancfdae.integrators.seeds import Seeds

__all__ = ["HHT", "Integrator", "Seeds"]
