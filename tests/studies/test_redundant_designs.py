"""A parallelogram with three cranks: derivatives in its geometry, with an equation left out.

One crank alone cannot change its length: the mechanism locks, and the motion has no derivative. All
three together can; the coupler then moves on a circle of the new radius.
"""

import numpy as np
import pytest
import scipy

from ancfdae import (
    DOP853,
    HHT,
    Adjoint,
    DesignVariable,
    DirectDifferentiation,
    Distance,
    Pin,
    RigidBody,
    Scene,
    Terminal,
    drop_redundant,
    gradient,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import position

LENGTH, CRANK, COUPLER, GRAVITY, END = 1.0, 1.0, 2.0, (1.0, -9.81), 0.8
INERTIA, COUNT = 0.1, 3


def parallelogram(links: bool = False) -> Scene:
    """Return a coupler on three cranks, which are bodies or massless links."""
    coupler = RigidBody("coupler", (1.0, LENGTH), mass=COUPLER, inertia=1.0)
    bodies, joints = [coupler], list[Pin | Distance]()
    for k in range(COUNT):
        at = coupler.at(k - 1.0, 0.0)
        if links:
            joints.append(Distance(at, LENGTH, ground=(float(k), 0.0), name=f"link{k}"))
            continue
        crank = RigidBody(f"crank{k}", (float(k), 0.5), mass=CRANK, inertia=INERTIA)
        bodies.append(crank)
        joints.append(Pin(crank.at(0, -0.5), ground=(float(k), 0.0), name=f"bearing{k}"))
        joints.append(Pin(crank.at(0, 0.5), at, name=f"tip{k}"))
    return drop_redundant(Scene([], joints, GRAVITY, bodies=bodies))


def place_of_coupler(length: float, links: bool = False) -> float:
    """Return x of the coupler at the end, by the angle of the cranks alone."""
    mass = COUPLER if links else COUPLER + COUNT * (INERTIA + CRANK / 4) / length**2
    arm = COUPLER if links else COUPLER + COUNT * CRANK / 2 / length

    def rates(t, y):
        pull = GRAVITY[0] * np.cos(y[0]) - GRAVITY[1] * np.sin(y[0])
        return [y[1], arm * pull / (mass * length)]

    run = scipy.integrate.solve_ivp(rates, (0, END), [0.0, 0.0], rtol=1e-12, atol=1e-13)
    return float(1 + length * np.sin(run.y[0, -1]))


@pytest.mark.parametrize("target", ["tip2.point_y", "tip2.other_x", "bearing1.ground_x"])
def test_the_change_of_one_link_is_refused(target: str) -> None:
    scene = parallelogram()
    x = Terminal(position(scene.bodies[0].at(0, 0), 0))
    for method in (DirectDifferentiation(), Adjoint()):
        with pytest.raises(InvalidInputError, match=target):
            gradient(scene, x, END, HHT(2**-6), method=method, design=["coupler.mass", target])


def test_the_change_of_all_links_has_the_derivative_of_one_coordinate() -> None:
    scene = parallelogram()
    x = Terminal(position(scene.bodies[0].at(0, 0), 0))
    length = DesignVariable("length", tuple(f"tip{k}.point_y" for k in range(COUNT)))
    found = gradient(scene, x, END, DOP853(1e-11), design=[length])
    np.testing.assert_allclose(found.value, place_of_coupler(LENGTH), rtol=1e-9)
    h = 1e-4
    slope = (place_of_coupler(LENGTH + h) - place_of_coupler(LENGTH - h)) / (2 * h)
    np.testing.assert_allclose(found.gradient, slope, rtol=1e-6)


def test_a_link_among_three_is_left_out() -> None:
    scene = parallelogram(links=True)
    assert len(scene.left_out) == 1
    x = Terminal(position(scene.bodies[0].at(0, 0), 0))
    length = DesignVariable("length", tuple(f"link{k}.length" for k in range(COUNT)))
    found = gradient(scene, x, END, DOP853(1e-11), design=[length])
    np.testing.assert_allclose(found.value, place_of_coupler(LENGTH, True), rtol=1e-9)
    h = 1e-4
    slope = (place_of_coupler(LENGTH + h, True) - place_of_coupler(LENGTH - h, True)) / (2 * h)
    np.testing.assert_allclose(found.gradient, slope, rtol=1e-6)
    with pytest.raises(InvalidInputError, match="link"):
        gradient(scene, x, END, HHT(2**-6), design=["link0.length", "link1.length"])
