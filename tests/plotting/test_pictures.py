"""What pictures, films and exports of mechanisms hold is what the solution says."""

import base64
import json
import re
import shutil
import subprocess
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.proj3d import proj_transform
from PIL import Image

from ancfdae import (
    CABLE_2D,
    HHT,
    Beam,
    Clamp,
    Distance,
    DistributedForce,
    FollowerForce,
    InitialVelocity,
    Material,
    Moment,
    MotorTorque,
    Pin,
    PointForce,
    PointMass,
    Revolute,
    RigidBody,
    RigidBox,
    Scene,
    SpringDamper,
    Terminal,
    Weld,
    assemble,
    differentiate,
    distributed_variables,
    equilibrium,
    gradient,
    simulate,
)
from ancfdae.errors import InvalidInputError, MissingPackageError, UnknownNameError
from ancfdae.extend import MaterialPoint
from ancfdae.laws import Harmonic
from ancfdae.observables import (
    axial_force,
    bending_moment,
    kinetic_energy,
    observe,
    position,
    strain_energy,
    von_mises,
)
from ancfdae.plotting import (
    AxialForce,
    BendingMoment,
    Field,
    Sensitivity,
    Speed,
    StrainEnergyDensity,
    VonMisesStress,
    animate,
    gradient_bars,
    history,
    painters,
    pictures,
    snapshots,
    write_vtk,
)
from ancfdae.plotting.derivatives import bar_places
from ancfdae.plotting.mechanism import mechanism
from ancfdae.plotting.painters import Glyphs
from ancfdae.plotting.pictures import page_data
from ancfdae.plotting.shapes import BeamMesh
from ancfdae.sections import Circle, GeneralSection, ISection, Rectangle, Tube
from ancfdae.sensitivity.observables.observable import states_of

STEEL = Material(2700, 1e8, 0.3)
DESIGN = ["rod.height", "rod.length"]
# Sums of ten products in another order, in units of the largest number in the sum.
ROUND_OFF = 1e-13


def planar_scene():
    rod = Beam("rod", (0, 0), (0.8, 0.3), 2, Rectangle(0.06, 0.03), STEEL)
    box = RigidBody("box", (1.0, 0.3), shape=RigidBox(0.4, 0.2, 0.1), density=900)
    return Scene(
        [rod],
        bodies=[box, PointMass(rod.at(0.5), 0.1)],
        joints=[Pin(rod.at_start), Pin(box.at(-0.2), rod.at_end)],
        gravity=(0, -9.81),
        loads=[
            PointForce(rod.at_end, (3, -4)),
            FollowerForce(rod.at(0.25), (0, 2)),
            Moment(rod.at(0.75), -0.7),
            DistributedForce("rod", (0, -5)),
        ],
        assemble=True,
        start=[InitialVelocity("rod", 2.0, (0, 0))],
    )


def spatial_scene():
    arm = Beam("arm", (0, 0, 0), (0.6, 0.1, 0.2), 2, ISection(0.06, 0.04, 0.008, 0.01), STEEL)
    tip = Beam("tip", arm.at_end, (0.2, 0.3, 0), 1, Tube(0.02, 0.005), STEEL)
    box = RigidBody("box", (0, 0, -0.3), shape=RigidBox(0.3, 0.2, 0.1), density=900)
    return Scene(
        [arm, tip],
        bodies=[box],
        joints=[
            Revolute(arm.at_start, axis=(0, 0, 1)),
            Weld(tip.at_start, arm.at_end),
            Distance(box.at(0.15, 0.1, 0.05), 0.5, ground=(0.15, 0.1, 0.25)),
        ],
        gravity=(0, 0, -9.81),
        loads=[MotorTorque(arm.at_start, 1.5), Moment(tip.at_end, (0.1, -0.2, 0.3))],
        assemble=True,
    )


@pytest.fixture(scope="module")
def planar():
    scene = planar_scene()
    return scene, differentiate(scene, 12 / 256, HHT(step=1 / 256), design=DESIGN)


@pytest.fixture(scope="module")
def spatial():
    scene = spatial_scene()
    return scene, differentiate(scene, 4 / 256, HHT(step=1 / 256), design=["arm.height"])


@pytest.fixture(params=["planar", "spatial"])
def moving(request):
    """A scene and its solution, in the plane and in space."""
    return request.getfixturevalue(request.param)


def material_points(mesh):
    """The points of a beam's mesh as the library names them, in the order of the mesh."""
    nodes = np.linspace(0, 1, mesh.body.element_count + 1)
    for e, x, f in np.ndindex(mesh.shape):
        fraction = nodes[e] + mesh.xi[x] * (nodes[e + 1] - nodes[e])
        yield MaterialPoint(mesh.name, min(fraction, 1.0), mesh.y[e, f], mesh.z[e, f])


def few(mesh):
    """Numbers and names of some of the points, of every element, station and fibre some."""
    return list(enumerate(material_points(mesh)))[:: max(1, np.prod(mesh.shape) // 23)]


def beams(own):
    return [(k, mesh) for k, mesh in enumerate(own.meshes) if isinstance(mesh, BeamMesh)]


def test_points_of_beams_are_material_points_at_their_places(moving):
    scene, solution = moving
    own = mechanism(scene, solution, None, None)
    for k, mesh in beams(own):
        for number, point in few(mesh):
            np.testing.assert_allclose(
                own.places[k][:, number], solution.position(point), atol=ROUND_OFF
            )


def test_points_of_rigid_bodies_move_with_them(moving):
    scene, solution = moving
    own, box = mechanism(scene, solution, None, None), scene.member("box")
    k = [mesh.name for mesh in own.meshes].index("box")
    half = np.array([box.shape.length, box.shape.height, box.shape.width])[: own.d] / 2
    corners = solution.position(box.at(*half))
    # One of the points of the mesh is this corner at all instants.
    away = np.linalg.norm(own.places[k] - corners[:, None], axis=-1).max(axis=0)
    assert away.min() < ROUND_OFF


def test_contours_are_those_of_the_sections(spatial):
    own = mechanism(*spatial, None, None)
    arm, tip = own.meshes[:2]
    # A flange of 0.04 by 0.01 on either side of a web of 0.008 by 0.04.
    y, z = arm.y[0], arm.z[0]
    area = 0.5 * abs(np.sum(y * np.roll(z, -1) - z * np.roll(y, -1)))
    assert area == pytest.approx(2 * 0.04 * 0.01 + 0.008 * 0.04, rel=1e-12)
    np.testing.assert_allclose(np.hypot(tip.y, tip.z), 0.02, rtol=1e-12)


def test_end_caps_fill_the_contour(spatial):
    own = mechanism(*spatial, None, None)
    arm = own.meshes[0]
    x = own.places[0][0][arm.faces[:8]]  # eight strips between eighteen places
    areas = 0.5 * np.linalg.norm(np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]), axis=1)
    assert areas.sum() == pytest.approx(2 * 0.04 * 0.01 + 0.008 * 0.04, rel=1e-12)


@pytest.mark.parametrize(
    ("field", "observable"),
    [
        (VonMisesStress(), von_mises),
        (AxialForce(), lambda p: axial_force(MaterialPoint(p.beam, p.fraction))),
        (BendingMoment(), lambda p: bending_moment(MaterialPoint(p.beam, p.fraction))),
    ],
    ids=lambda x: type(x).__name__,
)
def test_fields_are_the_observables(moving, field, observable):
    scene, solution = moving
    system, own = assemble(scene), mechanism(scene, solution, None, field)
    for k, mesh in beams(own):
        size = np.abs(own.values[k]).max()
        for number, point in few(mesh):
            # At a node the two elements that meet there differ.
            at_node = any(abs(point.fraction * mesh.shape[0] - n) < 1e-9 for n in range(9))
            if not at_node or mesh.shape[0] == 1:
                expected = observe(observable(point), solution, system)
                np.testing.assert_allclose(
                    own.values[k][:, number], expected, atol=1e-10 * size
                )  # strains of 1e-4 are differences of numbers of size one


def test_moment_about_the_height_is_that_observable(spatial):
    scene, solution = spatial
    own = mechanism(scene, solution, None, BendingMoment(1))
    point = MaterialPoint("arm", 0.25)
    expected = observe(bending_moment(point, 1), solution, assemble(scene))
    values = own.values[0].reshape(len(solution.t), *own.meshes[0].shape)
    half = (len(own.meshes[0].xi) - 1) // 2
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(
        values[:, 0, half, 0], expected, atol=1e-10 * np.abs(own.values[0]).max()
    )


def test_energy_density_adds_up_to_the_strain_energy(moving):
    scene, solution = moving
    own = mechanism(scene, solution, None, StrainEnergyDensity())
    total = np.zeros(len(solution.t))
    for k, mesh in beams(own):
        section = mesh.body.section
        area = section.points(np.array([section.sizes()]), False)[2].sum()
        values = own.values[k].reshape(len(total), *mesh.shape)[:, :, 0, 0]
        total += values @ mesh.body.reference().lengths * area
    expected = observe(strain_energy(), solution, assemble(scene))
    # Energies are squares of small differences: eps times the stiffness is left.
    np.testing.assert_allclose(total, expected, rtol=1e-8, atol=1e-12 * expected.max())


def test_speed_is_the_size_of_the_velocity(moving):
    scene, solution = moving
    own = mechanism(scene, solution, None, Speed())
    for k, mesh in beams(own):
        for number, point in few(mesh):
            expected = np.linalg.norm(solution.velocity(point), axis=1)
            np.testing.assert_allclose(own.values[k][:, number], expected, atol=1e-12)


@pytest.mark.parametrize("variable", [0, 1])
def test_sensitivity_is_the_derivative_of_the_place(planar, variable):
    scene, solution = planar
    own = mechanism(scene, solution, None, Sensitivity(DESIGN[variable]))
    mesh = own.meshes[0]
    for number, point in few(mesh):
        derivative = solution.derivative(lambda s, point=point: s.position(point))[..., variable]
        expected = np.linalg.norm(derivative, axis=1)
        np.testing.assert_allclose(own.values[0][:, number], expected, rtol=1e-10, atol=1e-13)


def test_bodies_without_the_field_have_no_value(planar):
    own = mechanism(*planar, None, VonMisesStress())
    assert np.isnan(own.values[1]).all()
    assert np.isfinite(own.values[0]).all()
    assert np.isfinite(mechanism(*planar, None, Speed()).values[1]).all()


def cable(**changes):
    rod = Beam("rod", (0, 0), (1, 0.2), 3, Circle(0.01), STEEL, element=CABLE_2D)
    scene = Scene([rod], joints=[Pin(rod.at_start)], gravity=(0, -9.81))
    return scene.with_values(changes) if changes else scene


def test_cables_are_as_high_as_their_section_across_their_centre_line():
    scene, h = cable(), 1e-4
    solution = differentiate(scene, 1 / 32, HHT(step=1 / 256), design=["rod.length"])
    own = mechanism(scene, solution, None, None)
    mesh = own.meshes[0]
    x = own.places[0].reshape(len(solution.t), *mesh.shape, 2)
    np.testing.assert_allclose(np.linalg.norm(x[..., -1, :] - x[..., 0, :], axis=-1), 0.02)
    e, along = x[..., -1, :] - x[..., 0, :], mesh.axis(solution.q)[0]
    chord = along[:, :, 1:] - along[:, :, :-1]
    assert np.all(np.abs(np.sum(e[:, :, 1:] * chord, axis=-1)) < 0.1 * 0.02 * np.abs(chord).max())
    # Up to the left of the way along it.
    assert np.all(chord[..., 0] * e[:, :, 1:, 1] - chord[..., 1] * e[:, :, 1:, 0] > 0)
    # Its derivative is the limit of differences of the picture of the run of a changed scene.
    length = float(np.hypot(1, 0.2))
    ends = []
    for sign in (1, -1):
        moved = cable(**{"rod.length": length + sign * h})
        run = simulate(moved, 1 / 32, HHT(step=1 / 256))
        ends.append(mechanism(moved, run, None, None).places[0])
    slopes = mesh.sensitivities(solution.q, solution.sensitivities.q_b[..., 0], 0)
    # Differences of order h^2, h = 1e-4: 1e-8 of derivatives of size one.
    np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), slopes, atol=1e-6)


def test_arrows_are_the_forces(planar):
    scene, solution = planar
    own = mechanism(scene, solution, None, None)
    arrows = {x.name: x for x in own.arrows}
    tip = arrows["force(rod@1)"]
    np.testing.assert_allclose(tip.vectors[:, 0], np.tile([3.0, -4.0], (len(solution.t), 1)))
    np.testing.assert_allclose(tip.places[:, 0], solution.position(MaterialPoint("rod", 1.0)))
    up = solution.slope(MaterialPoint("rod", 0.25), along=1)
    expected = 2 * up / np.linalg.norm(up, axis=1, keepdims=True)
    np.testing.assert_allclose(arrows["follower(rod@0.25)"].vectors[:, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(arrows["moment(rod@0.75)"].vectors, -0.7, rtol=1e-12)
    assert arrows["line-load(rod)"].kind == "force per length"
    np.testing.assert_allclose(arrows["line-load(rod)"].vectors[..., 1], -5.0)
    # The largest force, of 5 N, is drawn as the longest arrow, against its place.
    drawn = Glyphs(own).arrow(tip)[0, 0]
    assert drawn @ [3, -4] == pytest.approx(5 * np.linalg.norm(drawn))


def test_arcs_turn_as_the_moments(planar, spatial):
    own = mechanism(*planar, None, None)
    (moment,) = (x for x in own.arrows if x.kind == "moment")
    arc = Glyphs(own).arc(moment, 0)[:30] - moment.places[0, 0]
    turns = arc[:-1, 0] * arc[1:, 1] - arc[:-1, 1] * arc[1:, 0]
    assert np.all(turns < 0)  # from y to x, as M < 0
    own = mechanism(*spatial, None, None)
    moments = {x.name: x for x in own.arrows if x.kind == "moment"}
    np.testing.assert_allclose(moments["torque(arm@0)"].vectors[0, 0], [0, 0, 1.5], atol=1e-12)
    M = moments["moment(tip@1)"]
    np.testing.assert_allclose(M.vectors[0, 0], [0.1, -0.2, 0.3], atol=1e-12)
    arc = Glyphs(own).arc(M, 0)[:30] - M.places[0, 0]
    assert np.all(np.cross(arc[:-1], arc[1:]) @ M.vectors[0, 0] > 0)


def test_signs_stand_where_joints_and_masses_are(planar, spatial):
    scene, solution = planar
    marks = {(x.kind, x.name): x for x in mechanism(scene, solution, None, None).marks}
    np.testing.assert_allclose(marks["pin", "pin(box(-0.2, 0))"].places[:, 0].shape, 13)
    np.testing.assert_allclose(
        marks["pin", "pin(box(-0.2, 0))"].places,
        solution.position(MaterialPoint("rod", 1.0)),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        marks["mass", "mass(rod@0.5)"].places, solution.position(MaterialPoint("rod", 0.5))
    )
    assert ("ground", "pin(rod@0)") in marks
    assert ("ground", "pin(box(-0.2, 0))") not in marks
    own = mechanism(*spatial, None, None)
    lines = {x.kind: x for x in own.lines}
    link = lines["link"].ends
    np.testing.assert_allclose(np.linalg.norm(link[:, 0] - link[:, 1], axis=-1), 0.5, rtol=1e-9)
    np.testing.assert_allclose(lines["way"].ends[:, 1] - lines["way"].ends[:, 0], [[0, 0, 1]] * 5)


def test_an_axis_moves_with_the_body_that_carries_it():
    base = Beam("base", (0, 0, 0), (0.5, 0, 0), 1, Circle(0.02), STEEL)
    arm = Beam("arm", base.at_end, (0, 0.3, 0), 1, Circle(0.02), STEEL)
    scene = Scene(
        [base, arm],
        joints=[Pin(base.at_start), Revolute(arm.at_start, axis=(0, 0, 1), other=base.at_end)],
        start=[
            InitialVelocity("base", (3.0, 0, 0), (0, 0, 0)),
            InitialVelocity("arm", (3.0, 0, 0), (0, 0, 0)),
        ],
    )
    t, spin = 1 / 16, 3.0
    solution = simulate(scene, t, HHT(step=1 / 256))
    (way,) = (x for x in mechanism(scene, solution, [0, t], None).lines if x.kind == "way")
    angle = spin * t
    # It turns with the base; soft beams in 1/16 s leave that to a few hundredths.
    expected = [[0, 0, 1], [0, -np.sin(angle), np.cos(angle)]]
    np.testing.assert_allclose(way.ends[:, 1] - way.ends[:, 0], expected, atol=0.03)


def test_scene_alone_stands_as_declared_even_where_joints_do_not_meet():
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.1, 0.1), STEEL)
    scene = Scene([rod], joints=[Pin(rod.at_end, ground=(1.2, 0.3))], gravity=(0, -9.81))
    own = mechanism(scene, None, None, None)
    places = {x.kind: x.places[0].tolist() for x in own.marks}
    assert places["pin"] == [1.0, 0.0]
    snapshots(scene)
    link = Scene([rod], joints=[Distance(rod.at_end, 0.4, ground=(1.2, 0.3))])
    (line,) = mechanism(link, None, None, None).lines
    np.testing.assert_allclose(line.ends[0], [[1.0, 0.0], [1.2, 0.3]])


def test_picture_holds_every_instant_at_its_places_and_colours(planar):
    scene, solution = planar
    times = [0.0, 12 / 256]
    figure = snapshots(scene, solution, times, VonMisesStress())
    own = mechanism(scene, solution, times, VonMisesStress())
    areas = [x for x in figure.axes[0].collections if isinstance(x, PolyCollection)][:4]
    for k in range(2):
        rod, box = areas[2 * k : 2 * k + 2]
        for number, drawn in enumerate((rod, box)):
            faces = own.meshes[number].faces
            corners = np.array([path.vertices[:4] for path in drawn.get_paths()])
            np.testing.assert_allclose(corners, own.places[number][k][faces], atol=ROUND_OFF)
    brush = painters.PlanePainter(Figure(), own)
    faces = own.meshes[0].faces
    expected = brush.colours.to_rgba(own.values[0][1][faces].mean(axis=1))
    np.testing.assert_allclose(areas[2].get_facecolors(), expected)
    faint = 1 - (0.22 + 0.78 / 4) * (
        1 - brush.colours.to_rgba(own.values[0][0][faces].mean(axis=1))[:, :3]
    )
    np.testing.assert_allclose(areas[0].get_facecolors()[:, :3], faint)
    axes = figure.axes[0]
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    assert figure.axes[1].get_ylabel() == "von Mises stress [Pa]"


def test_space_is_drawn_at_its_places_with_equal_axes(spatial, monkeypatch):
    drawn = []
    kind = painters.Poly3DCollection
    monkeypatch.setattr(
        painters,
        "Poly3DCollection",
        lambda x, **style: drawn.append((x, style)) or kind(x, **style),
    )
    scene, solution = spatial
    figure = snapshots(scene, solution, [4 / 256], AxialForce())
    own = mechanism(scene, solution, [4 / 256], AxialForce())
    ((corners, style),) = drawn
    expected = [x[0][mesh.faces] for x, mesh in zip(own.places, own.meshes, strict=True)]
    np.testing.assert_allclose(corners, np.concatenate(expected))
    assert style["facecolors"].shape == (len(corners), 4)
    axes = figure.axes[0]
    spans = [np.ptp(getattr(axes, f"get_{axis}lim")()) for axis in "xyz"]
    box = np.array(axes._box_aspect)
    np.testing.assert_allclose(box / box[0], np.array(spans) / spans[0], rtol=1e-9)
    low, high = own.limits
    assert low == -high < 0  # signed: white is zero


def pixels(axes, places):
    """Where places in space are drawn."""
    x, y, _ = proj_transform(*places.T, axes.get_proj())
    return axes.transData.transform(np.stack([x, y], axis=1))


@pytest.mark.parametrize("camera", [None, (60.0, 20.0)])
def test_pictures_of_space_are_whole_beside_their_colour_bar(spatial, camera):
    scene, solution = spatial
    times = [0.0, 4 / 256]
    figure = snapshots(scene, solution, times, AxialForce(), "An arm", camera=camera)
    axes, bar = figure.axes
    own = mechanism(scene, solution, times, AxialForce())
    boxes = [axis.get_tightbbox() for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    drawn = pixels(axes, np.concatenate([x.reshape(-1, 3) for x in own.places]))
    corners = np.concatenate([drawn, *(box.get_points() for box in boxes)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    height = figure.bbox.height
    assert low[0] >= 0
    assert high[0] < bar.bbox.x0
    assert figure.legends[0].get_window_extent().y1 < low[1]
    assert high[1] < height
    # And they fill their room, in one direction at least.
    assert (high - low)[0] > 0.9 * bar.bbox.x0 or (high - low)[1] > 0.6 * height
    assert (axes.elev, axes.azim) == ((22, -60) if camera is None else camera)


def test_limits_of_colours_are_those_asked_for(planar, tmp_path):
    scene, solution = planar
    limits = (1e3, 2e4)
    figure = snapshots(scene, solution, colour=VonMisesStress(), limits=limits)
    assert figure.axes[1].get_ylim() == limits
    data = page_data(mechanism(scene, solution, None, VonMisesStress(), limits), 1.0, "")
    assert data["limits"] == limits
    shades = np.frombuffer(base64.b64decode(data["shades"]), np.uint8).reshape(13, -1)
    values, _ = mechanism(scene, solution, None, VonMisesStress()).values
    assert values.min() < limits[0]
    assert values.max() > limits[1]
    share = np.clip((values - limits[0]) / (limits[1] - limits[0]), 0, 1)
    np.testing.assert_array_equal(shades[:, : values.shape[1]], np.round(254 * share))
    animate(scene, solution, tmp_path / "a.gif", VonMisesStress(), 2, 1, dpi=30, limits=limits)
    assert (tmp_path / "a.gif").exists()


def test_colours_of_a_page_are_those_of_the_colour_bar(planar):
    own = mechanism(*planar, None, VonMisesStress())
    data = page_data(own, 1.0, "")
    colours = np.frombuffer(base64.b64decode(data["map"]), np.uint8).reshape(256, 4)
    shades = np.frombuffer(base64.b64decode(data["shades"]), np.uint8).reshape(13, -1)
    values = own.values[0]
    drawn = colours[shades[:, : values.shape[1]]]
    # A texture of 256 colours and 254 shades: two colours beside it at most, of 3.2 in 255 each.
    expected = 255 * painters.PlanePainter(Figure(), own).colours.to_rgba(values)
    assert np.max(np.abs(drawn - expected)) <= 6.5


def test_bodies_of_a_plane_cover_each_other_in_their_order(planar, tmp_path):
    own = mechanism(*planar, None, None)
    data = page_data(own, 1.0, "")
    triangles = np.frombuffer(base64.b64decode(data["triangles"]), np.uint32).reshape(-1, 3)
    bodies = np.repeat([0, 1], [x.shape[1] for x in own.places])[triangles]
    assert np.all(bodies == bodies[:, :1])
    assert np.all(np.diff(bodies[:, 0]) >= 0)
    # One depth has no order: the page tests depth in space only.
    text = animate(*planar, tmp_path / "a.html", frames=2).path.read_text(encoding="utf-8")
    assert re.findall(r".*DEPTH_TEST.*", text)[0].strip().startswith("if (data.d === 3)")


def test_a_page_starts_from_the_camera(spatial, tmp_path):
    path = animate(*spatial, tmp_path / "a.html", frames=2, camera=(10, 30)).path
    text = path.read_text(encoding="utf-8")
    assert json.loads(re.search(r"const data = (.*);\n", text)[1])["camera"] == [10, 30]
    assert "azimuth: data.camera[1], elevation: data.camera[0]" in text


def test_arrows_follow_the_law_of_their_load():
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.1, 0.1), STEEL)
    law = Harmonic(1.0, 2.0)
    loads = [PointForce(rod.at_end, (0.0, 3.0), law=law), DistributedForce("rod", (0.0, -2.0))]
    loads.append(Moment(rod.at_end, 0.5, law=law))
    scene = Scene([rod], joints=[Clamp(rod.at_start)], loads=loads)
    solution = simulate(scene, 16 / 64, HHT(step=1 / 64))
    force, line, moment = mechanism(scene, solution, None, None).arrows
    factor = law.derivative(np.array(list(law.parameters().values())), solution.t, 0)
    assert np.ptp(factor) > 0.1
    np.testing.assert_allclose(force.vectors[:, 0], np.outer(factor, (0.0, 3.0)), atol=1e-14)
    np.testing.assert_allclose(line.vectors, np.broadcast_to((0.0, -2.0), line.vectors.shape))
    # The slopes that the moment pulls at turn and stretch by the strain.
    np.testing.assert_allclose(moment.vectors[:, 0, 0], 0.5 * factor, rtol=1e-3, atol=1e-12)


def test_the_legend_names_sizes_with_their_units(planar, spatial):
    def texts(scene, solution):
        legend = snapshots(scene, solution).legends[0]
        return [text.get_text() for text in legend.get_texts() if "largest" in text.get_text()]

    assert texts(*planar) == [
        "force, largest 5 N",
        "moment, largest 0.7 N m",
        "force per length, largest 5 N/m",
    ]
    assert texts(*spatial) == ["moment, largest 1.5 N m"]


def test_thin_beams_have_the_colour_of_the_largest_stress():
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.004, 0.01), STEEL)
    scene = Scene([rod], joints=[Clamp(rod.at_start)], gravity=(0, -0.1))
    rest = equilibrium(scene).solution
    figure = snapshots(scene, rest, colour=VonMisesStress())
    own = mechanism(scene, rest, None, VonMisesStress())
    (line,) = [x for x in figure.axes[0].collections if isinstance(x, LineCollection)][:1]
    largest = own.values[0][0].reshape(-1, own.meshes[0].shape[2]).max(axis=1)
    brush = painters.PlanePainter(Figure(), own)
    expected = brush.colours.to_rgba((largest[1:] + largest[:-1]) / 2)
    np.testing.assert_allclose(line.get_colors(), expected)


def test_equilibrium_is_drawn():
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.1, 0.1), STEEL)
    spring = SpringDamper(rod.at_end, 500.0, ground=(1.0, 0.5))
    scene = Scene([rod], joints=[Pin(rod.at_start)], gravity=(0, -9.81), loads=[spring])
    figure = snapshots(scene, equilibrium(scene).solution, colour=BendingMoment())
    assert len(figure.axes) == 2
    (line,) = (x for x in mechanism(scene, None, None, None).lines if x.kind == "spring")
    np.testing.assert_allclose(line.ends[0], [[1.0, 0.0], [1.0, 0.5]])


def test_film_has_its_frames_and_they_move(planar, tmp_path):
    path = animate(*planar, tmp_path / "films" / "motion.gif", Speed(), frames=3, seconds=1, dpi=30)
    with Image.open(path) as film:
        assert film.n_frames == 3
        first = np.asarray(film.convert("RGB")).copy()
        film.seek(2)
        assert np.any(first != np.asarray(film.convert("RGB")))


@pytest.mark.parametrize("moves", ["planar", "spatial"])
def test_films_are_what_drawing_each_frame_whole_gives(
    moves, request, tmp_path, monkeypatch, capsys
):
    motion, settings = request.getfixturevalue(moves), {"frames": 2, "seconds": 1, "dpi": 40}
    quick = animate(*motion, tmp_path / "quick.gif", Speed(), **settings, progress=True)
    assert "2/2" in capsys.readouterr().err
    monkeypatch.setattr(pictures, "_freeze", lambda *_: None)
    whole = animate(*motion, tmp_path / "whole.gif", Speed(), **settings)
    assert quick.path.read_bytes() == whole.path.read_bytes()
    assert not capsys.readouterr().err


@pytest.mark.skipif(shutil.which("ffprobe") is None, reason="ffmpeg is not installed")
def test_mp4_is_read_back(planar, tmp_path):
    path = animate(*planar, tmp_path / "motion.mp4", frames=3, seconds=0.5, dpi=30)
    probe = ["ffprobe", "-v", "error", "-of", "json", "-count_frames", "-show_streams"]
    (film,) = json.loads(subprocess.check_output([*probe, path]))["streams"]
    assert (film["codec_name"], film["nb_read_frames"]) == ("h264", "3")
    # What browsers play, which needs even sizes.
    assert film["pix_fmt"] == "yuv420p"
    assert float(film["duration"]) == pytest.approx(0.5)
    raw = ["ffmpeg", "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    frames = np.frombuffer(subprocess.check_output(raw), np.uint8).reshape(3, -1).astype(int)
    # Compression leaves a few of 255 shades; the rod that moved is dark on white.
    assert np.abs(frames[2] - frames[0]).max() > 100


def test_page_needs_nothing_and_holds_the_motion(moving, tmp_path):
    scene, solution = moving
    path = animate(
        scene, solution, tmp_path / "motion.html", Speed(), frames=3, title="</script> & co"
    ).path
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"https?://|src=|@import|<link", text)
    assert text.count("</script>") == 1
    data = json.loads(re.search(r"const data = (.*);\n", text)[1])
    assert data["title"] == "</script> & co"
    own = mechanism(scene, solution, data["t"], Speed())
    low, span, n = np.array(data["low"]), np.array(data["span"]), data["points"]
    x = np.frombuffer(base64.b64decode(data["places"]), np.uint16).reshape(3, n, 3) / 65535
    expected = np.concatenate(own.places, axis=1)
    # Half a step of 16 bits over the extent.
    np.testing.assert_allclose(
        (low + span * x)[..., : own.d], expected, atol=0.51 / 65535 * span.max()
    )
    shades = np.frombuffer(base64.b64decode(data["shades"]), np.uint8).reshape(3, n)
    values, limits = np.concatenate(own.values, axis=1), data["limits"]
    back = limits[0] + shades / 254 * (limits[1] - limits[0])
    np.testing.assert_allclose(back, values, atol=0.51 / 254 * (limits[1] - limits[0]))
    triangles = np.frombuffer(base64.b64decode(data["triangles"]), np.uint32)
    assert triangles.max() == n - 1
    signs = np.frombuffer(base64.b64decode(data["signs"]), np.float32)
    assert len(signs) == 3 * 3 * sum(item["count"] for item in data["items"])


def test_page_keeps_bodies_without_the_field_apart(planar):
    data = page_data(mechanism(*planar, None, VonMisesStress()), 1.0, "")
    shades = np.frombuffer(base64.b64decode(data["shades"]), np.uint8).reshape(13, -1)
    assert np.all(shades[:, -4:] == 255)  # the box
    assert shades[:, :-4].max() == 254


def along(system, solution, observable):
    partials, own = observable.partials(system, states_of(solution)), solution.sensitivities
    return partials.value, partials.total(own.q_b, own.v_b, own.lam_b)


def test_bands_are_what_a_per_cent_does(planar):
    scene, solution = planar
    system, tip = assemble(scene, DESIGN), position(MaterialPoint("rod", 1.0), 1)
    value, slopes = along(system, solution, tip)
    expected = solution.derivative(lambda s: s.position(MaterialPoint("rod", 1.0))[:, 1])
    np.testing.assert_allclose(slopes, expected, rtol=1e-10, atol=1e-13)
    figure = history(system, solution, {"tip [m]": tip, "T [J]": kinetic_energy()}, percent=2.0)
    bands = {x.get_label(): x for x in figure.axes[0].collections}
    for i, name in enumerate(DESIGN):
        half = 0.02 * np.abs(expected[:, i]) * system.b[i]
        y = bands[name].get_paths()[0].vertices[:, 1]
        assert y.max() == pytest.approx((value + half).max(), rel=1e-12)
        assert y.min() == pytest.approx((value - half).min(), rel=1e-12)
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), value)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "rod.height ± 2 %",
        "rod.length ± 2 %",
    ]


def test_derivatives_of_histories_hold_velocities_and_the_design(planar):
    scene, solution = planar
    system = assemble(scene, DESIGN)
    _, slopes = along(system, solution, kinetic_energy())
    for i in range(2):
        h = 1e-5 * system.b[i]
        runs = [system.with_values(system.b + s * h * np.eye(2)[i]) for s in (1, -1)]
        T = [observe(kinetic_energy(), simulate(x, 12 / 256, HHT(step=1 / 256)), x) for x in runs]
        # Differences: h^2 times third derivatives, and Newton's tolerance over h.
        np.testing.assert_allclose(
            (T[0] - T[1]) / (2 * h), slopes[:, i], atol=1e-5 * np.abs(slopes[:, i]).max()
        )


def test_bars_point_up_where_the_objective_rises_and_are_in_proportion():
    rod = Beam("rod", (0, 0), (1, 0), 3, Rectangle(0.1, 0.1), STEEL)
    scene = Scene([rod], joints=[Pin(rod.at_start)], gravity=(0, -9.81))
    run = gradient(
        scene,
        Terminal(position(rod.at_end, 1)),
        1 / 16,
        HHT(step=1 / 128),
        design=distributed_variables("rod.height", 3),
    )
    own = mechanism(scene, None, None, None)
    values = np.array([0.5, -2.0, 1.0])
    x = bar_places(own, 0, values, extent=1.0)
    n = len(own.meshes[0].xi)
    tips = x[:, n:, 1] - x[:, :n, 1]
    np.testing.assert_allclose(tips, 0.22 * values[:, None] / 2 * np.ones(n), atol=1e-15)
    figure = gradient_bars(scene, run, "rod.height", time=1 / 16)
    bars = [c for c in figure.axes[0].collections if isinstance(c, PolyCollection)][-1]
    drawn = np.array([path.vertices[:-1] for path in bars.get_paths()])
    moved = mechanism(scene, run.solution, [1 / 16], None)
    np.testing.assert_allclose(
        drawn[:, : 2 * n],
        bar_places(moved, 0, run.gradient, painters.PlanePainter(figure, moved).extent),
        atol=1e-12,
    )
    with pytest.raises(UnknownNameError, match="bar"):
        gradient_bars(scene, run, "bar.height")
    with pytest.raises(InvalidInputError, match="distributed_variables"):
        gradient_bars(scene, run, "rod.width")


def test_vtk_reads_back_with_fields_and_times(moving, tmp_path):
    scene, solution = moving
    times = [float(solution.t[1]), float(solution.t[-1])]
    path = write_vtk(scene, solution, tmp_path / "out" / "motion.pvd", times)
    sets = ElementTree.parse(path).getroot().findall(".//DataSet")
    assert [float(x.get("timestep")) for x in sets] == times
    own = mechanism(scene, solution, times, VonMisesStress())
    for k, entry in enumerate(sets):
        mesh = meshio.read(path.parent / entry.get("file"))
        x = np.concatenate([place[k] for place in own.places])
        np.testing.assert_array_equal(mesh.points[:, : own.d], x)
        first = len(own.meshes[0].faces)
        np.testing.assert_array_equal(mesh.cells[0].data[:first], own.meshes[0].faces)
        counts = [len(each.faces) for each in own.meshes]
        numbers = np.repeat(np.arange(len(counts)), counts)
        np.testing.assert_array_equal(mesh.cell_data["body"][0][:, 0], numbers)
        stress = np.concatenate([values[k] for values in own.values])
        np.testing.assert_array_equal(mesh.point_data["von Mises stress [Pa]"][:, 0], stress)
        declared = mechanism(scene, None, None, None)
        moved = x - np.concatenate([place[0] for place in declared.places])
        np.testing.assert_array_equal(mesh.point_data["displacement [m]"][:, : own.d], moved)
        name = solution.sensitivities.names[0]
        slopes = own.meshes[0].sensitivities(own.motion.q, own.motion.sensitivities.q_b[..., 0], 0)
        read = mesh.point_data[f"d place/d {name}"][: slopes.shape[1], : own.d]
        np.testing.assert_array_equal(read, slopes[k])
        point = MaterialPoint(own.meshes[0].name, 0.0)
        N = observe(axial_force(point), own.motion, assemble(scene))[k]
        assert mesh.point_data["N [N]"][0] == pytest.approx(N, rel=1e-10)


def test_vtk_without_its_package_names_the_extra(planar, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyevtk.hl", None)
    with pytest.raises(MissingPackageError, match=r'pip install "ancfdae\[vtk\]"'):
        write_vtk(*planar, tmp_path / "motion.pvd")
    assert not list(tmp_path.iterdir())


def test_nonsense_is_refused_in_words(planar, spatial, tmp_path, monkeypatch):
    scene, solution = planar
    bare = simulate(scene, 1 / 256, HHT(step=1 / 256))
    longer = scene.with_values({"rod.length": 1.0})
    for call, words in (
        (lambda: snapshots(spatial[0], solution), "must be that of the scene"),
        (lambda: snapshots(longer, solution), "with_values"),
        (lambda: snapshots(scene, times=[0.1]), "need a motion"),
        (lambda: snapshots(scene, colour=Speed()), "need a motion"),
        (lambda: snapshots("scene"), "type Scene"),
        (lambda: snapshots(scene, solution, colour="speed"), "type Field"),
        (lambda: snapshots(scene, solution, times=[5.0]), r"lie in \[0"),
        (lambda: snapshots(scene, solution, title=3), "type str"),
        (lambda: snapshots(scene, bare, colour=Sensitivity("rod.height")), "differentiate"),
        (lambda: snapshots(scene, solution, colour=Sensitivity("x")), "Known names"),
        (lambda: snapshots(scene, solution, limits=(0, 1)), "increasing numbers"),
        (lambda: snapshots(scene, solution, colour=Speed(), limits=(1, 1)), "increasing numbers"),
        (lambda: snapshots(scene, solution, camera=(0, 0)), "left out for a planar scene"),
        (lambda: BendingMoment(3), "must be 1 or 2"),
        (lambda: animate(scene, solution, tmp_path / "a.avi"), "ends with"),
        (lambda: animate(scene, solution, 3), "name of a file"),
        (lambda: animate(scene, solution, tmp_path / "a.gif", frames=0), "positive integer"),
        (lambda: animate(scene, solution, tmp_path / "a.gif", seconds=-1), "positive"),
        (lambda: animate(scene, equilibrium(cable()).solution, tmp_path / "a.gif"), "instants"),
        (lambda: write_vtk(scene, solution, tmp_path / "a.vtu"), "ends with"),
        (lambda: history(assemble(scene), solution, {"T [J]": kinetic_energy()}), "Known names"),
        (
            lambda: history(assemble(scene, DESIGN), bare, {"T [J]": kinetic_energy()}),
            "derivatives",
        ),
        (lambda: history(assemble(scene, DESIGN), solution, {"T [": kinetic_energy()}), "unit"),
        (lambda: history(assemble(scene, DESIGN), solution, {}), "at least one"),
        (lambda: gradient_bars(scene, solution, "rod.height"), "type Gradient"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            call()
    monkeypatch.setattr("matplotlib.animation.FFMpegWriter.isAvailable", lambda: False)
    with pytest.raises(MissingPackageError, match="ffmpeg"):
        animate(scene, solution, tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_every_field_has_a_name_and_a_unit():
    kinds = [StrainEnergyDensity(), VonMisesStress(), AxialForce(), BendingMoment(), Speed()]
    for field in [*kinds, Sensitivity("rod.height")]:
        assert isinstance(field, Field)
        assert re.fullmatch(r".+ \[.+\]", field.label)


def test_vtk_leaves_out_stresses_that_no_section_knows(tmp_path):
    section = GeneralSection(2e-4, 2e-8, 1e-8, 2e-8)
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 1, section, STEEL)
    scene = Scene([rod], joints=[Clamp(rod.at_start)], gravity=(0, 0, -0.1))
    path = write_vtk(scene, equilibrium(scene).solution, tmp_path / "rest.pvd")
    (entry,) = ElementTree.parse(path).getroot().findall(".//DataSet")
    names = meshio.read(path.parent / entry.get("file")).point_data
    assert "M_z [N m]" in names
    assert "von Mises stress [Pa]" not in names


@pytest.mark.parametrize("section", [Rectangle(0.04, 0.02), ISection(0.06, 0.04, 0.008, 0.01)])
def test_a_shaft_in_torsion_has_the_colours_of_its_sides(section):
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 2, section, STEEL)
    load = Moment(rod.at_end, (1e-3, 0, 0))
    scene = Scene([rod], joints=[Clamp(rod.at_start)], loads=[load])
    rest = equilibrium(scene).solution
    (values,) = mechanism(scene, rest, None, VonMisesStress()).values
    # Corners have none, sides a quarter of the width from them nearly all.
    largest = observe(von_mises(rod.at(0.5, y=section.half_extents[0])), rest, assemble(scene))[0]
    assert values.min() < 0.05 * largest
    assert values.max() > 0.7 * largest


@pytest.mark.parametrize("d", [2, 3])
def test_vtk_of_bodies_without_a_shape_is_refused_before_anything_is_written(d, tmp_path):
    inertia = 0.1 if d == 2 else (0.1, 0.1, 0.1)
    body = RigidBody("body", (0.0,) * d, mass=1.0, inertia=inertia)
    scene = Scene([], bodies=[body])
    with pytest.raises(InvalidInputError, match="needs a beam or a body with a surface"):
        write_vtk(scene, simulate(scene, 0.01, HHT(0.005)), tmp_path / "run.pvd")
    assert not list(tmp_path.iterdir())
