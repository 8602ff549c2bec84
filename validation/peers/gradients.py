"""Gradients: exact here, central differences of Exudyn's runs there."""

from collections.abc import Callable

import numpy as np

from ancfdae import HHT, Adjoint, DirectDifferentiation, Terminal, assemble, gradient
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import medians
from ancfdae.observables import position
from ancfdae.plotting import Series
from validation.drawing import log_log
from validation.peers.cables import CablePendulum
from validation.peers.exudyn import Exudyn, Way
from validation.peers.pair import Pair
from validation.peers.rigid import Chain
from validation.report import Report

_STEP, _STEPS, _NEWTON = 2.0**-10, 256, 1e-8
_CHANGES = 10.0 ** np.arange(-1, -8, -1)


def fill(report: Report, quick: bool) -> None:
    """Add the table of gradients, and the errors of differences over their change."""
    report.heading("Gradients")
    cases: list[tuple[Pair, int]] = [(CablePendulum(10), 1), (CablePendulum(10), 10)]
    if not quick:
        cases += [(CablePendulum(100), 100), (Chain(5, True), 1), (Chain(20, True), 20)]
    rows: list[list[object]] = []
    curves: list[Series] = []
    ratios: list[float] = []
    for pair, number in cases:
        case = _Case(pair, number, 8 if quick else _STEPS)
        errors = case.errors_of_differences()
        title = f"{pair.title}, {number} variable{'s' * (number > 1)}"
        curves.append(Series(title, _CHANGES, errors, marker=True))
        best = int(np.nanargmin(errors))
        direct, adjoint, differences = case.times(float(_CHANGES[best]), 1 if quick else 3)
        name = f"gradient.{len(rows)}"
        ratios.append(report.figure(f"{name}.ratio", min(direct, adjoint) / differences))
        report.figure(f"{name}.error_of_differences", float(errors[best]))
        ms = [f"{1e3 * x:.3g}" for x in (direct, adjoint, differences)]
        digits = [f"{case.error_here():.0e}", f"{errors[best]:.0e}"]
        rows.append([title, *ms, *digits, f"{ratios[-1]:.3f}"])
    report.table(
        [
            "scene",
            "direct, ms",
            "adjoint, ms",
            "Exudyn and differences, ms",
            "error here",
            "error of differences",
            "ratio",
        ],
        rows,
    )
    worst = max(ratios)
    report.judge("gradients", worst <= 1, worst=worst)
    panel = log_log(
        "Error of central differences, first variable",
        "relative change [-]",
        "relative error [-]",
        curves,
    )
    report.plot("differences", [panel])


class _Case:
    """A scene with its first variables, here and there."""

    def __init__(self, pair: Pair, number: int, steps: int) -> None:
        self._number, self._t_end, self._steps = number, steps * _STEP, steps
        scene = pair.scene()
        self._system = assemble(scene, design=pair.design()[:number])
        assert scene.gravity is not None
        up = len(scene.gravity) - 1
        self._objective = Terminal(position(pair.point, up))
        self._exudyn = Exudyn(pair)
        self._way: Way = self._exudyn.fastest(_STEP, 16, _NEWTON)

    def errors_of_differences(self) -> Array:
        """Return how much differences move from one change to the next, relative."""
        values = np.array([self._differences(1, float(x))[0] for x in _CHANGES])
        exact = self._gradient(DirectDifferentiation())[0]
        # Both codes discretise time in their own ways; the most quiet pair of changes is Exudyn's
        # limit, and must be the gradient here up to that.
        steps = np.abs(np.diff(values))
        limit = values[1 + int(np.nanargmin(steps))]
        if not np.isclose(limit, exact, rtol=0.05):
            raise AssertionError(f"the codes disagree: {limit} there, {exact} here")
        return np.maximum(np.abs(values / limit - 1), np.nanmin(steps) / abs(limit))

    def error_here(self) -> float:
        """Return how far direct and adjoint are apart, relative."""
        direct, adjoint = self._gradient(DirectDifferentiation()), self._gradient(Adjoint())
        return float(np.linalg.norm(direct - adjoint) / np.linalg.norm(direct))

    def times(self, change: float, repeats: int) -> list[float]:
        """Return median processor seconds of direct, adjoint and differences, in turns."""
        calls: list[Callable[[], object]] = [
            lambda: self._gradient(DirectDifferentiation()),
            lambda: self._gradient(Adjoint()),
            lambda: self._differences(self._number, change),
        ]
        return medians(calls, repeats)

    def _gradient(self, method: DirectDifferentiation | Adjoint) -> Array:
        hht = HHT(step=_STEP, newton_tolerance=_NEWTON)
        found = gradient(self._system, self._objective, self._t_end, hht, method=method)
        return found.gradient * self._system.b

    def _differences(self, number: int, change: float) -> Array:
        def height() -> Array:
            return self._exudyn.end(_STEP, self._steps, _NEWTON, self._way)[-1:]

        return self._exudyn.differences(height, number, change)[:, 0]
