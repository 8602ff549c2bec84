"""Tolerances on motions that pass close to a singular place, and on smooth paths.

The radius of a Kepler orbit is held against Kepler's equation.
"""

import math

import numpy as np
import pytest

from ancfdae import HHT, Radau, Terminal, gradient, simulate
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom
from ancfdae.studies.accuracy import hht_runs
from ancfdae.studies.accuracy.features import RESOLVED, Transition
from ancfdae.studies.accuracy.hht_runs import HHTRuns
from ancfdae.studies.accuracy.places import Places, Witness
from ancfdae.studies.accuracy.runs import Sample
from ancfdae.studies.accuracy.search import _Spent, _wanted
from ancfdae.studies.accuracy.waves import Wave
from tests.support.springs import Mass

RADIUS = custom(lambda t, q, v, lam, b: q[:, 0], "radius")
END = 2.0


class Radius(FormulaSystem):
    """The radius of an orbit with angular momentum sqrt(c), from its greatest distance 1."""

    n_q, n_lam, design_names = 1, 0, ("c",)

    def with_values(self, b):
        return Radius(b)

    def start(self):
        return np.array([1.0]), np.array([0.0])

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return [self.b[0] / q[0] ** 3 - 1 / q[0] ** 2]

    def position_constraint(self, t, q):
        return np.zeros(0, dtype=q.dtype)


def by_kepler(c):
    """Return the radius at END by Kepler's equation, E - e sin E = n t + pi; c may be complex."""
    e, a = 1 - c, 1 / (2 - c)
    mean, E = math.pi + END / a**1.5, math.pi + END / a**1.5
    for _ in range(50):
        E = E - (E - e * np.sin(E) - mean) / (1 - e * np.cos(E))
    return a * (1 - e * np.cos(E))


@pytest.mark.parametrize(("c", "tolerance"), [(0.02, 1e-6), (0.02, 1e-3), (0.2, 1e-8)])
def test_a_close_passage_is_no_jump_of_a_force(c, tolerance):
    """At c = 0.02 the radius passes 0.01: it was refused as needing 1e38 equal steps."""
    found = gradient(Radius([c]), Terminal(RADIUS), END, tolerance=tolerance)
    moved = by_kepler(c + 1e-30j)
    assert found.accuracy.reached
    slope = moved.imag / 1e-30
    assert abs(found.value - moved.real) <= tolerance * max(abs(moved.real), c * abs(slope))
    assert abs(found.gradient[0] - slope) <= tolerance * abs(slope)


def seer():
    return HHTRuns(_wanted(Radius([0.5]), [Terminal(RADIUS)], 1.0, 1e-3))


def looked(runs, monkeypatch, *found):
    """Take runs of 64, 128, ... steps that pass over transitions of the given widths or none."""
    each = iter(found)
    monkeypatch.setattr(
        hht_runs,
        "passed_over",
        lambda *_: RESOLVED if (x := next(each)) is None else Transition(math.ceil(10 / x), x),
    )
    for k in range(len(found)):
        steps = 64 * 2**k
        run = simulate(runs._system, 1.0, HHT(1 / steps, -0.05))
        runs.take(Sample([np.ones(1), np.ones(1)], run.estimated_errors, steps, None, run))
    return runs


def test_a_transition_counts_if_two_runs_find_its_width(monkeypatch):
    runs = looked(seer(), monkeypatch, 1e-6, 2e-6)
    assert runs.transitions == (10**7, 1e-6)
    assert runs.count == 10**7
    runs = looked(seer(), monkeypatch, 1e-6, 1e-5)
    # The next run decides.
    assert runs.transitions == (10**6, 1e-5)
    assert runs.count == 256
    runs = looked(seer(), monkeypatch, 1e-6, None)
    assert runs.transitions == RESOLVED
    assert len(runs.samples) == 1
    assert not runs.estimates


@pytest.mark.parametrize("integrator", [Radau(3 / 40), HHT(3 / 600)])
def test_a_smooth_path_has_no_kinks(integrator):
    """Chords that the ends of a run cut, and stages of Radau, looked like kinks of its forces."""
    system = Mass(lambda q: q**3)
    run = simulate(system, 3.0, integrator)
    assert Witness(system, (), 1e-7).of(run, 40) == Places(0, 0, ())


def test_steps_that_keep_a_wave_must_keep_its_phase():
    """Of the amplification matrix of HHT-I3: the phase at the end, with the number of steps."""
    runs, speed, alpha = seer(), 200.0, -0.05
    runs._taken, runs._whole = 500, 0.3
    runs._damped = [Wave(0.0, np.ones(1), np.zeros(0), speed, 0.0)]
    steps = runs._in_phase
    gamma, beta, W = 0.5 - alpha, (1 - alpha) ** 2 / 4, (speed / steps) ** 2
    left = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 + alpha) * W, 0, 1]])
    right = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [alpha * W, 0, 0]])
    angles = np.abs(np.angle(np.linalg.eigvals(np.linalg.solve(left, right))))
    off = abs(angles[np.argmin(abs(angles - speed / steps))] * steps - speed)
    # An extrapolated number keeps 0.15 of its bar.
    assert 0.5 < 0.15 * 0.3 * off / runs._tolerance < 2


def test_a_cost_that_is_not_known_is_not_out_of_reach():
    class Runs:
        name, error, work = "Radau", math.inf, 1e3

    spent = _Spent([])
    assert spent.price(Runs(), math.inf) == "Radau at a cost that is not known"
    Runs.work = math.inf
    assert spent.price(Runs(), math.inf) == "Radau out of reach"
