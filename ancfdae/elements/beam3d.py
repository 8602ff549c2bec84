"""Spatial fully parameterised beam, 24 coordinates (Yakoub & Shabana 2001).

Node vectors X = [r_1, r_x1, r_y1, r_z1, r_2, r_x2, r_y2, r_z2]. The section
extends over `height` in y and `width` in z.
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.elements.continuum import ContinuumBeam
from ancfdae.elements.element import ElementParameter, Quantity
from ancfdae.elements.hermite import end_weight, end_weight_xi, slope_weights, slope_weights_xi
from ancfdae.numerics.arrays import Array


@final
class Beam3D(ContinuumBeam):
    """The spatial element."""

    name = "BEAM_3D"
    d = 3
    quantities = tuple(Quantity)
    voigt = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))

    def shape(self, points: Array, parameters: Array) -> Array:
        """Shape functions s_1 to s_8 (docs/theory.md, section 1)."""
        xi, eta, zeta = points.T
        h = parameters[:, ElementParameter.HEIGHT, None]
        w = parameters[:, ElementParameter.WIDTH, None]
        l = parameters[:, ElementParameter.LENGTH, None]
        s5, (p2, p6), one = end_weight(xi), slope_weights(xi), np.ones_like(h)
        y, z = h * eta, w * zeta
        first = [one * (1 - s5), l * p2, y * (1 - xi), z * (1 - xi)]
        second = [one * s5, l * p6, y * xi, z * xi]
        return np.stack(first + second, axis=-1)

    def shape_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative of `shape`."""
        xi, eta, zeta = points.T
        partial = np.zeros((1, len(points), self.n_a))
        if which is ElementParameter.HEIGHT:
            partial[..., 2], partial[..., 6] = eta * (1 - xi), eta * xi
        elif which is ElementParameter.WIDTH:
            partial[..., 3], partial[..., 7] = zeta * (1 - xi), zeta * xi
        elif which is ElementParameter.LENGTH:
            partial[..., 1], partial[..., 5] = slope_weights(xi)
        return np.repeat(partial, len(parameters), axis=0)

    def gradient(self, points: Array, parameters: Array) -> Array:
        """Gradient of `shape` in x, y and z."""
        xi, eta, zeta = points.T
        h = parameters[:, ElementParameter.HEIGHT, None]
        w = parameters[:, ElementParameter.WIDTH, None]
        l = parameters[:, ElementParameter.LENGTH, None]
        N = np.zeros((len(parameters), len(points), self.n_y, 3), dtype=parameters.dtype)
        N[..., 0, 0] = end_weight_xi(xi) / l
        N[..., 1, 0], N[..., 4, 0] = slope_weights_xi(xi)
        N[..., 2, 0], N[..., 5, 0] = -h * eta / l, h * eta / l
        N[..., 3, 0], N[..., 6, 0] = -w * zeta / l, w * zeta / l
        N[..., 2, 1], N[..., 5, 1] = 1 - xi, xi
        N[..., 3, 2], N[..., 6, 2] = 1 - xi, xi
        return N

    def gradient_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative of `gradient`; only the x column depends on the parameters."""
        xi, eta, zeta = points.T
        h = parameters[:, ElementParameter.HEIGHT, None]
        w = parameters[:, ElementParameter.WIDTH, None]
        l = parameters[:, ElementParameter.LENGTH, None]
        partial = np.zeros((len(parameters), len(points), self.n_y, 3), dtype=parameters.dtype)
        if which is ElementParameter.HEIGHT:
            partial[..., 2, 0], partial[..., 5, 0] = -eta / l, eta / l
        elif which is ElementParameter.WIDTH:
            partial[..., 3, 0], partial[..., 6, 0] = -zeta / l, zeta / l
        elif which is ElementParameter.LENGTH:
            partial[..., 0, 0] = -end_weight_xi(xi) / l**2
            partial[..., 2, 0], partial[..., 5, 0] = h * eta / l**2, -h * eta / l**2
            partial[..., 3, 0], partial[..., 6, 0] = w * zeta / l**2, -w * zeta / l**2
        return partial


BEAM_3D = Beam3D()
