"""IDA and IDAS of SUNDIALS on index-reduced equations."""

from ancfdae.errors import MissingPackage
from ancfdae.integrators.sundials.ida import IDA
from ancfdae.integrators.sundials.idas import IDAS
from ancfdae.integrators.sundials.index_reduced import IndexReduction

__all__ = ["IDA", "IDAS", "IndexReduction", "MissingPackage"]
