"""Slender columns near to the origin and far from it: critical loads, and what round-off hides."""

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    Material,
    Pin,
    PointForce,
    Scene,
    assemble,
    critical_load,
    equilibrium,
    equilibrium_gradient,
)
from ancfdae.errors import FreeMotionError, NoCriticalPointError
from ancfdae.observables import position
from ancfdae.sections import Rectangle
from ancfdae.statics.balance import Balance
from ancfdae.statics.exact_products import ExactProducts

E = 2e11


def column(h: float, n: int, place: float = 0.0, d: int = 2, width: float = 1.0) -> Scene:
    """Return a column of length 1 that is clamped at its start, with a force at its end."""
    start, end = (place, *[0.0] * (d - 1)), (place + 1.0, *[0.0] * (d - 1))
    beam = Beam("column", start, end, n, Rectangle(h, width * h), Material(7800.0, E, 0.3))
    force = PointForce(beam.at_end, (0.0,) * d, name="load")
    return Scene([beam], [Clamp(beam.at_start)], loads=[force])


def euler(h: float, width: float = 1.0) -> float:
    return -(np.pi**2) * E * width * h**4 / 12 / 4


@pytest.mark.parametrize(("d", "width"), [(2, 1.0), (3, 2.0)])
@pytest.mark.parametrize(
    ("h", "n", "place", "near"),
    [
        (1e-5, 64, 0.0, 3e-9),
        (1e-5, 300, 0.0, 3e-9),
        (1e-4, 64, 1e3, 2e-8),
        (1e-4, 300, 1e3, 2e-8),
        (1e-5, 64, 1e3, 3e-7),
    ],
)
def test_a_slender_column_buckles_at_eulers_load_wherever_it_stands(
    h: float, n: int, place: float, near: float, d: int, width: float
) -> None:
    """P = pi^2 E I / 4 L^2, to shear and shortening of 0.3 h^2 and 0.008/n^4 of the elements."""
    if d == 3 and n == 300:
        n = 64  # Twice as long, and shows the same.
    load = euler(h, width)
    found = critical_load(
        column(h, n, place, d, width), "load.force_x", 1.2 * load, design=["column.height"]
    )
    assert found.kind == "bifurcation"
    np.testing.assert_allclose(found.value, load, rtol=near)
    np.testing.assert_allclose(found.gradient * h / found.value, [3.0], atol=4 * near)


@pytest.mark.parametrize("place", [0.0, 1e3])
def test_two_elements_are_as_good_on_a_slender_column_as_on_a_thick_one(place: float) -> None:
    """The error of the elements, 5e-4, does not depend on the height, nor on the place."""
    errors = []
    for h in (1e-3, 1e-5):
        found = critical_load(column(h, 2, place), "load.force_x", 1.2 * euler(h))
        errors.append(found.value / euler(h) - 1.0)
    assert errors[1] == pytest.approx(errors[0], rel=2e-3)
    assert errors[1] == pytest.approx(5.12e-4, rel=1e-2)


@pytest.mark.parametrize("place", [0.0, 1e3])
def test_products_hold_the_bending_stiffness_of_a_slender_element(place: float) -> None:
    """An element bent to r_y = x^2/2 has the energy E I / 2 per length, as the strain says.

    The matrix loses it to sums of E A, and far from the origin to the rounding of coordinates.
    """
    h = 1e-6
    system = assemble(column(h, 4, place))
    q, lam = system.start()[0], np.zeros(system.n_lam)
    nodes = np.arange(5) / 4
    bent = np.zeros((5, 3, 2))
    # Position, slope along the beam, and the section, which stays at right angles to it.
    bent[:, 0, 1], bent[:, 1, 1], bent[:, 2, 0] = nodes**2 / 2, nodes, -nodes
    x = bent.ravel()
    K = Balance(system, 0.0, q, lam).tangent(1.0, q, lam)
    exact = ExactProducts(system, 0.0, q, lam, K, np.zeros_like(q))
    assert x @ exact.times(x) == pytest.approx(E * h**4 / 12, rel=1e-3)
    assert x @ exact.transposed_times(x) == pytest.approx(E * h**4 / 12, rel=1e-3)


def test_what_round_off_hides_is_not_said_to_be_free() -> None:
    with pytest.raises(FreeMotionError, match="round-off hides: column deforms"):
        equilibrium(column(1e-6, 8))
    # A column on a pin is free indeed.
    beam = Beam("column", (0, 0), (1, 0), 8, Rectangle(0.01, 0.01), Material(7800.0, E, 0.3))
    with pytest.raises(FreeMotionError, match="free to move: column turns about its start"):
        equilibrium(Scene([beam], [Pin(beam.at_start)]))


def test_a_column_whose_shortening_its_coordinates_do_not_hold_is_not_called_stable() -> None:
    h = 1e-5
    with pytest.raises(NoCriticalPointError, match=r"seems stable\..*origin"):
        critical_load(column(h, 8, 1e6), "load.force_x", 1.2 * euler(h))


@pytest.mark.parametrize("n", [1, 4])
def test_the_gradient_of_a_buckled_state_says_that_it_is_unstable(n: int) -> None:
    """Von Mises' truss of stiff bars, pushed through: its bars have buckled."""
    steel, square = Material(7800.0, E, 0.3), Rectangle(0.05, 0.05)
    left = Beam("left", (0, 0), (1, 0.5), n, square, steel)
    right = Beam("right", (1, 0.5), (2, 0), n, square, steel)
    joints = [Pin(left.at_start), Pin(left.at_end, right.at_start), Pin(right.at_end)]
    push = PointForce(left.at_end, (0.0, -5e6), name="push")
    scene = Scene([left, right], joints, loads=[push])
    found = equilibrium(scene)
    assert found.outcome.stable_to is not None
    slope = equilibrium_gradient(scene, position(left.at_end, 1), design=["left.youngs_modulus"])
    for outcome in found.outcome, slope.solution.outcome:
        assert outcome.success
        assert "% of the load: it is unstable (buckled)." in str(outcome)
    assert "unstable" in str(slope)
    light = scene.with_values({"push.force_y": -1e3})
    slope = equilibrium_gradient(light, position(left.at_end, 1), design=["left.youngs_modulus"])
    assert str(slope.solution.outcome).endswith("steps).")


def test_thick_column_of_many_short_elements_buckles_as_one_of_few() -> None:
    """Elements of 1/200 of their height: forces round by more than the bound of sums of terms."""
    h, found = 1 / 3, []
    for n in (100, 600):
        scene = column(h, n, width=2.0)
        found.append(
            critical_load(scene, "load.force_x", 1.2 * euler(h, 2.0), design=["column.height"])
        )
    assert found[1].value == pytest.approx(found[0].value, rel=1e-5)
    np.testing.assert_allclose(found[1].gradient, found[0].gradient, rtol=2e-5)
