"""Bodies that come to rest where forces balance each other, against closed forms.

At rest on a spring or a floor the sum of all forces vanishes, and with it what corrections of
Newton's method are measured against. The place of rest and its derivatives are those of statics.
"""

from typing import Any

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Contact,
    Plane,
    RigidBody,
    Scene,
    SpringDamper,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom, position

MASS, GRAVITY, STIFFNESS, DAMPING = 2.0, 9.81, 1e3, 90.0


def hanging(length: float = 1.0, place: float = 0.0, stiffness: float = STIFFNESS) -> Scene:
    """Return a body that hangs on a damped spring; `length` is the metre in units of the scene."""
    x = place * length
    body = RigidBody("body", (x, x - length), mass=MASS, inertia=0.01 * length**2)
    spring = SpringDamper(body.at(0, 0), stiffness, DAMPING, length, ground=(x, x), name="spring")
    return Scene([], [], (0, -GRAVITY * length), bodies=[body], loads=[spring])


@pytest.mark.parametrize("integrator", [HHT(1e-2), HHT(1e-3), HHT(1e-2, hht_alpha=-0.3)])
@pytest.mark.parametrize(("length", "place"), [(1.0, 0.0), (1e3, 0.0), (1.0, 1e3), (1.0, -1.0)])
def test_a_body_on_a_spring_comes_to_rest(integrator: HHT, length: float, place: float) -> None:
    scene = hanging(length, place)
    run = simulate(scene, 3.0, integrator)
    assert run.outcome.success, run.outcome
    sag = MASS * GRAVITY * length / STIFFNESS
    height = place * length - length - sag
    np.testing.assert_allclose(run.q[-1, 1], height, rtol=0, atol=1e-12 * length * (1 + abs(place)))
    assert np.abs(run.v[-1]).max() < 1e-10 * length * (1 + abs(place))


@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e6])
def test_the_place_of_rest_has_the_derivative_of_statics(stiffness: float) -> None:
    scene = hanging(stiffness=stiffness)
    height = Terminal(position(scene.bodies[0].at(0, 0), 1))
    found = gradient(scene, height, 10.0, HHT(2e-3), design=["spring.stiffness", "body.mass"])
    expected = np.array([MASS * GRAVITY / stiffness**2, -GRAVITY / stiffness])
    np.testing.assert_allclose(found.gradient, expected, rtol=1e-8)


class _Hanging(FormulaSystem):
    """The same as a system of one's own; u is the place below the end of the unstretched spring."""

    n_q, n_lam = 1, 0
    design_names = ("stiffness",)

    def __init__(self, b: Any = (STIFFNESS,)) -> None:
        super().__init__(b)

    def with_values(self, b: Any) -> "_Hanging":
        return _Hanging(b)

    def start(self) -> Any:
        return np.zeros(1), np.zeros(1)

    def mass_matrix(self, q: Any) -> Any:
        return MASS * np.eye(1)

    def force(self, t: float, q: Any, v: Any) -> Any:
        return MASS * GRAVITY - self.b[0] * q - DAMPING * v

    def position_constraint(self, t: float, q: Any) -> Any:
        return np.zeros(0)


@pytest.mark.parametrize("step", [1e-2, 1e-3])
def test_a_system_of_ones_own_comes_to_rest(step: float) -> None:
    end = Terminal(custom(lambda t, q, v, lam, b: q[:, 0]))
    found = gradient(_Hanging(), end, 3.0, HHT(step))
    np.testing.assert_allclose(found.value, MASS * GRAVITY / STIFFNESS, rtol=1e-12)
    np.testing.assert_allclose(found.gradient, -MASS * GRAVITY / STIFFNESS**2, rtol=1e-9)


@pytest.mark.parametrize("drop", [1e-4, 1e-2])
@pytest.mark.parametrize("integrator", [HHT(1e-2), HHT(1e-3), HHT(rtol=1e-5)])
def test_a_ball_comes_to_rest_on_a_floor(drop: float, integrator: HHT) -> None:
    stiffness, radius = 1e6, 0.1
    ball = RigidBody("ball", (0, radius + drop), mass=MASS, inertia=0.008)
    floor = Contact(
        ball.at(0, 0),
        Plane((0, 0), (0, 1)),
        stiffness=stiffness,
        radius=radius,
        restitution=0.2,
        impact_speed=1.0,
        name="floor",
    )
    scene = Scene([], [], (0, -GRAVITY), bodies=[ball], loads=[floor])
    run = simulate(scene, 2.0, integrator)
    assert run.t[-1] == 2.0, run.outcome
    height = radius - (MASS * GRAVITY / stiffness) ** (2 / 3)
    np.testing.assert_allclose(run.q[-1, 1], height, rtol=1e-9)
