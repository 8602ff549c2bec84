"""Initial strain of beams and cables: energy, taut strings, nets, buckling by heat, gradients."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    BEAM_2D,
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    DOP853,
    HHT,
    IDA,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    Integral,
    Material,
    Pin,
    PointForce,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    assemble,
    check_system,
    equilibrium,
    equilibrium_gradient,
    gradient,
    modes,
)
from ancfdae.assembly.elastic_forces import strain_energy
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.model.elements import Batch, ElementParameter, SaintVenantKirchhoff
from ancfdae.model.elements.continuum import prepare
from ancfdae.observables import axial_force, maximum_von_mises, position, reaction, von_mises
from ancfdae.sections import Circle, Rectangle
from ancfdae.studies.meshes import model_kinds
from tests.support import element_forces
from tests.support.element_kinds import ENERGIES, arc, kind_of, straight
from tests.support.oracle import plain_ancf, plain_cable

ELEMENTS = [BEAM_2D, BEAM_3D, CABLE_2D, CABLE_3D]
E, NU, RHO, L, HEIGHT, WIDTH, STRAIN = 2.1e6, 0.3, 2770.0, 0.7, 0.06, 0.04, 0.03
STEP = 1e-40
each_element = pytest.mark.parametrize("element", ELEMENTS, ids=lambda element: element.name)


def values(strain=STRAIN, damping_time=0.0):
    own = np.zeros((1, len(ElementParameter)))
    own[0, :8] = E, NU, RHO, L, damping_time, strain, HEIGHT, WIDTH
    return own


# ---- the law


def strains_along(element, X):
    """Strains along the axis at points of the volume, with the volume that they stand for."""
    if element.default_energy is None:
        for xi, weight in zip(*np.polynomial.legendre.leggauss(5), strict=True):
            r_x = plain_cable.shape_gradient(element.d, (1 + xi) / 2, 0, 0, L)[:, 0] @ X
            yield (r_x @ r_x - 1) / 2, weight / 2 * L * HEIGHT * WIDTH
        return
    for _, g, volume in plain_ancf.quadrature_points(element.d, HEIGHT, WIDTH, L):
        yield plain_ancf.strain(X, g)[1][0, 0], volume


@each_element
def test_energy_has_the_work_of_the_initial_stress(element):
    """The stress E eps_i along the axis, alone: sections have contracted with it."""
    d, n_s, slim = element.d, element.n_s, element.default_energy is None
    kind = kind_of(d, None if slim else SaintVenantKirchhoff())
    Y_unit = np.eye(d)[[0, 0, 0]][None] if slim else straight(d)
    law = prepare(element, Batch(kind, values(), Y_unit))
    chosen = [int(q) + k * (d + 1) for k in (0, 1) for q in element.quantities]
    X = plain_ancf.straight_reference(d, L)[chosen]
    X = X + 0.1 * np.random.default_rng(d).standard_normal(X.shape)
    Y = np.concatenate([[X[n_s] - X[0]], X[1:n_s], X[n_s + 1 :]])[None]
    # Plane strain resists a stretch along the axis with E/(1 - nu^2).
    stress = STRAIN * (E / (1 - NU**2) if element is BEAM_2D else E)
    expected = (plain_cable if slim else plain_ancf).energy(X, E, NU, HEIGHT, WIDTH, L)
    for along, volume in strains_along(element, X):
        expected += volume * stress * (along + STRAIN / 2)
    if (
        slim
    ):  # E I is that of the cable free of stress, whose lengths are sqrt(1 - 2 eps_i) of these.
        bent = plain_cable.bending_energy(X, E, HEIGHT, WIDTH, L)
        expected += bent * (1 / np.sqrt(1 - 2 * STRAIN) - 1)
    # Round-off as in test_invariants: sums of some hundred terms.
    assert strain_energy(law.A, law.g_o, Y, law.bending)[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("form", ["straight", "curved"])
@pytest.mark.parametrize("element", [BEAM_2D, BEAM_3D], ids=lambda element: element.name)
def test_forces_have_exact_partials_whatever_the_energy(element, form):
    d, rng = element.d, np.random.default_rng(2)
    own, Y_unit = values(damping_time=0.02), straight(d) if form == "straight" else arc(d)
    Y, V = Y_unit + 0.1 * rng.standard_normal((2, *Y_unit.shape))
    tau, P = own[:, ElementParameter.DAMPING_TIME], ElementParameter
    wanted = (P.INITIAL_STRAIN, P.POISSON_RATIO, P.LENGTH, P.SIZE_1)
    for energy in ENERGIES.values():
        if d not in energy.dimensions:
            continue
        kind = kind_of(d, energy, straight=form == "straight")
        law = prepare(element, Batch(kind, own, Y_unit))
        for which in wanted:
            moved = own.astype(complex)
            moved[0, which] += 1j * STEP
            by = prepare(element, Batch(kind, moved, Y_unit))
            expected = element_forces.force(by.A, by.g_o, Y, V, tau).imag / STEP
            found = element_forces.force_partial(
                (law.A, law.g_o, None), law.partials([which])[which], Y, V, tau
            )
            scale = np.max(np.abs(expected))
            # Two evaluations of one derivative, each a sum of some hundred terms.
            assert np.max(np.abs(found - expected)) <= 1e-11 * scale


# ---- a beam between walls


def taut(element, strain, n=8, ends=Clamp, damping_time=0.0, length=2.0, height=0.01):
    flat = (0.0,) * (element.d - 1)
    round_one = element.default_energy is None
    section = Circle(height / 2) if round_one else Rectangle(height, height)
    metal = Material(7850.0, 2.1e11, NU, damping_time)
    wire = Beam(
        "wire", (0.0, *flat), (length, *flat), n, section, metal, element=element,
        initial_strain=strain,
    )  # fmt: skip
    moments = section.second_moments()
    area = np.pi * height**2 / 4 if round_one else height**2
    return Scene([wire], [ends(wire.at_start, name="wall"), ends(wire.at_end)]), area, moments[0, 0]


@each_element
def test_stress_force_and_reaction_are_those_of_the_strain(element):
    scene, area, _ = taut(element, 1e-3)
    point = scene.beams[0].at(0.3)
    stress = 2.1e11 * 1e-3
    for observable, expected in (
        (axial_force(point), stress * area),
        (reaction("wall", 0), -stress * area),
        (von_mises(point), stress),
        (maximum_von_mises("wire", 1e-2 * stress), stress),
    ):
        found = equilibrium_gradient(scene, observable, design=["wire.initial_strain"])
        # SMALL_STRAIN = 1e-9 is added to bending stress of a cable in space: 1e-6 of 1e-3.
        assert found.value == pytest.approx(expected, rel=2e-6)
        assert found.gradient == pytest.approx([expected / 1e-3], rel=2e-6)
    system = assemble(scene)
    q, v = system.start()
    energy = system.energies.total(q[None], v[None])[0]
    assert energy == pytest.approx(0.5 * stress * 1e-3 * area * 2.0, rel=1e-10)


@each_element
def test_a_taut_string_with_its_derivative_and_its_damping(element):
    """w_n^2 = k^2 T/mu + k^4 E I/mu, k = n pi/L; only bending strains change, so only they damp."""
    strain, tau = 1e-3, 1e-5
    scene, area, inertia = taut(element, strain, 16, Pin, tau)
    # Every mode stands twice in space, and a beam there is free to turn about itself first.
    skip, alike = int(element is BEAM_3D), element.d - 1
    found = modes(scene, skip + 3 * alike, design=["wire.initial_strain"])
    k, mu = np.arange(1, 4) * np.pi / 2.0, 7850.0 * area
    # M = E I dtheta/ds_o of a cable, with the length s_o = free s of the cable free of stress.
    free = 1.0 if element.default_energy else np.sqrt(1 - 2 * strain)
    bent = k**4 * 2.1e11 * inertia / free / mu
    expected = np.sqrt(k**2 * 2.1e11 * area * strain / mu + bent)
    slope = k**2 * 2.1e11 * area / mu / (2 * expected)
    if not element.default_energy:
        slope = slope + bent / free**2 / (2 * expected)
    # A beam loses (k h)^2/12 = 2e-4 to shear and rotary inertia, and the same times a few of the
    # share of bending; of a cable the mesh leaves (k l)^4/720 of a sixth.
    rel = 4e-4 if element.default_energy else 3e-5
    chosen = slice(skip, None, alike)
    assert found.natural_frequencies[chosen] == pytest.approx(expected, rel=rel)
    assert found.natural_frequencies_b[chosen, 0] == pytest.approx(slope, rel=rel)
    # That of a cable acts on its axial strain only.
    ratios = 0.5 * tau * bent / expected if element.default_energy else np.zeros(3)
    assert found.damping_ratios[chosen] == pytest.approx(ratios, rel=1e-3, abs=1e-12)


@each_element
def test_heat_buckles_a_clamped_column(element):
    """4 pi^2 E I/L^2 = E A alpha dT (Euler): the lowest squared frequency vanishes there."""
    _, area, inertia = taut(element, 0.0)
    critical = 4 * np.pi**2 * inertia / area / 2.0**2
    places = critical * np.array([0.97, 0.99])
    scenes = (taut(element, -place, 16)[0] for place in places)
    squares = [modes(scene, 1).frequencies[0] ** 2 for scene in scenes]
    # The square of a frequency is linear in the strain, except by its shape: (1 - share)^2 = 1e-4.
    found = places[1] + squares[1] * np.diff(places)[0] / (squares[0] - squares[1])
    assert found == pytest.approx(critical, rel=1e-3)


def test_a_free_beam_grows_with_heat_and_stays_similar():
    """Straight or curved: arcs are longer by sqrt(1 + 2 alpha dT), angles as before."""
    heat, angles = 0.01, np.linspace(0, 1.2, 5)
    tangents = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    frames = np.stack([tangents, tangents[:, ::-1] * (-1, 1)], axis=1)
    places = np.stack([np.sin(angles), 1 - np.cos(angles)], axis=1)
    metal = Material(1000.0, 1e7, NU)
    bow = CurvedBeam("bow", places, frames, Rectangle(0.05, 0.05), metal)
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.05, 0.05), metal)
    for beam, end in ((rod, (1.0, 0.0)), (bow, places[-1])):
        hot = replace(beam, initial_strain=-heat)
        found = equilibrium(Scene([hot], [Clamp(beam.at_start)]))
        # A clamp holds the unit tangent of an end free to grow across: 1 + 2e-4 along it remains.
        place = found.solution.position(beam.at_end)[0]
        assert place == pytest.approx(np.sqrt(1 + 2 * heat) * np.array(end), abs=1e-3 * heat)


# ---- nets


def test_a_net_that_is_taut_by_itself_stands_where_force_densities_have_it():
    """Four cables of their own strains between a node and the walls, with exact derivatives."""
    walls = np.array([(1.0, 0, 0.3), (-1.2, 0.1, 0.3), (0, 1.1, -0.3), (0.2, -0.9, -0.2)])
    strains, stiffness, load = np.array([0.1, 0.05, 0.08, 0.02]), 50.0, (0.2, -0.1, 0.5)
    metal, thin = Material(1e3, stiffness / (np.pi * 1e-6), NU), Circle(1e-3)
    cables = [
        Beam(f"c{k}", (0, 0, 0), tuple(wall), 1, thin, metal, element=CABLE_3D, initial_strain=e)
        for k, (wall, e) in enumerate(zip(walls, strains.tolist(), strict=True))
    ]
    joints = [Pin(cable.at_end) for cable in cables]
    joints += [Pin(cable.at_start, cables[0].at_start) for cable in cables[1:]]
    scene = Scene(cables, joints, loads=[PointForce(cables[0].at_start, load)])
    place = position(cables[0].at_start, 2)
    found = equilibrium_gradient(scene, place, design=[f"c{k}.initial_strain" for k in range(4)])

    def height(strains):
        x, length = np.zeros(3, dtype=strains.dtype), np.linalg.norm(walls, axis=1)
        for _ in range(30):
            chord = walls - x
            q = stiffness / length * (np.sum(chord**2, axis=1) / length**2 - 1 + 2 * strains) / 2
            K = np.sum(q) * np.eye(3) + np.einsum("k,ki,kj", stiffness / length**3, chord, chord)
            x = x + np.linalg.solve(K, load + q @ chord)
        return x[2]

    exact = [height(strains + 1j * STEP * unit).imag / STEP for unit in np.eye(4)]
    # Equilibria are solved to 1e-10 of the forces.
    assert found.value == pytest.approx(height(strains), rel=1e-8)
    assert found.gradient == pytest.approx(exact, rel=1e-8)


# ---- motions


def slack(element, n=2):
    """A wire with a beam at its end, which start with strains that no support balances."""
    flat, tau = (0.0,) * (element.d - 2), 2e-3
    soft = Material(1000.0, 1e7, NU, tau)
    wire = Beam(
        "wire", (0, 0, *flat), (1.0, 0.1, *flat), n, Circle(0.01), soft, element=element,
        initial_strain=0.01,
    )  # fmt: skip
    post = Beam("post", (1.0, 0.1, *flat), (1.0, -0.8, *flat), 1, Circle(0.03), soft,
                initial_strain=-0.002)  # fmt: skip
    joints = [Pin(wire.at_start), Pin(wire.at_end, post.at_start)]
    return Scene([wire, post], joints, (0.0, -9.81, *flat))


DESIGN = ["wire.initial_strain", "post.initial_strain", "wire.length", "wire.damping_time"]


@each_element
def test_gradients_agree_and_are_the_limit_of_differences(element):
    scene = slack(element)
    wire = scene.beams[0]
    for objective in (
        Terminal(position(wire.at_end, 1)),
        Integral(maximum_von_mises("wire", 1e4)),
        Integral(axial_force(wire.at(0.6)) ** 2),
    ):
        call = objective, 2.0**-5, HHT(2.0**-8)
        direct = gradient(scene, *call, design=DESIGN)
        for method in (Adjoint(), ComplexStep()):
            other = gradient(scene, *call, design=DESIGN, method=method)
            assert other.gradient == pytest.approx(direct.gradient, rel=1e-10)
        for name, slope in zip(DESIGN[:2], direct.gradient[:2], strict=True):
            held = scene.beam(name.split(".")[0]).initial_strain
            ends = [
                gradient(scene.with_values({name: held + s * 1e-6}), *call, design=[name]).value
                for s in (1, -1)
            ]
            # Steps of 1e-6 leave round-off of 1e-16/1e-6 of the value, and (1e-6/0.01)^2.
            assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(slope, rel=1e-5)


def test_every_integrator_takes_it():
    scene = slack(BEAM_2D)
    objective = Terminal(position(scene.beams[0].at_end, 1))
    soft = Scene(scene.beams[:1], [scene.joints[0]], scene.gravity)
    for integrator in (Radau(rtol=1e-7), IDA(rtol=1e-8), DOP853(rtol=1e-6)):
        its = soft if isinstance(integrator, DOP853) else scene
        names = DESIGN[::2] if its is soft else DESIGN
        found = gradient(its, objective, 2.0**-6, integrator, design=names)
        exact = gradient(its, objective, 2.0**-6, HHT(2.0**-13), design=names)
        assert found.gradient == pytest.approx(exact.gradient, rel=1e-3)


@pytest.mark.parametrize("element", [BEAM_2D, CABLE_3D], ids=lambda element: element.name)
def test_a_strained_scene_is_a_system(element):
    assert check_system(assemble(slack(element, 1), DESIGN), samples=1)


# ---- what is refused


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 0.5, -0.5, "0.1", None, True, (0.1, 0.2)])
def test_strains_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InvalidInputError, match="initial_strain"):
        replace(slack(BEAM_2D).beams[0], initial_strain=wrong)


def test_what_is_rigid_has_none():
    scene = slack(BEAM_2D)
    wire = scene.beams[0]
    with pytest.raises(InvalidInputError, match="rigid"):
        replace(wire, rigid=True)
    rigid = replace(wire, rigid=True, initial_strain=0.0)
    block = RigidBody("block", (0, 0), 1.0, 1.0)
    for body, beams, bodies in ((rigid, [rigid], []), (block, [], [block])):
        with pytest.raises(UnknownNameError, match="initial_strain"):
            Scene(beams, bodies=bodies).with_values({f"{body.name}.initial_strain": 1e-3})
    with pytest.raises(InvalidInputError, match="whole beam"):
        scene.with_values({"wire.initial_strain[0]": 1e-3})
    with pytest.raises(InvalidInputError, match=r"wire\.initial_strain"):
        scene.with_values({"wire.initial_strain": 0.7})
    # A model without strain leaves it out.
    assert not any(x.initial_strain for x in next(model_kinds(scene, {})).build().beams)
