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
    RotatingFrame,
    Scene,
    Terminal,
    assemble,
    campbell,
    check_system,
    choose_model,
    error_bars,
    gradient,
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


@pytest.mark.parametrize(("count", "shown"), [(12, 12), (13, 13), (14, 12)])
def test_no_table_hides_a_single_line(count, shown):
    rows = [("title",), *((f"row {k}",) for k in range(count))]
    lines = columns(rows).split("\n")
    assert len([line for line in lines if line.startswith("row")]) == shown
    assert page("", rows).count("<td>") == shown
    more = f"and {count - shown} more"
    assert (lines[-1] == more) == (count > shown) == (more in page("", rows))
    assert len(columns(rows, shorten=False).split("\n")) == count + 1
