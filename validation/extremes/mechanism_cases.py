"""Cases of mechanisms: ratios of bodies, dead centres, joints that hold too much or nothing."""

from collections.abc import Callable

import numpy as np

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    Distance,
    Material,
    Pin,
    PointOnLine,
    Revolute,
    Scene,
    simulate,
)
from ancfdae.results import Solution
from ancfdae.sections import Rectangle
from validation.extremes.rows import Case
from validation.extremes.scenes import Crank

_STEP = 2.0**-7
_SECTION, _SOFT = Rectangle(0.05, 0.05), Material(2770.0, 1e8, 0.3)


def ratios(quick: bool) -> list[Case]:
    """Take bodies of very different mass or stiffness."""
    exponents = (-6, 6) if quick else (-6, -4, -2, 0, 2, 4, 6)
    steps = 16 if quick else 128
    return [
        _crank(f"{what} 1e{k}", Crank(angle=0.5, **{f"{key}_ratio": 10.0**k}), steps)  # type: ignore[arg-type]  # numbers
        for what, key in (("mass", "mass"), ("stiffness", "stiffness"))
        for k in exponents
    ]


def dead_centres(quick: bool) -> list[Case]:
    """Start where joints lose a direction."""
    steps, spun = 16 if quick else 256, Crank(spin=10.0)
    return [
        _crank("stretched out, at rest", Crank(), steps),
        _crank("stretched out, crank turning at 10 rad/s, step 2^-9 s", spun, steps, 2.0**-9),
        _crank("the same turned by 1 rad, step 2^-8 s", spun.with_turn(1.0), steps),
        _crank("folded, at rest", Crank(angle=np.pi), steps),
        _crank(
            "crank as long as rod, folded: slider in the bearing", Crank(rod=0.9, angle=3.1), steps
        ),
        Case("rod on a line and a link, in one line: no second direction", _dead_link, _STEP, 16),
        Case("distance joint of length zero", _no_length, _STEP, 16),
        Case("distance joint shorter than the gap", _short_link, _STEP, 16),
    ]


def redundant(quick: bool) -> list[Case]:
    """Return cases with redundant joints, which hold motions that other joints hold already."""
    bar = _bar()
    start, end = bar.at_start, bar.at_end
    scenes: dict[str, Callable[[], Scene]] = {
        "pin twice at one point": lambda: Scene(
            [bar], [Pin(start, name="first"), Pin(start, name="second")]
        ),
        "clamp and pin at one point": lambda: Scene(
            [bar], [Clamp(start, name="clamp"), Pin(start, name="pin")]
        ),
        "clamped at both ends": lambda: Scene([bar], [Clamp(start), Clamp(end)], (0, -9.81)),
        "spatial four-bar of four revolutes": _four_bar,
        "the same, one revolute a spherical joint": lambda: _four_bar(spherical=True),
    }
    return [Case(label, scene, _STEP, 16) for label, scene in scenes.items()]


def _crank(label: str, crank: Crank, steps: int, step: float = 2.0**-8) -> Case:
    """Case of a crank-slider whose error is the difference to the mechanism turned by 1 rad."""

    def error(run: Solution) -> float:
        turned = crank.with_turn(crank.turned + 1.0)
        other = simulate(turned.scene(), step * steps, HHT(step))
        if not other.outcome.success:
            return np.inf
        return float(np.max(np.abs(crank.reach(run) - turned.reach(other))) / crank.rod)

    return Case(label, crank.scene, step, steps, error=error)


def _bar(
    name: str = "bar", end: tuple[float, ...] = (1.0, 0.0), **where: tuple[float, ...]
) -> Beam:
    start = where.get("start", (0.0,) * len(end))
    return Beam(name, start, end, 2, _SECTION, _SOFT)


def _dead_link() -> Scene:
    """Return a bar on a line and a link, in one line."""
    bar = _bar()
    joints = [
        Pin(bar.at_start),
        PointOnLine(bar.at_end, (0, 1), name="line"),
        Distance(bar.at_end, 0.5, ground=(1.5, 0.0), name="link"),
    ]
    return Scene([bar], joints, (0, -9.81))


def _no_length() -> Scene:
    """Return a bar on a distance joint of length 1e-9 m."""
    bar = _bar()
    return Scene([bar], [Distance(bar.at_end, 1e-9, ground=(1.0, 0.0))], project_start=True)


def _short_link() -> Scene:
    """Return a distance joint shorter than the gap."""
    bar = _bar()
    joints = [Pin(bar.at_start), Distance(bar.at_end, 0.4, ground=(1.5, 0.0), name="link")]
    return Scene([bar], joints, (0, -9.81))


def _four_bar(spherical: bool = False) -> Scene:
    corners = [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0)]
    a, b, c = (_bar(n, corners[i + 1], start=corners[i]) for i, n in enumerate("abc"))
    axis = (0, 0, 1)
    joints = [
        Revolute(a.at_start, axis, name="A"),
        Revolute(a.at_end, axis, b.at_start, name="B"),
        Revolute(b.at_end, axis, c.at_start, name="C"),
        Pin(c.at_end, name="D") if spherical else Revolute(c.at_end, axis, name="D"),
    ]
    return Scene([a, b, c], joints, (0, -9.81, 0))
