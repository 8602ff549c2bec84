"""Newton's method of HHT-I3: what its tolerance promises, and what a step costs."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    Material,
    PointForce,
    Scene,
    Terminal,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.errors import StabilityWarning
from ancfdae.extend import FormulaSystem, MaterialPoint, SystemProperties
from ancfdae.integrators.hht import step as continuation
from ancfdae.integrators.hht import step as newton
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum, chain
from tests.support.members import constraint_force
from validation.scenes import crank_slider, pendulum

TOLERANCES = np.logspace(-4, -10, 25)


def size(system, state, a, lam):
    """Size of accelerations and reactions, in units of force (docs/theory/05-hht-i3.md)."""
    t, q = state
    reaction = constraint_force(system, t, q, lam)
    weights = system.weights
    return np.sqrt(weights @ a**2) + np.sqrt((1 / weights) @ reaction**2)


def error(system, run, exact):
    """Error of A and lam at the end of a run, relative to the forces of the motion."""
    t, q, v, a, lam = (getattr(exact, name)[-1] for name in ("t", "q", "v", "a", "lam"))
    left = size(system, (t, q), run.a[-1] - a, run.lam[-1] - lam)
    load = np.sqrt((1 / system.weights) @ system.force(t, q, v) ** 2)
    return left / (size(system, (t, q), a, lam) + load)


@pytest.mark.parametrize("steps", [1, 2], ids=["one step", "two steps"])
@pytest.mark.parametrize(
    ("system", "h"), [(CartesianPendulum(-1.0, 2.0), 0.25), (chain(), 0.01)], ids=["rod", "chain"]
)
def test_newtons_method_leaves_what_its_tolerance_says(system, h, steps):
    exact = HHT(h, newton_tolerance=1e-14).integrate(system, steps * h)
    runs = [HHT(h, newton_tolerance=x).integrate(system, steps * h) for x in TOLERANCES]
    used = [error(system, run, exact) / x for run, x in zip(runs, TOLERANCES, strict=True)]
    # Where one more iteration is just saved, the error is that of the tolerance: measured 0.7 to
    # 4.5 times, since one rate tells it and the first of two steps hands its own on. At twice the
    # step the chain, whose start is projected, has two solutions, and tolerances choose.
    assert 0.2 < max(used) < 10


def test_newtons_method_takes_the_tolerance_as_documented():
    assert HHT(step=0.1).newton_tolerance == 1e-14
    assert HHT(rtol=1e-3).newton_tolerance == 1e-9
    assert HHT(rtol=1e-8).newton_tolerance == pytest.approx(1e-11, rel=1e-12)
    assert HHT(rtol=1e-12).newton_tolerance == 1e-14


@pytest.mark.parametrize("scene", [pendulum, crank_slider])
def test_a_step_takes_two_iterations_and_one_factorisation(scene):
    # As measured (docs/theory/05-hht-i3.md); the policy for the matrix is built on it.
    done = simulate(scene(), 0.25, HHT(2.0**-10)).statistics
    assert 2.0 <= done.iterations / done.steps < 2.4
    assert done.factorisations == done.steps


def loaded(force, elements=4):
    """A soft cantilever with a force across its end, all at once."""
    rod = Beam("rod", (0, 0), (1, 0), elements, Rectangle(0.02, 0.02), Material(2700.0, 1e8, 0.3))
    load = PointForce(rod.at_end, (0, force), name="load")
    return Scene([rod], [Clamp(rod.at_start)], loads=[load])


# Full steps of Newton's method alone do not finish any of them, with 60 iterations either.
STALLING = {
    "sudden load": (lambda: loaded(10.0, 8), 0.01, 20),
    "large step": (lambda: loaded(10.0), 0.05, 10),
}


@pytest.mark.parametrize("scene", [pendulum, crank_slider])
def test_nothing_changes_where_full_steps_converge(scene, monkeypatch):
    def refuse(*_):
        raise AssertionError("not needed")

    monkeypatch.setattr(continuation, "continued", refuse)
    assert simulate(scene(), 0.25, HHT(2.0**-7)).statistics.continued == 0


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
@pytest.mark.parametrize("name", STALLING)
def test_a_stalled_step_finds_the_solution_that_belongs_to_short_ones(name, monkeypatch):
    make, h, steps = STALLING[name]
    run = simulate(make(), h * steps, HHT(h))
    assert run.outcome.success, str(run.outcome)
    assert run.statistics.continued > 0
    # Fine strides along the branch, with whatever they take, end at the same solutions.
    monkeypatch.setattr(newton, "_CLOSE", 0.05)
    monkeypatch.setattr(continuation, "_AIM", 0.02)
    monkeypatch.setattr(continuation, "_LONGEST", 1.1)
    monkeypatch.setattr(continuation, "_MOST", 1000)
    fine = simulate(make(), h * steps, HHT(h))
    assert fine.statistics.iterations != run.statistics.iterations
    # Newton's method leaves 1e-14 of the forces, whatever it started from; stiff modes of the
    # chain of steps amplify it (measured: 1e-12).
    np.testing.assert_allclose(fine.q, run.q, atol=1e-9 * np.max(np.abs(run.q)), rtol=0)


@pytest.mark.filterwarnings("ignore::ancfdae.errors.StabilityWarning")
def test_statistics_count_what_shorter_steps_cost():
    run = simulate(loaded(10.0), 0.5, HHT(0.05)).statistics
    assert 0 < run.continued <= run.steps
    # Fifteen iterations in vain, and the way from short steps.
    assert run.iterations == run.residuals > 20 * run.continued
    assert run.rejected == 0


def test_controlled_steps_shrink_instead():
    # Where steps are controlled a smaller one is the cure.
    run = simulate(loaded(10.0), 0.25, HHT(rtol=1e-3)).statistics
    assert run.continued == 0


def test_a_run_that_needed_shorter_steps_is_differentiated_exactly():
    scene, design = loaded(10.0), ["load.force_y", "rod.youngs_modulus", "rod.height"]
    runs = [
        differentiate(scene, 0.2, HHT(0.05), design=design, method=method)
        for method in (DirectDifferentiation(), ComplexStep())
    ]
    assert runs[0].statistics.continued >= 3
    for name in ("q_b", "lam_b"):
        direct, exact = (getattr(run.sensitivities, name) for run in runs)
        scale = np.max(np.abs(exact), axis=(0, 1))
        # Both linearise at the same states, that Newton's method leaves at 1e-14 (measured: 4e-13).
        assert np.max(np.abs(direct - exact) / scale) < 1e-10
    tip = Terminal(position(MaterialPoint("rod", 1.0), 1))
    back, direct = (
        gradient(scene, tip, 0.2, HHT(0.05), design=design, method=method).gradient
        for method in (Adjoint(), DirectDifferentiation())
    )
    np.testing.assert_allclose(back, direct, rtol=1e-9)


def test_derivatives_of_a_run_that_needed_shorter_steps_are_those_of_the_call():
    scene, h, base = loaded(10.0), 0.05, 10.0
    tip = Terminal(position(MaterialPoint("rod", 1.0), 1))
    exact = gradient(
        scene, tip, 0.25, HHT(h), design=["load.force_y"], method=DirectDifferentiation()
    )
    assert exact.solution.statistics.continued > 0

    def value(force):
        run = simulate(scene.with_values({"load.force_y": force}), 0.25, HHT(h))
        return run.position(MaterialPoint("rod", 1.0))[-1, 1]

    d = 1e-5 * base
    found = (value(base + d) - value(base - d)) / (2 * d)
    # Truncation d^2 and round-off 1e-14/1e-5.
    assert exact.gradient[0] == pytest.approx(found, rel=1e-6)


class Wall(FormulaSystem):
    """A mass that is pushed all at once at t = 0.1 s, 5000 times as hard, against a steep wall."""

    n_q, n_lam, design_names = 1, 0, ("K",)
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def __init__(self, b=(40.0,)):
        super().__init__(b)

    def with_values(self, b):
        return Wall(b)

    def start(self):
        return np.zeros(1), np.zeros(1)

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        push = 1.0 + 5e3 / (1 + np.exp(-2000 * (t - 0.1)))
        return push - np.exp(self.b[0] * (q - 1.0))

    def position_constraint(self, t, q):
        return np.zeros(0) * q[0]


@pytest.mark.parametrize("step", [0.05, 0.02])
def test_a_correction_is_not_small_because_forces_got_huge(step):
    # Within the wall forces grow to 1e200, beside which any correction is round-off.
    with pytest.warns(StabilityWarning, match="too long to follow"):
        run = simulate(Wall(), 0.4, HHT(step))
    assert run.outcome.success, str(run.outcome)
    # exp(K (q - 1)) / K cannot exceed the work of the push, 5e3 q: q = 1.31 at most.
    assert 1.1 < np.max(run.q) < 1.32


@pytest.mark.parametrize(("away", "success"), [(0.0, True), (1.0, False)])
def test_iterating_on_counts_only_near_the_motion(away, success, monkeypatch):
    # Steps of 0.01 at a speed of 2: a solution a length of 1 away belongs to another motion.
    solve = newton.StepSolver.advance

    def stalled(self, step, patience=1):
        node = solve(self, step, patience)
        why = Failure(Verdict.NO_CONVERGENCE, 1.0)
        return why if patience == 1 else node._replace(q=node.q + away)

    monkeypatch.setattr(newton.StepSolver, "advance", stalled)
    monkeypatch.setattr(continuation, "continued", lambda solver, step, why: (why, 0.9))
    outcome = simulate(CartesianPendulum(-1.0, 2.0), 0.01, HHT(0.01)).outcome
    assert outcome.success is success


class LightAndHeld(FormulaSystem):
    """A light coordinate, driven to sin 3t by a steep constraint, beside a mass held by a spring.

    The constraint is e^(3 x) = e^(3 sin 3t). The spring of 1e6 N/m balances a force of 1e6 N.
    """

    n_q, n_lam, design_names = 2, 1, ("k",)

    def __init__(self, light, b=(1e6,)):
        self.light = light
        super().__init__(b)

    def with_values(self, b):
        return LightAndHeld(self.light, b)

    def start(self):
        return np.array([0.0, 1.0]), np.array([3.0, 0.0])

    def mass_matrix(self, q):
        return np.diag([self.light, 1.0])

    def force(self, t, q, v):
        return [0.0 * q[0], self.b[0] * (1.0 - q[1])]

    def position_constraint(self, t, q):
        return [np.exp(3.0 * q[0]) - np.exp(3.0 * np.sin(3.0 * t))]


@pytest.mark.parametrize(("light", "bound"), [(1e-6, 1e-14), (1e-10, 1e-11)])
def test_constraints_close_before_balanced_forces_end_a_step(light, bound):
    """Reactions on a light coordinate are far below the round-off of the forces that balance.

    So forces are in balance after the first iterations, while the constraint is still open: a step
    ends only where corrections of coordinates are lost, too. They are in the norm of masses, so
    an error of 8 eps / sqrt(light) may remain in x.
    """
    run = HHT(0.2).integrate(LightAndHeld(light), 1.5)
    assert run.outcome.success
    assert np.max(np.abs(run.q[:, 0] - np.sin(3.0 * run.t))) < bound
