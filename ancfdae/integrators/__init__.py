"""Integrators, and the consistent start that all of them share."""

from ancfdae.integrators.bindings import MissingPackage
from ancfdae.integrators.contract import AdjointIntegrator, Integrator
from ancfdae.integrators.explicit import Explicit
from ancfdae.integrators.hht import HHT
from ancfdae.integrators.ida import IDA
from ancfdae.integrators.idas import IDAS
from ancfdae.integrators.index_reduced import IndexReduction
from ancfdae.integrators.seeds import Seeds

__all__ = [
    "HHT",
    "IDA",
    "IDAS",
    "AdjointIntegrator",
    "Explicit",
    "IndexReduction",
    "Integrator",
    "MissingPackage",
    "Seeds",
]
