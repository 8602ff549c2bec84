"""The warning of meshes that are too coarse, for calls of any kind."""

import warnings

from ancfdae.equations.system import MechanicalSystem
from ancfdae.errors.kinds import CoarseMeshWarning
from ancfdae.errors.text import listed
from ancfdae.numerics.arrays import Array


def warn_of_mesh(
    call: str, system: MechanicalSystem, states: Array, stacklevel: int, moving: bool = False
) -> None:
    """Warn of beams that have too few elements for their curvature in states, rows of q."""
    coarse = system.coarse(states, moving)
    if not coarse:
        return
    worst = max(coarse.values())
    warnings.warn(
        f"{call}: too few elements for the bending of {listed(map(repr, coarse))}: "
        f"{100 * worst / (1 + worst):.2g} % of the energy is an error of the mesh. Values err by "
        "one to six times as much, derivatives by up to twenty-five times. Double the number of "
        "elements until this warning is gone.",
        CoarseMeshWarning,
        stacklevel=stacklevel,
    )
