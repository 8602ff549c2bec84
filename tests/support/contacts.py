"""Units of scenes with contact, and the check of their gradients."""

import numpy as np
import pytest

from ancfdae import (
    Adjoint,
    ComplexStep,
    Contact,
    DirectDifferentiation,
    InitialVelocity,
    Plane,
    RigidBody,
    Scene,
    assemble,
    gradient,
)

#: Around the origin in SI, and in millimetres and tonnes a thousand lengths away.
R, MASS, G = 0.1, 2.0, 9.81
UNITS = {"m": (1.0, 1.0, 0.0), "mm": (1e3, 1e-3, 1e5)}


def agree(scene, objective, t_end, design, integrators, difference=True):
    """Check direct, adjoint and complex step against each other, and differences of the call.

    By unit changes of variables, to 1e-10 of each and to round-off of the largest.
    """
    values = assemble(scene, design).b
    unit = np.where(values == 0, 1.0, np.abs(values))
    for integrator in integrators:
        ways = DirectDifferentiation(), Adjoint(), ComplexStep()
        call = objective, t_end, integrator
        found = [gradient(scene, *call, design=design, method=way).gradient * unit for way in ways]
        first, largest = found[0], np.abs(found[0]).max()
        assert largest > 0
        for other in found[1:]:
            np.testing.assert_allclose(other, first, rtol=1e-10, atol=1e-13 * largest)
    for k, name in enumerate(design if difference else ()):
        moved = [
            gradient(scene.with_values({name: values[k] + x * unit[k]}), *call, design=[name]).value
            for x in (-2e-6, -1e-6, 1e-6, 2e-6)
        ]
        fine, wide = (moved[2] - moved[1]) / 2e-6, (moved[3] - moved[0]) / 4e-6
        # Powers of 3/2 make second derivatives jump where contact begins, between two time points.
        assert first[k] == pytest.approx((4 * fine - wide) / 3, rel=1e-6, abs=3e-7 * largest)


def ball(at=(0.0, 0.0, R), name="ball", mass=MASS, radius=R):
    """A homogeneous ball, of which only mass and inertia are known."""
    inertia = 0.4 * mass * radius**2
    return RigidBody(name, at, mass=mass, inertia=(inertia,) * 3)


def moving(body, velocity, spin=(0.0, 0.0, 0.0)):
    return InitialVelocity(body.name, spin, body.position, velocity)


def falling(speed=1.0, unit="m", **law):
    """A ball that meets the floor at a speed, without gravity, from 1 mm above it."""
    length, mass, away = UNITS[unit]
    m = law.get("exponent", 1.5)
    # Undamped it would be 2 mm deep.
    k = (m + 1) * MASS * mass * (speed * length) ** 2 / (2 * (2e-3 * length) ** (m + 1))
    floor = away, away, 2 * away
    body = ball((away, away, 2 * away + 1.01 * R * length), mass=MASS * mass, radius=R * length)
    names = ("impact_speed", "slip_speed")
    law = {x: y * length if x in names else y for x, y in law.items()}
    touch = Contact(
        body.at(0, 0, 0), Plane(floor, (0, 0, 2)), stiffness=k, radius=R * length, name="floor",
        **law,
    )  # fmt: skip
    start = [moving(body, (0.0, 0.0, -speed * length))]
    return Scene([], [], bodies=[body], loads=[touch], start=start), body
