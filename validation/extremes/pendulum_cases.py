"""Cases of a pendulum: moduli, shapes, steps, numbers of elements, places, sizes."""

import numpy as np

from ancfdae import HHT, simulate
from ancfdae.results import Solution
from validation.extremes.rows import Case
from validation.extremes.scenes import Rod

_STEP = 2.0**-7


def _against(label: str, rod: Rod, step: float, steps: int, other: Rod) -> Case:
    """Case of a rod whose error is the difference to another at the same steps."""

    def error(run: Solution) -> float:
        exact = simulate(other.scene(), step * steps, HHT(step))
        return float(np.max(np.abs(other.arm(run) - other.arm(exact))))

    return Case(label, rod.scene, step, steps, error=error)


def _against_natural(label: str, rod: Rod, step: float, steps: int, alpha: float = -0.3) -> Case:
    """Case of a rod whose error is the difference to the run in natural units."""

    def error(run: Solution) -> float:
        units = rod.natural()
        h = step * units.time
        other = simulate(rod.scene(units), h * steps, HHT(h, hht_alpha=alpha))
        if not other.outcome.success:
            return np.inf
        return float(np.max(np.abs(rod.arm(run) - rod.arm(other, units))))

    return Case(label, rod.scene, step, steps, alpha, error)


def _against_half_step(label: str, rod: Rod, step: float, steps: int) -> Case:
    def error(run: Solution) -> float:
        fine = simulate(rod.scene(), step * steps, HHT(step / 2))
        if not fine.outcome.success:
            return np.inf
        return float(np.max(np.abs(rod.arm(run) - rod.arm(fine)[::2])))

    return Case(label, rod.scene, step, steps, error=error)


def moduli(quick: bool) -> list[Case]:
    """Take Young's moduli from soft to stiff."""
    exponents = (3, 7, 13) if quick else (*range(3, 14), 16)
    steps = 16 if quick else 128
    return [
        _against_natural(f"E = 1e{k} Pa", Rod(modulus=10.0**k), _STEP, steps) for k in exponents
    ]


def slenderness(quick: bool) -> list[Case]:
    """Take sections from thick to thin."""
    steps = 16 if quick else 128
    cases = []
    for ratio in (0.2, 1e-4) if quick else (0.2, 0.1, 0.03, 1e-2, 1e-3, 1e-4):
        for E in (1e7, 2e11):
            rod = Rod(modulus=E, slenderness=ratio)
            label = f"h/L = {ratio:g}, E = {E:.0e} Pa"
            cases.append(_against_natural(label, rod, _STEP, steps))
    if not quick:
        thin = Rod(modulus=2e11, slenderness=1e-4)
        label = "the last with the step 2^-11 s"
        cases.append(_against_natural(label, thin, 2.0**-11, 1024))
    return cases


def step_sizes(quick: bool) -> list[Case]:
    """Take steps from long to short."""
    exponents = (1, 4, 8) if quick else range(1, 9)
    return [
        _against_half_step(f"step 1e-{k} s", Rod(), 10.0**-k, 10 if quick else 100)
        for k in exponents
    ]


def alphas(quick: bool) -> list[Case]:
    """Take both ends of hht_alpha, and what is refused."""
    steps = 16 if quick else 128
    rod = Rod()
    cases = [
        _against_natural(f"hht_alpha = {name}", rod, _STEP, steps, alpha)
        for name, alpha in (("-1/3", -1 / 3), ("-1e-6", -1e-6), ("0", 0.0))
    ]
    refused = [Case(f"hht_alpha = {a}", rod.scene, _STEP, steps, a) for a in (-0.34, 1e-3)]
    return cases + refused


def elements(quick: bool) -> list[Case]:
    """Take one element to many."""
    counts, reference = (1, 100) if quick else (1, 10, 100, 1000, 10000), Rod(elements=20)
    return [
        _against(f"{n} element{'s' if n > 1 else ''}", Rod(elements=n), _STEP, 10, reference)
        for n in counts
    ]


def far(quick: bool) -> list[Case]:
    """Stand far from the origin."""
    steps, distances = 16 if quick else 64, (1e6,) if quick else (1.0, 1e3, 1e6, 1e9, 1e12)
    return [
        _against(f"{at:g} m from the origin", Rod(at=at), _STEP, steps, Rod()) for at in distances
    ]


def lengths(quick: bool) -> list[Case]:
    """Take rods from tiny to huge."""
    steps, cases = 16 if quick else 64, []
    for length in (1e-6, 1e4):
        for step in (_STEP * np.sqrt(length), _STEP):
            label = f"L = {length:g} m, step {step:.1e} s"
            cases.append(_against_natural(label, Rod(length=length, spin=0.0), step, steps))
    return cases
