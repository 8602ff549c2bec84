"""Rods of nearly incompressible material in motion: their volume does not set the step."""

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
    HHT,
    Adjoint,
    Beam,
    DirectDifferentiation,
    EnhancedContinuum,
    Material,
    NodalState,
    Pin,
    Scene,
    Terminal,
    assemble,
    gradient,
    simulate,
)
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle

L, H, E, RHO, G, ANGLE, N = 1.0, 2e-3, 1e7, 1000.0, 9.81, 0.02, 8


def hanging(nu, d, shift=0.0):
    """A rod hung from a pin, stretched by its weight and turned; its sections are unstrained."""
    down, zero = (0.0,) * (d - 1) + (-1.0,), (shift,) * d
    end = tuple(np.add(zero, down).tolist())
    rod = Beam("rod", zero, end, N, Rectangle(H, H), Material(RHO, E, nu))
    s = np.linspace(0.0, 1.0, N + 1)
    nodes = np.zeros((N + 1, d + 1, d))
    nodes[:, 1:] = rod.reference().slopes
    nodes[:, 0] = np.outer(s + RHO * G * L / E * (s - s**2 / 2), down)
    nodes[:, 1] *= 1 + RHO * G * L / E * (1 - s)[:, None]
    c, x = np.cos(ANGLE), np.sin(ANGLE)
    across, along = nodes[..., 0].copy(), nodes[..., -1].copy()
    nodes[..., 0], nodes[..., -1] = c * across - x * along, x * across + c * along
    nodes[:, 0] += zero
    start = [NodalState("rod", nodes)]
    return Scene([rod], [Pin(rod.at_start)], gravity=np.multiply(G, down), start=start), rod


def linear_theory(t):
    """Deflection of the tip of a hanging rod, w(s, 0) = ANGLE s, by Ritz's method.

    T = rho g A (L - s) and E I resist w' and w''. 20 polynomials that vanish at the pin; with 12
    of them the motion differs by 2.3e-3 of the amplitude, in its highest waves.
    """
    x, w = np.polynomial.legendre.leggauss(40)
    x, w = (x + 1) / 2, w / 2
    basis = [np.polynomial.Legendre.basis(k, [0, 1]) for k in range(21)]
    forms = [b - b(0.0) for b in basis[1:]]  # the pin holds s = 0
    values, first, second = (np.array([f.deriv(k)(x) for f in forms]) for k in (0, 1, 2))
    A, EI = H * H, E * H**4 / 12
    M = RHO * A * (values * w) @ values.T
    K = RHO * G * A * (first * w * (1 - x)) @ first.T + EI * (second * w) @ second.T
    root = np.linalg.inv(np.linalg.cholesky(M))
    squares, modes = np.linalg.eigh(root @ K @ root.T)
    modes = root.T @ modes
    amplitudes = modes.T @ (RHO * A * (values * w) @ (ANGLE * x))
    tip = np.array([f(1.0) for f in forms]) @ modes
    return np.cos(np.outer(t, np.sqrt(squares))) @ (tip * amplitudes)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49, 0.499, 0.49999])
def test_a_swinging_rubber_rod_moves_as_linear_theory_says(nu, d):
    scene, rod = hanging(nu, d)
    run = simulate(scene, 1.0, HHT(step=1e-3))
    assert run.outcome.success
    tip = run.position(rod.at_end)[:, 0]
    # Found 2.4e-3 for every nu and d: the high waves that 8 elements and steps of 1e-3 s do not
    # follow, and 4e-4, the square of the angle.
    assert np.max(np.abs(tip - linear_theory(run.t))) < 3e-3 * ANGLE * L
    # No section is turned inside out, none strained by more than what the start does.
    volumes = np.linalg.det(run.nodes("rod")[:, :, 1:])
    assert np.max(np.abs(volumes - 1)) < 2 * RHO * G * L / E
    # Nor is Newton's method in need of another matrix in more than one step of ten.
    assert run.statistics.factorisations < 1100
    assert run.statistics.continued == 0


def test_it_does_so_a_thousand_lengths_away():
    (near, _), (far, _) = (hanging(0.499, 3, shift=x) for x in (0.0, 1000.0))
    runs = [simulate(scene, 0.1, HHT(step=1e-3)) for scene in (near, far)]
    tips = [run.nodes("rod")[:, -1, 0] - run.nodes("rod")[:, 0, 0] for run in runs]
    # Round-off of positions, 1e-13, against accelerations of the fast start.
    assert np.max(np.abs(tips[0] - tips[1])) < 1e-8


def test_its_gradient_is_that_of_the_call():
    scene, rod = hanging(0.499, 3)
    design = ["rod.poisson_ratio", "rod.youngs_modulus"]
    b = np.array([0.499, E])
    tip = Terminal(position(rod.at_end, 0))

    def value(b):
        moved = scene.with_values(dict(zip(design, b.tolist(), strict=True)))
        return gradient(moved, tip, 0.1, HHT(step=1e-3), design=design).value

    found = [
        gradient(scene, tip, 0.1, HHT(step=1e-3), design=design, method=m).gradient
        for m in (DirectDifferentiation(), Adjoint())
    ]
    # Waves of the thickness have (omega h)^2 = 1.1e6, whose round-off a hundred steps may add up to
    # 2.4e-8; found 1.2e-8.
    assert np.max(np.abs((found[0] - found[1]) * b)) < 1e-7 * np.max(np.abs(found[0] * b))
    for k, h in enumerate((1e-6, 1e-5)):
        up, down = b.copy(), b.copy()
        up[k], down[k] = b[k] * (1 + h), b[k] * (1 - h)
        slope = (value(up) - value(down)) / (2 * h)
        # Differences of values of 0.02 with an error of 1e-13 leave 1e-8 of the largest slope.
        assert abs(slope - found[0][k] * b[k]) < 1e-5 * np.max(np.abs(found[0] * b))


def test_bounded_stiffness_leaves_modulus_contraction_and_shear():
    law = EnhancedContinuum()
    for nu in (0.49, 0.4901, 0.495, 0.499, 0.5 - 1e-9):
        C = np.sum(law.stiffness(3, np.array([E]), np.array([nu])), axis=0)[0]
        S = np.linalg.inv(C[:3, :3])
        assert S[0, 0] * E == pytest.approx(1, rel=1e-12)
        assert S[0, 1:] * E == pytest.approx([-nu, -nu], rel=1e-12)
        # 1.11 times E/(2 (1 + nu)(1 - 2 nu)) at 0.49, 16.8 E.
        assert C[1, 1] + C[1, 2] < 2 * 18.7 * E
        assert C[1, 1] - C[1, 2] == pytest.approx(E / (1 + nu), rel=1e-12)


def unstrained(nu, elements=N, damping_time=0.0, contracted=False):
    """A rod hung from a pin, stretched along a tilted line by 2e-4; its sections are not."""
    made = Rectangle(H, H), Material(RHO, E, nu, damping_time=damping_time)
    rod = Beam("rod", (0, 0), (0, -L), elements, *made)
    s, along = np.linspace(0.0, 1.0, elements + 1), np.array([ANGLE, -1.0])
    stretch, angle = np.linalg.norm(along), np.arctan(ANGLE)
    nodes = np.empty((elements + 1, 3, 2))
    nodes[:, 0] = s[:, None] * along
    nodes[:, 1] = along if contracted else along / stretch
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    nodes[:, 2] = rod.reference().slopes[0, 1] @ turn
    nodes[:, 2] *= 1 - nu * (stretch - 1) if contracted else 1
    start = [NodalState("rod", nodes)]
    return Scene([rod], [Pin(rod.at_start)], gravity=(0, -G), start=start)


@pytest.mark.parametrize("nu", [0.3, 0.499])
def test_a_motion_that_mirrors_sections_is_no_success(nu):
    """Steps of 28 times 1/omega of the ringing thickness lead to sections that are mirrored.

    Positions lie on a line, slopes have the length one across it: sections lack the contraction of
    their axis, and ring. Newton's method ends at mirrored sections, which have the same energy.
    """
    scene = unstrained(nu)
    done = simulate(scene, 0.3, HHT(step=1e-3))
    assert not done.outcome.success
    assert done.outcome.verdict is Verdict.FOLDED
    assert "sections of 'rod' inside out" in done.outcome.advice
    # What is kept is not mirrored.
    assert np.all(np.linalg.det(done.nodes("rod")[:, :, 1:]) > 0)
    # Shorter steps follow the ringing.
    assert simulate(scene, 0.003, HHT(step=1e-5)).outcome.success


@pytest.mark.parametrize("nu", [0.49, 0.499, 0.49999])
def test_every_remedy_that_the_words_name_ends_the_run(nu):
    """Shorter steps, damping and contraction at the start, each alone, at steps that else stop."""
    known = simulate(hanging(nu, 2)[0], 0.3, HHT(step=1e-3)).nodes("rod")[-1, -1, 0, 0]
    for scene, step in (
        (unstrained(nu), 5e-4),
        (unstrained(nu, damping_time=1e-4), 1e-3),
        (unstrained(nu, contracted=True), 1e-3),
    ):
        run = simulate(scene, 0.3, HHT(step=step))
        assert run.outcome.success
        assert np.all(np.abs(np.linalg.det(run.nodes("rod")[:, :, 1:]) - 1) < 0.02)
        # The starts differ by their stretch, and waves along the rod move the tip by as much.
        assert abs(run.nodes("rod")[-1, -1, 0, 0] - known) < 0.1 * ANGLE


def mirrored_in(system, body, k, d):
    """Five states of a system; from the fourth on the last slope at vector k is reversed."""
    q = np.tile(system.start()[0], (5, 1))
    # A turn is no mirror.
    q[1] = (q[1].reshape(-1, d) @ np.diag([-1.0, -1.0, 1.0][:d])).ravel()
    first = d * (body.first_vector + k + d)
    q[3:, first : first + d] *= -1
    return q


@pytest.mark.parametrize("d", [2, 3])
def test_states_in_which_a_body_is_mirrored_are_found(d):
    start, middle, end = ((x, *(0.0,) * (d - 1)) for x in (0.0, 1.0, 2.0))
    made = Rectangle(H, H), Material(RHO, E, 0.3)
    cable = Beam("cable", start, middle, 2, *made, element=CABLE_2D if d == 2 else CABLE_3D)
    rod, bar = Beam("rod", start, middle, 2, *made), Beam("bar", middle, end, 2, *made, rigid=True)
    system = assemble(Scene([cable, rod, bar], [Pin(rod.at_end, bar.at_start)]))
    _, of_rod, of_bar = system.naming.layout.bodies
    assert system.mirrored(np.tile(system.start()[0], (3, 1))) is None
    for body, k in ((of_rod, 0), (of_rod, 2 * (d + 1)), (of_bar, 0)):
        first, words = system.mirrored(mirrored_in(system, body, k, d))
        assert first == 3
        assert words.startswith(f"turns sections of {body.name!r} inside out")
    # What has diverged is not judged.
    assert system.mirrored(np.full((2, system.n_q), np.nan)) is None
