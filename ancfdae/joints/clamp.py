"""Clamp: position and all slopes of a section are held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point
from ancfdae.joints.joint import SECTION, Coefficients, Joint, empty_coefficients
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Clamp(Joint):
    """Hold a section of a beam to ground as it is in the reference configuration.

    The constraints are r = r_o and r_k = r_ok for every slope vector: the section neither
    moves, nor turns, nor deforms.

    Parameters
    ----------
    point : Point
    name : str, optional
        By default ``clamp(beam@fraction)``.
    """

    point: Point
    name: str = ""

    takes_part = SECTION
    kind = "clamp"
    holds_position = True

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """U_i - U_i(reference)."""
        n, d = reference.shape
        c = empty_coefficients(n * d, p, reference)
        rows, axes = np.arange(n * d), np.arange(n * d) % d
        c.linear[rows, rows // d, axes] = 1.0
        c.offset[:] = reference.ravel()
        return c
