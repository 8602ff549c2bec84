"""Planar shear-deformable beam, 12 coordinates (Omar & Shabana 2001; eqs. 7-8).

Node vectors X = [r_1, r_x1, r_y1, r_2, r_x2, r_y2]. Plane strain of thickness
`width`; the section extends over `height` in y.
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.elements.continuum import ContinuumBeam
from ancfdae.elements.element import ElementParameter, Quantity
from ancfdae.elements.hermite import end_weight, end_weight_xi, slope_weights, slope_weights_xi
from ancfdae.numerics.arrays import Array


@final
class Beam2D(ContinuumBeam):
    """The planar element."""

    name = "BEAM_2D"
    d = 2
    quantities = tuple(Quantity)[:3]
    voigt = ((0, 0), (1, 1), (0, 1))

    def shape(self, points: Array, parameters: Array) -> Array:
        """Eq. (8)."""
        xi, eta = points.T
        h = parameters[:, ElementParameter.HEIGHT, None]
        l = parameters[:, ElementParameter.LENGTH, None]
        s5, (p2, p6), y, one = end_weight(xi), slope_weights(xi), h * eta, np.ones_like(h)
        columns = [one * (1 - s5), l * p2, y * (1 - xi), one * s5, l * p6, y * xi]
        return np.stack(columns, axis=-1)

    def shape_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative of eq. (8)."""
        xi, eta = points.T
        partial = np.zeros((1, len(points), self.n_a))
        if which is ElementParameter.HEIGHT:
            partial[..., 2], partial[..., 5] = eta * (1 - xi), eta * xi
        elif which is ElementParameter.LENGTH:
            partial[..., 1], partial[..., 4] = slope_weights(xi)
        return np.repeat(partial, len(parameters), axis=0)

    def gradient(self, points: Array, parameters: Array) -> Array:
        """Gradient of eq. (7) in x and y."""
        xi, eta = points.T
        h = parameters[:, ElementParameter.HEIGHT, None]
        l = parameters[:, ElementParameter.LENGTH, None]
        N = np.zeros((len(parameters), len(points), self.n_y, 2), dtype=parameters.dtype)
        N[..., 0, 0] = end_weight_xi(xi) / l
        N[..., 1, 0], N[..., 3, 0] = slope_weights_xi(xi)
        N[..., 2, 0], N[..., 4, 0] = -h * eta / l, h * eta / l
        N[..., 2, 1], N[..., 4, 1] = 1 - xi, xi
        return N

    def gradient_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative of `gradient`; only the x column depends on height and length."""
        xi, eta = points.T
        h = parameters[:, ElementParameter.HEIGHT, None]
        l = parameters[:, ElementParameter.LENGTH, None]
        partial = np.zeros((len(parameters), len(points), self.n_y, 2), dtype=parameters.dtype)
        if which is ElementParameter.HEIGHT:
            partial[..., 2, 0], partial[..., 4, 0] = -eta / l, eta / l
        elif which is ElementParameter.LENGTH:
            partial[..., 0, 0] = -end_weight_xi(xi) / l**2
            partial[..., 2, 0], partial[..., 4, 0] = h * eta / l**2, -h * eta / l**2
        return partial


BEAM_2D = Beam2D()
