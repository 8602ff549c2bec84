"""Equilibria: against theory, their derivatives, and what has none."""

import numpy as np
import pytest
import scipy

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    ContinuousAdjoint,
    CurvedBeam,
    DirectDifferentiation,
    Distance,
    DistributedForce,
    FiniteDifference,
    FollowerForce,
    Material,
    Moment,
    NodalState,
    Pin,
    PointForce,
    Revolute,
    Scene,
    SpringDamper,
    assemble,
    equilibrium,
    equilibrium_gradient,
    load_solution,
    modes,
)
from ancfdae.errors import (
    FreeMotionError,
    Interrupted,
    InvalidInputError,
    RedundantConstraintsError,
    UnfinishedRunError,
)
from ancfdae.extend import MaterialPoint
from ancfdae.observables import custom, multiplier, observe, position, reaction, strain_energy
from ancfdae.results import Equilibrium, EquilibriumOutcome, Verdict
from ancfdae.sections import Circle, Rectangle
from ancfdae.statics.balance import Balance
from ancfdae.statics.outcome import free_mechanism
from tests.support.mechanisms import CartesianPendulum, HeldDoublePendulum, WrittenPendulum, chain
from tests.support.members import constraint_force

G = 9.81
SOFT = Material(1000.0, 1e7, 0.3)


def rod(start=(0.0, 0.0), end=(1.0, 0.0), elements=4, material=SOFT, name="rod", size=0.05):
    return Beam(name, start, end, elements, Rectangle(size, size), material)


def unbalanced(scene, found):
    """Forces and gaps left, relative to the reactions and the size of the scene."""
    system = scene if not isinstance(scene, Scene) else assemble(scene)
    reaction = constraint_force(system, 0.0, found.q, found.lam)
    R = system.force(0.0, found.q, 0 * found.q) - reaction
    return max(
        np.max(np.abs(R)) / np.max(np.abs(reaction)), np.max(np.abs(system.constraint(0, found.q)))
    )


# ---------------------------------------------------------------- against theory


# Mattiasson 1981, recomputed by elliptic integrals: P L^2/(E I), u/L, w/L.
ELASTICA = [
    (1, 0.0564332363, 0.3017207738),
    (5, 0.3876283607, 0.7137915235),
    (10, *(0.5549955978,), 0.8106090249),
]


@pytest.mark.parametrize(("alpha", "shortening", "deflection"), ELASTICA)
def test_a_cantilever_is_the_elastica(alpha, shortening, deflection):
    E, h = 1e9, 0.02
    beam = rod(elements=64, material=Material(1000.0, E, 0.0), size=h)
    tip = PointForce(beam.at_end, (0.0, alpha * E * h**4 / 12))
    found = equilibrium(Scene([beam], [Clamp(beam.at_start)], loads=[tip]))
    assert found.outcome.success
    # 64 elements of h/L = 0.02: 7e-4 (slow convergence when thin, and shear).
    x, y = found.solution.position(beam.at_end)[0]
    assert (1 - x, y) == pytest.approx((shortening, deflection), abs=1e-3)


def test_a_cantilever_rolls_up_to_a_circle():
    # The loads that turn are scaled with the load: without that the path ends at 2 %.
    E, h = 1e9, 0.02
    beam = rod(elements=32, material=Material(1000.0, E, 0.0), size=h)
    moment = Moment(beam.at_end, 2 * np.pi * E * h**4 / 12)
    found = equilibrium(Scene([beam], [Clamp(beam.at_start)], loads=[moment]))
    assert found.outcome.success
    # One element more or less of the circle: its ends meet to the error of the mesh.
    assert np.max(np.abs(found.solution.position(beam.at_end))) < 0.02


@pytest.mark.parametrize("modulus", [1e7, 2e11])
@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0, 3.0, -np.pi / 2])
@pytest.mark.parametrize("origin", [0.0, 1e3])
def test_a_pendulum_hangs_wherever_it_starts(modulus, angle, origin):
    start = np.array([origin, origin])
    end = start + np.array([np.cos(angle), np.sin(angle)])
    beam = rod(start, end, material=Material(1000.0, modulus, 0.3))
    scene = Scene([beam], [Pin(beam.at_start)], gravity=(0.0, -G))
    found = equilibrium(scene)
    assert found.outcome.success
    weight = 1000.0 * 0.05**2 * G
    # The round-off of the axial stiffness E A / l eps |q| over the weight.
    noise = 4 * modulus * 0.05**2 * np.finfo(float).eps * (1 + origin) / weight
    assert unbalanced(scene, found) <= max(1e-10, 10 * noise)
    assert found.solution.reaction("pin(rod@0)")[0] == pytest.approx([0, weight], abs=1e-9 * weight)
    below = found.solution.position(beam.at_end)[0] - start
    # It hangs straight down, longer by rho g L^2 / 2 E of nearly plane strain.
    assert abs(below[0]) <= 1e-9 + 10 * noise
    assert -1.001 < below[1] < -1.0 + 1e-9


def test_newton_s_method_is_quadratic_at_what_was_found():
    scene = Scene([rod()], [Pin(rod().at_start)], gravity=(0.0, -G))
    found, system = equilibrium(scene), assemble(scene)
    balance = Balance.of(system, 0.0, found.q, found.lam)
    moved = found.q + 1e-5 * np.random.default_rng(1).standard_normal(system.n_q)
    again = balance.solve(1.0, moved, found.lam)
    # 1e-5, then its square times the ratio of axial to bending stiffness, then round-off.
    assert again.iterations <= 4
    np.testing.assert_allclose(again.q, found.q, atol=1e-12)


def gap():
    """The scene of all loads, and its end off the support that it is pinned to."""
    scene = bent()[0]
    support = Pin(scene.beams[0].at_end, ground=(0.997, 0.01), name="support")
    return Scene(scene.beams, [*scene.joints, support], scene.gravity, loads=scene.loads)


def test_the_tangent_is_the_derivative_of_the_equations_all_along_the_path():
    for system in (assemble(gap()), CartesianPendulum(0.4)):
        rng = np.random.default_rng(2)
        q_0 = system.start()[0]
        balance = Balance.of(system, 0.0, q_0, np.zeros(system.n_lam))
        q, lam = q_0 + 0.1 * rng.standard_normal(system.n_q), rng.standard_normal(system.n_lam)
        dq = rng.standard_normal(system.n_q)
        for s in (0.0, 0.4, 1.0):
            moved = q + 1e-30j * dq
            left = balance.unbalanced(moved, lam) - (1 - s) * balance.held_back(moved)
            K = system.pattern.dense(balance.tangent(s, q, lam))
            # Complex step; round-off.
            np.testing.assert_allclose(-K @ dq, left.imag / 1e-30, rtol=1e-9, atol=1e-9)


def test_the_path_closes_gaps_and_its_tangent_leads_along_it():
    system = assemble(gap())
    q_0, lam_0, s, ds = system.start()[0], np.zeros(system.n_lam), 0.3, 1e-3
    balance = Balance.of(system, 0.0, q_0, lam_0)
    point, ahead, behind = (balance.solve(x, q_0, lam_0) for x in (s, s + ds, s - ds))
    np.testing.assert_allclose(
        system.constraint(0.0, point.q), 0.7 * system.constraint(0.0, q_0), atol=1e-12
    )
    q_s, lam_s = point.path
    for ours, part in ((q_s, "q"), (lam_s, "lam")):
        slope = (getattr(ahead, part) - getattr(behind, part)) / (2 * ds)
        # ds^2 of the third derivative.
        np.testing.assert_allclose(ours, slope, atol=1e-4 * np.max(np.abs(ours)))
    found = equilibrium(gap())
    assert found.outcome.success
    assert found.solution.position(MaterialPoint("rod", 1.0))[0] == pytest.approx(
        (0.997, 0.01), abs=1e-12
    )


def test_reactions_sum_up_to_the_loads():
    a, b = rod(), rod((1.0, 0.0), (2.0, 0.3), name="b")
    force = PointForce(b.at(0.5), (3.0, -7.0))
    joints = [Pin(a.at_start), Pin(a.at_end, b.at_start, name="p"), Pin(b.at_end)]
    scene = Scene([a, b], joints, (0.0, -G), loads=[force])
    found = equilibrium(scene).solution
    total = found.reaction("pin(rod@0)")[0] + found.reaction("pin(b@1)")[0]
    weight = 1000 * 0.05**2 * (1 + np.hypot(1, 0.3)) * G
    # 1e-12 of the pull of the shallow chain, 1e2 times the loads.
    assert total == pytest.approx([-3.0, 7.0 + weight], abs=1e-9)


# ---------------------------------------------------------------- derivatives


def bent():
    beam = rod(elements=3)
    loads = [
        PointForce(beam.at_end, (1.0, 4.0), name="tip"),
        Moment(beam.at(0.5), -0.7, name="couple"),
        FollowerForce(beam.at(0.3), (0.0, 2.0), name="follow"),
        SpringDamper(beam.at(0.8), 30.0, free_length=0.2, ground=(0.8, -0.3), name="spring"),
    ]
    scene = Scene([beam], [Clamp(beam.at_start, name="wall")], (0.0, -G), loads=loads)
    names = ["rod.youngs_modulus", "rod.height", "rod.length", "rod.density", "tip.force_x"]
    return scene, [*names, "couple.moment", "follow.force_y", "spring.stiffness"], "wall"


def hanging():
    beam = rod(elements=3)
    scene = Scene([beam], [Pin(beam.at_start, name="wall")], (2.0, -G))
    return scene, ["rod.youngs_modulus", "rod.height", "rod.length", "rod.density"], "wall"


def spatial():
    nodes = np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.0], [0.7, 0.4, 0.0]])
    x = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.6, 0.8, 0.0]])
    y = np.stack([-x[:, 1], x[:, 0], x[:, 2]], axis=1)
    slopes = np.stack([x, y, np.tile([0.0, 0.0, 1.0], (3, 1))], axis=1)
    beam = CurvedBeam("rod", nodes, slopes, Rectangle(0.05, 0.04), SOFT)
    force = PointForce(beam.at_end, (0.0, 2.0, 3.0), name="tip")
    scene = Scene([beam], [Clamp(beam.at_start, name="wall")], loads=[force])
    return scene, ["rod.youngs_modulus", "rod.width", "rod.poisson_ratio", "tip.force_z"], "wall"


CASES = {"bent": bent, "hanging": hanging, "spatial": spatial}


@pytest.mark.parametrize("case", CASES)
def test_every_method_finds_the_same_gradient(case):
    scene, design, joint = CASES[case]()
    end = MaterialPoint("rod", 1.0)
    number = position(end, 1) + position(end, 0) * reaction(joint, 1) / 100
    number = number + multiplier(joint, 0) ** 2 / 1e4 + strain_energy()
    exact = equilibrium_gradient(scene, number, design=design, method=ComplexStep())
    scale = np.abs(exact.gradient)
    for method in (DirectDifferentiation(), Adjoint(), None):
        ours = equilibrium_gradient(scene, number, design=design, method=method)
        assert ours.value == pytest.approx(exact.value, rel=1e-13)
        assert np.all(np.abs(ours.gradient - exact.gradient) <= 1e-9 * np.max(scale))
        # Entry by entry 1e-7: the stiffest directions hold the round-off of E A / (E I / L^2).
        assert ours.gradient == pytest.approx(exact.gradient, rel=1e-7, abs=1e-18)
    central = FiniteDifference(1e-5, central=True)
    near = equilibrium_gradient(scene, number, design=design, method=central).gradient
    # (1e-5)^2 of the third derivative, and round-off 1e-12 over 1e-5.
    np.testing.assert_allclose(near, exact.gradient, rtol=1e-5, atol=1e-6 * np.max(scale) * 1e-3)


@pytest.mark.parametrize("case", CASES)
def test_sensitivities_are_those_of_the_call(case):
    scene, design, joint = CASES[case]()
    found = equilibrium(scene, design=design)
    for i, name in enumerate(design):
        value = found.solution.sensitivities.values[i]
        moved = [equilibrium(scene.with_values({name: value * (1 + s)})) for s in (1e-5, -1e-5)]
        for ours, part in ((found.q_b, "q"), (found.lam_b, "lam")):
            difference = (getattr(moved[0], part) - getattr(moved[1], part)) / (2e-5 * value)
            size = np.max(np.abs(getattr(found, part))) / abs(value)
            # As above; relative to the coordinates over the variable.
            np.testing.assert_allclose(ours[:, i], difference, atol=1e-6 * size)
    ours = found.solution.derivative(lambda run: run.reaction(joint))[0]
    for i in range(2):
        slope = equilibrium_gradient(scene, reaction(joint, i), design=design).gradient
        # The round-off of E A, 1e4 N, is 1e-12 N; derivatives carry it over their variable.
        noise = 1e-10 / np.abs(found.solution.sensitivities.values)
        assert np.all(np.abs(ours[i] - slope) <= noise + 1e-9 * np.abs(slope))
    assert np.all(
        found.solution.derivative(lambda run: run.velocity(MaterialPoint("rod", 1.0))) == 0
    )


def test_systems_of_any_kind_have_equilibria():
    for angle in (0.0, 0.3, 3.0, np.pi / 2):
        found = equilibrium(CartesianPendulum(angle))
        np.testing.assert_allclose([*found.q, *found.lam], [0, -1, 9.81], atol=1e-12)
        # q = (0, -L), lam = g / L.
        np.testing.assert_allclose(found.q_b, [[0, 0], [-1, 0]], atol=1e-12)
        np.testing.assert_allclose(found.lam_b, [[-9.81, 1]], atol=1e-11)
    np.testing.assert_allclose(equilibrium(WrittenPendulum()).q, [0, -1], atol=1e-12)
    for system in (HeldDoublePendulum(), chain(frequency=0.0)):
        height = custom(lambda t, q, v, lam, b: q[:, 1] * b[0] + lam[:, 0], "height")
        exact = equilibrium_gradient(system, height, method=ComplexStep()).gradient
        for method in (DirectDifferentiation(), Adjoint()):
            ours = equilibrium_gradient(system, height, method=method).gradient
            np.testing.assert_allclose(ours, exact, atol=1e-9 * np.max(np.abs(exact)))


# ---------------------------------------------------------------- what it is made of


def test_an_equilibrium_is_a_solution_of_one_instant():
    scene, design, joint = bent()
    found = equilibrium(scene, design=design)
    assert isinstance(found, Equilibrium)
    assert found.solution.outcome.success
    assert observe(reaction(joint, 0), found.solution) == found.solution.reaction(joint)[:, 0]
    assert not np.any(found.solution.v)
    assert not np.any(found.solution.a)
    energy = observe(strain_energy(), found.solution, assemble(scene))
    assert energy > 0
    lines = repr(found).splitlines()
    assert lines[0] == "Equilibrium: 24 coordinates, 3 multipliers"
    assert lines[1].split()[:2] == ["design", "variable"]
    assert [line.split()[0] for line in lines[2:-1]][:2] == ["rod.youngs_modulus", "rod.height"]
    assert lines[-1] == "the equilibrium was reached in 1 step."
    assert repr(equilibrium(scene)) == f"{lines[0]}\n{lines[-1]}"
    assert found.fraction == 1.0


def test_a_saved_equilibrium_is_read_again(tmp_path):
    scene, design, joint = bent()
    found = equilibrium(scene, design=design).solution
    again = load_solution(found.save(tmp_path / "rest.npz"))
    assert again.outcome == found.outcome
    np.testing.assert_array_equal(again.reaction(joint), found.reaction(joint))


@pytest.mark.parametrize("units", [(1e3, 1e-3, 1.0), (1e-6, 1.0, 1.0), (1.0, 1e-6, 1e6)])
@pytest.mark.parametrize("joint", [Pin, Clamp])
def test_units_do_not_matter(units, joint):
    def found(length, mass, time):
        force = mass * length / time**2
        material = Material(4000 * mass / length**3, 1e7 * force / length**2, 0.3)
        section = Rectangle(0.05 * length, 0.04 * length)
        beam = Beam("rod", (0.0, 0.0), (length, 0.0), 4, section, material)
        scene = Scene(
            [beam],
            [joint(beam.at_start, name="wall")],
            (0.0, -G * length / time**2),
            loads=[PointForce(beam.at_end, (0.0, -30 * force), name="tip")],
        )
        run = equilibrium(scene, design=["rod.height"])
        wall = run.solution.multipliers("wall")[0, :2] / force
        return run.solution.position(beam.at_end)[0] / length, wall, run.q_b[-6]

    for ours, base in zip(found(*units), found(1.0, 1.0, 1.0), strict=True):
        # Round-off of E A / l over the loads and over the bending stiffness.
        np.testing.assert_allclose(ours, base, atol=1e-9)


def test_a_search_goes_on_from_an_equilibrium():
    scene, _, _ = bent()
    first = equilibrium(scene)
    more = scene.with_values({"tip.force_y": 6.0})
    ahead, anew = equilibrium(more, start=first), equilibrium(more)
    np.testing.assert_allclose(ahead.q, anew.q, atol=1e-11)
    again = equilibrium(scene, start=first)
    # One of the path, and two that see corrections stop to shrink.
    assert again.statistics.iterations <= 3
    np.testing.assert_allclose(again.q, first.q, atol=1e-12)


def test_a_search_starts_from_the_states_of_nodes_given():
    beam = rod(elements=2)
    scene, joints = bent()[0], [Clamp(beam.at_start)]
    there = equilibrium(Scene([beam], joints, (0.0, -G)))
    state = NodalState("rod", there.solution.nodes("rod")[0])
    found = equilibrium(Scene([beam], joints, (0.0, -G), start=[state]))
    # Those of the path, and two that see corrections stop to shrink.
    assert found.statistics.iterations <= 4
    np.testing.assert_allclose(found.q, there.q, atol=1e-11)
    assert scene.start == ()


# ---------------------------------------------------------------- what has none


def arch(force):
    """Two bars from (-1, 0) and (1, 0) to the apex (0, 0.1), pushed down at the apex."""
    bars = [
        rod((-1.0, 0.0), (0.0, 0.1), 1, Material(1000.0, 1e9, 0.0), "left", 0.02),
        rod((0.0, 0.1), (1.0, 0.0), 1, Material(1000.0, 1e9, 0.0), "right", 0.02),
    ]
    left, right = bars
    joints = [Pin(left.at_start), Pin(right.at_end), Pin(left.at_end, right.at_start)]
    push = PointForce(left.at_end, (0.0, -force), name="push")
    return Scene(bars, joints, loads=[push])


def test_a_load_past_the_limit_point_is_told_and_what_converged_is_kept():
    # Two bars of St. Venant-Kirchhoff: P = E A z (z_0^2 - z^2)/L^3, largest at z = z_0/sqrt(3).
    largest = 1e9 * 0.02**2 * 2 * 0.1**3 / (3 * np.sqrt(3)) / np.hypot(1, 0.1) ** 3
    scene = arch(2 * largest)
    found = equilibrium(scene, design=["push.force_y"])
    assert found.outcome.verdict is Verdict.LIMIT_POINT
    assert not found.outcome.success
    # 1e-6 of the load is the least step; that much below the limit point it ends at best.
    assert found.fraction == pytest.approx(0.5, abs=1e-4)
    assert "limit point" in str(found.outcome)
    assert f"{100 * found.fraction:.6g} % of the load" in str(found.outcome)
    assert found.q_b is None
    apex = found.solution.position(MaterialPoint("left", 1.0))[0]
    # Near the limit point z moves with the root of the load.
    assert apex == pytest.approx([0.0, 0.1 / np.sqrt(3)], abs=2e-3)
    assert unbalanced(arch(2 * largest * found.fraction), found) < 1e-9
    with pytest.raises(
        UnfinishedRunError, match=r"limit point.* at 49\.99\d* % of the load"
    ) as caught:
        equilibrium_gradient(
            scene, position(MaterialPoint("left", 1.0), 1), design=["push.force_y"]
        )
    assert len(caught.value.solution.t) == 1
    assert equilibrium(arch(0.99 * largest)).outcome.success


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_buckled_column_is_told(dimension):
    # In space a square section buckles both ways at once; the determinant keeps its sign.
    E, h = 1e9, 0.05
    end = (0.0,) * (dimension - 1) + (1.0,)
    column = rod((0.0,) * dimension, end, 8, Material(1000.0, E, 0.0), size=h)
    critical = np.pi**2 * E * h**4 / 12 / 4
    for share, stable in ((0.9, True), (1.5, False)):
        down = tuple(-share * critical * x for x in end)
        scene = Scene([column], [Clamp(column.at_start)], loads=[PointForce(column.at_end, down)])
        outcome = equilibrium(scene).outcome
        assert outcome.success
        assert ("unstable (buckled)" in str(outcome)) is not stable
        assert "gyroscopic" not in str(outcome)
        # Stability is told to one per cent of the load; shear and the mesh change another two.
        expected = None if stable else pytest.approx(1 / 1.5, abs=0.02)
        assert outcome.stable_to == expected


def test_a_critical_load_is_no_free_mechanism():
    # Lateral buckling of a cantilever on its edge, where the square of a frequency is zero to the
    # last digit: some search finds no equilibrium, and says so; none is told to add a joint.
    section, steel = Rectangle(0.1, 0.02), Material(7850.0, 2e11, 0.0)
    beam = Beam("beam", (0, 0, 0), (1, 0, 0), 4, section, steel)

    def square(load):
        force = PointForce(beam.at_end, (0, -load, 0))
        scene = Scene([beam], [Clamp(beam.at_start)], loads=[force])
        at = equilibrium(scene)
        if not at.outcome.success:
            return 0.0
        return -(modes(scene, 1, at=at).exponents[0] ** 2).real

    # 4.01 sqrt(E I G J)/L^2 and a tenth more, for it bends before it buckles.
    critical = scipy.optimize.brentq(square, 6e4, 9e4, xtol=1e-8)
    assert critical == pytest.approx(76485, rel=1e-3)


SPACE = rod((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
LINK = rod((1.0, 0.0), (2.0, 0.0), name="link")
FREE = {
    "rod turns about its start": Scene([rod()], [Pin(rod().at_start)]),
    "rod turns about its end": Scene([rod()], [Pin(rod().at_end)]),
    r"rod turns about \(0.5, 0\)": Scene([rod()], [Pin(rod().at(0.5))]),
    "rod moves along x; rod moves along y; rod turns about its start": Scene(
        [rod()], gravity=(0.0, -G)
    ),
    "rod turns about its start while link moves along y; link turns about its start": Scene(
        [rod(), LINK], [Pin(rod().at_start), Pin(rod().at_end, LINK.at_start)]
    ),
    "link turns about its start.": Scene(
        [rod(), LINK], [Clamp(rod().at_start), Pin(LINK.at_start)]
    ),
    "rod turns about the axis z through its start": Scene(
        [SPACE], [Revolute(SPACE.at_start, (0.0, 0.0, 1.0))]
    ),
    r"rod turns about the axis y through \(0.5, 0, 0\)": Scene(
        [SPACE], [Revolute(SPACE.at(0.5), (0.0, 1.0, 0.0))]
    ),
    r"rod turns about the axis y through \(0.5, 0, 0.02\)": Scene(
        [SPACE], [Revolute(SPACE.at(0.5, z=0.02), (0.0, 1.0, 0.0))]
    ),
    "rod turns about its own axis.": Scene([SPACE], [Pin(SPACE.at_start)], (0.0, 0.0, -G)),
}


@pytest.mark.parametrize("words", FREE)
def test_a_mechanism_that_is_free_to_move_is_refused_with_its_motion(words):
    with pytest.raises(FreeMotionError, match=f"free to move: {words}"):
        equilibrium(FREE[words])


@pytest.mark.parametrize("n", [2, 4, 8])
def test_a_rod_that_spins_on_two_links_is_a_family_of_equilibria(n):
    """The weight bends the rod by 2 mm: the bent shape turns, at no stiffness but round-off."""
    steel = Material(7850.0, 2.1e11, 0.3)
    bar = Beam("rod", (0, -1, 0), (1, -1, 0), n, Circle(0.005), steel)
    links = [
        Distance(point, np.sqrt(1.04), ground=(x, 0, 0))
        for point, x in ((bar.at_start, -0.2), (bar.at_end, 1.2))
    ]
    with pytest.raises(FreeMotionError, match="rod turns about its own axis, bent as it is"):
        equilibrium(Scene([bar], links, (0.0, -G, 0.0)))
    found = modes(Scene([bar], links, (0.0, -G, 0.0)), 3)
    assert found.exponents[0] == 0
    assert "rod turns about its own axis" in found.free


def test_a_free_motion_of_a_system_without_names_is_told_by_coordinates():
    class Sliding(CartesianPendulum):
        def with_values(self, b):
            return Sliding(self.angle, self.spin, b)

        def constraint(self, t, *motion):
            return motion[-1][1:]

        def constraint_q(self, t, *motion):
            return np.array([0.0, 1.0]) * (len(motion) == 1)

    with pytest.raises(FreeMotionError, match="motion of coordinate 1"):
        equilibrium(Sliding())


def test_a_motion_that_is_not_rigid_is_told_as_such():
    system = assemble(bent()[0])
    motion = np.random.default_rng(0).standard_normal((system.n_q, 1))
    error = free_mechanism(system.naming, system.start()[0], motion)
    assert "a stiffness that round-off hides: rod deforms." in str(error)


def test_bars_in_line_carry_a_load_across_by_their_stretch():
    left, right = rod(elements=1), rod((1.0, 0.0), (2.0, 0.0), 1, name="right")
    joints = [Pin(left.at_start), Pin(left.at_end, right.at_start, name="p"), Pin(right.at_end)]
    found = equilibrium(
        Scene([left, right], joints, loads=[PointForce(left.at_end, (0.0, -1.0), name="push")])
    )
    assert found.outcome.success
    # P = E A w^3 / L^3 of bars whose force is proportional to the strain of Green and Lagrange.
    sag = (1.0 / (1e7 * 0.05**2)) ** (1 / 3)
    assert found.solution.position(left.at_end)[0, 1] == pytest.approx(-sag, rel=1e-3)


def test_an_interrupt_and_a_limit_of_steps_keep_what_converged():
    scene = arch(100.0)

    class Pressing(CartesianPendulum):
        calls = 0

        def force(self, t, q, v):
            Pressing.calls += 1
            if Pressing.calls > 60:
                raise KeyboardInterrupt
            return super().force(t, q, v)

    with pytest.raises(Interrupted) as caught:
        equilibrium(Pressing(1.0))
    found = caught.value.result
    assert found.outcome.verdict is Verdict.INTERRUPTED
    assert np.all(np.isfinite(found.q))
    few = equilibrium(scene.with_values({"push.force_y": -1e4}), max_steps=9)
    assert few.outcome.verdict is Verdict.STEP_LIMIT
    assert 0 < few.fraction < 1
    assert "limit of steps" in str(few.outcome)


def test_nonsense_is_refused_in_words():
    scene, design, _ = bent()
    tip = position(MaterialPoint("rod", 1.0), 1)
    twice = Scene([rod()], [Clamp(rod().at_start), Pin(rod().at_start)])
    for action, words in (
        (lambda: equilibrium("scene"), "model"),
        (lambda: equilibrium(scene, max_steps=0), "max_steps"),
        (lambda: equilibrium(scene, start=scene), "start"),
        (lambda: equilibrium(scene, start=equilibrium(hanging()[0])), "24 coordinates"),
        (lambda: equilibrium(scene, design=["rod.size"]), "rod.size"),
        (lambda: equilibrium(CartesianPendulum(), design=["L"]), "its own design"),
        (lambda: equilibrium_gradient(scene, tip), "design"),
        (lambda: equilibrium_gradient(scene, "tip", design=design), "Observable"),
        (
            lambda: equilibrium_gradient(
                scene, position(MaterialPoint("x", 1.0), 1), design=design
            ),
            "'x'",
        ),
        (lambda: equilibrium_gradient(scene, tip, design=design, method=HHT(0.1)), "method"),
        (
            lambda: equilibrium_gradient(scene, tip, design=design, method=ContinuousAdjoint()),
            "Adjoint",
        ),
    ):
        with pytest.raises(InvalidInputError, match=words):
            action()
    with pytest.raises(RedundantConstraintsError):
        equilibrium(twice)


def test_forces_that_are_not_finite_are_refused():
    class Bad(CartesianPendulum):
        def force(self, t, q, v):
            return np.full(2, np.nan)

    with pytest.raises(InvalidInputError, match="finite"):
        equilibrium(Bad())


def test_an_outcome_is_a_sentence():
    outcome = EquilibriumOutcome(Verdict.NO_CONVERGENCE, 0.25, 3, 1e-3, 0.125)
    assert str(outcome) == (
        "the Newton iteration did not converge at 25 % of the load, after 3 steps; what is in "
        "balance with that part is kept; the last relative correction was 0.001; its stiffness "
        "is negative above 12.5 % of the load: it is unstable (buckled)."
    )
    assert str(EquilibriumOutcome(Verdict.EQUILIBRIUM, 1.0, 1, 0.0, downhill=True)) == (
        "the equilibrium was reached in 1 step downhill."
    )
    assert str(EquilibriumOutcome(Verdict.STEP_LIMIT, 0.0, 9, 1e-3, downhill=True)) == (
        "the limit of steps (max_steps) was reached after 9 steps downhill; where it has come is "
        "kept."
    )


@pytest.mark.parametrize("length", [None, 3.0])
def test_a_line_load_on_an_arc_is_its_arc_length_times_the_force(length):
    turn = np.linspace(0, np.pi / 2, 9)
    c, s = np.cos(turn), np.sin(turn)
    frames = np.stack([np.stack([c, s], 1), np.stack([-s, c], 1)], 1)
    rod = CurvedBeam("arc", np.stack([s, 1 - c], 1), frames, Rectangle(0.05, 0.04), SOFT)
    if length is not None:
        rod = rod.with_length(length)
    clamp = Clamp(rod.at_start, name="wall")
    found = equilibrium(Scene([rod], [clamp], loads=[DistributedForce("arc", (0.0, -1.0))]))
    # The cubic through places 0.196 rad apart is longer by 0.196^4/720 = 2.1e-6.
    expected = np.pi / 2 if length is None else length
    assert observe(reaction("wall", 1), found.solution)[0] == pytest.approx(expected, rel=3e-6)


@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("tilt", [0.0, 0.2])
@pytest.mark.parametrize("links", ["distances", "rods"])
def test_a_rod_that_spins_between_its_links_has_a_family_of_equilibria(rigid, tilt, links):
    # Whatever the spin of a round rod it hangs alike: no angle is the equilibrium.
    metal, round_ = Material(7850.0, 2e11, 0.3), Circle(0.01)
    ends, above = ((0.0, 0.0, 0.0), (1.0, tilt, 0.0)), ((0.1, 0.5, 0.0), (1.1, 0.5, 0.1))
    rod = Beam("rod", *ends, 2, round_, metal, rigid=rigid)
    bodies, joints = [rod], []
    for point, ground, end, name in zip((rod.at_start, rod.at_end), above, ends, "ab", strict=True):
        if links == "distances":
            joints.append(Distance(point, 0.5, ground=ground))
        else:
            link = Beam(name, ground, end, 1, round_, metal, rigid=True)
            bodies.append(link)
            joints += [Pin(link.at_start), Pin(link.at_end, point)]
    scene = Scene(bodies, joints, (0.0, -G, 0.0), assemble=True)
    with pytest.raises(FreeMotionError, match="rod turns about the axis"):
        equilibrium(scene)
