"""The same scene in other units gives the same digits: no hidden absolute tolerance."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    FollowerForce,
    InitialVelocity,
    Material,
    Pin,
    Scene,
    SpringDamper,
    Weld,
    assemble,
    differentiate,
    equilibrium_gradient,
)
from ancfdae.extend import MaterialPoint
from ancfdae.observables import position
from ancfdae.sections import Rectangle

DESIGN = ("beam.youngs_modulus", "beam.height", "beam.density", "beam.length")


def scaled_run(length, mass, time, dimension, spin=2.0):
    """The paper's pendulum with a moving start, in units smaller by the given factors."""
    rest = (0.0,) * (dimension - 1)
    beam = Beam(
        "beam",
        (0.0, *rest),
        (1.2 * length, *rest),
        4,
        Rectangle(0.05 * length, 0.04 * length),
        Material(4000 * mass / length**3, 1e7 * mass / (length * time**2), 0.3),
    )
    gravity = (0.0, -9.81 * length / time**2, 0.0)[:dimension]
    axis = spin / time if dimension == 2 else (0.0, 0.0, spin / time)
    start = [InitialVelocity("beam", axis, (0.0, *rest))]
    scene = Scene([beam], [Pin(beam.at_start)], gravity=gravity, start=start)
    return differentiate(scene, 0.5 * time, HHT(2.0**-7 * time), design=DESIGN)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    ("length", "mass", "time"),
    [(1e3, 1e-3, 1.0), (1e-6, 1.0, 1.0), (1e6, 1.0, 1e3), (1.0, 1e-6, 1e6), (1e-6, 1e6, 1e-6)],
)
def test_motion_reactions_and_sensitivities_scale(length, mass, time, dimension):
    base, other = (
        scaled_run(*units, dimension) for units in ((1.0, 1.0, 1.0), (length, mass, time))
    )
    assert other.outcome.success
    assert other.statistics.iterations == base.statistics.iterations

    def tip(run):
        return run.position(MaterialPoint("beam", 1.0))

    # 1e-10: the Newton tolerance 1e-13 and round-off, amplified by growing sensitivities.
    within = {"rtol": 0.0}
    np.testing.assert_allclose(tip(other) / length, tip(base), atol=1e-11, **within)
    force = mass * length / time**2
    reactions = other.reaction("pin(beam@0)") / force, base.reaction("pin(beam@0)")
    np.testing.assert_allclose(*reactions, atol=1e-10 * np.max(np.abs(reactions[1])), **within)
    ours, theirs = (run.derivative(tip) * run.sensitivities.values for run in (other, base))
    np.testing.assert_allclose(ours / length, theirs, atol=1e-10 * np.max(np.abs(theirs)), **within)


def static_derivatives(length, mass, time, elements):
    """Value and scaled derivatives of a steel frame at rest, whose load follows it."""
    m, kg, h = length, mass, 0.01
    newton, bending = mass * length / time**2, 2.1e11 * h**4 / 12
    steel = Material(7850 * kg / m**3, 2.1e11 * kg / (m * time**2), 0.3)
    section = Rectangle(h * m, h * m)
    post = Beam("post", (0.0, 0.0), (m, 0.0), elements, section, steel)
    arm = Beam("arm", post.at_end, (0.0, 0.5 * m), elements, section, steel)
    stiffness = 10 * bending * mass / time**2
    spring = SpringDamper(
        post.at(0.5), stiffness, 0.0, 0.3 * m, ground=(0.5 * m, -0.4 * m), name="spring"
    )
    load = FollowerForce(arm.at_end, (0.0, -2 * bending * newton), name="load")
    joints = [Clamp(post.at_start), Weld(arm.at_start, post.at_end)]
    scene = Scene([post, arm], joints, loads=[load, spring])
    design = ["post.height", "load.force_y", "spring.stiffness"]
    found = equilibrium_gradient(scene, position(arm.at_end, 0) / length, design=design)
    return np.append(found.value, found.gradient * assemble(scene, design).b)


@pytest.mark.parametrize("widest", [64, 0], ids=["band", "SuperLU"])
@pytest.mark.parametrize("elements", [4, 20])
@pytest.mark.parametrize("time", [1e-5, 1e-3, 1e3])
@pytest.mark.parametrize("length", [1.0, 1e-6])
def test_statics_under_a_follower_load_scale(monkeypatch, length, time, elements, widest):
    """Rows were exchanged by the size of stiffnesses beside that of joints."""
    monkeypatch.setattr("ancfdae.numerics.linear_solvers._BAND_HALF_WIDTH", widest)
    base = static_derivatives(1.0, 1.0, 1.0, elements)
    other = static_derivatives(length, 1.0, time, elements)
    np.testing.assert_allclose(other, base, rtol=1e-8)


def test_a_turned_scene_turns_its_solution():
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    runs = []
    for rotation in (np.eye(2), turn):
        start, end = rotation @ [0.3, 0.2], rotation @ [1.5, 0.2]
        beam = Beam("beam", start, end, 4, Rectangle(0.05, 0.04), Material(4000, 1e7, 0.3))
        scene = Scene([beam], [Pin(beam.at_start)], gravity=rotation @ [0.0, -9.81])
        runs.append(differentiate(scene, 0.5, HHT(2.0**-7), design=DESIGN))
    straight, turned = (run.position(MaterialPoint("beam", 1.0)) for run in runs)
    np.testing.assert_allclose(turned, straight @ turn.T, atol=1e-11)


def test_a_scene_far_from_the_origin_moves_alike():
    runs = []
    for shift in (0.0, 1e3):
        beam = Beam(
            "beam",
            (shift, -shift),
            (shift + 1.2, -shift),
            4,
            Rectangle(0.05, 0.04),
            Material(4000, 1e7, 0.3),
        )
        scene = Scene([beam], [Pin(beam.at_start)], gravity=(0.0, -9.81))
        runs.append(differentiate(scene, 0.5, HHT(2.0**-7), design=DESIGN))
        assert runs[-1].outcome.success
    near, far = (
        run.position(MaterialPoint("beam", 1.0)) - run.position(MaterialPoint("beam", 0.0))
        for run in runs
    )
    # Coordinates of 1e3 carry round-off of 1e-13 a step, which 64 steps let grow.
    np.testing.assert_allclose(far, near, atol=1e-9)
