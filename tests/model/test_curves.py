"""Curved beams from a few points: arcs, and smooth curves without frames by hand."""

import numpy as np
import pytest

from ancfdae import Clamp, CurvedBeam, Material, PointForce, Scene, equilibrium
from ancfdae.errors import InvalidInputError
from ancfdae.sections import Circle, Rectangle

STEEL = Material(7850, 2.1e11, 0.3)
BAR = Rectangle(height=0.01, width=0.02)
QUARTER = (np.cos(np.pi / 4), np.sin(np.pi / 4))


def turned(points, axis=(0.3, -0.5, 0.8), angle=1.1):
    """Points of the plane, placed in a tilted plane of space."""
    k = np.array(axis) / np.linalg.norm(axis)
    K = np.cross(np.eye(3), k)
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return np.column_stack([points, np.zeros(len(points))]) @ R.T + [0.2, -0.4, 1.0]


@pytest.mark.parametrize("angle", [0.3, np.pi / 2, np.pi, 2.9, 4.0, 6.0])
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("spatial", [False, True])
def test_nodes_of_an_arc_lie_on_the_circle_and_its_length_is_radius_times_angle(
    angle, sense, spatial
):
    theta = sense * angle * np.array([0.0, 0.4, 1.0])
    points = 2.0 * np.column_stack([np.cos(theta), np.sin(theta)]) + [1.0, -3.0]
    centre = np.array([[1.0, -3.0]])
    if spatial:
        points, centre = turned(points), turned(centre)
    beam = CurvedBeam.arc("arc", *points, 64, BAR, STEEL)
    assert beam.length == pytest.approx(2.0 * angle, rel=2e-7)
    np.testing.assert_allclose(np.linalg.norm(beam.positions - centre, axis=1), 2.0, rtol=1e-13)
    np.testing.assert_allclose(beam.positions[[0, -1]], points[[0, 2]], atol=1e-14)
    radial = (beam.positions - centre) / 2.0
    frames = beam.frames
    np.testing.assert_allclose(np.einsum("ni,ni->n", frames[:, 0], radial), 0, atol=1e-14)
    unit = frames @ np.swapaxes(frames, 1, 2) - np.eye(len(points[0]))
    np.testing.assert_allclose(unit, 0, atol=1e-13)
    inward = 1 if spatial else sense
    np.testing.assert_allclose(frames[:, 1], -inward * radial, atol=1e-13)


def test_the_middle_may_lie_opposite_to_the_start():
    beam = CurvedBeam.arc("arc", (1, 0), (-1, 0), (0, -1), 3, BAR, STEEL)
    np.testing.assert_allclose(beam.positions, [(1, 0), (0, 1), (-1, 0), (0, -1)], atol=1e-15)


def test_a_quarter_arc_deflects_as_castigliano_says():
    """F at the end along the radius: u = pi F R^3/(4 E I), plus shear and stretch below 1e-4."""
    beam = CurvedBeam.arc("arc", (1, 0), QUARTER, (0, 1), 32, Rectangle(0.004, 0.004), STEEL)
    bent = equilibrium(
        Scene([beam], [Clamp(beam.at_start)], loads=[PointForce(beam.at_end, (0, -1e-3))])
    )
    EI = 2.1e11 * 0.004**4 / 12
    down = 1 - bent.solution.position(beam.at_end)[0, 1]
    assert down == pytest.approx(1e-3 * np.pi / 4 / EI, rel=1e-3)


def test_the_height_keeps_its_angle_to_the_plane_of_the_arc():
    points = turned(np.array([(1.0, 0.0), QUARTER, (0.0, 1.0)]))
    plain = CurvedBeam.arc("arc", *points, 8, BAR, STEEL).frames
    tilted = 0.8 * plain[0, 1] + 0.6 * plain[0, 2]
    frames = CurvedBeam.arc("arc", *points, 8, BAR, STEEL, height_axis=tilted).frames
    np.testing.assert_allclose(np.einsum("ni,ni->n", frames[:, 1], plain[:, 1]), 0.8, rtol=1e-13)
    np.testing.assert_allclose(np.einsum("ni,ni->n", frames[:, 1], plain[:, 2]), 0.6, rtol=1e-13)
    assert np.all(np.linalg.det(frames) > 0)


def helix(s, r=0.5, c=0.2):
    w = 1 / np.hypot(r, c)
    return np.column_stack([r * np.cos(w * s), r * np.sin(w * s), c * w * s])


def test_a_section_does_not_turn_about_the_tangent_of_a_helix():
    """Against the normals of Frenet the frame turns back by the torsion c/(r^2 + c^2)."""
    r, c = 0.5, 0.2
    s, w = np.linspace(0, 4.0, 41), 1 / np.hypot(r, c)
    beam = CurvedBeam.through("coil", helix(s), Circle(0.01), STEEL, height_axis=(-1.0, 0.0, 0.0))
    tangent = np.column_stack([-r * np.sin(w * s), r * np.cos(w * s), 0 * s + c]) * w
    normal = np.column_stack([-np.cos(w * s), -np.sin(w * s), 0 * s])
    np.testing.assert_allclose(beam.frames[2:-2, 0], tangent[2:-2], atol=1e-4)
    binormal = np.cross(tangent, normal)
    height = beam.frames[:, 1]
    angle = np.unwrap(
        np.arctan2(np.sum(height * binormal, axis=1), np.sum(height * normal, axis=1))
    )
    np.testing.assert_allclose(angle - angle[5], -c * w**2 * (s - s[5]), atol=2e-4)
    assert abs(angle[-1]) > 2


def test_a_curve_through_points_of_a_circle_converges_to_the_arc_with_order_four():
    errors = []
    for count in (9, 17, 33):
        theta = np.linspace(0, 2.0, count)
        beam = CurvedBeam.through(
            "arc", np.column_stack([np.cos(theta), np.sin(theta)]), BAR, STEEL, elements=24
        )
        errors.append(np.max(np.abs(np.linalg.norm(beam.positions, axis=1) - 1)))
        lengths = beam.reference().lengths
        np.testing.assert_allclose(lengths, lengths.mean(), rtol=1e-5)
        assert beam.length == pytest.approx(2.0, rel=20 * errors[-1] + 1e-8)
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 3.7)


def test_two_points_make_a_straight_beam_and_by_default_each_point_a_node():
    straight = CurvedBeam.through("rod", [(0, 0, 0), (0, 0, 2)], BAR, STEEL, elements=4)
    assert straight.length == pytest.approx(2.0)
    np.testing.assert_allclose(straight.frames[0], [(0, 0, 1), (1, 0, 0), (0, 1, 0)], atol=1e-15)
    points = np.array([(0.0, 0.0), (1.0, 0.5), (2.5, 0.0), (3.0, -1.0)])
    beam = CurvedBeam.through("rod", points, BAR, STEEL)
    np.testing.assert_allclose(beam.positions, points, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: CurvedBeam.arc("a", (0, 0), (1, 1), (2, 2), 4, BAR, STEEL), "one line"),
        (lambda: CurvedBeam.arc("a", (0, 0), (0, 0), (2, 2), 4, BAR, STEEL), "one line"),
        (lambda: CurvedBeam.arc("a", (0, 0), (1, 1, 0), (2, 0), 4, BAR, STEEL), "middle"),
        (lambda: CurvedBeam.arc("a", (0, 0), (1, 1), (2, 0), 0, BAR, STEEL), "elements"),
        (
            lambda: CurvedBeam.arc(
                "a", (0, 0), (1, 1), (2, 0), 2, BAR, STEEL, height_axis=(0, 0, 1)
            ),
            "in the plane",
        ),
        (lambda: CurvedBeam.through("a", [(0, 0)], BAR, STEEL), "shape"),
        (lambda: CurvedBeam.through("a", [(0, 0), (0, 0)], BAR, STEEL), "differ"),
        (
            lambda: CurvedBeam.through(
                "a", [(0, 0, 0), (1, 0, 0)], BAR, STEEL, height_axis=(1, 0, 0)
            ),
            "parallel",
        ),
    ],
)
def test_what_makes_no_curve_is_told(make, words):
    with pytest.raises(InvalidInputError, match=words):
        make()
