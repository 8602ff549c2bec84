"""Equilibria by the kernel are those of Newton's method in Python, step by step."""

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    Beam,
    Clamp,
    FollowerForce,
    Material,
    Moment,
    Pin,
    PointForce,
    Scene,
    SpringDamper,
    assemble,
    equilibrium,
)
from ancfdae.equations import prepared
from ancfdae.equations.system import called_plan
from ancfdae.kernels import RULES, Model, narrow_order
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from ancfdae.statics.balance import Balance

SOFT = Material(1000.0, 1e7, 0.3)


def rod(elements=3, d=2, **settings):
    end = (1.0, 0.1, 0.0)[:d]
    return Beam("rod", (0.0,) * d, end, elements, Rectangle(0.05, 0.05), SOFT, **settings)


def held():
    beam = rod()
    loads = [
        PointForce(beam.at_end, (1.0, 4.0)),
        Moment(beam.at(0.5), -0.7),
        FollowerForce(beam.at(0.3), (0.0, 2.0)),
        SpringDamper(beam.at(0.8), 30.0, free_length=0.2, ground=(0.8, -0.3)),
    ]
    return Scene([beam], [Clamp(beam.at_start)], (0.0, -9.81), loads=loads)


def supported():
    """Held at both ends, so that K without constraints is not definite in any order."""
    beam = rod(6, element=CABLE_2D)
    force = PointForce(beam.at(0.5), (0.0, -2.0))
    return Scene([beam], [Pin(beam.at_start), Pin(beam.at_end)], loads=[force])


def in_space():
    beam = rod(2, 3)
    return Scene([beam], [Clamp(beam.at_start)], (0.0, -3.0, -9.81))


def weighed():
    """A pendulum with no stiffness but gravity; the search uses pseudo-transient continuation."""
    beam = rod()
    return Scene([beam], [Pin(beam.at_start)], (0.0, -9.81))


def buckled():
    beam = Beam("rod", (0, 0), (1, 0), 4, Rectangle(0.02, 0.02), SOFT)
    force = PointForce(beam.at_end, (-1.0, 0.0))
    return Scene([beam], [Clamp(beam.at_start)], loads=[force])


@pytest.mark.parametrize("make", [held, supported, in_space, weighed, buckled])
def test_both_ways_take_the_same_steps(make, monkeypatch):
    scene = make()
    compiled = equilibrium(scene)
    monkeypatch.setattr(prepared, "planned", called_plan)
    plain = equilibrium(scene)
    ours, theirs = compiled.outcome, plain.outcome
    assert ours.success
    assert (ours.verdict, ours.step, ours.downhill) == (
        theirs.verdict,
        theirs.step,
        theirs.downhill,
    )
    assert (ours.stable_to is None) == (theirs.stable_to is None)
    assert compiled.statistics.rejected == plain.statistics.rejected
    # Round-off of solutions with K, of (L/h)^2 units.
    for one, other in ((compiled.q, plain.q), (compiled.lam, plain.lam)):
        np.testing.assert_allclose(one, other, atol=1e-11 * np.max(np.abs(other), initial=1e-9))


def test_a_solution_tells_its_path_and_that_it_is_stable():
    system = assemble(supported())
    balance = Balance.of(system, 0.0, system.start()[0], np.zeros(system.n_lam))
    points = [balance.solve(s, balance.q_0, balance.lam_0) for s in (0.999, 1.0, 1.001)]
    assert all(point.definite for point in points)
    slope = (points[2].q - points[0].q) / 2e-3
    # 1e-6 of the third derivative.
    np.testing.assert_allclose(points[1].path[0], slope, atol=1e-5 * np.max(np.abs(slope)))
    compressed = assemble(buckled())
    last = equilibrium(compressed)
    balance = Balance.of(compressed, 0.0, last.q, last.lam)
    assert not balance.begun().definite
    assert last.outcome.verdict is Verdict.EQUILIBRIUM


def test_wrong_arrays_are_refused():
    system = assemble(held())
    balance = Balance.of(system, 0.0, system.start()[0], np.zeros(system.n_lam))
    plan = system.plan
    model = Model(plan, balance.matrices.layout(band=True), np.zeros(RULES), None)
    n_q, n_lam = system.n_q, system.n_lam
    q, lam = np.zeros(n_q), np.zeros(n_lam)
    factors = np.ones(1), *(plan.load_factors(np.zeros(1))[0] for _ in range(2))
    good = (q, lam, q.copy(), lam.copy()), (q, None, q, lam), factors, np.ones(11)
    for at, bad in (
        (0, (q, lam, q)),
        (0, (q[1:], lam, q, lam)),
        (0, (q, lam, q.astype(complex), lam)),
        (1, (q, q[1:], q, lam)),
        (1, (None, None, q, lam)),
        (2, (np.ones(2), *factors[1:])),
        (3, np.ones(10)),
    ):
        with pytest.raises((ValueError, TypeError)):
            model.rest(*good[:at], bad, *good[at + 1 :])
    patterns = *system.pattern.places, *system.constraint_pattern.places
    for at, bad in ((1, patterns[1] + 1), (0, patterns[0][:-1]), (3, patterns[3] - 1), (2, None)):
        with pytest.raises((ValueError, TypeError)):
            narrow_order(*patterns[:at], bad, *patterns[at + 1 :])
