"""Static calls: equilibrium, its gradients, and critical loads.

A search for an equilibrium is a run with one time point (`Static`), so that every gradient method
differentiates it.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.meshes import warn_of_mesh
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import (
    require_count,
    require_finite,
    require_flag,
    require_kind,
    require_sequence,
)
from ancfdae.errors.kinds import InvalidInputError, StabilityWarning, UnknownNameError
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.integrators.integrator import AdjointIntegrator, Integrator, Seeds
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.modes.analysis import growth
from ancfdae.modes.linearised import LinearisationPoint
from ancfdae.modes.precise import NoModes
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.method import Gradient, GradientMethod, Run
from ancfdae.sensitivity.objectives import Objective, ObjectivePartials, Terminal
from ancfdae.sensitivity.objectives.objective import NO_TOTALS, Totals
from ancfdae.sensitivity.observables.observable import Observable, States
from ancfdae.statics.controlled import about_states, with_states
from ancfdae.statics.critical import CriticalLoad, find_critical
from ancfdae.statics.equilibrium import (
    MAX_STEPS,
    Equilibrium,
    Tangent,
    find_equilibrium,
)
from ancfdae.studies.calls import as_system, cheapest, differentiable, warn_of_strains

_STEPS = "For example 100."


def equilibrium(
    model: Scene | MechanicalSystem,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    start: Equilibrium | None = None,
    max_steps: int = MAX_STEPS,
) -> Equilibrium:
    """Return the static equilibrium under all loads at t = 0, and its design derivatives.

    The search follows the path of equilibria from the start of the model while the load increases;
    a mechanism with no stiffness but gravity is solved under the full load by pseudo-transient
    continuation (docs/theory/11-statics.md). States of controllers are unknowns, too
    (docs/theory/17-controllers.md), and stand in the velocities of the result's `solution`.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    design : sequence of str or DesignVariable, optional
        For a scene: design variables in which `q_b` and `lam_b` of the result are taken. A
        mechanical system has its own design variables.
    start : Equilibrium, optional
        Equilibrium of the same model under other loads or at another design from which to start.
    max_steps : int
        Largest number of attempted load steps.

    Returns
    -------
    Equilibrium
        If there is no equilibrium under the full load, `outcome` says so, and the last equilibrium
        is returned. Warns of beams with too few elements for their curvature (`CoarseMeshWarning`),
        or strained beyond the validity of their elements (`LargeStrainWarning`).

    Raises
    ------
    FreeMotionError
        If a motion has no stiffness; the message names it.
    InvalidInputError
        If an argument is invalid, or a driven joint has a nonzero rate at t = 0.
    Interrupted
        At Ctrl-C; its `result` is the last equilibrium found.
    """
    require_count("max_steps", max_steps, _STEPS)
    system = as_system(model, design).in_all_states()
    if start is not None:
        _require_start_of(system, start)
    state = None
    if start is not None:
        state = with_states(system, start.q, start.solution.v[0]), start.lam
    found = uninterrupted(
        find_equilibrium(system, start=state, max_steps=max_steps, sensitivities=bool(system.n_b))
    )
    if found.outcome.success:
        warn_of_strains("equilibrium", system, found.q[None])
        found = _judged_with_damping(system, found)
    return found


def _judged_with_damping(system: MechanicalSystem, found: Equilibrium) -> Equilibrium:
    """Return an equilibrium whose outcome says if a motion grows with damping and controllers."""
    if system.traits.symmetric or not system.traits.velocity_forces:
        return found
    about = about_states(system, found.q, found.solution.v[0])
    try:
        searched, grows = growth(about, LinearisationPoint(found.q, found.lam))
    except NoModes as error:
        warnings.warn(
            f"equilibrium: stability with damping and controllers is undecided: {error}",
            StabilityWarning,
            stacklevel=3,
        )
        return found
    outcome = replace(found.outcome, growth=grows, growth_searched=searched)
    return replace(found, outcome=outcome)


def critical_load(
    model: Scene | MechanicalSystem,
    parameter: str | DesignVariable,
    to: float,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    progress: bool = False,
) -> CriticalLoad:
    """Return the value of a load, or of another parameter, at which stability is lost.

    Equilibria are followed from the value in the model to `to`, until one has a motion without
    stiffness: a limit point, as of an arch that snaps through, or a bifurcation, as of a column
    that buckles (docs/theory/11-statics.md). The parameter may be any design target: a force, a
    pressure, the position of a driver, an initial strain, a rate of rotation.

    Parameters
    ----------
    model : Scene or MechanicalSystem
        A model in stable equilibrium at its value of the parameter.
    parameter : str or DesignVariable
        A design target such as ``"load.force_y"``, or a variable that drives several targets; for a
        mechanical system one of its `design_names`.
    to : float
        Value of the parameter at which the search ends, in its unit; above or below its value in
        the model.
    design : sequence of str or DesignVariable, optional
        Design variables of the gradient of the critical value, as in `equilibrium`. A mechanical
        system is differentiated in its other design variables.
    progress : bool
        Whether to show a progress bar: the fraction of the way to `to`.

    Returns
    -------
    CriticalLoad
        Warns of beams with too few elements for their curvature at the critical point, or in the
        reference (`CoarseMeshWarning`).

    Raises
    ------
    NoCriticalPointError
        If every equilibrium up to `to` is stable.
    InvalidInputError
        If the model is not in stable equilibrium, two motions lose their stiffness at once, or a
        design variable separates the branches of a bifurcation (an imperfection): the load then
        falls with a root of it and has no derivative.
    Interrupted
        At Ctrl-C; its `result` is the last equilibrium.
    """
    require_flag("progress", progress)
    search = CriticalValue(model, parameter, to, design)
    found = find_critical(search.system, search.index, float(to), progress)
    warn_of_mesh("critical_load", search.system, found.equilibrium.q[None], stacklevel=3)
    return found


@final
@dataclass(frozen=True, eq=False)
class CriticalValue(Objective):
    """The value found by `critical_load`, as an objective together with objectives of a run.

    Its model is in equilibrium and may differ from the model of the run, with other loads. Design
    variables of the same name are shared; the run must have all variables of the model.
    `ComplexStep` uses the same gradient.

    Parameters
    ----------
    model, parameter, to, design
        As in `critical_load`. `to` should be beyond the critical values of all designs: a design
        that is stable up to `to` has no value.
    """

    model: Scene | MechanicalSystem
    parameter: str | DesignVariable
    to: float
    design: Sequence[str | DesignVariable] | None = None

    def __post_init__(self) -> None:
        require_finite("to", self.to)
        if self._name not in self.system.design_names:
            raise UnknownNameError("parameter", self._name, self.system.design_names)

    @property
    def _name(self) -> str:
        parameter = self.parameter
        return parameter.name if isinstance(parameter, DesignVariable) else parameter

    @cached_property
    def system(self) -> MechanicalSystem:
        """System whose equilibria are followed; the parameter is a design variable of it."""
        if not isinstance(self.model, Scene):
            return as_system(self.model, self.design).in_all_states()
        others = require_sequence("design", () if self.design is None else self.design)
        return as_system(self.model, [self.parameter, *others]).in_all_states()

    @property
    def index(self) -> int:
        """Index of the load parameter among the design variables of `system`."""
        return self.system.design_names.index(self._name)

    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Raise UnknownNameError if the run lacks a design variable of the model."""
        for name in self.system.design_names:
            if name not in (self._name, *system.design_names):
                raise UnknownNameError("design of CriticalValue", name, system.design_names)

    def value(
        self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS
    ) -> float | complex:
        """Return the critical value of the load parameter at the design values of the run."""
        value, slopes = self._at(system)
        return value + 1j * float(slopes @ system.b.imag) if np.iscomplexobj(system.b) else value

    def partials(
        self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS
    ) -> ObjectivePartials:
        """Return the critical value and its design gradient; states of the run have no effect."""
        value, slopes = self._at(system)
        return ObjectivePartials(value, None, None, None, slopes)

    def _at(self, system: MechanicalSystem) -> tuple[float, Array]:
        b, slopes = np.array(self.system.b), np.zeros(system.n_b)
        others = np.arange(len(b)) != self.index
        names = np.array(self.system.design_names)[others]
        columns = [system.design_names.index(name) for name in names]
        b[others] = system.b[columns].real
        found = _critical(self, tuple(b))
        slopes[columns] = found.gradient
        return found.value, slopes


@lru_cache(maxsize=4)
def _critical(sought: CriticalValue, b: tuple[float, ...]) -> CriticalLoad:
    """Return the critical load at design values b; cached for value, partials and directions."""
    return find_critical(sought.system.with_values(np.array(b)), sought.index, float(sought.to))


def _require_start_of(system: MechanicalSystem, start: Equilibrium) -> None:
    require_kind("start", start, (Equilibrium,), "Pass what `equilibrium` returned.")
    if (len(start.q), len(start.lam)) != (system.n_q, system.n_lam):
        raise InvalidInputError(
            "start",
            f"must have {system.n_q} coordinates and {system.n_lam} multipliers",
            f"{len(start.q)} and {len(start.lam)}",
            "Start from an equilibrium of the same beams and joints; where other loads act "
            "within a beam, declare Beam(kinks=...).",
        )


def equilibrium_gradient(
    model: Scene | MechanicalSystem,
    observable: Observable,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: GradientMethod | None = None,
    max_steps: int = MAX_STEPS,
) -> Gradient:
    """Return the value of an observable in static equilibrium, and its design gradient.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    observable : Observable
        For example ``position(rod.at_end, 1)`` or ``reaction("pin", 0)``.
    design : sequence of str or DesignVariable
        As in `equilibrium`.
    method : GradientMethod, optional
        `DirectDifferentiation`, `Adjoint`, `FiniteDifference` or `ComplexStep`; by default
        whichever of the first two costs less, see `cheapest`.
    max_steps : int
        Largest number of attempted load steps.

    Raises
    ------
    FreeMotionError
        If a motion has no stiffness.
    UnfinishedRunError
        If there is no equilibrium under the full load; the error says why and has the last one.
    """
    require_count("max_steps", max_steps, _STEPS)
    system = differentiable(model, design)
    objective = Terminal(observable)
    objective.check(system, 0.0)
    chosen = cheapest(system.n_b, 1) if method is None else method
    require_kind(
        "method", chosen, (GradientMethod,), "For example Adjoint() or DirectDifferentiation()."
    )
    if isinstance(chosen, ContinuousAdjoint):
        raise InvalidInputError(
            "method",
            "must be Adjoint, DirectDifferentiation or a perturbation method",
            repr(chosen),
        )
    return chosen.gradients(Run(system, 0.0, Static(max_steps)), [objective])[0]


@final
@dataclass(frozen=True)
class Static(AdjointIntegrator):
    """An integrator that finds the equilibrium, not a motion; its solution has one time point.

    Parameters
    ----------
    max_steps : int
        Largest number of attempted load steps.
    """

    max_steps: int = MAX_STEPS

    def refined(self, solution: Solution) -> Integrator:
        """Raise InvalidInputError: an equilibrium has no error of discretisation in time."""
        rule = "an equilibrium must have no error bar in time"
        raise InvalidInputError("Static", rule, repr(self), "Compare meshes: error_bars(meshes=2).")

    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Return the equilibrium at t = 0 as a solution; `t_end` and `progress` are ignored."""
        return find_equilibrium(
            system, max_steps=self.max_steps, sensitivities=sensitivities
        ).solution

    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient, shape (n_b,), by one transposed solve at the equilibrium."""
        sizes = system.n_q, system.n_q, system.n_lam
        given = zip((seeds.q, seeds.v, seeds.lam), sizes, strict=True)
        on_q, on_v, on_lam = (np.zeros(n) if x is None else np.array(x[0]) for x, n in given)
        on_q = with_states(system, on_q, on_v)
        return Tangent.of(system, solution).pull_back(on_q, on_lam)
