"""The end time as a design variable."""

import numpy as np
import pytest
import scipy

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    AdaptiveSteps,
    Adjoint,
    AtTimes,
    Beam,
    ComplexStep,
    DirectDifferentiation,
    EndEvent,
    FiniteDifference,
    Impact,
    Integral,
    Material,
    Pin,
    PrescribedSteps,
    Radau,
    Responses,
    RigidBody,
    Scene,
    SmoothMaximum,
    Terminal,
    gradient,
    gradients,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import custom, elapsed_time, position, velocity
from ancfdae.sections import Rectangle
from tests.support.balls import BOUNCE, HEIGHT, Ball, ball_by_hand

EXACT = (DirectDifferentiation(), Adjoint(), ComplexStep())
SPEED = custom(lambda t, q, v, lam, b: v[:, 0], "speed")


@pytest.mark.parametrize("integrator", [HHT(0.05), Radau(0.1), DOP853(1e-11), IDA(1e-10)])
def test_derivatives_in_the_end_time_are_rates_at_the_end(integrator):
    # Free fall until 0.7 s; an integral changes by its integrand, the mean by what it misses.
    ball = Ball((5.0, -0.1, 10.0, 0.8))
    objectives = [Terminal(HEIGHT), Terminal(SPEED * elapsed_time()), Integral(SPEED)]
    objectives += [AtTimes(HEIGHT, [0.3])]
    v = -0.1 - 10 * 0.7
    exact = [v, v - 10 * 0.7, v, 0.0]
    methods = EXACT if isinstance(integrator, HHT | Radau) else EXACT[:1]
    for method in methods:
        found = gradients(ball, objectives, 0.7, integrator, design=["t_end"], method=method)
        assert found[0].names[-1] == "t_end"
        np.testing.assert_allclose([x.gradient[-1] for x in found], exact, atol=1e-8)


def flexible_rod():
    material = Material(1000, 2e8, 0.3, damping_time=1e-3)
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.03, 0.03), material)
    return rod, Scene([rod], [Pin(rod.at_start)], gravity=(0, -9.81))


def test_end_time_beside_other_variables_of_a_flexible_rod():
    # 99.5 steps, so that differences have the same number of them.
    rod, scene = flexible_rod()
    objectives = [
        Terminal(position(rod.at_end, 1) * elapsed_time()),
        Integral(velocity(rod.at_end, 1) ** 2),
        SmoothMaximum(position(rod.at(0.5), 0), 50.0),
    ]
    by_method = [
        gradients(
            scene, objectives, 0.199, HHT(step=2e-3), design=["t_end", "rod.height"], method=method
        )
        for method in (*EXACT, FiniteDifference(1e-6, central=True))
    ]
    for direct, adjoint, stepped, differences in zip(*by_method, strict=True):
        assert direct.names == ("rod.height", "t_end")
        size = np.max(np.abs(direct.gradient))
        for other, bound in ((adjoint, 1e-10), (stepped, 1e-10), (differences, 1e-6)):
            np.testing.assert_allclose(other.gradient, direct.gradient, atol=bound * size)


def test_end_time_counts_after_events_and_not_where_one_ends_the_run():
    ball = Ball()
    found = gradient(ball, Terminal(HEIGHT), 3.2, HHT(0.05), design=["t_end"], events=[BOUNCE])
    rate = (ball_by_hand(3.2 + 1e-6, ball.b) - ball_by_hand(3.2 - 1e-6, ball.b)) / 2e-6
    assert found.gradient[-1] == pytest.approx(rate, rel=1e-7)
    end = EndEvent(HEIGHT - 1.0, -1)
    for method in EXACT:
        found = gradient(
            ball, Terminal(SPEED), 3.2, HHT(0.05), design=["t_end"], events=[end], method=method
        )
        assert found.gradient[-1] == 0.0


def test_least_time_of_a_fall_to_a_height():
    # From 5 m at -0.1 m/s, to 2 m: 5 t^2 + 0.1 t = 3.
    ball = Ball((5.0, -0.1, 10.0, 0.8))
    asked = {"time": Terminal(elapsed_time()), "height": Terminal(HEIGHT)}
    r = Responses(ball, asked, 0.5, HHT(0.02), design=["t_end"])
    assert r.design_names[-1] == "t_end"
    start = r.start
    low, high = np.append(start[:-1], 0.01), np.append(start[:-1], 2.0)
    found = scipy.optimize.minimize(
        r["time"], start, jac=r["time"].gradient, bounds=scipy.optimize.Bounds(low, high),
        constraints=r.constraint("height", 2.0, 2.0), method="SLSQP", options={"ftol": 1e-14},
    )  # fmt: skip
    assert found.x[-1] == pytest.approx((-0.1 + np.sqrt(0.01 + 60)) / 10, rel=1e-9)


def test_derivative_in_the_end_time_reaches_a_tolerance():
    rod, scene = flexible_rod()
    tip = Terminal(position(rod.at_end, 1))
    found = gradient(scene, tip, 0.2, design=["t_end"], tolerance=1e-3)
    assert found.accuracy.reached
    speed = simulate(scene, 0.2, HHT(1e-4)).velocity(rod.at_end)[-1, 1]
    assert found.gradient[0] == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize("method", EXACT)
def test_the_end_time_alone_is_a_design_of_a_run_with_impacts(method):
    # Free fall from 1 m, and up again at half the speed: the rate of the height at 0.6 s.
    body = RigidBody("body", (0, 1.0), mass=1.0, inertia=0.1)
    height, scene = position(body.at(0, 0), 1), Scene([], [], (0, -10.0), bodies=[body])
    call = Terminal(height), 0.6, HHT(0.01)
    found = gradient(scene, *call, design=["t_end"], events=[Impact(height, 0.5)], method=method)
    fall = 0.2**0.5
    up = 10 * fall / 2 - 10 * (0.6 - fall)
    assert found.gradient == pytest.approx([up], rel=1e-10)


@pytest.mark.parametrize("t_end", [0.6, 0.6001, 0.61])
@pytest.mark.parametrize("time", [0.555, 0.3, 0.0071])
def test_a_value_at_a_time_between_steps_does_not_depend_on_the_design(t_end, time):
    body = RigidBody("body", (0, 1.0), mass=1.0, inertia=0.1)
    read = AtTimes(position(body.at(0, 0), 1), time)
    scene = Scene([], [], (0, -10.0), bodies=[body])
    for design in (["body.position_y"], ["body.position_y", "t_end"]):
        found = gradient(scene, read, t_end, HHT(0.01), design=design)
        # A cubic, and HHT, have no error in a parabola.
        assert found.value == pytest.approx(1 - 5 * time**2, rel=1e-12)
        assert found.gradient == pytest.approx([1.0, 0.0][: len(design)], abs=1e-10)


def test_messages_name_the_end_time_where_there_are_no_events():
    body = RigidBody("body", (0, 1.0), mass=1.0, inertia=0.1)
    scene, read = Scene([], [], (0, -10.0), bodies=[body]), Terminal(position(body.at(0, 0), 1))
    with pytest.raises(InvalidInputError, match="t_end in the design"):
        gradient(scene, read, 0.6, HHT(PrescribedSteps((0.0, 0.3, 0.6))), design=["t_end"])
    along = HHT(AdaptiveSteps(1e-5, sensitivities=True))
    with pytest.raises(InvalidInputError, match=r"of the motion alone.*t_end in the design"):
        gradient(scene, read, 0.6, along, design=["body.mass", "t_end"])
    with pytest.raises(InvalidInputError, match="t_end in the design"):
        gradient(scene, read, 0.6, DOP853(1e-8), design=["t_end"], method=Adjoint())
