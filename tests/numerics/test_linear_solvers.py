"""Patterns of sparse matrices, and the linear solvers that factorise saddle points."""

import pickle
import weakref

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Pin,
    Scene,
    assemble,
)
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.numerics import linear_solvers
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.numerics.patterns import SparsityPattern
from tests.support.members import (
    force_q,
)
from tests.support.scenes import FLAT, RUBBER, STEEL, THICK
from tests.support.setting import STEP, assert_close

# ---------------------------------------------------------------- patterns


pytestmark = pytest.mark.rounding


@pytest.mark.parametrize("shape", [(4, 7), (250, 250)], ids=["dense", "sparse"])
def test_pattern_products_are_those_of_the_dense_matrix(shape):
    rng = np.random.default_rng(1)
    rows, columns = rng.integers(0, shape[0], 60), rng.integers(0, shape[1], 60)
    pattern = SparsityPattern(shape, rows, columns)
    raw = rng.uniform(-1, 1, 60) + 1j * rng.uniform(-1, 1, 60)
    expected = np.zeros(shape, dtype=complex)
    np.add.at(expected, (rows, columns), raw)
    values = pattern.gather(rows, columns, raw)
    # Sums of at most 60 products of size one.
    tolerance = 60 * np.finfo(float).eps
    assert_close(pattern.dense(values), expected, tolerance)
    assert_close(pattern.csr(values).toarray(), expected, tolerance)
    for x, y in (
        (rng.uniform(-1, 1, shape[1]), rng.uniform(-1, 1, shape[0])),
        (rng.uniform(-1, 1, (shape[1], 3)), rng.uniform(-1, 1, (shape[0], 3))),
    ):
        assert_close(pattern.dot(values, x), expected @ x, tolerance)
        assert_close(pattern.dot_transposed(values, y), expected.T @ y, tolerance)


# ---------------------------------------------------------------- linear solvers


STORAGES = {
    "band": (10**9, linear_solvers._BandStorage),
    "sparse": (0, linear_solvers._SparseStorage),
}


class Chain:
    """Two pinned chains of beams, a matrix on their pattern and the same matrix densely."""

    def __init__(self, kind, monkeypatch):
        half_width, storage = STORAGES[kind]
        monkeypatch.setattr(linear_solvers, "_BAND_HALF_WIDTH", half_width)
        self.system = chain_system()
        system = self.system
        self.B = system.constraint_q(0.0, system.start()[0])
        self.solver = SaddlePoint(system.pattern, system.constraint_pattern, system.weights, self.B)
        assert isinstance(self.solver._storage, storage)

    def values(self, is_complex):
        """M plus an unsymmetric perturbation of a tenth of its diagonal."""
        rng, pattern = np.random.default_rng(2), self.system.pattern
        weights = np.sqrt(self.system.weights)
        noise = rng.uniform(-1, 1, pattern.size) * weights[pattern.rows] * weights[pattern.columns]
        K = self.system.mass(None) + 0.003 * noise
        return K * (1 + 0.1j * rng.uniform(-1, 1, pattern.size)) if is_complex else K

    def matrix(self, K):
        n, m = self.system.n_q, self.system.n_lam
        A = np.zeros((n + m, n + m), dtype=K.dtype)
        A[:n, :n] = self.system.pattern.dense(K)
        A[n:, :n] = self.system.constraint_pattern.dense(self.B)
        A[:n, n:] = A[n:, :n].T
        return A


def chain_system():
    crank = Beam("crank", (0.0, 0.0), (1.0, 0.0), 9, FLAT, STEEL)
    rod = Beam("rod", (1.0, 0.0), (2.0, 0.5), 21, THICK, RUBBER)
    joints = [Pin(crank.at_start), Pin(crank.at_end, rod.at_start, name="p"), Pin(rod.at_end)]
    return assemble(Scene([crank, rod], joints))


@pytest.mark.parametrize("kind", STORAGES)
@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
@pytest.mark.parametrize("right", ["vector", "columns", "complex vector", "complex columns"])
def test_every_storage_solves_with_the_matrix_and_its_transpose(
    kind, is_complex, right, monkeypatch
):
    chain = Chain(kind, monkeypatch)
    K = chain.values(is_complex)
    A, factors = chain.matrix(K), chain.solver.factor(K, chain.B)
    rng = np.random.default_rng(4)
    shape = (len(A), 4) if right.endswith("columns") else (len(A),)
    b = rng.uniform(-1, 1, shape)
    if right.startswith("complex"):
        b = b + 1j * rng.uniform(-1, 1, shape)
    kept = b.copy()
    scale = chain.solver.scale
    S = scale[:, None] * A * scale
    # Error of a solution of the scaled system: condition times eps times growth, which for
    # partial pivoting is a small power of N in practice: 100.
    tolerance = 100 * np.linalg.cond(S) * np.finfo(float).eps
    assert tolerance < 1e-6  # otherwise the matrix would be too bad to show anything
    assert np.max(np.abs(A - A.T)) > 0.001 * np.max(np.abs(A))  # so that the transpose counts
    for matrix, x in ((A, factors.solve(b)), (A.T, factors.solve_transposed(b))):
        expected = np.linalg.solve(matrix, b)
        assert x.shape == b.shape
        unscaled = scale if b.ndim == 1 else scale[:, None]
        assert_close(x / unscaled, expected / unscaled, tolerance)
        assert (x.dtype.kind == "c") == (expected.dtype.kind == "c")
    assert np.array_equal(b, kept)  # right-hand sides are left alone


@pytest.mark.parametrize("kind", STORAGES)
def test_imaginary_part_of_a_complex_step_survives_the_factorisation(kind, monkeypatch):
    # (K + i eps N)^{-1} b has the imaginary part -eps K^{-1} N K^{-1} b.
    chain = Chain(kind, monkeypatch)
    K, rng = chain.values(False), np.random.default_rng(5)
    N = rng.uniform(-1, 1, chain.system.pattern.size)
    b = rng.uniform(-1, 1, chain.solver.size)
    real = chain.solver.factor(K, chain.B)
    x = real.solve(b)
    n = chain.system.n_q
    change = np.zeros_like(x)
    change[:n] = chain.system.pattern.dot(N, x[:n])
    expected = -real.solve(change)
    stepped = chain.solver.factor(K + 1j * STEP * N, chain.B).solve(b)
    A = chain.matrix(K)
    scale = chain.solver.scale
    tolerance = 100 * np.linalg.cond(scale[:, None] * A * scale) * np.finfo(float).eps
    assert_close(stepped.imag / STEP / scale, expected / scale, tolerance)


@pytest.mark.parametrize("kind", STORAGES)
def test_no_right_hand_side_gives_no_solution(kind, monkeypatch):
    chain = Chain(kind, monkeypatch)
    factors = chain.solver.factor(chain.values(False), chain.B)
    empty = np.zeros((chain.solver.size, 0))
    assert factors.solve(empty).shape == factors.solve_transposed(empty).shape == empty.shape


@pytest.mark.parametrize("kind", STORAGES)
@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
def test_singular_matrix_is_refused(kind, is_complex, monkeypatch):
    chain = Chain(kind, monkeypatch)
    K = chain.values(is_complex)
    with pytest.raises(SingularMatrix):
        chain.solver.factor(K, 0 * chain.B)  # a row of zeros
    with pytest.raises(SingularMatrix):
        chain.solver.factor(0 * K, chain.B)  # more coordinates than constraints
    spoiled = K.copy()
    spoiled[7] = np.nan
    with pytest.raises(SingularMatrix, match="not finite"):
        chain.solver.factor(spoiled, chain.B)


class SymmetricChain(Chain):
    """The same chains with a symmetric matrix, positive definite unless it is shifted."""

    def __init__(self):
        self.system = system = chain_system()
        self.B = system.constraint_q(0.0, system.start()[0])
        patterns = system.pattern, system.constraint_pattern
        self.solver = SaddlePoint(*patterns, system.weights, self.B, symmetric=True)

    def values(self, is_complex, shift=0.0):
        system, rng = self.system, np.random.default_rng(8)
        q = rng.uniform(-1, 1, system.n_q) * 0.01 + system.start()[0]
        K = system.mass(None) * (1 - shift) - 1e-8 * force_q(system, 0.0, q, q)
        return K * (1 + 0.1j * rng.uniform(-1, 1)) if is_complex else K


@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
@pytest.mark.parametrize("right", ["vector", "columns", "complex vector", "complex columns"])
@pytest.mark.parametrize("shift", [0.0, 1.5], ids=["definite", "indefinite"])
def test_symmetric_matrices(is_complex, right, shift):
    chain = SymmetricChain()
    K = chain.values(is_complex, shift)
    A, factors = chain.matrix(K), chain.solver.factor(K, chain.B)
    assert np.max(np.abs(A - A.T)) < 1e-14 * np.max(np.abs(A))
    symmetric = chain.solver._envelope.factor(((1.0, K),), chain.B)[1] == 0
    assert symmetric == (shift == 0)  # a pivot of an indefinite matrix has not its sign
    rng, scale = np.random.default_rng(4), chain.solver.scale
    for columns in (1, 2, 4, 5, 8, 13) if right.endswith("columns") else ((),):
        b = rng.uniform(-1, 1, (len(A), columns) if columns else (len(A),))
        if right.startswith("complex"):
            b = b + 1j * rng.uniform(-1, 1, b.shape)
        tolerance = 100 * np.linalg.cond(scale[:, None] * A * scale) * np.finfo(float).eps
        assert tolerance < 1e-6
        unscaled = scale if b.ndim == 1 else scale[:, None]
        expected = np.linalg.solve(A, b) / unscaled
        for x in (factors.solve(b), factors.solve_transposed(b)):
            assert_close(x / unscaled, expected, tolerance)


def test_singular_symmetric_matrices_are_refused():
    chain = SymmetricChain()
    K = chain.values(False)
    for values, B in ((K, 0 * chain.B), (0 * K, chain.B), (np.nan * K, chain.B)):
        with pytest.raises(SingularMatrix):
            chain.solver.factor(values, B)


def test_chains_are_bands():
    system = chain_system()
    values = system.constraint_q(0.0, system.start()[0])
    arguments = (system.pattern, system.constraint_pattern, system.weights, values)
    # A narrow band of two nodes and the multipliers between them.
    storage = SaddlePoint(*arguments)._storage
    assert isinstance(storage, linear_solvers._BandStorage)
    assert storage.band.__reduce__()[1][0] <= 20


def test_places_are_kept_beside_a_pattern_without_weak_references():
    # Those have callbacks, and Ctrl-C in a callback is written to stderr and lost.
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, FLAT, STEEL)
    system = assemble(Scene([rod], [Pin(rod.at_start)]))
    K, B = system.pattern, system.constraint_pattern
    weights, values = system.weights, np.ones(B.size)
    first = SaddlePoint(K, B, weights, values)
    assert SaddlePoint(K, B, weights, values)._places is first._places
    other = SparsityPattern(B.shape, B.rows, B.columns)
    assert SaddlePoint(K, other, weights, values)._places is not first._places
    assert SaddlePoint(K, B, weights, values)._places is first._places
    assert not weakref.getweakrefs(K)
    assert not weakref.getweakrefs(B)
    assert not pickle.loads(pickle.dumps(K)).beside
