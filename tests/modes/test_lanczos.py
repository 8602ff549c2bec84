"""Lowest modes by Lanczos's method with a count, against dense eigenvalues of LAPACK."""

import numpy as np
import pytest
import scipy

from ancfdae import Beam, Clamp, Material, Scene, SpringDamper, assemble, modes
from ancfdae.modes import lanczos, undamped
from ancfdae.modes.linearised import LinearisationPoint, Linearised
from ancfdae.sections import Rectangle
from validation.peers.loops import frame

STEEL = Material(7850, 2.1e11, 0.3)


def cantilevers(copies, elements=20):
    """Return equal cantilevers side by side that nothing joins."""
    beams = [
        Beam(f"b{k}", (0, k), (2, k), elements, Rectangle(0.05, 0.05), STEEL) for k in range(copies)
    ]
    return Scene(beams, [Clamp(beam.at_start) for beam in beams])


def linearised(scene):
    system = assemble(scene)
    at = LinearisationPoint(system.start()[0], np.zeros(system.n_lam))
    return Linearised.of(system, at, None)


def dense(small, count):
    """Return the lowest z in a basis of the null space of Phi_q."""
    system = small.system
    N = scipy.linalg.null_space(system.constraint_pattern.dense(small.Phi_q))
    K, M = (N.T @ system.pattern.dense(x) @ N for x in (small.K, small.M))
    return scipy.linalg.eigvalsh((K + K.T) / 2, (M + M.T) / 2, subset_by_index=[0, count - 1])


@pytest.mark.parametrize("cells", [3, 4])
def test_values_are_those_of_dense_matrices_and_shapes_solve_the_pencil(cells):
    small = linearised(frame(cells))
    z, X, change = lanczos.lowest(small, 6, 6)
    # Dense values round to units of the largest, 1e13 times the lowest.
    np.testing.assert_allclose(z, dense(small, 6), rtol=1e-3)
    assert np.all(change <= 1e-6 * z)
    np.testing.assert_allclose(X.T @ small.times(small.M, X), np.eye(6), atol=1e-10)
    pattern = small.system.constraint_pattern
    assert np.max(np.abs(pattern.dot(small.Phi_q, X))) <= 1e-14 * np.max(np.abs(X))
    # The residual of inverse iteration: shapes to twelve digits in the norm of M.
    factors = small.saddle.factor(small.K + z[-1] * small.M, small.Phi_q)
    again = small.solve(factors, small.times(small.M, X)) * (z + z[-1])
    assert np.all(np.sqrt(small.squares(again - X)) <= 1e-9)


def test_one_mode_that_lacks_is_counted():
    """Sylvester's law sees the mode that a space of few motions does not hold."""
    small = linearised(frame(4))
    z, X, _ = lanczos.lowest(small, 5, 5)
    beyond = dense(small, 6)[-1]
    assert lanczos.all_below(small, z[-1], beyond, X)
    # Without any one of them there are more eigenvalues than shapes.
    for k in range(4):
        assert not lanczos.all_below(small, z[-1], beyond, np.delete(X, k, axis=1))
    assert not lanczos.all_below(small, z[-2], beyond, X[:, :-1]) or z[-1] > z[-2] + 0.25 * (
        beyond - z[-2]
    )


@pytest.mark.parametrize("copies", [1, 2, 3, 5])
def test_modes_that_coincide_are_all_found(copies):
    """Each cantilever has a copy of each mode, found by Lanczos's method or by a search."""
    scene, one = cantilevers(copies, 60), linearised(cantilevers(1, 60))
    wanted = np.sqrt(np.repeat(dense(one, 3), copies))
    for count in (1, copies, copies + 1, 2 * copies):
        found = modes(scene, count)
        shown = len(found.natural_frequencies)
        # A group that coincides is completed.
        assert shown >= count
        assert shown % copies == 0
        np.testing.assert_allclose(found.natural_frequencies, wanted[:shown], rtol=1e-4)


def test_a_space_that_lacks_a_copy_is_refused():
    """Six copies of a mode, two are asked for: the space has converged before it holds them."""
    small = linearised(cantilevers(8, 15))
    assert lanczos.lowest(small, 4, 2) is None
    z = undamped.lowest_of_all(small, 4, 2)[0]
    assert np.sum(z < 1.001 * z[0]) == 8
    assert len(modes(cantilevers(8, 15), 2).natural_frequencies) == 8


def test_rigid_motions_come_first_and_hide_no_other():
    """Rod on a soft spring: the end of a free rod moves as about a quarter of its mass would."""
    rod = Beam("rod", (0, 0), (2, 0), 40, Rectangle(0.05, 0.05), STEEL)
    spring = SpringDamper(rod.at_start, 1.0, free_length=1.0, ground=(0, -1))
    free, tied = (modes(Scene([rod], loads=loads), 6) for loads in ((), (spring,)))
    assert np.all(free.natural_frequencies[:3] == 0)
    assert np.all(tied.natural_frequencies[:2] == 0)
    mass, slender = STEEL.density * 0.05**2 * 2, (0.05 / 2) ** 2
    at_end = mass / (1.0 + 3.0 / (1.0 + slender))
    assert tied.natural_frequencies[2] == pytest.approx(np.sqrt(1.0 / at_end), rel=1e-5)
    np.testing.assert_allclose(
        tied.natural_frequencies[3:], free.natural_frequencies[3:], rtol=1e-6
    )
    # Bending of a free rod: (4.730)^2 sqrt(EI / m L^4), less what shear takes.
    radius = 0.05 / np.sqrt(12.0)
    bending = 4.7300407449**2 * np.sqrt(STEEL.youngs_modulus / STEEL.density) * radius / 4.0
    assert 0.98 * bending < free.natural_frequencies[3] < bending


@pytest.mark.parametrize("asked", [2, 5])
def test_shapes_asked_for_have_all_digits_however_many_are_sought(asked):
    small = linearised(frame(4))
    few = lanczos.lowest(small, asked + 2, asked)[1][:, :asked]
    many = lanczos.lowest(small, 12, 12)[1][:, :asked]
    off = np.sqrt(small.squares(few - many * np.sign(np.sum(few * many, axis=0))))
    assert np.all(off <= 1e-9)


def test_dense_matrices_take_over_where_clusters_hide_the_count(monkeypatch):
    """Sixty equal cantilevers have modes in groups of sixty, of which 80 modes end the second.

    Their 900 motions are less than twelve times as many: nothing else is tried before.
    """

    def tried(*given):
        raise AssertionError("a count of all modes was tried")

    monkeypatch.setattr(undamped, "lowest_of_all", tried)
    found, one = modes(cantilevers(60, 2), 80), modes(cantilevers(1, 2), 2)
    groups = np.repeat(one.frequencies, 60)[:80]
    np.testing.assert_allclose(found.frequencies, groups, rtol=1e-7)
