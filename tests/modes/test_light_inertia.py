"""Modes of Ziegler's double pendulum with dampers, whose links have nearly no inertia of their own.

Stiffness over inertia of a link alone is up to 4e9 of its exponents' squares; joints exclude such
motions, and the exponents keep all digits.
"""

import numpy as np
import pytest

from ancfdae import (
    FollowerForce,
    Pin,
    RigidBody,
    Scene,
    TorsionalSpringDamper,
    modes,
)


def pendulum(load, inner, outer, inertia):
    """Masses of 2 and 1 kg at the ends of links of 1 m, springs of 1 N m/rad, a follower force."""
    a = RigidBody("a", (0.0, 0.0), mass=2.0, inertia=inertia, centre=(1.0, 0.0))
    b = RigidBody("b", (1.0, 0.0), mass=1.0, inertia=inertia, centre=(1.0, 0.0))
    loads = [
        TorsionalSpringDamper(a.at(0, 0), 1.0, inner, name="k1"),
        TorsionalSpringDamper(b.at(0, 0), 1.0, outer, other=a.at(1.0, 0), name="k2"),
        FollowerForce(b.at(1.0, 0), (-load, 0.0), name="P"),
    ]
    joints = [Pin(a.at(0, 0)), Pin(b.at(0, 0), a.at(1.0, 0))]
    return Scene([], joints, loads=loads, bodies=[a, b])


def exponents(load, inner, outer, inertia):
    """Eigenvalues in the two angles of the links (Ziegler 1952)."""
    M = np.array([[3.0 + inertia, 1.0], [1.0, 1.0 + inertia]])
    K = np.array([[2.0 - load, load - 1.0], [-1.0, 1.0]])
    D = np.array([[inner + outer, -outer], [-outer, outer]])
    below = np.linalg.solve(M, np.hstack([-K, -D]))
    return np.linalg.eigvals(np.vstack([np.eye(4)[2:], below]))


@pytest.mark.parametrize("inertia", [1e-9, 1e-6, 1e-4, 1.0])
def test_exponents_of_light_links_keep_all_digits(inertia):
    rng = np.random.default_rng(1)
    for _ in range(25):
        load, inner, outer = rng.uniform(0, 3), *10 ** rng.uniform(-1, 1.3, 2)
        found = modes(pendulum(load, inner, outer, inertia), 4).exponents
        exact = exponents(load, inner, outer, inertia)
        assert 2 * np.sum(found.imag > 0) + np.sum(found.imag == 0) == 4
        for s in found:
            assert np.min(np.abs(exact - s)) < 1e-11 * abs(s)


def test_derivatives_of_exponents_of_light_links():
    at = 1.535465, 15.34852, 0.214569
    found = modes(pendulum(*at, 1e-9), 4, design=["P.force_x"])
    for s, slope in zip(found.exponents, found.natural_frequencies_b[:, 0], strict=True):
        lower, upper = (
            abs(x[np.argmin(np.abs(x - s))])
            for x in (exponents(at[0] + e, *at[1:], 1e-9) for e in (1e-5, -1e-5))
        )
        # Second-order differences, with a round-off of 1e-16/1e-5; the force is -P.
        assert slope == pytest.approx((upper - lower) / 2e-5, rel=1e-7, abs=1e-9)
