"""Compiled inner loops: element forces and tangents, sparse products, banded solutions.

Real and complex numbers go through the same formulas, each of which stands once, in C++: those of
elements in `elements.h`, their sums over a scene in `blocks.h`. `kernels.cpp` says what each
function computes, of what fits together; all else is a ValueError or a TypeError. Why this is
compiled, and by what: docs/measurements.md, "What is compiled".
"""

try:
    from ancfdae.kernels._kernels import *  # noqa: F403
except ImportError as error:  # a checkout that was updated since it was installed
    raise ImportError(
        "the kernels of ancfdae are not compiled; run `python -m pip install -e .` in the checkout"
    ) from error
