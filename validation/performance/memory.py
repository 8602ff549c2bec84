"""A thousand variables: the adjoint against the dynamics, and within a limit of memory."""

import statistics
from functools import partial

import numpy as np

from ancfdae import HHT, Adjoint, Integral, assemble, gradient, simulate
from ancfdae.equations import MechanicalSystem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import timed
from ancfdae.observables import position
from validation.performance.row import Row, in_a_process, largest_memory
from validation.performance.scale import cantilever, variables

_STEP = 2.0**-9
_LIMIT = "50 MB"


def measure(elements: int = 1_000, steps: int = 512, repeats: int = 3) -> list[Row]:
    """Return the cost of the adjoint of a height per element, its memory, and what a limit does."""
    found = {limit: in_a_process(_gradient, elements, steps, limit) for limit in (None, _LIMIT)}
    ratio = in_a_process(_ratio, elements, steps, repeats)
    (whole, peak, _), (parts, limited, taken) = found[None], found[_LIMIT]
    base = in_a_process(_gradient, elements, 2, None)[1]
    away = float(np.max(np.abs(parts - whole)) / np.max(np.abs(whole)))
    what = f"{elements} variables, {steps} steps"
    return [
        Row(f"adjoint against dynamics, {what}", ratio, "-", "at most 1.6"),
        Row("memory beyond that of two steps, whole run", 1e-6 * (peak - base), "MB"),
        Row(f"memory beyond that, memory={_LIMIT!r}", 1e-6 * (limited - base), "MB", _LIMIT),
        Row("steps taken within that limit, of those of the run", taken / steps, "-"),
        Row("difference of the gradients", away, "-"),
    ]


def _gradient(elements: int, steps: int, limit: str | None) -> tuple[Array, float, int]:
    """Return the gradient, the largest memory in bytes, and the steps taken."""
    system = assemble(cantilever(elements), variables(elements))
    method = Adjoint(memory=limit)
    answer = gradient(system, _objective(elements), steps * _STEP, HHT(_STEP), method=method)
    return answer.gradient, largest_memory(), answer.solution.statistics.steps


def _ratio(elements: int, steps: int, repeats: int) -> float:
    """Return the median over alternating runs of gradient against motion."""
    system: MechanicalSystem = assemble(cantilever(elements), variables(elements))
    objective, t_end, ratios = _objective(elements), steps * _STEP, []
    for _ in range(repeats):
        motion = partial(simulate, system, t_end, HHT(_STEP))
        both = partial(gradient, system, objective, t_end, HHT(_STEP), method=Adjoint())
        short, long = (timed(call, wall=True)[0] for call in (motion, both))
        ratios.append(long / short)
    return statistics.median(ratios)


def _objective(elements: int) -> Integral:
    beam = cantilever(elements).beams[0]
    return Integral(position(beam.at(0.03), 1) ** 2)
