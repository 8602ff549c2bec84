"""Bouncing balls, with their motion and its derivatives by hand."""

import numpy as np

from ancfdae import (
    Impact,
)
from ancfdae.extend import FormulaSystem
from ancfdae.observables import (
    custom,
)


class Ball(FormulaSystem):
    """A ball that falls on a floor at z = 0."""

    n_q, n_lam = 1, 0
    design_names = ("z0", "v0", "g", "restitution")

    def __init__(self, b=(5.0, -0.1, 10.0, 0.8)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return self.b[:1] * 1, self.b[1:2] * 1

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return -self.b[2:3]

    def position_constraint(self, t, q):
        return np.zeros(0)


def height(t, q, v, lam, b):
    return q[:, 0]


def of_design(t, q, v, lam, b):
    return b[3] + 0 * t


HEIGHT, RESTITUTION = custom(height, "height"), custom(of_design, "restitution")


BOUNCE = Impact(HEIGHT, RESTITUTION)


def ball_by_hand(t, b):
    """Height at t from the flights between impacts, in numbers of any kind."""
    z0, v0, g, e = b
    speed = (v0 * v0 + 2 * g * z0) ** 0.5
    landed = (v0 + speed) / g
    if t <= landed:
        return z0 + v0 * t - g * t * t / 2
    up = e * speed
    while t > landed + 2 * up / g:
        landed, up = landed + 2 * up / g, e * up
    return up * (t - landed) - g * (t - landed) ** 2 / 2


def slopes_by_hand(t, b):
    steps = 1e-30j * np.eye(len(b))
    return np.array([np.imag(ball_by_hand_complex(t, np.array(b) + x)) / 1e-30 for x in steps])


def ball_by_hand_complex(t, b):
    """The same with the number of impacts of the real part."""
    z0, v0, g, e = b
    speed = np.sqrt(v0 * v0 + 2 * g * z0)
    landed = (v0 + speed) / g
    if t <= landed.real:
        return z0 + v0 * t - g * t * t / 2
    up = e * speed
    while t > (landed + 2 * up / g).real:
        landed, up = landed + 2 * up / g, e * up
    return up * (t - landed) - g * (t - landed) ** 2 / 2
