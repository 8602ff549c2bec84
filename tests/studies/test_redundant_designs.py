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
    FiniteDifference,
    Pin,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    drop_redundant,
    equilibrium,
    gradient,
    modes,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import position
from ancfdae.results import Verdict

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


def test_designs_at_which_equations_left_out_open_are_refused():
    machine = parallelogram(links=True)
    other = machine.with_values({"link1.length": 1.02 * LENGTH})
    for call in (
        lambda: simulate(other, END, HHT(0.02)),
        lambda: simulate(other, END, DOP853(1e-8)),
        lambda: modes(other),
        lambda: equilibrium(other),
    ):
        with pytest.raises(InvalidInputError, match=r"joint 'link\d' open by"):
            call()
    cost = Terminal(position(machine.bodies[0].origin, 0))
    with pytest.raises(InvalidInputError, match="open by"):
        gradient(
            machine, cost, END, HHT(0.02), design=["link1.length"], method=FiniteDifference(1e-3)
        )
    assert simulate(machine, END, HHT(0.02)).outcome.success


@pytest.mark.parametrize("integrator", [HHT(0.01), Radau(0.05), DOP853(1e-8), HHT(rtol=1e-4)])
def test_a_run_ends_where_an_equation_left_out_opens(integrator):
    """Three links that close where they start, and nowhere else: the third has another ground."""
    coupler = RigidBody("coupler", (1.0, LENGTH), mass=COUPLER, inertia=1.0)
    links = [
        Distance(coupler.at(k - 1.0, 0.0), LENGTH, ground=(float(k), 0.0), name=f"link{k}")
        for k in range(2)
    ]
    third = Distance(coupler.at(1.0, 0.0), LENGTH / 2, ground=(2.0, LENGTH / 2), name="link2")
    scene = Scene([], [*links, third], GRAVITY, bodies=[coupler], left_out=[("link2", 0)])
    run = simulate(scene, END, integrator)
    assert run.outcome.verdict is Verdict.OPENED
    assert "'link2' open by" in str(run.outcome)
    assert run.t[-1] < 0.2
