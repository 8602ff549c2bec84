"""L D L^T by fronts (docs/theory/09-linear-algebra.md) against dense LU of LAPACK."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Terminal,
    assemble,
    gradient,
    simulate,
)
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.numerics.fronts import Fronts
from ancfdae.numerics.linear_solvers import SaddlePoint, _Places
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.observables import position
from tests.support.nets import net

EPS = float(np.finfo(float).eps)


def grid(nodes, spread, seed):
    """Return patterns and values of K, positive definite on a grid of nodes, and of B.

    Stiffnesses differ by up to `spread`; each constraint couples two coordinates at random.
    """
    random = np.random.default_rng(seed)
    n, m = nodes**2, nodes
    number = np.arange(n).reshape(nodes, nodes)
    pairs = np.concatenate(
        [
            np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()]),
            np.stack([number[:-1].ravel(), number[1:].ravel()]),
        ],
        axis=1,
    )
    dense = np.zeros((n, n))
    for i, j in pairs.T:
        k = spread ** random.uniform(-0.5, 0.5)
        dense[[i, j], [i, j]] += k
        dense[[i, j], [j, i]] -= k
    dense[np.arange(n), np.arange(n)] += spread**-0.5
    chosen = random.permutation(n)[: 2 * m].reshape(m, 2)
    B = np.zeros((m, n))
    for row, (i, j) in enumerate(chosen):
        B[row, [i, j]] = random.uniform(0.5, 2, 2)
    K_pattern = SparsityPattern((n, n), *np.nonzero(dense))
    B_pattern = SparsityPattern((m, n), *np.nonzero(B))
    return (K_pattern, dense[dense != 0]), (B_pattern, B[B != 0])


def dense_saddle(K, B):
    K, B = K[0].dense(K[1]), B[0].dense(B[1])
    return np.block([[K, B.T], [B, np.zeros((len(B), len(B)))]])


@pytest.mark.parametrize("spread", [1.0, 1e3, 1e9])
@pytest.mark.parametrize("nodes", [2, 5, 13])
def test_solutions_are_those_of_dense_lu(nodes, spread):
    K, B = grid(nodes, spread, seed=nodes)
    matrix = dense_saddle(K, B)
    solve = Fronts(K[0], B[0]).factor(((0.25, K[1]), (0.75, K[1])), B[1])
    x = np.random.default_rng(1).standard_normal((7, len(matrix)))
    right = x @ matrix
    found = solve(right)
    residual = np.abs(right - found @ matrix)
    # Refined: a few units of round-off of |A| |x| + |b| in each entry, and the same once more from
    # the product that makes the residual.
    assert np.all(residual <= 50 * EPS * (np.abs(found) @ np.abs(matrix)).max(axis=1)[:, None])
    # Errors are at most ten times as large as those of LAPACK with exchanges.
    lapack = np.linalg.solve(matrix, right.T).T
    assert np.abs(found - x).max() <= 10 * np.abs(lapack - x).max() + 100 * EPS * np.abs(x).max()


def test_complex_right_sides_are_solved_in_their_parts():
    K, B = grid(6, 1e2, seed=3)
    solve = Fronts(K[0], B[0]).factor(((1.0, K[1]),), B[1])
    right = np.random.default_rng(2).standard_normal((2, 3, 42))
    both = solve(right[0] + 1j * right[1])
    # The same operations in the same order on each part.
    assert np.allclose(both.real, solve(right[0]), rtol=0, atol=1e-13)
    assert np.allclose(both.imag, solve(right[1]), rtol=0, atol=1e-13)


def test_a_direction_of_negative_stiffness_has_a_pivot_of_the_wrong_sign():
    K, B = grid(6, 1e2, seed=4)
    values = K[1].copy()
    values[K[0].diagonal] -= 0.05 * np.abs(K[1]).max()
    null = np.linalg.svd(B[0].dense(B[1]))[2][B[0].shape[0] :]
    assert np.linalg.eigvalsh(null @ K[0].dense(values) @ null.T)[0] < -1e-2
    assert Fronts(K[0], B[0]).factor(((1.0, values),), B[1]) is None


def test_other_units_change_no_digit():
    # Scales are powers of two, and so are these units.
    K, B = grid(7, 1e4, seed=5)
    fronts = Fronts(K[0], B[0])
    right = np.random.default_rng(3).standard_normal(sum(p.shape[0] for p in (K[0], B[0])))
    factors = np.where(np.arange(len(right)) < K[0].shape[0], 1.0, 2.0**40)
    one = fronts.factor(((1.0, K[1]),), B[1])(right)
    other = fronts.factor(((2.0**60, K[1]),), 2.0**20 * B[1])(right * 2.0**60 / factors)
    assert np.array_equal(one, np.where(factors == 1.0, 1.0, 2.0**-40) * other)


def test_constraints_that_depend_on_each_other_are_no_success():
    K, B = grid(5, 1.0, seed=6)
    rows = np.append(B[0].rows, B[0].rows[B[0].rows == 0] + B[0].shape[0])
    columns = np.append(B[0].columns, B[0].columns[B[0].rows == 0])
    twice = SparsityPattern((B[0].shape[0] + 1, B[0].shape[1]), rows, columns)
    values = np.append(B[1], B[1][B[0].rows == 0])
    solve = Fronts(K[0], twice).factor(((1.0, K[1]),), values)
    right = np.zeros(25 + 6)
    right[-1] = 1.0  # The two rows contradict each other.
    assert solve is None or solve(right) is None


def test_matrices_of_a_net_are_solved_as_with_exchanges():
    system = assemble(net(7))
    values = system.constraint_q(0.0, system.start()[0])
    patterns = system.pattern, system.constraint_pattern
    by_fronts = SaddlePoint(*patterns, system.weights, values, symmetric=True)
    exchanging = SaddlePoint(*patterns, system.weights, values)
    assert by_fronts.layout(band=True) is None  # Its band is too wide.
    K = system.mass(None)
    right = np.random.default_rng(7).standard_normal(by_fronts.size)
    one, other = (each.factor(K, values).solve(right) for each in (by_fronts, exchanging))
    assert np.allclose(one, other, rtol=0, atol=1e-11 * np.abs(other).max())


def test_the_gradient_of_a_net_is_the_limit_of_differences():
    def fallen(youngs_modulus, gravity=-9.81):
        scene = net(7, youngs_modulus, gravity)
        middle = Terminal(position(scene.beams[3].at(0.5), 2))
        return scene, middle, 0.05, HHT(0.005)

    design = ["x3.youngs_modulus", "scene.gravity_z"]
    one, other = (
        gradient(*fallen(1e7), design=design, method=how)
        for how in (DirectDifferentiation(), Adjoint())
    )
    # Transposed solves of the same matrices: round-off of ten steps.
    assert np.allclose(one.gradient, other.gradient, rtol=1e-9)
    before, behind = (
        gradient(*fallen(1e7, -9.81 * x), design=design).value for x in (1 - 1e-4, 1 + 1e-4)
    )
    # Central differences: the square of the step, and Newton's 1e-10 over it.
    difference = (behind - before) / (2e-4 * -9.81)
    assert np.isclose(difference, one.gradient[1], rtol=2e-6)


@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint()], ids=repr)
def test_derivatives_of_a_wide_system_are_those_of_a_complex_step(damping, method):
    # Fronts solve for both parts of a complex right side; with damping, whose matrices are no sum
    # of two terms, SuperLU does, which the kernel calls.
    scene = net(7, damping=damping)
    system = assemble(scene, ["x3.youngs_modulus", "x3.density"])
    assert saddle_point(system, 0.0).layout(band=True) is None
    objective = Terminal(position(scene.beams[3].at(0.5), 2))
    run = system, objective, 0.025, HHT(0.005)
    found, exact = (gradient(*run, method=how).gradient for how in (method, ComplexStep()))
    # Round-off of five steps of 1e7 Pa; the imaginary part is solved for, not differenced.
    assert np.all(exact != 0.0)
    np.testing.assert_allclose(found, exact, rtol=1e-8)


@pytest.mark.parametrize("nodes", [2, 5, 11])
def test_growth_is_that_of_a_dense_elimination_in_the_same_order(nodes):
    K, B = grid(nodes, 1e3, seed=10 + nodes)
    fronts = Fronts(K[0], B[0], np.arange(sum(p.shape[0] for p in (K[0], B[0]))))
    diagonal = K[1][K[0].diagonal]
    root = 1 / np.sqrt(diagonal)
    values = K[1] * root[K[0].rows] * root[K[0].columns]
    rows = B[1] * root[B[0].columns]
    rows = rows / np.sqrt(np.bincount(B[0].rows, rows * rows))[B[0].rows]
    left = dense_saddle((K[0], values), (B[0], rows))[np.ix_(fronts.order, fronts.order)]
    left[np.arange(len(left)), np.arange(len(left))] -= 1e-7 * (fronts.order >= K[0].shape[0])
    sums = np.zeros(len(left))
    for k in range(len(left)):
        pivot, column = left[k, k], left[k:, k].copy()
        sums[k:] += column**2 / abs(pivot)
        left[k:, k:] -= np.outer(column, column) / pivot
    growth = fronts.growth(((1.0, values),), rows)
    # The perturbation is 1e-7 of rows scaled by powers of two, up to a factor of four.
    assert growth == pytest.approx(np.max(sums), rel=1e-5)


@pytest.mark.parametrize("seed", [21, 22, 23])
def test_negative_directions_are_those_of_eigenvalues_on_the_null_space(seed):
    K, B = grid(6, 1e2, seed)
    places = _Places(K[0], B[0], np.arange(sum(p.shape[0] for p in (K[0], B[0]))))
    pattern = places.sparse.constrained
    ones = np.ones(K[0].shape[0])
    diagonal = K[0].diagonal
    null = np.linalg.svd(B[0].dense(B[1]))[2][B[0].shape[0] :]
    kappa = np.linalg.eigvalsh(null @ K[0].dense(K[1]) @ null.T)
    # One eigenvalue is moved below zero. Fronts have -1e-7 in place of zeros, so that they prove
    # nothing of stiffnesses below 1e-7 of the largest; factors without them count then.
    away = 1e-3 * kappa[-1]
    values = K[1].copy()
    values[diagonal] -= kappa[0] + away
    for wide in (True, False):
        pattern.wide = wide
        matrix = pattern.scaled(values, B[1], ones)
        assert matrix.below(0.5 * away) == 1
        assert matrix.below(2.0 * away) == 0
    assert matrix._none_below(2.0 * away)
    assert not matrix._none_below(0.5 * away)
    small = 1e-10 * kappa[-1]
    values[diagonal] += away - small
    matrix = pattern.scaled(values, B[1], ones)
    assert (matrix.below(0.5 * small), matrix.below(2.0 * small)) == (1, 0)


def test_corrections_of_few_digits_leave_no_gap_and_no_error():
    """Newton's corrections are refined to 1e-6; the test of convergence looks at all entries."""
    system = assemble(net(7))
    rough, fine = (simulate(system, 0.05, HHT(0.005, newton_tolerance=x)) for x in (1e-10, 1e-12))
    gap = max(np.max(np.abs(system.constraint(t, q))) for t, q in zip(fine.t, fine.q, strict=True))
    # Of points at distances of one, which are equal to a unit of round-off.
    assert gap <= 4 * EPS
    fallen = np.max(np.abs(fine.q[-1] - fine.q[0]))
    assert np.max(np.abs(rough.q[-1] - fine.q[-1])) <= 1e-10 * fallen
