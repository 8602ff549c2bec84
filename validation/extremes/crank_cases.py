"""Cases of a crank-slider: ratios of its bodies, dead centres."""

from __future__ import annotations

import numpy as np

from ancfdae import HHT, simulate
from ancfdae.results import Solution
from validation.extremes.joint_cases import dead_link, no_length, short_link
from validation.extremes.rows import Case
from validation.extremes.scenes import Crank

_STEP = 2.0**-7


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
        Case("rod on a line and a link, in one line: no second direction", dead_link, _STEP, 16),
        Case("distance joint of length zero", no_length, _STEP, 16),
        Case("distance joint shorter than the gap", short_link, _STEP, 16),
    ]


def _crank(label: str, crank: Crank, steps: int, step: float = 2.0**-8) -> Case:
    """Case of a crank-slider whose error is the difference to the mechanism turned by 1 rad."""

    def error(run: Solution) -> float:
        turned = crank.with_turn(crank.turned + 1.0)
        other = simulate(turned.scene(), step * steps, HHT(step))
        if not other.outcome.success:
            return np.inf
        return float(np.max(np.abs(crank.reach(run) - turned.reach(other))) / crank.rod)

    return Case(label, crank.scene, step, steps, error=error)
