"""Equations that stay are independent along the motion: a Bennett linkage in one coordinate.

A Bennett linkage has four bars and four hinges that are neither parallel nor meet in a point.
Opposite bars have equal lengths a, b and twists alpha, beta with sin(alpha)/a = sin(beta)/b.
Hinges at both ends of a bar turn by theta and phi, where tan(theta/2) tan(phi/2) =
sin((alpha + beta)/2) / sin((beta - alpha)/2) (Bennett 1903).
"""

import numpy as np
import pytest
import scipy

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Beam,
    Material,
    Radau,
    Revolute,
    Scene,
    drop_redundant,
    simulate,
)
from ancfdae.sections import Rectangle

WIDTH, DENSITY, TWIST, LENGTHS = 0.04, 7800.0, 0.6, (0.5, 0.8)
OTHER_TWIST = np.arcsin(np.sin(TWIST) * LENGTHS[1] / LENGTHS[0])
RATIO = np.sin((OTHER_TWIST + TWIST) / 2) / np.sin((OTHER_TWIST - TWIST) / 2)


def frames(theta):
    """Hinges along z of frames from bar to bar, as 4 x 4 matrices (Denavit and Hartenberg)."""
    phi = 2 * np.arctan2(RATIO * np.cos(theta / 2), np.sin(theta / 2))
    found = [np.eye(4)]
    for turn, length, twist in (
        (theta, LENGTHS[0], TWIST),
        (phi, LENGTHS[1], OTHER_TWIST),
        (-theta, LENGTHS[0], TWIST),
        (-phi, LENGTHS[1], OTHER_TWIST),
    ):
        c, s, u, w = np.cos(turn), np.sin(turn), np.cos(twist), np.sin(twist)
        step = np.eye(4)
        step[:3] = [
            [c, -s * u, s * w, length * c],
            [s, c * u, -c * w, length * s],
            [0.0, w, u, 0.0],
        ]
        found.append(found[-1] @ step)
    np.testing.assert_allclose(found[-1], np.eye(4), atol=1e-12)
    return found[:4]


def bennett(theta, place=(0.0, 0.0, 0.0), unit=1.0):
    """The linkage with the bar from frame 0 to frame 1 as ground, and the end of its first bar."""
    found = frames(theta)
    places = [tuple(unit * (found[k % 4][:3, 3] + place)) for k in (1, 2, 3, 4)]
    axes = [tuple(found[k % 4][:3, 2]) for k in (1, 2, 3, 4)]
    section = Rectangle(WIDTH * unit, WIDTH * unit), Material(DENSITY / unit**3, 2e11 / unit, 0.3)
    rods = [Beam(f"bar {k}", *places[k : k + 2], 1, *section, rigid=True) for k in range(3)]
    joints = [
        Revolute(rod.at_start, axis, end, name=f"hinge {k}")
        for k, (rod, axis, end) in enumerate(
            zip(rods, axes, [None, rods[0].at_end, rods[1].at_end], strict=False)
        )
    ]
    last = Revolute(rods[2].at_end, axes[3], name="hinge 3")
    return Scene(rods, [*joints, last], (0.0, 0.0, -9.81 * unit)), rods[0].at_end


def fallen(theta, t_end):
    """The end of bar 0 after t_end, from the energy of the square bars in theta alone.

    Twice the kinetic energy of a bar of square section is m |c'|^2 + m (L^2 + w^2)/12 |u'|^2 +
    m w^2/6 (omega . u)^2, with its centre c, direction u and angular velocity omega.
    """
    start = frames(theta)

    def bars_at(x):
        found = frames(x)
        # The ground is the bar from frame 0 to frame 1, and frame 1 belongs to it.
        found = [start[1] @ np.linalg.inv(found[1]) @ one for one in found]
        ends = np.array([found[k % 4][:3, 3] for k in (1, 2, 3, 4)])
        turns = [found[k % 4][:3, :3] for k in (2, 3, 4)]
        return ends, turns

    def energies(x):
        h = 1e-4
        parts = [bars_at(x + k * h) for k in (-2, -1, 1, 2)]

        def rate(values):
            a, b, c, d = values
            return (a - 8 * b + 8 * c - d) / (12 * h)

        ends, turns = bars_at(x)
        mass, height = 0.0, 0.0
        for k in range(3):
            length = np.linalg.norm(ends[k + 1] - ends[k])
            m = DENSITY * WIDTH**2 * length
            c_x = rate([(p[0][k] + p[0][k + 1]) / 2 for p in parts])
            W = rate([p[1][k] for p in parts]) @ turns[k].T
            omega = np.array([W[2, 1], W[0, 2], W[1, 0]])
            u = (ends[k + 1] - ends[k]) / length
            across = omega - (omega @ u) * u
            mass += m * (
                c_x @ c_x
                + (length**2 + WIDTH**2) / 12 * (across @ across)
                + WIDTH**2 / 6 * (omega @ u) ** 2
            )
            height += m * 9.81 * (ends[k, 2] + ends[k + 1, 2]) / 2
        return mass, height

    def rates(t, y):
        h = 1e-3
        M, _ = energies(y[0])
        (a, p), (b, r), (c, s), (d, w) = (energies(y[0] + k * h) for k in (-2, -1, 1, 2))
        M_x, V_x = (a - 8 * b + 8 * c - d) / (12 * h), (p - 8 * r + 8 * s - w) / (12 * h)
        return [y[1], -(M_x * y[1] ** 2 / 2 + V_x) / M]

    run = scipy.integrate.solve_ivp(rates, (0, t_end), [theta, 0.0], "DOP853", rtol=1e-9, atol=1e-9)
    return bars_at(run.y[0, -1])[0][1]


INTEGRATORS = {
    "HHT": (HHT(2.0**-10), 1e-5),
    "Radau": (Radau(2.0**-7), 1e-6),
    "IDA": (IDA(1e-8), 1e-6),
    "DOP853": (DOP853(1e-9), 1e-6),
}


@pytest.mark.parametrize(("integrator", "off"), INTEGRATORS.values(), ids=INTEGRATORS)
@pytest.mark.parametrize("theta", [0.3, 1.0, 2.9])
@pytest.mark.filterwarnings("error")
def test_a_bennett_linkage_falls_as_in_one_coordinate(theta, integrator, off):
    """Angles 0.3 and 2.9 lie near both stretched positions, and the others pass them."""
    scene, point = bennett(theta)
    free = drop_redundant(scene)
    assert len(free.left_out) == 3
    run = simulate(free, 1.0, integrator)
    assert run.outcome.success
    np.testing.assert_allclose(run.position(point)[-1], fallen(theta, 1.0), atol=off)


def test_a_linkage_loses_the_same_equations_wherever_and_in_whatever_unit():
    expected = drop_redundant(bennett(1.0)[0]).left_out
    for place, unit in (((1e3, -2e3, 5e2), 1.0), ((0.0, 0.0, 0.0), 1e3)):
        assert drop_redundant(bennett(1.0, place, unit)[0]).left_out == expected
