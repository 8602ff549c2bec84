"""The paper's Figs. 4 to 6 again."""

import numpy as np

from ancfdae import HHT, FiniteDifference, differentiate
from ancfdae.plotting import Panel, Series
from validation.pendulum.case import DESIGN, STEP, SYMBOLS, Curves, Extent, relative, scaled
from validation.report import Agreement, Report
from validation.scenes import pendulum


def effect_of_modulus(report: Report, hard: Curves, soft: Curves) -> None:
    """Add Fig. 4 of the paper, computed here."""
    report.heading("Effect of Young's modulus (paper, Fig. 4)")
    runs = {"E = 1e7 N/m²": hard, "E = 5e6 N/m²": soft}
    deflections = [Series(name, c.t, c.y) for name, c in runs.items()]
    slopes = [Series(name, c.t, c.y_b[:, 2]) for name, c in runs.items()]
    title = "Its sensitivity to Young's modulus"
    panels = [
        Panel("Deflection of the free end", "time t [s]", "deflection [m]", deflections),
        Panel(title, "time t [s]", "E · d(deflection)/dE [m]", slopes),
    ]
    report.plot("deflection", panels, 2)
    figures = {
        "largest deflection [m]": [float(np.max(np.abs(c.y))) for c in (hard, soft)],
        "rms of d/dE [m³/N]": [
            float(np.sqrt(np.mean((c.y_b[:, 2] / E) ** 2))) for c, E in ((hard, 1e7), (soft, 5e6))
        ],
    }
    for key, name in zip(figures, ("deflection_max", "dE_rms"), strict=True):
        for value, modulus in zip(figures[key], ("1e7", "5e6"), strict=True):
            report.figure(f"fig4.{name}.E{modulus}", value)
    report.table(["", "E = 1e7", "E = 5e6"], [[name, *values] for name, values in figures.items()])
    smaller = all(first < second for first, second in figures.values())
    report.judge(
        "modulus",
        smaller,
        pairs="; ".join(f"{name}: {a:.3g} against {b:.3g}" for name, (a, b) in figures.items()),
    )


def against_finite_differences(report: Report, hard: Curves, extent: Extent) -> None:
    """Add Fig. 5 of the paper, computed here."""
    report.heading("Direct differentiation against 1 % finite differences (paper, Fig. 5)")
    check = scaled(
        differentiate(
            pendulum(), extent.t_end, HHT(STEP), design=DESIGN, method=FiniteDifference(0.01)
        )
    )
    curves = {"direct differentiation": hard, "forward difference, 1 %": check}
    _compare(report, "fig5", "finite-differences", curves)


def planar_and_spatial(report: Report, planar: Curves, extent: Extent) -> None:
    """Add Fig. 6 of the paper, computed here."""
    report.heading("Planar against spatial element (paper, Fig. 6)")
    spatial = scaled(differentiate(pendulum(3), extent.t_end, HHT(STEP), design=DESIGN))
    motion = report.figure("fig6.difference.deflection", relative(spatial.y, planar.y))
    curves = {"planar, 12 coordinates": planar, "spatial, 24 coordinates": spatial}
    _compare(report, "fig6", "planar-spatial", curves, motion=motion)


def _compare(
    report: Report, figure: str, key: str, curves: dict[str, Curves], **values: object
) -> None:
    """Draw the sensitivities to every variable, one panel each, and compare them."""
    first, other = curves.values()
    panels, differences = [], []
    for i, symbol in enumerate(SYMBOLS):
        differences.append(relative(other.y_b[:, i], first.y_b[:, i]))
        series = [Series(name, curve.t, curve.y_b[:, i]) for name, curve in curves.items()]
        axes = "time t [s]", f"{symbol} · d(deflection)/d{symbol} [m]"
        panels.append(Panel(f"Sensitivity to {symbol}", *axes, series))
    report.figures(f"{figure}.difference.{{}}", SYMBOLS, differences)
    report.plot(key, panels, 3)
    # "Comparable" curves: the eye sees a difference of a fifth of the amplitude.
    verdict = Agreement.AGREES if max(differences) < 0.2 else Agreement.PARTLY
    words = ", ".join(f"{s}: {d:.2g}" for s, d in zip(SYMBOLS, differences, strict=True))
    report.judge(key, verdict, differences=words, **values)
    report.say(key)
