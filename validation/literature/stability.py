"""Case: critical loads of a column and of Lee's frame, and the path of the buckled column."""

from typing import Final

import numpy as np
from scipy.special import ellipe, ellipk

from ancfdae import (
    Beam,
    DesignVariable,
    Material,
    Pin,
    PointForce,
    Scene,
    Weld,
    critical_load,
    equilibrium,
)
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import CriticalLoad
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.tables import convergence, derivative_table, relative
from validation.published import published
from validation.report import Report
from validation.scenes import cantilever

_E, _H, _L = 2.1e11, 0.004, 1.0
_EULER: Final = np.pi**2 * _E * _H**4 / 12 / 4 / _L**2
# Lee's frame: E = 7.2e6, A = 6, I = 2, lengths 120, the force at a fifth of the beam.
_LEE_E, _LEE_H, _LEE_W, _LEE_L = 7.2e6, 2.0, 3.0, 120.0
_LEE: Final = float(published("lee")["limit_load"])
_ANGLES: Final = (20.0, 40.0, 60.0, 80.0, 100.0)


def stability(report: Report, quick: bool) -> None:
    """Fill the section."""
    report.say("stability")
    counts = (4, 8) if quick else (4, 8, 16, 32)
    columns = [critical_load(_column(n), "load.force_x", -1.5 * _EULER) for n in counts]
    values = [[-found.value] for found in columns]
    euler = convergence(report, "euler", ("P [N]",), counts, values, [_EULER])[-1, 0]
    design = ["rod.youngs_modulus", "rod.height", "rod.length"]
    found = critical_load(_column(counts[-1]), "load.force_x", -1.5 * _EULER, design=design)
    logs = found.gradient * [_E, _H, _L] / found.value
    # Height and width differ: only the height bends.
    rows = list(zip(["ln P"] * 3, ["ln E", "ln h", "ln L"], logs, [1.0, 3.0, -2.0], strict=True))
    names = ("critical_load", "closed form")
    slopes = derivative_table(report, "euler", rows, names)
    angles = _ANGLES[:2] if quick else _ANGLES
    path = _buckled(columns[-1], _column(counts[-1]), angles)
    exact = np.array([_elastica(angle) for angle in angles])
    apart = float(np.max(relative(path, exact[:, 1:])))
    report.figure("euler.elastica.apart", apart)
    report.say("stability.path", angle=angles[-1], apart=apart)
    sides = [
        dots("elements", path[:, 1], exact[:, 0]),
        Series("elastica", exact[:, 2], exact[:, 0]),
    ]
    axes = "deflection of the end over the length [-]", "P / Euler's load [-]"
    report.plot("stability", [Panel("Path of the buckled column", *axes, sides)])
    lee, identity = _lee(report, quick)
    report.judge("stability", relative(lee, _LEE) < 5e-3, lee=lee)
    report.require("euler", float(euler))
    report.require("euler.derivatives", slopes)
    report.require("euler.path", apart)
    report.require("lee", float(relative(lee, _LEE)))
    report.require("lee.scaling", identity)


def _column(n: int) -> Scene:
    rod = Beam("rod", (0, 0), (_L, 0), n, Rectangle(_H, _H), Material(7850.0, _E, 0.0))
    return cantilever(rod, (0.0, 0.0))


def _elastica(angle: float) -> tuple[float, float, float]:
    """Return P over Euler's load and x/L, w/L of the end that has turned by an angle."""
    m = np.sin(np.radians(angle) / 2) ** 2
    K = ellipk(m)
    return (2 * K / np.pi) ** 2, 2 * ellipe(m) / K - 1, 2 * np.sqrt(m) / K


def _buckled(critical: CriticalLoad, scene: Scene, angles: tuple[float, ...]) -> Array:
    """Return the places of the end along the buckled path, its deflection positive."""
    places, (_, at) = [], critical.branch(0.2)
    for angle in angles:
        load = -_elastica(angle)[0] * _EULER
        at = equilibrium(scene.with_values({"load.force_x": load}), start=at)
        assert at.outcome.success, at.outcome
        places.append(np.abs(at.solution.position(scene.beams[0].at_end)[0]))
    return np.array(places)


def _lee(report: Report, quick: bool) -> tuple[float, float]:
    """Return the limit load, and how far its derivatives are from P = E L^2 f(h/L, w/L)."""
    counts = (5, 10) if quick else (5, 10, 20, 40)
    loads = [-critical_load(_frame(n), "load.force_y", -3e4).value for n in counts]
    report.say("stability.lee")
    convergence(report, "lee", ("P",), counts, [[load] for load in loads], [_LEE])
    names = ("youngs_modulus", "height", "width")
    design = [DesignVariable(name, [f"post.{name}", f"top.{name}"]) for name in names]
    # The support moves with the beam's end.
    rise = {"post.length": 1.0, "pin(top@1).ground_y": 1.0}
    span = {"top.length": 1.0, "pin(top@1).ground_x": 1.0}
    design += [DesignVariable("rise", rise), DesignVariable("span", span)]
    found = critical_load(_frame(counts[-1]), "load.force_y", -3e4, design=design)
    logs = found.gradient * [_LEE_E, _LEE_H, _LEE_W, _LEE_L, _LEE_L] / found.value
    words = ", ".join(f"{x:.6f} (ln {y})" for x, y in zip(logs, found.names, strict=True))
    report.say("stability.scaling", words=words)
    return loads[-1], float(max(abs(logs[0] - 1), abs(np.sum(logs[1:]) - 2)))


def _frame(n: int) -> Scene:
    section, material = Rectangle(_LEE_H, _LEE_W), Material(1.0, _LEE_E, 0.0)
    post = Beam("post", (0, 0), (0, _LEE_L), n, section, material)
    top = Beam("top", (0, _LEE_L), (_LEE_L, _LEE_L), n, section, material)
    joints = [Pin(post.at_start), Pin(top.at_end), Weld(post.at_end, top.at_start)]
    return Scene([post, top], joints, loads=[PointForce(top.at(0.2), (0.0, 0.0), name="load")])
