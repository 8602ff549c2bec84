"""The torque of a flexible arm for a path of its tip, against the response of a beam in frequency.

An Euler-Bernoulli beam with a hub and a tip mass bends under a torque tau e^(i omega t) to
w = A sin(b x) + B sinh(b x) + C (cos(b x) - cosh(b x)). Here b^4 = m omega^2 / (E I). The tip
follows the torque with a delay that no causal inverse makes up for: the inverse has poles in both
half planes. Its bounded response to a path, by Fourier transforms, begins before the path does.
"""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Material,
    Misfit,
    MotorTorque,
    Pin,
    PointMass,
    Radau,
    RigidBody,
    Scene,
    Weld,
    distributed_variables,
    simulate,
)
from ancfdae.laws import BSpline
from ancfdae.observables import position
from ancfdae.sections import Rectangle

LENGTH, HEIGHT, WIDTH, E, RHO = 1.0, 0.004, 0.03, 7e10, 2700.0
HUB, TIP = 0.05, 0.1
BEFORE, MOVES, AFTER = 0.2, 0.3, 0.2
# The last control values act in the last moments, which the tip does not feel: they stay zero.
HELD = 4


def arm(count, before=BEFORE):
    """A flexible arm on a hub that a torque turns, with a mass at its tip."""
    t_end = before + MOVES + AFTER
    beam = Beam("arm", (0, 0), (LENGTH, 0), 4, Rectangle(HEIGHT, WIDTH), Material(RHO, E, 0.0))
    hub = RigidBody("hub", (0, 0), mass=1.0, inertia=HUB)
    motor = MotorTorque(hub.origin, 1.0, law=BSpline(0.0, t_end, [0.0] * count), name="motor")
    joints, tip = [Pin(hub.origin), Weld(beam.at_start, hub.origin)], PointMass(beam.at_end, TIP)
    return beam, Scene([beam], joints, loads=[motor], bodies=[hub, tip]), t_end


def path(t, begin, order=0):
    """A polynomial of degree nine from 0 to 1, or a derivative, which is zero outside."""
    s = np.clip((t - begin) / MOVES, 0, 1)
    rise = np.polynomial.Polynomial([0] * 5 + [126, -420, 540, -315, 70])
    return rise.deriv(order)(s) / MOVES**order if order else rise(s)


def inverted(count, step, size, before=BEFORE, iterations=1):
    """Control values of the torque for a path of that size in rad, by Gauss-Newton's method.

    Also returns the largest miss of the path, relative to its size, scene and beam. One iteration
    is enough for a small angle.
    """
    beam, scene, t_end = arm(count, before)
    times = np.linspace(0, t_end, 2 * count + 1)[1:]
    angle = np.arctan2(position(beam.at_end, 1), position(beam.at_end, 0))
    misfit = Misfit([angle], times, [size * path(times, before)], 1 / size)
    design = distributed_variables("motor.value", count)[:-HELD]
    fit = misfit.fit(scene, t_end, HHT(step), design=design)
    x = fit.start
    for _ in range(iterations):
        x = x - np.linalg.lstsq(fit.jacobian(x), fit.residuals(x))[0]
    moved = scene.with_values(dict(zip(fit.design_names, x, strict=True)))
    return np.append(x, np.zeros(HELD)), np.max(np.abs(fit.residuals(x))), moved, beam


def stiffness_in_frequency(omega):
    """Torque over deflection of the tip at omega > 0, an Euler-Bernoulli beam; N m/m."""
    EI, m = E * WIDTH * HEIGHT**3 / 12, RHO * HEIGHT * WIDTH
    b = (m * omega**2 / EI) ** 0.25
    s, c, sh, ch = (f(b * LENGTH) for f in (np.sin, np.cos, np.sinh, np.cosh))
    # At the tip no moment, and the shear force of the mass: two equations for A, B, C.
    w = np.array([s, sh, c - ch])
    moment = b**2 * np.array([-s, sh, -c - ch])
    shear = EI * b**3 * np.array([-c, ch, s - sh]) + TIP * omega**2 * w
    A, B, C = np.cross(moment / np.abs(moment).max(), shear / np.abs(shear).max())
    turn, bending = b * (A + B), -2 * EI * b**2 * C
    return (-HUB * omega**2 * turn - bending) / (w @ [A, B, C])


def by_fourier(t, begin):
    """The bounded torque for a path of the tip of one metre, in a window of 8 s; N m."""
    n, window, shift = 2**13, 8.0, 3.0
    tau = window / n * np.arange(n)
    omega = 2 * np.pi * np.fft.rfftfreq(n, window / n)
    inertia = HUB + RHO * HEIGHT * WIDTH * LENGTH**3 / 3 + TIP * LENGTH**2
    over = np.zeros(len(omega))
    over[0] = inertia / LENGTH
    # Beyond 1,500 rad/s the path has nothing, and the hyperbolic functions lose digits.
    low = np.flatnonzero((omega > 0) & (omega < 1500))
    over[low] = [-stiffness_in_frequency(x) / x**2 for x in omega[low]]
    torque = np.fft.irfft(np.fft.rfft(path(tau, shift, 2)) * over, n)
    return np.interp(t - begin + shift, tau, torque)


def test_small_motions_have_the_torque_of_a_beam_inverted_by_fourier_transforms():
    """To 1e-3 of the largest torque, half of which acts before the tip starts to move."""
    count, size = 100, 1e-3
    values, *_ = inverted(count, 1e-3, size)
    t_end = BEFORE + MOVES + AFTER
    t = np.linspace(0, t_end, 400)
    torque = BSpline(0.0, t_end, values.tolist()).derivative(values, t, 0)
    exact = size * LENGTH * by_fourier(t, BEFORE)
    largest = np.max(np.abs(exact))
    assert np.max(np.abs(exact[t < BEFORE])) > 0.5 * largest
    assert abs(exact[0]) < 1e-5 * largest
    assert np.max(np.abs(torque - exact)) < 1e-3 * largest
    rigid = size * (HUB + RHO * HEIGHT * WIDTH / 3 + TIP) * path(t, BEFORE, 2)
    assert np.max(np.abs(rigid - exact)) > largest


def test_the_tip_follows_a_path_over_a_large_angle():
    """1.2 rad: the miss by another integrator is an error of HHT(2e-3), which found the torque.

    It falls as the square of the step, so that the same torque is missed four times more by
    HHT(4e-3).
    """
    count, step = 40, 2e-3
    _, _, turned, beam = inverted(count, step, 1.2, iterations=4)
    t_end = BEFORE + MOVES + AFTER
    t = np.linspace(0, t_end, 701)
    runs = [simulate(turned, t_end, r).at(t) for r in (Radau(rtol=1e-7), HHT(2 * step))]
    exact, coarse = (np.arctan2(*run.position(beam.at_end).T[::-1]) for run in runs)
    miss = np.max(np.abs(exact - 1.2 * path(t, BEFORE)))
    assert miss < 1e-3
    assert np.max(np.abs(coarse - exact)) == pytest.approx(4 * miss, rel=0.3)


def test_a_torque_that_starts_with_the_path_grows_without_bound():
    """The causal inverse is unstable: it takes a hundred times the torque, and misses the path."""
    bounded, follows, *_ = inverted(40, 4e-3, 1e-3)
    causal, missed, *_ = inverted(40, 4e-3, 1e-3, before=0.0)
    assert np.max(np.abs(causal)) > 20 * np.max(np.abs(bounded))
    assert missed > 1e-3 > 1e2 * follows
