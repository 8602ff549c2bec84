"""Section forces against what acts beyond the section, over random beams, and against the energy.

Straight, curved, pretwisted, tapered and off-axis beams of every section and energy. What acts at
nodes is carried exactly, to the residual of the equilibrium, 1e-8 of the load, on any mesh; what is
spread along elements, weight and inertia, leaves the square of their length.
"""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ancfdae import (
    BEAM_2D,
    BEAM_3D,
    HHT,
    Clamp,
    CurvedBeam,
    DistributedForce,
    EnhancedContinuum,
    Material,
    Moment,
    PlaneStress,
    PointForce,
    SaintVenantKirchhoff,
    Scene,
    assemble,
    equilibrium,
    simulate,
)
from ancfdae.laws import SmoothStep
from ancfdae.model.elements import Batch, ElementParameter
from ancfdae.model.elements.element import SectionPlace
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
from tests.support.element_kinds import arc, kind_of, straight
from tests.support.oracle import plain_rod, plain_strains
from tests.support.sections import forces, section_axes

PLACES = [(0.03, 0.03), (0.03, -0.01), (-0.01, -0.01), (-0.01, 0.03)]
OFF = QuadratureSection(
    places=PLACES, areas=[4e-4] * 4, shear_factors=(0.8, 0.7), torsion_constant=2e-7
)
SECTIONS = [
    Rectangle(0.06, 0.03),
    Circle(0.03),
    Tube(0.03, 0.008),
    Box(0.06, 0.04, 5e-3, 8e-3),
    ISection(0.06, 0.05, 6e-3, 8e-3),
    GeneralSection(1e-3, 2e-7, 1e-7, 1e-7),
    OFF,
]
ENERGIES = [EnhancedContinuum(), EnhancedContinuum(False), SaintVenantKirchhoff(True)]
ENERGIES += [SaintVenantKirchhoff(), PlaneStress(True)]
RUBBER = Material(1000.0, 1e7, 0.3, damping_time=1e-3)


def beam(d, n, section, energy, rates, taper=0.0):
    """A helix of constant rates of turn, of length 1; `rates` of the plane are about z."""
    motions = [plain_rod.helix(rates, k / n) for k in range(n + 1)]
    places, frames = (np.array(part) for part in zip(*motions, strict=True))
    names = section.size_names()
    sizes = [1 - taper * (k + 0.5) / n for k in range(n)]
    sections = [
        section.with_sizes({name: s * x for name, x in zip(names, section.sizes(), strict=True)})
        for s in sizes
    ]
    frames = frames.swapaxes(1, 2)
    return CurvedBeam("rod", places[:, :d], frames[:, :d, :d], sections, RUBBER, energy=energy)


def spatial(vector):
    return np.append(vector, 0.0) if len(vector) == 2 else np.asarray(vector, dtype=float)


def in_section(solution, point, force, moment):
    """Components of a force and a moment in the axes of a section, as `forces` has them."""
    if solution.naming.layout.d == 2:
        return np.append(section_axes(solution, point) @ force[:2], moment[2])
    axes = section_axes(solution, point)
    return np.concatenate([axes @ force, axes @ moment])


@settings(max_examples=24)
@given(
    d=st.sampled_from([3, 3, 2]),
    section=st.sampled_from(SECTIONS),
    energy=st.sampled_from(ENERGIES),
    taper=st.sampled_from([0.0, 0.3]),
    seed=st.integers(0, 999),
)
def test_loads_at_nodes_are_carried_by_every_section(d, section, energy, taper, seed):
    if d == 3 and isinstance(energy, PlaneStress):
        energy = EnhancedContinuum()
    random, n = np.random.default_rng(seed), 3
    rates = random.uniform(-1.5, 1.5, 3) * random.integers(0, 2, 3)
    rod = beam(d, n, section, energy, rates if d == 3 else (0.0, 0.0, rates[2]), taper)
    bend = 0.3 * 1e7 * 1e-7
    # At the end, in the middle of a beam and off the axis there; a moment about all axes.
    points = [rod.at(1.0, 0.01, 0.005 * (d == 3)), rod.at(1 / 3)]
    F = [0.3 * bend * random.standard_normal(d) for _ in points]
    M = 0.1 * bend * random.standard_normal(3) if d == 3 else 0.1 * bend
    loads = [PointForce(p, f, name=f"P{k}") for k, (p, f) in enumerate(zip(points, F, strict=True))]
    loads += [Moment(rod.at(2 / 3), M)]
    scene = Scene([rod], [Clamp(rod.at_start, name="wall")], loads=loads)
    result = equilibrium(scene)
    assert result.outcome.success
    solution, system = result.solution, assemble(scene)
    M = M if d == 3 else np.array([0.0, 0.0, M])
    for fraction in (0.0, *random.uniform(0.0, 1.0, 3)):
        point = rod.at(fraction)
        place, force, moment = spatial(solution.position(point)[0]), np.zeros(3), np.zeros(3)
        for p, f in zip(points, F, strict=True):
            if p.fraction > fraction:
                force += spatial(f)
                moment += np.cross(spatial(solution.position(p)[0]) - place, spatial(f))
        moment += M * (fraction < 2 / 3)
        found = [observe(o, solution, system)[0] for o in forces(point, d)]
        expected = in_section(solution, point, force, moment)
        assert np.max(np.abs(found - expected)) <= 1e-7 * bend
        if fraction == 0.0:
            wall = [observe(reaction("wall", axis), solution, system)[0] for axis in range(d)]
            assert np.max(np.abs(np.array(wall) + force[:d])) <= 1e-7 * bend


def beyond(scene, section, rates, f, states, point):
    """Force and moment about a section of the loads f, weight and inertia beyond it."""
    (rod,), system, g = scene.beams, assemble(scene), spatial(scene.gravity)
    y, z, dA = (x[0] for x in section.points(np.array([section.sizes()]), True))

    def vectors(fraction):
        made = (system.naming.vector(rod.at(fraction), quantity) for quantity in range(4))
        return [
            np.array([v.weights @ x.reshape(-1, 3)[v.vectors] for x in states])
            for k, v in enumerate(made)
            if k != 1
        ]

    here, force, moment = vectors(point.fraction)[0][0], np.zeros(3), np.zeros(3)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    ends = np.unique([point.fraction, *(x for x in rod_fractions(rod) if x > point.fraction)])
    for start, end in pairwise(ends):
        for node, weight in zip(nodes, weights, strict=True):
            ds = weight / 2 * (end - start)
            r, r_y, r_z = vectors(start + (end - start) * (1 + node) / 2)
            force += f * ds
            moment += np.cross(r[0] - here, f) * ds
            mass = RUBBER.density * dA * (1 - rates[2] * y + rates[1] * z) * ds
            place = r[0] + np.outer(y, r_y[0]) + np.outer(z, r_z[0])
            pull = mass[:, None] * (g - r[1] - np.outer(y, r_y[1]) - np.outer(z, r_z[1]))
            force += pull.sum(axis=0)
            moment += np.cross(place - here, pull).sum(axis=0)
    return force, moment


def rod_fractions(rod):
    ends = np.cumsum(rod.reference().lengths)
    return ends / ends[-1]


MOVING = {
    "straight": (Rectangle(0.06, 0.03), (0.0, 0.0, 0.0)),
    "pretwisted": (Rectangle(0.06, 0.03), (1.0, 0.0, 0.0)),
    "helix off the axis": (OFF, (0.5, 0.8, -0.8)),
}


@pytest.mark.parametrize("name", MOVING)
@pytest.mark.parametrize("moves", [False, True])
def test_spread_loads_and_inertia_are_carried_to_second_order(name, moves):
    section, rates = MOVING[name]
    f, errors = np.array([1.0, -2.0, 1.5]), []
    for n in (8, 16):
        rod = beam(3, n, section, EnhancedContinuum(), rates)
        # The lowest period is about 1 s: in the midst of the ramp the rod lags behind its load.
        law = SmoothStep(0.0, 1.0, 0.2) if moves else None
        loads, joints = [DistributedForce("rod", f, law=law)], [Clamp(rod.at_start)]
        gravity = (0.0, 0.0, 0.0) if moves else (0.0, -0.3, 0.0)
        scene = Scene([rod], joints, gravity, loads=loads)
        if moves:
            # Velocities on either side give the acceleration to the square of the step, which
            # falls with the elements.
            h, k = 0.2 / (8 * n), 5 * n
            solution = simulate(scene, 0.2, HHT(h))
            a = (solution.v[k + 1] - solution.v[k - 1]) / (2 * h)
            share = float(law.at(k * h))
        else:
            solution, k, share = equilibrium(scene).solution, 0, 1.0
            a = np.zeros_like(solution.q[0])
        system = assemble(scene)
        at, none = slice(k, k + 1), np.zeros((1, system.n_lam))
        states = States(solution.t[at], solution.q[at], solution.v[at], none)
        error = []
        for fraction in (0.0, 0.13, 0.5, 0.77):
            point = rod.at(fraction)
            there = beyond(scene, section, rates, share * f, (solution.q[k], a), point)
            y, z = (system.naming.vector(point, quantity) for quantity in (2, 3))
            y, z = (v.weights @ solution.q[k].reshape(-1, 3)[v.vectors] for v in (y, z))
            normal, y = np.cross(y, z), y / np.linalg.norm(y)
            normal /= np.linalg.norm(normal)
            axes = np.array([normal, y, np.cross(normal, y)])
            expected = np.concatenate([axes @ part for part in there])
            found = [o.value(system, states)[0] for o in forces(point, 3)]
            error.append(np.abs(np.array(found) - expected))
        errors.append(np.max(error) / np.linalg.norm(f))
    assert errors[1] < 3e-3
    # A quarter, and terms of higher order.
    assert errors[1] < 0.4 * errors[0]


def slope_along(function, Y, direction):
    """Derivative of a quartic along a direction: differences of four places are exact."""
    at = [function(Y + h * direction) for h in (-0.2, -0.1, 0.1, 0.2)]
    return (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / 1.2


@pytest.mark.parametrize("element", [BEAM_2D, BEAM_3D], ids=lambda e: e.name)
@pytest.mark.parametrize("form", ["straight", "curved"])
@pytest.mark.parametrize("assumed", [False, True])
def test_section_forces_do_the_work_of_the_energy(element, form, assumed):
    # Of its definition in vectors, in states far from any balance: forces on the distance of the
    # nodes, moments on the turn of the sections at either end.
    d, energy = element.d, EnhancedContinuum(assumed)
    kind = kind_of(d, energy, OFF, form == "straight")
    values = np.zeros((1, len(ElementParameter)))
    values[0, :8] = 3.0, 0.3, 1000.0, 0.5, 0.0, 0.0, 1.0, 1.0
    batch = Batch(kind, values, straight(d) if form == "straight" else arc(d))
    Y_o = batch.Y_unit[0].copy()
    Y_o[0] *= 0.5
    law, points = definition(form == "straight", assumed), [(*p, 4e-4) for p in PLACES]

    def stored(Y):
        return plain_strains.energy(Y, Y_o, 0.5, points, law)

    random = np.random.default_rng(4)
    Y = Y_o + 0.2 * random.standard_normal(Y_o.shape)
    for xi in (0.0, 1.0):
        at = element.section_law(batch, SectionPlace(0, xi))
        parts = at.forces(Y[None], 0 * Y[None])
        first = 2 + d * int(xi)
        y, *z = (spatial(v) for v in Y[first : first + d - 1])
        normal = np.cross(y, z[0]) if z else np.array([y[1], -y[0], 0.0])
        y, normal = y / np.linalg.norm(y), normal / np.linalg.norm(normal)
        n, m = parts.reshape(2, 3) @ np.array([normal, y, np.cross(normal, y)])
        size = np.linalg.norm(parts)
        for axis in range(d):
            apart = np.zeros_like(Y)
            apart[0, axis] = 1.0
            assert abs(slope_along(stored, Y, apart) - n[axis]) <= 1e-11 * size
        for axis in range(3) if d == 3 else [2]:
            # The node turns: its sections and its tangent.
            turned = np.zeros_like(Y)
            for k in range(first - 1, first + d - 1):
                turned[k] = np.cross(np.eye(3)[axis], spatial(Y[k]))[:d]
            work = slope_along(stored, Y, turned) * (1 if xi else -1)
            assert abs(work - m[axis]) <= 1e-11 * size


def definition(is_straight, assumed):
    moments = np.array([4 * 4e-4 * 0.02**2] * 2)
    area, J = 1.6e-3, OFF.torsion_constant
    return {
        "E": 3.0,
        "nu": 0.3,
        "assumed": assumed,
        "straight": is_straight,
        "factors": np.sqrt([*OFF.shear_factors, J / moments.sum()]),
        "radii": np.sqrt(np.append(moments, J) / area),
        "centroid": (0.01, 0.01),
        "shear_centre": (0.01, 0.01),
    }
