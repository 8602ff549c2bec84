"""What people print of a result is short and says what matters, whatever the size of the scene."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    DirectDifferentiation,
    Integral,
    Terminal,
    assemble,
    check_system,
    differentiate,
    distributed_variables,
    error_bars,
    estimate_adjoint_error,
    gradient,
    simulate,
    sweep,
    taylor_test,
    work_precision,
)
from ancfdae.errors.text import columns, listed, page
from ancfdae.extend import MaterialPoint
from ancfdae.observables import custom, position
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

SCENE = pendulum(elements=20)
DESIGN = distributed_variables("pendulum.height", 20)
OBJECTIVE = Integral(position(MaterialPoint("pendulum", 1.0), 1) ** 2)
Y = custom(lambda t, q, v, lam, b: q[:, 1], "y")
ARGUMENTS = (SCENE, OBJECTIVE, 0.04, HHT(0.01))
END = "the end time was reached (t = 0.04, "


@pytest.fixture(scope="module")
def found():
    return gradient(*ARGUMENTS, design=DESIGN)


@pytest.fixture(scope="module")
def run():
    return differentiate(SCENE, 0.04, HHT(0.01), design=DESIGN)


def short(result):
    text = repr(result)
    assert text == str(result)
    assert text.count("\n") < 16
    # No array: NumPy writes them in brackets, and no name here has a space after one.
    assert not any(part in text for part in ("[ ", "array(", "0x"))
    return text


def test_a_gradient_shows_value_names_derivatives_method_and_outcome(found):
    text = short(found)
    for part in (f"{found.value:.9g}", "pendulum.height[0] ", f"{found.gradient[0]:.6g}"):
        assert part in text
    for part in ("Adjoint()", "and 8 more", END):
        assert part in text


def test_a_solution_shows_its_size_variables_and_outcome(run):
    text = short(run)
    for part in ("5 instants", "126 coordinates", "2 multipliers", "pendulum.height[0], ", END):
        assert part in text
    assert f"motion {run.estimated_errors.motion:.3g}" in text
    assert "derivatives in" not in short(simulate(SCENE, 0.01, HHT(0.01)))


def test_sensitivities_show_names_values_and_sizes(run):
    own = run.sensitivities
    first = np.max(np.abs(own.q_b[..., 0]))
    assert f"pendulum.height[0]   0.05   {first:.6g}" in short(own)


def test_error_bars_show_bars_and_outcome():
    bars = error_bars(*ARGUMENTS, design=DESIGN)
    text = short(bars)
    for part in (f"{bars.value:.9g}", f"{bars.value_bar:.2g}", f"{bars.gradient[0]:.9g}", END):
        assert part in text
    assert "waves resolved: no" in text


def test_an_adjoint_error_shows_value_error_and_outcome():
    estimate = estimate_adjoint_error(*ARGUMENTS)
    for part in (f"{estimate.value:.9g}", f"{estimate.error:.2g}", END):
        assert part in short(estimate)


def test_a_taylor_test_shows_order_and_remainders():
    test = taylor_test(*ARGUMENTS, design=DESIGN)
    for part in (f"{test.gradient.value:.9g}", f"order {test.order:.3g}", f"{test.first[1]:.3g}"):
        assert part in short(test)


def test_a_tradeoff_shows_errors_and_outcomes_of_twelve_settings_at_most():
    settings = [HHT(0.02 / k) for k in range(1, 15)]
    result = work_precision(CartesianPendulum(), Integral(Y), 0.04, settings, reference=HHT(0.001))
    text = repr(result)
    assert text.count("\n") == 13
    for part in ("(reference)", f"{result.rows[0].gradient:.2g}", END):
        assert part in text
    assert result.table().count("\n") == 15


def test_scene_and_system_show_their_parts():
    for part in ("beams: pendulum (20 elements)", "joints: pin(pendulum@0)", "gravity: (0.0, -9.8"):
        assert part in short(SCENE)
        assert part in short(assemble(SCENE, DESIGN))
    assert "pendulum.height[0] = 0.05" in short(assemble(SCENE, DESIGN))


def test_a_conformance_names_what_is_wrong_and_prints_all():
    report = check_system(CartesianPendulum(), samples=1)
    assert repr(report) == f"CartesianPendulum: {len(report.findings)} checks, all ok"
    assert str(report).count("\n") > len(report.findings)


def test_lists_end_and_columns_stand_below_each_other():
    assert listed([]) == "none"
    assert listed("abc") == "a, b, c"
    assert listed(range(14)).endswith("10, 11 and 2 more")
    assert columns([("a", "bb"), ("ccc", "d")]) == "a    bb\nccc  d"
    assert columns([("a",)] * 16).endswith("a\nand 3 more")
    assert columns([("a",)] * 14, shorten=False) == "\n".join("a" * 14)


def test_tables_for_notebooks_have_titles_end_and_escape():
    rows = [("a", "b<c"), *[("1", "2")] * 14]
    told = page("head & all", rows, "tail")
    assert told.startswith("<p>head &amp; all</p><table><tr><th>a</th><th>b&lt;c</th></tr>")
    assert told.count("<tr><td>1</td><td>2</td></tr>") == 12
    assert told.endswith("</table>and 2 more<p>tail</p>")
    assert page("", rows[:2]) == (
        "<table><tr><th>a</th><th>b&lt;c</th></tr><tr><td>1</td><td>2</td></tr></table>"
    )


def test_results_are_tables_in_notebooks():
    system = CartesianPendulum()
    x = Terminal(custom(lambda t, q, v, lam, b: q[:, 0], "x"))
    found = gradient(system, x, 0.5, HHT(0.25), method=DirectDifferentiation())
    run = found.solution
    for told, words in (
        (found._repr_html_(), ("objective", "<td>L</td>", "the end time was reached")),
        (run.sensitivities._repr_html_(), ("<th>largest |q_b|</th>", "<td>9.81</td>")),
        (run._repr_html_(), ("<td>instants</td><td>3</td>", "<th>largest |q_b|</th>")),
        (sweep(system, [{"L": 1.0}], type)._repr_html_(), ("<td>L = 1.0</td>",)),
    ):
        assert all(word in told for word in words), told
