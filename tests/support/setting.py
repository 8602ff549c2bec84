"""A system beside its start, and complex steps of its values: what tests of partials share.

Complex steps have no truncation error: STEP^2 vanishes against one.
"""

import functools
import inspect

import numpy as np

from ancfdae import (
    assemble,
)
from tests.support.scenes import SCENES

STEP = 1e-40
# Two evaluations of one derivative differ by round-off: sums over up to 432 quadrature points and
# 28 entries of g, with terms a few hundred times the result (the cancellation in the strain,
# about 1e-1, and in the product rule): 1e3 eps = 2e-13, five times that is allowed.
DERIVATIVE = 1e-12
# Values against the oracle: sums as above without the product rule, and a reference that was
# turned into the direction of the beam (a few eps more).
VALUE = 3e-13


def concrete_subclasses(base):
    found = set()
    for kind in base.__subclasses__():
        found |= concrete_subclasses(kind)
        # Only public classes of the package: other tests may define some of their own.
        public = kind.__module__.startswith("ancfdae.") and not kind.__name__.startswith("_")
        if not inspect.isabstract(kind) and public:
            found.add(kind)
    return found


def assert_close(value, expected, tolerance):
    scale = np.max(np.abs(expected))
    assert scale > 0
    assert np.shape(value) == np.shape(expected)
    assert np.max(np.abs(value - expected)) <= tolerance * scale


class MeasuredSetting:
    """A system with a random state beside its start and random design derivatives of it."""

    def __init__(self, scene, design):
        self.scene = SCENES[scene]() if isinstance(scene, str) else scene
        self.design = design
        self.system = assemble(self.scene, design)
        system, rng = self.system, np.random.default_rng(3)
        self.q = system.start()[0] + 0.05 * rng.uniform(-1, 1, system.n_q)
        self.v, self.a = rng.uniform(-1, 1, (2, system.n_q))
        self.lam = rng.uniform(-1, 1, system.n_lam)
        self.units = np.where(system.b == 0, 1.0, np.abs(system.b))
        self.q_b, self.v_b, self.a_b = rng.uniform(-1, 1, (3, system.n_q, system.n_b)) / self.units
        #: A direction of the design, and how the states move along it.
        self.b_along = rng.uniform(0.5, 1, system.n_b) * rng.choice([-1, 1], system.n_b)
        self.b_along *= self.units
        self.along = tuple(x_b @ self.b_along for x_b in (self.q_b, self.v_b, self.a_b))
        self.t = 0.3

    @functools.cached_property
    def moved(self):
        """The system with an imaginary step along the direction of the design."""
        return self.system.with_values(self.system.b + 1j * STEP * self.b_along)

    def noise(self, name):
        """Round-off of accelerations and multipliers where the bodies are not strained.

        A start by rigid motions leaves forces that are round-off, and so are their derivatives:
        of Q in the norm of the weights `force_round_off`, in single numbers by the least and the
        largest weight. Factor 10 for the solve, and for coordinates that move by more than 1 m.
        """
        weights, Q = self.system.weights, 10 * self.system.traits.force_round_off
        sizes = {"a": Q / np.sqrt(np.min(weights)), "lam": Q * np.sqrt(np.max(weights))}
        return sizes.get(name, 0.0)

    def by_coordinate(self, value, state=None):
        """Complex step of value(q), or of value of another state, as a last axis."""
        state = self.q if state is None else state
        columns = []
        for k in range(self.system.n_q):
            q = state.astype(complex)
            q[k] += 1j * STEP
            columns.append(np.imag(value(q)) / STEP)
        return np.stack(columns, axis=-1)

    def check_design(self, partial, value, magnitude, tolerance=DERIVATIVE, noise=0.0):
        """Compare a partial along the direction of the design with a step of value(system, e).

        `magnitude` is the size of the differentiated quantity, the scale where the exact
        derivative vanishes, and `noise` that of its round-off.
        """
        expected = np.imag(value(self.moved, 1j * STEP)) / STEP
        assert partial.shape == (*expected.shape, self.system.n_b)
        changes = partial * self.b_along
        sizes = np.max(np.abs(changes), axis=tuple(range(partial.ndim - 1)), initial=0.0)
        allowed = tolerance * max(np.sum(sizes), magnitude) + noise * self.system.n_b
        error = np.max(np.abs(np.sum(changes, axis=-1) - expected), initial=0.0)
        assert error <= allowed, (error, allowed, dict(zip(self.design, sizes, strict=True)))
