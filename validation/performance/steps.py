"""A step of HHT-I3, alone and with its derivatives, on the paper's two scenes."""

from collections.abc import Callable
from functools import partial

from ancfdae import HHT, Adjoint, Integral, Scene, assemble, differentiate, gradient, simulate
from ancfdae.equations import MechanicalSystem
from ancfdae.numerics.timing import medians
from ancfdae.observables import position
from validation.performance.row import Row
from validation.scenes import crank_slider, pendulum

_STEP = 2.0**-10
_FIELDS = ("youngs_modulus", "height", "density")


def crank_variables() -> list[str]:
    """Return six variables of the crank-slider."""
    return [f"{beam.name}.{field}" for beam in crank_slider().beams[:2] for field in _FIELDS]


def pendulum_variables() -> list[str]:
    """Return three variables of the pendulum."""
    return [f"{pendulum().beams[0].name}.{field}" for field in _FIELDS]


def measure(steps: int = 256, repeats: int = 7) -> list[Row]:
    """Return microseconds of a step, and what derivatives cost relative to it."""
    rows, t_end = [], steps * _STEP
    for name, scene, limits in (
        ("crank-slider", crank_slider(), ("at most 120", "at most 150")),
        ("pendulum", pendulum(), ("at most 60", "-")),
    ):
        for newton, asked in zip((1e-8, 1e-14), limits, strict=True):
            (median,) = medians([partial(_run, assemble(scene), t_end, newton)], repeats)
            what = f"step of the {name}, Newton {newton:g}"
            rows.append(Row(what, _us(median, steps), "us", asked))
    return rows + _derivatives(crank_slider(), crank_variables(), steps, repeats)


def _derivatives(scene: Scene, design: list[str], steps: int, repeats: int) -> list[Row]:
    """Compare runs with derivatives to the motion alone, alternating."""
    t_end, hht = steps * _STEP, HHT(_STEP, newton_tolerance=1e-14)
    six, one = assemble(scene, design), assemble(scene, design[:1])
    objective = Integral(position(scene.beams[-1].at_end, 0))
    calls: list[Callable[[], object]] = [
        lambda: _run(six, t_end, 1e-14),
        lambda: differentiate(six, t_end, hht),
        lambda: differentiate(one, t_end, hht),
        lambda: gradient(six, objective, t_end, hht, method=Adjoint()),
    ]
    motion, of_six, of_one, adjoint = medians(calls, repeats)
    further = (of_six - of_one) / (len(design) - 1) / motion
    return [
        Row("six variables directly, against the motion", of_six / motion, "-", "at most 1.2"),
        Row("each further variable", 100 * further, "% of the motion", "at most 2"),
        Row("adjoint against the motion", adjoint / motion, "-", "at most 1.25"),
        Row("six variables directly, a step", _us(of_six, steps), "us"),
        Row("adjoint, a step", _us(adjoint, steps), "us"),
    ]


def _run(system: MechanicalSystem, t_end: float, newton: float) -> object:
    return simulate(system, t_end, HHT(_STEP, newton_tolerance=newton))


def _us(total: float, steps: int) -> float:
    return 1e6 * total / steps
