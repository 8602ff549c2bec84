"""Values and gradients of objectives to a tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.derived import design_sizes
from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import AdjointIntegrator, Integrator
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.sensitivity.method import Accuracy, Gradient, GradientMethod, Run, UnfinishedRunError
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.objectives.objective import ObjectivePartials
from ancfdae.sensitivity.objectives.reductions import OverTime, SmoothUpperBound
from ancfdae.sensitivity.objectives.totals import read_at_end
from ancfdae.sensitivity.observables.expression import leaves
from ancfdae.sensitivity.observables.states import States
from ancfdae.studies.tolerance.features import features
from ancfdae.studies.tolerance.places import Seen, Witness
from ancfdae.studies.tolerance.runs import Sample, Wanted
from ancfdae.studies.tolerance.search import Found, search
from ancfdae.studies.tolerance.spectrum import speed

# Up to _DIRECT variables HHT differentiates directly, which also shows whether waves are resolved.
_DIRECT = 6
# Intervals of high order where objectives read the end only, and else, or where
# forces may have sharp places along the path.
_FEW, _MANY = 4, 64


def gradients_within(
    system: MechanicalSystem,
    objectives: Sequence[Objective],
    t_end: float,
    tolerance: float,
    method: GradientMethod | None,
    progress: bool,
) -> list[Gradient]:
    """Return values and gradients with bars below the tolerance, or a warning and the best."""
    require_tolerance(tolerance)
    scale = design_sizes(system)

    def measure(integrator: Integrator) -> Sample:
        way = method or _method(integrator, system.n_b)
        try:
            results = way.gradients(Run(system, t_end, integrator, progress), objectives)
        except UnfinishedRunError as error:
            return Sample([], None, error.solution.statistics.steps, error, error.solution)
        vectors = [x for each in results for x in (np.array([each.value]), each.gradient * scale)]
        run = results[0].solution
        return Sample(vectors, run.estimated_errors, run.statistics.steps, results, run)

    wanted = _wanted(system, objectives, t_end, tolerance)
    witness, intervals = Witness(system, _seen(objectives), tolerance), None
    if method is None or isinstance(method, DirectDifferentiation):
        few = read_at_end(system, objectives, t_end) and not witness.looks
        intervals = _FEW if few else _MANY
    reached = search(wanted, measure, witness, intervals, 4)
    return _results(reached, scale, tolerance)


def _wanted(
    system: MechanicalSystem, objectives: Sequence[Objective], t_end: float, tolerance: float
) -> Wanted:
    """Return the task of the search for objectives."""

    def numbers(states: States) -> list[Array]:
        with np.errstate(all="ignore"):
            return [np.array([np.real(x.value(system, states))]) for x in objectives]

    def partials(states: States) -> list[ObjectivePartials]:
        return [x.partials(system, states) for x in objectives]

    parts = [leaves(x) for x in objectives]
    over = [[x for x in each if isinstance(x, OverTime)] for each in parts]
    integrated = [len(x) == len(y) for x, y in zip(parts, over, strict=True)]
    problem = InitialValueProblem.of(system, t_end)
    fast = features(problem, [x.observable for each in over for x in each], t_end)
    return Wanted(
        problem,
        t_end,
        tolerance,
        _sizes,
        numbers,
        integrated,
        partials,
        False,
        fast,
        speed(problem),
    )


def require_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that means nothing or that round-off is above."""
    require_positive("tolerance", tolerance)
    if not 1e-11 <= tolerance <= 0.1:
        raise InvalidInputError(
            "tolerance", "must lie in [1e-11, 0.1]", tolerance, "For example 1e-3."
        )


def _method(integrator: Integrator, variables: int) -> GradientMethod:
    adjoint = isinstance(integrator, AdjointIntegrator) and variables > _DIRECT
    return Adjoint() if adjoint else DirectDifferentiation()


def _seen(objectives: Sequence[Objective]) -> tuple[Seen, ...]:
    """Return the observables that objectives read between the ends of a run."""
    each = dict.fromkeys(x for objective in objectives for x in leaves(objective))
    over = (x for x in each if isinstance(x, OverTime | SmoothUpperBound))
    return tuple(Seen(x.observable, getattr(x, "sharpness", None)) for x in over)


def _sizes(vectors: Sequence[Array]) -> list[float]:
    """Return the sizes for pairs of a value and a scaled gradient."""
    norms = [float(np.linalg.norm(each)) for each in vectors]
    pairs = zip(norms[::2], norms[1::2], strict=True)
    return [size for value, slope in pairs for size in (max(value, slope), slope)]


def _results(reached: Found, scale: Array, tolerance: float) -> list[Gradient]:
    """Put the estimates into the results of the finest run."""
    results, done = reached.result, []
    assert isinstance(results, list)
    for each, value, slope in zip(
        results, reached.estimates[::2], reached.estimates[1::2], strict=True
    ):
        accuracy = Accuracy(
            tolerance,
            reached.reached,
            reached.integrator,
            reached.why,
            reached.trials,
            float(value.bar[0]),
            slope.bar / scale,
        )
        numbers = {"value": float(value.x[0]), "gradient": slope.x / scale}
        done.append(replace(each, **numbers, accuracy=accuracy))
    return done
