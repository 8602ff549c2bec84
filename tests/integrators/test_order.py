"""HHT-I3 is second order in q, v, a and lam, from rest and from a moving start.

The observed order is taken in the maximum norm over *all* instants, the first steps included,
from successive differences: d_k = |x(h_k) - x(h_k / 2)|, order = log2(d_k / d_{k+1}).
"""

import itertools

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    InitialVelocity,
    Terminal,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import custom
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

# The claim: 2 within 0.15.
WITHIN = 0.15


def observed_orders(runs, read):
    """Orders between neighbouring pairs of runs, each at half the step of the one before."""
    values = [read(run) for run in runs]
    changes = [np.max(np.abs(coarse - fine[::2])) for coarse, fine in itertools.pairwise(values)]
    return np.log2(np.divide(changes[:-1], changes[1:]))


def states(run):
    return {"q": run.q, "v": run.v, "a": run.a, "lam": run.lam}


def assert_second_order(runs):
    for run in runs:
        assert run.outcome.success, str(run.outcome)
    for name in ("q", "v", "a", "lam"):
        orders = observed_orders(runs, lambda run, name=name: states(run)[name])
        assert abs(orders[-1] - 2) < WITHIN, (name, orders)


@pytest.mark.parametrize("hht_alpha", [-0.05, -0.3, -1 / 3])
@pytest.mark.parametrize(("angle", "spin"), [(-np.pi / 2, 0.0), (-1.0, 2.0), (0.5, 3.0)])
def test_rigid_pendulum_converges_with_order_two(hht_alpha, angle, spin):
    system = CartesianPendulum(angle, spin)
    assert_second_order([simulate(system, 1.0, HHT(2.0**-k, hht_alpha)) for k in (6, 7, 8, 9)])


# Steps that resolve the fastest wave of the section (about 4e3 and 4e4 rad/s).
@pytest.mark.parametrize("hht_alpha", [-0.05, -0.3])
@pytest.mark.parametrize("spin", [0.0, 3.0])
@pytest.mark.parametrize(("modulus", "t_end", "first"), [(1e7, 2.0**-6, 14), (1e9, 2.0**-9, 17)])
def test_flexible_pendulum_converges_with_order_two(modulus, t_end, first, spin, hht_alpha):
    start = (InitialVelocity("pendulum", spin, (0.0, 0.0)),) if spin else ()
    scene = pendulum(youngs_modulus=modulus, start=start)
    steps = [2.0**-k for k in range(first, first + 4)]
    assert_second_order([simulate(scene, t_end, HHT(step, hht_alpha)) for step in steps])


def test_sensitivities_of_the_rigid_pendulum_converge_with_order_two():
    system = CartesianPendulum(-1.0, 2.0)
    runs = [differentiate(system, 1.0, HHT(2.0**-k)) for k in (6, 7, 8, 9)]
    for name in ("q_b", "v_b", "a_b", "lam_b"):
        orders = observed_orders(runs, lambda run, name=name: getattr(run.sensitivities, name))
        assert abs(orders[-1] - 2) < WITHIN, (name, orders)


# Steps of which the run has no whole number: 2 % or 70 % of a step remain at the end.
@pytest.mark.parametrize("part", [0.02, 0.7])
def test_order_and_derivatives_hold_where_the_end_is_no_whole_number_of_steps(part):
    """All steps are shorter alike: one short last step had the multipliers of first order."""
    system, end = CartesianPendulum(-1.0, 2.0), []
    runs = [simulate(system, 1.0, HHT(1 / (n - 1 + part))) for n in (64, 128, 256, 512)]
    assert [len(run.t) - 1 for run in runs] == [64, 128, 256, 512]
    assert_second_order(runs)
    for step in (1 / (63 + part), 1 / 64):
        gradients = [
            gradient(system, Terminal(custom(speed, "v_x")) + 1.0, 1.0, HHT(step), method=method)
            for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
        ]
        end.append(np.array([each.gradient for each in gradients]))
        # Round-off of 64 steps, 1e-16 each, a hundred times over.
        np.testing.assert_allclose(end[-1][1:], end[-1][:1].repeat(2, 0), rtol=1e-12)
    np.testing.assert_allclose(end[0], end[1], rtol=1e-13)


def speed(t, q, v, lam, b):
    return v[:, 0]


def test_a_run_goes_on_over_whole_steps_only():
    system, integrator = CartesianPendulum(-1.0, 2.0), HHT(0.03)
    run = simulate(system, 0.3, integrator)
    whole = simulate(system, 0.6, integrator)
    on = simulate(system, 0.6, integrator, after=run)
    np.testing.assert_array_equal(on.t, whole.t)
    np.testing.assert_allclose(on.q, whole.q, rtol=1e-13)  # round-off of 10 steps
    with pytest.raises(InvalidInputError, match="end after whole steps"):
        simulate(system, 0.5, integrator, after=run)
    assert len(simulate(system, 1e-9, integrator).t) == 2


def test_multipliers_at_hht_alpha_zero_oscillate_and_that_is_warned_about():
    with pytest.warns(UserWarning, match="oscillate"):
        undamped = HHT(2.0**-7, 0.0)
    reference = simulate(CartesianPendulum(-1.0, 2.0), 1.0, HHT(2.0**-12, -0.05)).lam[::32]
    damped = simulate(CartesianPendulum(-1.0, 2.0), 1.0, HHT(2.0**-7, -0.05)).lam
    wild = simulate(CartesianPendulum(-1.0, 2.0), 1.0, undamped).lam
    # The start-up leaves an O(h^2) error that nothing damps: its sign alternates, which second
    # differences single out, and it grows with the number of steps.
    saw = np.abs(np.diff(wild - reference, n=2, axis=0)[:, 0])
    smooth = np.abs(np.diff(damped - reference, n=2, axis=0)[:, 0])
    assert np.max(saw[-20:]) > 100 * np.max(smooth[-20:])
    assert np.max(saw[-20:]) > 3 * np.max(saw[:20])
