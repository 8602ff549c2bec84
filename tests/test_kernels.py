"""The compiled kernels against plain NumPy formulas, and what they refuse.

CLOSE: numbers are of size one and sums have at most 200 terms, n eps = 4e-14, with a factor of ten
for products of such sums. A wrong term shows at order one.
"""

import itertools
import subprocess
import sys

import numpy as np
import pytest
import scipy

from ancfdae import kernels

CLOSE = 1e-12
#: n_y and d: of the elements (3D beam, 2D beam, cable), and sizes that only the general code has.
SIZES = [(7, 3), (5, 2), (3, 2), (5, 3), (1, 3), (3, 1)]
DTYPES = [float, complex]


def numbers(rng, shape, dtype):
    x = rng.uniform(-1, 1, shape)
    return x if dtype is float else x + 1j * rng.uniform(-1, 1, shape)


def odd_layouts(x):
    """The same numbers in Fortran order, with gaps, and with negative strides."""
    gaps = np.zeros((*x.shape[:-1], 2 * x.shape[-1]), dtype=x.dtype)
    gaps[..., ::2] = x
    return [np.asfortranarray(x), gaps[..., ::2], np.ascontiguousarray(x[..., ::-1])[..., ::-1]]


def close(a, b):
    assert a.shape == b.shape
    assert a.dtype == b.dtype
    assert np.max(np.abs(a - b), initial=0) <= CLOSE * max(1, np.max(np.abs(b), initial=0))


# ---------------------------------------------------------------- the formulas, without cleverness


def packed(Y, U):
    i, j = np.triu_indices(Y.shape[-2])
    whole = np.einsum("...ic,...jc->...ij", Y, U)
    return (whole + whole.swapaxes(-1, -2))[..., i, j]


def product(p, Y):
    n_y = Y.shape[-2]
    i, j = np.triu_indices(n_y)
    W = np.zeros((*p.shape[:-1], n_y, n_y), dtype=p.dtype)
    W[..., i, j] += p
    W[..., j, i] += p
    return W @ Y


def map_of(vectors, d, n_q):
    """R as a matrix, (n n_y d, n_q)."""
    n, n_a = vectors.shape
    R = np.zeros((n, n_a - 1, d, n_q))
    second = n_a // 2
    for e in range(n):
        for c in range(d):
            R[e, 0, c, vectors[e, second] * d + c] += 1
            R[e, 0, c, vectors[e, 0] * d + c] -= 1
            slopes = [a for a in range(n_a) if a not in (0, second)]
            for row, a in enumerate(slopes, start=1):
                R[e, row, c, vectors[e, a] * d + c] += 1
    return R.reshape(-1, n_q)


class Case:
    """Three elements that share nodes, k instants."""

    def __init__(self, n_y, d, dtype, alike=False, linear=True):
        rng = np.random.default_rng(n_y * 10 + d)
        n, self.k, n_g = 3, 5, n_y * (n_y + 1) // 2
        self.n_y, self.d, self.n_g = n_y, d, n_g
        half = (n_y + 1) // 2
        nodes = np.arange((n + 1) * half).reshape(n + 1, half)
        vectors = np.concatenate([nodes[[2, 0, 1]], nodes[[3, 1, 0]]], axis=1)
        laws = 1 if alike else n
        A = numbers(rng, (laws, n_g, n_g), dtype)
        A = A + A.swapaxes(1, 2)
        g_o = numbers(rng, (laws, n_g), dtype)
        p_o = numbers(rng, (laws, n_g), dtype) if linear else None
        tau = numbers(rng, n, dtype)
        n_q = vectors.max() * d + d + 2  # and two numbers of others
        self.block = kernels.Block(A, g_o, p_o, tau, vectors, d, n_q)
        self.R = map_of(vectors, d, n_q)
        self.q, self.v, self.u, self.z = numbers(rng, (4, self.k, n_q), dtype)
        self.p_b = numbers(rng, (n, self.k, n_g), dtype)
        self.F = numbers(rng, (self.k, n, n_y, d), dtype)
        # Entries at the same place are summed.
        self.index = np.arange(n * ((n_y + 1) * d) ** 2, dtype=np.int32).reshape(n, -1) // 2
        # Two places without an entry, and one at the very end.
        self.size = int(self.index.max()) + 4
        self.index[-1, -1] = self.size - 1

    def Y(self, q):
        return (q @ self.R.T).reshape(*q.shape[:-1], 3, self.n_y, self.d)

    def lifted(self, F):
        return F.reshape(*F.shape[:-3], -1) @ self.R

    def law(self, x):
        return np.einsum("egh,...eh->...eg", np.broadcast_to(self.block.A, (3, *[self.n_g] * 2)), x)

    def p(self, q, v):
        Y, b = self.Y(q), self.block
        x = packed(Y, Y) / 2 - b.g_o
        if v is not None:
            x = x + b.tau[:, None] * packed(Y, self.Y(v))
        return self.law(x) + (0 if b.p_o is None else b.p_o)

    def forces(self, q, v):
        return self.lifted(product(self.p(q, v), self.Y(q)))

    def along(self, q, v, u, z, p_b=None):
        """Derivative of `forces` by the product rule."""
        Y, U, tau = self.Y(q), self.Y(u), self.block.tau[:, None]
        x = packed(Y, U)
        if v is not None:
            x = x + tau * (packed(U, self.Y(v)) + packed(Y, self.Y(z)))
        change = self.law(x) + (0 if p_b is None else p_b.swapaxes(0, 1))
        return self.lifted(product(change, Y) + product(self.p(q, v), U))

    def tangent(self, q, v, damping):
        """Values of the tangent of one instant, from columns; elements stand apart."""
        b, values = self.block, np.zeros(self.size, dtype=q.dtype)
        for e in range(3):
            own = (b.vectors[e][:, None] * self.d + np.arange(self.d)).ravel()
            alone = Case.__new__(Case)
            alone.__dict__.update(self.__dict__)
            alone.R = np.where(np.arange(len(self.R)) // (self.n_y * self.d) == e, self.R.T, 0).T
            units, zero = np.eye(b.n_q)[own].astype(q.dtype), np.zeros((len(own), b.n_q))
            directions = (zero, units) if damping else (units, zero)
            at = q, np.zeros_like(q) if damping else v
            columns = alone.along(*at, *directions)[:, own]
            np.add.at(values, self.index[e], columns.T.ravel())
        return values


@pytest.fixture(params=[(s, t) for s in SIZES for t in DTYPES], ids=str, name="case")
def _case(request):
    (n_y, d), dtype = request.param
    return Case(n_y, d, dtype, alike=d == 3, linear=n_y != 7)


# ---------------------------------------------------------------- elements


def test_relative_vectors_and_their_transpose(case):
    close(kernels.relative(case.block, case.q), case.Y(case.q))
    close(kernels.relative(case.block, case.q[0]), case.Y(case.q[0]))
    close(kernels.lifted(case.block, case.F), case.lifted(case.F))
    for q, F in zip(odd_layouts(case.q), odd_layouts(case.F), strict=True):
        close(kernels.relative(case.block, q), case.Y(case.q))
        close(kernels.lifted(case.block, F), case.lifted(case.F))


def test_forces(case):
    q, v = case.q, case.v
    close(kernels.forces(case.block, q, None), case.forces(q, None))
    close(kernels.forces(case.block, q, v), case.forces(q, v))
    close(kernels.forces(case.block, q[0], v[0]), case.forces(q[0], v[0]))
    for other in odd_layouts(q):
        close(kernels.forces(case.block, other, v), case.forces(q, v))


def test_forces_along_directions(case):
    q, v, u, z = case.q, case.v, case.u, case.z
    for p_b in (None, case.p_b):
        each = kernels.forces_along(case.block, q, v, u, z, p_b)
        close(each, case.along(q, v, u, z, p_b))
        one = kernels.forces_along(case.block, q[0], v[0], u, z, p_b)
        close(one, case.along(q[:1], v[:1], u, z, p_b))
        undamped = kernels.forces_along(case.block, q, None, u, None, p_b)
        close(undamped, case.along(q, None, u, None, p_b))


def test_tangents(case):
    for damping, v in ((False, None), (False, case.v), (True, None)):
        found = kernels.tangents(case.block, case.q, v, damping, case.index, case.size)
        at = [None] * case.k if v is None else v
        expected = [case.tangent(x, y, damping) for x, y in zip(case.q, at, strict=True)]
        close(found, np.array(expected))


def test_packed_matrices(case):
    Y, U = case.Y(case.q), case.Y(case.v)
    close(kernels.gram(Y, U), packed(Y, U))
    close(kernels.gram(Y[0, 0], U[0, 0]), packed(Y[0, 0], U[0, 0]))
    close(kernels.stressed(packed(Y, U), Y), product(packed(Y, U), Y))
    g_o, tau = case.block.g_o, case.block.tau
    x = packed(Y, Y) / 2 - g_o
    close(kernels.strain(g_o, Y, None, None), x)
    close(kernels.strain(g_o, Y, U, tau), x + tau[:, None] * packed(Y, U))
    for other in odd_layouts(Y):
        close(kernels.gram(other, U), packed(Y, U))
        close(kernels.strain(g_o, other, None, None), x)
        close(kernels.stressed(packed(Y, U), other), product(packed(Y, U), Y))


def test_real_and_complex_arguments_mix():
    case, step = Case(7, 3, float), 1e-40
    q, v = case.q + 1j * step * case.u, case.v + 1j * step * case.z
    F = kernels.forces(case.block, q, v)
    close(F.imag / step, kernels.forces_along(case.block, case.q, case.v, case.u, case.z, None))
    close(kernels.relative(case.block, q).imag / step, case.Y(case.u))
    Y, other = case.Y(case.q), case.Y(q)
    for one, two in ((Y, other), (other, Y)):
        close(kernels.gram(one, two), packed(one, two))
        p = kernels.gram(one, one)
        close(kernels.stressed(p, two), product(p, two))


def test_nothing_is_nothing():
    block = Case(7, 3, float).block
    none = block._replace(
        A=block.A[:0], g_o=block.g_o[:0], p_o=None, tau=None, vectors=block.vectors[:0]
    )
    q, index = np.ones((2, block.n_q)), np.zeros((0, 576), dtype=np.int32)
    assert kernels.relative(none, q).shape == (2, 0, 7, 3)
    assert not kernels.forces(none, q, None).any()
    assert not kernels.tangents(none, q, None, False, index, 4).any()
    assert not kernels.lifted(none, np.zeros((2, 0, 7, 3))).any()
    assert kernels.forces(block, q[:0], None).shape == (0, block.n_q)
    assert kernels.forces_along(block, q[0], None, q[:0], None, None).shape == (0, block.n_q)
    assert kernels.gram(np.zeros((4, 0, 7, 3)), np.zeros((4, 0, 7, 3))).shape == (4, 0, 28)
    assert kernels.finite(np.zeros(0))
    assert kernels.norm(np.zeros(0), np.zeros(0)) == 0
    empty, zero = np.zeros(0), np.zeros(1, dtype=np.int32)
    assert kernels.csr_rows(zero, zero[:0], empty, np.ones(3)).shape == (0,)
    lu, pivots, info = kernels.band_factor(empty, empty, empty, empty.astype(int), 0, 0)
    assert (lu.shape, info) == ((0, 1), 0)
    assert kernels.band_solve(lu, pivots, 0, [], empty, np.zeros((2, 0)), False).shape == (2, 0)


# ---------------------------------------------------------------- linear algebra


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("x_dtype", DTYPES)
def test_sparse_products(dtype, x_dtype):
    rng = np.random.default_rng(1)
    dense = numbers(rng, (7, 9), dtype) * (rng.uniform(size=(7, 9)) < 0.4)
    dense[3] = 0
    M = scipy.sparse.csr_array(dense)
    rows = M.indptr.astype(np.int32), M.indices.astype(np.int32), M.data
    for k in range(7):  # rows go by fours
        x, y = numbers(rng, (k, 9), x_dtype), numbers(rng, (k, 7), x_dtype)
        for other in (x, *odd_layouts(x)):
            close(kernels.csr_rows(*rows, other), x @ dense.T)
        close(kernels.csr_rows_transposed(*rows, y, 9), y @ dense)
    x = numbers(rng, 9, x_dtype)
    close(kernels.csr_rows(*rows, x), dense @ x)


@pytest.mark.parametrize("dtype", DTYPES)
def test_norm_is_that_of_the_real_part(dtype):
    x = numbers(np.random.default_rng(2), (2, 5), dtype)
    weights = np.arange(1.0, 11).reshape(2, 5)
    expected = np.sqrt(np.sum(weights * x.real**2))
    assert kernels.norm(x, weights) == pytest.approx(expected, rel=CLOSE)
    assert kernels.norm(x[:, ::-1], weights[:, ::-1]) == pytest.approx(expected, rel=CLOSE)


@pytest.mark.parametrize("dtype", DTYPES)
def test_finite_finds_what_is_not(dtype):
    for size in range(20):  # it goes by eights
        x = np.full(size, 1e308, dtype=dtype)
        assert kernels.finite(x)
        for at in range(size):
            for bad in (
                np.nan,
                np.inf,
                -np.inf,
                *([complex(0, np.nan)] if x.dtype == "c16" else []),
            ):
                y = x.copy()
                y[at] = bad
                assert not kernels.finite(y)


def test_scaled_sum_of_any_kind():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(size=(2, 4, 3))
    close(kernels.add_scaled(x, 0.3, y), x + 0.3 * y)
    close(kernels.add_scaled(x.T, 0.3, y.T), (x + 0.3 * y).T)
    close(kernels.add_scaled(x[0], 0.3, y), x[0] + 0.3 * y)
    close(kernels.add_scaled(x, 0.3j, y), x + 0.3j * y)
    close(kernels.add_scaled(x, 0.3, 1j * y), x + 0.3j * y)
    close(kernels.add_scaled(1j * x, 0.3, y), 1j * x + 0.3 * y)
    close(kernels.add_scaled(x, y[:, :1], y), x + y[:, :1] * y)
    assert kernels.add_scaled(1, 2.0, 3) == 7
    with pytest.raises(ValueError, match="broadcast"):
        kernels.add_scaled(x, 0.3, y[:3])


class Band:
    """A saddle-point matrix of 6 + 2 unknowns, numbered anew, and its arguments."""

    half = 4

    def __init__(self, dtype, dtype_B=None):
        rng = np.random.default_rng(4)
        dtype_B = dtype_B or dtype
        self.dense = np.zeros((8, 8), dtype=np.result_type(dtype, dtype_B))
        self.order = rng.permutation(8)
        place = np.argsort(self.order)
        near = np.abs(place[:, None] - place) <= self.half
        rows, columns = np.nonzero(near[:6, :6])
        b_rows, b_columns = np.nonzero(near[6:, :6])
        self.K, self.B = numbers(rng, len(rows), dtype), numbers(rng, len(b_rows), dtype_B)
        self.dense[rows, columns] = self.K
        self.dense[b_rows + 6, b_columns] = self.dense[b_columns, b_rows + 6] = self.B
        self.scale = rng.uniform(1, 2, 8)
        i = np.concatenate([rows, b_rows + 6, b_columns])
        j = np.concatenate([columns, b_columns, b_rows + 6])
        self.factors = self.scale[i] * self.scale[j]
        self.flat = place[j] * (3 * self.half + 1) + 2 * self.half + place[i] - place[j]

    def factor(self):
        return kernels.band_factor(self.K, self.B, self.factors, self.flat, 8, self.half)


@pytest.mark.parametrize("dtypes", list(itertools.product(DTYPES, DTYPES)))
@pytest.mark.parametrize("right_dtype", DTYPES)
def test_banded_solutions(dtypes, right_dtype):
    band, dtype = Band(*dtypes), np.result_type(*dtypes)
    lu, pivots, info = band.factor()
    assert info == 0
    right = numbers(np.random.default_rng(5), (3, 8), right_dtype)
    for transposed in (False, True):
        expected = np.linalg.solve(band.dense.T if transposed else band.dense, right.T).T
        for other in (right, right[1], *odd_layouts(right)):
            x = kernels.band_solve(lu, pivots, 4, band.order, band.scale, other, transposed)
            # Times the condition of the matrix, which is 30.
            assert np.allclose(
                x, expected if other.ndim == 2 else expected[1], rtol=1e-11, atol=1e-11
            )
            assert x.dtype == np.result_type(dtype, right_dtype)


@pytest.mark.parametrize("bad", [np.nan, np.inf, complex(0, np.nan)])
def test_factors_of_what_is_not_finite_are_refused(bad):
    for name in ("K", "B"):
        band = Band(complex if isinstance(bad, complex) else float)
        getattr(band, name)[-1] = bad
        assert band.factor()[2] == -1


def test_zero_pivot_is_told():
    band = Band(float)
    band.K[:], band.B[:] = 0, 0
    assert band.factor()[2] == 1


# ---------------------------------------------------------------- what is refused


def _refused():
    """Wrong calls: each is one argument away from a right one."""
    case = Case(7, 3, float)
    b, q, v, u, z = case.block, case.q, case.v, case.u, case.z
    n_q, wide = b.n_q, np.zeros((5, b.n_q + 3))
    far = b.vectors.copy()
    far[1, 2] = n_q // 3
    below = b.vectors.copy()
    below[1, 2] = -1
    blocks = {
        "a vector beyond": b._replace(vectors=far),
        "a vector below": b._replace(vectors=below),
        "the least vector": b._replace(vectors=np.where(below < 0, np.iinfo(np.int64).min, below)),
        "vectors of floats": b._replace(vectors=b.vectors * 1.0),
        "vectors of one axis": b._replace(vectors=b.vectors.ravel()),
        "many vectors": b._replace(vectors=np.zeros((3, 16), dtype=int)),
        "one vector": b._replace(vectors=b.vectors[:, :1]),
        "no d": b._replace(d=0),
        "d of four": b._replace(d=4),
        "d beyond int": b._replace(d=2**32 + 3),
        "n_q below": b._replace(n_q=-1),
        "n_q of float": b._replace(n_q=1.0),
        "not a block": tuple(b)[:-1],
        "a list": list(b),
    }
    for name, block in blocks.items():
        yield name, kernels.relative, (block, q)
        yield name, kernels.forces, (block, q, v)
    laws = {
        "A of two": b._replace(A=b.A[:2]),
        "A of one": b._replace(A=b.A[:1]),
        "A small": b._replace(A=b.A[:, :-1]),
        "A missing": b._replace(A=None),
        "A flat": b._replace(A=b.A.reshape(3, -1)),
        "g_o of one": b._replace(g_o=b.g_o[:1]),
        "g_o small": b._replace(g_o=b.g_o[:, :-1]),
        "p_o small": b._replace(p_o=b.p_o[:, :-1]),
        "p_o of two": b._replace(p_o=b.p_o[:2]),
        "tau of one": b._replace(tau=b.tau[:1]),
        "tau a number": b._replace(tau=np.array(0.1)),
        "A of objects": b._replace(A=b.A.astype(object)),
    }
    for name, block in laws.items():
        yield name, kernels.forces, (block, q, v)
        yield name, kernels.forces_along, (block, q, v, u, z, None)
        yield name, kernels.tangents, (block, q, v, False, case.index, case.size)
    for name, bad in (("wide", wide), ("number", np.array(1.0)), ("text", "q"), ("none", None)):
        yield f"q {name}", kernels.relative, (b, bad)
        yield f"q {name}", kernels.forces, (b, bad, None)
        yield f"q {name}", kernels.forces_along, (b, bad, None, u, None, None)
        yield f"u {name}", kernels.forces_along, (b, q, None, bad, None, None)
        yield f"q {name}", kernels.tangents, (b, bad, None, False, case.index, case.size)
        yield f"F {name}", kernels.lifted, (b, bad)
    yield "fewer v", kernels.forces, (b, q, v[:4])
    yield "flat F", kernels.lifted, (b, case.F.reshape(5, -1))
    yield "F of two", kernels.lifted, (b, case.F[:, :2])
    yield "one v", kernels.forces_along, (b, q, v[0], u, z, None)
    yield "two q", kernels.forces_along, (b, q[:2], v[:2], u, z, None)
    yield "fewer z", kernels.forces_along, (b, q, v, u, z[:4], None)
    yield "no z", kernels.forces_along, (b, q, v, u, None, None)
    yield "p_b turned", kernels.forces_along, (b, q, v, u, z, case.p_b.swapaxes(0, 1))
    yield "p_b small", kernels.forces_along, (b, q, v, u, z, case.p_b[..., :-1])
    for name, index in (
        ("short", case.index[:, :-1]),
        ("of two", case.index[:2]),
        ("below", np.where(case.index == 7, -1, case.index)),
        ("beyond", np.where(case.index == 7, case.size, case.index)),
        ("int64", case.index.astype(np.int64)),
        ("none", None),
    ):
        yield f"index {name}", kernels.tangents, (b, q, v, False, index, case.size)
    for size in (0, -1, 1.5, None, 2**70):
        yield f"size {size}", kernels.tangents, (b, q, v, False, case.index, size)
    Y, x = case.Y(q), packed(case.Y(q), case.Y(q))
    yield "other U", kernels.gram, (Y, Y[:4])
    yield "no U", kernels.gram, (Y, None)
    yield "no Y", kernels.gram, (None, Y)
    yield "a row", kernels.gram, (Y[0, 0, 0], Y[0, 0, 0])
    yield "wide Y", kernels.gram, (np.zeros((9, 3)), np.zeros((9, 3)))
    yield "deep Y", kernels.gram, (np.zeros((3, 4)), np.zeros((3, 4)))
    yield "no g_o", kernels.strain, (None, Y, Y, b.tau)
    yield "g_o of two", kernels.strain, (b.g_o[:2], Y, None, None)
    yield "g_o small", kernels.strain, (b.g_o[:, 1:], Y, None, None)
    yield "tau of two", kernels.strain, (b.g_o, Y, Y, b.tau[:2])
    yield "p small", kernels.stressed, (x[..., 1:], Y)
    yield "p of two", kernels.stressed, (x[:, :2], Y)
    yield "deep", kernels.stressed, (np.zeros((2, 6)), np.zeros((2, 3, 40)))
    yield "axes", kernels.relative, (b, np.zeros((1,) * 63 + (n_q,)))
    yield from _refused_in_linear_algebra()


def _refused_in_linear_algebra():
    first, columns = np.array([0, 2, 3], dtype=np.int32), np.array([0, 2, 1], dtype=np.int32)
    values = np.ones(3)
    wrong = {
        "first beyond": (first + first // 3, columns, values),
        "first below": (first - 1, columns, values),
        "first turned": (np.array([0, 4, 3], dtype=np.int32), columns, values),
        "no first": (first[:0], columns, values),
        "column beyond": (first, columns + 1, values),
        "column below": (first, columns - 1, values),
        "fewer values": (first, columns, values[:2]),
        "fewer columns": (first, columns[:2], values),
        "int64": (first.astype(np.int64), columns, values),
        "none": (first, None, values),
    }
    for name, rows in wrong.items():
        yield name, kernels.csr_rows, (*rows, np.ones((2, 3)))
        yield name, kernels.csr_rows_transposed, (*rows, np.ones((2, 2)), 3)
    yield "x small", kernels.csr_rows, (first, columns, values, np.ones((2, 2)))
    yield "x a number", kernels.csr_rows, (first, columns, values, np.array(1.0))
    yield "x wide", kernels.csr_rows_transposed, (first, columns, values, np.ones((2, 3)), 3)
    yield "size below", kernels.csr_rows_transposed, (first, columns, values, np.ones(2), -3)
    yield "size", kernels.csr_rows_transposed, (first, columns, values, np.ones(2), "3")
    yield "weights", kernels.norm, (np.ones(3), np.ones(4))
    yield "weights", kernels.norm, (np.ones(3), np.ones(3) * 1j)
    yield "none", kernels.norm, (None, np.ones(3))
    yield "none", kernels.finite, (None,)
    yield "text", kernels.finite, ("x",)
    yield "count", kernels.finite, ()
    yield "none", kernels.add_scaled, (None, 1.0, None)
    yield from _refused_in_bands()


def _refused_in_bands():
    band, half = Band(float), Band.half
    K, B, factors, flat, order = band.K, band.B, band.factors, band.flat, band.order
    yield "flat beyond", kernels.band_factor, (K, B, factors, flat + 40, 8, half)
    yield "flat below", kernels.band_factor, (K, B, factors, flat - 10, 8, half)
    yield "n small", kernels.band_factor, (K, B, factors, flat, 4, half)
    yield "factors", kernels.band_factor, (K, B, factors[1:], flat, 8, half)
    yield "fewer K", kernels.band_factor, (K[1:], B, factors, flat, 8, half)
    for n, width in ((-1, half), (8, -1), (2**31, half), (8, 2**30), (8.0, half), (8, None)):
        yield f"n {n} {width}", kernels.band_factor, (K, B, factors, flat, n, width)
    lu, pivots, _ = band.factor()
    right = np.ones((2, 8))
    right_call = (lu, pivots, half, order, band.scale, right, False)
    for name, at, bad in (
        ("lu turned", 0, lu.T),
        ("lu flat", 0, lu.ravel()),
        ("pivots few", 1, pivots[1:]),
        ("pivot zero", 1, pivots * 0),
        ("pivot beyond", 1, pivots + 8),
        ("half", 2, half + 1),
        ("half below", 2, -1),
        ("order beyond", 3, order + 1),
        ("order below", 3, order - 1),
        ("order few", 3, order[1:]),
        ("scale", 4, band.scale[1:]),
        ("right", 5, right[:, 1:]),
        ("a number", 5, np.array(1.0)),
        ("none", 5, None),
    ):
        yield name, kernels.band_solve, (*right_call[:at], bad, *right_call[at + 1 :])


def refused(function, arguments):
    try:
        function(*arguments)
    except (ValueError, TypeError):
        return True
    return False


def test_wrong_arguments_are_refused():
    passed = [(f.__name__, name) for name, f, args in _refused() if not refused(f, args)]
    assert passed == []


def test_arguments_are_let_go():
    case = Case(7, 3, float)
    held = [case.q, case.block.A, case.index]
    counts = [sys.getrefcount(x) for x in held]
    for _ in range(3):
        kernels.forces(case.block, case.q, case.q)
        kernels.tangents(case.block, case.q, None, False, case.index, case.size)
        with pytest.raises(ValueError, match="index"):
            kernels.tangents(case.block, case.q, None, False, case.index, 1)
        assert sys.getrefcount(kernels.relative(case.block, case.q)) == 1 + (
            sys.version_info < (3, 14)
        )
    assert [sys.getrefcount(x) for x in held] == counts


def test_scipy_with_wider_integers_is_refused():
    # The routines are looked up once, so in a process of its own.
    program = """
import sys, types
import numpy as np
import scipy.linalg.cython_lapack as real
from ancfdae.kernels import band_factor
wide = types.ModuleType("scipy.linalg.cython_lapack")
wide.__pyx_capi__ = {"dgbtrf": real.__pyx_capi__["dgbtrs"]}
sys.modules["scipy.linalg.cython_lapack"] = wide
try:
    band_factor(np.ones(1), np.ones(0), np.ones(1), np.zeros(1, dtype=int), 1, 0)
except ImportError as error:
    assert "32-bit integers" in str(error), error
else:
    raise SystemExit("not refused")
"""
    subprocess.run([sys.executable, "-c", program], check=True)
