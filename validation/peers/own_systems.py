"""Systems of one's own beside CasADi with IDAS, and JAX with diffrax, at equal accuracy."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from ancfdae import DOP853, gradient, simulate
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import medians, timed
from validation.peers.casadi_runs import CasadiRuns
from validation.peers.diffrax_runs import DiffraxRuns
from validation.peers.formulas import MECHANISMS, Formulated, Mechanism
from validation.report import Report

# Relative error of the gradient that a run may have, and tolerances that are tried in turn.
_ACCURACY = 1e-6
_TOLERANCES = 10.0 ** np.arange(-4, -11, -1)
_EXACT = 3e-14


class _Runs(Protocol):
    def motion(self) -> object:
        """Run the motion and its objective."""

    def gradient(self) -> Array:
        """Return the gradient of the objective."""


class _Ours:
    """Motion and gradient here; each call can trace the formulas first."""

    def __init__(self, mechanism: Mechanism, tolerance: float) -> None:
        self._mechanism, self._t_end = mechanism, mechanism.t_end
        self._system = Formulated(mechanism)
        self._explicit = DOP853(tolerance, intervals=1)

    def motion(self) -> object:
        return simulate(self._system, self._t_end, self._explicit)

    def gradient(self) -> Array:
        return self._gradient(self._system)

    def traced_motion(self) -> object:
        return simulate(Formulated(self._mechanism), self._t_end, self._explicit)

    def traced_gradient(self) -> Array:
        return self._gradient(Formulated(self._mechanism))

    def _gradient(self, system: Formulated) -> Array:
        return gradient(system, system.objective(), self._t_end, self._explicit).gradient


class _Found(NamedTuple):
    """Runs that are accurate enough, their tolerance, and the time of their making; s."""

    runs: _Runs
    tolerance: float
    error: float
    making: float


def fill(report: Report, count: int, repeats: int) -> None:
    """Add the table of the first `count` mechanisms."""
    report.say("own-systems", accuracy=_ACCURACY)
    rows: list[list[str]] = []
    ratios: dict[str, list[float]] = {}
    for i, make in enumerate(MECHANISMS[:count]):
        mechanism = make()
        exact = _exact(mechanism)
        ours, casadi, jax = (
            _accurate(kind, mechanism, exact) for kind in (_Ours, CasadiRuns, DiffraxRuns)
        )
        here = ours.runs
        assert isinstance(here, _Ours)
        calls: list[Callable[[], object]] = [
            here.motion,
            here.traced_motion,
            casadi.runs.motion,
            jax.runs.motion,
            here.gradient,
            here.traced_gradient,
            casadi.runs.gradient,
            jax.runs.gradient,
        ]
        times = medians(calls, repeats)
        for what, (own, traced, other, compiled) in (
            ("motion", times[:4]),
            ("gradient", times[4:]),
        ):
            for name, ratio in (
                (f"{what}.casadi", traced / other),
                (f"{what}.jax", traced / compiled),
                (f"{what}.jax_alone", own / compiled),
            ):
                ratios.setdefault(name, []).append(report.figure(f"own.{i}.{name}.ratio", ratio))
            rows.append(
                [
                    f"{mechanism.title}: {what}",
                    *(f"{1e3 * x:.3g}" for x in (own, traced, other, compiled)),
                    f"{traced / other:.2f}",
                    f"{traced / compiled:.2f}",
                ]
            )
        found = (ours, casadi, jax)
        report.figure(f"own.{i}.compilation_s", jax.making)
        rows.append(
            [
                "error of the gradient; made ready, s",
                f"{ours.error:.0e}",
                f"{ours.making:.2g}",
                *(f"{each.error:.0e}; {each.making:.2g}" for each in found[1:]),
                "",
                "",
            ]
        )
    report.table(
        [
            "mechanism",
            "here, ms",
            "with tracing, ms",
            "CasADi + IDAS, ms",
            "JAX + diffrax, ms",
            "of CasADi, with tracing",
            "of JAX, with tracing",
        ],
        rows,
    )
    for peer, bound, asked in (("casadi", 0.2, "CasADi + IDAS"), ("jax", 1.0, "compiled JAX")):
        worst = [max(ratios[f"{what}.{peer}"]) for what in ("motion", "gradient")]
        report.judge(
            "own-systems",
            max(worst) <= bound,
            asked=asked,
            bound=bound,
            worst=", ".join(f"{ratio:.2f}" for ratio in worst),
        )


def _exact(mechanism: Mechanism) -> Array:
    """Return the gradient by DOP853 at the smallest tolerance."""
    system = Formulated(mechanism)
    explicit = DOP853(_EXACT, intervals=1, max_steps=10**6)
    return gradient(system, system.objective(), mechanism.t_end, explicit).gradient


def _accurate(
    kind: Callable[[Mechanism, float], _Runs], mechanism: Mechanism, exact: Array
) -> _Found:
    """Return runs at the largest tolerance whose gradient is accurate."""
    # What is compiled once serves all tolerances.
    making, _ = timed(partial(kind, mechanism, float(_TOLERANCES[0])), wall=True)
    for tolerance in _TOLERANCES:
        runs = kind(mechanism, float(tolerance))
        error = float(np.max(np.abs(runs.gradient() / exact - 1)))
        if error <= _ACCURACY:
            return _Found(runs, float(tolerance), error, making)
    raise AssertionError(f"{mechanism.title}: no tolerance of {kind} gives {_ACCURACY:g}")
