"""Design sensitivities of whole runs, by several independent methods, and their checks."""

from ancfdae.sensitivity.complex_step import ComplexStep
from ancfdae.sensitivity.contract import Method
from ancfdae.sensitivity.direct import Direct
from ancfdae.sensitivity.finite_difference import FiniteDifference
from ancfdae.sensitivity.run import as_system, differentiate, simulate
from ancfdae.sensitivity.taylor import TaylorTest, taylor_test

__all__ = [
    "ComplexStep",
    "Direct",
    "FiniteDifference",
    "Method",
    "TaylorTest",
    "as_system",
    "differentiate",
    "simulate",
    "taylor_test",
]
