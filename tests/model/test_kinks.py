"""Loads and joints at nodes within a beam: what jumps there, against Timoshenko's formulas.

The nodes there have a slope along the beam on either side, so that shear and axial forces jump by
the load. Small loads: the terms of second order in the deflection, v/L = 1e-7, are left out.
"""

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    HHT,
    Adjoint,
    Beam,
    Bushing,
    Clamp,
    ComplexStep,
    CurvedBeam,
    DirectDifferentiation,
    EnhancedContinuum,
    EquilibriumStart,
    Material,
    Moment,
    NodalState,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    SaintVenantKirchhoff,
    Scene,
    Spherical,
    SpringDamper,
    Terminal,
    Weld,
    assemble,
    equilibrium,
    equilibrium_gradient,
    gradients,
    load_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.sections import QuadratureSection, Rectangle
from ancfdae.sensitivity.observables.observable import observe
from ancfdae.sensitivity.observables.points import position
from ancfdae.sensitivity.observables.sections import axial_force, bending_moment, shear_force

L, H, W, E, NU = 1.0, 0.2, 0.1, 1e9, 0.3
STEEL = Material(density=1000.0, youngs_modulus=E, poisson_ratio=NU)
LOOSE = Material(density=1000.0, youngs_modulus=E, poisson_ratio=0.0)
PLATE = Rectangle(H, W)
EI, EA = E * W * H**3 / 12, E * W * H
#: v/L below 1e-7 for all loads of one newton: what Timoshenko leaves out is smaller than this.
SMALL = 1e-6


def shear_stiffness(nu):
    """k G A of a rectangle (Cowper 1966)."""
    return 10 * (1 + nu) / (12 + 11 * nu) * E / (2 * (1 + nu)) * W * H


GA = shear_stiffness(NU)


def straight(n, d=2, section=PLATE, material=STEEL, **more):
    return Beam("rod", (0.0,) * d, (L, *(0.0,) * (d - 1)), n, section, material, **more)


def across(d, size=1.0, along=0.0):
    return (along, size, *(0.0,) * (d - 2))


def supported(rod, *loads, roller=1.0):
    """A beam on a fixed and on a sliding support; in space it cannot turn about its axis."""
    d = rod.dimension
    if d == 2:
        joints = [Pin(rod.at_start, name="start"), PointOnLine(rod.at(roller), (1.0, 0.0))]
    else:
        ends = rod.at(roller), rod.at_end
        joints = [Spherical(rod.at_start, name="start"), PointOnLine(ends[0], (1.0, 0.0, 0.0))]
        # A soft bushing against the turn, which nothing drives.
        loads = (*loads, Bushing(rod.at_start, (0.0,) * 3, turn_stiffness=(EI, 0.0, 0.0)))
    return Scene([rod], joints, loads=loads)


def at_rest(scene):
    found = equilibrium(scene)
    assert found.outcome.success
    return found.solution, assemble(scene)


def seen(state, observable):
    return float(observe(observable, *state)[0])


def sides(state, point_of, observable):
    """A force just before and after a place."""
    return [seen(state, observable(point_of(before))) for before in (True, False)]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [4, 8])
def test_three_point_bending_is_timoshenkos(n, d):
    rod = straight(n, d)
    state = at_rest(supported(rod, PointForce(rod.at(0.5), across(d, -1.0))))
    for k in range(n):
        for place in (k / n, (k + 0.3) / n, (k + 0.5) / n):
            V = -0.5 if place < 0.5 else 0.5
            assert seen(state, shear_force(rod.at(place))) == pytest.approx(V, abs=SMALL)
    V = sides(state, lambda before: rod.at(0.5, before=before), shear_force)
    np.testing.assert_allclose(V, (-0.5, 0.5), atol=SMALL)
    sag = L**3 / (48 * EI) + L / (4 * GA)
    assert -state[0].position(rod.at(0.5))[0, 1] == pytest.approx(sag, rel=SMALL)


@pytest.mark.parametrize("d", [2, 3])
def test_an_inner_support_bears_what_an_overhanging_beam_does(d):
    """A force P at the end beyond a support at a: reactions -P b/a and P L/a."""
    a, rod = 0.75, straight(8, d)
    b = L - a
    state = at_rest(supported(rod, PointForce(rod.at_end, across(d)), roller=a))
    V = sides(state, lambda before: rod.at(a, before=before), shear_force)
    np.testing.assert_allclose(V, (-b / a, 1.0), rtol=SMALL)
    M = sides(state, lambda before: rod.at(a, before=before), bending_moment)
    np.testing.assert_allclose(M, (b, b), rtol=1e-5)
    tip = b**2 * (a + b) / (3 * EI) + (b + b**2 / a) / GA
    assert state[0].position(rod.at_end)[0, 1] == pytest.approx(tip, rel=1e-5)


@pytest.mark.parametrize(
    ("energy", "material"),
    [
        (EnhancedContinuum(assumed_strains=False), STEEL),
        (SaintVenantKirchhoff(), LOOSE),
    ],
    ids=["plain", "full"],
)
def test_other_strains_converge_with_the_square_of_the_length(energy, material):
    # The full law has the whole area for shears, k = 1.
    k = 1.0 if isinstance(energy, SaintVenantKirchhoff) else 10 * 1.3 / (12 + 3.3)
    GA_full = k * E / (2 * (1 + material.poisson_ratio)) * W * H
    exact, errors = (L / 2) ** 3 / (3 * EI) + L / 2 / GA_full, []
    for n in (8, 16, 32):
        rod = straight(n, material=material, energy=energy)
        load = PointForce(rod.at(0.5), (0.0, 1.0))
        state = at_rest(Scene([rod], [Clamp(rod.at_start)], loads=[load]))
        errors.append(abs(state[0].position(rod.at(0.5))[0, 1] / exact - 1))
        places = [rod.at((k + 0.5) / n) for k in range(n)]
        V = [seen(state, shear_force(place)) for place in places]
        np.testing.assert_allclose(V, np.repeat([1.0, 0.0], n // 2), atol=1e-5)
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.95), (errors, orders)


@pytest.mark.parametrize("d", [2, 3])
def test_a_beam_is_as_two_that_are_welded(d):
    loads, shapes = across(d, 2.0, 3.0), []
    rod = straight(6, d)
    half = (L / 2, *(0.0,) * (d - 1))
    left = Beam("left", (0.0,) * d, half, 3, PLATE, STEEL)
    right = Beam("right", left.at_end, half, 3, PLATE, STEEL)
    whole = at_rest(Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at(0.5), loads)]))
    two = at_rest(
        Scene(
            [left, right],
            [Clamp(left.at_start), Weld(right.at_start, left.at_end)],
            loads=[PointForce(left.at_end, loads)],
        )
    )
    for fraction in (0.2, 0.5, 0.9):
        pair = left.at(2 * fraction) if fraction <= 0.5 else right.at(2 * fraction - 1)
        shapes.append([whole[0].position(rod.at(fraction))[0], two[0].position(pair)[0]])
    one, other = np.swapaxes(shapes, 0, 1)
    # Both searches end at the round-off of their forces: E A eps over 3 EI/L^3 of the deflection.
    np.testing.assert_allclose(one, other, atol=1e-13)


def test_a_force_along_the_beam_is_a_jump_of_the_axial_force():
    rod = straight(6)
    load = PointForce(rod.at(1 / 3), (1.0, 0.0))
    state = at_rest(Scene([rod], [Clamp(rod.at_start)], loads=[load]))
    N = sides(state, lambda before: rod.at(1 / 3, before=before), axial_force)
    np.testing.assert_allclose(N, (1.0, 0.0), atol=SMALL)
    moved = state[0].position(rod.at_end)[0, 0] - L
    assert moved == pytest.approx(L / 3 / EA, rel=SMALL)


def test_springs_masses_and_bushings_push_as_forces_do():
    rod, stiffness, weight = straight(8), 3 * EI, 2.0
    place = rod.at(0.5)
    v = 0.5**3 / 3 / EI + 0.5 / GA
    bush = Bushing(place, (0.0, stiffness))
    spring = SpringDamper(place, stiffness, free_length=100.0, ground=(0.5, -100.0))
    for holder in (bush, spring):
        load = PointForce(place, (0.0, 1.0), name="push")
        state = at_rest(Scene([rod], [Clamp(rod.at_start)], loads=[holder, load]))
        V = sides(state, lambda before: rod.at(0.5, before=before), shear_force)
        # The beam and the holder share the force in proportion to stiffness, 1/v and `stiffness`.
        np.testing.assert_allclose(V, (1 / (1 + stiffness * v), 0.0), atol=SMALL)
    light = Material(density=1e-9, youngs_modulus=E, poisson_ratio=NU)
    rod = straight(8, material=light)
    body = PointMass(rod.at(0.5), weight)
    state = at_rest(Scene([rod], [Clamp(rod.at_start)], bodies=[body], gravity=(0.0, -1.0)))
    V = sides(state, lambda before: rod.at(0.5, before=before), shear_force)
    np.testing.assert_allclose(V, (-weight, 0.0), atol=2 * SMALL)


def test_a_moment_leaves_forces_alone_where_the_axis_is_off_the_centroid():
    """A moment within a bar whose axis is off its centroid jumps the strain of the axis."""
    y = 0.05 + H / np.sqrt(12) * np.array([-1.0, 1.0])
    section = QuadratureSection(
        places=[(k, z) for k in y for z in (-0.03, 0.03)], areas=4 * [W * H / 4]
    )
    rod = straight(4, section=section)
    state = at_rest(Scene([rod], [Clamp(rod.at_start)], loads=[Moment(rod.at(0.5), 1.0)]))
    for force in (axial_force, shear_force):
        found = [seen(state, force(rod.at(k / 8))) for k in range(9)]
        np.testing.assert_allclose(found, 0.0, atol=1e-5)
    turned = state[0].slope(rod.at_end, 1)[0]
    assert -turned[0] == pytest.approx(L / 2 / EI, rel=1e-5)


def test_a_stepped_bar_is_exact_with_a_kink_at_the_step():
    """Under an end force N is the same on both sides of the step, and the elongation N l/(E A)."""
    sections = [Rectangle(H, W)] * 2 + [Rectangle(H / 2, W)] * 2
    states = []
    for kinks in ((), (0.5,)):
        rod = straight(4, section=sections, kinks=kinks, material=LOOSE)
        load = PointForce(rod.at_end, (1.0, 0.0))
        states.append(at_rest(Scene([rod], [Clamp(rod.at_start)], loads=[load])))
    N = [seen(states[1], axial_force(rod.at(k / 8))) for k in range(9)]
    np.testing.assert_allclose(N, 1.0, atol=SMALL)
    errors = [state[0].position(rod.at_end)[0, 0] - L - 1.5 * L / EA for state in states]
    assert abs(errors[1]) < SMALL * L / EA < abs(errors[0])


def test_a_load_within_an_arc_jumps_forces_by_its_components():
    """Balance with what is beyond, in the middle of the elements beside it where N is best.

    What 16 elements leave at the end of such an arc, 2e-3, they leave here.
    """
    n, force = 16, np.array([0.3, -1.0])

    def tangent(fraction):
        angle = np.pi / 2 * np.asarray(fraction)
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    t = tangent(np.arange(n + 1) / n)
    up = t @ [[0.0, 1.0], [-1.0, 0.0]]
    arc = CurvedBeam("rod", up[0] - up, np.stack([t, up], axis=1), PLATE, STEEL)
    load = PointForce(arc.at(0.5), tuple(force))
    state = at_rest(Scene([arc], [Clamp(arc.at_start)], loads=[load]))
    for side, beyond in ((-0.5, force), (0.5, 0 * force)):
        x, y = tangent(0.5 + side / n)
        found = [seen(state, each(arc.at(0.5 + side / n))) for each in (axial_force, shear_force)]
        np.testing.assert_allclose(found, [[x, y], [-y, x]] @ beyond, atol=2e-3)
    before, after = sides(state, lambda before: arc.at(0.5, before=before), shear_force)
    assert before - after == pytest.approx([-1.0, 1.0] @ force / np.sqrt(2), abs=2e-3)


# ---------------------------------------------------------------- what has kinks


def test_only_inner_nodes_that_parts_act_on_have_kinks():
    rod = straight(8)
    wall, push = [Clamp(rod.at_start)], (0.0, 1.0)
    plain = Scene([rod], wall, loads=[PointForce(rod.at_end, push)])
    assert assemble(plain).n_q == 9 * 6
    assert plain.kinks == {"rod": ()}
    between = Scene([rod], wall, loads=[PointForce(rod.at(0.3), push)])
    assert between.kinks == {"rod": ()}
    inner = Scene([rod], [*wall, Pin(rod.at(0.25))], loads=[Moment(rod.at(0.75), 1.0)])
    assert inner.kinks == {"rod": (2, 6)}
    assert assemble(inner).n_q == 9 * 6 + 2 * 2
    stiff = straight(8, rigid=True)
    assert Scene([stiff], loads=[PointForce(stiff.at(0.5), push)]).kinks == {}


@pytest.mark.parametrize("n", [10, 64, 1000, 1999])
def test_a_fraction_means_its_node_however_many_there_are(n):
    rod = Beam("rod", (0.0, 0.0), (1.2, 0.0), n, PLATE, STEEL)
    assert rod.inner_nodes(k / n for k in range(n + 1)) == set(range(1, n))
    assert rod.inner_nodes((k + 1e-6) / n for k in range(n)) == set()


def test_a_cable_has_none_because_its_slopes_carry_bending():
    rod = Beam("rod", (0.0, 0.0), (L, 0.0), 8, PLATE, STEEL, element=CABLE_2D)
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at(0.5), (0.0, 1.0))])
    assert assemble(scene).n_q == 9 * 4
    v = at_rest(scene)[0].position(rod.at(0.5))[0, 1]
    assert v == pytest.approx((L / 2) ** 3 / (3 * EI), rel=SMALL)
    with pytest.raises(InvalidInputError, match=r"kinks.*resists bending"):
        Beam("rod", (0.0, 0.0), (L, 0.0), 8, PLATE, STEEL, element=CABLE_2D, kinks=(0.5,))


@pytest.mark.parametrize(
    ("kinks", "rule"),
    [((0.3,), "between elements"), ((0.0,), "between elements"), ((2.0,), "in \\[0, 1\\]")],
)
def test_kinks_lie_at_inner_nodes(kinks, rule):
    with pytest.raises(InvalidInputError, match=rule):
        straight(8, kinks=kinks)


def test_nothing_lies_before_the_start():
    with pytest.raises(InvalidInputError, match="nothing lies before"):
        straight(8).at(0.0, before=True)
    assert str(straight(8).at(0.5, before=True)) == "rod@0.5 before"


def test_a_point_at_a_node_is_no_design_variable():
    rod = straight(8)
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at(0.5), (0, 1), name="f")])
    with pytest.raises(InvalidInputError, match="inside an element"):
        assemble(scene, design=["f.point_fraction"])


# ---------------------------------------------------------------- starts and files


def hung(rod, *loads, start=()):
    return Scene([rod], [Clamp(rod.at_start)], loads=loads, start=start)


def test_an_equilibrium_with_another_load_is_a_start(tmp_path):
    rod = straight(4, kinks=(0.25,))
    load = PointForce(rod.at(0.5), (0.0, 1e3), name="off")
    other = PointForce(rod.at(0.25), (0.0, 1e3), name="on")
    held = equilibrium(hung(rod, load)).solution
    for scene in (
        hung(straight(4), other, start=[EquilibriumStart(loads=[load])]),
        hung(straight(4, kinks=(0.5,)), other, start=[NodalState("rod", held.ends("rod")[0])]),
    ):
        run = simulate(scene, 2.0**-9, HHT(2.0**-10))
        assert run.ends("rod").shape == (len(run.t), 4, 2, 3, 2)
        np.testing.assert_allclose(run.ends("rod")[0], held.ends("rod")[0], rtol=0, atol=1e-15)
    path = run.save(tmp_path / "run.npz")
    again = load_solution(path)
    assert again.naming.layout == run.naming.layout
    np.testing.assert_array_equal(again.ends("rod"), run.ends("rod"))
    before, after = (run.slope(rod.at(0.5, before=side)) for side in (True, False))
    np.testing.assert_array_equal(run.ends("rod")[:, 1, 1, 1], before)
    np.testing.assert_array_equal(run.nodes("rod")[:, 2, 1], after)
    # The tangent at a node shows all but a hundredth of the angle of shear
    # (docs/theory/02-strain-energy.md, assumed strains, point 6).
    assert np.abs(after - before)[0, 1] == pytest.approx(0.99 * 1e3 / GA, rel=1e-2)
    names = list(run.to_dataframe())
    assert len(names) == run.q.shape[1]
    np.testing.assert_array_equal(run.to_dataframe()["rod[2].slope_x before.y"], before[:, 1])


def test_a_start_with_a_jump_needs_a_kink():
    rod = straight(4)
    held = equilibrium(hung(rod, PointForce(rod.at(0.5), (0.0, 1e3)))).solution
    with pytest.raises(InvalidInputError, match=r"at node 2.*kinks=\["):
        hung(rod, start=[NodalState("rod", held.ends("rod")[0])])


# ---------------------------------------------------------------- derivatives


def loaded(d):
    """A beam with an inner load and an inner support off the middle, with initial turn."""
    rod = straight(4, d, turn=0.2 if d == 2 else (0.0, 0.0, 0.2))
    load = PointForce(rod.at(0.5), across(d, -2e4, 1e4), name="push")
    joints = [Clamp(rod.at_start)]
    mass = PointMass(rod.at(0.75), 5.0)
    return Scene([rod], joints, loads=[load], bodies=[mass], gravity=across(d, -9.81)), rod


DESIGN = ["rod.length", "rod.height", "push.force_y", "mass(rod@0.75).mass"]


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_agree_at_rest_and_in_motion(d):
    scene, rod = loaded(d)
    turn = "rod.turn" if d == 2 else "rod.turn_z"
    design = [*DESIGN, turn]
    observables = [
        shear_force(rod.at(0.5, before=True)),
        shear_force(rod.at(0.5)),
        position(rod.at(0.5), 1),
    ]
    for observable in observables:
        found = [
            equilibrium_gradient(scene, observable, design=design, method=method).gradient
            for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
        ]
        # Round-off of a search: that of forces, 1e-16 E A of 1e4 N, times the condition 1e3.
        for other in found[1:]:
            np.testing.assert_allclose(
                other, found[0], rtol=1e-7, atol=1e-9 * np.max(np.abs(found))
            )
    objectives = [Terminal(observable) for observable in observables]
    by_method = [
        gradients(scene, objectives, 2.0**-8, HHT(2.0**-10), design=design, method=method)
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    for direct, *others in zip(*by_method, strict=True):
        for other in others:
            scale = np.abs(direct.gradient)
            np.testing.assert_allclose(
                other.gradient, direct.gradient, rtol=1e-7, atol=1e-9 * scale.max()
            )


def test_a_gradient_is_the_limit_of_the_calls_a_user_makes():
    scene, rod = loaded(2)
    observable, h = position(rod.at(0.5), 1), 1e-5
    for target in ("rod.length", "rod.turn", "push.force_y"):
        exact = equilibrium_gradient(scene, observable, design=[target]).gradient[0]
        b = scene._held(target)[0]
        ends = [
            seen(at_rest(scene.with_values({target: b * (1 + s * h)})), observable) for s in (1, -1)
        ]
        # Central differences: h^2 and round-off over h.
        assert (ends[0] - ends[1]) / (2 * h * b) == pytest.approx(exact, rel=1e-6)
