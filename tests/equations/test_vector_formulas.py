"""NumPy's functions in the formulas of loads: they do what NumPy does, or are refused in words."""

from dataclasses import make_dataclass

import numpy as np
import pytest

from ancfdae import DOP853, HHT, RigidBody, Scene, Terminal, gradient, simulate
from ancfdae.errors import InvalidInputError
from ancfdae.extend import (
    LAW_FIELD,
    ExternalFunction,
    Load,
    MaterialPoint,
    Quantity,
    concatenate,
    design_numbers,
    dot,
)
from ancfdae.observables import position
from tests.support.jets import Jet


def pair(formula):
    """A load on two points of two bodies, 1 m apart, of mass 1, by a formula of U and k."""

    def vectors(self, elements):
        return tuple((point, Quantity.POSITION) for point in self.points)

    def force(self, U, V, p, U_o):
        return formula(U, self.split(p)[0])

    made = {
        "kind": "pair",
        "design_fields": (*design_numbers("k"), LAW_FIELD),
        "vectors": vectors,
        "force": force,
    }
    settings = [("point", MaterialPoint), ("other", MaterialPoint), ("k", float)]
    cls = make_dataclass("Pair", settings, bases=(Load,), namespace=made, frozen=True)
    left = RigidBody("l", (0.0, 0.3), mass=1.0, inertia=0.1)
    right = RigidBody("r", (0.6, -0.5), mass=1.0, inertia=0.1)
    load = cls(left.at(0, 0), right.at(0, 0), 3.0, name="pair")
    return Scene([], [], bodies=[left, right], loads=[load]), left


def ends(U):
    return U[..., 0, :], U[..., 1, :]


GOOD = {
    "stack": lambda U, k: np.stack(
        [-k * (U[..., 0, :] - U[..., 1, :]), k * (U[..., 0, :] - U[..., 1, :])], axis=-2
    ),
    "concatenate": lambda U, k: np.concatenate(
        [-k * (U[..., :1, :] - U[..., 1:, :]), k * (U[..., :1, :] - U[..., 1:, :])], axis=-2
    ),
    "own": lambda U, k: concatenate(
        [-k * (U[..., :1, :] - U[..., 1:, :]), k * (U[..., :1, :] - U[..., 1:, :])]
    ),
    "sum": lambda U, k: k * (np.sum(U, axis=-2, keepdims=True) - 2 * U),
}


@pytest.mark.parametrize("name", GOOD)
def test_forces_on_two_points_are_joined_as_arrays_are(name):
    """A spring of no length between two masses: x = (1 - cos(sqrt(2 k) t))/2 of the way."""
    scene, left = pair(GOOD[name])
    found = gradient(
        scene, Terminal(position(left.at(0, 0), 0)), 0.5, HHT(2.0**-10), design=["pair.k"]
    )
    w = 6.0**0.5
    assert found.value == pytest.approx(0.6 * (1 - np.cos(w * 0.5)) / 2, abs=1e-6)
    # dw/dk = 1/w.
    assert found.gradient[0] == pytest.approx(0.6 * np.sin(w * 0.5) * 0.5 / 2 / w, rel=1e-5)


SQUARE = ExternalFunction(lambda s: s**2, lambda s: 2 * s)
BAD = {
    "external": (lambda U, k: SQUARE(U), "FormulaSystem"),
    "array": (lambda U, k: np.array(ends(U)), "np.stack"),
    "list": (lambda U, k: list(ends(U)), "np.stack"),
    "norm": (lambda U, k: U / np.linalg.norm(U), "np.sqrt"),
    "outer": (lambda U, k: np.outer([1.0, -1.0], U[0]), "arithmetic"),
    "dot": (lambda U, k: U * np.dot(U[0], U[1]), "dot and cross"),
    "abs": (lambda U, k: np.abs(U), "x\\*\\*2"),
    "where": (lambda U, k: np.where(U > 0, U, 0.0), "Use arithmetic"),
}


@pytest.mark.parametrize("name", BAD)
def test_other_functions_are_refused_in_words(name):
    formula, remedy = BAD[name]
    scene, _ = pair(formula)
    with pytest.raises(InvalidInputError, match=remedy) as refused:
        simulate(scene, 0.1, HHT(0.01))
    assert "object at" not in str(refused.value)
    assert "in time" not in str(refused.value)


def test_jets_are_joined_with_their_rates():
    t = Jet(np.array([[2.0, 3.0]]), np.array([[1.0, 0.5]]))
    both = np.concatenate([t * t, np.ones((1, 2))], axis=-2)
    np.testing.assert_array_equal(both.derivatives[0], [[4, 9], [1, 1]])
    np.testing.assert_array_equal(both.derivatives[1], [[4, 3], [0, 0]])
    length = np.sqrt(dot(t, t))
    assert length.derivatives[1] == pytest.approx((2 * 1 + 3 * 0.5) / 13**0.5)
    # The angle of (2, 3) turns by (x y' - y x')/r^2.
    turned = np.arctan2(t[:, 1:], t[:, :1])
    assert turned.derivatives[1] == pytest.approx((2 * 0.5 - 3 * 1) / 13)


def test_many_stops_are_printed_short():
    many = DOP853(1e-6, stops=tuple(np.linspace(0.1, 1, 400).tolist()))
    assert repr(many).endswith("stops=<400 from 0.1 to 1>)")
    assert len(repr(many)) < 120
    few = DOP853(1e-6, stops=(0.5,))
    assert eval(repr(few)) == few
