"""The woodpecker toy: three contacts with friction against an integration of its own."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    ImpactLaw,
    RestModes,
    Terminal,
    gradient,
    gradients,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import custom
from validation.events.minimal import differences
from validation.events.woodpecker import START, Woodpecker

HEIGHT = custom(lambda t, q, v, lam, b: q[:, 0] + 1e-3 * v[:, 3] + 0.1 * q[:, 3], "height")


def height_by_twin(b, t_end):
    q, u, _ = Woodpecker.twin(b, t_end)
    return q[0] + 1e-3 * u[2] + 0.1 * q[2]


@pytest.mark.parametrize("law", ImpactLaw)
def test_woodpecker_meets_the_events_of_its_twin(law):
    """Through impacts of all three contacts, sliding up and down, sticking, and leaving."""
    toy, t_end = Woodpecker(), 0.142
    run = simulate(toy, t_end, DOP853(1e-10), events=toy.events(law), modes=toy.modes())
    q, u, twin = Woodpecker.twin(np.array(START), t_end, law is ImpactLaw.POISSON)
    np.testing.assert_allclose([x.time for x in run.events], [t for t, _ in twin.events], atol=1e-9)
    modes = ["start", "start", "upper rises", "start", "start"]
    modes += ["lower falls", "lower sticks", "lower falls", "start"]
    assert [x.mode for x in run.events] == modes
    np.testing.assert_allclose(run.q[-1][[0, 1, 3]], q, atol=1e-8)
    np.testing.assert_allclose(run.v[-1][[0, 1, 3]], u, rtol=1e-6, atol=1e-8)


def test_gradient_through_a_cycle_follows_differences_of_the_twin():
    toy, b, t_end = Woodpecker(), np.array(START), 0.1
    slopes = differences(lambda x: height_by_twin(x, t_end), b, 2e-5)
    found = gradient(
        toy, Terminal(HEIGHT), t_end, DOP853(1e-12), events=toy.events(), modes=toy.modes()
    )
    assert found.value == pytest.approx(height_by_twin(b, t_end), rel=1e-11)
    np.testing.assert_allclose(
        found.gradient * b, slopes * b, atol=1e-7 * np.max(np.abs(slopes * b))
    )


def test_exact_methods_agree_through_a_cycle():
    toy = Woodpecker()
    direct, adjoint, stepped = (
        gradient(
            toy, Terminal(HEIGHT), 0.145, HHT(1e-3), method=method, events=toy.events(),
            modes=toy.modes(),
        ).gradient
        * START
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    )  # fmt: skip
    size = np.max(np.abs(direct))
    np.testing.assert_allclose(adjoint, direct, rtol=0, atol=1e-10 * size)
    np.testing.assert_allclose(stepped, direct, rtol=0, atol=1e-10 * size)


def test_limit_cycle_is_found_by_newtons_method_with_exact_derivatives():
    toy = Woodpecker()
    # Place of the angle of the bird and of three rates among coordinates and velocities.
    places = [custom(lambda t, q, v, lam, b: q[:, 3], "phi_S")]
    places += [custom(lambda t, q, v, lam, b, k=k: v[:, k], f"rate {k}") for k in (0, 1, 3)]
    misses = []
    for _ in range(3):
        found = gradients(
            toy, [Terminal(x) for x in places], 0.2, DOP853(1e-11),
            events=[*toy.events(), toy.section()], modes=toy.modes(),
        )  # fmt: skip
        x, J = toy.b[5:], np.array([each.gradient[5:] for each in found])
        miss = np.array([each.value for each in found]) - x
        misses.append(np.max(np.abs(miss / x)))
        toy = toy.with_values(np.append(toy.b[:5], x - np.linalg.solve(J - np.eye(4), miss)))
    assert misses[2] < 1e-8 < misses[0]
    assert max(abs(np.linalg.eigvals(J))) < 1  # The cycle is stable.


def test_contact_that_stays_closed_without_a_mode_is_refused_in_words():
    toy = Woodpecker()
    beak, lower, upper = toy.events()
    upper = replace(upper, rest=RestModes(sticks="upper sticks"))
    with pytest.raises(InvalidInputError, match=r"Impact\.rest of 'upper'.*slides by \+1"):
        simulate(toy, 0.1, DOP853(1e-9), events=[beak, lower, upper], modes=toy.modes())
