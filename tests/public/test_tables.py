"""Tables of pandas hold the numbers of the results, under names that say which."""

import sys

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Material,
    Pin,
    RigidBody,
    RigidBox,
    Scene,
    Terminal,
    differentiate,
    gradient,
    simulate,
    sweep,
    work_precision,
)
from ancfdae.errors import InvalidInputError, MissingPackageError
from ancfdae.observables import position
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum

DESIGN = ["rod.height", "rod.density"]
STEPS = HHT(step=1 / 128)


def scene():
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.1, 0.1), Material(1000, 1e7, 0.3))
    box = RigidBody("box", (2, 0), shape=RigidBox(0.4, 0.2, 0.1), density=900)
    return Scene([rod], bodies=[box], joints=[Pin(rod.at_start), Pin(box.origin)], gravity=(0, -9))


@pytest.fixture(scope="module")
def solution():
    return differentiate(scene(), 1 / 32, STEPS, design=DESIGN)


def test_columns_are_coordinates_by_name_over_time(solution):
    tip = solution.position(scene().beams[0].at_end)
    slope = solution.slope(scene().beams[0].at(0.5), along=1)
    table = solution.to_dataframe({"tip [m]": tip[:, 1]})
    np.testing.assert_array_equal(table.index, solution.t)
    np.testing.assert_array_equal(table["rod[2].y"], tip[:, 1])
    np.testing.assert_array_equal(table["tip [m]"], tip[:, 1])
    np.testing.assert_allclose(table["rod[1].slope_y.x"], slope[:, 0], rtol=1e-15)
    np.testing.assert_array_equal(table["box.x"], solution.nodes("box")[:, 0, 0, 0])
    np.testing.assert_array_equal(table["box.axis_2.y"], solution.nodes("box")[:, 0, 2, 1])
    assert table.shape == (len(solution.t), solution.q.shape[1] + 1)
    assert np.ptp(table["rod[2].y"]) > 0


def test_derivatives_stand_under_coordinate_and_variable(solution):
    table = solution.to_dataframe(derivatives=True)
    expected = solution.derivative(lambda s: s.position(scene().beams[0].at_end)[:, 1])
    for i, name in enumerate(DESIGN):
        np.testing.assert_allclose(
            table[f"d rod[2].y/d {name}"], expected[:, i], rtol=1e-12, atol=1e-15
        )
    own = solution.sensitivities.to_dataframe()
    assert list(own.columns) == DESIGN
    np.testing.assert_array_equal(own.loc[(3, 5)], solution.sensitivities.q_b[3, 5])


def test_other_systems_have_numbered_coordinates():
    run = simulate(CartesianPendulum(), 1 / 32, STEPS)
    np.testing.assert_array_equal(run.to_dataframe()["q[1]"], run.q[:, 1])


def test_gradients_and_sweeps_have_a_row_each():
    objective = Terminal(position(scene().beams[0].at_end, 1))
    run = gradient(scene(), objective, 1 / 32, STEPS, design=DESIGN)
    table = run.to_dataframe()
    assert table.attrs["objective"] == run.value
    np.testing.assert_array_equal(table.loc[DESIGN, "derivative"], run.gradient)
    heights = [{"rod.height": 0.1}, {"rod.height": 0.2}, {"rod.height": -1.0}]
    many = sweep(
        scene(),
        heights,
        lambda model: gradient(model, objective, 1 / 32, STEPS, design=DESIGN),
    ).to_dataframe()
    assert many.loc[0, "objective"] == run.value
    assert many.loc[0, "d/d rod.density"] == run.gradient[1]
    assert many.loc[1, "objective"] != run.value
    assert np.isnan(many.loc[2, "objective"])
    assert "height" in many.loc[2, "error"]


def test_tradeoffs_have_a_row_for_each_setting():
    objective = Terminal(position(scene().beams[0].at_end, 1))
    trade = work_precision(scene(), objective, 1 / 32, [STEPS, HHT(step=1 / 64)], design=DESIGN)
    table = trade.to_dataframe()
    assert len(table) == 3
    assert list(table["gradient"][:2]) == [row.gradient for row in trade.rows]
    assert list(table["label"][:2]) == ["step 0.007812", "step 0.01562"]


def test_nonsense_is_refused_and_a_missing_package_named(solution, monkeypatch):
    with pytest.raises(InvalidInputError, match="tip"):
        solution.to_dataframe({"tip [m]": [1.0, 2.0]})
    with pytest.raises(InvalidInputError, match="differ from the names of all other columns"):
        solution.to_dataframe({"rod[2].y": solution.t})
    with pytest.raises(InvalidInputError, match="differentiate"):
        simulate(scene(), 1 / 128, STEPS).to_dataframe(derivatives=True)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingPackageError, match=r'pip install "ancfdae\[pandas\]"'):
        solution.to_dataframe()
