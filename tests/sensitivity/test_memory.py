"""`gradient(..., memory=)`: the same gradient, by repeating as few steps as can be."""

import importlib
import tracemalloc
from functools import cache
from math import comb

import numpy as np
import pytest

from ancfdae import (
    HHT,
    IDA,
    Adjoint,
    AtTimes,
    DirectDifferentiation,
    Integral,
    PrescribedSteps,
    SmoothMaximum,
    Terminal,
    assemble,
    gradient,
    gradients,
    simulate,
)
from ancfdae.errors import InvalidInputError, MissingPackageError, UnfinishedRunError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.observables import custom, design_value, kinetic_energy, position, reaction
from ancfdae.results import Verdict
from ancfdae.sensitivity.adjoint import division, size_of
from tests.support.mechanisms import CartesianPendulum
from validation.performance.scale import cantilever
from validation.scenes import pendulum

TIP = MaterialPoint("pendulum", 1.0)
DESIGN = ["pendulum.height", "pendulum.youngs_modulus", "pendulum.length"]
SYSTEM = assemble(pendulum(elements=1, youngs_modulus=1e6, damping_time=1e-3), DESIGN)
STEPS, STEP = 24, 2.0**-8
EVEN = HHT(STEP)
UNEVEN = HHT(
    PrescribedSteps(tuple(np.cumsum([0.0, *(STEP * (1 + np.arange(STEPS) % 3))]).tolist()))
)
OBJECTIVES = [
    Integral(kinetic_energy() * design_value("pendulum.height")) / Terminal(position(TIP, 0)),
    SmoothMaximum(position(TIP, 1) ** 2, 30.0)
    + AtTimes(reaction("pin(pendulum@0)", 1), [0.0, 0.08]),
]


def t_end(integrator):
    return STEPS * STEP if integrator is EVEN else UNEVEN.steps.times[-1]


@cache
def whole(integrator):
    return gradients(SYSTEM, OBJECTIVES, t_end(integrator), integrator, method=Adjoint())


def bytes_for(rows):
    """Return the bytes of which half hold three copies of the states at `rows` times."""
    return 1.001 * 2 * 3 * 8 * (3 * SYSTEM.n_q + SYSTEM.n_lam + 1) * rows


@pytest.mark.parametrize("integrator", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("rows", [3, 8, 1000])
def test_the_gradient_is_that_of_the_whole_run(integrator, rows):
    parts = gradients(SYSTEM, OBJECTIVES, t_end(integrator), integrator, memory=bytes_for(rows))
    for a, b in zip(whole(integrator), parts, strict=True):
        # Newton's method begins a part with a matrix of its own: its tolerance of 1e-14, amplified
        # in the multipliers and over 24 steps.
        assert b.value == pytest.approx(a.value, rel=1e-11)
        np.testing.assert_allclose(b.gradient, a.gradient, rtol=1e-10)
        assert b.solution.t[-1] == a.solution.t[-1]


def repetitions(parts, kept):
    """Return how many parts are stepped over: Griewank & Walther (2000), theorem 1.

    With C(kept + r - 1, r - 1) < parts <= C(kept + r, r) reversing takes at least
    r parts - C(kept + r, r - 1) of them, and one more each to hold it for the pass back.
    """
    r = next(r for r in range(1, parts + 1) if comb(kept + r, r) >= parts)
    return r * parts - comb(kept + r, r - 1) + parts


@pytest.mark.parametrize("rows", [2, 3, 5])
def test_steps_are_repeated_as_the_schedule_predicts(rows):
    memory = bytes_for(rows)
    length, kept = division(SYSTEM, STEPS, memory)
    assert length == rows - 1
    run = gradient(SYSTEM, OBJECTIVES[0], STEPS * STEP, EVEN, memory=memory).solution
    assert run.statistics.steps == repetitions(STEPS // length, kept) * length > STEPS


def test_a_run_that_fits_is_taken_once():
    run = gradient(SYSTEM, OBJECTIVES[0], STEPS * STEP, EVEN, memory="1 MB").solution
    assert run.statistics.steps == STEPS
    assert len(run.t) == STEPS + 1


def own(t, q, v, lam, b):
    return q[:, 0] ** 2 * b[0] + lam[:, 0]


def test_a_system_of_your_own_has_it_too():
    given = CartesianPendulum(spin=1.0), Integral(custom(own)), 1.0, HHT(2.0**-6)
    a, b = gradient(*given, method=Adjoint()), gradient(*given, memory=3000)
    np.testing.assert_allclose(b.gradient, a.gradient, rtol=1e-10)
    assert b.solution.statistics.steps > a.solution.statistics.steps


def test_small_steps_that_jump_are_pulled_back_from_the_states_that_they_began_with():
    # The first step of a part is three times, or a third of, the last one of the part before. With
    # the acceleration of that step the row of the constraints would err by 2e-4. What round-off of
    # the constraints may disturb is 1e-8 of the motion in each of 24 steps.
    t = np.cumsum([0.0, *(1e-5 * (1 + 2 * (np.arange(STEPS) % 2)))])
    system = CartesianPendulum(spin=5.0, angle=0.3)
    given = system, Integral(custom(own)), float(t[-1]), HHT(PrescribedSteps(tuple(t.tolist())))
    rows = 1.001 * 2 * 3 * 8 * (3 * system.n_q + system.n_lam + 1) * 2
    a, b = gradient(*given, method=Adjoint()), gradient(*given, memory=rows)
    assert b.solution.statistics.steps > a.solution.statistics.steps
    np.testing.assert_allclose(b.gradient, a.gradient, rtol=1e-6)


def test_a_run_that_ends_early_is_told():
    with pytest.raises(UnfinishedRunError) as caught:
        gradient(SYSTEM, OBJECTIVES[0], 16.0, HHT(4.0, max_iterations=1), memory=bytes_for(3))
    assert caught.value.solution.outcome.verdict is Verdict.NO_CONVERGENCE


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"memory": "much"}, "memory: must be a size"),
        ({"memory": "1e400 MB"}, "memory: must be a size"),
        ({"memory": "200 MiB"}, "memory: must be a size"),
        ({"memory": -1.0}, "memory: must be positive"),
        ({"memory": "0 MB"}, "memory: must be a size"),
        ({"memory": 1.0}, r"memory: must be .* MB or more for 12 coordinates"),
        ({"method": DirectDifferentiation()}, "memory: limits the adjoint method only"),
        ({"integrator": IDA(1e-6)}, "Adjoint: needs an integrator with an adjoint"),
        ({"integrator": HHT(rtol=1e-3)}, r"HHT\.steps: needs steps that are known"),
    ],
)
def test_bad_input_is_refused(change, match):
    given = {"integrator": EVEN, "memory": "1 kB"} | change
    with pytest.raises(InvalidInputError, match=match):
        gradient(SYSTEM, OBJECTIVES[0], STEPS * STEP, **given)


def test_sizes_are_read_as_they_are_written():
    assert [size_of(x) for x in (7, "7 B", "1.5kB", "200 MB", "2e1 GB")] == [7, 7, 1500, 2e8, 2e10]


def test_a_missing_package_is_named(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(MissingPackageError, match=r"ancfdae\[checkpoints\]"):
        gradient(SYSTEM, OBJECTIVES[0], STEPS * STEP, EVEN, memory=bytes_for(3))


def test_an_element_takes_at_most_40_kilobytes():
    # Of the assembled system and a short run, at their largest.
    fewer, more = (largest(cantilever(n)) for n in (100, 500))
    assert (more - fewer) / 400 < 40e3


def largest(scene):
    tracemalloc.start()
    try:
        simulate(assemble(scene), 4 * STEP, HHT(STEP))
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
