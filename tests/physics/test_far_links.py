"""Links, `Distance`, far from the origin move as they do at the origin.

Products of coordinates themselves would lose the square of the place times the round-off.
"""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    Distance,
    Pin,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    assemble,
    gradient,
)
from ancfdae.integrators.integrator import Integrator
from ancfdae.observables import position


def linkage(place: float, to_ground: bool) -> Scene:
    """Return two bodies with a pin and links, moved by (place, -place)."""
    first = RigidBody("first", (place + 0.5, -place), mass=1.3, inertia=0.12)
    second = RigidBody("second", (place + 1.0, -place - 0.6), mass=0.7, inertia=0.05)
    joints = [
        Pin(first.at(-0.5, 0), ground=(place, -place)),
        Distance(first.at(0.5, 0), 0.6, second.at(0, 0), name="link"),
    ]
    if to_ground:
        held = (place + 2.0, -place - 0.6)
        joints.append(Distance(second.at(0, 0), 1.0, ground=held, name="rod"))
    return Scene([], joints, (0.3, -9.81), bodies=[first, second])


@pytest.mark.parametrize("integrator", [Radau(rtol=1e-8), HHT(2**-7), DOP853(1e-9)])
@pytest.mark.parametrize("to_ground", [False, True])
@pytest.mark.parametrize("place", [1e3, 1e5])
def test_a_linkage_far_away_has_the_derivatives_of_one_at_the_origin(
    integrator: Integrator, to_ground: bool, place: float
) -> None:
    found = []
    for at in (0.0, place):
        scene = linkage(at, to_ground)
        height = Terminal(position(scene.bodies[1].at(0, 0), 1))
        design = ["link.length", "second.mass", *(["rod.length"] if to_ground else [])]
        run = gradient(scene, height, 0.4, integrator, design=design)
        found.append((run.value + at, run.gradient))
    # Error control turns a last place of coordinates into other steps within its tolerance.
    bound = max(1e-12 * place, 1e-6)
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=0, atol=bound)
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=0, atol=10 * bound)


@pytest.mark.parametrize("place", [1e3, 1e5])
def test_an_open_linkage_far_away_closes_as_one_at_the_origin(place: float) -> None:
    """The rod is declared 0.1 too short; `assemble` moves the bodies until both links close."""
    starts = []
    for at in (0.0, place):
        scene = linkage(at, True)
        joints = [replace(x, length=1.1) if x.name == "rod" else x for x in scene.joints]
        system = assemble(replace(scene, joints=joints, assemble=True))
        q = system.start()[0]
        assert np.max(np.abs(system.constraint(0.0, q))) < 1e-15 * max(at, 10.0)
        starts.append(q.reshape(2, -1, 2)[:, 0] - np.array([at, -at]))
    np.testing.assert_allclose(starts[1], starts[0], rtol=0, atol=1e-14 * place)
