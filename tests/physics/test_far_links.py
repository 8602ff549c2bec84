"""Links, `Distance`, far from the origin move as they do at the origin.

Products of coordinates themselves would lose the square of the place times the round-off.
"""

import numpy as np
import pytest

from ancfdae import DOP853, HHT, Distance, Pin, Radau, RigidBody, Scene, Terminal, gradient
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
