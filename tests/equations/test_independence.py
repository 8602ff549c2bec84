"""Whether constraints are independent: seen from factors where that is clear."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Pin,
    Revolute,
    RigidBody,
    RigidBox,
    Scene,
    Spherical,
    assemble,
    simulate,
)
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors import RedundantConstraintsError
from ancfdae.extend import FormulaSystem
from tests.support.scenes import STEEL, THICK

LENGTH = 0.2


def chain(bodies, *more):
    """A chain of hinges, with further joints made from the bars."""
    box = RigidBox(LENGTH, 0.02, 0.02)
    bars = [
        RigidBody(f"bar {i}", ((i + 0.5) * LENGTH, 0, 0), shape=box, density=1000)
        for i in range(bodies)
    ]
    ends = [None, *(bar.at(LENGTH / 2) for bar in bars)]
    joints = [
        Revolute(bar.at(-LENGTH / 2), (0, 1, 0), end) for bar, end in zip(bars, ends, strict=False)
    ]
    return assemble(Scene(bodies=bars, joints=[*joints, *(make(bars) for make in more)]))


def test_a_long_chain_is_accepted_without_a_decomposition(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("decomposed")

    system = chain(40)
    monkeypatch.setattr(np.linalg, "svd", refuse)
    assert saddle_point(system, 0.0).size == system.n_q + system.n_lam


@pytest.mark.parametrize("joint", [Revolute, Spherical])
def test_a_joint_that_a_long_chain_has_already_is_named(joint):
    def twice(bars):
        sides = bars[20].at(-LENGTH / 2), bars[19].at(LENGTH / 2)
        axis = [(0, 1, 0)] if joint is Revolute else []
        return joint(sides[0], *axis, sides[1], name="twice")

    rows = 5 if joint is Revolute else 3
    with pytest.raises(RedundantConstraintsError, match=rf"'twice'.*{rows} redundant") as told:
        saddle_point(chain(24, twice), 0.0)
    assert "'bar 3" not in str(told.value)


class Touching(FormulaSystem):
    """A mass on y = 1 and on y = 1 + x^2/2: the curves touch at x = 0, where rows are dependent."""

    n_q, n_lam = 3, 2
    design_names = ("m",)
    constraint_names = ("line", "parabola")

    def __init__(self, x, b=(1.0,)):
        self.x = x
        super().__init__(np.asarray(b))

    def mass_matrix(self, q):
        return self.b[0] * np.eye(3)

    def force(self, t, q, v):
        return np.array([0.0, -9.81, 0.0]) * self.b[0]

    def position_constraint(self, t, q):
        return np.array([q[1] - 1.0, q[1] - 1.0 - 0.5 * q[0] ** 2])

    def start(self):
        return np.array([self.x, 1.0, 0.0]), np.zeros(3)

    def with_values(self, b):
        return Touching(self.x, b)


@pytest.mark.parametrize("x", [0.0, 1e-5])
def test_a_start_that_is_projected_onto_dependent_constraints_is_refused(x):
    """At x = 1e-5 m the rows are independent and open by 5e-11 m only; closing them leads to 0."""
    with pytest.raises(RedundantConstraintsError, match="'line', 'parabola'"):
        simulate(Touching(x), 0.1, HHT(0.01))


def triangle(height):
    """Two bars on three pins: the joints hold them, twice over where the pins lie in a line."""
    left = Beam("left", (0, 0), (0.3, height), 1, THICK, STEEL, rigid=True)
    right = Beam("right", (0.3, height), (0.6, 0), 1, THICK, STEEL, rigid=True)
    joints = [Pin(left.at_start), Pin(left.at_end, right.at_start), Pin(right.at_end)]
    return assemble(Scene([left, right], joints), ["left.density", "left.damping_time"])


def test_constraints_are_checked_again_where_their_numbers_change():
    """Of one system: at another place, and with other masses, by the scale of a new assembly."""
    system, flat = triangle(0.1), triangle(0.0).start()[0]
    first = saddle_point(system, 0.0)
    with pytest.raises(RedundantConstraintsError, match="1 redundant"):
        saddle_point(system, 0.0, flat)
    assert saddle_point(system.with_values(np.add(system.b, [0.0, 1e-3])), 0.0) is first
    heavier = system.with_values(system.b * [4.0, 1.0])
    scale = saddle_point(heavier, 0.0).scale
    half = np.flatnonzero(system.weights != heavier.weights)
    np.testing.assert_allclose(scale[half], first.scale[half] / 2, rtol=1e-12)
    assert len(half) == 6
