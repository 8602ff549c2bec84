"""Where the numerics end: tiny steps, stiff bodies under huge ones, very large and small units."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ancfdae import (
    DOP853,
    HHT,
    AdaptiveSteps,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Integral,
    PrescribedSteps,
    differentiate,
    estimate_adjoint_error,
    gradient,
    simulate,
)
from ancfdae.errors import Interrupted, InvalidInputError
from ancfdae.extend import FormulaSystem, SystemProperties
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.small_steps import ConstraintRow, Nodes
from ancfdae.observables import custom
from ancfdae.results import Verdict
from tests.support.mechanisms import CartesianPendulum, GuidedDoublePendulum, chain
from validation.extremes.rows import Case, measure
from validation.extremes.scenes import Rod, Units


def rigid_pendulum(t, angle, spin):
    """Accelerations and multiplier of `CartesianPendulum` from its angle."""
    rate = lambda t, y: [y[1], -9.81 * np.sin(y[0])]  # noqa: E731
    run = solve_ivp(
        rate, (0, t[-1]), [angle, spin], method="DOP853", t_eval=t, rtol=1e-13, atol=1e-15
    )
    theta, omega = run.y
    turning = -9.81 * np.sin(theta)
    along, inward = (
        np.stack([np.cos(theta), np.sin(theta)]),
        np.stack([-np.sin(theta), np.cos(theta)]),
    )
    a = (along * turning + inward * omega**2).T
    return a, (omega**2 + 9.81 * np.cos(theta))[:, None]


@pytest.mark.parametrize("alpha", [-0.05, -0.3])
@pytest.mark.parametrize("h", [1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
def test_accelerations_and_multipliers_stay_usable_at_tiny_steps(h, alpha):
    # With Phi(q) itself in the equations: 3e-5 at 1e-5 s, no convergence below.
    run = simulate(CartesianPendulum(-1.0, 2.0), 400 * h, HHT(h, hht_alpha=alpha))
    assert run.outcome.success
    a, lam = rigid_pendulum(run.t, -1.0, 2.0)
    assert np.max(np.abs(run.a - a)) < 2e-6 * np.max(np.abs(a))
    assert np.max(np.abs(run.lam - lam)) < 2e-6 * np.max(np.abs(lam))


@pytest.mark.parametrize("system", [GuidedDoublePendulum(), chain()])
def test_constraints_that_move_hold_at_tiny_steps(system):
    run = simulate(system, 500 * 1e-6, HHT(1e-6, hht_alpha=-0.05))
    assert run.outcome.success
    worst = max(np.max(np.abs(system.constraint(t, q))) for q, t in zip(run.q, run.t, strict=True))
    assert worst < 1e-13


def tiny(h, alpha, count):
    """Steps whose sizes jump by up to a factor of three."""
    times = np.cumsum([0.0, *(h * (1 + 0.5 * np.sin(np.arange(count))))])
    return HHT(PrescribedSteps(tuple(times)), alpha)


@pytest.mark.parametrize("alpha", [-0.05, -0.3])
@pytest.mark.parametrize(
    ("build", "h", "count"),
    [
        (lambda: CartesianPendulum(-1.0, 2.0), 1e-5, 100),
        (lambda: CartesianPendulum(-1.0, 2.0), 1e-7, 100),
        (GuidedDoublePendulum, 1e-6, 16),
        (chain, 1e-7, 40),
    ],
)
def test_derivatives_at_tiny_steps_are_those_of_the_complex_step(build, h, count, alpha):
    # With Phi_q q_b + Phi_b from q_b itself a_b and lam_b of the pendulum err by 1e-5 at 1e-5 s and
    # by their own size at 1e-7 s.
    system, integrator = build(), tiny(h, alpha, count)
    direct, check = (
        differentiate(system, integrator.steps.times[-1], integrator, method=method)
        for method in (DirectDifferentiation(), ComplexStep())
    )
    for name, bound in (("q_b", 1e-12), ("v_b", 1e-10), ("a_b", 2e-6), ("lam_b", 2e-6)):
        ours, theirs = (getattr(run.sensitivities, name) for run in (direct, check))
        assert np.max(np.abs(ours - theirs)) < bound * np.max(np.abs(theirs)), name
    objective = Integral(custom(lambda t, q, v, lam, b: lam[:, 0] ** 2, "reaction"))
    back, forth = (
        gradient(system, objective, integrator.steps.times[-1], integrator, method=method).gradient
        for method in (Adjoint(), DirectDifferentiation())
    )
    assert np.linalg.norm(back - forth) < 1e-7 * np.linalg.norm(forth)


def test_derivatives_of_the_rigid_pendulum_stay_usable_at_tiny_steps():
    h, system = 1e-6, CartesianPendulum(-1.0, 2.0)
    run = differentiate(system, 400 * h, HHT(h, hht_alpha=-0.05))
    exact = differentiate(system, 400 * h, DOP853(1e-12)).sensitivities
    for name in ("a_b", "lam_b"):
        ours, theirs = getattr(run.sensitivities, name)[-1], getattr(exact, name)[-1]
        assert np.max(np.abs(ours - theirs)) < 1e-5 * np.max(np.abs(theirs)), name


def test_derivatives_along_take_small_steps_into_account():
    system, h = CartesianPendulum(-1.0, 2.0), 1e-6
    integrator = HHT(AdaptiveSteps(1e-9, max_steps=400, sensitivities=True))
    run = differentiate(system, 1e-4, integrator)
    assert np.median(np.diff(run.t)) < 10 * h
    batched = integrator.differentiate(system, run)
    for name in ("q_b", "v_b", "a_b", "lam_b"):
        ours, theirs = (getattr(x.sensitivities, name) for x in (run, batched))
        assert np.max(np.abs(ours - theirs)) < 1e-6 * np.max(np.abs(theirs)), name


def test_an_interrupt_among_small_steps_keeps_the_derivatives_before(monkeypatch):
    count, original = iter(range(100)), ConstraintRow.of

    def interrupted(*arguments):
        if next(count) == 5:
            raise KeyboardInterrupt
        return original(*arguments)

    monkeypatch.setattr(ConstraintRow, "of", interrupted)
    monkeypatch.setattr(linear_passes, "_CHUNK_NUMBERS", 1)  # one step at a time
    with pytest.raises(Interrupted) as caught:
        differentiate(CartesianPendulum(-1.0, 2.0), 20e-7, HHT(1e-7))
    run = caught.value.result
    assert run.outcome.verdict is Verdict.INTERRUPTED
    assert len(run.t) == len(run.sensitivities.q_b) == 6


def test_defects_of_small_steps_have_the_weights_of_other_steps(monkeypatch):
    # In exact arithmetic a small step has the same equations as any other; here Phi/h^2 has a
    # round-off of 1e-16 m / (2e-5 s)^2 = 3e-7 m/s^2 beside 10 m/s^2, a hundredth of which is left
    # of sums over 50 steps.
    system, steps = CartesianPendulum(-1.0, 2.0), HHT(2e-5)
    objective = Integral(custom(lambda t, q, v, lam, b: lam[:, 0] ** 2))
    small = estimate_adjoint_error(system, objective, 1e-3, steps).error
    monkeypatch.setattr(Nodes, "maybe_small", lambda self: np.zeros(len(self.run.t), bool))
    other = estimate_adjoint_error(system, objective, 1e-3, steps).error
    assert abs(small - other) <= 1e-8 * abs(other)
    assert small != other


class Carriage(FormulaSystem):
    """Two free coordinates, the second of which is driven: A sin(w t)."""

    n_q, n_lam = 2, 1
    design_names = ("A", "w")
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def with_values(self, b):
        return Carriage(b)

    def start(self):
        return np.array([1.0, 0.0]), np.array([0.0, self.b[0] * self.b[1]])

    def mass_matrix(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return 0 * q

    def position_constraint(self, t, q):
        return np.array([q[1] - self.b[0] * np.sin(self.b[1] * t)])


def test_a_step_from_an_instant_without_forces_is_not_taken_for_small():
    # Inertia and reaction are zero at the start; increments of the drive would err by 4e-9.
    run = differentiate(Carriage((1.0, 1.0)), 2.0, HHT(0.5))
    exact = np.stack([np.sin(run.t), run.t * np.cos(run.t)], axis=1)
    np.testing.assert_allclose(run.sensitivities.q_b[:, 1], exact, atol=1e-14, rtol=0)


def test_constraints_do_not_drift_over_many_tiny_steps():
    run = simulate(CartesianPendulum(-1.0, 2.0), 4_000 * 1e-6, HHT(1e-6, hht_alpha=-0.05))
    drift = np.abs(np.sum(run.q**2, axis=1) - 1.0)
    assert np.max(drift) < 1e-12


@pytest.mark.parametrize("system", [CartesianPendulum(), GuidedDoublePendulum(), chain()])
def test_increments_of_constraints_over_small_steps_add_up_to_them(system):
    # Steps of 1e-7 s take the integral of dPhi/dt for Phi; one wrong weight of 5/18 would leave
    # 1e-7 m of the 1e-5 m that points move.
    run = simulate(system, 100 * 1e-7, HHT(1e-7))
    assert len(run.t) == 101
    first = system.constraint(0.0, run.q[0])
    for t, q in zip(run.t.tolist(), run.q, strict=True):
        np.testing.assert_allclose(system.constraint(t, q), first, atol=1e-13, rtol=0)


def test_no_step_far_from_balance_is_taken_for_round_off():
    # Corrections are small since the rod is stiff against its step, not since it has converged.
    row = measure(Case("", Rod(length=1e-6, spin=0.0).scene, 2.0**-7, 8))
    assert row.clean
    assert not row.survived
    assert "did not converge" in row.message


@pytest.mark.parametrize(
    "units",
    [
        Units(10.0**i, 10.0**j, 10.0**k)
        for i, j, k in [(7, 0, 0), (-7, 0, 0), (0, 7, 0), (0, -7, 0), (0, 0, 7), (0, 0, -7)]
    ],
)
def test_a_rod_scales_over_fourteen_orders_of_magnitude(units):
    rod = Rod()
    runs = [simulate(rod.scene(u), 0.25 * u.time, HHT(2.0**-7 * u.time)) for u in (Units(), units)]
    base, other = (rod.arm(run, u) for run, u in zip(runs, (Units(), units), strict=True))
    np.testing.assert_allclose(other, base, atol=1e-11, rtol=0)
    reactions = runs[0].lam, runs[1].lam / units.force
    np.testing.assert_allclose(*reactions, atol=1e-10 * np.max(np.abs(runs[0].lam)), rtol=0)


def test_a_row_tells_a_refusal_in_words():
    row = measure(Case("", Rod().scene, 1e-2, 4, alpha=-0.4))
    assert row.clean
    assert "hht_alpha" in row.message


def test_steps_whose_forces_are_mostly_round_off_are_counted():
    counts = [
        simulate(Rod(modulus=E).scene(), 8 * 2.0**-7, HHT(2.0**-7)).statistics.round_off_steps
        for E in (1e7, 1e13, 1e16)
    ]
    assert counts == [0, 8, 8]


@pytest.mark.parametrize("step", [1e-200, 1e-160, 1e200])
def test_a_step_whose_square_is_no_number_is_refused(step):
    with pytest.raises(InvalidInputError, match=r"HHT\.step"):
        HHT(step)


@pytest.mark.parametrize("t_end", [1e-160, 1e200])
def test_an_end_whose_square_is_no_number_is_refused(t_end):
    with pytest.raises(InvalidInputError, match="t_end"):
        simulate(CartesianPendulum(), t_end, HHT(rtol=1e-3))
