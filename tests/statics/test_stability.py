"""Stability: unstable motions are counted, whatever stands beside them."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from ancfdae import (
    CABLE_2D,
    Beam,
    Clamp,
    FollowerForce,
    Material,
    Pin,
    PointForce,
    PointMass,
    RigidBody,
    Scene,
    TorsionalSpringDamper,
    equilibrium,
)
from ancfdae.errors import StabilityWarning
from ancfdae.numerics.inertia import ConstrainedMatrix
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.sections import Rectangle
from ancfdae.statics.softness import negative_directions

E = 2.1e11
# Of Euler's cantilever of 1 m and 10 x 10 mm.
EULER = np.pi**2 * E * 0.01**4 / 12 / 4


def couplings(n, m, wide):
    """Patterns of a chain of n coordinates, or of a grid, and of m constraints of two each."""
    i = np.arange(n)
    reach = (1, round(np.sqrt(n)), 70) if wide else (1, 2)
    rows = np.concatenate([i, *(i[k:] for k in reach), *(i[:-k] for k in reach)])
    columns = np.concatenate([i, *(i[:-k] for k in reach), *(i[k:] for k in reach)])
    along = np.arange(m) * (n // m) if m else np.zeros(0, dtype=int)
    both = np.tile(np.arange(m), 2), np.concatenate([along, (along + 1) % n])
    return SparsityPattern((n, n), rows, columns), SparsityPattern((m, n), *both)


def on_null_space(K, B, D):
    """All eigenvalues of K x = kappa D x on B x = 0, by dense matrices."""
    Z = scipy.linalg.null_space(B / np.sqrt(D)) if len(B) else np.eye(len(K))
    return np.linalg.eigvals(Z.T @ (K / np.sqrt(np.outer(D, D))) @ Z)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("m", [0, 7])
@pytest.mark.parametrize("seed", range(6))
def test_all_negative_directions_are_counted(seed, m, wide):
    rng, n = np.random.default_rng(seed), 150
    of_K, of_B = couplings(n, m, wide)
    # Coordinates of twelve orders of stiffness; a few of negative stiffness, large and small.
    D = 10.0 ** rng.uniform(-6, 6, n)
    K = of_K.csr(0.2 * rng.standard_normal(of_K.size)).toarray()
    K = K + K.T + np.diag(np.where(rng.random(n) < 0.05, -1.0, 1.0))
    K *= np.sqrt(np.outer(D, D))
    B = rng.standard_normal(of_B.size)
    dense = on_null_space(K, of_B.dense(B), D).real
    matrices = SaddlePoint(of_K, of_B, np.ones(n), B)
    matrix = matrices.constrained.scaled(K[of_K.rows, of_K.columns], B, D)
    for sigma in (1e-12, 0.01, 0.3, 1.0):
        # Between these numbers no eigenvalue is as near as round-off.
        assert matrix.below(sigma) == np.sum(dense < -sigma)


@pytest.mark.parametrize("n", [20, 150], ids=["dense", "by Arnoldi"])
@pytest.mark.parametrize("seed", range(8))
def test_real_negative_eigenvalues_of_other_matrices_are_found(seed, n):
    rng, m = np.random.default_rng(seed), 5
    of_K, of_B = couplings(n, m, wide=False)
    # Pairs of coordinates that turn about each other: complex with any real part, or real twice.
    K = np.diag(rng.uniform(0.5, 2.0, n))
    turn = 0.4 if seed % 2 else 0.0
    K[10:12, 10:12] = [[-0.3, turn], [-turn, -0.3]]
    K += 0.01 * of_K.csr(rng.standard_normal(of_K.size)).toarray() * (turn > 0)
    B, D = rng.standard_normal(of_B.size), np.ones(n)
    dense = on_null_space(K, of_B.dense(B), D)
    matrix = SaddlePoint(of_K, of_B, D, B).constrained
    matrix = matrix.scaled(K[of_K.rows, of_K.columns], B, D)
    real = dense.real[np.abs(dense.imag) < 1e-9]
    assert matrix.is_odd(1e-12) == (np.sum(real < 0) % 2 == 1)
    one = np.zeros(of_K.size)
    one[of_K.diagonal] = 1.0
    assert matrix.has_negative(one) == np.any(real < 0)


def test_eigenvalues_that_arnoldi_does_not_find_are_found_densely(monkeypatch):
    """ARPACK gave up with a raw error on soft beams beside stiff ones under a follower force."""
    n, rng = 150, np.random.default_rng(0)
    of_K, of_B = couplings(n, 5, wide=False)
    K = (
        np.diag(rng.uniform(0.5, 2.0, n))
        + 0.01 * of_K.csr(rng.standard_normal(of_K.size)).toarray()
    )
    B, one = rng.standard_normal(of_B.size), np.zeros(of_K.size)
    one[of_K.diagonal] = 1.0
    matrix = SaddlePoint(of_K, of_B, np.ones(n), B).constrained
    matrix = matrix.scaled(K[of_K.rows, of_K.columns], B, np.ones(n))
    found = matrix.nearest(one, 12)

    def gives_up(*_, **__):
        raise scipy.sparse.linalg.ArpackNoConvergence("No convergence", [], [])

    monkeypatch.setattr(scipy.sparse.linalg, "eigs", gives_up)
    densely = matrix.nearest(one, 12)
    np.testing.assert_allclose(np.sort(np.abs(densely)), np.sort(np.abs(found)), rtol=1e-8)


def test_a_count_that_round_off_could_change_is_refused():
    # The first pivot is 1e-15: the factors are those of a matrix that differs by a tenth.
    of_K, of_B = (
        SparsityPattern.full((2, 2)),
        SparsityPattern((0, 2), np.zeros(0, int), np.zeros(0, int)),
    )
    K, none = np.array([0.0, 1.0, 1.0, 0.0]), np.zeros(0)
    matrix = SaddlePoint(of_K, of_B, np.ones(2), none).constrained.scaled(K, none, np.ones(2))
    assert matrix.below(1e-14) is None
    assert matrix.below(1e-6) == 1


def column(beside=(), joints=(), loads=(), force=0.0, **scene):
    """A steel column, and what stands beside it."""
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.01, 0.01), Material(1.0, E, 0.3))
    loads = [PointForce(rod.at_end, (force, 0.0), name="load"), *loads]
    beams = [part for part in beside if not isinstance(part, RigidBody)]
    bodies = [part for part in beside if isinstance(part, RigidBody)]
    joints = [Clamp(rod.at_start), *joints]
    return Scene([rod, *beams], joints, loads=loads, bodies=bodies, **scene)


def beside_a_strip(force=0.0):
    rubber = Material(1000, 1e5, 0.3)
    strip = Beam("strip", (0, 1), (1, 1), 8, Rectangle(0.001, 0.01), rubber)
    return column([strip], [Clamp(strip.at_start)], force=force)


def with_a_tie(force=0.0):
    rubber = Material(1000, 1e4, 0.3)
    tie = Beam("tie", (1, 0), (1, 1), 12, Rectangle(0.001, 0.01), rubber)
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.01, 0.01), Material(1.0, E, 0.3))
    return column([tie], [Pin(rod.at_end, tie.at_start), Clamp(tie.at_end)], force=force)


def with_links(force=0.0):
    """The column stands on its head; links hang from its tip, held by their weight of 1 mN."""
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.01, 0.01), Material(1.0, E, 0.3))
    links, joints, last = [], [], rod.at_end
    for k in range(12):
        link = RigidBody(f"link {k}", (1.05 + 0.1 * k, 0), mass=1e-5, inertia=1e-8)
        links.append(link)
        joints.append(Pin(last, link.at(-0.05, 0)))
        last = link.at(0.05, 0)
    return column(links, joints, force=force, gravity=(9.81, 0.0))


@pytest.mark.parametrize("scene", [column, beside_a_strip, with_a_tie, with_links])
def test_a_column_has_buckled_whatever_stands_beside_it(scene):
    at = [equilibrium(scene(force=-share * EULER)) for share in (0.9, 3.0, 8.0)]
    assert all(state.outcome.success for state in at)
    assert [state.outcome.stable_to is None for state in at] == [True, False, False]
    # To one per cent of the load: steps halve to 1/128 of the path. What settles has no path.
    for share, state in zip((3.0, 8.0), at[1:], strict=True):
        end = state.outcome
        assert (
            end.stable_to == 0.0 if end.downhill else abs(end.stable_to * share - 1) <= 0.02 * share
        )


@pytest.mark.parametrize("negative", [0, 1, 3])
def test_negative_directions_are_counted_where_constraints_depend_on_each_other(negative):
    """A row that stands twice leaves no pivots to trust; the null space is the same."""
    n = 12
    of_K, of_B = (
        SparsityPattern((n, n), np.arange(n), np.arange(n)),
        SparsityPattern((2, n), [0, 1], [0, 0]),
    )
    matrix = SaddlePoint(of_K, of_B, np.ones(n), np.ones(2)).constrained.scaled(
        np.where(np.arange(n) < negative + 1, -1.0, 1.0), np.ones(2), np.ones(n)
    )
    # The first coordinate is held, twice.
    assert matrix.below(1e-14) is None
    assert negative_directions(matrix) == negative


@pytest.mark.parametrize("negative", [0, 1, 3])
@pytest.mark.parametrize("apart", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("seed", range(4))
def test_constraints_that_nearly_depend_on_each_other_count_no_motion(seed, apart, negative):
    """Two rows hold two coordinates, at an angle: the other coordinates are free.

    The sign of the pivot of the second multiplier is round-off, which had counted -1 motions.
    """
    n, rng = 12, np.random.default_rng(seed)
    of_K = SparsityPattern.full((n, n))
    of_B = SparsityPattern((2, n), [0, 0, 1, 1], [0, 1, 0, 1])
    K, V = rng.uniform(0.1, 1.0, n), np.linalg.qr(rng.standard_normal((n - 2, n - 2)))[0]
    K[2 : 2 + negative] *= -1
    whole = np.diag(K)
    whole[2:, 2:] = V.T @ whole[2:, 2:] @ V
    B = np.array([0.6, 0.8, 0.6 - 0.8 * apart, 0.8 + 0.6 * apart])
    matrix = SaddlePoint(of_K, of_B, np.ones(n), B).constrained
    matrix = matrix.scaled(whole[of_K.rows, of_K.columns], B, np.ones(n))
    counts = {matrix.below(sigma) for sigma in 1e-14 * 16.0 ** np.arange(9)}
    assert counts <= {None, negative}
    assert negative_directions(matrix) == negative


@pytest.mark.parametrize("o", [0.0, 1000.0])
@pytest.mark.parametrize("beyond", [1e-7, 1e-9, 1e-11, -1e-11, -1e-9])
def test_a_link_just_above_its_critical_load_is_unstable(beyond, o):
    """P L = (1 + d) k on a torsion spring k: the stiffness is -d k, above round-off of eps k."""
    found = equilibrium(pressed_link(o, beyond))
    assert found.outcome.success
    assert (found.outcome.stable_to is None) == (beyond < 0)


def test_a_link_at_its_critical_load_is_undecided_in_words():
    with pytest.warns(StabilityWarning, match="undecided"):
        equilibrium(pressed_link(0.0, 2e-16))


def pressed_link(o, beyond):
    """A rigid bar of length one on a torsion spring of 10 N m/rad, under 10 (1 + beyond) N."""
    bar = RigidBody("bar", (o + 0.5, o), mass=1.0, inertia=1.0)
    foot, load = bar.at(-0.5, 0), (-10.0 * (1.0 + beyond), 0.0)
    loads = [TorsionalSpringDamper(foot, 10.0), PointForce(bar.at(0.5, 0), load)]
    return Scene(joints=[Pin(foot)], bodies=[bar], loads=loads)


def test_round_off_of_a_symmetric_stiffness_is_no_load_that_turns(monkeypatch):
    """Forces of cables have a potential; eigenvalues are sought where a load turns alone."""

    def refused(self, M):
        raise AssertionError("no load turns")

    monkeypatch.setattr(ConstrainedMatrix, "growing", refused)
    rope = Beam(
        "rope",
        (0, 0),
        (1.2, 0),
        256,
        Rectangle(0.02, 0.02),
        Material(1000, 2e8, 0),
        element=CABLE_2D,
    )
    load = PointForce(rope.at_end, (0, -5.0))
    found = equilibrium(Scene([rope], [Clamp(rope.at_start)], loads=[load]))
    assert found.outcome.success
    strip = Beam("strip", (0, 0), (1.2, 0), 4, Rectangle(0.02, 0.02), Material(1000, 2e8, 0))
    turning = Scene(
        [strip], [Clamp(strip.at_start)], loads=[FollowerForce(strip.at_end, (0, -0.1))]
    )
    with pytest.raises(AssertionError, match="no load turns"):
        equilibrium(turning)


@pytest.mark.parametrize("damping", [0.01, 0.1])
@pytest.mark.parametrize("force", [1.2, 1.45, 1.5, 1.8, 2.1])
def test_damping_that_lets_a_double_pendulum_flutter_is_said(force, damping):
    """Ziegler (1952): dampers in the hinges halve the force up to which it stands.

    M q'' + D q' + K q = 0 with M = [3 1; 1 1], D = d [2 -1; -1 1], K = [2 - P, P - 1; -1, 1].
    """
    lower = Beam(
        "lower", (0, 0), (1, 0), 1, Rectangle(0.01, 0.01), Material(1e-6, E, 0.3), rigid=True
    )
    upper = replace(lower, name="upper", start=(1, 0), end=(2, 0))
    scene = Scene(
        [lower, upper],
        [Pin(lower.at_start), Pin(lower.at_end, upper.at_start)],
        bodies=[PointMass(lower.at_end, 2.0), PointMass(upper.at_end, 1.0)],
        loads=[
            TorsionalSpringDamper(lower.at_start, 1.0, damping=damping),
            TorsionalSpringDamper(upper.at_start, 1.0, damping=damping, other=lower.at_end),
            FollowerForce(upper.at_end, (-force, 0)),
        ],
    )
    M, K = np.array([[3.0, 1.0], [1.0, 1.0]]), np.array([[2 - force, force - 1], [-1.0, 1.0]])
    D = damping * np.array([[2.0, -1.0], [-1.0, 1.0]])
    right = np.hstack([-np.linalg.solve(M, K), -np.linalg.solve(M, D)])
    s = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), right]))
    growing = s[np.argmax(s.real)]
    outcome = equilibrium(scene).outcome
    assert outcome.growth_searched
    assert "flutters" not in str(outcome)
    if growing.real < 0:
        assert outcome.growth is None
        return
    assert outcome.growth.real == pytest.approx(growing.real, rel=1e-4)
    assert abs(outcome.growth.imag) == pytest.approx(abs(growing.imag), rel=1e-5)
    assert "unstable with its damping" in str(outcome)
