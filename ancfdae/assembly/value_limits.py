"""Limits of the values that a scene admits for each design variable, such as E > 0."""

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array

# Trial values on one side of zero, over the size of a variable. If a sign is required, every value
# is rejected; values rejected for another reason, such as two coinciding points, are isolated.
_BEYOND = (1e-6, 0.37, 1.0, 2.9)
# Limits of Poisson's ratio, outside which a material has no positive moduli.
_POISSON = (-1.0, 0.5)


def value_limits(scene: Scene, design: tuple[DesignVariable, ...], b: Array) -> tuple[Array, Array]:
    """Return lower and upper limits of the values b, shape (n_b,); infinite without a limit.

    A limit holds whatever the other variables are: zero for a positive or non-negative parameter,
    and the limits of Poisson's ratio.
    """
    pairs = zip(design, b.tolist(), strict=True)
    lower, upper = np.transpose([_limits(scene, variable, value) for variable, value in pairs])
    return lower, upper


def _limits(scene: Scene, variable: DesignVariable, value: float) -> tuple[float, float]:
    parameters = {scene.resolve(text).parameter for text in variable.targets}
    if "poisson_ratio" in parameters and not variable.shares:
        return _POISSON
    size = abs(value) or 1.0
    negative, positive = (
        not any(_fits(scene, variable, sign * part * size) for part in _BEYOND) for sign in (-1, 1)
    )
    return (0.0 if negative else -np.inf, 0.0 if positive else np.inf)


def _fits(scene: Scene, variable: DesignVariable, value: float) -> bool:
    try:
        scene.refuse_values({variable: value})
    except InvalidInputError:
        return False
    return True
