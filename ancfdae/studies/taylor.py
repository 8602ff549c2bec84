"""Taylor test of a gradient: first-order remainders must decrease with the square."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.derived import design_sizes
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_array, require_flag
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText
from ancfdae.events.calls import EventRun
from ancfdae.events.kinds import Event, Mode
from ancfdae.integrators.integrator import Integrator
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.modes.analysis import advised
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.numerics.timing import progress_bar
from ancfdae.sensitivity.method import Gradient, GradientMethod, finished
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import states_of
from ancfdae.studies import events as with_events
from ancfdae.studies.accuracy.bars import observed_order
from ancfdae.studies.calls import (
    as_system,
    differentiable,
    gradient,
    require_objectives,
    without_end,
)


@final
@dataclass(frozen=True, repr=False)
class TaylorTest(PrintedTable):
    """Remainders of zeroth and first order along one direction db of the design space.

    Attributes
    ----------
    gradient : Gradient
        Value Psi(b) and gradient Psi_b under test.
    sizes : array, shape (n,)
        Relative perturbations s (dimensionless).
    zeroth : array, shape (n,)
        abs(Psi(b + s db) - Psi(b)), in the unit of the objective.
    first : array, shape (n,)
        abs(Psi(b + s db) - Psi(b) - s Psi_b db), in the unit of the objective.
    """

    gradient: Gradient
    sizes: Array
    zeroth: Array
    first: Array

    @property
    def order(self) -> float:
        """Smallest observed order of `first` between neighbouring sizes; 2 if Psi_b is right.

        Infinite if a remainder vanishes, as for a linear objective to round-off.
        """
        orders = observed_order(self.first[:-1], self.first[1:], self.sizes[:-1] / self.sizes[1:])
        return float(np.min(np.where(np.isnan(orders), np.inf, orders)))

    def to_dataframe(self) -> Any:
        """Return a pandas table: a row per size, with ``change`` and ``remainder``."""
        table = {"size": self.sizes, "change": self.zeroth, "remainder": self.first}
        return pandas().DataFrame(table)

    def _printed(self) -> TableText:
        numbers = zip(self.sizes, self.zeroth, self.first, strict=True)
        rows = [("size", "change", "remainder")]
        rows += [(f"{s:.3g}", f"{change:.3g}", f"{rest:.3g}") for s, change, rest in numbers]
        head = (
            f"Taylor test of {self.gradient.value:.9g} by {self.gradient.method}: order "
            f"{self.order:.3g}, a right gradient has 2"
        )
        return head, rows, ""


def taylor_test(
    model: Scene | MechanicalSystem,
    objective: Objective,
    t_end: float,
    integrator: Integrator,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: GradientMethod | None = None,
    direction: Numbers | None = None,
    sizes: Numbers = (1e-3, 5e-4, 2.5e-4),
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> TaylorTest:
    """Check the gradient of an objective by runs at perturbed designs.

    The perturbed runs repeat the steps of the unperturbed run. With events, or with the end time in
    the design, they are runs of their own: events move, and the value jumps by the discretisation
    error where a phase takes another number of steps. Then take smaller `sizes` or steps.

    Parameters
    ----------
    model, objective, t_end, integrator, design, method, events, modes
        As in `gradient`; the method is the one under test.
    direction : sequence of float, optional
        Relative change of each design variable (absolute where it is zero); ones by default.
    sizes : sequence of float
        Perturbation sizes, decreasing (relative). For too large ones third-order terms, for too
        small ones round-off change the observed order.
    progress : bool
        Whether to show a progress bar, which counts the perturbed runs.
    """
    require_flag("progress", progress)
    own, free_end = without_end(design)
    system = as_system(model, own) if free_end else differentiable(model, own)
    s = require_array("sizes", sizes)
    if s.ndim != 1 or len(s) < 2 or np.any(np.diff(s) >= 0) or s[-1] <= 0:
        raise InvalidInputError(
            "sizes", "must be two or more, positive and falling", sizes, "For example (1e-3, 5e-4)."
        )
    count = system.n_b + free_end
    given = np.ones(count) if direction is None else direction
    relative = require_array("direction", given, (count,))
    if not relative.any():
        repair = "Leave it out to change all variables."
        raise InvalidInputError("direction", "must change at least one variable", given, repair)
    if events is not None or modes is not None or free_end:
        require_objectives(system, [objective], t_end)
        run = EventRun.of(system, t_end, integrator, events or (), modes, own, False, free_end)
        base = with_events.gradients(run, [objective], method)[0]
        db = relative * np.append(design_sizes(system), run.b[system.n_b :])

        def value(size: float) -> float:
            return float(with_events.values(run.at(run.b + size * db), [objective])[1][0])

    else:
        base = gradient(system, objective, t_end, integrator, method=method)
        frozen, db = integrator.frozen(base.solution), relative * design_sizes(system)

        def value(size: float) -> float:
            moved = system.with_values(system.b + size * db)
            run = finished(advised(moved, frozen.integrate(moved, t_end)))
            return objective.value(moved, states_of(run))

    bar = progress_bar(progress, s.tolist(), desc="taylor_test", unit="run")
    change = np.array([value(size) for size in bar]) - base.value
    return TaylorTest(base, s, np.abs(change), np.abs(change - s * (base.gradient @ db)))
