"""A mass on a spring with a further force, as a system of one's own."""

import numpy as np

from ancfdae.extend import FormulaSystem


class Mass(FormulaSystem):
    """A mass on a spring, q'' = -10 k q + p f(q) - c v, that starts at 0.5."""

    n_q, n_lam, design_names = 1, 0, ("k", "p")

    def __init__(self, f, c=0.0, b=(1.0, 1.0)):
        self.f, self.c = f, c
        super().__init__(b)

    def with_values(self, b):
        return Mass(self.f, self.c, b)

    def start(self):
        return np.array([0.5]), np.array([0.0])

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return [-10 * self.b[0] * q[0] + self.b[1] * self.f(q[0]) - self.c * v[0]]

    def position_constraint(self, t, q):
        return np.zeros(0, dtype=q.dtype)
