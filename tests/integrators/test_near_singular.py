"""A four-bar that folds nearly flat: errors grow there, and runs say so.

Held against the equations of three angles and two multipliers, integrated by SciPy.
"""

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ancfdae import (
    DOP853,
    HHT,
    Beam,
    DirectDifferentiation,
    Material,
    Moment,
    Pin,
    Radau,
    Scene,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.errors import StabilityWarning
from ancfdae.observables import position
from ancfdae.sections import Rectangle

DENSITY, SIDE, CRANK, LINK, TORQUE, G, END = 1000.0, 0.05, 1.0, 2.0, 60.0, 9.81, 2.0


def upright(rocker):
    """End of the crank, end of the coupler, and the second ground of the four-bar at its start."""
    B, D = np.array([0.0, CRANK]), np.array([LINK, 0.0])
    base = np.hypot(*(D - B))
    x = (base**2 + LINK**2 - rocker**2) / (2 * base)
    along = (D - B) / base
    return B, B + x * along + np.sqrt(LINK**2 - x**2) * np.array([-along[1], along[0]]), D


def four_bar(rocker):
    """A four-bar with sides CRANK, LINK, rocker and LINK; with rocker = CRANK it folds flat."""
    B, C, D = map(tuple, upright(rocker))
    made = 1, Rectangle(SIDE, SIDE), Material(DENSITY, 1e9, 0.3)
    crank = Beam("crank", (0.0, 0.0), B, *made, rigid=True)
    coupler = Beam("coupler", B, C, *made, rigid=True)
    other = Beam("rocker", D, C, *made, rigid=True)
    joints = [
        Pin(crank.at_start),
        Pin(crank.at_end, coupler.at_start),
        Pin(coupler.at_end, other.at_end),
        Pin(other.at_start),
    ]
    load = Moment(crank.at_start, TORQUE)
    return Scene([crank, coupler, other], joints, (0, -G), loads=[load]), other


def by_angles(rocker, times):
    """Place of the end of the rocker in x, (k,), by M a + P^T lam = Q and P a = gamma."""
    a, b, r = CRANK, LINK, rocker
    B, C, D = upright(r)
    m = DENSITY * SIDE**2 * np.array([a, b, r])
    J = m * (np.array([a, b, r]) ** 2 + SIDE**2) / 12

    def slope(_, y):
        (A, K, R), w = y[:3], y[3:]
        M = np.diag([J[0] + m[0] * a**2 / 4 + m[1] * a**2, J[1] + m[1] * b**2 / 4, J[2]])
        M[2, 2] += m[2] * r**2 / 4
        M[0, 1] = M[1, 0] = m[1] * a * b / 2 * np.cos(A - K)
        swing = m[1] * a * b / 2 * np.sin(A - K)
        Q = np.array(
            [
                TORQUE - swing * w[1] ** 2 - G * np.cos(A) * a * (m[0] / 2 + m[1]),
                swing * w[0] ** 2 - G * np.cos(K) * m[1] * b / 2,
                -G * np.cos(R) * m[2] * r / 2,
            ]
        )
        lengths = np.array([a, b, -r])
        c, s = lengths * np.cos(y[:3]), lengths * np.sin(y[:3])
        P = np.array([-s, c])
        matrix = np.block([[M, P.T], [P, np.zeros((2, 2))]])
        side = np.concatenate([Q, [c @ w**2, s @ w**2]])
        return np.append(w, np.linalg.solve(matrix, side)[:3])

    angles = [np.arctan2(v[1], v[0]) for v in (B, C - B, C - D)]
    run = solve_ivp(slope, (0, END), [*angles, 0, 0, 0], "DOP853", times, rtol=1e-12, atol=1e-13)
    return D[0] + r * np.cos(run.y[2])


@pytest.mark.parametrize(
    ("rocker", "step", "told"),
    [
        *((1.0001, 2e-4, True), (1.001, 1e-3, True), (1.001, 5e-4, True), (1.01, 2e-3, True)),
        *((1.001, 2e-4, False), (1.01, 5e-4, False), (1.1, 1e-3, False), (1.5, 2e-3, False)),
    ],
)
def test_runs_that_pass_near_a_singular_position_say_how_errors_grow(rocker, step, told):
    scene, other = four_bar(rocker)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = simulate(scene, END, HHT(step))
    assert run.outcome.success
    away = np.abs(run.position(other.at_end)[:, 0] - by_angles(rocker, run.t))
    # Without a word the error is 3 % of the length of the linkage at most.
    assert np.max(away) > 0.3 if told else np.max(away) < 0.06
    assert [x.category for x in caught] == [StabilityWarning] * told
    if told:
        assert "near a singular position at t = " in str(caught[0].message)
        assert caught[0].filename == __file__


@pytest.mark.parametrize(("rocker", "step", "told"), [(1.001, 2e-4, True), (1.01, 2e-4, False)])
def test_gradients_near_a_singular_position_err_by_the_square(rocker, step, told):
    """In the density of the crank, against halved steps: 23 % and 0.4 % off."""
    scene, other = four_bar(rocker)
    objective = Terminal(position(other.at_end, 0))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        settings = {"design": ["crank.density"], "method": DirectDifferentiation()}
        found = gradient(scene, objective, END, HHT(step), **settings).gradient[0]
    assert [x.category for x in caught] == [StabilityWarning] * told
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        better = gradient(scene, objective, END, HHT(step / 4), **settings).gradient[0]
    away = abs(found / better - 1)
    assert away > 0.05 if told else away < 0.02


def test_few_output_times_say_nothing_of_singular_positions():
    """No position of this four-bar is singular: it warned where output was 0.2 s apart."""
    scene, other = four_bar(1.5)
    objective = Terminal(position(other.at_end, 0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = gradient(scene, objective, 5.0, DOP853(1e-7), design=["crank.density"])
    # Radau IIA, whose states are the stages of short steps.
    exact = gradient(scene, objective, 5.0, Radau(5.0 / 5000), design=["crank.density"])
    assert found.gradient[0] == pytest.approx(exact.gradient[0], rel=1e-3)
