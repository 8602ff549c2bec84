"""The unit that machines are compared by: one banded LU of LAPACK, n = 106, half width 25."""

import numpy as np
from scipy.linalg.lapack import dgbtrf

from validation.performance.row import Row, seconds

_SIZE, _HALF_WIDTH, _BATCH = 106, 25, 200


def banded_lu(repeats: int = 9) -> float:
    """Return the median seconds of one factorisation, out of batches."""
    rng, k = np.random.default_rng(0), _HALF_WIDTH
    band = np.zeros((3 * k + 1, _SIZE), order="F")
    band[k:] = rng.uniform(-1, 1, (2 * k + 1, _SIZE))
    band[2 * k] += 4 * k

    def batch() -> None:
        for _ in range(_BATCH):
            dgbtrf(band, k, k)

    return seconds(batch, repeats) / _BATCH


def measure(repeats: int = 9) -> list[Row]:
    """Return the unit itself."""
    return [Row("one banded LU (n = 106, half width 25)", 1e6 * banded_lu(repeats), "us")]
