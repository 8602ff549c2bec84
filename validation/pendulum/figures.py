"""The paper's Figs. 4 to 6 again."""

import numpy as np

from ancfdae import HHT, FiniteDifference, differentiate
from ancfdae.plotting import Panel, Series
from validation.pendulum.case import DESIGN, STEP, SYMBOLS, Curves, Extent, relative, scaled
from validation.report import Agreement, Report
from validation.scenes import pendulum

__all__ = ["against_finite_differences", "effect_of_modulus", "planar_and_spatial"]


def effect_of_modulus(report: Report, hard: Curves, soft: Curves) -> None:
    """Add Fig. 4 of the paper, computed here."""
    report.heading("Effect of Young's modulus (paper, Fig. 4)")
    report.plot(
        "deflection",
        [
            Panel(
                "Deflection of the free end",
                "time t [s]",
                "deflection [m]",
                [Series("E = 1e7 N/m²", hard.t, hard.y), Series("E = 5e6 N/m²", soft.t, soft.y)],
            ),
            Panel(
                "Its sensitivity to Young's modulus",
                "time t [s]",
                "E · d(deflection)/dE [m]",
                [
                    Series("E = 1e7 N/m²", hard.t, hard.y_b[:, 2]),
                    Series("E = 5e6 N/m²", soft.t, soft.y_b[:, 2]),
                ],
            ),
        ],
        columns=2,
        title="Flexible pendulum, planar, HHT-I3 at the paper's step 2⁻⁷ s",
        caption="Deflection of the free end across the tangent at the pin, and what one per cent "
        "of Young's modulus changes, times 100.",
    )
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
    report.claim(
        "The stiffer pendulum deflects less and is less sensitive to E",
        "yes (text to Fig. 4)",
        "; ".join(f"{name}: {a:.3g} against {b:.3g}" for name, (a, b) in figures.items()),
        Agreement.AGREES if smaller else Agreement.DISAGREES,
    )


def against_finite_differences(report: Report, hard: Curves, extent: Extent) -> None:
    """Add Fig. 5 of the paper, computed here."""
    report.heading("Direct differentiation against 1 % finite differences (paper, Fig. 5)")
    check = scaled(
        differentiate(
            pendulum(), extent.t_end, HHT(STEP), design=DESIGN, method=FiniteDifference(0.01)
        )
    )
    differences = [relative(check.y_b[:, i], hard.y_b[:, i]) for i in range(3)]
    for symbol, value in zip(SYMBOLS, differences, strict=True):
        report.figure(f"fig5.difference.{symbol}", value)
    report.plot(
        "finite-differences",
        _panels({"direct differentiation": hard, "forward difference, 1 %": check}),
        columns=3,
        title="Sensitivities directly and by finite differences, E = 1e7 N/m², step 2⁻⁷ s",
        caption="The same discrete motion differentiated in two ways.",
    )
    report.claim(
        "Direct differentiation is comparable with 1 % finite differences",
        "comparable curves (Fig. 5)",
        "relative difference (norm over time) "
        + ", ".join(f"{s}: {d:.2g}" for s, d in zip(SYMBOLS, differences, strict=True)),
        # "Comparable" curves: the eye sees a difference of a fifth of the amplitude.
        Agreement.AGREES if max(differences) < 0.2 else Agreement.PARTLY,
    )
    report.text(
        "Both curves differentiate the same discrete motion, so their agreement says nothing "
        "about the time step: see below."
    )


def planar_and_spatial(report: Report, planar: Curves, extent: Extent) -> None:
    """Add Fig. 6 of the paper, computed here."""
    report.heading("Planar against spatial element (paper, Fig. 6)")
    spatial = scaled(differentiate(pendulum(3), extent.t_end, HHT(STEP), design=DESIGN))
    differences = [relative(spatial.y_b[:, i], planar.y_b[:, i]) for i in range(3)]
    motion = report.figure("fig6.difference.deflection", relative(spatial.y, planar.y))
    for symbol, value in zip(SYMBOLS, differences, strict=True):
        report.figure(f"fig6.difference.{symbol}", value)
    report.plot(
        "planar-spatial",
        _panels({"planar, 12 coordinates": planar, "spatial, 24 coordinates": spatial}),
        columns=3,
        title="Sensitivities of the planar and the spatial model, E = 1e7 N/m², step 2⁻⁷ s",
        caption="Sensitivities of the deflection by both elements.",
    )
    report.claim(
        "Spatial sensitivities coincide with planar ones",
        "coincide well (Fig. 6)",
        f"relative difference: deflection {motion:.2g}, "
        + ", ".join(f"{s}: {d:.2g}" for s, d in zip(SYMBOLS, differences, strict=True)),
        Agreement.AGREES if max(differences) < 0.2 else Agreement.PARTLY,
    )
    report.text(
        "They coincide because both elements lock in the same way: with the full St. "
        "Venant-Kirchhoff law at nu = 0.3 either bends (1 - nu)/((1 + nu)(1 - 2 nu)) = 1.346 "
        "times too stiffly. The agreement is not one with beam theory."
    )


def _panels(curves: dict[str, Curves]) -> list[Panel]:
    """Draw the sensitivities to every variable, one panel each."""
    return [
        Panel(
            f"Sensitivity to {symbol}",
            "time t [s]",
            f"{symbol} · d(deflection)/d{symbol} [m]",
            [Series(name, curve.t, curve.y_b[:, i]) for name, curve in curves.items()],
        )
        for i, symbol in enumerate(SYMBOLS)
    ]
