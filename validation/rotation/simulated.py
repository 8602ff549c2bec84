"""A blade that is driven in a frame at rest: its free vibration beside the modes of the frame."""

import numpy as np
import scipy

from ancfdae import (
    Beam,
    Clamp,
    Material,
    NodalState,
    Pin,
    Radau,
    RotatingFrame,
    RotationDriver,
    Scene,
    equilibrium,
    modes,
    simulate,
)
from ancfdae.laws import ConstantAcceleration
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import Equilibrium, Modes, Solution
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.tables import relative
from validation.report import Report
from validation.rotation.blade import unit

# Part of the shape, norm one in the mass, that starts the vibration; its square is its error.
_AMPLITUDE = 1e-6
_SPEED, _PERIODS = 6.0, 3.0


def simulated(report: Report, quick: bool) -> None:
    """Fill the section."""
    report.say("simulated")
    elements, steps = (2, 48) if quick else (4, 64)
    rate = _SPEED * unit()
    blade = Beam(
        "blade", (0, 0), (1, 0), elements, Rectangle(0.004, 0.004), Material(1000.0, 1e9, 0.0)
    )
    at = equilibrium(Scene([blade], [Clamp(blade.at_start)], frame=RotatingFrame(rate)))
    turning = Scene([blade], [Clamp(blade.at_start)], frame=RotatingFrame(rate))
    lag = modes(turning, 1, at=at)
    frequency = float(lag.frequencies[0])
    run = _simulated(blade, rate, at, lag, steps)
    x = _across(run, blade, rate)
    found = _frequency(run.t, x, frequency)
    apart = report.figure("simulated.apart", float(relative(found, frequency)))
    report.figure("simulated.frequency", found / unit())
    report.say(
        "simulated.frequency",
        speed=_SPEED,
        found=found / unit(),
        frequency=frequency / unit(),
        apart=apart,
    )
    wave = np.cos(frequency * run.t) * x[0]
    some = slice(None, None, 16)
    points = dots("simulation", run.t[some], x[some])
    series = [Series("modes", run.t, wave), points]
    panel = Panel("tip across the blade", "t [s]", "deflection [m]", series)
    report.plot("simulated", [panel])
    report.judge("simulated", apart < 1e-4, apart=apart)
    report.require("simulated", apart)


def _simulated(blade: Beam, rate: float, at: Equilibrium, lag: Modes, steps: int) -> Solution:
    """Start from the equilibrium that turns and a part of the mode; drive the root."""
    shape, s = lag.shapes[:, 0], lag.exponents[0]
    J = np.array([[0.0, -1.0], [1.0, 0.0]])
    vectors = (at.q + _AMPLITUDE * shape.real).reshape(-1, 2)
    rates = (_AMPLITUDE * (s * shape).real).reshape(-1, 2) + rate * vectors @ J.T
    nodes = (len(vectors) // blade.element.n_s, blade.element.n_s, 2)
    start = NodalState("blade", vectors.reshape(nodes), rates.reshape(nodes))
    joints = [Pin(blade.at_start), RotationDriver(blade.at_start, ConstantAcceleration(rate))]
    period = 2 * np.pi / s.imag
    scene = Scene([blade], joints, start=[start])
    return simulate(scene, _PERIODS * period, Radau(period / steps))


def _across(run: Solution, blade: Beam, rate: float) -> Array:
    """Return the deflection of the tip across the blade in the turning frame."""
    tip, angle = run.position(blade.at_end), rate * run.t
    return tip[:, 1] * np.cos(angle) - tip[:, 0] * np.sin(angle)


def _frequency(t: Array, x: Array, guess: float) -> float:
    """Return the frequency of the harmonic that fits best."""

    def left(w: float) -> float:
        basis = np.column_stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)])
        return float(np.sum((x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0]) ** 2))

    size = 1 / left(1.2 * guess)
    options = {"bounds": (0.9 * guess, 1.1 * guess), "options": {"xatol": 1e-9 * guess}}
    return float(scipy.optimize.minimize_scalar(lambda w: size * left(w), **options).x)
