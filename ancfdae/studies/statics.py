"""Calls at rest: an equilibrium, and the gradient of what is observed there."""

from collections.abc import Sequence

from ancfdae.equations import MechanicalSystem
from ancfdae.errors import (
    InvalidInput,
    UnknownName,
    require_count,
    require_finite,
    require_kind,
    require_sequence,
    uninterrupted,
)
from ancfdae.integrators import Static
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.sensitivity.continuous_adjoint import ContinuousAdjoint
from ancfdae.sensitivity.method import Gradient, GradientMethod, Run
from ancfdae.sensitivity.objectives import Terminal
from ancfdae.sensitivity.observables import Observable
from ancfdae.statics import (
    MAX_STEPS,
    CriticalLoad,
    Equilibrium,
    find_critical,
    find_equilibrium,
)
from ancfdae.studies.calls import as_system, cheapest, differentiable

_STEPS = "For example 100."


def equilibrium(
    model: Scene | MechanicalSystem,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    start: Equilibrium | None = None,
    max_steps: int = MAX_STEPS,
) -> Equilibrium:
    """Find the state of rest under all loads at t = 0, and its design derivatives.

    The search follows the path of equilibria from the start of the model while the load grows; a
    mechanism that only its weight holds settles under the full load (docs/theory/11-statics.md).

    Parameters
    ----------
    model : Scene or MechanicalSystem
    design : sequence of str or DesignVariable, optional
        For a scene: what to differentiate in; `q_b` and `lam_b` of the result. A mechanical
        system has its own design variables.
    start : Equilibrium, optional
        Of the same model under other loads or at another design: the search starts from there.
    max_steps : int
        Attempted steps of the load.

    Returns
    -------
    Equilibrium
        A load that cannot be carried is reported by `outcome`, and what was carried is kept.

    Raises
    ------
    FreeMechanism
        If nothing holds a motion; the message names it.
    InvalidInput
        If the input makes no sense, or a joint drives a motion at t = 0 (a law with a rate there).
    Interrupted
        At Ctrl-C; its `result` is what was found up to there.
    """
    require_count("max_steps", max_steps, _STEPS)
    system = as_system(model, design)
    if start is not None:
        _require_start_of(system, start)
    return uninterrupted(
        find_equilibrium(system, start=start, max_steps=max_steps, sensitivities=bool(system.n_b))
    )


def critical_load(
    model: Scene | MechanicalSystem,
    parameter: str | DesignVariable,
    to: float,
    *,
    design: Sequence[str | DesignVariable] | None = None,
) -> CriticalLoad:
    """Find the value of a load, or of another parameter, at which stability is lost.

    From the value that it has in the model to another, equilibria are followed until one meets a
    motion without stiffness: a limit point, as of an arch that snaps through, or a bifurcation, as
    of a column that buckles (docs/theory/11-statics.md). The parameter may be any design target: a
    force, a pressure, the place of a drive, an initial strain, a rate of rotation.

    Parameters
    ----------
    model : Scene or MechanicalSystem
        In stable equilibrium at the value that the parameter has in it.
    parameter : str or DesignVariable
        A design target such as ``"load.force_y"``, or a variable that drives several; of a
        mechanical system one of its `design_names`.
    to : float
        Where the search ends. Its sense is that of the load.
    design : sequence of str or DesignVariable, optional
        As in `equilibrium`: what to differentiate the critical value in. A mechanical system is
        differentiated in its other design variables.

    Returns
    -------
    CriticalLoad

    Raises
    ------
    NoCriticalPoint
        If every equilibrium up to `to` is stable.
    InvalidInput
        If the model is not in stable equilibrium, two motions lose their stiffness at once, or a
        design variable parts the paths of a bifurcation: the load then falls with a root of it and
        has no derivative.
    Interrupted
        At Ctrl-C; its `result` is the last equilibrium.
    """
    require_finite("to", to)
    name = parameter.name if isinstance(parameter, DesignVariable) else parameter
    if isinstance(model, Scene):
        design = [parameter, *require_sequence("design", () if design is None else design)]
    system = as_system(model, design)
    if name not in system.design_names:
        raise UnknownName("parameter", name, system.design_names)
    return find_critical(system, system.design_names.index(name), float(to))


def _require_start_of(system: MechanicalSystem, start: Equilibrium) -> None:
    require_kind("start", start, (Equilibrium,), "Pass what `equilibrium` returned.")
    if (len(start.q), len(start.lam)) != (system.n_q, system.n_lam):
        raise InvalidInput(
            "start",
            f"must have {system.n_q} coordinates and {system.n_lam} multipliers",
            f"{len(start.q)} and {len(start.lam)}",
            "Start from an equilibrium of the same beams and joints; where other loads act "
            "within a beam, declare Beam(kinks=...).",
        )


def static_gradient(
    model: Scene | MechanicalSystem,
    observable: Observable,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: GradientMethod | None = None,
    max_steps: int = MAX_STEPS,
) -> Gradient:
    """Return an observable at the equilibrium, and its design gradient.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    observable : Observable
        For example ``position(rod.at_end, 1)`` or ``reaction("pin", 0)``.
    design : sequence of str or DesignVariable
        As in `equilibrium`.
    method : GradientMethod, optional
        `Direct`, `Adjoint`, `FiniteDifference` or `ComplexStep`; by default whichever of the
        first two costs less, see `cheapest`.
    max_steps : int
        Attempted steps of the load.

    Raises
    ------
    FreeMechanism
        If nothing holds a motion.
    UnfinishedRun
        If there is no equilibrium under the full load; the error states why and keeps the rest.
    """
    require_count("max_steps", max_steps, _STEPS)
    system = differentiable(model, design)
    objective = Terminal(observable)
    objective.check(system, 0.0)
    chosen = cheapest(system.n_b, 1) if method is None else method
    require_kind("method", chosen, (GradientMethod,), "For example Adjoint() or Direct().")
    if isinstance(chosen, ContinuousAdjoint):
        raise InvalidInput("method", "must be one for an equilibrium", repr(chosen), "Use Adjoint.")
    return chosen.gradients(Run(system, 0.0, Static(max_steps)), [objective])[0]
