"""Results that print as tables show in notebooks and become tables of pandas with their numbers."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    EndEvent,
    Material,
    Pin,
    PointForce,
    RigidBody,
    RigidBox,
    RotatingFrame,
    Scene,
    Terminal,
    assemble,
    campbell,
    check_system,
    choose_model,
    critical_load,
    equilibrium,
    error_bars,
    gradient,
    mass_properties,
    modes,
    record_observables,
    simulate,
    taylor_test,
)
from ancfdae.errors.text import columns, page
from ancfdae.observables import position
from ancfdae.sections import Circle, Rectangle

ROD = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.1, 0.1), Material(1000, 1e7, 0.3))
PENDULUM = Scene([ROD], [Pin(ROD.at_start)], gravity=(0, -9.81))
DESIGN = ["rod.height", "rod.density"]
TIP = position(ROD.at_end, 1)
STEPS = HHT(1 / 64)


def results():
    """Every result that prints as a table, with a number that must stand in it."""
    found = gradient(PENDULUM, Terminal(TIP), 1 / 8, STEPS, design=DESIGN)
    careful = gradient(PENDULUM, Terminal(TIP), 1 / 8, design=DESIGN, tolerance=0.05)
    estimates = simulate(PENDULUM, 1 / 8, observables=[TIP], tolerance=0.05)
    record = record_observables(PENDULUM, [TIP], 1 / 8, STEPS, keep=2)
    bars = error_bars(PENDULUM, Terminal(TIP), 1 / 8, STEPS, design=DESIGN)
    taylor = taylor_test(PENDULUM, Terminal(TIP), 1 / 8, STEPS, design=DESIGN)
    clamped = modes(Scene([ROD], [Clamp(ROD.at_start)]), 2, design=DESIGN)
    shaft = Beam("shaft", (0, 0, 0), (1, 0, 0), 2, Circle(0.02), Material(7850, 2e11, 0.3))
    spun = Scene([shaft], [Clamp(shaft.at_start)], frame=RotatingFrame(0.0, (1, 0, 0)))
    turned = campbell(spun, [0.0, 10.0], 2)
    ended = simulate(PENDULUM, 1, STEPS, events=[EndEvent(TIP + 0.1, name="low")])
    check = check_system(assemble(PENDULUM, DESIGN))
    ladder = choose_model(PENDULUM, Terminal(TIP), 1 / 8, 0.5, design=["rod.density"])
    pushed = Scene([ROD], [Clamp(ROD.at_start)], loads=[PointForce(ROD.at_end, (0, 0), name="F")])
    load = critical_load(pushed, "F.force_x", -300.0, design=["rod.height"])
    bent = equilibrium(pushed.with_values({"F.force_y": -1.0}), design=DESIGN)
    sizes = mass_properties(PENDULUM, design=DESIGN)
    return {
        "Gradient": (found, "derivative", found.gradient),
        "Accuracy": (careful.accuracy, "seconds", [x.seconds for x in careful.accuracy.trials]),
        "ObservableEstimates": (estimates, "bar of 0", estimates.bars[:, 0]),
        "ObservableRecord": (record, "0", record.values[:, 0]),
        "ErrorBars": (bars, "bar", [bars.value_bar, *bars.gradient_bar]),
        "TaylorTest": (taylor, "remainder", taylor.first),
        "Modes": (clamped, "d/d rod.height", clamped.natural_frequencies_b[:, 0]),
        "Campbell": (turned, "mode 1", turned.frequencies[:, 1]),
        "EventSolution": (ended, "time", [ended.events[0].time]),
        "SystemCheck": (check, "error", [x.error for x in check.findings]),
        "ModelComparison": (ladder, "error", [x.error for x in ladder.choices()]),
        "CriticalLoad": (load, "derivative", load.gradient),
        "Equilibrium": (bent, "d/d rod.height", bent.q_b[:, 0]),
        "MassProperties": (
            sizes,
            "d/d rod.height",
            [*sizes.mass_b[:1], *sizes.centre_b[:, 0], *sizes.inertia_b[0, :, 0]],
        ),
    }


@pytest.fixture(scope="module")
def found():
    return results()


def test_tables_of_pandas_hold_the_numbers(found):
    for name, (result, column, numbers) in found.items():
        assert type(result).__name__ == name
        np.testing.assert_array_equal(result.to_dataframe()[column], numbers, err_msg=name)


def test_notebooks_show_the_table(found):
    for name, (result, _, _) in found.items():
        shown = result._repr_html_()
        assert "<table><tr><th>" in shown, name
        assert shown.count("<tr>") == shown.count("</tr>") > 1, name


def test_the_text_before_and_after_the_table_shows_in_both(found):
    event, estimates = found["EventSolution"][0], found["ObservableEstimates"][0]
    for shown in (repr(event), event._repr_html_()):
        assert "1 phases" in shown
        assert str(event.outcome) in shown
    assert estimates.why in repr(estimates)
    assert "low" in repr(event)


def test_the_derivative_of_a_frequency_is_the_closed_form(found):
    """Of a thin clamped beam |s| goes with h and 1/sqrt(rho); shear and rotation take 3 %."""
    table = found["Modes"][0].to_dataframe()
    of_height, of_density = table["d/d rod.height"], table["d/d rod.density"]
    np.testing.assert_allclose(of_density * 1000 / table["natural frequency"], -0.5, rtol=1e-9)
    np.testing.assert_allclose(of_height[0] * 0.1 / table["natural frequency"][0], 1, rtol=0.03)


def test_rows_of_mass_and_critical_load_are_closed_forms(found):
    """A bar: m = rho A l, J = m (l^2 + h^2)/12; a column's load goes with h^3."""
    sizes, load = found["MassProperties"][0], found["CriticalLoad"][0].to_dataframe()
    table = sizes.to_dataframe()
    assert list(table.index) == ["mass", "centre.x", "centre.y", "inertia.zz"]
    np.testing.assert_allclose(table["value"], [10, 0.5, 0, 10 * 1.01 / 12], atol=1e-12)
    exact = [1e-2, 0, 0, 1.01 / 1200]
    np.testing.assert_allclose(table["d/d rod.density"], exact, atol=1e-12)
    assert repr(sizes).splitlines()[5].split() == ["inertia.zz", "0.841667", "kg", "m^2"]
    block = RigidBody("block", (0, 0, 0), shape=RigidBox(0.4, 0.2, 0.1), density=900)
    spatial = mass_properties(Scene(bodies=[block])).to_dataframe()["value"]
    assert list(spatial.index[4:]) == [f"inertia.{x}" for x in ("xx", "xy", "xz", "yy", "yz", "zz")]
    m = 900 * 0.4 * 0.2 * 0.1
    turning = m / 12 * np.array([0.05, 0, 0, 0.17, 0, 0.20])
    np.testing.assert_allclose(spatial[4:], turning, atol=1e-12)
    assert load.attrs["name"] == "F.force_x"
    # Shear takes part of the load of a thick column: 3 P/h less 2 to 3 %.
    slope = load.loc["rod.height", "derivative"] * 0.1 / load.attrs["value"]
    assert slope == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize(("count", "shown"), [(12, 12), (13, 13), (14, 12)])
def test_no_table_hides_a_single_line(count, shown):
    rows = [("title",), *((f"row {k}",) for k in range(count))]
    lines = columns(rows).split("\n")
    assert len([line for line in lines if line.startswith("row")]) == shown
    assert page("", rows).count("<td>") == shown
    more = f"and {count - shown} more"
    assert (lines[-1] == more) == (count > shown) == (more in page("", rows))
    assert len(columns(rows, shorten=False).split("\n")) == count + 1
