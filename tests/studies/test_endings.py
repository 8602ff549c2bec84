"""Searches by tolerance whose motion ends before `t_end` say so after a few runs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from ancfdae import DOP853, HHT, Radau, Terminal, gradient, simulate
from ancfdae.extend import FormulaSystem
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.observables import custom
from ancfdae.sensitivity.method import UnfinishedRunError
from ancfdae.studies.accuracy import search
from ancfdae.studies.accuracy.endings import Ending

END = Terminal(custom(lambda t, q, v, lam, b: q[:, 0]))


class Falling(FormulaSystem):
    """One coordinate q, at first 1, with a force that grows with the design variable."""

    n_q, n_lam = 1, 0
    design_names = ("b",)
    v0 = 0.0

    def __init__(self, b=(1.0,)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.ones(1) + 0 * self.b[0], self.v0 + np.zeros(1) * self.b[0]

    def mass_matrix(self, q):
        return np.eye(1)

    def position_constraint(self, t, q):
        return np.array([])


class Root(Falling):
    """The root of a coordinate that becomes negative."""

    def force(self, t, q, v):
        return -self.b[0] - np.sqrt(q)


class Growing(Falling):
    """A force that drives q to infinity in a finite time."""

    v0 = 1.0

    def force(self, t, q, v):
        return 4 * self.b[0] * q**3


class Vanishing(Falling):
    """A mass that becomes zero."""

    def mass_matrix(self, q):
        return np.array([[q[0]]])

    def force(self, t, q, v):
        return -self.b[0] + 0 * q


class Passed(Falling):
    """A mass 1 - q and a force b (1 - q): the motion t + b t^2 / 2 passes q = 1 smoothly."""

    v0 = 1.0

    def start(self):
        q, v = super().start()
        return q - 1, v

    def mass_matrix(self, q):
        return np.array([[1 - q[0]]])

    def force(self, t, q, v):
        return self.b[0] * (1 - q)


class Orbit(Falling):
    """The distance of a planet from its sun, which it passes closely."""

    def force(self, t, q, v):
        return -self.b[0] / q**2 + 0.003 / q**3


class Critical(Falling):
    """A stiff spring with critical damping, whose support oscillates."""

    design = (1e6, 2e3)
    design_names = ("k", "c")

    def __init__(self, b=design):
        super().__init__(b)

    def start(self):
        return 0 * self.b[:1], 0 * self.b[:1]

    def force(self, t, q, v):
        return -self.b[0] * (q - np.sin(t)) - self.b[1] * v


# Times from the conserved energies.
ENDS = {
    Root: quad(lambda q: (2 * (1 - q) + 4 / 3 * (1 - q**1.5)) ** -0.5, 0, 1)[0],
    Growing: quad(lambda q: (2 * q**4 - 1) ** -0.5, 1, np.inf)[0],
    Vanishing: math.sqrt(math.pi / 2),
    Passed: math.sqrt(3) - 1,
}


@pytest.fixture
def settings(monkeypatch):
    """The settings of the runs of a search, in their order."""
    made, take = [], search._Spent.take

    def counted(self, runs, measure):
        made.append(runs.setting)
        return take(self, runs, measure)

    monkeypatch.setattr(search._Spent, "take", counted)
    return made


@pytest.mark.parametrize("kind", ENDS)
def test_a_motion_that_ends_early_needs_few_runs(kind, settings):
    with pytest.raises(UnfinishedRunError, match="The motion ends there") as raised:
        gradient(kind(), END, 3.0, tolerance=1e-2)
    assert len(settings) <= 4
    outcome = raised.value.solution.outcome
    assert outcome.time == pytest.approx(ENDS[kind], abs=1e-4)
    assert f"t = {outcome.time:.6g}" in str(raised.value)


def test_a_close_passage_that_coarse_runs_miss_is_no_end():
    system = Orbit()
    ending = Ending(InitialValueProblem.of(system, 1.6), 1.6, 1e-3)
    coarse = HHT(0.025)
    run = simulate(system, 1.6, coarse)
    assert not run.outcome.success
    for _ in range(3):
        ending.require_motion(coarse, run)


def test_runs_that_fail_long_before_the_end_of_the_motion_do_not_tell_it():
    system = Root()
    ending = Ending(InitialValueProblem.of(system, 3.0), 3.0, 1e-3)
    fine = HHT(1e-3)
    run = simulate(system, 3.0, fine)
    early = replace(run, outcome=replace(run.outcome, time=1.0))
    for _ in range(3):
        ending.require_motion(fine, early)
    with pytest.raises(UnfinishedRunError):
        ending.require_motion(fine, run)


def test_long_runs_of_stiff_lists_of_operations_are_priced_as_measured(settings):
    """A run of HHT-I3 of 16384 steps takes a second, runs of high order a fortieth of it."""
    result = gradient(Critical(), END, 3.0, tolerance=1e-6)
    k, c = Critical.design
    # The forced motion alone: q = Im(k e^(i t) / (k + i c - 1)) after the transient.
    h = k + 1j * c - 1
    phase = np.exp(3j)
    exact = [(phase * (h - k) / h**2).imag, (-1j * k * phase / h**2).imag]
    assert result.value == pytest.approx((k * phase / h).imag, rel=1e-6)
    assert result.gradient == pytest.approx(exact, rel=1e-5)
    assert isinstance(settings[-1], DOP853 | Radau)
    assert max(3.0 / x.steps.step for x in settings if isinstance(x, HHT)) < 5000
