"""Which motions every kind of joint lets through, between sections in space."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ancfdae import (
    Clamp,
    Cylindrical,
    PlanarJoint,
    Prismatic,
    Revolute,
    RotationDriver,
    TranslationDriver,
    Universal,
    Weld,
)
from ancfdae.extend import MaterialPoint
from ancfdae.laws import ConstantAcceleration

HERE, THERE = MaterialPoint("rod", 0.3), MaterialPoint("arm", 1.0)
T, SPEED = 0.7, 1.9
ANGLE = SPEED * T
# Sections of the reference: normal and axes of section as columns.
FRAMES = {
    "aligned": (Rotation.identity(), Rotation.identity()),
    "square": (Rotation.identity(), Rotation.from_rotvec([0.0, 0.0, np.pi / 2])),
    "skew": (Rotation.from_rotvec([0.3, 0.9, -0.4]), Rotation.from_rotvec([-1.1, 0.2, 0.5])),
}
X, Y, Z = np.eye(3)
OBLIQUE = np.array([0.5, 0.6, -0.7]) / np.linalg.norm([0.5, 0.6, -0.7])


@dataclass
class Case:
    """A joint, and how the section of the point moves against what it is joined to."""

    joint: object
    turn: object = lambda rng: Rotation.identity()
    slide: object = lambda rng: np.zeros(3)
    freedoms: int = 0


def about(axis):
    return lambda rng: Rotation.from_rotvec(rng.uniform(-np.pi, np.pi) * axis)


def along(*directions):
    return lambda rng: rng.uniform(-1, 1, len(directions)) @ np.array(directions)


def cross(axis, other):
    """Turn about the axis that the section carries, then about the one of the other."""
    return lambda rng: about(other)(rng) * about(axis)(rng)


def across(axis):
    return np.linalg.svd(axis[None])[2][1:]


def cases(frame, other):
    """Cases whose axes lie in the section of the point, along its normal, or obliquely."""
    n, y, _ = frame.as_matrix().T
    ends = {"ground": None} if other is None else {"section": THERE}
    carried = THERE if other is not None else None
    (end,) = ends
    found = {}
    for name, axis in {"in": y, "along": n, "oblique": OBLIQUE}.items():
        a = tuple(axis)
        both = {
            "revolute": Case(Revolute(HERE, a, carried), about(axis), freedoms=1),
            "cylindrical": Case(Cylindrical(HERE, a, carried), about(axis), along(axis), 2),
            "plane": Case(PlanarJoint(HERE, a, carried), about(axis), along(*across(axis)), 3),
            "prismatic": Case(Prismatic(HERE, a, carried), slide=along(axis), freedoms=1),
            "drive": Case(
                RotationDriver(HERE, ConstantAcceleration(SPEED), a, carried),
                lambda rng, axis=axis: Rotation.from_rotvec(ANGLE * axis),
                along(X, Y, Z),
                5,
            ),
        }
        second = across(axis)[0]
        both["universal"] = Case(
            Universal(HERE, a, tuple(second), carried), cross(axis, second), freedoms=2
        )
        found |= {f"{kind}, {name}, {end}": case for kind, case in both.items()}
    if carried is None:
        found["clamp"] = Case(Clamp(HERE))
    else:
        found["weld"] = Case(Weld(HERE, THERE))
        found["guide"] = Case(
            TranslationDriver(HERE, tuple(OBLIQUE), ConstantAcceleration(SPEED), THERE),
            lambda rng: Rotation.random(random_state=rng),
            lambda rng: ANGLE * OBLIQUE + along(*across(OBLIQUE))(rng),
            5,
        )
    return found


MOTIONS = [
    pytest.param(case, frame, other, id=f"{layout}: {name}")
    for layout, (frame, other) in FRAMES.items()
    for held in (None, other)
    for name, case in cases(frame, held).items()
]
