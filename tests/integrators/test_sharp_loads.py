"""Loads of a user's own that change within a small part of the motion, under a tolerance.

Held against SciPy in one angle: a rigid rod on a pin, J phi'' = -m g l cos(phi)/2 + torque.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ancfdae import Beam, Material, Pin, Scene, Terminal, gradient, simulate
from ancfdae.errors import ToleranceWarning
from ancfdae.extend import (
    LAW_FIELD,
    Load,
    MaterialPoint,
    Quantity,
    design_numbers,
)
from ancfdae.observables import position
from ancfdae.sections import Rectangle

MASS, G, END = 2.5, 9.81, 1.2
INERTIA = MASS * (1 / 3 + 0.05**2 / 12)


@dataclass(frozen=True)
class Notch(Load):
    """A force along x at a point where one of its numbers is near `place`."""

    point: MaterialPoint
    strength: float
    place: float
    width: float
    of: str = "x"

    kind = "notch"
    design_fields = (*design_numbers("strength", "place", "width"), LAW_FIELD)

    def vectors(self, elements) -> tuple[tuple[MaterialPoint, Quantity], ...]:
        return ((self.point, Quantity.POSITION),)

    def force(self, U: Any, V: Any, p, U_o) -> Any:
        strength, place, width, *_ = self.split(p)
        x = np.arctan2(U[..., 1:], U[..., :1]) if self.of == "angle" else U[..., :1]
        s = (x - place) / width
        return strength * np.exp(-s * s) * np.array([1.0, 0.0])


def scene(of, strength, place, width):
    made = 1, Rectangle(0.05, 0.05), Material(1000.0, 1e9, 0.3)
    rod = Beam("rod", (0, 0), (1, 0), *made, rigid=True)
    notch = Notch(rod.at_end, strength, place, width, of, name="notch")
    return Scene([rod], [Pin(rod.at_start)], loads=[notch], gravity=(0, -G)), rod


def height(of, strength, place, width, times=(END,)):
    """Place of the end in y at some times, by SciPy, in short steps where the notch is passed."""

    def off(t, y):
        c, s = np.cos(y[0]), np.sin(y[0])
        return ((np.arctan2(s, c) if of == "angle" else c) - place) / width

    def slope(t, y):
        push = strength * np.exp(-(off(t, y) ** 2))
        return [y[1], (-MASS * G * np.cos(y[0]) / 2 - push * np.sin(y[0])) / INERTIA]

    # Without the notch until it is near, then in steps of a twentieth of its passage and less.
    free = solve_ivp(
        lambda t, y: [y[1], -MASS * G * np.cos(y[0]) / 2 / INERTIA],
        *((0, END), [0, 0], "DOP853"),
        rtol=1e-12,
        atol=1e-13,
        dense_output=True,
    )
    fine = np.linspace(0, END, 200_001)
    near = fine[np.argmax(np.abs(off(fine, free.sol(fine))) < 20)]
    settings = {"rtol": 1e-11, "atol": 1e-13, "dense_output": True}
    before = max(near - 1e-5, 0.0)
    leg = 40 * width
    inside = solve_ivp(
        slope, (before, before + leg), free.sol(before), "DOP853", max_step=width / 50, **settings
    )
    assert abs(off(0, inside.y[:, -1])) > 8
    after = solve_ivp(
        slope, (before + leg, END), inside.y[:, -1], "DOP853", max_step=2e-3, **settings
    )
    parts = [(before, free.sol), (before + leg, inside.sol), (np.inf, after.sol)]
    return np.sin([next(y(t)[0] for end, y in parts if t <= end) for t in times])


@pytest.mark.parametrize(
    ("of", "strength", "place", "width", "tolerance"),
    [
        ("x", 300.0, 0.5, 1e-2, 1e-4),
        ("x", 3e4, 0.5, 1e-4, 1e-2),
        ("angle", 2e4, -1.0, 1e-4, 1e-4),
    ],
)
def test_gradients_follow_loads_that_are_sharp_in_the_state(of, strength, place, width, tolerance):
    there, rod = scene(of, strength, place, width)
    objective = Terminal(position(rod.at_end, 1))
    design = ["notch.strength"]
    found = gradient(there, objective, END, tolerance=tolerance, design=design)
    e = 1e-4
    up, down = (height(of, strength * (1 + x), place, width)[0] for x in (e, -e))
    assert found.gradient[0] == pytest.approx((up - down) / (2 * e * strength), rel=3 * tolerance)
    assert found.value == pytest.approx(height(of, strength, place, width)[0], abs=3 * tolerance)


def test_values_over_time_follow_them_too():
    there, rod = scene("x", 3e4, 0.5, 1e-4)
    seen = simulate(there, END, tolerance=1e-4, observables=[position(rod.at_end, 1)])
    exact = height("x", 3e4, 0.5, 1e-4, seen.t)
    assert np.linalg.norm(seen.values[:, 0] - exact) < 2e-4 * np.linalg.norm(exact)


def test_a_notch_that_no_run_follows_is_said_to_be_missed():
    """A ten-millionth of the travel, passed in 5e-8 s."""
    there, rod = scene("x", 3e7, 0.2, 1e-7)
    settings = {"tolerance": 1e-2, "design": ["notch.strength"]}
    with pytest.warns(ToleranceWarning, match="forces or observables change within"):
        gradient(there, Terminal(position(rod.at_end, 1)), END, **settings)
