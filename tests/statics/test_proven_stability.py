"""Stability that one factorisation proves, and what searches for equilibria do not do twice."""

from unittest import mock

import numpy as np
import pytest
import scipy

from ancfdae import (
    Beam,
    Clamp,
    Material,
    Pin,
    PointForce,
    RigidBody,
    Scene,
    assemble,
    equilibrium,
)
from ancfdae.equations import saddle_points
from ancfdae.errors import RedundantConstraintsError
from ancfdae.sections import Rectangle
from ancfdae.statics import search
from ancfdae.statics import search as ways
from ancfdae.statics.balance import Balance
from ancfdae.statics.softness import Softness, softest
from validation.peers.cables import Elastica
from validation.peers.loops import frame

STEEL = Material(7850, 2.1e11, 0.3)


def loaded(cells, force):
    """Return a frame with forces along the tops of its columns."""
    scene = frame(cells)
    columns = [beam for beam in scene.beams if beam.name.startswith("c")]
    loads = [PointForce(column.at_end, (0, -force), name=f"on {column.name}") for column in columns]
    return assemble(Scene(scene.beams, scene.joints, loads=loads))


def least_stiffness(soft):
    """Return the smallest eigenvalue of K on the constraints, in the norm of D, by LAPACK."""
    system = soft.balance.system
    N = scipy.linalg.null_space(system.constraint_pattern.dense(soft.Phi_q))
    K, D = N.T @ system.pattern.dense(soft.K) @ N, N.T @ (soft.D[:, None] * N)
    return scipy.linalg.eigvalsh((K + K.T) / 2, D, subset_by_index=[0, 0])[0]


@pytest.mark.parametrize(("force", "stable"), [(0.0, True), (1e7, True), (2e9, False)])
def test_what_is_proven_is_what_eigenvalues_of_lapack_say(force, stable):
    system = loaded(4, force)
    found = equilibrium(system)
    soft = softest(Balance(system, 0.0, found.q, found.lam), 1.0, found.q, found.lam)
    assert (least_stiffness(soft) > 0) == stable
    assert soft.definite is stable
    assert soft.stable is stable
    assert (found.outcome.stable_to is None) is stable


def test_a_frame_takes_no_motions_and_one_beam_no_proof_by_fronts():
    """Seven factorisations: five of Newton's method with the last digits, and two proofs."""
    system = loaded(4, 1e5)
    with mock.patch.object(Softness, "_softest", property(lambda _: pytest.fail("motions"))):
        found = equilibrium(system)
    assert found.outcome.success
    assert found.statistics.factorisations == 7
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.02, 0.02), STEEL)
    bent = assemble(Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at_end, (0, -10))]))
    fails = mock.Mock(side_effect=AssertionError("stiffness"))
    with mock.patch.object(search, "softest", fails), mock.patch.object(ways, "softest", fails):
        assert equilibrium(bent).outcome.success


def test_a_solution_too_far_away_is_not_solved_for_again():
    """Of P L^2 = 3 E I the full load is reached from half of it, and known before."""
    system = assemble(Elastica(8).scene())
    solved, solve = [], Balance.solve

    def watched(self, s, *rest, **more):
        solved.append(s)
        return solve(self, s, *rest, **more)

    with mock.patch.object(Balance, "solve", watched):
        found = equilibrium(system)
    assert solved == [1.0, 0.5]
    assert (found.statistics.steps, found.statistics.rejected) == (2, 1)
    # The same from a start near it, and in a hundred steps.
    again = equilibrium(system, start=found)
    np.testing.assert_allclose(again.q, found.q, rtol=0, atol=1e-12)
    # Mattiasson (1981): a cantilever under P L^2 / E I = 3 sinks by 0.60325 of its length.
    end = found.solution.position(Elastica(8).point)[-1]
    assert -end[1] / 1.2 == pytest.approx(0.60325, abs=2e-3)


def test_a_jump_to_another_path_stays_refused_from_places_in_between():
    """A shallow arch snaps through: the far solution is on no smooth path from any place before."""
    h, steel = 0.02, STEEL
    left = Beam("left", (-1, 0), (0, 0.06), 6, Rectangle(h, h), steel)
    right = Beam("right", (0, 0.06), (1, 0), 6, Rectangle(h, h), steel)
    joints = [Pin(left.at_start), Pin(left.at_end, right.at_start), Pin(right.at_end)]
    # von Mises truss: the limit load is 2 E A sin^3 / (3 sqrt 3) of a flat truss, twice exceeded.
    limit = 2 * steel.youngs_modulus * h**2 * 0.06**3 / (3 * np.sqrt(3))
    over, under = (
        equilibrium(Scene([left, right], joints, loads=[PointForce(left.at_end, (0, -x * limit))]))
        for x in (2.0, 0.8)
    )
    assert under.outcome.success
    assert under.solution.position(left.at_end)[-1][1] > 0
    # It ends at the limit point, or settles below: it never claims the arch to be above.
    if over.outcome.success:
        assert over.solution.position(left.at_end)[-1][1] < 0


def test_rows_are_checked_again_when_weights_have_moved_far():
    """Rows stay independent with nearly the same weights: they are not checked again."""

    def arm(mass):
        body = RigidBody("arm", (0.5, 0), mass, mass / 12)
        return Scene(bodies=[body], joints=[Pin(body.at(-0.5))], gravity=(0, -9.81))

    system = assemble(arm(1.0), ["arm.mass", "arm.inertia"])
    checks, check = [], saddle_points.refuse_redundant

    def counted(*args):
        checks.append(args[0].b[0])
        return check(*args)

    with mock.patch.object(saddle_points, "refuse_redundant", counted):
        for mass in (1.0, 1.5, 3.0, 3.9, 4.5, 9.0, 17.0, 19.0):
            saddle_points.saddle_point(system.with_values(np.array([mass, mass / 12])), 0.0)
    assert checks == [1.0, 4.5, 19.0]
    body = RigidBody("arm", (0.5, 0), 1.0, 0.1)
    twice = Scene(bodies=[body], joints=[Pin(body.at(-0.5)), Pin(body.at(-0.5), name="again")])
    with pytest.raises(RedundantConstraintsError, match="again"):
        equilibrium(twice)
