"""Part of the report on the elements: very thin beams, of which matrices hold few digits."""

import numpy as np
import numpy.typing as npt
import scipy

from ancfdae import (
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    Material,
    PointForce,
    Scene,
    Weld,
    equilibrium,
    equilibrium_gradient,
    modes,
)
from ancfdae.observables import position
from ancfdae.sections import Circle, Rectangle
from validation.report import Report
from validation.scenes import cantilever

_E, _RHO = 1e9, 1000.0


def fill(report: Report, quick: bool) -> None:
    """Add the tables and their claims."""
    report.say("thin-beams")
    slendernesses = (1e-4, 1e-5) if quick else (1e-4, 1e-5, 1e-6)
    columns = ["frequencies", "pairs", "length: direct", "adjoint", "complex step"]
    rows, worst = [], np.zeros(5)
    for slenderness in slendernesses:
        # Statics ends at h/L = 1e-5: beyond it a cantilever counts as a mechanism, in words.
        gradients = _length_gradients(slenderness) if slenderness > 5e-6 else []
        errors = [_frequencies(slenderness), _pairs(slenderness), *gradients]
        worst[: len(errors)] = np.maximum(worst[: len(errors)], errors)
        rows.append([f"{slenderness:.0e}", *(f"{x:.1e}" for x in errors), *3 * ["refused"]][:6])
        for name, error in zip(columns, errors, strict=False):
            report.figure(
                f"thin.{name.replace(': ', '_').replace(' ', '_')}.{slenderness:.0e}", float(error)
            )
    report.table(["h/L", *columns], rows)
    halves = max(_welded_halves(n) for n in ((50,) if quick else (50, 500)))
    report.figure("thin.halves", halves)
    # Rotary inertia and shear, 13 (h/L)^2 of the third frequency, are 1e-7 at h/L = 1e-4.
    for name, error, limit in (
        ("Frequencies of thin beams", worst[0], 1e-6),
        ("Coinciding frequencies of thin round bars", worst[1], 1e-8),
        ("Gradients in the length of thin beams", float(np.max(worst[2:])), 1e-6),
        ("Deflection of welded halves of short elements", halves, 1e-9),
    ):
        report.judge("thin-beams", error <= limit, name=name, limit=limit, error=error)


def cantilever_frequencies(elements: int) -> npt.NDArray[np.float64]:
    """Frequencies of a cantilever of cubic elements, in units of sqrt(E I / (rho A L^4))."""
    return euler_frequencies(elements, held=2)


def euler_frequencies(elements: int, held: int = 0) -> npt.NDArray[np.float64]:
    """Frequencies of cubic elements of Euler's beam, in units of sqrt(E I / (rho A L^4)).

    The first `held` coordinates, deflection and slope of the first node, are zero; of a free beam
    the first two frequencies are rigid motions, with round-off.
    """
    l = 1 / elements
    k = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / l**3
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
    size = 2 * elements + 2
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for element in range(elements):
        rows = slice(2 * element, 2 * element + 4)
        K[rows, rows] += k
        M[rows, rows] += m * l / 420
    squares: npt.NDArray[np.float64] = scipy.linalg.eigh(
        K[held:, held:], M[held:, held:], eigvals_only=True
    )
    return np.sqrt(np.maximum(squares, 0.0))


def thin_cantilever(
    slenderness: float,
    elements: int = 8,
    d: int = 2,
    nu: float = 0.3,
    *,
    free: bool = False,
    round_bar: bool = False,
    damping_time: float = 0.0,
) -> Scene:
    """Return a beam of 1 m whose height is `slenderness`, clamped at its start or free."""
    section = Circle(slenderness / 2) if round_bar else Rectangle(slenderness, slenderness)
    end = (1.0,) + (0.0,) * (d - 1)
    material = Material(_RHO, _E, nu, damping_time=damping_time)
    rod = Beam("rod", (0.0,) * d, end, elements, section, material)
    return Scene([rod], [] if free else [Clamp(rod.at_start)])


def _frequencies(slenderness: float) -> float:
    """Return the largest error of three frequencies."""
    computed = modes(thin_cantilever(slenderness), 3).frequencies
    exact = cantilever_frequencies(8)[:3] * np.sqrt(_E * slenderness**2 / 12 / _RHO)
    return float(np.max(np.abs(computed / exact - 1)))


def _pairs(slenderness: float) -> float:
    """Return how far two pairs are apart."""
    frequencies = modes(thin_cantilever(slenderness, d=3, round_bar=True), 4).frequencies
    return float(np.max(np.abs(frequencies[1::2] / frequencies[::2] - 1)))


def _length_gradients(slenderness: float) -> list[float]:
    """Return errors of d ln v/d ln L under a force that bends by a millionth, by each method."""
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 4, Rectangle(slenderness, slenderness), _material())
    force = 1e-6 * 3 * _E * slenderness**4 / 12
    scene = cantilever(rod, (0.0, force))
    errors = []
    tip, length = position(rod.at_end, 1), ["rod.length"]
    for method in (DirectDifferentiation(), Adjoint(), ComplexStep()):
        result = equilibrium_gradient(scene, tip, design=length, method=method)
        errors.append(abs(float(result.gradient[0] / result.value) - 3) / 3)
    return errors


def _welded_halves(elements: int, h: float = 0.05) -> float:
    """Return the error of the deflection of two halves under a small force."""
    section, force = Rectangle(h, h), 1e-3
    first = Beam("first", (0.0, 0.0), (0.5, 0.0), elements, section, _material())
    second = Beam("second", (0.5, 0.0), (1.0, 0.0), elements, section, _material())
    joints = [Clamp(first.at_start), Weld(first.at_end, second.at_start)]
    scene = Scene([first, second], joints, loads=[PointForce(second.at_end, (0.0, force))])
    bent = equilibrium(scene)
    if not bent.outcome.success:
        return np.inf
    shear = 10 * (1 + 0.3) / (12 + 11 * 0.3)
    G = _E / (2 * (1 + 0.3))
    exact = force / (3 * _E * h**4 / 12) + force / (shear * G * h * h)
    return abs(float(bent.solution.position(second.at_end)[0][1]) / exact - 1)


def _material() -> Material:
    return Material(_RHO, _E, 0.3)
