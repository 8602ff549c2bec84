"""Discretisation error of an objective and its gradient, from runs that are refined.

For HHT-I3, of order two, runs at h, h/2 (and h/4) differ by d_1 = x(h/2) - x(h) and d_2 = x(h/4) -
x(h/2). With the order p observed in d_1/d_2 = 2^p, or p = 2 assumed, the finest run errs by d/(2^p
- 1), and adding that at p = 2 is Richardson's extrapolation. The bar multiplies it by the safety
factor of Roache's grid convergence index (J. Fluids Eng. 116, 1994): 3 where the order is assumed,
1.25 where it is observed. An observed order is limited to 1/2 to 2, so that runs that do not
converge yet get wide bars, and d_2 is taken as at least d_1/4.

If the runs show that their steps do not resolve the waves of the derivatives, differences have no
order, and the bar is a multiple of them (`bars.unresolved`).

SUNDIALS and SciPy choose their steps themselves. The refined run has a tenth of the tolerance, the
bar is the whole difference, and no value is extrapolated.

With events steps are halved in all phases, and runs must meet the same events. Whether waves are
resolved is not known then. Differences count as ordered only if three runs show the order.

Meshes are treated like steps, at the longest step: with two or three meshes, each of twice the
elements, the error of the finest follows from their differences, and the order is observed or taken
as 2.

**From one run** of HHT-I3 and one backward pass (`estimate_adjoint_error`). The smooth motion
leaves residuals (defects) in every step of the recurrence (`integrators.hht.equations.Defects`);
the discrete adjoint gives the change of the objective that each of them causes. The error of the
objective's own quadrature is added; from the value on every second time point it is I - Q_h =
-(Q_2h - Q_h)/3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, cast, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.derived import design_sizes
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText
from ancfdae.integrators.integrator import DefectIntegrator, Integrator, Seeds
from ancfdae.integrators.step_control import FixedSteps
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.scene import Scene
from ancfdae.modes.analysis import advice
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.sensitivity.adjoint import DirectDifferentiation
from ancfdae.sensitivity.method import Gradient, GradientMethod, Run, finished, keeping
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import states_of
from ancfdae.studies.accuracy.bars import (
    MESH_ORDER,
    ORDERLESS,
    RESOLVED_ORDER,
    convergence_bars,
    falls,
    observed_order,
    remainder,
    unresolved,
)
from ancfdae.studies.calls import as_system, differentiable, gradient, require_objectives
from ancfdae.studies.meshes import with_mesh

if TYPE_CHECKING:
    from ancfdae.equations.event_solution import EventSolution
    from ancfdae.events.kinds import Event, Mode

# Least number of steps of a run whose error can be estimated.
_LEAST_STEPS = 4
_Design: TypeAlias = Sequence[str | DesignVariable] | None
_Mesh: TypeAlias = tuple[Scene | MechanicalSystem, _Design]


@final
@dataclass(frozen=True, repr=False)
class ErrorBars(PrintedTable):
    """An objective and its gradient with estimates of their discretisation error.

    Attributes
    ----------
    names : tuple of str
        Names of the design variables.
    value : float
        Value of the objective on the finest run, in its unit.
    gradient : array, shape (n_b,)
        Gradient of the finest run; unit of the objective over that of the variable.
    parts : dict of str to array, shape (1 + n_b,)
        Estimated bounds of the errors of value and gradient by ``"step"`` and, where meshes were
        compared, by ``"mesh"``; not proven: docs/reports/error-bars says how often they hold.
    extrapolated_value : float
        Value with the estimated error removed, better by one order if runs converge; unit of the
        objective.
    extrapolated_gradient : array, shape (n_b,)
        The same for the gradient; equal to `gradient` if the integrator has no fixed order.
    orders : array, shape (1 + n_b,)
        Observed orders of the value and the gradient; NaN where they cannot be observed.
    mesh_orders : array, shape (1 + n_b,)
        Observed orders of the value and of the derivatives in the element length; dimensionless.
    runs : tuple of Gradient
        All runs, from the coarsest to the finest.
    resolved : bool or None
        Whether the steps resolve the waves of the derivatives: whether their estimated errors
        (`Solution.estimated_errors`) fall at the order of the integrator from the last run but one.
        If not, bars are three to four times the differences of the runs. None without such an
        estimate, which only `DirectDifferentiation` with `HHT` provides.
    """

    names: tuple[str, ...]
    value: float
    gradient: Array
    parts: dict[str, Array]
    extrapolated_value: float
    extrapolated_gradient: Array
    orders: Array
    mesh_orders: Array
    runs: tuple[Gradient, ...]
    resolved: bool | None

    @property
    def value_bar(self) -> float:
        """Estimated bound of the error of the value, the sum of its parts; unit of the value."""
        return float(sum(part[0] for part in self.parts.values()))

    @property
    def gradient_bar(self) -> Array:
        """Estimated bounds of the errors of the gradient: sums of their parts, (n_b,)."""
        bar: Array = np.sum([part[1:] for part in self.parts.values()], axis=0)
        return bar

    def to_dataframe(self) -> Any:
        """Return a pandas table of the objective and its derivatives, with values and bars."""
        table: dict[str, object] = {
            "value": [self.value, *self.gradient],
            "extrapolated": [self.extrapolated_value, *self.extrapolated_gradient],
            "bar": [self.value_bar, *self.gradient_bar],
            **{f"bar of {name}": part for name, part in self.parts.items()},
            "order": self.orders,
        }
        return pandas().DataFrame(table, index=["objective", *self.names])

    def _printed(self) -> TableText:
        small: dict[str, Sequence[float] | Array]
        small = {"bar": (self.value_bar, *self.gradient_bar), "order": self.orders}
        if "mesh" in self.parts:
            small |= {f"bar of {name}": part for name, part in self.parts.items()}
            small["order of mesh"] = self.mesh_orders
        values = (self.value, *self.gradient)
        better = (self.extrapolated_value, *self.extrapolated_gradient)
        rows = [("", "value", "extrapolated", *small)]
        for name, x, y, *others in zip(
            ("objective", *self.names), values, better, *small.values(), strict=True
        ):
            cells = ("-" if np.isnan(each) else f"{each:.2g}" for each in others)
            rows.append((name, f"{x:.9g}", f"{y:.9g}", *cells))
        known = {
            True: "yes",
            False: "no, bars are multiples of what runs differ by",
            None: "not known",
        }
        finest = self.runs[-1].solution.outcome
        end = f"waves resolved: {known[self.resolved]}\nfinest run: {finest}"
        return "", rows, end


def error_bars(
    model: Scene | MechanicalSystem,
    objective: Objective,
    t_end: float,
    integrator: Integrator,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: GradientMethod | None = None,
    levels: int = 2,
    meshes: int = 1,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> ErrorBars:
    """Estimate the discretisation error of an objective and its gradient.

    Parameters
    ----------
    model, objective, t_end, integrator, design, events, modes, progress
        As in `gradient`; the coarsest run has this integrator, and at least four steps. With events
        it has a fixed step, or is `DOP853` or `IDA`, and there is one mesh.
    method : GradientMethod
        As in `gradient`, but `DirectDifferentiation` by default.
    levels : int
        Number of runs: 2, or 3 to observe the order, which with `HHT` cost 3 or 7 times the first
        run.
    meshes : int
        Number of meshes of a scene, with 2 or 3: further runs with once or twice doubled elements;
        value, gradient and bars then belong to the finest mesh.
    """
    if not any(levels is count for count in (2, 3)):
        raise InvalidInputError(
            "levels", "must be 2 or 3", repr(levels), "2 is cheaper, 3 is safer."
        )
    chosen = DirectDifferentiation() if method is None else method

    def run(at: _Mesh, settings: Integrator) -> Gradient:
        return gradient(
            at[0],
            objective,
            t_end,
            settings,
            design=at[1],
            method=chosen,
            events=events,
            modes=modes,
            progress=progress,
        )

    happens = events is not None or modes is not None
    if happens:
        _require_halving(integrator, meshes)
    *coarser, finest = _meshes(model, design, meshes)
    settings, runs = integrator, [run(finest, integrator)]
    steps = sum(x.statistics.steps for x in _solutions(runs[0]))
    if steps < _LEAST_STEPS:
        raise InvalidInputError(
            "error_bars",
            f"needs {_LEAST_STEPS} steps or more: from fewer no error can be estimated",
            steps,
            f"Use a step of {t_end / (2 * _LEAST_STEPS):.3g} or less.",
        )
    for _ in range(levels - 1):
        settings = _refined(settings, runs[-1])
        runs.append(run(finest, settings))
    if happens:
        _require_same_events(runs)
    widths, orders, resolved = _of_steps(runs, finest, integrator.order)
    parts, mesh_orders = {"step": widths}, np.full(len(widths), np.nan)
    if coarser:
        on_meshes = _numbers([*(run(each, integrator) for each in coarser), runs[0]])
        parts["mesh"], mesh_orders = convergence_bars(np.diff(on_meshes, axis=0), MESH_ORDER)
    x, last = _numbers(runs[-2:]), runs[-1]
    better = x[1]
    if integrator.order is not None:
        better = x[1] + remainder(x[1] - x[0], 2.0, integrator.order)
    known = last.names, last.value, last.gradient, parts, float(better[0]), better[1:]
    return ErrorBars(*known, orders, mesh_orders, tuple(runs), resolved)


def _of_steps(
    runs: Sequence[Gradient], mesh: _Mesh, order: int | None
) -> tuple[Array, Array, bool | None]:
    """Return error bars from the steps, orders, and whether the steps resolve the waves."""
    differences, happens = np.diff(_numbers(runs), axis=0), runs[0].event_solution is not None
    resolved = None if happens else _resolved(*runs[-2:])
    widths, orders = convergence_bars(differences, order)
    if resolved is False or (happens and order is not None and not _fall(differences, order)):
        scale = design_sizes(differentiable(*mesh))
        slopes = unresolved(differences[:, 1:] * scale) / scale
        widths = np.append(unresolved(differences[:, :1]), slopes)
    return widths, orders, resolved


def _fall(differences: Array, order: int) -> bool:
    """Return whether two differences of values and of each derivative fall with the order."""
    if len(differences) < 2:
        return False
    columns = np.abs(differences).T
    return all(not np.any(sizes) or falls(sizes, (1, 2, 4), order) for sizes in columns)


def _solutions(run: Gradient) -> Sequence[Solution]:
    """Return the solutions of all phases of a run."""
    return (run.solution,) if run.event_solution is None else run.event_solution.phases


def _refined(settings: Integrator, run: Gradient) -> Integrator:
    """Return the integrator with half the steps of a run, or a tenth of its tolerance."""
    if run.event_solution is not None and isinstance(settings, SteppedIntegrator):
        assert isinstance(settings.steps, FixedSteps)
        return settings.with_steps(FixedSteps(settings.steps.step / 2))
    return settings.refined(run.solution)


def _require_halving(integrator: Integrator, meshes: int) -> None:
    """Raise InvalidInputError for several meshes, or steps with events that cannot be halved."""
    if meshes != 1:
        raise InvalidInputError(
            "meshes", "must be 1 with events", meshes, "Leave out meshes to compare steps."
        )
    if isinstance(integrator, SteppedIntegrator) and not isinstance(integrator.steps, FixedSteps):
        rule, repair = "must be fixed with events", "For example HHT(step=...), or IDA(rtol)."
        raise InvalidInputError("error_bars, steps", rule, repr(integrator), repair)


def _require_same_events(runs: Sequence[Gradient]) -> None:
    """Raise InvalidInputError for runs with different events, whose motions differ."""
    names = [[x.name for x in cast("EventSolution", run.event_solution).events] for run in runs]
    if any(each != names[-1] for each in names):
        rule = "must meet the same events in all runs to compare them"
        got = ", ".join(f"{len(each)} events" for each in names)
        raise InvalidInputError("error_bars", rule, got, "Take a shorter step.")


def _meshes(model: Scene | MechanicalSystem, design: _Design, count: int) -> list[_Mesh]:
    """Return the model and its design on `count` meshes, the coarsest first."""
    if count not in (1, 2, 3):
        raise InvalidInputError(
            "meshes", "must be 1, 2 or 3", repr(count), "2 is cheaper, 3 is safer."
        )
    if count == 1:
        return [(model, design)]
    require_kind("model", model, (Scene,), "Only scenes have meshes.")
    assert isinstance(model, Scene)
    variables = as_design(() if design is None else design)
    return [with_mesh(model, variables, level) for level in range(count)]


def _numbers(runs: Sequence[Gradient]) -> Array:
    return np.array([[run.value, *run.gradient] for run in runs])


def _resolved(coarse: Gradient, fine: Gradient) -> bool | None:
    errors = [run.solution.estimated_errors for run in (coarse, fine)]
    before, after = (None if x is None else x.derivatives for x in errors)
    if before is None or after is None:
        return None
    # A variable without influence has the error nan, which passes; an infinite one does not.
    orders = observed_order(np.asarray(before), np.asarray(after), 2.0)
    return not (np.any(np.asarray(before) > ORDERLESS) or np.any(orders < RESOLVED_ORDER))


@final
@dataclass(frozen=True)
class AdjointErrorEstimate:
    """An objective and the estimate of its discretisation error from a single run.

    `error` estimates the exact value minus `value`, with its sign, in the unit of the objective; it
    is not a bound.
    """

    value: float
    error: float
    solution: Solution

    @property
    def extrapolated_value(self) -> float:
        """The value corrected by its estimated error; unit of the objective."""
        return self.value + self.error

    def __repr__(self) -> str:
        numbers = f"objective {self.value:.9g}, estimated error {self.error:.2g}"
        return f"{numbers} (extrapolated {self.extrapolated_value:.9g})\n{self.solution.outcome}"


@in_one_thread
def estimate_adjoint_error(
    model: Scene | MechanicalSystem,
    objective: Objective,
    t_end: float,
    integrator: Integrator,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    progress: bool = False,
) -> AdjointErrorEstimate:
    """Estimate the discretisation error of an objective from a single run.

    Costs about 1.4 runs, where `error_bars` costs three; it gives no error of the gradient, and is
    unreliable where the step does not resolve the motion.

    Parameters
    ----------
    model, objective, t_end, progress
        As in `gradient`.
    integrator : Integrator
        An integrator that computes the defects of its steps, such as `HHT`, with at least four
        steps.
    design : sequence of str or DesignVariable, optional
        Needed only where the objective contains `design_value`.
    """
    if not isinstance(integrator, DefectIntegrator):
        rule = "needs an integrator that knows the defects of its steps, such as HHT"
        raise InvalidInputError(
            "estimate_adjoint_error", rule, repr(integrator), "Use HHT, or error_bars."
        )
    system = as_system(model, design)
    require_objectives(system, [objective], t_end)
    solution = finished(Run(system, t_end, integrator, progress).solution())
    steps = len(solution.t) - 1
    if steps < _LEAST_STEPS:
        periods = advice(system, 0.0, solution.q[0], solution.v[0], solution.lam[0])
        repair = f"Use a step of {t_end / 8:.3g} or less. {periods}".rstrip()
        raise InvalidInputError("estimate_adjoint_error", "needs four steps", steps, repair)
    states = states_of(solution)
    partials = objective.partials(system, states)
    seeds = Seeds(partials.q, partials.v, partials.lam)
    with keeping(solution):
        error = integrator.discretisation_error(system, solution, seeds)
    every_second = [*range(0, steps, 2), steps]
    thinned = objective.value(system, states.rows(every_second))
    quadrature = remainder(np.real(partials.value - thinned), 2.0, 2)
    return AdjointErrorEstimate(partials.value, error + float(quadrature), solution)
