"""Joints of sections: which motions they let through, and what of a section they hold.

The coefficients of a joint are evaluated on vectors made by hand: sections in rigid motion by
SciPy's rotations, sheared against their centre line, or stretched.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ancfdae import (
    Cylindrical,
    PlanarJoint,
    Prismatic,
    TranslationDriver,
)
from ancfdae.model.parts import Elements
from tests.support.examples import coefficients_of
from tests.support.joint_motions import HERE, MOTIONS, THERE, T

# Sums of a dozen products of vectors of length one, which come from inverses of condition one.
ROUND_OFF = 2e-14


class Pose:
    """A joint in its reference, and in an admissible rigid motion of both sides."""

    def __init__(self, case, frame, other, seed=3):
        self.joint = case.joint
        rng = np.random.default_rng(seed)
        self.kinds = self.joint.vectors(Elements(3, {}))
        place = rng.uniform(-1, 1, 3)
        relative = getattr(self.joint, "other", None) is not None
        # The reference: both points at the same place.
        self.frames = {HERE: frame, THERE: other}
        self.reference = np.array(
            [place if k == 0 else self.frames[p].as_matrix()[:, k - 1] for p, k in self.kinds]
        )
        carrier = Rotation.random(random_state=rng) if relative else Rotation.identity()
        shift = rng.uniform(-1, 1, 3) if relative else np.zeros(3)
        turn, slide = case.turn(rng), case.slide(rng)
        self.turns = {HERE: carrier * turn, THERE: carrier}
        self.places = {HERE: place + shift + carrier.apply(slide), THERE: place + shift}
        self.now = self.rigid(self.places, self.turns)
        p = np.array(list(self.joint.parameters().values()))
        self.c = coefficients_of(self.joint, p, self.reference, T)
        self.own = len(self.c.offset) - len(self.c.shapes)

    def rigid(self, places, turns):
        return np.array(
            [
                places[p] if k == 0 else (turns[p] * self.frames[p]).as_matrix()[:, k - 1]
                for p, k in self.kinds
            ]
        )

    def Phi(self, U):
        c = self.c
        quadratic = np.einsum("rij,ix,jx->r", c.bilinear, U, U) / 2
        return np.einsum("rix,ix->r", c.linear, U) + quadratic - c.offset

    def rate(self, V):
        c = self.c
        return np.einsum("rix,ix->r", c.linear, V) + np.einsum(
            "rij,ix,jx->r", c.bilinear, self.now, V
        )

    def change(self, point, of):
        """Vectors of a point that change: `of` gives the change of a vector by its quantity."""
        return np.array(
            [
                of(int(k), U) if p is point else np.zeros(3)
                for (p, k), U in zip(self.kinds, self.now, strict=True)
            ]
        )

    def rigid_rates(self):
        """Rates of Phi for translations and rotations of each point's section, (rows, 6 or 12)."""
        motions = [
            self.change(point, motion)
            for point in self.joint.points
            for e in np.eye(3)
            for motion in (
                lambda k, U, e=e: e * (k == 0),
                lambda k, U, e=e: np.cross(e, U) * (k > 0),
            )
        ]
        return np.array([self.rate(motion) for motion in motions]).T


every_case = pytest.mark.parametrize(("case", "frame", "other"), MOTIONS)


@every_case
def test_admissible_motions_of_rigid_sections_satisfy_a_joint(case, frame, other):
    for seed in range(3):
        pose = Pose(case, frame, other, seed)
        assert np.max(np.abs(pose.Phi(pose.now))) <= ROUND_OFF


@every_case
def test_a_joint_leaves_the_freedoms_that_it_should(case, frame, other):
    pose = Pose(case, frame, other)
    rates = pose.rigid_rates()
    own, shapes = rates[: pose.own], rates[pose.own :]
    values = np.linalg.svd(own, compute_uv=False)
    assert len(values) == pose.own == 6 - case.freedoms
    assert values[-1] > 0.05
    # In rigid motion shapes say nothing that the others do not.
    rest = shapes - shapes @ np.linalg.pinv(own) @ own
    assert np.max(np.abs(rest), initial=0.0) <= ROUND_OFF


@every_case
def test_equations_and_shapes_of_a_joint_are_independent(case, frame, other):
    pose = Pose(case, frame, other)
    n = pose.now.size
    columns = [pose.rate(e.reshape(pose.now.shape)) for e in np.eye(n)]
    assert np.linalg.svd(np.array(columns).T, compute_uv=False)[-1] > 0.05


@every_case
def test_a_joint_holds_sections_by_themselves(case, frame, other):
    """No force on what shears the centre line against a section or stretches the section.

    But where the shear is held: then the sum with what holds it counts.
    """
    pose = Pose(case, frame, other)
    square = [(a.beam, a.fraction) for a in pose.c.shapes if 1 in a.slopes]
    for point in pose.joint.points:
        if (point.beam, point.fraction) in square:
            continue
        for e in np.eye(3):
            rate = pose.rate(pose.change(point, lambda k, U, e=e: e * (k == 1)))
            assert np.max(np.abs(rate)) <= ROUND_OFF
        if isinstance(pose.joint, Cylindrical | TranslationDriver | PlanarJoint | Prismatic):
            continue  # stretched directions times the distance are no turn
        for stretched in (2, 3):
            rate = pose.rate(pose.change(point, lambda k, U, s=stretched: U * (k == s)))
            assert np.max(np.abs(rate)) <= ROUND_OFF
