"""The compiled kernels against plain NumPy formulas, and what they refuse.

CLOSE: numbers are of size one and sums have at most 200 terms, n eps = 4e-14, with a factor of ten
for products of such sums. A wrong term shows at order one.
"""

import itertools
import subprocess
import sys
from typing import NamedTuple

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


def bent(bending, Y):
    """Force of int 1/2 E I |r_x x r_xx|^2/|r_x|^4 dx at two Gauss points, none where E I = 0."""
    rows, F = [0, 1, (Y.shape[-2] + 1) // 2], np.zeros(Y.shape, dtype=np.result_type(Y, bending))
    stiffness, l = (x[:, None] for x in np.broadcast_to(bending, (Y.shape[-3], 2)).T)
    l = np.where(stiffness == 0, 1, l)
    for xi in (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)):
        one = np.ones_like(l)
        s_x = np.stack(
            [6 * xi * (1 - xi) / l, (1 - xi) * (1 - 3 * xi) * one, xi * (3 * xi - 2) * one]
        )
        s_xx = np.stack([(6 - 12 * xi) / l**2, (6 * xi - 4) / l, (6 * xi - 2) / l])
        r_x, r_xx = (sum(s[k] * Y[..., row, :] for k, row in enumerate(rows)) for s in (s_x, s_xx))
        pairs = ((r_x, r_x), (r_xx, r_xx), (r_x, r_xx))
        a, b, c = (np.sum(x * y, axis=-1, keepdims=True) for x, y in pairs)
        a = np.where(stiffness == 0, 1, a)
        on_x = (2 * c**2 / a**3 - b / a**2) * r_x - c / a**2 * r_xx
        on_xx = r_xx / a - c / a**2 * r_x
        for k, row in enumerate(rows):
            F[..., row, :] += stiffness * l / 2 * (s_x[k] * on_x + s_xx[k] * on_xx)
    return F


def slope_at(function, dtype):
    """Derivative at 0 of an analytic function, by its values on a circle (Cauchy).

    The error is (r/R)^8 with the radius R of analyticity, here above 0.4, and eps/r: 1e-13.
    """
    radius, roots = 1e-2, np.exp(2j * np.pi * np.arange(8) / 8)
    total = sum(function(radius * root) / root for root in roots) / (8 * radius)
    return total if np.dtype(dtype).kind == "c" else total.real


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


def sorted_pairs(pairs):
    """Where the pairs of three elements begin, their numbers and variables, as kernels ask."""
    element, variable, number = np.array(sorted(pairs), dtype=np.int64).reshape(-1, 3).T
    return np.searchsorted(element, np.arange(4)), number, variable


class Law(NamedTuple):
    """Arguments of a block."""

    A: np.ndarray
    g_o: np.ndarray
    bending: np.ndarray | None
    tau: np.ndarray
    vectors: np.ndarray
    d: int
    n_q: int


class Case:
    """Three elements that share nodes, k instants."""

    def __init__(self, n_y, d, dtype, alike=False, bends=True):
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
        bending = 2.0 + numbers(rng, (laws, 2), dtype) if bends else None
        if bends and laws > 1:
            bending[1] = 0
        tau = numbers(rng, n, dtype)
        n_q = vectors.max() * d + d + 2  # and two numbers of others
        self.given = Law(A, g_o, bending, tau, vectors, d, n_q)
        self.block = kernels.Block(*self.given)
        self.R = map_of(vectors, d, n_q)
        self.q, self.v, self.u, self.z = numbers(rng, (4, self.k, n_q), dtype)
        # Chords of 10, so that no tangent vanishes, whose curvature has none.
        self.q[:, nodes[:, 0] * d] += 10 * np.arange(n + 1)
        # Element, variable and number of what changes stresses (two by one), or tau.
        self.pairs = [(0, 3, 0), (2, 0, 1), (0, 0, 2), (2, 0, 3), (2, 0, 4), (1, 2, 5)]
        A_b = numbers(rng, (4, n_g, n_g), dtype)
        A_b, rest_b = A_b + A_b.swapaxes(1, 2), numbers(rng, (4, n_g + 2), dtype)
        self.law_b = A_b, rest_b, numbers(rng, 2, dtype), *sorted_pairs(self.pairs)
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
        return np.einsum("egh,...eh->...eg", np.broadcast_to(self.given.A, (3, *[self.n_g] * 2)), x)

    def p(self, q, v):
        Y, b = self.Y(q), self.given
        x = packed(Y, Y) / 2 - b.g_o
        if v is not None:
            x = x + b.tau[:, None] * packed(Y, self.Y(v))
        return self.law(x)

    def forces(self, q, v):
        Y, b = self.Y(q), self.given.bending
        F = product(self.p(q, v), Y)
        return self.lifted(F if b is None else F + bent(b, Y))

    def along(self, q, v, u, z, p_b=0):
        """Derivative of `forces` by the product rule."""
        Y, U, tau = self.Y(q), self.Y(u), self.given.tau[:, None]
        x = packed(Y, U)
        if v is not None:
            x = x + tau * (packed(U, self.Y(v)) + packed(Y, self.Y(z)))
        change = self.law(x) + p_b
        F = product(change, Y) + product(self.p(q, v), U)
        if self.given.bending is not None:
            F = F + slope_at(lambda s: bent(self.given.bending, Y + s * U), F.dtype)
        return self.lifted(F)

    def totals(self, q, v, pairs):
        """The force, and its derivatives along rows with the stresses of pairs added."""
        Y, V = self.Y(q[0]), None if v is None else self.Y(v[0])
        A_b, rest_b, tau_b = self.law_b[:3]
        x = packed(Y, Y) / 2 - self.given.g_o
        x = x if v is None else x + self.given.tau[:, None] * packed(Y, V)
        p_b, bent_b = (
            np.zeros((len(q), *x.shape[:1], *own), dtype=x.dtype)
            for own in (x.shape[1:], Y.shape[1:])
        )
        for e, i, number in pairs:
            if number < len(A_b):
                g_ob, bending_b = rest_b[number, :-2], rest_b[number, -2:]
                p_b[i + 1, e] += A_b[number] @ x[e] - self.law(np.tile(g_ob, (3, 1)))[e]
                bent_b[i + 1, e] += self.bent_along(Y[e], e, bending_b)
            else:
                p_b[i + 1, e] += tau_b[number - len(A_b)] * self.law(packed(Y, V))[e]
        rates = (q[1:], None, None) if v is None else (q[1:], v[:1], v[1:])
        total = self.along(q[:1], rates[1], rates[0], rates[2], p_b[1:])
        total = total + self.lifted(bent_b[1:])
        return np.concatenate([self.forces(q[:1], rates[1]), total])

    def bent_along(self, Y, e, bending_b):
        """Change of the bending force of element e along that of its stiffness and length."""
        if self.given.bending is None:
            return 0
        own = np.broadcast_to(self.given.bending, (3, 2))[e]
        if own[0] == 0:
            return 0
        return slope_at(lambda s: bent((own + s * bending_b)[None], Y[None])[0], Y.dtype)

    def tangent(self, q, v, damping):
        """Values of the tangent of one instant, from columns; elements stand apart."""
        b, values = self.given, np.zeros(self.size, dtype=q.dtype)
        for e in range(3):
            own = (b.vectors[e][:, None] * self.d + np.arange(self.d)).ravel()
            alone = Case.__new__(Case)
            alone.__dict__.update(self.__dict__)
            alone.R = np.where(np.arange(len(self.R)) // (self.n_y * self.d) == e, self.R.T, 0).T
            if b.bending is not None:  # Others have no tangents to bend.
                held = np.where(np.arange(3)[:, None] == e, b.bending, 0)
                alone.given = b._replace(bending=held)
            units, zero = np.eye(b.n_q)[own].astype(q.dtype), np.zeros((len(own), b.n_q))
            directions = (zero, units) if damping else (units, zero)
            at = q, np.zeros_like(q) if damping else v
            columns = alone.along(*at, *directions)[:, own]
            np.add.at(values, self.index[e], columns.T.ravel())
        return values


@pytest.fixture(params=[(s, t) for s in SIZES for t in DTYPES], ids=str, name="case")
def _case(request):
    (n_y, d), dtype = request.param
    return Case(n_y, d, dtype, alike=d == 3, bends=(n_y, d) not in ((5, 2), (1, 3)))


# ---------------------------------------------------------------- elements


def test_relative_vectors_and_their_transpose(case):
    close(case.block.relative(case.q), case.Y(case.q))
    close(case.block.relative(case.q[0]), case.Y(case.q[0]))
    close(case.block.lifted(case.F), case.lifted(case.F))
    for q, F in zip(odd_layouts(case.q), odd_layouts(case.F), strict=True):
        close(case.block.relative(q), case.Y(case.q))
        close(case.block.lifted(F), case.lifted(case.F))


def test_forces(case):
    q, v = case.q, case.v
    close(case.block.forces(q, None), case.forces(q, None))
    close(case.block.forces(q, v), case.forces(q, v))
    close(case.block.forces(q[0], v[0]), case.forces(q[0], v[0]))
    for other in odd_layouts(q):
        close(case.block.forces(other, v), case.forces(q, v))


def test_forces_along_directions(case):
    q, v, u, z = case.q, case.v, case.u, case.z
    close(case.block.forces_along(q, v, u, z), case.along(q, v, u, z))
    one = case.block.forces_along(q[0], v[0], u, z)
    close(one, case.along(q[:1], v[:1], u, z))
    close(case.block.forces_along(q, None, u, None), case.along(q, None, u, None))


def test_force_totals(case):
    q, v, stiff = case.q, case.v, case.law_b[:2]
    close(case.block.force_totals(q, v, case.law_b), case.totals(q, v, case.pairs))
    undamped = [pair for pair in case.pairs if pair[2] < len(stiff[0])]
    law_b = (*stiff, np.zeros(0), *sorted_pairs(undamped))
    close(case.block.force_totals(q, None, law_b), case.totals(q, None, undamped))
    none = (stiff[0][:0], stiff[1][:0], np.zeros(0), *sorted_pairs([]))
    close(case.block.force_totals(q[:1], v[:1], none), case.forces(q[:1], v[:1]))
    for other in odd_layouts(q):
        found = case.block.force_totals(other, v, case.law_b)
        close(found, case.totals(q, v, case.pairs))


def test_tangents(case):
    for damping, v in ((False, None), (False, case.v), (True, None)):
        found = case.block.tangents(case.q, v, damping, case.index, case.size)
        at = [None] * case.k if v is None else v
        expected = [case.tangent(x, y, damping) for x, y in zip(case.q, at, strict=True)]
        close(found, np.array(expected))


def test_packed_matrices(case):
    Y, U = case.Y(case.q), case.Y(case.v)
    close(kernels.strain(None, Y, U, None), packed(Y, U))
    close(kernels.strain(None, Y[0, 0], U[0, 0], None), packed(Y[0, 0], U[0, 0]))
    close(kernels.stressed(packed(Y, U), Y), product(packed(Y, U), Y))
    g_o, tau = case.given.g_o, case.given.tau
    x = packed(Y, Y) / 2 - g_o
    close(kernels.strain(g_o, Y, None, None), x)
    close(kernels.strain(g_o, Y, U, tau), x + tau[:, None] * packed(Y, U))
    for other in odd_layouts(Y):
        close(kernels.strain(None, other, U, None), packed(Y, U))
        close(kernels.strain(g_o, other, None, None), x)
        close(kernels.stressed(packed(Y, U), other), product(packed(Y, U), Y))


def test_real_and_complex_arguments_mix():
    case, step = Case(7, 3, float), 1e-40
    q, v = case.q + 1j * step * case.u, case.v + 1j * step * case.z
    F = case.block.forces(q, v)
    close(F.imag / step, case.block.forces_along(case.q, case.v, case.u, case.z))
    close(case.block.relative(q).imag / step, case.Y(case.u))
    Y, other = case.Y(case.q), case.Y(q)
    for one, two in ((Y, other), (other, Y)):
        close(kernels.strain(None, one, two, None), packed(one, two))
        p = kernels.strain(None, one, one, None)
        close(kernels.stressed(p, two), product(p, two))


def test_nothing_is_nothing():
    case = Case(7, 3, float)
    A, g_o, *_, vectors, d, n_q = case.given
    none = kernels.Block(A[:0], g_o[:0], None, None, vectors[:0], d, n_q)
    q, index = np.ones((2, n_q)), np.zeros((0, 576), dtype=np.int32)
    assert none.relative(q).shape == (2, 0, 7, 3)
    assert not none.forces(q, None).any()
    assert not none.tangents(q, None, False, index, 4).any()
    assert not none.lifted(np.zeros((2, 0, 7, 3))).any()
    assert case.block.forces(q[:0], None).shape == (0, n_q)
    assert case.block.forces_along(q[0], None, q[:0], None).shape == (0, n_q)
    none = np.zeros((4, 0, 7, 3))
    assert kernels.strain(None, none, none, None).shape == (4, 0, 28)
    assert kernels.finite(np.zeros(0))
    assert kernels.norm(np.zeros(0), np.zeros(0)) == 0
    empty, zero = np.zeros(0), np.zeros(1, dtype=np.int32)
    assert kernels.csr_rows(zero, zero[:0], empty, np.ones(3), None).shape == (0,)
    nothing = empty.astype(int)
    band = kernels.Band(0, nothing, empty, nothing)
    lu, pivots, _, info = band.factor(empty, empty)
    assert (lu.shape, info) == ((0, 1), 0)
    assert band.solve(lu, pivots, empty, np.zeros((2, 0)), False).shape == (2, 0)


# ---------------------------------------------------------------- linear algebra


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("x_dtype", DTYPES)
def test_sparse_products(dtype, x_dtype):
    rng = np.random.default_rng(1)
    dense = numbers(rng, (7, 9), dtype) * (rng.uniform(size=(7, 9)) < 0.4)
    dense[3] = 0
    M = scipy.sparse.csr_array(dense)
    rows = M.indptr.astype(np.int32), M.indices.astype(np.int32), M.data
    for k in (0, 1, 2, 3, 4, 5, 6, 8, 9, 13):  # rows go by eights and fours
        x, y = numbers(rng, (k, 9), x_dtype), numbers(rng, (k, 7), x_dtype)
        for other in (x, *odd_layouts(x)):
            close(kernels.csr_rows(*rows, other, None), x @ dense.T)
        close(kernels.csr_rows(*rows, y, 9), y @ dense)
    x = numbers(rng, 9, x_dtype)
    close(kernels.csr_rows(*rows, x, None), dense @ x)


@pytest.mark.parametrize("dtype", DTYPES)
def test_norm_is_that_of_the_real_part(dtype):
    x = numbers(np.random.default_rng(2), (2, 5), dtype)
    weights = np.arange(1.0, 11).reshape(2, 5)
    expected = np.sqrt(np.sum(weights * x.real**2))
    assert kernels.norm(x, weights) == pytest.approx(expected, rel=CLOSE)
    assert kernels.norm(x[:, ::-1], weights[:, ::-1]) == pytest.approx(expected, rel=CLOSE)
    more = np.arange(3.0), np.array([1.0, 2, 3])
    both = expected + np.sqrt(2 * 1 + 3 * 4)
    assert kernels.norm(x, weights, *more) == pytest.approx(both, rel=CLOSE)


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
        return self.made().factor(self.K, self.B)

    def made(self):
        return kernels.Band(self.half, self.flat, self.factors, self.order)


@pytest.mark.parametrize("dtypes", list(itertools.product(DTYPES, DTYPES)))
@pytest.mark.parametrize("right_dtype", DTYPES)
def test_banded_solutions(dtypes, right_dtype):
    band, dtype = Band(*dtypes), np.result_type(*dtypes)
    lu, pivots, of_B, info = band.factor()
    assert info == 0
    scale = band.scale * np.where(np.arange(8) < 6, 1, of_B)
    right = numbers(np.random.default_rng(5), (3, 8), right_dtype)
    for transposed in (False, True):
        expected = np.linalg.solve(band.dense.T if transposed else band.dense, right.T).T
        for other in (right, right[1], *odd_layouts(right)):
            x = band.made().solve(lu, pivots, scale, other, transposed)
            # Times the condition of the matrix, which is 30.
            assert np.allclose(
                x, expected if other.ndim == 2 else expected[1], rtol=1e-11, atol=1e-11
            )
            assert x.dtype == np.result_type(dtype, right_dtype)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("size", [0.0, 1.0, 1e-9, 1e15])
def test_constraints_are_scaled_to_the_size_of_the_matrix(size, dtype):
    band = Band(dtype, dtype)
    band.K *= size
    *_, of_B, _ = band.factor()
    largest = np.max(np.abs(band.K.real * band.factors[: len(band.K)])) if size else 1.0
    # A power of two, next to the largest entry; of complex ones both parts count.
    assert np.frexp(of_B)[0] == 0.5
    assert 0.5 <= of_B / largest <= 4.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, complex(0, np.nan)])
def test_factors_of_what_is_not_finite_are_refused(bad):
    for name in ("K", "B"):
        band = Band(complex if isinstance(bad, complex) else float)
        getattr(band, name)[-1] = bad
        assert band.factor()[3] == -1


def test_zero_pivot_is_told():
    band = Band(float)
    band.K[:], band.B[:] = 0, 0
    assert band.factor()[3] == 1


class EnvelopeMatrix:
    """A symmetric matrix with two multipliers behind their coordinates."""

    n = 16

    first = np.cumsum([0, *np.minimum(8, np.arange(n, 0, -1))]).astype(np.int32)

    def __init__(self, dtype):
        rng = np.random.default_rng(4)
        self.order, self.signs, last = rng.permutation(self.n), np.ones(self.n), [7, self.n - 1]
        self.signs[last] = -1
        columns = np.repeat(np.arange(self.n), np.diff(self.first))
        rows = columns + np.arange(self.first[-1]) - self.first[columns]
        values = numbers(rng, len(rows), dtype) * 0.3
        if dtype is complex:  # almost real, as in a complex step
            values.imag *= 0.1
        diagonal = rows == columns
        values[diagonal] = np.where(self.signs > 0, 4.0 + values[diagonal].real, 0.0)
        own = np.isin(rows, last) | np.isin(columns, last)
        # Values of K in another order, those of B behind them, and a value that is not taken.
        shuffled = rng.permutation(np.flatnonzero(~own))
        self.K, self.B = np.append(np.nan, values[shuffled]), values[own]
        self.chosen = np.arange(1, 1 + len(shuffled), dtype=np.int32)
        self.places = np.concatenate([shuffled, np.flatnonzero(own)]).astype(np.int32)
        dense = np.zeros((self.n, self.n), dtype=dtype)
        dense[rows, columns] = dense[columns, rows] = values
        self.dense = np.empty_like(dense)
        self.dense[np.ix_(self.order, self.order)] = dense

    def factor(self):
        return self.made().factor(((0.25, self.K), (0.75, self.K)), self.B)

    def made(self):
        return kernels.Envelope(self.first, self.chosen, self.places, self.signs, self.order)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("right_dtype", DTYPES)
def test_solutions_of_symmetric_matrices(dtype, right_dtype):
    matrix = EnvelopeMatrix(dtype)
    factors, failed = matrix.factor()
    assert failed == 0
    for rows in (1, 2, 3, 4, 5, 8, 9, 13):
        right = numbers(np.random.default_rng(rows), (rows, matrix.n), right_dtype)
        expected = np.linalg.solve(matrix.dense, right.T).T
        for other in (right, right[0], *odd_layouts(right)):
            x = matrix.made().solve(factors, other)
            known = expected if other.ndim == 2 else expected[0]
            assert np.allclose(x, known, rtol=1e-11, atol=1e-11)  # its condition is 30
            assert x.dtype == np.result_type(dtype, right_dtype)


def test_pivots_without_their_sign_are_told():
    for k in range(EnvelopeMatrix.n):
        matrix = EnvelopeMatrix(float)
        matrix.signs[k] *= -1
        assert matrix.factor()[1] == k + 1
    for name in ("K", "B"):
        matrix = EnvelopeMatrix(float)
        getattr(matrix, name)[-1] = np.nan
        assert matrix.factor()[1] > 0
    matrix = EnvelopeMatrix(float)
    matrix.K[:] = matrix.B[:] = 0
    assert matrix.factor()[1] == 1


@pytest.mark.parametrize(("more", "failed"), [(1e-14, 2), (1e-12, 0)])
def test_pivots_that_are_round_off_are_told(more, failed):
    K, first = np.array([1.0, 1.0, 1 + more]), np.array([0, 2, 3], np.int32)
    every = np.arange(3, dtype=np.int32)
    envelope = kernels.Envelope(first, every, every, np.ones(2), np.arange(2))
    assert envelope.factor(((1.0, K),), K[:0])[1] == failed


# ---------------------------------------------------------------- what is refused


def _refused():
    """Wrong calls: each is one argument away from a right one."""
    case = Case(7, 3, float)
    b, block, q, v, u, z = case.given, case.block, case.q, case.v, case.u, case.z
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
        "one item more": (*b, 3),
    }
    for name, wrong in blocks.items():
        yield name, kernels.Block, tuple(wrong)
    laws = {
        "A of two": b._replace(A=b.A[:2]),
        "A of one": b._replace(A=b.A[:1]),
        "A small": b._replace(A=b.A[:, :-1]),
        "A missing": b._replace(A=None),
        "A flat": b._replace(A=b.A.reshape(3, -1)),
        "g_o of one": b._replace(g_o=b.g_o[:1]),
        "g_o small": b._replace(g_o=b.g_o[:, :-1]),
        "bending small": b._replace(bending=b.bending[:, :-1]),
        "bending of two": b._replace(bending=b.bending[:2]),
        "tau of one": b._replace(tau=b.tau[:1]),
        "tau a number": b._replace(tau=np.array(0.1)),
        "A of objects": b._replace(A=b.A.astype(object)),
    }
    for name, wrong in laws.items():
        yield name, kernels.Block, tuple(wrong)
    for name, bad in (("wide", wide), ("number", np.array(1.0)), ("text", "q"), ("none", None)):
        yield f"q {name}", block.relative, (bad,)
        yield f"q {name}", block.forces, (bad, None)
        yield f"q {name}", block.forces_along, (bad, None, u, None)
        yield f"u {name}", block.forces_along, (q, None, bad, None)
        yield f"q {name}", block.tangents, (bad, None, False, case.index, case.size)
        yield f"F {name}", block.lifted, (bad,)
    yield "fewer v", block.forces, (q, v[:4])
    yield "flat F", block.lifted, (case.F.reshape(5, -1),)
    yield "F of two", block.lifted, (case.F[:, :2],)
    yield "one v", block.forces_along, (q, v[0], u, z)
    yield "two q", block.forces_along, (q[:2], v[:2], u, z)
    yield "fewer z", block.forces_along, (q, v, u, z[:4], None)
    yield "no z", block.forces_along, (q, v, u, None)
    A_b, rest_b, tau_b, first, pairs, variables = case.law_b
    for name, law_b in {
        "A_b small": (A_b[:, :-1], *case.law_b[1:]),
        "A_b none": (None, *case.law_b[1:]),
        "A_b fewer": (A_b[:-1], rest_b[:-1], *case.law_b[2:]),
        "rest_b fewer": (A_b, rest_b[:-1], *case.law_b[2:]),
        "rest_b small": (A_b, rest_b[..., :-1], *case.law_b[2:]),
        "rest_b of one": (A_b, rest_b[:, :1], *case.law_b[2:]),
        "tau_b fewer": (A_b, rest_b, tau_b[:-1], *case.law_b[3:]),
        "first short": (*case.law_b[:3], first[1:], pairs, variables),
        "first late": (*case.law_b[:3], first + (first == 0), pairs, variables),
        "first back": (*case.law_b[:3], first[[0, 2, 1, 3]], pairs, variables),
        "first beyond": (*case.law_b[:3], first + (first == first[-1]), pairs, variables),
        "first far": (*case.law_b[:3], np.array([0, 2**40, 2**40, first[-1]]), pairs, variables),
        "pairs below": (*case.law_b[:4], pairs - 1, variables),
        "pairs beyond": (*case.law_b[:4], pairs + 1, variables),
        "variables below": (*case.law_b[:5], variables - 1),
        "variables beyond": (*case.law_b[:5], variables + 1),
        "variables fewer": (*case.law_b[:5], variables[1:]),
        "variables none": (*case.law_b[:5], None),
    }.items():
        yield name, block.force_totals, (q, v, law_b)
    yield "tau_b without v", block.force_totals, (q, None, case.law_b)
    yield "fewer v", block.force_totals, (q, v[:4], case.law_b)
    yield "one row", block.force_totals, (q[:1], v[:1], case.law_b)
    for name, index in (
        ("short", case.index[:, :-1]),
        ("of two", case.index[:2]),
        ("below", np.where(case.index == 7, -1, case.index)),
        ("beyond", np.where(case.index == 7, case.size, case.index)),
        ("int64", case.index.astype(np.int64)),
        ("none", None),
    ):
        yield f"index {name}", block.tangents, (q, v, False, index, case.size)
    for size in (0, -1, 1.5, None, 2**70):
        yield f"size {size}", block.tangents, (q, v, False, case.index, size)
    Y, x = case.Y(q), packed(case.Y(q), case.Y(q))
    yield "other U", kernels.strain, (None, Y, Y[:4], None)
    yield "no U", kernels.strain, (None, Y, None, None)
    yield "no Y", kernels.strain, (None, None, Y, None)
    yield "a row", kernels.strain, (None, Y[0, 0, 0], Y[0, 0, 0], None)
    yield "wide Y", kernels.strain, (None, np.zeros((9, 3)), np.zeros((9, 3)), None)
    yield "deep Y", kernels.strain, (None, np.zeros((3, 4)), np.zeros((3, 4)), None)
    yield "no g_o", kernels.strain, (None, Y, Y, b.tau)
    yield "g_o of two", kernels.strain, (b.g_o[:2], Y, None, None)
    yield "g_o small", kernels.strain, (b.g_o[:, 1:], Y, None, None)
    yield "tau of two", kernels.strain, (b.g_o, Y, Y, b.tau[:2])
    yield "p small", kernels.stressed, (x[..., 1:], Y)
    yield "p of two", kernels.stressed, (x[:, :2], Y)
    yield "deep", kernels.stressed, (np.zeros((2, 6)), np.zeros((2, 3, 40)))
    yield "axes", block.relative, (np.zeros((1,) * 63 + (n_q,)),)
    yield from _refused_in_linear_algebra()


def _refused_in_linear_algebra():
    first, columns = np.array([0, 2, 3], dtype=np.int32), np.array([0, 2, 1], dtype=np.int32)
    values = np.ones(3)
    wrong = {
        "first beyond": (first + first // 3, columns, values),
        "first below": (first - 1, columns, values),
        "first turned": (np.array([0, 4, 3], dtype=np.int32), columns, values),
        "an entry before the first row": (first + np.array([1, 0, 0], np.int32), columns, values),
        "an entry behind the last row": (first - np.array([0, 0, 1], np.int32), columns, values),
        "no first": (first[:0], columns, values),
        "column beyond": (first, columns + 1, values),
        "column below": (first, columns - 1, values),
        "fewer values": (first, columns, values[:2]),
        "fewer columns": (first, columns[:2], values),
        "int64": (first.astype(np.int64), columns, values),
        "none": (first, None, values),
    }
    for name, rows in wrong.items():
        yield name, kernels.csr_rows, (*rows, np.ones((2, 3)), None)
        yield name, kernels.csr_rows, (*rows, np.ones((2, 2)), 3)
        if name != "fewer values":
            diagonal = np.arange(4, dtype=np.int32), np.arange(3, dtype=np.int32)
            yield name, kernels.narrow_order, (*diagonal, *rows[:2])
    yield "x small", kernels.csr_rows, (first, columns, values, np.ones((2, 2)), None)
    yield "x a number", kernels.csr_rows, (first, columns, values, np.array(1.0), None)
    yield "x wide", kernels.csr_rows, (first, columns, values, np.ones((2, 3)), 3)
    yield "size below", kernels.csr_rows, (first, columns, values, np.ones(2), -3)
    yield "size", kernels.csr_rows, (first, columns, values, np.ones(2), "3")
    yield "size of M^T", kernels.csr_rows, (first, columns, values, np.ones(3), 3)
    yield "odd", kernels.norm, (np.ones(3), np.ones(3), np.ones(3))
    yield "nothing", kernels.norm, ()
    yield "weights", kernels.norm, (np.ones(3), np.ones(4))
    yield "weights", kernels.norm, (np.ones(3), np.ones(3) * 1j)
    yield "none", kernels.norm, (None, np.ones(3))
    yield "none", kernels.finite, (None,)
    yield "text", kernels.finite, ("x",)
    yield "count", kernels.finite, ()
    yield from _refused_in_bands()
    yield from _refused_in_envelopes()


def _spoiled(function, call, cases):
    for name, at, bad in cases:
        yield name, function, (*call[:at], bad, *call[at + 1 :])


def _refused_in_bands():
    band = Band(float)
    K, B, half, flat, order = band.K, band.B, band.half, band.flat, band.order
    yield from _spoiled(
        kernels.Band,
        (half, flat, band.factors, order),
        (
            ("flat beyond", 1, flat + 40),
            ("flat below", 1, flat - 10),
            ("factors", 2, band.factors[1:]),
            *((f"half {x}", 0, x) for x in (half - 1, -1, 2**30, 2**31, 4.0, None)),
            ("order beyond", 3, order + 1),
            ("order below", 3, order - 1),
            ("order few", 3, order[1:]),
        ),
    )
    yield "fewer K", band.made().factor, (K[1:], B)
    lu, pivots, *_ = band.factor()
    right = np.ones((2, 8))
    yield from _spoiled(
        band.made().solve,
        (lu, pivots, band.scale, right, False),
        (
            ("lu turned", 0, lu.T),
            ("lu flat", 0, lu.ravel()),
            ("pivots few", 1, pivots[1:]),
            ("pivot zero", 1, pivots * 0),
            ("pivot beyond", 1, pivots + 8),
            ("scale", 2, band.scale[1:]),
            ("right", 3, right[:, 1:]),
            ("a number", 3, np.array(1.0)),
            ("none", 3, None),
        ),
    )


def _refused_in_envelopes():
    m = EnvelopeMatrix(float)
    late = m.first + 1
    yield from _spoiled(
        kernels.Envelope,
        (m.first, m.chosen, m.places, m.signs, m.order),
        (
            ("chosen below", 1, m.chosen - 2),
            ("places beyond", 2, m.places + 1),
            ("places below", 2, m.places - 1),
            ("first late", 0, late),
            ("first falls", 0, m.first[::-1]),
            ("in disorder", 0, np.concatenate([m.first[:1], m.first[1:2] + 4, m.first[2:]])),
            ("column too long", 0, np.append(m.first[:-1], m.first[-1:] + 1)),
            ("first empty", 0, m.first[:0]),
            ("signs few", 3, m.signs[1:]),
            ("order beyond", 4, m.order + 1),
            ("order below", 4, m.order - 1),
            ("order few", 4, m.order[1:]),
            ("none", 0, None),
        ),
    )
    terms = ((1.0, m.K),)
    for name, at, bad in (("chosen beyond", 1, m.chosen + 1), ("places few", 2, m.places[1:])):
        call = (m.first, m.chosen, m.places, m.signs, m.order)
        wrong = kernels.Envelope(*call[:at], bad, *call[at + 1 :])
        yield name, wrong.factor, (terms, m.B)
    yield from _spoiled(
        m.made().factor,
        (terms, m.B),
        (
            ("fewer K", 0, ((1.0, m.K[:-1]),)),
            ("terms of two sizes", 0, ((1.0, m.K), (1.0, m.K[1:]))),
            ("no terms", 0, ()),
            ("no number", 0, ((m.K, 1.0),)),
            ("a list", 0, [(1.0, m.K)]),
            ("more B", 1, np.append(m.B, 1.0)),
            ("none", 0, None),
        ),
    )
    yield from _spoiled(
        m.made().solve,
        (m.factor()[0], np.ones((2, m.n))),
        (
            ("factors few", 0, m.factor()[0][1:]),
            ("right", 1, np.ones((2, m.n - 1))),
            ("a number", 1, np.array(1.0)),
            ("none", 1, None),
        ),
    )


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
    held = [case.q, case.given.A, case.index]
    counts = [sys.getrefcount(x) for x in held]
    for _ in range(3):
        case.block.forces(case.q, case.q)
        case.block.tangents(case.q, None, False, case.index, case.size)
        with pytest.raises(ValueError, match="index"):
            case.block.tangents(case.q, None, False, case.index, 1)
        assert sys.getrefcount(case.block.relative(case.q)) == 1 + (sys.version_info < (3, 14))
    assert [sys.getrefcount(x) for x in held] == counts


def test_scipy_with_wider_integers_is_refused():
    # The routines are looked up once, so in a process of its own.
    program = """
import sys, types
import numpy as np
import scipy.linalg.cython_lapack as real
from ancfdae.kernels import Band
wide = types.ModuleType("scipy.linalg.cython_lapack")
wide.__pyx_capi__ = {"dgbtrf": real.__pyx_capi__["dgbtrs"]}
sys.modules["scipy.linalg.cython_lapack"] = wide
try:
    zero, one = np.zeros(1, dtype=int), np.ones(1)
    Band(0, zero, one, zero).factor(one, one[:0])
except ImportError as error:
    assert "32-bit integers" in str(error), error
else:
    raise SystemExit("not refused")
"""
    subprocess.run([sys.executable, "-c", program], check=True)
