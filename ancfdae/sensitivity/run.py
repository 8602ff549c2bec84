"""The two calls that a user needs: simulate, differentiate."""

from __future__ import annotations

from collections.abc import Sequence

from ancfdae.design import DesignVariable
from ancfdae.errors import InvalidInput
from ancfdae.integrators import Integrator
from ancfdae.scene import Scene
from ancfdae.sensitivity.contract import Method
from ancfdae.sensitivity.direct import Direct
from ancfdae.solution import Solution
from ancfdae.system import MechanicalSystem, assemble


def simulate(
    model: Scene | MechanicalSystem, t_end: float, integrator: Integrator, *, progress: bool = False
) -> Solution:
    """Integrate a scene, or any mechanical system, from t = 0 to `t_end`.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    t_end : float
        End time; s.
    integrator : Integrator
        For example ``HHT(step=2**-7)``.
    progress : bool
        Whether to show a progress bar.

    Raises
    ------
    InvalidInput
        If the input makes no sense; before anything is integrated.
    """
    return integrator.integrate(as_system(model, ()), t_end, progress=progress)


def differentiate(
    model: Scene | MechanicalSystem,
    design: Sequence[str | DesignVariable],
    t_end: float,
    integrator: Integrator,
    method: Method | None = None,
    *,
    progress: bool = False,
) -> Solution:
    """Integrate and differentiate the whole trajectory in the design variables.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    design : sequence of str or DesignVariable
        For a scene, targets such as ``"pendulum.youngs_modulus"``; empty for a mechanical
        system, which brings its own design variables.
    t_end : float
        End time; s.
    integrator : Integrator
    method : Method
        `Direct` (default), `FiniteDifference` or `ComplexStep`.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Solution
        With `sensitivities`.

    Raises
    ------
    InvalidInput
        If the input makes no sense; before anything is integrated.
    """
    system = as_system(model, design)
    return (method or Direct()).differentiate(system, t_end, integrator, progress)


def as_system(
    model: Scene | MechanicalSystem, design: Sequence[str | DesignVariable]
) -> MechanicalSystem:
    """Assemble a scene; a mechanical system is passed through.

    Raises
    ------
    InvalidInput
        If design variables are named for a mechanical system, or the model is neither.
    """
    if isinstance(model, Scene):
        return assemble(model, design)
    if not isinstance(model, MechanicalSystem):
        raise InvalidInput(
            "model", "must be a Scene or a MechanicalSystem", repr(model), "Pass one."
        )
    if design:
        raise InvalidInput(
            "design",
            "a mechanical system brings its own design variables",
            list(design),
            "Pass an empty sequence.",
        )
    return model
