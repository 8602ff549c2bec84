"""Shapes of rigid bodies of one density: what gives their mass and moments."""

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import require_kind, require_positive
from ancfdae.model.design import Designable
from ancfdae.numerics.arrays import Array


class BodyShape(Designable, abc.ABC):
    """A solid that is symmetric to the planes of its axes, so that these are principal ones.

    In a planar scene it is the same solid, seen along z.
    """

    @abc.abstractmethod
    def moments(self, p: Array) -> tuple[Array, Array]:
        """Return the volume, and the means of x^2, y^2 and z^2 over it, shape (3,).

        `p` has the values of `parameters`; complex ones must go through.
        """

    def __post_init__(self) -> None:
        self.check_fields(type(self).__name__)


def require_shape(where: str, value: object) -> None:
    """Refuse what is no shape."""
    require_kind(where, value, (BodyShape,), "For example RigidBox(0.2, 0.1, 0.05).")


@final
@dataclass(frozen=True)
class RigidBox(BodyShape):
    """A cuboid: `length` along x, `height` along y, `width` along z; m, all design targets."""

    length: float
    height: float
    width: float

    design_fields = tuple((name, require_positive) for name in ("length", "height", "width"))

    def moments(self, p: Array) -> tuple[Array, Array]:
        """Means a^2 / 12."""
        return p[0] * p[1] * p[2], p * p / 12


@final
@dataclass(frozen=True)
class RigidCylinder(BodyShape):
    """A cylinder about z, a disc in the plane: `radius` and `length` along z; m, design targets."""

    radius: float
    length: float

    design_fields = tuple((name, require_positive) for name in ("radius", "length"))

    def moments(self, p: Array) -> tuple[Array, Array]:
        """Means r^2 / 4 across the axis, l^2 / 12 along it."""
        across = p[0] ** 2 / 4
        return np.pi * p[0] ** 2 * p[1], np.stack([across, across, p[1] ** 2 / 12])


@final
@dataclass(frozen=True)
class RigidSphere(BodyShape):
    """A ball: `radius`; m, a design target."""

    radius: float

    design_fields = (("radius", require_positive),)

    def moments(self, p: Array) -> tuple[Array, Array]:
        """Means r^2 / 5."""
        return 4 / 3 * np.pi * p[0] ** 3, np.repeat(p**2 / 5, 3)
