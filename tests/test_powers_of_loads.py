"""Whole powers of negative numbers in loads of one's own: complex steps go through them."""

from dataclasses import dataclass

import pytest

from ancfdae import (
    HHT,
    Adjoint,
    DirectDifferentiation,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    assemble,
    gradient,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import LAW_FIELD, Load, MaterialPoint, Quantity, design_numbers
from ancfdae.observables import position


@dataclass(frozen=True)
class Power(Load):
    """F = -k (e_x^n, e_y^n), e from the origin to the point."""

    point: MaterialPoint
    k: float
    n: float = 2.0

    kind = "power"
    design_fields = (*design_numbers("k"), LAW_FIELD)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION),)

    def force(self, U, V, p, U_o):
        k, _ = self.split(p)
        return -k * U**self.n


BODY = RigidBody("body", (-1.0, -0.9), mass=1.0, inertia=0.1)
END = Terminal(position(BODY.at(0, 0), 0))


def pulled(k, n):
    load = Power(BODY.at(0, 0), k, n, name="pull")
    return Scene([], [], (0, 0), bodies=[BODY], loads=[load])


@pytest.mark.parametrize("n", [2.0, 3.0, -1.0, -2.0, 70.0])
@pytest.mark.parametrize("integrator", [HHT(2.0**-7), Radau(2.0**-5)])
def test_the_gradient_is_the_limit_of_differences(n, integrator):
    """A load of U**2 with U < 0 had a gradient of 1e24 with success."""
    k, h = 0.3, 1e-4

    def value(k):
        return gradient(pulled(k, n), END, 0.25, integrator, design=["pull.k"]).value

    difference = (value(k + h) - value(k - h)) / (2 * h)
    assert abs(difference) > 1e-3
    for method in (DirectDifferentiation(), Adjoint()):
        found = gradient(pulled(k, n), END, 0.25, integrator, design=["pull.k"], method=method)
        assert found.gradient[0] == pytest.approx(difference, rel=1e-5)


@dataclass(frozen=True)
class Pull(Load):
    """One force for two points, which has no opposite."""

    point: MaterialPoint
    other: MaterialPoint
    k: float

    kind = "pull"
    design_fields = (*design_numbers("k"), LAW_FIELD)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION), (self.other, Quantity.POSITION))

    def force(self, U, V, p, U_o):
        return -p[0] * (U[..., 0, :] - U[..., 1, :])


def test_one_force_for_two_points_is_refused():
    """Broadcasting would let one force act on both points without its opposite."""
    other = RigidBody("other", (1.0, 0.2), mass=2.0, inertia=0.1)
    load = Pull(BODY.at(0, 0), other.at(0, 0), 3.0, name="pull")
    with pytest.raises(InvalidInputError, match="pull': must have the shape"):
        assemble(Scene([], [], (0, 0), bodies=[BODY, other], loads=[load]))
