"""A locomotive with three cranks at angles, of which no choice of equations is regular."""

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

from ancfdae import (
    Bushing,
    InitialVelocity,
    Pin,
    Radau,
    RigidBody,
    Scene,
    assemble,
    drop_redundant,
    simulate,
)
from ancfdae.integrators.prescribed_motion import lock

RADIUS, MASS, ROD, INERTIA, SPIN, G = 0.3, 0.5, 1.0, 0.01, 15.0, 9.81
BEARINGS = np.array([[0.0, 0.0], [1.0, 0.0], [0.4, 0.5]])


def locomotive() -> Scene:
    """Return three equal cranks, turning at SPIN, and the rod that their tips share."""
    arm = RADIUS * np.array([np.cos(1.0), np.sin(1.0)])
    across = RADIUS * SPIN * np.array([-np.sin(1.0), np.cos(1.0)])
    rod = RigidBody("rod", tuple(arm), mass=ROD, inertia=0.1)
    bodies, joints, start = [rod], [], [InitialVelocity("rod", 0.0, (0, 0), velocity=tuple(across))]
    for k, place in enumerate(BEARINGS):
        # The body stands in the middle of the crank, its axes along x and y.
        crank = RigidBody(f"crank{k}", tuple(place + arm / 2), mass=MASS, inertia=INERTIA)
        tip = crank.at(*(arm / 2))
        joints += [
            Pin(crank.at(*(-arm / 2)), ground=tuple(place), name=f"bearing{k}"),
            Pin(tip, rod.at(*place), name=f"tip{k}"),
        ]
        bodies.append(crank)
        start.append(InitialVelocity(crank.name, SPIN, tuple(place)))
    return Scene([], joints, (0.0, -G), bodies=bodies, start=start)


def angle(t: float) -> float:
    """Return the angle of the cranks, from the equation of motion in this one coordinate."""
    inertia = 3 * (MASS * RADIUS**2 / 4 + INERTIA) + ROD * RADIUS**2
    pull = (3 * MASS / 2 + ROD) * RADIUS * G
    run = solve_ivp(
        lambda _, y: [y[1], -pull * np.cos(y[0]) / inertia],
        (0, t),
        [1.0, SPIN],
        rtol=1e-12,
        atol=1e-12,
    )
    return float(run.y[0, -1])


def tip(t: float) -> np.ndarray:
    return RADIUS * np.array([np.cos(angle(t)), np.sin(angle(t))])


def test_locomotive_whose_third_crank_is_held_by_a_stiff_bushing_turns_as_one_coordinate() -> None:
    """The run passes positions at which no choice of equations is regular, at a tight tolerance."""
    scene = locomotive()
    last = scene.joints[-1]
    soft = Bushing(last.point, (1e8, 1e8), (100.0, 100.0), other=last.other, name="tip2")
    held = replace(scene, joints=scene.joints[:-1], loads=[soft])
    run = simulate(held, 1.0, Radau(rtol=1e-8))
    assert run.outcome.success
    found = run.position(scene.bodies[0].origin)[-1]
    np.testing.assert_allclose(found, tip(1.0), atol=1e-7)


def test_run_that_stops_without_some_equations_says_that_they_may_be_missing() -> None:
    scene = locomotive()
    for model, said in ((drop_redundant(scene), True), (replace(scene, joints=[]), False)):
        system = assemble(model)
        advice = lock(system, 0.0, system.start()[0], 1.0)
        assert ("Equations of joints are left out" in advice) is said
        assert ("stiff Bushing" in advice) is said
