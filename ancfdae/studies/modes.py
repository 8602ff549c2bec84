"""Calls for natural frequencies and shapes, and for a step that follows them."""

from collections.abc import Sequence

from ancfdae.equations import MechanicalSystem
from ancfdae.errors import require_count, require_flag, require_kind, require_positive
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.modes import Configuration, Modes, StepSuggestion, modes_about, suggestion
from ancfdae.sensitivity.adjoint import Adjoint
from ancfdae.sensitivity.direct import Direct
from ancfdae.statics import Equilibrium
from ancfdae.studies.calls import as_system
from ancfdae.studies.mode_places import place


def modes(
    model: Scene | MechanicalSystem,
    count: int = 6,
    *,
    at: Configuration | Equilibrium | None = None,
    design: Sequence[str | DesignVariable] | None = None,
    damped: bool | None = None,
    highest: bool = False,
    method: Direct | Adjoint | None = None,
) -> Modes:
    """Return natural frequencies and shapes of small motions about a configuration at rest.

    Joints are kept exactly; those that are driven are held.

    Parameters
    ----------
    count : int
        How many; modes that coincide are not separated, so there may be a few more.
    at : Equilibrium or Configuration, optional
        Where: what `equilibrium` found, or coordinates and multipliers, for example
        ``Configuration.of(solution, instant)`` of a motion that has come to rest. By default the
        start of the model, at rest, with the multipliers that hold it best; if forces there are
        not in balance these are the modes of a motion that is held there, and the result says so.
    design : sequence of str or DesignVariable, optional
        Design variables of a scene to differentiate in; a mechanical system has its own.
    damped : bool, optional
        Whether velocity forces count; by default if there are any.
    highest : bool
        Whether the highest modes are wanted instead of the lowest.
    method : Direct or Adjoint, optional
        How frequencies are differentiated: `Direct` (default) with the shapes, `Adjoint` by one
        transposed solve for each mode, independent of the number of design variables.

    Lowest first: growing motions (of an unstable equilibrium), rigid ones (s = 0), then vibrations
    by frequency.

    Raises
    ------
    InvalidInput
        If the input makes no sense, or `at` is an instant of a motion, such as a steady rotation.
    """
    require_count("count", count, "Ask for one or more modes.")
    require_flag("highest", highest)
    if method is not None:
        require_kind("method", method, (Direct, Adjoint), "Direct() or Adjoint().")
    system = as_system(model, design)
    where = place(system, at)
    if system.n_b and isinstance(method, Adjoint):
        at, pull_back = where.configuration(False), where.pull_back
        return modes_about(system, at, count, highest, damped, pull_back)
    return modes_about(system, where.configuration(system.n_b > 0), count, highest, damped, None)


def suggest_step(
    model: Scene | MechanicalSystem,
    per_period: float = 20.0,
    *,
    follow: int | None = 6,
    at: Configuration | Equilibrium | None = None,
) -> StepSuggestion:
    """Return a step that resolves the vibrations of a model, and its shortest and longest period.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    per_period : float
        Steps in the shortest period that counts; HHT-I3 errs by about (2 pi / per_period)^2 / 8 of
        a turn in each, / 12 with ``hht_alpha=0``.
    follow : int, optional
        How many motions count, from the slowest; None for all of them. Waves through the sections
        of stiff beams are thousands of times faster than what one wants to see.
    at : Configuration, optional
        As in `modes`.

    Raises
    ------
    InvalidInput
        If the input makes no sense or nothing vibrates.
    """
    require_positive("per_period", per_period)
    if follow is not None:
        require_count("follow", follow, "Follow one motion or more, or None for all.")
    system = as_system(model)
    return suggestion(system, place(system, at).configuration(False), per_period, follow)
