"""A system beside its start, and complex steps of its values: what tests of partials share.

Complex steps have no truncation error: STEP^2 vanishes against one.
"""

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
        scale = 1.0 / np.where(system.b == 0, 1.0, system.b)
        self.q_b, self.v_b, self.a_b = rng.uniform(-1, 1, (3, system.n_q, system.n_b)) * scale
        self.t, self._moved = 0.3, {}

    def moved(self, i):
        """The system with an imaginary step in one design variable, and the step; kept."""
        if i not in self._moved:
            size = STEP * self.unit(i)
            b = self.system.b.astype(complex)
            b[i] += 1j * size
            self._moved[i] = self.system.with_values(b), size
        return self._moved[i]

    def by_design(self, value):
        """Complex step of value(system, i, size) in every design variable, as a last axis."""
        columns = []
        for i in range(self.system.n_b):
            system, size = self.moved(i)
            columns.append(np.imag(value(system, i, 1j * size)) / size)
        return np.stack(columns, axis=-1)

    def noise(self, name):
        """Round-off of accelerations and multipliers where the bodies are not strained.

        A start by rigid motions leaves forces that are round-off, and so are their derivatives:
        of Q in the norm of the weights `force_round_off`, in single numbers by the least and the
        largest weight. Factor 10 for the solve, and for coordinates that move by more than 1 m.
        """
        weights, Q = self.system.weights, 10 * self.system.traits.force_round_off
        sizes = {"a": Q / np.sqrt(np.min(weights)), "lam": Q * np.sqrt(np.max(weights))}
        return sizes.get(name, 0.0)

    def unit(self, i):
        """Size of a design variable, one where it is zero."""
        return abs(self.system.b[i]) or 1.0

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
        """Compare column by column: design variables have units of their own.

        `magnitude` is the size of the differentiated quantity, the scale where the exact
        derivative vanishes, and `noise` that of its round-off.
        """
        system = self.system
        if not system.n_b:
            assert partial.shape[-1] == 0
            return
        expected = self.by_design(value)
        assert partial.shape == expected.shape
        for i in range(system.n_b):
            scale = max(np.max(np.abs(expected[..., i])), magnitude / self.unit(i))
            allowed = tolerance * scale + noise / self.unit(i)
            assert np.max(np.abs(partial[..., i] - expected[..., i])) <= allowed, (
                system.design_names[i]
            )
