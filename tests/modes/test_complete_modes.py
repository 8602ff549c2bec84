"""Vibrations are all returned, lowest first, beside bodies with many motions that creep."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
import scipy

from ancfdae import (
    Beam,
    Clamp,
    DirectDifferentiation,
    Material,
    Scene,
    SpringDamper,
    assemble,
    modes,
)
from ancfdae.modes import damped, dense, sparse, undamped
from ancfdae.modes import damped as completeness
from ancfdae.modes.damped import proportional_exponents
from ancfdae.modes.eigenpairs import Eigenpairs
from ancfdae.modes.linearised import Linearised
from ancfdae.modes.precise import NoModes
from ancfdae.results import LinearisationPoint
from ancfdae.sections import Rectangle

# Height, density, modulus.
STEEL, RUBBER, WOOD = (0.01, 7850.0, 2.1e11), (0.02, 1100.0, 1e7), (0.015, 600.0, 1e10)


def cantilevers(elements, kinds, times, loads=()):
    """Cantilevers of length 1 above each other, not joined but by loads between their tips."""
    beams = [
        Beam(f"b{k}", (0, k), (1, k), elements, Rectangle(h, h), Material(rho, E, 0.3, tau))
        for k, ((h, rho, E), tau) in enumerate(zip(kinds, times, strict=True))
    ]
    return Scene(beams, [Clamp(x.at_start) for x in beams], loads=[load(beams) for load in loads])


def cubic(elements, kinds, times):
    """K, D and M of the same cantilevers from cubic elements of Euler's beam."""
    l = 1 / elements
    bending = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / l**3
    inertia = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
    slopes = np.diag([1, l, 1, l])
    k, m = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    for i in range(0, 2 * elements, 2):
        k[i : i + 4, i : i + 4] += slopes @ bending @ slopes
        m[i : i + 4, i : i + 4] += slopes @ inertia @ slopes * l / 420
    stiffness = [E * h**4 / 12 * k[2:, 2:] for h, _, E in kinds]
    damping = [tau * K for tau, K in zip(times, stiffness, strict=True)]
    mass = [rho * h**2 * m[2:, 2:] for h, rho, _ in kinds]
    return [scipy.linalg.block_diag(*x) for x in (stiffness, damping, mass)]


def vibrations(K, D, M):
    """The exponents with Im s > 0 of s^2 M + s D + K, by size: 1/s are those of a full matrix."""
    n, w = len(K), np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[0])
    inverse = -np.linalg.solve(K, np.hstack([w * D, w * w * M]))
    s = w / np.linalg.eigvals(np.vstack([inverse, np.eye(n, 2 * n)]))
    s = s[s.imag > 1e-6 * np.abs(s)]
    return s[np.argsort(np.abs(s))]


# Shear and rotary inertia of the fifth vibration of the rubber beam, and the mesh; a vibration that
# is skipped leaves one that is 20 % off and more in its place.
THEORY = 2e-2


@pytest.mark.parametrize(
    ("elements", "tau"),
    [
        *((n, tau) for n in (8, 16) for tau in (0.01, 0.1, 0.5, 5.0, 100.0)),
        (32, 0.1),
        (32, 5.0),
        (48, 0.5),
        (48, 100.0),
    ],
)
def test_no_vibration_of_steel_is_skipped_beside_rubber_that_creeps(elements, tau):
    """At 8 elements and 5 s the first one was 106,328 rad/s, and 16 elements skipped the fifth."""
    case = elements, (STEEL, RUBBER), (0.0, tau)
    expected = vibrations(*cubic(*case))
    for count in (1, 4, 6) if elements < 48 else (5,):
        found = modes(cantilevers(*case), count).exponents
        np.testing.assert_allclose(found, expected[:count], rtol=THEORY)


@pytest.mark.parametrize("tau", [1.0, 10.0])
def test_the_vibrations_of_a_coarse_cantilever_are_those_of_theory(tau):
    """(1.8751, 4.6941, 7.8548)^2 sqrt(E I/(rho A)); 4 elements are 0.8 % too stiff for the third.

    All rubber creeps but its first vibration at 1 s, 1.935 rad/s.
    """
    found = modes(cantilevers(4, (STEEL, RUBBER), (0.0, tau)), 4).frequencies
    unit = np.sqrt(2.1e11 * 0.01**2 / 12 / 7850)
    own = found[1:4] if tau == 1.0 else found[:3]
    np.testing.assert_allclose(own, unit * np.array([1.8751, 4.6941, 7.8548]) ** 2, rtol=1e-2)


@pytest.mark.parametrize("elements", [4, 10, 24])
def test_three_bodies_with_three_retardation_times(elements):
    """Every material has the exponents of its own undamped frequencies."""
    times = 0.0, 0.01, 10.0
    expected = []
    for kind, tau in zip((STEEL, WOOD, RUBBER), times, strict=True):
        omega = modes(cantilevers(elements, (kind,), (0.0,)), 1000).frequencies
        left = omega**2 - (tau * omega**2 / 2) ** 2
        expected += list((-tau * omega**2 / 2 + 1j * np.sqrt(np.maximum(left, 0)))[left > 0])
    expected = np.array(sorted(expected, key=abs))
    for count in (1, 3, 12, 20) if elements < 24 else (3, 20):
        found = modes(cantilevers(elements, (STEEL, WOOD, RUBBER), times), count).exponents
        np.testing.assert_allclose(found, expected[:count], rtol=1e-6)


@pytest.mark.parametrize("elements", [6, 16])
def test_a_strong_dashpot_holds_the_tip_of_one_of_two_beams(elements):
    """c beside which the beam is soft: tan b = tanh b; the other beam vibrates as before."""
    unit = np.sqrt(2.1e11 * 0.01**2 / 12 / 7850)
    held = np.array([3.9266, 7.0686]) ** 2 * unit
    free = np.array([1.8751, 4.6941]) ** 2 * unit
    scene = cantilevers(
        elements,
        (STEEL, STEEL),
        (0.0, 0.0),
        [lambda beams: SpringDamper(beams[1].at_end, 0.0, 1e7, ground=(1.0, 3.0))],
    )
    found = modes(scene, 4)
    np.testing.assert_allclose(found.frequencies, np.sort([*held, *free]), rtol=4e-3)
    np.testing.assert_allclose(found.damping_ratios, 0.0, atol=1e-3)


def test_tips_joined_by_a_soft_spring():
    """1 N/m on both tips adds to w(1)^2 of each shape, which is 4/m; before, 229,382 rad/s."""
    join = [
        lambda beams: SpringDamper(beams[0].at_end, 1.0, free_length=1.0, other=beams[1].at_end)
    ]
    case = 10, (STEEL, RUBBER), (0.0, 10.0)
    K, D, M = cubic(*case)
    tips = np.zeros(len(K))
    tips[[len(K) // 2 - 2, len(K) - 2]] = 1.0, -1.0
    expected = vibrations(K + np.outer(tips, tips), D, M)
    found = modes(cantilevers(*case, join), 5).exponents
    np.testing.assert_allclose(found, expected[:5], rtol=THEORY)


def test_derivatives_are_those_of_the_same_vibrations():
    """d omega/dE = omega/(2 E) of the steel beam, and none in the modulus of rubber."""
    scene = cantilevers(8, (STEEL, RUBBER), (0.0, 5.0))
    found = modes(
        scene, 4, design=["b0.youngs_modulus", "b1.youngs_modulus"], method=DirectDifferentiation()
    )
    omega_b = found.frequencies_b
    np.testing.assert_allclose(omega_b[:, 0] / found.frequencies, 0.5 / 2.1e11, rtol=1e-6)
    np.testing.assert_allclose(omega_b[:, 1] * 1e7 / found.frequencies, 0.0, atol=1e-9)


def linearised(scene):
    system = assemble(scene)
    at = LinearisationPoint(system.start()[0], np.zeros(system.n_lam))
    return Linearised.of(system, at, None)


@pytest.mark.parametrize("tau", [0.01, 5.0])
@pytest.mark.parametrize("elements", [4, 24])
def test_the_count_sees_one_root_more_and_one_less(elements, tau):
    """Of all roots, and of pairs alone, beside which real ones are counted by inertia."""
    small = linearised(cantilevers(elements, (STEEL, RUBBER), (0.0, tau)))
    s, _ = dense.damped(small, np.zeros((small.system.n_q, 0)), 1.0)
    pairs = s[s.imag > 0]
    pairs = pairs[np.argsort(np.abs(pairs))]
    assert len(s) + len(pairs) == 2 * small.n_free
    for known in (s, pairs):
        for last in np.abs(pairs[[0, 3]]):
            assert completeness.all_found(small, known, 0, last)
            assert not completeness.all_found(small, known[known != pairs[0]], 0, last)
            assert not completeness.all_found(small, np.append(known, 0.5j * last), 0, last)
            assert not completeness.all_found(small, known, 1, last)


@pytest.mark.parametrize("large", [False, True])
def test_a_vibration_that_arnoldi_misses_is_found_or_the_modes_are_refused(monkeypatch, large):
    scene = cantilevers(6, (STEEL, RUBBER), (0.0, 1e-3))
    expected = modes(scene, 5).exponents
    search = sparse.damped

    def without_third(*args):
        s, X = search(*args)
        kept = np.abs(s - expected[2]) > 1e-3 * np.abs(s)
        assert not np.all(kept)
        return s[kept], X[:, kept]

    monkeypatch.setattr(sparse, "damped", without_third)
    monkeypatch.setattr(undamped, "_DENSE_DAMPED", 0)
    monkeypatch.setattr(undamped, "_ROOM", 0)
    if large:
        monkeypatch.setattr(damped, "_DENSE_CROWDED", 0)
        with pytest.raises(NoModes, match="lower vibrations than those found may be missing"):
            modes(scene, 5)
    else:
        np.testing.assert_allclose(modes(scene, 5).exponents, expected, rtol=1e-8)


@pytest.mark.parametrize("crowded", [0, 800])
def test_large_systems_in_which_nothing_vibrates_creep(monkeypatch, crowded):
    """Every motion of two rubbers has tau omega > 2; the slowest are near -1 over 50 s."""
    monkeypatch.setattr(damped, "_DENSE_CROWDED", crowded)
    scene = cantilevers(24, (RUBBER, RUBBER), (20.0, 50.0))
    try:
        found = modes(scene, 3).exponents
    except NoModes:
        assert not crowded
    else:
        np.testing.assert_allclose(found, -0.02, rtol=1e-2)


def test_one_vibration_found_twice_is_not_two():
    small = linearised(cantilevers(4, (STEEL, STEEL), (0.0, 0.0)))
    z = np.array([52.5j, 52.5j])
    X = dense.undamped(small, 2, False)[1].astype(complex)
    assert damped._are_distinct(small, Eigenpairs(z, X, 1e-9 * np.ones(2)))
    X[:, 1] = X[:, 0]
    assert not damped._are_distinct(small, Eigenpairs(z, X, 1e-9 * np.ones(2)))


def test_real_exponents_of_strong_damping_have_all_their_digits():
    """s^2 + tau z s + z = 0 in 60 digits: creeping, vibrating and growing motions (z < 0)."""
    z = np.array([1e-6, 1.0, 3.9e4, 4.1e4, 1e9, -1e-4, -2e7])
    tau = 0.01
    s, _, number = proportional_exponents(tau, z, np.zeros(len(z)))
    assert len(s) == 11  # four vibrations or the like, and pairs
    with localcontext() as context:
        context.prec = 60
        for k, own in enumerate(z.tolist()):
            half, square = Decimal(tau) * Decimal(own) / 2, Decimal(own)
            left, mine = half * half - square, s[number == k]
            if left < 0:
                expected = [complex(-float(half), float((-left).sqrt()))]
            else:
                root = left.sqrt()
                expected = sorted(float(x) for x in (-half - root, -half + root))
                mine = np.sort(mine.real)
            np.testing.assert_allclose(mine, expected, rtol=4e-16, err_msg=str(own))


def test_real_roots_are_counted_below_zero_down_to_the_radius():
    """Beside the cluster at -1/tau = -1000/s every root of the dense matrices is counted."""
    small = linearised(cantilevers(4, (RUBBER, STEEL), (1e-3, 1e-3)))
    s, _ = dense.damped(small, np.zeros((small.system.n_q, 0)), 1.0)
    real = np.sort(s[s.imag == 0].real)
    stiff = real[real < -2e3]
    assert len(stiff) > 20
    for far in (2.0 * abs(real[0]), 1.1 * abs(stiff[10])):
        counted = np.sort(completeness._real_roots(small, far))
        assert np.all((counted < 0) & (counted > -far))
        # Between two places of a logarithmic scale, six for each factor of ten.
        within = stiff[stiff > -far]
        np.testing.assert_allclose(counted[counted < -2e3], within, rtol=10 ** (1 / 6) - 1)
