"""The sparse pseudo-inverse is that of the singular values, whatever the rank."""

import numpy as np
import pytest
from scipy import sparse

from ancfdae.assembly.closing import LeastNorm


@pytest.mark.parametrize("size", [40, 200])
def test_small_singular_values_count(size):
    # 1e-6 of the largest: a pass of the sparse way leaves (a/s)^2 = 1e-2 of it, and round-off is
    # 1e-16 / 1e-6 of the solution.
    matrix = np.diag(np.r_[np.full(20, 1e-6), np.linspace(0.5, 1.0, size - 20)])
    exact = np.random.default_rng(1).normal(size=size)
    found = LeastNorm(sparse.csr_array(matrix)).solve(matrix @ exact)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("size", [40, 200])
def test_solutions_are_those_of_the_pseudo_inverse(size):
    # Of rank size - 10 in both directions: the last ten rows and columns repeat others.
    generator = np.random.default_rng(0)
    core = np.diag(generator.uniform(0.5, 2.0, size - 10)) + np.eye(size - 10, k=3)
    matrix = np.pad(core, ((0, 10), (0, 10)), mode="edge")
    inverse = LeastNorm(sparse.csr_array(matrix))
    b = matrix @ generator.normal(size=size) * (1 + 2j)
    expected = np.linalg.pinv(matrix) @ b
    # Round-off over a: 1e-16 / 1e-7 is left of the null space, nothing elsewhere.
    atol = 1e-8 * np.max(np.abs(expected))
    np.testing.assert_allclose(inverse.solve(b), expected, rtol=0, atol=atol)
    np.testing.assert_allclose(matrix @ inverse.solve(b), b, rtol=0, atol=1e-12 * size)
    projector = np.eye(size) - np.linalg.pinv(matrix) @ matrix
    open_rows = np.linalg.norm(projector, axis=1) > 1e-8
    np.testing.assert_array_equal(inverse.leaves_open(size) > 1e-8, open_rows)
