"""Closed chains of hinges in space move as with joints that hold no direction twice."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    Cylindrical,
    DirectDifferentiation,
    Integral,
    Material,
    Pin,
    Radau,
    Revolute,
    RigidBody,
    RotationDriver,
    Scene,
    Spherical,
    SpringDamper,
    Terminal,
    assemble,
    drop_redundant,
    equilibrium,
    equilibrium_gradient,
    gradient,
    mass_properties,
    modes,
    simulate,
)
from ancfdae.errors import InvalidInputError, RedundantConstraintsError, UnknownNameError
from ancfdae.laws import ConstantAcceleration
from ancfdae.observables import kinetic_energy, observe, position, reaction
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle

BAR = Rectangle(0.04, 0.03), Material(7800.0, 2e11, 0.3)
ACROSS = (0.0, 0.0, 1.0)
FOUR_BAR = [(0, 0, 0), (0.3, 0.4, 0), (1.3, 0.6, 0), (1.0, 0, 0)]


def bars(places):
    """Rigid bars from place to place."""
    pairs = enumerate(itertools.pairwise(places))
    return [Beam(f"bar {k}", *pair, 1, *BAR, rigid=True) for k, pair in pairs]


def closed(places, axes, last, gravity):
    """A chain of bars on hinges about `axes`, whose end `last` joins with the ground."""
    rods = bars(places)
    ends = [None, *(rod.at_end for rod in rods)]
    joints = [
        Revolute(rod.at_start, axis, end, name=f"hinge {k}")
        for k, (rod, axis, end) in enumerate(zip(rods, axes, ends, strict=False))
    ]
    return Scene(rods, [*joints, *last(rods)], gravity), rods


def four_bar(minimal, offset=(0.0, 0.0, 0.0), unit=1.0):
    """A planar four-bar, out of plane in space: four hinges, or two, a ball and a cylinder."""
    a, b, c, d = (tuple(unit * (np.array(x) + offset)) for x in FOUR_BAR)
    crank, coupler, rocker = (
        Beam(name, start, end, 1, Rectangle(0.04 * unit, 0.03 * unit), BAR[1], rigid=True)
        for name, start, end in (("crank", a, b), ("coupler", b, c), ("rocker", c, d))
    )
    joints = [
        Revolute(crank.at_start, ACROSS, name="ground"),
        Revolute(coupler.at_start, ACROSS, crank.at_end, name="elbow"),
    ]
    if minimal:
        joints += [
            Spherical(rocker.at_start, coupler.at_end, name="wrist"),
            Cylindrical(rocker.at_end, ACROSS, name="foot"),
        ]
    else:
        joints += [
            Revolute(rocker.at_start, ACROSS, coupler.at_end, name="wrist"),
            Revolute(rocker.at_end, ACROSS, name="foot"),
        ]
    scene = Scene([crank, coupler, rocker], joints, (0, -9.81 * unit, 0))
    return scene, coupler.at(0.5)


# Six edges of a cube, each hinge across its two bars.
CUBE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1), (0, 0, 1), (0, 0, 0)]
CUBE_AXES = [(0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]


def bricard(minimal):
    """Bricard's mechanism: five bars of a metre and the ground, from edge to edge of a cube."""

    def last(rods):
        kind = Cylindrical if minimal else Revolute
        return [kind(rods[-1].at_end, (1.0, 0.0, 0.0), name="last")]

    scene, rods = closed(CUBE[:-1], CUBE_AXES, last, (0, 0, -9.81))
    return scene, rods[2].at_start


MECHANISMS = {
    "four-bar": (four_bar, 3, ["crank.height", "coupler.length", "rocker.density"]),
    "Bricard": (bricard, 1, ["bar 0.height", "bar 2.density", "bar 4.density"]),
}
every_mechanism = pytest.mark.parametrize(
    ("build", "count", "design"), MECHANISMS.values(), ids=MECHANISMS
)


@every_mechanism
@pytest.mark.parametrize("integrator", [HHT(2.0**-8), Radau(2.0**-6)], ids=repr)
def test_motion_and_gradient_are_those_of_the_minimal_joints(build, count, design, integrator):
    (scene, point), (minimal, _) = build(False), build(True)
    with pytest.raises(RedundantConstraintsError, match=rf"{count} redundant.*drop_redundant"):
        simulate(scene, 0.1, integrator)
    free = drop_redundant(scene)
    assert len(free.left_out) == count
    runs = [simulate(x, 0.25, integrator).position(point) for x in (free, minimal)]
    assert np.max(np.abs(runs[0][-1] - runs[0][0])) > 0.1
    np.testing.assert_allclose(runs[0][-1], runs[1][-1], atol=1e-9)
    objective = Integral(position(point, 1) ** 2) + Terminal(kinetic_energy())
    for method in (DirectDifferentiation(), Adjoint(), ComplexStep()):
        ours, theirs = (
            gradient(x, objective, 0.25, integrator, design=design, method=method)
            for x in (free, minimal)
        )
        assert ours.value == pytest.approx(theirs.value, rel=1e-8)
        scale = np.max(np.abs(theirs.gradient))
        np.testing.assert_allclose(ours.gradient, theirs.gradient, rtol=1e-6, atol=1e-9 * scale)


@every_mechanism
def test_modes_and_equilibria_are_those_of_the_minimal_joints(build, count, design):
    found = []
    for minimal in (False, True):
        scene, point = build(minimal)
        scene = scene if minimal else drop_redundant(scene)
        hung = replace(scene, loads=[SpringDamper(point, 5e4, 10.0, ground=(0.5, 0.5, 2.0))])
        rest = equilibrium(hung, design=design)
        found.append(
            [
                *(rest.solution.position(point)[0]),
                *modes(hung, 1, at=rest, design=design).natural_frequencies_b[0],
                *equilibrium_gradient(hung, position(point, 1), design=design).gradient,
            ]
        )
    np.testing.assert_allclose(*found, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("offset", "unit"), [((0, 0, 0), 1.0), ((1e3, -2e3, 5e2), 1.0), ((0, 0, 0), 1e3)]
)
def test_axes_are_left_out_before_positions_wherever_and_in_whatever_unit(offset, unit):
    """A hinge holds its point by equations 0 to 2: every joint keeps its reaction."""
    scene, _ = four_bar(False, offset, unit)
    free = drop_redundant(scene)
    assert free.left_out == drop_redundant(four_bar(False)[0]).left_out
    assert all(row >= 3 for _, row in free.left_out)
    assert drop_redundant(free) == free
    assert "equations left out: wrist (4), foot (3, 4)" in repr(free)
    run = simulate(free, 0.1, HHT(2.0**-8))
    for joint in scene.joints:
        assert run.reaction(joint.name).shape == (len(run.t), 3)
        assert np.all(np.isfinite(observe(reaction(joint.name, 1), run)))


def test_the_weight_is_carried_whichever_equations_are_left_out():
    """At rest forces on a chain balance: the ground carries all of the weight."""
    scene, point = four_bar(False)
    hung = replace(scene, loads=[SpringDamper(point, 5e4, 0.0, ground=(0.6, 2.0, 0.0))])
    rest = equilibrium(drop_redundant(hung)).solution
    weight = mass_properties(scene).mass * 9.81
    pulled = 5e4 * (rest.position(point)[0, 1] - 2.0)
    carried = rest.reaction("ground")[0, 1] + rest.reaction("foot")[0, 1]
    assert carried == pytest.approx(weight + pulled, rel=1e-6)


def test_a_driven_four_bar_follows_its_law_and_a_second_driver_is_refused():
    scene, point = four_bar(False)
    crank = scene.beams[0]
    law = ConstantAcceleration(0.0, acceleration=20.0)
    turned = replace(scene, joints=[*scene.joints, RotationDriver(crank.at_start, law, ACROSS)])
    minimal, _ = four_bar(True)
    driven = replace(minimal, joints=[*minimal.joints, turned.joints[-1]])
    ours, theirs = (
        simulate(x, 0.25, Radau(2.0**-6)).position(point)[-1]
        for x in (drop_redundant(turned), driven)
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-10)
    foot = RotationDriver(scene.beams[2].at_end, law, ACROSS, name="second")
    with pytest.raises(RedundantConstraintsError, match="two drivers of one motion"):
        drop_redundant(replace(turned, joints=[*turned.joints, foot]))


def test_a_joint_that_says_nothing_new_is_left_out_as_a_whole():
    rod = Beam("rod", (0, 0), (1, 0), 2, *BAR)
    scene = Scene([rod], [Clamp(rod.at_start), Pin(rod.at_start, name="again")], (0, -9.81))
    free = drop_redundant(scene)
    assert free.left_out == (("again", 0), ("again", 1))
    alone = Scene([rod], [Clamp(rod.at_start)], (0, -9.81))
    ours, theirs = (simulate(x, 0.05, HHT(0.01)).q[-1] for x in (free, alone))
    np.testing.assert_allclose(ours, theirs, atol=1e-12)
    with pytest.raises(InvalidInputError, match=r"reaction of 'again'"):
        simulate(free, 0.05, HHT(0.01)).reaction("again")
    assert drop_redundant(alone) == alone


def test_a_dead_point_is_no_redundancy():
    """A parallelogram in one line may become a kite there: its equations are not redundant."""
    a, b, c = (
        Beam(name, (x, 0), (y, 0), 1, *BAR, rigid=True)
        for name, x, y in (("a", 0, 1), ("b", 1, 3), ("c", 2, 3))
    )
    joints = [Pin(a.at_start), Pin(b.at_start, a.at_end), Pin(c.at_start), Pin(c.at_end, b.at_end)]
    with pytest.raises(RedundantConstraintsError, match="dead point"):
        drop_redundant(Scene([a, b, c], joints))


def test_equations_that_do_not_exist_are_refused():
    scene, _ = four_bar(False)
    with pytest.raises(UnknownNameError, match=r"'nothing'.*wrist"):
        replace(scene, left_out=[("nothing", 0)])
    with pytest.raises(InvalidInputError, match=r"'foot'.*0 to 5; got 7"):
        assemble(replace(scene, left_out=[("foot", 7)]))
    with pytest.raises(InvalidInputError, match="pairs"):
        replace(scene, left_out=["foot"])
    with pytest.raises(InvalidInputError, match="scene"):
        drop_redundant(assemble(scene))
    body = RigidBody("body", (0, 0), mass=1.0, inertia=1.0)
    # An equation that no other one implies opens.
    held = Scene(bodies=[body], joints=[Pin(body.origin, name="pin")], gravity=(0, -10.0))
    falls = simulate(replace(held, left_out=[("pin", 1)]), 0.5, HHT(0.01))
    assert falls.outcome.verdict is Verdict.OPENED
    assert falls.t[-1] == 0
