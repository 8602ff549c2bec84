"""Logarithmic derivatives of values at rest, by the package."""

from collections.abc import Sequence

import numpy as np

from ancfdae import (
    Adjoint,
    DesignVariable,
    DirectDifferentiation,
    Scene,
    assemble,
    equilibrium_gradient,
)
from ancfdae.extend import Observable
from validation.literature.tables import Array, relative

__all__ = ["log_derivatives"]


def log_derivatives(
    scene: Scene,
    observable: Observable,
    design: Sequence[str | DesignVariable],
    adjoint: bool = True,
) -> tuple[Array, float]:
    """Return d ln(observable)/d ln(b) by direct differentiation, and how far the adjoint is off.

    Parameters
    ----------
    scene : Scene
    observable : Observable
    design : sequence of str or DesignVariable
        The variables b; none may be zero.
    adjoint : bool
        Whether to run the adjoint too.
    """
    system = assemble(scene, design)
    direct = equilibrium_gradient(system, observable, method=DirectDifferentiation())
    computed: Array = direct.gradient * system.b.real / direct.value
    if not adjoint:
        return computed, 0.0
    other = equilibrium_gradient(system, observable, method=Adjoint()).gradient
    return computed, float(np.max(relative(other, direct.gradient)))
