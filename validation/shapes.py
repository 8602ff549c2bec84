"""Shapes and loads that need more elements than bending does: helices, shafts, buckled columns."""

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy

from ancfdae import (
    Beam,
    Clamp,
    CurvedBeam,
    Cylindrical,
    Material,
    Moment,
    PointForce,
    Scene,
    assemble,
    equilibrium,
)
from ancfdae.numerics.arrays import Array
from ancfdae.sections import Circle, Rectangle
from ancfdae.sensitivity.observables.observable import States
from ancfdae.sensitivity.observables.quantities import strain_energy
from validation.report import Report
from validation.scenes import cantilever

_E, _NU, _R = 1e9, 0.3, 0.001
_G = _E / (2 * (1 + _NU))
_EI, _GJ = _E * np.pi / 4 * _R**4, _G * np.pi / 2 * _R**4
_WIRE, _RUBBER = Circle(_R), Material(1000.0, _E, _NU)
# Helix: radius, rise a turn, turns.
_COIL, _RISE, _TURNS = 0.05, 0.02, 3


def fill(report: Report, quick: bool) -> None:
    """Add the section."""
    counts = (4, 8) if quick else (4, 8, 16, 32, 64)
    cases: dict[str, Callable[[int], float]] = {
        "helix, elements a turn: deflection under a force along its axis": helix,
        "shaft at 0.5 of its critical torque: deflection under a force": partial(shaft, 0.5),
        "shaft at 0.9 of its critical torque": partial(shaft, 0.9),
        "column at 0.9 of its critical load: deflection": partial(column, 0.9),
        "column at 1.02 times its critical load": partial(column, 1.02),
        "column at 1.5 times its critical load": partial(column, 1.5),
    }
    report.say("shapes")
    rows = []
    for title, error in cases.items():
        errors = [error(n) for n in counts]
        rows.append([title, *("none found" if np.isnan(x) else f"{x:.1e}" for x in errors)])
        short = title.split(" critical")[0].split(",")[0].replace(" ", "-")
        for n, value in zip(counts, errors, strict=True):
            if not np.isnan(value):
                report.figure(f"shape.{short}.n{n}", value)
    report.table(["relative error, by elements", *map(str, counts)], rows)
    report.say("shapes.stretched")
    strains = (-0.02, -0.01, 0.01, 0.02)
    changes = [f"{(arc_stiffness(32, strain) - 1) / strain:.3f}" for strain in strains]
    report.table(["axial strain", *map(str, strains)], [["change over the strain", *changes]])


def helix(a_turn: int) -> float:
    """Error of the deflection of a wire helix, clamped, under a small force at its free end.

    Against Castigliano's theorem with bending, torsion, shear and stretch of the wire.
    """
    n = a_turn * _TURNS
    angle = np.linspace(0, 2 * np.pi * _TURNS, n + 1)
    positions, frames = _coil(angle)
    wire = CurvedBeam("wire", positions, frames, _WIRE, _RUBBER)
    F = 1e-6 * _GJ / _COIL**2
    bent = equilibrium(cantilever(wire, (0.0, 0.0, F)))
    moved = bent.solution.position(wire.at_end)[0, 2] - positions[-1, 2]
    fine, weights = np.polynomial.legendre.leggauss(400)
    at = np.pi * _TURNS * (fine + 1)
    r, axes = _coil(at)
    m = np.einsum("nij,nj->ni", axes, np.cross(positions[-1] - r, [0.0, 0.0, 1.0]))
    f = axes[:, :, 2]
    kappa = 6 * (1 + _NU) / (7 + 6 * _NU)
    A = np.pi * _R**2
    per_m = np.array([1 / _GJ, 1 / _EI, 1 / _EI])
    per_f = np.array([1 / (_E * A), 1 / (kappa * _G * A), 1 / (kappa * _G * A)])
    speed = np.hypot(_COIL, _RISE / (2 * np.pi))
    ds = np.pi * _TURNS * weights * speed
    exact = F * ds @ (m**2 @ per_m + f**2 @ per_f)
    return float(abs(moved / exact - 1))


def _coil(angle: Array) -> tuple[Array, Array]:
    c, s, zero = np.cos(angle), np.sin(angle), 0 * angle
    rise = _RISE / (2 * np.pi)
    positions = np.stack([_COIL * c, _COIL * s, rise * angle], 1)
    tangent = np.stack([-_COIL * s, _COIL * c, rise + zero], 1) / np.hypot(_COIL, rise)
    inward = np.stack([-c, -s, zero], 1)
    return positions, np.stack([tangent, inward, np.cross(tangent, inward)], 1)


def shaft(share: float, n: int) -> float:
    """Error of the deflection of a clamped shaft under torque and a small force in its middle.

    The far end turns about the axis and slides. E I u'''' - i T u''' = 0 on either side of the
    force, u = y + i z (Greenhill); the critical torque is 8.987 E I/L.
    """
    T, F = share * 8.986819 * _EI, 1e-4 * _EI
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), n, _WIRE, _RUBBER)
    joints = [Clamp(rod.at_start), Cylindrical(rod.at_end, axis=(1, 0, 0))]
    loads = [Moment(rod.at_end, (T, 0, 0)), PointForce(rod.at(0.5), (0, F, 0))]
    bent = equilibrium(Scene([rod], joints, loads=loads))
    if not bent.outcome.success:
        return float("nan")
    moved = np.linalg.norm(bent.solution.position(rod.at(0.5))[0, 1:])
    k = 1j * T / _EI

    def row(x: float, order: int) -> list[complex]:
        powers = np.array([[1.0, x, x**2], [0.0, 1.0, 2 * x], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
        return [*powers[order].tolist(), complex(k**order * np.exp(k * x))]

    none = [0.0] * 4
    ends = [row(0, 0) + none, row(0, 1) + none, none + row(1, 0), none + row(1, 1)]
    middle = [row(0.5, order) + [-x for x in row(0.5, order)] for order in range(4)]
    # The third derivatives jump by F/E I.
    right = np.array([0, 0, 0, 0, 0, 0, 0, -F / _EI])
    u = np.linalg.solve(np.array(ends + middle), right)[:4] @ np.array(row(0.5, 0))
    return float(abs(moved / abs(u) - 1))


def column(share: float, n: int) -> float:
    """Error of the deflection of a clamped column that a force of 1e-3 of its load bends.

    Against the elastica of Euler, by shooting for the angle at the tip. Thin, so that nothing else
    counts: h/L = 0.001.
    """
    h = 1e-3
    EI = _E * h**4 / 12
    P = share * np.pi**2 / 4 * EI
    rod = Beam("rod", (0, 0), (1, 0), n, Rectangle(h, h), Material(1000.0, _E, 0.0))
    bent = equilibrium(cantilever(rod, (-P, 1e-3 * P)))
    if not bent.outcome.success:
        return float("nan")
    moved = bent.solution.position(rod.at_end)[0, 1]

    def bend(s: float, x: Array) -> list[float]:
        # E I theta'' = -m', m' = P sin + 1e-3 P cos.
        rate = -(P / EI) * (np.sin(x[0]) + 1e-3 * np.cos(x[0]))
        return [x[1], rate, np.sin(x[0])]

    def shot(curvature: float) -> Array:
        run = scipy.integrate.solve_ivp(bend, (0, 1), [0, curvature, 0], rtol=1e-11, atol=1e-14)
        return np.asarray(run.y[:, -1])

    rough = (bent.solution.position(rod.at(1e-3))[0, 1]) * 2e6
    curvature = scipy.optimize.newton(lambda k: shot(k)[1], rough, tol=1e-12)
    return float(abs(moved / shot(curvature)[2] - 1))


def arc_stiffness(n: int, strain: float) -> float:
    """Bending stiffness over E I of a quarter circle that is stretched along its axis.

    Its energy at prescribed states, stretched by 1 + strain and bent to (1 + d) times its turn:
    the second derivative in d over E I kappa_o^2 L, 1 in the rod of Reissner and Simo. At nu = 0.
    """
    h, turn = 0.05, np.pi / 2
    places, frames = _circle(n, turn, 1.0)
    bow = CurvedBeam("bow", places, frames, Rectangle(h, h), Material(1000.0, _E, 0.0))
    system = assemble(Scene([bow]))

    def energy(d: float, stretch: float) -> float:
        x, axes = _circle(n, turn * (1 + d), stretch)
        axes[:, 0] *= stretch
        q = np.concatenate([x[:, None], axes], axis=1).reshape(1, -1)
        states = States(np.zeros(1), q, 0 * q, np.zeros((1, 0)))
        return float(strain_energy().value(system, states)[0])

    def stiffness(stretch: float) -> float:
        # Energies of 1e-3 of E I: a step of 1e-2 leaves its square.
        d = 1e-2
        return (energy(d, stretch) - 2 * energy(0, stretch) + energy(-d, stretch)) / d**2

    return stiffness(1 + strain) / stiffness(1.0)


def _circle(n: int, turn: float, length: float) -> tuple[Array, Array]:
    angle = np.linspace(0, turn, n + 1)
    c, s = np.cos(angle), np.sin(angle)
    frames = np.stack([np.stack([c, s], 1), np.stack([-s, c], 1)], 1)
    return length / turn * np.stack([s, 1 - c], 1), frames
