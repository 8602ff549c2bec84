"""Functions in loads of one's own have their slopes; so have whole powers of negative numbers."""

from dataclasses import dataclass

import numpy as np
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


# What loads may call, of components between -1.1 and -0.8.
FUNCTIONS = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": lambda x: np.tan(0.7 * x),
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "arctan": np.arctan,
    "exp": np.exp,
    "log": lambda x: np.log(3.0 + x),
    "sqrt": lambda x: np.sqrt(3.0 + x),
    "square": np.square,
    "reciprocal": np.reciprocal,
    "quotient": lambda x: x / (2.0 - x),
    "difference": lambda x: 1.0 - x,
    "opposite": np.negative,
    "power": lambda x: (3.0 + x) ** 1.7,
}


@dataclass(frozen=True)
class Formed(Load):
    """F = -k f(e), e from the origin to the point, with a function of `FUNCTIONS`."""

    point: MaterialPoint
    k: float
    function: str

    kind = "formed"
    design_fields = (*design_numbers("k"), LAW_FIELD)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION),)

    def force(self, U, V, p, U_o):
        k, _ = self.split(p)
        return -k * FUNCTIONS[self.function](U)


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


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("integrator", [HHT(2.0**-7), Radau(2.0**-5)])
def test_the_gradient_has_the_slope_of_every_function(function, integrator):
    """Values do not show it: Newton's method finds them with a wrong slope, too."""
    k, h = 0.6, 1e-4

    def pulled(k):
        load = Formed(BODY.at(0, 0), k, function, name="pull")
        return Scene([], [], (0, 0), bodies=[BODY], loads=[load])

    def value(k):
        return gradient(pulled(k), END, 0.5, integrator, design=["pull.k"]).value

    difference = (value(k + h) - value(k - h)) / (2 * h)
    for method in (DirectDifferentiation(), Adjoint()):
        found = gradient(pulled(k), END, 0.5, integrator, design=["pull.k"], method=method)
        # Central differences of a motion of 0.1 with a relative error of 1e-13.
        assert found.gradient[0] == pytest.approx(difference, rel=1e-6)


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
