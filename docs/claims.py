"""Costs and errors that pages quote, taken from the results of the reports when the site is built.

A page writes a name in double braces; `CLAIMS` says which figure stands there and with how many
digits. tests/test_claims.py finds costs that are typed into a page instead.
"""

import json
from pathlib import Path

_REPORTS = Path(__file__).parent / "reports"
#: Variables of the crank-slider in report `crank-slider`.
_VARIABLES = 6


def _figures(report: str) -> dict[str, float]:
    """Return the figures of a report by name."""
    text = (_REPORTS / report / "results.json").read_text(encoding="utf-8")
    found: dict[str, float] = json.loads(text)["figures"]
    return found


def _shown(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits that it can be read aloud, never as 1e+03."""
    text = f"{value:.{digits}g}"
    return f"{float(text):,.0f}" if "e+" in text else text


def _range(values: list[float]) -> str:
    """Return one number, or the least and the largest."""
    low, high = _shown(min(values), 1), _shown(max(values), 1)
    return low if low == high else f"{low} to {high}"


def _cheapest(figures: dict[str, float], scene: str, error: float, kinds: tuple[str, ...]) -> str:
    """Return seconds and name of the cheapest setting, for both kinds of objective.

    Both gradients, of an integral (`gradient`) and of a value at the end (`pointwise`), must be
    right to `error`. "not reached" if no setting is so for either.
    """
    best: dict[str, tuple[float, str]] = {}
    for name, seconds in figures.items():
        case, _, rest = name.partition(".")
        if case != scene or not rest.startswith(kinds) or not rest.endswith(".seconds"):
            continue
        for kind in ("gradient", "pointwise"):
            if figures.get(name.removesuffix("seconds") + kind, float("inf")) <= error:
                found = (seconds, rest.split(".")[0].split("_")[0])
                best[kind] = min(best.get(kind, found), found)
    if not best:
        return "not reached"
    methods = sorted({method for _, method in best.values()})
    words = _range([seconds for seconds, _ in best.values()])
    if methods == ["HHT"]:
        return words
    return f"{words} ({' and '.join(methods)})"


def _methods() -> dict[str, str]:
    """Return what derivatives cost: pages on methods of differentiation."""
    speed, crank = _figures("performance"), _figures("crank-slider")
    step = "a_step_and_its_derivatives."
    directly = speed[f"{step}six_variables_directly_against_the_motion"]
    adjoint = speed[f"{step}adjoint_against_the_motion"]
    motion = speed[f"{step}step_of_the_crank_slider_newton_1e_08"]
    further = speed[f"{step}each_further_variable"] / motion
    many = "a_thousand_variables.adjoint_against_dynamics_1000_variables_512_steps"
    return {
        "direct_first": _shown(directly - 1 - 5 * further),
        "direct_six": _shown(directly, 3),
        "direct_further": _shown(100 * further),
        "adjoint": _shown(adjoint - 1),
        "adjoint_total": _shown(adjoint, 3),
        "adjoint_thousand": _shown(speed[many], 3),
        "continuous_adjoint": _shown(crank["cost.continuous_adjoint.ratio"] - 1),
        "complex_step": _shown((crank["cost.complex_step.ratio"] - 1) / _VARIABLES),
        "finite_difference": _shown((crank["cost.finite_difference.ratio"] - 1) / _VARIABLES),
    }


def _integrators() -> dict[str, str]:
    """Return what accuracy costs: pages on integrators and steps."""
    figures = _figures("work-precision")
    low, high = ("HHT",), ("DOP853", "IDA", "IDAS", "Radau")
    scenes = ("soft", "soft-damped", "stiff", "stiff-damped", "slider-crank")
    claims = {
        f"{scene.replace('-', '_')}_{error:.0e}_{order}".replace("1e-0", "1e"): _cheapest(
            figures, scene, error, kinds
        )
        for scene in scenes
        for error in (1e-2, 1e-4, 1e-6)
        for order, kinds in (("hht", low), ("high", high))
    }
    gains = [value for name, value in figures.items() if name.endswith(".any_alpha")]
    return claims | {"control_least": _shown(min(gains)), "control_most": _shown(max(gains))}


def _speeds() -> dict[str, str]:
    """Return times of steps, of assembly and of a design: pages on limits and sizes."""
    speed, tolerance = _figures("performance"), _figures("tolerance")
    step = speed["a_step_and_its_derivatives.step_of_the_crank_slider_newton_1e_08"]
    size = "from_ten_to_ten_thousand_elements."
    return {
        "step_crank": _shown(step / 1e3, 1),
        "step_ten_thousand": _shown(speed[f"{size}step_of_10000_elements"] / 1e3, 1),
        "chain_of_100": _shown(speed["start.chain_of_100_bodies_assembled"]),
        "assembly_1000": _shown(speed[f"{size}1000_elements_assembled"]),
        "assembly_1000_heights": _shown(speed[f"{size}1_000_elements_assembled_with_their_heights"]),
        "tolerance_price": _shown(tolerance["price"]),
        "tolerance_held": _shown(100 * tolerance["held"]),
    }


#: What stands for each name.
CLAIMS = _methods() | _integrators() | _speeds()
