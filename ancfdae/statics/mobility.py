"""Motions of a mechanism that nothing holds, in words."""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.equations import Naming
from ancfdae.errors import InvalidInput
from ancfdae.errors.text import listed
from ancfdae.numerics.arrays import Array


@final
class FreeMechanism(InvalidInput):
    """A system without an equilibrium because nothing holds a motion, which the message names."""


def free_mechanism(naming: Naming | None, q: Array, motions: Array) -> FreeMechanism:
    """Return the error for motions, shape (n_q, k), that nothing holds at q."""
    return FreeMechanism(
        "equilibrium",
        "every motion must be held by a joint, a stiffness or the weight",
        f"a mechanism that is free to move: {motions_in_words(naming, q, motions)}",
        "Add a joint, a spring or gravity, or simulate the motion.",
    )


def motions_in_words(naming: Naming | None, q: Array, motions: Array) -> str:
    """Say what moves, and how, in motions without stiffness, shape (n_q, k)."""
    if naming is not None:
        return naming.motions_in_words(q, motions)
    share = np.sqrt(np.sum(motions**2, axis=1))
    moving = np.flatnonzero(share > 0.1 * np.max(share))
    return "motion of " + listed(f"coordinate {i + 1}" for i in moving)
