"""Published problems of the report `test-set`: what its reference is made of, and a gradient."""

import numpy as np
import pytest

from ancfdae import Radau, gradient
from validation.test_set.car_axis import CarAxis
from validation.test_set.crank_with_spring import CrankWithSpring
from validation.test_set.flexible_crank import FlexibleCrank
from validation.test_set.pendulum import SimplePendulum
from validation.test_set.roberts import Roberts
from validation.test_set.squeezer import Squeezer

CONSTRAINED = [CarAxis, CrankWithSpring, FlexibleCrank, SimplePendulum, Squeezer]


@pytest.mark.parametrize("kind", CONSTRAINED)
def test_derivatives_by_hand_are_those_of_the_constraints(kind):
    problem, t = kind(), 0.013
    q, v = problem.start()
    # Any place will do: near the start, off the constraints.
    q = q + 1e-3 * np.cos(np.arange(problem.n_q))
    expected = problem.constraint_q(t, q).reshape(problem.n_lam, problem.n_q)
    size = np.max(np.abs(expected))
    assert np.max(np.abs(problem.jacobian(t, q) - expected)) < 1e-11 * size
    expected = problem.constraint(t, q, v + 1.0, np.zeros(problem.n_q))
    size = np.max(np.abs(expected))
    assert np.max(np.abs(problem.gamma(t, q, v + 1.0) - expected)) < 1e-10 * size


@pytest.mark.parametrize(
    ("kind", "t_end"),
    [
        (SimplePendulum, 0.1),
        (CrankWithSpring, 0.1),
        (CarAxis, 0.005),
        (Squeezer, 2e-4),
        (FlexibleCrank, 1e-4),
        (Roberts, 0.03),
    ],
)
def test_gradient_is_that_of_the_reference(kind, t_end):
    problem = kind()
    exact = problem.reference(t_end, 1e-11)
    ours = gradient(problem, problem.objective(), t_end, Radau(rtol=1e-7))
    sizes = np.abs(problem.b)
    apart = np.max(np.abs(ours.gradient - exact[1:]) * sizes)
    # The tolerance is relative to the largest coordinate, up to 200 times what is observed.
    assert abs(ours.value - exact[0]) < 2e-5 * abs(exact[0])
    assert apart < 2e-5 * np.max(np.abs(exact[1:]) * sizes)
