"""Scales of the unknowns, also where the start gives none (docs/theory/10-index-reduction.md)."""

import dataclasses

import numpy as np
import pytest

from ancfdae.equations.saddle_points import saddle_point
from ancfdae.extend import FormulaSystem, SystemProperties
from ancfdae.integrators.problem import Scales
from ancfdae.integrators.start import consistent_start
from tests.support.mechanisms import CartesianPendulum, chain


class Bead(FormulaSystem):
    """A bead of mass 4 at (x, 0), on the line y = 0, with the speed v and a force along it."""

    n_q, n_lam = 2, 1
    design_names = ("force",)
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def __init__(self, x=0.0, v=0.0, force=0.0):
        self.x, self.v = x, v
        super().__init__((force,))

    def with_values(self, b):
        return Bead(self.x, self.v, *b)

    def start(self):
        return np.array([self.x, 0.0]), np.array([self.v, 0.0])

    def mass_matrix(self, q):
        return 4.0 * np.eye(2)

    def force(self, t, q, v):
        return np.array([1.0, 0.0]) * self.b[0]

    def position_constraint(self, t, q):
        return 3.0 * q[1:]


T = 5.0
# Bead; position, speed and load: root mean squares over two coordinates of sqrt(w) q = 2 x,
# sqrt(w) v = 2 v and Q / sqrt(w) = force / 2, times sqrt(2).
CASES = {
    "all given": (Bead(3.0, 7.0, 12.0), (6.0, 14.0, 6.0)),
    # Over the length 6 a load of 96 reaches sqrt(6 * 96), over the time 5 more.
    "from rest": (Bead(3.0, 0.0, 192.0), (6.0, 24.0, 96.0)),
    # A small load reaches less in the time 5 than over the length.
    "from rest, slowly": (Bead(3.0, 0.0, 0.02), (6.0, 0.05, 0.01)),
    # Over that length the load reaches sqrt(70 * 6).
    "at zero, moving": (Bead(0.0, 7.0, 12.0), (14.0 * T, 420.0**0.5, 6.0)),
    "at zero, moving freely": (Bead(0.0, 7.0), (14.0 * T, 14.0, 14.0 / T)),
    "at zero, pushed": (Bead(0.0, 0.0, 12.0), (6.0 * T**2, 6.0 * T, 6.0)),
    "at rest": (Bead(3.0), (6.0, 6.0 / T, 6.0 / T**2)),
    "nothing": (Bead(), (2**0.5, 2**0.5 / T, 2**0.5 / T**2)),
}


def scales_of(system, t_end):
    return Scales.of(system, consistent_start(system, saddle_point(system, 0.0), 0.0), t_end)


@pytest.mark.parametrize("case", CASES)
def test_scales_of_a_start(case):
    system, expected = CASES[case]
    scales = scales_of(system, T)
    position, speed, load = np.array(expected) / 2**0.5
    found = scales.position, scales.speed, scales.load
    np.testing.assert_allclose(found, (position, speed, load), rtol=1e-14)
    # sqrt(w) = 2; the row is Phi_q / sqrt(w) = 3/2.
    np.testing.assert_allclose(scales.q, position / 2, rtol=1e-14)
    np.testing.assert_allclose(scales.v, speed / 2, rtol=1e-14)
    np.testing.assert_allclose(scales.force, load * 2, rtol=1e-14)
    np.testing.assert_allclose(scales.row, 1.5, rtol=1e-14)
    np.testing.assert_allclose(scales.lam, load / 1.5, rtol=1e-14)
    np.testing.assert_allclose(scales.eta, speed / 1.5, rtol=1e-14)
    np.testing.assert_allclose(scales.b, abs(system.b[0]) or 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    ("angle", "spin", "load"),
    [
        (0.5, 0.0, 9.81),  # at rest, oblique: the force
        (0.0, 2.0, 9.81 + 4.0),  # through the bottom: the reaction
        (np.pi, 6.0, 36.0),  # through the top: the inertia, of which the force bears a part
    ],
    ids=["force", "reaction", "inertia"],
)
def test_the_largest_load_counts(angle, spin, load):
    # Unit mass and length; the root mean square over two coordinates.
    scales = scales_of(CartesianPendulum(angle, spin), T)
    assert scales.load == pytest.approx(load / 2**0.5, rel=1e-14)


def test_scales_follow_the_units():
    length, mass, time = 64.0, 4.0, 0.25
    one = dataclasses.asdict(scales_of(chain(), 1.0))
    other = dataclasses.asdict(scales_of(chain(length, mass, time), time))
    speed, load = length / time, length / time**2
    expected = {
        "position": mass**0.5 * length,
        "speed": mass**0.5 * speed,
        "load": mass**0.5 * load,
    }
    for name, unit in expected.items():
        assert other[name] == pytest.approx(one[name] * unit, rel=1e-12), name
