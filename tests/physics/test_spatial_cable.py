"""The cable of space: the plane's cable in a plane, Irvine's catenary and frequencies, nets."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from ancfdae import (
    BEAM_2D,
    CABLE_2D,
    CABLE_3D,
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DesignVariable,
    DirectDifferentiation,
    Material,
    Moment,
    NodalState,
    Pin,
    PointForce,
    Scene,
    Terminal,
    Weld,
    assemble,
    check_system,
    equilibrium,
    equilibrium_gradient,
    gradient,
    load_solution,
    modes,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import MaterialPoint
from ancfdae.observables import (
    axial_force,
    bending_moment,
    maximum_von_mises,
    observe,
    position,
    reaction,
    shear_force,
    torsional_moment,
    von_mises,
)
from ancfdae.plotting.mechanism import mechanism
from ancfdae.sections import Circle
from ancfdae.statics.outcome import motions_in_words

STEP = 1e-30


def in_space(vectors):
    """Vectors of the x-z plane from those of the plane."""
    return np.insert(vectors, 1, 0.0, axis=-1)


# ---- Irvine's catenary


EA, RADIUS = 1e7, 3e-8


def span_of(H, length, weight, stiffness):
    """Distance of the supports at a horizontal pull H."""
    return H * length / stiffness + 2 * H / weight * np.arcsinh(weight * length / (2 * H))


def irvine(length, weight, span, stiffness):
    """Sag and horizontal pull of an elastic cable between supports of one height (Irvine 1981)."""
    H = 0.3 + 0j
    for _ in range(30):
        half = weight * length / (2 * H)
        left = span_of(H, length, weight, stiffness) - span
        slope = length / stiffness + 2 / weight * np.arcsinh(half)
        H = H - left / (slope - length / H / np.sqrt(1 + half**2))
    half = weight * length / (2 * H)
    sag = weight * length**2 / (8 * stiffness) + H / weight * (np.sqrt(1 + half**2) - 1)
    return np.array([-sag, H])


def hanging(element, n=64, length=1.0, span=0.8):
    area = np.pi * RADIUS**2
    thin, metal = Circle(RADIUS), Material(1 / area, EA / area, 0.3)
    flat = in_space if element.d == 3 else np.asarray
    rope = Beam("rope", flat([0, 0]), flat([length, 0]), n, thin, metal, element=element)
    start = Pin(rope.at_start, name="start")
    end = Pin(rope.at_end, ground=tuple(flat([span, 0.0])), name="end")
    a = irvine(length, 1.0, span, np.inf)[1].real
    s = np.linspace(-length / 2, length / 2, n + 1)
    place = np.stack([span / 2 + a * np.arcsinh(s / a), np.hypot(a, s)], axis=1)
    tangent = np.stack([a / np.hypot(a, s), s / np.hypot(a, s)], axis=1)
    state = NodalState("rope", flat(np.stack([place - place[0] * (0, 1), tangent], axis=1)))
    return Scene([rope], [start, end], tuple(flat([0, -1.0])), start=[state], project_start=True)


@pytest.mark.parametrize("element", [CABLE_2D, CABLE_3D])
def test_a_hanging_cable_is_irvines_catenary_with_its_derivatives(element):
    scene = hanging(element)
    area = np.pi * RADIUS**2
    values = np.array([1.0, 1 / area, 0.8, EA / area])
    design = ["rope.length", "rope.density", "end.ground_x", "rope.youngs_modulus"]
    expected = irvine(1.0, 1.0, 0.8, EA)
    exact = []
    for k in range(4):
        length, density, span, modulus = values + 1j * STEP * values[k] * (np.arange(4) == k)
        exact.append(irvine(length, density * area, span, modulus * area).imag / STEP / values[k])
    up = element.d - 1
    for k, observable in enumerate((position(scene.beams[0].at(0.5), up), -reaction("start", 0))):
        found = equilibrium_gradient(scene, observable, design=design)
        size = abs(expected[k].real)
        # The mesh leaves 1e-7, strains of 5e-8 and bending of 2e-9 less.
        assert abs(found.value - expected[k].real) <= 1e-6 * size
        # Per relative change of each variable, on the sag or pull: dependence on E A is small.
        change = (found.gradient - np.array(exact)[:, k]) * values
        assert np.max(np.abs(change)) <= 1e-6 * size


@pytest.mark.parametrize("element", [CABLE_2D, CABLE_3D])
def test_the_tension_of_a_catenary_is_right_at_any_point(element):
    """N = H cosh(x/a) = sqrt(H^2 + s^2) of a unit weight, s from the middle: nodes included."""
    n, scene = 20, hanging(element, 20)
    pull, rope = irvine(1.0, 1.0, 0.8, EA)[1].real, scene.beams[0]
    found, system = equilibrium(scene).solution, assemble(scene)
    for s in np.array([0, 0.25, 1, 4.5, 9.75, 10, 13.25, 19, 20]) / n:
        for point in {rope.at(s), rope.at(s, before=s > 0)}:
            expected = np.hypot(pull, s - 0.5)
            # The mesh leaves 2e-5 of the pull.
            assert observe(axial_force(point), found, system)[0] == pytest.approx(
                expected, rel=3e-5
            )


# ---- frequencies of a sagging cable (Irvine & Caughey 1974)


@pytest.mark.parametrize("stiffness", [10.0, 60.0])
def test_a_sagging_cable_has_the_frequencies_of_irvine_and_caughey(stiffness):
    """tan(b/2) = b/2 - (4/k)(b/2)^3 in the plane; those of a string across it, and odd ones."""
    L, m, g, sag, n = 100.0, 2.0, 9.81, 0.5, 32
    H, radius = m * g * L**2 / (8 * sag), 1e-3
    EA, area = stiffness * H * (1 + 8 * (sag / L) ** 2) / (8 * sag / L) ** 2, np.pi * radius**2
    slack = brentq(lambda x: span_of(H, x, m * g, EA) - L, 0.99 * L, 1.01 * L, xtol=1e-12)
    metal = Material(m / area, EA / area, 0.3)
    wire = Beam("wire", (0, 0, 0), (slack, 0, 0), n, Circle(radius), metal, element=CABLE_3D)
    x = np.linspace(0, 1, n + 1)
    place = np.stack([L * x, 0 * x, -4 * sag * x * (1 - x)], axis=1)
    tangent = np.stack([1 + 0 * x, 0 * x, -4 * sag / L * (1 - 2 * x)], axis=1)
    start = NodalState("wire", np.stack([place, tangent], axis=1))
    joints = [Pin(wire.at_start), Pin(wire.at_end, ground=(L, 0, 0))]
    scene = Scene([wire], joints, (0, 0, -g), start=[start], project_start=True)
    found = modes(scene, 6, at=equilibrium(scene))
    string = np.pi / L * np.sqrt(H / m)
    half = [
        brentq(lambda b: np.sin(b) - (b - 4 / stiffness * b**3) * np.cos(b), low + 1e-9, high)
        for low, high in ((np.pi / 2, 1.5 * np.pi), (1.5 * np.pi, 2.5 * np.pi))
    ]
    expected = string * np.sort([1, 2, 3, 4, 2, 4, *(2 * np.array(half) / np.pi)])
    # Of the sag, 8 (sag/L)^2 = 2e-4 are neglected in theory, and strains of 2e-4.
    assert found.frequencies[:6] == pytest.approx(expected[:6], rel=1e-3)
    # Nothing is free to spin: a cable has no torsion.
    assert np.min(found.frequencies) > 0.5 * string


# ---- a net against force densities


def force_densities(nodes, free, edges, lengths, stiffness, loads):
    """Places of nodes of a pin-jointed net, each edge with T = E A (s^2 - 1) s/2 at a stretch s.

    Newton's method on sum q (x_i - x_j) = F with the force densities q = T/(s L) (Schek 1974).
    """
    x, first, second = nodes.copy(), *edges.T
    at = np.flatnonzero(free)
    for _ in range(30):
        chord = x[second] - x[first]
        q = stiffness / (2 * lengths) * (np.sum(chord**2, axis=1) / lengths**2 - 1)
        pull, K = loads.copy(), np.zeros((len(x), 3, len(x), 3))
        np.add.at(pull, first, q[:, None] * chord)
        np.add.at(pull, second, -q[:, None] * chord)
        for i, j, own, c, l in zip(first, second, q, chord, lengths, strict=True):
            block = own * np.eye(3) + stiffness / l**3 * np.outer(c, c)
            K[i, :, i] += block
            K[j, :, j] += block
            K[i, :, j] -= block
            K[j, :, i] -= block
        matrix = K[at][:, :, at].reshape(3 * len(at), -1)
        x[at] += np.linalg.solve(matrix, pull[at].ravel()).reshape(-1, 3)
    return x


def test_a_net_stands_where_force_densities_have_it():
    """Twelve cables between four nodes and the points of a saddle, drawn by forces at nodes."""
    grid = [
        (i, j) for i in range(4) for j in range(4) if (i, j) not in ((0, 0), (0, 3), (3, 0), (3, 3))
    ]
    nodes = np.array([(i, j, 0.3 * (i - 1.5) ** 2 - 0.2 * (j - 1.5) ** 2) for i, j in grid])
    free = np.array([0 < i < 3 and 0 < j < 3 for i, j in grid])
    edges = np.array(
        [
            (a, b)
            for a in range(len(grid))
            for b in range(a + 1, len(grid))
            if np.sum(np.abs(np.subtract(grid[a], grid[b]))) == 1 and (free[a] or free[b])
        ]
    )
    stiffness, radius = 50.0, 1e-3
    metal = Material(1e3, stiffness / (np.pi * radius**2), 0.3)
    cables = [
        Beam(f"c{k}", nodes[a], nodes[b], 1, Circle(radius), metal, element=CABLE_3D)
        for k, (a, b) in enumerate(edges)
    ]
    ends = {}
    for cable, edge in zip(cables, edges, strict=True):
        for node, point in zip(edge.tolist(), (cable.at_start, cable.at_end), strict=True):
            ends.setdefault(node, []).append(point)
    rng = np.random.default_rng(3)
    loads = np.where(free[:, None], rng.uniform(-1, 1, nodes.shape), 0.0)
    # Drawn at the boundary, so that no cable is slack.
    drawn = np.where(free[:, None], nodes, (1.5, 1.5, 0.0) + 1.2 * (nodes - (1.5, 1.5, 0.0)))
    joints, forces = [], []
    for node, points in ends.items():
        if free[node]:
            joints += [Pin(other, points[0]) for other in points[1:]]
            forces.append(PointForce(points[0], tuple(loads[node])))
        else:
            joints += [Pin(point, ground=tuple(drawn[node])) for point in points]
    found = equilibrium(Scene(cables, joints, loads=forces, project_start=True))
    lengths = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    expected = force_densities(drawn, free, edges, lengths, stiffness, loads)
    assert np.max(np.abs(expected - drawn)[free]) > 0.02
    for node, points in ends.items():
        place = found.solution.position(points[0])[0]
        # Equilibria are solved to 1e-10 of the forces.
        assert place == pytest.approx(expected[node], abs=1e-9)


# ---- planar and spatial cables move alike


@pytest.mark.parametrize("damping_time", [0.0, 2e-3])
def test_in_a_plane_both_cables_are_one(damping_time):
    soft = Material(1000.0, 1e7, 0.3, damping_time=damping_time)
    results = []
    for flat, element in ((np.asarray, CABLE_2D), (in_space, CABLE_3D)):
        rod = Beam("rod", flat([0, 0]), flat([1.0, 0.2]), 4, Circle(0.01), soft, element=element)
        load = PointForce(rod.at(0.5), tuple(flat([0.3, 1.0])))
        scene = Scene([rod], [Clamp(rod.at_start)], tuple(flat([0.0, -9.81])), loads=[load])
        solution = simulate(scene, 0.25, HHT(2.0**-7))
        planar = [0, 2] if element is CABLE_3D else [0, 1]
        across = np.delete(solution.nodes("rod"), planar, axis=-1)
        assert not np.any(across)
        results.append(solution.nodes("rod")[..., planar])
    # 32 steps, each solved to round-off times the stiffness of 1e4.
    assert results[1] == pytest.approx(results[0], abs=1e-11)


# ---- a chain that falls in space


def chain(**changes):
    arguments = {"section": Circle(0.004), "material": Material(1100.0, 2e7, 0.4)}
    arguments |= {"element": CABLE_3D} | changes
    first = Beam("first", (0, 0, 0), (0.6, 0, 0), 4, **arguments)
    second = Beam("second", (0.6, 0, 0), (0.6, 0.5, 0), 4, **arguments)
    joints = [Pin(first.at_start), Pin(first.at_end, second.at_start)]
    return Scene([first, second], joints, (0, 0, -9.81))


def test_a_falling_chain_keeps_its_energy():
    scene = chain()
    system, drift = assemble(scene), []
    for h in (2.0**-9, 2.0**-10):
        solution = simulate(scene, 0.25, HHT(h, hht_alpha=-0.05))
        energy = system.energies.total(solution.q, solution.v)
        fallen = np.ptp(system.energies.gravity(solution.q))
        drift.append(np.max(np.abs(energy - energy[0])) / fallen)
    # Steps of second order, and a damping of high frequencies that is of third.
    assert drift[0] < 1e-3
    assert drift[1] < 0.35 * drift[0]


def test_direct_adjoint_and_complex_step_agree():
    design = [
        "first.radius",
        "second.length",
        "first.youngs_modulus",
        "second.density",
        "first.turn_y",
    ]
    objective = Terminal(position(MaterialPoint("second", 1.0), 2))
    call = chain(), objective, 2.0**-4, HHT(2.0**-8)
    direct, adjoint, exact = (
        gradient(*call, design=design, method=method).gradient
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    )
    assert direct == pytest.approx(exact, rel=1e-11)
    assert adjoint == pytest.approx(direct, rel=1e-11)
    assert np.all(exact != 0)


def test_a_cable_that_is_free_to_swing_does_not_spin():
    """Bent by 1e-9 it swings about z as the straight one; a turn about itself moves 1e-9 of it."""
    wire = chain().beams[0]
    system = assemble(Scene([wire], [Pin(wire.at_start)]))
    q, _ = system.start()
    X = q.reshape(-1, 3)
    swing = np.stack([-X[:, 1], X[:, 0], 0 * X[:, 0]], axis=1).reshape(-1, 1)
    X[::2, 2] += 1e-9 * np.sin(3 * X[::2, 0])
    words = motions_in_words(
        system.naming, X.ravel(), swing + 1e-9 * np.cos(np.arange(len(swing)))[:, None]
    )
    assert words == "first turns about the axis z through its start"


# ---- cables and beams in one scene


def hung(d):
    """A mast of a beam, a cable from its top that carries a weight, and a rigid strut."""
    flat = in_space if d == 3 else np.asarray
    soft, tube = Material(1500.0, 5e7, 0.3, damping_time=1e-3), Circle(0.012)
    cable = CABLE_3D if d == 3 else CABLE_2D
    mast = Beam("mast", flat([0, 0]), flat([0.1, 0.8]), 1, tube, soft)
    rope = Beam("rope", flat([0.1, 0.8]), flat([0.7, 0.6]), 2, Circle(0.008), soft, element=cable)
    strut = Beam("strut", flat([0.7, 0.6]), flat([0.9, 0.3]), 1, tube, soft, rigid=True)
    joints = [
        Clamp(mast.at_start),
        Pin(rope.at_start, mast.at_end),
        Pin(strut.at_start, rope.at_end),
    ]
    loads = [PointForce(rope.at(0.4), tuple(flat([0.2, 0.5])), name="pull")]
    if d == 2:
        joints[1] = Weld(rope.at_start, mast.at_end)
        loads.append(Moment(rope.at_end, 0.01, name="twist"))
    return Scene([mast, rope, strut], joints, tuple(flat([0.0, -9.81])), loads=loads)


def test_a_scene_of_beams_and_cables_is_a_system():
    assert check_system(assemble(hung(3), ["rope.length"]))


@pytest.mark.parametrize("d", [2, 3])
def test_a_gradient_across_beams_and_cables_is_the_limit_of_differences(d):
    scene, names = hung(d), ["mast.radius", "rope.radius", "rope.length", "mast.length"]
    objective = Terminal(position(MaterialPoint("strut", 1.0), d - 1))
    call = objective, 2.0**-4, HHT(2.0**-7)
    found = gradient(scene, *call, design=names)
    exact = gradient(scene, *call, design=names, method=ComplexStep()).gradient
    assert found.gradient == pytest.approx(exact, rel=1e-10)

    def value(name, factor):
        variable = DesignVariable(name, (name,))
        moved = scene.with_values({variable: factor * scene.value(variable)})
        return gradient(moved, *call, design=[name]).value

    values = np.array([scene.value(DesignVariable(name, (name,))) for name in names])
    steps = [value(name, 1 + 1e-5) - value(name, 1 - 1e-5) for name in names]
    differences = steps / (2e-5 * values)
    assert found.gradient == pytest.approx(differences, rel=1e-5)


def test_what_stands_alone_is_the_same_beside_others():
    """Forces of a cable, widened to the places of a beam's, are those of a scene of its own."""
    rng, alone = np.random.default_rng(4), []
    whole = hung(3)
    both = assemble(whole)
    q = rng.normal(size=both.n_q)
    for beam in whole.beams[:2]:
        own = assemble(Scene([beam], gravity=whole.gravity))
        at = both.naming.layout.body(beam.name).first_vector * 3 + np.arange(own.n_q)
        force = own.force(0.0, q[at], 0.5 * q[at])
        mass = own.mass_times(q[at], q[at])
        alone.append((at, force, mass))
    bare = assemble(replace(whole, loads=()))
    force, mass = bare.force(0.0, q, 0.5 * q), bare.mass_times(q, q)
    for at, own_force, own_mass in alone:
        # The same sums of the same numbers, with zeros among them.
        assert force[at] == pytest.approx(
            own_force, rel=1e-12, abs=1e-12 * np.max(np.abs(own_force))
        )
        assert mass[at] == pytest.approx(own_mass, rel=1e-12)


def test_a_file_knows_the_element_of_every_beam(tmp_path):
    solution = simulate(hung(2), 2.0**-6, HHT(2.0**-7))
    solution.save(tmp_path / "hung.npz")
    again = load_solution(tmp_path / "hung.npz").naming.layout
    assert [beam.element for beam in again.beams] == [BEAM_2D, CABLE_2D, BEAM_2D]
    assert again == solution.naming.layout


# ---- stresses


def stressed(d):
    """A cantilever pulled by N = 0.01 N and bent by F = 1e-4 N across it."""
    flat = in_space if d == 3 else np.asarray
    element = CABLE_3D if d == 3 else CABLE_2D
    section, rubber = Circle(0.01), Material(1000.0, 1e7, 0.3)
    rod = Beam("rod", flat([0, 0]), flat([1.0, 0]), 4, section, rubber, element=element)
    load = PointForce(rod.at_end, tuple(flat([0.01, 1e-4])), name="load")
    return rod, Scene([rod], [Clamp(rod.at_start)], loads=[load])


def test_stresses_of_a_cable_are_those_of_force_and_moment():
    """N/A - M y/I in the plane; N/A + M rho/I in space, whichever way the section lies."""
    area, inertia, L = np.pi * 1e-4, np.pi * 1e-8 / 4, 1.0
    # The pull stiffens by N L^2/(E I) = 1e-2 / 0.0785: M = F tanh(k L)/k.
    k = np.sqrt(0.01 / (1e7 * inertia))
    M = 1e-4 * np.tanh(k * L) / k
    for d, point, expected in (
        (2, {"y": 0.01}, 0.01 / area - M * 0.01 / inertia),
        (2, {"y": -0.005}, 0.01 / area + M * 0.005 / inertia),
        (3, {"y": 0.006, "z": -0.008}, 0.01 / area + M * 0.01 / inertia),
        (3, {}, 0.01 / area),
    ):
        rod, scene = stressed(d)
        found = equilibrium_gradient(
            scene, von_mises(rod.at(0.0, **point)), design=["load.force_x"]
        )
        # Moments of cubics err by (k l)^2/12 at nodes; round-off stands at 1e-9 E = 0.01.
        assert found.value == pytest.approx(abs(expected), rel=2e-3, abs=0.03)


@pytest.mark.parametrize("d", [2, 3])
def test_stresses_of_a_cable_have_exact_gradients(d):
    soft = Material(1000.0, 1e7, 0.3, damping_time=2e-3)
    rod = replace(stressed(d)[0], material=soft)
    pull = (3.0, 0.5, 0.8)[:d]
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at_end, pull, name="load")])
    design = ["rod.radius", "rod.youngs_modulus", "rod.length", "rod.damping_time", "load.force_x"]
    call = maximum_von_mises("rod", 1e-4), 2.0**-5, HHT(2.0**-8)
    exact = gradient(scene, Terminal(call[0]), *call[1:], design=design, method=ComplexStep())
    ours = gradient(scene, Terminal(call[0]), *call[1:], design=design)
    assert ours.gradient == pytest.approx(exact.gradient, rel=1e-10)
    forces = axial_force(rod.at(0.3)) + bending_moment(rod.at(0.6)) + shear_force(rod.at(0.6))
    call = scene, Terminal(forces), 2.0**-5, HHT(2.0**-8)
    b = assemble(scene, design).b
    exact, ours = (
        gradient(*call, design=design, method=method).gradient * b
        for method in (ComplexStep(), DirectDifferentiation())
    )
    # Newton's method leaves as much of the largest part in all of them.
    np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-10 * np.max(np.abs(exact)))


def test_a_cable_in_space_has_no_axes_across_it():
    rod, scene = stressed(3)
    for component in (torsional_moment(rod.at_start), bending_moment(rod.at_start, 1)):
        with pytest.raises(InvalidInputError, match="a cable"):
            component.check(assemble(scene))


def test_a_file_of_one_element_for_all_is_still_read(tmp_path):
    """Format 7 had the element beside the beams."""
    solution = simulate(chain(), 2.0**-6, HHT(2.0**-7))
    path = solution.save(tmp_path / "chain.npz")
    with np.load(path) as file:
        arrays = dict(file)
    meta = json.loads(str(arrays["meta"]))
    layout = meta["layout"]
    del layout["d"]
    layout["element_name"] = {beam.pop("element") for beam in layout["beams"]}.pop()
    meta["format"] = "ancfdae solution 7"
    np.savez(path, **arrays | {"meta": np.array(json.dumps(meta))})
    assert load_solution(path).naming.layout == solution.naming.layout


def test_the_surface_of_a_cable_lies_around_its_line():
    """Every point at the radius, across the tangent, in any state; also after half a turn."""
    _, scene = stressed(3)
    system = assemble(scene)
    own = mechanism(scene, equilibrium(scene).solution, None, None)
    (mesh,) = own.meshes
    X = system.start()[0].reshape(-1, 3)
    for matrix in (np.diag([-1.0, 1.0, 1.0]), np.diag([-1.0, -1.0, 1.0]), np.eye(3)[[1, 2, 0]]):
        places = mesh.places((X @ matrix).reshape(1, -1)).reshape(*mesh.shape, 3)
        line = places.mean(axis=2)
        arms = places - line[:, :, None]
        assert np.linalg.norm(arms, axis=-1) == pytest.approx(np.full(mesh.shape, 0.01), rel=1e-9)
        assert arms @ matrix[0] == pytest.approx(np.zeros(mesh.shape), abs=1e-12)
