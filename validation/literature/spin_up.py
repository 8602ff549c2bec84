"""Case: a flexible beam is spun up to a constant speed (Simo & Vu-Quoc 1986; Kane et al. 1987)."""

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    DirectDifferentiation,
    Material,
    Pin,
    RotationDriver,
    Scene,
    Terminal,
    assemble,
    gradient,
    simulate,
)
from ancfdae.extend import Law, MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.moving_rod import HubRod
from validation.literature.tables import convergence, derivative_table, logarithmic, relative
from validation.published import published
from validation.report import Report

_L, _EA, _GA, _EI, _MASS, _TURNING = 10.0, 2.8e7, 1.0e7, 1.4e4, 1.2, 6e-4
_SPEED, _DURATION = 6.0, 15.0
_MIDDLE, _END = 7.5, 20.0
_PUBLISHED: Final = float(published("spin-up")["extension"])
_NAMES: Final = ("deflection at 7.5 s [m]", "mean extension from 15 s on [m]")


@final
@dataclass(frozen=True)
class SpinUp(Law):
    """psi'' = (W/T) (1 - cos(2 pi t/T)) up to the time T, then the speed W."""

    speed: float
    duration: float

    design_fields = (("speed", lambda *_: None), ("duration", lambda *_: None))

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Angle and its first three time derivatives."""
        W, T = p
        a, w = W / T, 2 * np.pi / T
        c, s = np.cos(w * t), np.sin(w * t)
        before = (a * (t * t / 2 + (c - 1) / w**2), a * (t - s / w), a * (1 - c), a * w * s)
        after = (W * (t - T / 2), W, 0 * W, 0 * W)
        return np.where(np.real(t) < np.real(T), before[order], after[order])


def spin_up(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (2, 4) if quick else (2, 4, 8, 16)
    step = 0.01 if quick else 0.005
    times = np.linspace(0, _END, 401)
    report.say("spin-up")
    exactness = (2, 1e-3) if quick else (8, 1e-7)
    rod = HubRod(_L, _EA, _GA, _EI, _MASS, _TURNING, *exactness)
    exact = rod.tip(_turning, times)
    tips = {n: _tip(n, step, times) for n in counts}
    middle = int(np.searchsorted(times, _MIDDLE))
    late = times >= _DURATION
    wanted = [exact[1, middle], exact[0, late].mean()]
    computed = [[tip[1, middle], tip[0, late].mean()] for tip in tips.values()]
    errors = convergence(report, "spin-up", _NAMES, counts, computed, wanted)
    half = _tip(counts[-2], step / 2, times[: middle + 1])[1, -1]
    left = float(relative(half, wanted[0]))
    report.say("spin-up.step", n=counts[-2], left=left)
    apart = _derivatives(report, counts[-2], step, rod, exact[1, middle])
    _plot(report, times, tips, exact)
    _verdict(report, float(np.max(errors[-1])), computed[-1][1], apart)


def _turning(t: float) -> tuple[float, float, float]:
    law = SpinUp(_SPEED, _DURATION)
    return float(law.at(t)), float(law.at(t, 1)), float(law.at(t, 2))


def _scene(n: int) -> Scene:
    """Return the scene; the square section has the published EA, EI, rho A and rho I."""
    h = np.sqrt(12 * _EI / _EA)
    material = Material(_MASS / h**2, _EA / h**2, 0.0)
    beam = Beam("beam", (0, 0), (_L, 0), n, Rectangle(h, h), material)
    return Scene(
        [beam], [Pin(beam.at_start), RotationDriver(beam.at_start, SpinUp(_SPEED, _DURATION))]
    )


def _integrator(step: float) -> HHT:
    return HHT(step=step, hht_alpha=-0.05, newton_tolerance=1e-10)


def _tip(n: int, step: float, times: Array) -> Array:
    """Return the displacement of the tip in the frame of the hub, shape (2, k)."""
    run = simulate(_scene(n), float(times[-1]), _integrator(step)).at(times)
    psi = np.array([_turning(t)[0] for t in times])
    c, s, r = np.cos(psi), np.sin(psi), run.position(MaterialPoint("beam", 1.0))
    return np.array([c * r[:, 0] + s * r[:, 1] - _L, -s * r[:, 0] + c * r[:, 1]])


def _derivatives(report: Report, n: int, step: float, rod: HubRod, deflection: float) -> float:
    """Compare d ln(deflection)/d ln(E, rho) with differences of the reference."""
    psi, end = _turning(_MIDDLE)[0], MaterialPoint("beam", 1.0)
    tip = -np.sin(psi) * position(end, 0) + np.cos(psi) * position(end, 1)
    design = ["beam.youngs_modulus", "beam.density"]
    direct, adjoint = (
        gradient(_scene(n), Terminal(tip), _MIDDLE, _integrator(step), design=design, method=m)
        for m in (DirectDifferentiation(), Adjoint())
    )
    values = assemble(_scene(n), design).b
    computed = direct.gradient * values / direct.value
    exact = [_reference_derivative(rod, part) / deflection for part in ("stiffness", "mass")]
    rows = logarithmic("deflection at 7.5 s", ("E", "rho"), computed, np.array(exact))
    apart = derivative_table(report, "spin-up", rows, (f"direct, {n} elements", "reference"))
    round_off = float(np.max(relative(adjoint.gradient, direct.gradient)))
    report.say("adjoint", off=round_off)
    return apart


def _reference_derivative(rod: HubRod, part: str) -> float:
    """Return d(deflection)/d ln(E) or d ln(rho) of the reference by central differences."""
    d = 1e-3

    def value(factor: float) -> float:
        e, m = (factor, 1.0) if part == "stiffness" else (1.0, factor)
        changed = HubRod(
            _L,
            e * rod.stretch,
            e * rod.shear,
            e * rod.bend,
            m * rod.mass,
            m * rod.turning_mass,
            rod.degree,
            rod.tolerance,
        )
        return float(changed.tip(_turning, np.array([0.0, _MIDDLE]))[1, -1])

    return (value(1 + d) - value(1 - d)) / (2 * d)


def _plot(report: Report, times: Array, tips: dict[int, Array], exact: Array) -> None:
    few = slice(None, None, 10)
    panels = []
    for row, title in enumerate(("Extension", "Deflection")):
        series = [Series(f"{n} elements", times, tip[row]) for n, tip in tips.items()]
        series.append(dots("reference", times[few], exact[row, few]))
        if not row:
            late = np.array([16.0, 18.0, 20.0])
            steady = np.full(3, _PUBLISHED)
            series.append(dots("Simo & Vu-Quoc 1986", late, steady))
        panels.append(Panel(f"{title} of the tip", "t [s]", f"{title.lower()} [m]", series))
    report.plot("spin-up", panels, 2)


def _verdict(report: Report, error: float, extension: float, apart: float) -> None:
    off = float(relative(extension, _PUBLISHED))
    report.judge("spin-up", off < 2e-3, published=_PUBLISHED, extension=extension)
    report.require("spin-up", error)
    report.require("spin-up.derivatives", apart)
