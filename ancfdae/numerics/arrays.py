"""Array types and the imaginary step of complex-step derivatives.

A complex-step run carries a perturbation of size `STEP` in the imaginary part. Values must keep it
(no ``abs``, no conjugation); decisions, such as convergence tests, must look at the real part only.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

# The same as numpy.typing.NDArray[Any], whose import takes a tenth of this package's import time.
Array: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[Any]]
# A sequence or array of numbers from a user.
Numbers: TypeAlias = Sequence[float] | Array
# Imaginary step of derivatives, about 1e-40, relative to what it is added to. Its square vanishes
# against one, it stays far above the smallest normal number after division by beta h^2 or
# multiplication with small lengths, and as a power of two it adds no round-off.
STEP = 2.0**-133


def only(batch: Array) -> Array:
    """Return the single entry of a batch that holds one state."""
    return batch[0]
