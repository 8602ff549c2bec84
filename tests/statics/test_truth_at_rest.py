"""Every success of a search on random scenes is true; `validation.outcomes` draws 500 of them."""

import numpy as np
import pytest

from ancfdae import assemble, equilibrium
from validation.outcomes import Truth, checked, exact_forces, random_scene, unbalanced


@pytest.mark.parametrize("first", range(0, 40, 10))
def test_outcomes_of_random_scenes_hold(first):
    seeds = range(first, first + 10)
    truths = {seed: checked(random_scene(seed)) for seed in seeds}
    assert {seed: truth.wrong for seed, truth in truths.items() if truth.wrong} == {}
    # Some of any ten are found, or nothing is checked.
    assert {"stable", "unstable"} & {truth.kind for truth in truths.values()}


def test_a_bar_beside_a_rigid_link_that_is_clamped_has_not_buckled():
    """The link has no stiffness but round-off of its reactions: -1 motions were counted."""
    assert checked(random_scene(219)) == Truth("stable")


def test_the_check_sees_what_does_not_hold():
    for seed in range(40):
        scene = random_scene(seed)
        if checked(scene).kind == "stable":
            break
    found, system = equilibrium(scene), assemble(scene)
    exact = exact_forces(system, found.q)
    ours = system.force(0.0, found.q, 0 * found.q)
    # Forces in double are those in long double, to the round-off of the summed terms.
    blur = np.max(system.pattern.dot(np.abs(_K(system, found)), np.abs(found.q)))
    assert np.max(np.abs(ours - exact)) <= 8 * np.finfo(float).eps * blur
    assert unbalanced(scene, found) == ""
    found.q[:] += 1e-6 * np.max(np.abs(found.q)) * np.cos(np.arange(system.n_q))
    assert "unbalanced" in unbalanced(scene, found)


def _K(system, found):
    rest = np.zeros((1, system.n_q))
    return system.linearise(np.zeros(1), found.q[None], rest, rest, found.lam[None]).f_q[0]
