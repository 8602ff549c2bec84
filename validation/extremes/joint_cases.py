"""Cases of joints that hold too much or nothing, and the scenes of them."""

from __future__ import annotations

from ancfdae import Beam, Clamp, Distance, Material, Pin, PointOnLine, Revolute, Scene
from ancfdae.sections import Rectangle
from validation.extremes.rows import Case

_STEP = 2.0**-7
_SECTION, _SOFT = Rectangle(0.05, 0.05), Material(2770.0, 1e8, 0.3)


def redundant(quick: bool) -> list[Case]:
    """Return cases with redundant joints, which hold motions that other joints hold already."""
    return [
        Case("pin twice at one point", _two_pins, _STEP, 16),
        Case("clamp and pin at one point", _clamped_pin, _STEP, 16),
        Case("clamped at both ends", _two_clamps, _STEP, 16),
        Case("spatial four-bar of four revolutes", _four_bar, _STEP, 16),
        Case("the same, one revolute a spherical joint", _free_four_bar, _STEP, 16),
    ]


def _bar(
    name: str = "bar", end: tuple[float, ...] = (1.0, 0.0), **where: tuple[float, ...]
) -> Beam:
    start = where.get("start", (0.0,) * len(end))
    return Beam(name, start, end, 2, _SECTION, _SOFT)


def dead_link() -> Scene:
    """Return a bar on a line and a link, in one line."""
    bar = _bar()
    joints = [
        Pin(bar.at_start),
        PointOnLine(bar.at_end, (0, 1), name="line"),
        Distance(bar.at_end, 0.5, ground=(1.5, 0.0), name="link"),
    ]
    return Scene([bar], joints, (0, -9.81))


def no_length() -> Scene:
    """Return a bar on a distance joint of length 1e-9 m."""
    bar = _bar()
    return Scene([bar], [Distance(bar.at_end, 1e-9, ground=(1.0, 0.0))], project_start=True)


def short_link() -> Scene:
    """Return a distance joint shorter than the gap."""
    bar = _bar()
    joints = [Pin(bar.at_start), Distance(bar.at_end, 0.4, ground=(1.5, 0.0), name="link")]
    return Scene([bar], joints, (0, -9.81))


def _two_pins() -> Scene:
    bar = _bar()
    return Scene([bar], [Pin(bar.at_start, name="first"), Pin(bar.at_start, name="second")])


def _clamped_pin() -> Scene:
    bar = _bar()
    return Scene([bar], [Clamp(bar.at_start, name="clamp"), Pin(bar.at_start, name="pin")])


def _two_clamps() -> Scene:
    bar = _bar()
    return Scene([bar], [Clamp(bar.at_start), Clamp(bar.at_end)], (0, -9.81))


def _four_bar(last: type[Pin] | None = None) -> Scene:
    corners = [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0)]
    a, b, c = (_bar(n, corners[i + 1], start=corners[i]) for i, n in enumerate("abc"))
    axis = (0, 0, 1)
    joints = [
        Revolute(a.at_start, axis, name="A"),
        Revolute(a.at_end, axis, b.at_start, name="B"),
        Revolute(b.at_end, axis, c.at_start, name="C"),
        Pin(c.at_end, name="D") if last else Revolute(c.at_end, axis, name="D"),
    ]
    return Scene([a, b, c], joints, (0, -9.81, 0))


def _free_four_bar() -> Scene:
    return _four_bar(Pin)
