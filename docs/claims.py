"""Costs and errors that pages quote, taken from the results of the reports when the site is built.

A page writes a name in double braces; `CLAIMS` says which figure stands there and with how many
digits. tests/public/test_claims.py finds costs that are typed into a page instead.
"""

import json
from collections.abc import Collection
from pathlib import Path

_REPORTS = Path(__file__).parent / "reports"
#: Variables of the crank-slider in report `crank-slider`.
_VARIABLES = 6
#: Scenes of report `work-precision` that pages quote.
_SCENES = ("soft", "soft-damped", "stiff", "stiff-damped", "slider-crank")


def _figures(report: str) -> dict[str, float]:
    """Return the figures of a report by name."""
    text = (_REPORTS / report / "results.json").read_text(encoding="utf-8")
    found: dict[str, float] = json.loads(text)["figures"]
    return found


def _made(report: str) -> str:
    """Return the day on which a report was started."""
    text = (_REPORTS / report / "results.json").read_text(encoding="utf-8")
    return str(json.loads(text)["meta"]["started"])[:10]


def _shown(value: float, digits: int = 2) -> str:
    """Return a number with its significant digits, 1,000 in place of 1e+03."""
    text = f"{value:.{digits}g}"
    return f"{float(text):,.0f}" if "e+" in text else text


def _range(values: Collection[float]) -> str:
    """Return one number, or the least and the largest; "not reached" without a number."""
    if not values:
        return "not reached"
    low, high = _shown(min(values), 1), _shown(max(values), 1)
    return low if low == high else f"{low} to {high}"


def _cheapest(scene: str, error: float, groups: tuple[str, ...]) -> dict[str, float]:
    """Return the seconds of the cheapest setting of some kinds, by the objective it reaches."""
    figures = _figures("work-precision")
    found = {}
    for objective in ("integrated", "pointwise"):
        names = [f"cheapest.{scene}.{objective}.{group}.{error:.0e}" for group in groups]
        seconds = [figures[name] for name in names if name in figures]
        if seconds:
            found[objective] = min(seconds)
    return found


def _methods() -> dict[str, str]:
    """Return costs of derivatives, for pages on methods of differentiation."""
    speed, crank = _figures("performance"), _figures("crank-slider")
    step = "a_step_and_its_derivatives."
    directly = speed[f"{step}six_variables_directly_against_the_motion"]
    adjoint = speed[f"{step}adjoint_against_the_motion"]
    further = speed[f"{step}each_further_variable"] / 100  # The report has per cent.
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
    """Return costs of accuracy, for pages on integrators and steps."""
    second, high = ("HHT_fixed", "HHT_controlled"), ("high_order",)
    claims = {}
    for scene in _SCENES:
        for digits in (2, 4, 6):
            name = f"{scene.replace('-', '_')}_{digits}_digits"
            claims[f"{name}_hht"] = _range(_cheapest(scene, 10.0**-digits, second).values())
            claims[f"{name}_high"] = _range(_cheapest(scene, 10.0**-digits, high).values())
    figures, both = _figures("work-precision"), []
    gains = [value for name, value in figures.items() if name.endswith(".any_alpha")]
    for scene in _SCENES:
        fixed = _cheapest(scene, 1e-2, ("HHT_fixed",))
        careful = _cheapest(scene, 1e-2, ("both_controlled",))
        both += [careful[kind] / fixed[kind] for kind in fixed.keys() & careful.keys()]
    return claims | {
        "control_least": _shown(min(gains)),
        "control_most": _shown(max(gains)),
        "control_of_both": _range(both),
    }


def _speeds() -> dict[str, str]:
    """Return times of steps and of assembly, for pages on limits and sizes."""
    speed, tolerance = _figures("performance"), _figures("tolerance")
    step = speed["a_step_and_its_derivatives.step_of_the_crank_slider_newton_1e_08"]
    size = "from_ten_to_ten_thousand_elements."
    return {
        "step_crank": _shown(step / 1e3, 1),
        "step_ten_thousand": _shown(speed[f"{size}step_of_10000_elements"] / 1e3, 1),
        "chain_of_100": _shown(speed["start.chain_of_100_bodies_assembled"]),
        "tolerance_made": _made("tolerance"),
        "tolerance_price": _shown(tolerance["price"]),
        "tolerance_held": _shown(100 * tolerance["held"]),
    }


def _elements() -> dict[str, str]:
    """Return errors of meshes, in per cent unless they are of a quarter circle."""
    figures = _figures("elements")
    shapes = {
        "helix": ("helix", (8, 16, 32, 64)),
        "shaft_half": ("shaft-at-0.5-of-its", (16, 32, 64)),
        "shaft_near": ("shaft-at-0.9-of-its", (32, 64)),
        "column_below": ("column-at-0.9-of-its", (4, 8, 16)),
        "column_near": ("column-at-1.02-times-its", (4, 8, 16)),
        "column_beyond": ("column-at-1.5-times-its", (4, 8, 16)),
    }
    claims = {
        f"{name}_{n}": _shown(100 * figures[f"shape.{shape}.n{n}"])
        for name, (shape, counts) in shapes.items()
        for n in counts
    }
    circles = {f"quarter_circle_{n}": _shown(figures[f"circle.enhanced.n{n}"]) for n in (2, 4, 8)}
    bent, laws = "deflection.2d.nu0.3.h0.01.", {}
    for n in (1, 4, 16):
        laws[f"exact_strains_{n}"] = _shown(-100 * figures[f"{bent}enhanced-exact-strains.n{n}"])
    laws["full_law"] = _shown(1 / (1 + figures[f"{bent}full-law.n64"]), 3)
    return claims | circles | laws


def _steps() -> dict[str, str]:
    """Return steps of the pendulum of report `integrators` by which errors are 1 %, as 2⁻ᵏ."""
    figures = _figures("integrators")

    def first(what: str) -> int:
        return min(k for k in range(7, 17) if figures[f"pendulum.HHT-I3.2-{k}.{what}"] <= 0.01)

    power = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    steps = {
        f"step_of_{name}": "2" + f"-{first(what)}".translate(power)
        for name, what in (
            ("deflection", "deflection"),
            ("height", "h-sensitivity"),
            ("modulus", "E-sensitivity"),
        )
    }
    missed = figures[f"pendulum.HHT-I3.2-{first('deflection')}.h-sensitivity"]
    return steps | {"missed_at_this_step": _shown(100 * missed)}


#: What stands for each name.
CLAIMS = _methods() | _integrators() | _speeds() | _elements() | _steps()
