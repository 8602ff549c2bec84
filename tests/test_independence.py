"""Whether constraints are independent: seen from factors where that is clear."""

import numpy as np
import pytest

from ancfdae import Revolute, RigidBody, RigidBox, Scene, Spherical, assemble
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors import RedundantConstraintsError

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
