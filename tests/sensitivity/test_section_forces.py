"""Forces and stresses in the sections of beams: statics, strength of materials, exact partials.

Section forces of loads at nodes are those of statics to the residual of the equilibrium, 1e-8 of
the load at most here; loads spread along elements leave the square of the length.
"""

import dataclasses

import numpy as np
import pytest

from ancfdae import (
    BEAM_2D,
    CABLE_2D,
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    DirectDifferentiation,
    DistributedForce,
    EnhancedContinuum,
    InitialVelocity,
    Material,
    Moment,
    Pin,
    PlaneStress,
    PointForce,
    SaintVenantKirchhoff,
    Scene,
    SmoothMaximum,
    Terminal,
    assemble,
    equilibrium,
    equilibrium_gradient,
    gradients,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.sections import (
    Box,
    Circle,
    GeneralSection,
    ISection,
    QuadratureSection,
    Rectangle,
    Tube,
)
from ancfdae.sensitivity.observables.observable import States, observe
from ancfdae.sensitivity.observables.quantities import reaction
from ancfdae.sensitivity.observables.sections import (
    axial_force,
    bending_moment,
    maximum_von_mises,
    shear_force,
    torsional_moment,
    von_mises,
)
from tests.support.sections import forces, section_axes

STEEL = Material(density=7800.0, youngs_modulus=2e11, poisson_ratio=0.3)
LOOSE = dataclasses.replace(STEEL, poisson_ratio=0.0)
PLATE = Rectangle(height=0.02, width=0.01)
GAUSS = 0.5 - 0.5 / np.sqrt(3.0)
EPS = 1e-40


def cantilever(n, load, d=3, section=PLATE, material=STEEL, **changes):
    end = (1.0, 0.0) if d == 2 else (1.0, 0.0, 0.0)
    rod = Beam("rod", tuple(0.0 for _ in end), end, n, section, material, **changes)
    return Scene([rod], [Clamp(rod.at_start, name="wall")], loads=[load(rod)])


def at_rest(scene):
    found = equilibrium(scene)
    assert found.outcome.success
    return found.solution, assemble(scene)


def seen(scene, state, points):
    """Section forces at points of a state of rest, shape (n_points, 3 or 6)."""
    solution, system = state
    d = scene.beams[0].dimension
    return np.array([[observe(o, solution, system)[0] for o in forces(p, d)] for p in points])


def statics(solution, point, force, where):
    """What a force at a place does to a section: its components and those of its moment."""
    axes, arm = section_axes(solution, point), where - solution.position(point)[0]
    if len(arm) == 2:
        return np.array([*(axes @ force), arm[0] * force[1] - arm[1] * force[0]])
    return np.concatenate([axes @ force, axes @ np.cross(arm, force)])


# ---------------------------------------------------------------- statics


def test_an_end_force_is_carried_by_every_section_with_its_moment():
    P = np.array([-20.0, 60.0, 30.0])
    for n in (1, 4):
        scene = cantilever(n, lambda rod: PointForce(rod.at_end, tuple(P)))
        (rod,), state = scene.beams, at_rest(scene)
        solution, _ = state
        points = [rod.at((e + xi) / n) for e in range(n) for xi in (0.0, GAUSS, 0.5, 0.9)]
        tip = solution.position(rod.at_end)[0]
        expected = np.array([statics(solution, point, P, tip) for point in points])
        assert np.max(np.abs(seen(scene, state, points) - expected)) <= 1e-8 * np.linalg.norm(P)


@pytest.mark.parametrize(("d", "axis"), [(2, 2), (3, 2), (3, 1)])
def test_a_moment_bends_with_one_moment_and_no_force(d, axis):
    # The rod turns by 0.5 rad, about its width or its height.
    h, w = (0.02, 0.01) if axis == 2 else (0.01, 0.02)
    M = 0.5 * STEEL.youngs_modulus * w * h**3 / 12
    scene = cantilever(
        4, lambda rod: Moment(rod.at_end, M if d == 2 else tuple(M * np.eye(3)[axis])), d
    )
    found = seen(scene, at_rest(scene), [scene.beams[0].at(x) for x in (0.0, 0.3, 0.375, 1.0)]) / M
    own = -1 if axis == 2 else -2
    assert np.allclose(found[:, own], 1.0, rtol=0, atol=1e-8)
    assert np.max(np.abs(np.delete(found, own, axis=1))) <= 1e-8


@pytest.mark.parametrize(
    "section", [Circle(0.01), PLATE, Tube(0.02, 0.002), Box(0.04, 0.02, 2e-3, 3e-3)]
)
def test_a_torque_is_carried_by_every_section(section):
    J = section.torsion(np.array([section.sizes()]))[0]
    T = 0.3 * STEEL.youngs_modulus / 2.6 * J
    scene = cantilever(4, lambda rod: Moment(rod.at_end, (T, 0.0, 0.0)), section=section)
    found = seen(scene, at_rest(scene), [scene.beams[0].at(x) for x in (0.0, 0.3, 1.0)]) / T
    # An element twists by 0.075 rad: its fourth power, and Wagner's lengthening.
    assert np.allclose(found[:, 3], 1.0, rtol=0, atol=1e-4)
    assert np.max(np.abs(found[:, [1, 2, 4, 5]])) <= 1e-4
    # Forces times the height of the section; the square of the twist of an element.
    assert np.max(np.abs(found[:, 0])) * 0.02 <= 1e-4


LAWS = [
    (EnhancedContinuum(), BEAM_2D, 0.3),
    (PlaneStress(assumed_strains=True), BEAM_2D, 0.3),
    (SaintVenantKirchhoff(assumed_strains=True), BEAM_2D, 0.3),
    (SaintVenantKirchhoff(), BEAM_2D, 0.0),
    (None, CABLE_2D, 0.3),
]


@pytest.mark.parametrize(("energy", "element", "nu"), LAWS)
def test_sections_of_every_law_are_in_balance_with_a_distributed_load(energy, element, nu):
    # All laws but the bare one, which locks, have the same accuracy.
    thick = Rectangle(height=0.05, width=0.02)
    material = Material(7800.0, 2e9, nu)
    f = np.array([100.0, 200.0])
    errors = []
    for n in (8, 16):
        scene = cantilever(
            n,
            lambda rod: DistributedForce("rod", tuple(f)),
            2,
            thick,
            material,
            element=element,
            energy=energy,
        )
        (rod,), state = scene.beams, at_rest(scene)
        solution, _ = state
        points = [rod.at(place) for place in (0.5 / n, 0.5 + 0.5 / n)]
        expected = []
        for point in points:
            # The force on the rest acts in its middle, the mean of its places.
            s, w = np.polynomial.legendre.leggauss(8)
            s, w = point.fraction + (1 - point.fraction) * (s + 1) / 2, w / 2
            middle = w @ [solution.position(rod.at(x))[0] for x in s]
            expected.append(statics(solution, point, f * (1 - point.fraction), middle))
        found = seen(scene, state, points)
        errors.append(np.abs(found - expected) / np.linalg.norm(f))
    # Second order of the moment: f l^2/24 in the middle of an element, 1.6e-4 of f L^2.
    assert np.max(errors[1][:, 2]) <= 2e-4
    # Or round-off: strains of 3e-3 out of products of order 1, E A h over the force: 1e-8.
    assert np.max(errors[1][:, 2]) <= max(0.3 * np.max(errors[0][:, 2]), 1e-8)
    # The strains are 3e-3: the shear of a section that bends, and what they leave in the axes.
    assert np.max(errors[1][:, :2]) <= 1e-3


def test_an_elastica_has_the_moment_of_the_force_times_its_arm():
    strip = Rectangle(height=0.02, width=0.02)
    bending = STEEL.youngs_modulus * 0.02 * 0.02**3 / 12
    P = np.array([0.0, 3 * bending])
    for n in (16, 32):
        scene = cantilever(n, lambda rod: PointForce(rod.at_end, tuple(P)), 2, strip)
        (rod,), state = scene.beams, at_rest(scene)
        solution, _ = state
        tip = solution.position(rod.at_end)[0]
        # The tip of the elastica, from elliptic integrals at P L^2/(E I) = 3; shear adds 1e-4.
        assert tip == pytest.approx((1 - 0.25442, 0.60325), abs=3e-4)
        points = [rod.at((e + xi) / n) for e in range(n) for xi in (0.0, GAUSS, 0.5)]
        expected = np.array([statics(solution, point, P, tip) for point in points])
        error = np.abs(seen(scene, state, points) - expected)
        assert np.max(error) <= 1e-8 * np.linalg.norm(P)


def quarter(n):
    """A quarter of a circle of radius 1 m in the plane, clamped at its start."""
    turn = np.linspace(0.0, np.pi / 2, n + 1)
    c, s = np.cos(turn), np.sin(turn)
    frames = np.stack([np.stack([c, s], 1), np.stack([-s, c], 1)], axis=1)
    return CurvedBeam("rod", np.stack([s, 1 - c], 1), frames, PLATE, STEEL)


def test_a_curved_beam_is_in_balance():
    P, rod = np.array([50.0, 100.0]), quarter(8)
    scene = Scene(
        [rod], [Clamp(rod.at_start, name="wall")], loads=[PointForce(rod.at_end, tuple(P))]
    )
    solution, system = at_rest(scene)
    points = [rod.at((e + xi) / 8) for e in (0, 4) for xi in (0.0, 0.3, 0.5)]
    tip = solution.position(rod.at_end)[0]
    expected = np.array([statics(solution, point, P, tip) for point in points])
    found = seen(scene, (solution, system), points)
    assert np.max(np.abs(found - expected)) <= 1e-8 * np.linalg.norm(P)


def test_a_twisted_beam_carries_the_tractions_of_a_homogeneous_strain():
    # r = F X in all of the beam: one S everywhere, and the tractions F S n add up to A F S n.
    x = np.linspace(0.0, 1.0, 17)
    turn = 0.5 * np.pi * x
    c, s, none = np.cos(turn), np.sin(turn), 0 * turn
    axes = [[none + 1, none, none], [none, c, s], [none, -s, c]]
    places, thick = np.outer(0.5 * x, [1.0, 0.0, 0.0]), Rectangle(0.1, 0.06)
    law = SaintVenantKirchhoff()
    rod = CurvedBeam("rod", places, np.moveaxis(np.array(axes), -1, 0), thick, STEEL, energy=law)
    system = assemble(Scene([rod]))
    F = np.eye(3) + 1e-3 * np.array([[3.0, 1.0, -2.0], [2.0, -1.0, 4.0], [1.0, -3.0, 2.0]])
    q = (system.start()[0].reshape(-1, 3) @ F.T).reshape(1, -1)
    states = States(np.zeros(1), q, 0 * q, np.zeros((1, 0)))
    E, nu, strain = 2e11, 0.3, (F.T @ F - np.eye(3)) / 2
    S = E / (1 + nu) * (strain + nu / (1 - 2 * nu) * np.trace(strain) * np.eye(3))
    point = rod.at(0.53)
    frame = (system.naming.vector(point, quantity) for quantity in (2, 3))
    y, z = (v.weights @ q.reshape(-1, 3)[v.vectors] for v in frame)
    n, y = np.cross(y, z) / np.linalg.norm(np.cross(y, z)), y / np.linalg.norm(y)
    expected = 0.1 * 0.06 * np.array([n, y, np.cross(n, y)]) @ F @ S[:, 0]
    found = [o.value(system, states)[0] for o in forces(point, 3)[:3]]
    # Between nodes an element turned by phi = 0.098 rad has a section smaller by phi^2/4. The
    # transposed map of stresses is 7e-3 to 1.7e-2 off.
    np.testing.assert_allclose(found, expected, rtol=3e-3)


@pytest.mark.parametrize("d", [2, 3])
def test_the_section_at_a_clamp_carries_the_reaction(d):
    P = np.array([-20.0, 60.0, 30.0])[:d]
    scene = cantilever(4, lambda rod: PointForce(rod.at_end, tuple(P)), d)
    (rod,), state = scene.beams, at_rest(scene)
    wall = [observe(reaction("wall", axis), *state)[0] for axis in range(d)]
    found = seen(scene, state, [rod.at(0.0)])[0, :d]
    across = section_axes(state[0], rod.at_start) @ wall
    assert np.max(np.abs(found + across)) <= 1e-8 * np.linalg.norm(P)


def test_internal_damping_is_part_of_the_forces():
    # Without Poisson's effect: stretched by lambda at a rate, S = E (e + tau e'), N = lambda A S.
    damped = dataclasses.replace(LOOSE, damping_time=0.02)
    stretch, rate = 1.01, 0.3
    for element in (BEAM_2D, CABLE_2D):
        rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, PLATE, damped, element=element)
        # Free ends would carry no force.
        system = assemble(Scene([rod], [Pin(rod.at_start), Pin(rod.at_end)]))
        q = system.start()[0].reshape(-1, 2)
        v = np.zeros_like(q)
        # Positions and tangents along x, which grow with the stretch; heights do not.
        along = np.arange(len(q)) % len(element.quantities) < 2
        v[along] = rate * q[along]
        q[along, 0] *= stretch
        states = States(np.zeros(1), q.reshape(1, -1), v.reshape(1, -1), np.zeros((1, 0)))
        strain, strain_rate = (stretch**2 - 1) / 2, stretch * rate
        S = STEEL.youngs_modulus * (strain + 0.02 * strain_rate)
        found = axial_force(rod.at(0.3)).value(system, states)[0]
        assert found == pytest.approx(stretch * 0.02 * 0.01 * S, rel=1e-12)
        if element is BEAM_2D:
            stress = von_mises(rod.at(0.3, y=0.01)).value(system, states)[0]
            assert stress == pytest.approx(S, rel=1e-12)


# ---------------------------------------------------------------- stress


def test_stress_of_tension_bending_and_torsion():
    section = Circle(0.01)
    A, I = np.pi * 1e-4, np.pi / 4 * 1e-8
    loads = {
        "tension": (lambda rod: PointForce(rod.at_end, (5e3, 0.0, 0.0)), 5e3 / A),
        "bending": (lambda rod: Moment(rod.at_end, (0.0, 0.0, 50.0)), 50.0 * 0.01 / I),
        "torsion": (lambda rod: Moment(rod.at_end, (50.0, 0, 0)), np.sqrt(3) * 25.0 * 0.01 / I),
    }
    for name, (load, expected) in loads.items():
        scene = cantilever(8, load, section=section)
        state, (rod,) = at_rest(scene), scene.beams
        point = rod.at((4 + GAUSS) / 8, y=0.01)
        # Strains of 1e-4 to 4e-4, and what is left of bending and twist of 0.005 rad an element.
        assert observe(von_mises(point), *state)[0] == pytest.approx(expected, rel=1e-3), name
        if name != "tension":
            inside = observe(von_mises(rod.at((4 + GAUSS) / 8, y=0.005)), *state)[0]
            assert inside == pytest.approx(expected / 2, rel=1e-3)


def test_plane_strain_has_a_stress_across_the_plane():
    # Uniaxial strain e along x: S = (lambda + 2 G, lambda, lambda) e, von Mises' 2 G e.
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, PLATE, STEEL, energy=SaintVenantKirchhoff())
    thin = dataclasses.replace(rod, name="thin", energy=PlaneStress())
    system = assemble(Scene([rod, thin]))
    q = system.start()[0].reshape(-1, 2)
    q[np.arange(len(q)) % 3 < 2, 0] *= 1.001
    states = States(np.zeros(1), q.reshape(1, -1), 0 * q.reshape(1, -1), np.zeros((1, 0)))
    e, E, nu = (1.001**2 - 1) / 2, 2e11, 0.3
    found = [von_mises(beam.at(0.4)).value(system, states)[0] for beam in (rod, thin)]
    # Plane stress: S = E/(1 - nu^2) (1, nu) e.
    factor = np.sqrt(1 - nu + nu**2)
    assert np.allclose(found, [E / (1 + nu) * e, E / (1 - nu**2) * factor * e], rtol=1e-12)


SECTIONS = [
    PLATE,
    Circle(0.01),
    Tube(0.02, 0.003),
    Box(0.04, 0.02, 2e-3, 3e-3),
    ISection(0.04, 0.02, 2e-3, 3e-3),
    GeneralSection(2e-4, 2e-8, 1e-8, 2e-8),
    QuadratureSection(
        places=[(0.01, 0.0), (-0.01, 0.01), (-0.01, -0.01)], areas=[1e-4, 1e-4, 1e-4]
    ),
]


# Those without a shape know no stress in torsion.
@pytest.mark.parametrize(
    ("d", "section"),
    [*((2, section) for section in SECTIONS), *((3, section) for section in SECTIONS[:5])],
)
def test_the_smooth_maximum_bounds_the_stresses_of_a_beam(d, section):
    P = (-200.0, 60.0, 30.0)[:d]
    scene = cantilever(3, lambda rod: PointForce(rod.at_end, P), d, section)
    state, (rod,) = at_rest(scene), scene.beams
    y, z = (x[0] for x in section.outline(np.array([section.sizes()])))
    if d == 2:
        y, z = np.array([np.min(y), (np.min(y) + np.max(y)) / 2, np.max(y)]), np.zeros(3)
    # A point just before a node belongs to the element before.
    places = [(e + xi) / 3 for e in range(3) for xi in (0.0, 0.5, 1.0 - 1e-9)]
    points = [rod.at(x, a, b) for x in places for a, b in zip(y, z, strict=True)]
    stresses = np.array([observe(von_mises(point), *state)[0] for point in points])
    largest, n = np.max(stresses), len(points)
    for k in (20.0 / largest, 200.0 / largest):
        found = observe(maximum_von_mises("rod", k), *state)[0]
        # The points before the nodes lie 1e-9 off.
        assert largest * (1 - 1e-8) <= found <= largest + np.log(n) / k
        assert found == pytest.approx(
            np.log(np.sum(np.exp(k * (stresses - largest)))) / k + largest
        )


# ---------------------------------------------------------------- partials

CASES = [
    *((2, PLATE, energy, curved) for energy, _, _ in LAWS[:4] for curved in (False, True)),
    (2, PLATE, "cable", False),
    *((3, section, EnhancedContinuum(), False) for section in SECTIONS),
    (3, PLATE, SaintVenantKirchhoff(), True),
    (3, Tube(0.02, 0.003), EnhancedContinuum(), True),
]


def bent(d, section, energy, curved):
    """A damped beam of two elements, in a random state around its reference."""
    damped = dataclasses.replace(STEEL, damping_time=1e-3)
    arguments = {"section": section, "material": damped, "initial_strain": 0.01}
    arguments |= {"element": CABLE_2D} if energy == "cable" else {"energy": energy}
    if not curved:
        z = (0.0,) * (d - 2)
        return Beam("rod", (0.0, 0.0, *z), (0.3, 0.1, *z), elements=2, **arguments)
    turn = np.linspace(0.0, 0.5, 3)
    c, s, zero = np.cos(turn), np.sin(turn), np.zeros(3)
    places, frames = np.stack([s, 1 - c, zero], 1), np.zeros((3, 3, 3))
    frames[:, 0], frames[:, 1] = np.stack([c, s, zero], 1), np.stack([-s, c, zero], 1)
    frames[:, 2, 2] = 1.0
    return CurvedBeam("rod", places[:, :d], frames[:, :d, :d], **arguments)


@pytest.mark.parametrize(("d", "section", "energy", "curved"), CASES)
def test_partials_are_those_of_the_value(d, section, energy, curved):
    rod = bent(d, section, energy, curved)
    design = [f"rod.{name}" for name in rod.parameter_names()]
    design[-1] += "[1]"
    system, random = assemble(Scene([rod]), design), np.random.default_rng(5)
    q, v = system.start()
    q, v = (x + s * random.standard_normal((4, len(q))) for x, s in ((q, 0.02), (v, 1.0)))
    states = States(np.arange(4.0), q, v, np.zeros((4, 0)))
    dq, dv = random.standard_normal((2, *q.shape))
    db = system.b * random.standard_normal(system.n_b)
    moved = States(states.t, q + 1j * EPS * dq, v + 1j * EPS * dv, states.lam)
    shifted = system.with_values(system.b + 1j * EPS * db)
    y = (1 - 1e-9) * section.half_extents[0] if d == 3 else 0.003
    stresses = [von_mises(rod.at(0.7, y)), maximum_von_mises("rod", 1e-9)]
    if energy == "cable" or (d == 3 and section in SECTIONS[5:]):
        stresses = []
    for observable in [*forces(rod.at(0.3), d), *forces(rod.at(1.0), d), *stresses]:
        observable.check(system)
        p = observable.partials(system, states)
        assert np.array_equal(p.value, observable.value(system, states))
        on_v = 0 * q if p.v is None else p.v
        along = np.sum(p.q * dq, axis=1) + np.sum(on_v * dv, axis=1) + p.b @ db
        size = np.sum(np.abs(p.q * dq), axis=1) + np.sum(np.abs(on_v * dv), axis=1)
        slope = observable.value(shifted, moved).imag / EPS
        # Sums of a few hundred terms of size `size`, 1e-16 each.
        assert np.all(np.abs(slope - along) <= 1e-13 * (size + np.abs(p.b) @ np.abs(db)))


def test_values_do_not_see_rigid_motions_and_scale_with_units():
    P = np.array([-20.0, 60.0, 30.0])
    scene = cantilever(3, lambda rod: PointForce(rod.at_end, tuple(P)))
    (rod,), (solution, system) = scene.beams, at_rest(scene)
    observables = [
        *forces(rod.at(0.4), 3),
        von_mises(rod.at(0.4, y=0.01)),
        maximum_von_mises("rod", 1e-7),
    ]
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, s, c], [0, -c, s]]
    )
    vectors = solution.q.reshape(-1, 3) @ turn.T
    vectors[::4] += (3.0, -2.0, 5.0)
    states = States(np.zeros(1), vectors.reshape(1, -1), 0 * solution.q, solution.lam)
    for observable in observables:
        before = observe(observable, solution, system)[0]
        # Strains are differences of numbers of size one, against those of the load, 1e-4.
        assert observable.value(system, states)[0] == pytest.approx(before, rel=1e-8, abs=1e-6)


def test_gradients_by_every_method_agree_with_the_complex_step():
    rubber = Material(1100.0, 1e6, 0.3, damping_time=1e-3)
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 4, Rectangle(0.06, 0.04), rubber)
    scene = Scene(
        [rod],
        [Pin(rod.at_start, name="pin")],
        (0.0, -9.81),
        [InitialVelocity("rod", 1.0, (0.0, 0.0))],
    )
    objectives = [
        SmoothMaximum(maximum_von_mises("rod", 1e-3), 1e-3),
        Terminal(bending_moment(rod.at(0.5))),
        Terminal(axial_force(rod.at(0.1)) * shear_force(rod.at(0.6))),
    ]
    design = ["rod.length", "rod.height", "rod.youngs_modulus", "rod.damping_time"]
    found = {
        type(method).__name__: gradients(
            scene, objectives, 0.25, HHT(2**-7), design=design, method=method
        )
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    }
    for k in range(len(objectives)):
        exact = found["ComplexStep"][k].gradient
        for name in ("DirectDifferentiation", "Adjoint"):
            assert np.allclose(found[name][k].gradient, exact, rtol=1e-9, atol=0), (name, k)


def test_static_gradients_are_limits_of_differences():
    def scene(h):
        section = Rectangle(h, 0.01)
        return cantilever(4, lambda rod: PointForce(rod.at_end, (0.0, 60.0)), 2, section)

    objective, s = maximum_von_mises("rod", 1e-7), 2e-5
    found = equilibrium_gradient(scene(0.02), objective, design=["rod.height"]).gradient[0]
    values = [
        equilibrium_gradient(scene(0.02 + x), objective, design=["rod.height"]).value
        for x in (s, -s)
    ]
    # Third derivatives leave (s/h)^2 = 1e-6.
    assert found == pytest.approx((values[0] - values[1]) / (2 * s), rel=1e-5)


# ---------------------------------------------------------------- what does not exist


def test_what_a_beam_does_not_have_is_refused():
    scene = cantilever(2, lambda rod: PointForce(rod.at_end, (0.0, 1.0)), 2)
    (rod,), system = scene.beams, assemble(scene)
    for observable, text in (
        (torsional_moment(rod.at_end), "planar"),
        (shear_force(rod.at_end, 2), "planar"),
        (bending_moment(rod.at_end, 1), "planar"),
        (von_mises(rod.at(0.5, y=0.02)), "in the section"),
    ):
        with pytest.raises(InvalidInputError, match=text):
            observable.check(system)
    other = dataclasses.replace(rod, name="rood")
    for observable in (
        axial_force(other.at_end),
        von_mises(other.at_end),
        maximum_von_mises("rood", 1.0),
    ):
        with pytest.raises(UnknownNameError):
            observable.check(system)
    for action, text in (
        (lambda: axial_force(rod.at(0.5, y=0.01)), "axis of the beam"),
        (lambda: shear_force(rod.at_end, 0), "axis of the section"),
        (lambda: bending_moment(rod.at_end, 3), "from 0 to 2"),
        (lambda: von_mises("rod"), "MaterialPoint"),
        (lambda: maximum_von_mises("rod", -1.0), "positive"),
    ):
        with pytest.raises(InvalidInputError, match=text):
            action()


def test_rigid_beams_have_neither_forces_nor_stresses():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, PLATE, STEEL, rigid=True)
    system = assemble(Scene([rod]))
    for observable in (
        axial_force(rod.at_end),
        von_mises(rod.at_end),
        maximum_von_mises("rod", 1.0),
    ):
        with pytest.raises(InvalidInputError, match="must deform"):
            observable.check(system)


def test_a_rigid_beam_before_it_leaves_the_forces_of_a_beam_alone():
    P = (0.0, 60.0)
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 4, PLATE, STEEL)
    post = Beam("post", (0.0, -1.0), (0.0, 0.0), 3, PLATE, STEEL, rigid=True)
    found = []
    for beams in ([rod], [post, rod]):
        joints = [Clamp(rod.at_start, name="wall"), *(Clamp(x.at_start) for x in beams[:-1])]
        solution, system = at_rest(Scene(beams, joints, loads=[PointForce(rod.at_end, P)]))
        observables = [bending_moment(rod.at(0.3)), maximum_von_mises("rod", 1e-6)]
        found.append([observe(x, solution, system)[0] for x in observables])
    # The tolerance of the search for the equilibrium.
    assert np.allclose(found[0], found[1], rtol=1e-6)
