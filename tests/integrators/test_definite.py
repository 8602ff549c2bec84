"""Runs end where a mass matrix that depends on q ceases to be positive prescribed_motion."""

import math

import numpy as np
import pytest

from ancfdae import DOP853, HHT, IDA, Radau, simulate
from ancfdae.errors.outcomes import Verdict
from ancfdae.extend import FormulaSystem
from ancfdae.integrators import prescribed_motion
from ancfdae.integrators.prescribed_motion import indefinite
from ancfdae.integrators.recorder import Rows


class Vanishing(FormulaSystem):
    """q q'' = -b with q(0) = 1 at rest: q'^2 = -2 ln q, so q = 0 at t = sqrt(pi / 2)."""

    n_q, n_lam = 1, 0
    design_names = ("b",)

    def __init__(self, b=(1.0,)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.ones(1) + 0 * self.b[0], 0 * self.b

    def mass_matrix(self, q):
        return np.array([[q[0]]])

    def force(self, t, q, v):
        return -self.b[0] + 0 * q

    def position_constraint(self, t, q):
        return np.array([])


class Beads(Vanishing):
    """Two coordinates whose sum is fixed; the mass of the second one is its position."""

    n_q, n_lam = 2, 1

    def start(self):
        return np.array([0.0, 1.0]) + 0 * self.b[0], np.array([1.0, -1.0]) + 0 * self.b[0]

    def mass_matrix(self, q):
        return np.array([[2.0, 0 * q[0]], [0 * q[0], q[1]]])

    def position_constraint(self, t, q):
        return np.array([q[0] + q[1] - 1])


@pytest.mark.parametrize(
    ("integrator", "step"),
    [(HHT(0.00251), 0.00251), (HHT(0.000488), 0.000488), (HHT(1e-4), 1e-4), (Radau(2**-8), 2**-8)],
)
def test_no_step_passes_over_a_mass_of_zero(integrator, step):
    run = simulate(Vanishing(), 3.0, integrator)
    end = math.sqrt(math.pi / 2)
    assert not run.outcome.success
    assert end - 3 * step < run.outcome.time < end
    assert (run.q > 0).all()
    if run.outcome.verdict is Verdict.INDEFINITE:
        assert "ceases to be positive definite" in str(run.outcome)


def test_the_outcome_says_that_the_mass_is_indefinite():
    assert simulate(Vanishing(), 3.0, HHT(0.000488)).outcome.verdict is Verdict.INDEFINITE


@pytest.mark.parametrize("integrator", [HHT(2**-8), Radau(2**-8), DOP853(1e-8)])
def test_a_negative_mass_that_a_heavier_one_carries_is_permitted(integrator):
    """Only (2 + q_1) / 2 in the permitted direction (1, -1) has to be positive."""
    run = simulate(Beads(), 1.5, integrator)
    assert run.outcome.success
    assert run.q[-1, 1] < -0.1


class Coasting(Vanishing):
    """(1 - q) q'' = 0 with q'(0) = 1: the uniform motion satisfies this also beyond q = 1."""

    def start(self):
        return 0 * self.b, 1 + 0 * self.b

    def mass_matrix(self, q):
        return np.array([[1 - q[0]]])

    def force(self, t, q, v):
        return 0 * q


@pytest.mark.parametrize("integrator", [HHT(rtol=1e-5), Radau(rtol=1e-3), Radau(rtol=1e-7)])
def test_steps_under_error_control_end_at_the_time_at_which_the_mass_is_zero(integrator):
    """No error of the motion makes steps shorter there: a step ended at t = 0.5 before."""
    run = simulate(Coasting(), 2.0, integrator)
    assert run.outcome.verdict is Verdict.INDEFINITE
    assert run.outcome.time == pytest.approx(1.0, abs=1e-11)
    assert (run.q < 1).all()
    assert run.statistics.steps < 60


def test_ida_keeps_the_output_times_before_the_mass_is_zero():
    """A step passes over t = 1; output times from 0.59 on, before it, were lost."""
    run = simulate(Coasting(), 2.0, IDA(1e-8))
    assert not run.outcome.success
    assert 0.98 < run.outcome.time < 1.0
    assert run.q[:, 0] == pytest.approx(run.t, rel=1e-6)


def rows(*second):
    q = np.array([[1 - x, x] for x in second])
    return Rows(np.arange(len(q), dtype=float), q, 0 * q)


@pytest.mark.parametrize(
    ("second", "first"),
    [((1, 0.5, -0.5, -1.9), None), ((1, -1.9, -2.1, 1), 2), ((-2.1, -3.0), None), ((0, 0), None)],
)
def test_directions_that_constraints_permit_count(second, first):
    assert indefinite(Beads(), rows(*map(float, second))) == first


def test_blocks_of_matrices_are_examined_in_their_order(monkeypatch):
    monkeypatch.setattr(prescribed_motion, "_ENTRIES", 8)
    assert indefinite(Beads(), rows(1.0, 0.5, 0.2, -1.9, -2.1, -2.2, 1.0)) == 4


def test_units_of_coordinates_do_not_matter():
    class Small(Beads):
        def mass_matrix(self, q):
            return 1e-30 * Beads.mass_matrix(self, q)

    assert indefinite(Small(), rows(1.0, -1.9, -2.1)) == 2
