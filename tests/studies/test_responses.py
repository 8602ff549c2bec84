"""`Responses`: one run a design, for SciPy, OpenMDAO and JAX, also where runs end early."""

import importlib
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import check_grad, least_squares, minimize

from ancfdae import (
    DOP853,
    HHT,
    DesignVariable,
    DirectDifferentiation,
    MotorTorque,
    Responses,
    RigidBody,
    Scene,
    Terminal,
    distributed_variables,
    gradients,
)
from ancfdae.errors import (
    FailedDesignWarning,
    InvalidInputError,
    NonFiniteObjectiveError,
    UnfinishedRunError,
    UnknownNameError,
)
from ancfdae.laws import BSpline
from ancfdae.observables import custom, elapsed_time, mass, position
from ancfdae.sensitivity.method import GradientMethod
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

X = Terminal(custom(lambda t, q, v, lam, b: q[:, 0], "x"))
Y = Terminal(custom(lambda t, q, v, lam, b: q[:, 1], "y"))
MISS = (X - 1.2) ** 2 + 0.01 * Y**2
STEPS = HHT(2.0**-4)


class Short(CartesianPendulum):
    """A pendulum whose runs end early where it is longer than the limit."""

    limit = 1.26

    def with_values(self, b):
        return Short(self.angle, self.spin, b)

    def force(self, t, q, v):
        force = super().force(t, q, v)
        return force * np.nan if abs(self.b[0]) > self.limit and t > 0.1 else force


SYSTEM = Short(-1.0, 2.0)


def responses(**settings):
    settings = {"scale": SYSTEM.b, "method": DirectDifferentiation()} | settings
    return Responses(SYSTEM, {"miss": MISS, "y": Y}, 1.0, STEPS, **settings)


def test_values_and_derivatives_are_those_of_gradients_in_scaled_variables():
    r = responses()
    x = np.array([0.9, 1.1])
    found = gradients(
        SYSTEM.with_values(x * SYSTEM.b), [MISS, Y], 1.0, STEPS, method=DirectDifferentiation()
    )
    np.testing.assert_array_equal(r.values(x), [each.value for each in found])
    assert r["y"](x) == found[1].value
    np.testing.assert_array_equal(r["y"].gradient(x), SYSTEM.b * found[1].gradient)
    np.testing.assert_array_equal(r.start, [1.0, 1.0])
    # Forward differences with steps of 1.5e-8 err by that times the curvature, about one here.
    assert check_grad(r["miss"], r["miss"].gradient, x) < 1e-6


def test_whatever_is_asked_for_a_design_runs_once():
    r = responses()
    for x in ([1.0, 1.0], [0.9, 1.0], [1.0, 1.0]):
        r["miss"](x), r["y"].gradient(x), r.values(x), r.jacobian(x), r.solution(x)
        r.constraint("y", upper=0.0).fun(x)
    assert [row.result["y"] for row in r.history.rows] == [r["y"](x) for x in ([1, 1], [0.9, 1])]
    assert "2 designs run" in repr(r)


class Counted(GradientMethod):
    """Direct differentiation that counts the runs it makes, and the finished ones it is given."""

    def __init__(self, broken=None):
        self.anew, self.given, self.broken = 0, 0, broken

    def gradients(self, run, objectives):
        if self.broken is not None and run.system.b[0] == self.broken:
            raise NonFiniteObjectiveError("Integral", "x", 0.5)
        self.given += run.after is not None
        self.anew += run.after is None
        return DirectDifferentiation().gradients(run, objectives)


@pytest.mark.parametrize("method", ["Nelder-Mead", "COBYQA"])
def test_a_search_without_derivatives_runs_every_design_once_and_differentiates_none(
    method, monkeypatch
):
    designs, counted = [], Counted()
    at = Short.with_values
    monkeypatch.setattr(Short, "limit", np.inf)
    monkeypatch.setattr(Short, "with_values", lambda self, b: designs.append(b) or at(self, b))
    r = responses(method=counted)
    bounded = {"constraints": r.constraint("y", upper=0.0)} if method == "COBYQA" else {}
    minimize(r["miss"], 0.9 * r.start, method=method, options={"maxiter": 12}, **bounded)
    assert (counted.anew, counted.given) == (0, 0)
    assert len(designs) == len(r.history.rows) > 9  # More than runs are kept
    # Of old runs the values are kept alone.
    early = r.history.rows[0]
    assert r["y"](0.9 * r.start) == early.result["y"]
    assert r.solution(0.9 * r.start).outcome.success
    assert len(designs) == len(r.history.rows) + 1


def test_a_gradient_takes_the_run_that_is_there_or_one_for_both():
    counted = Counted()
    r = responses(method=counted)
    for x in ([1.0, 1.0], [0.9, 1.0]):
        r["miss"](x), r["y"].gradient(x), r["y"](x), r.jacobian(x)
    assert (counted.anew, counted.given) == (0, 2)
    counted = Counted()
    r = Responses(SYSTEM, {"y": Y}, 1.0, DOP853(1e-6), method=counted)
    r["y"](r.start)
    assert counted.anew == 0
    # DOP853 integrates derivatives with the motion: after the first question they come along.
    r.jacobian(r.start), r["y"](0.9 * r.start), r.jacobian(0.9 * r.start)
    assert (counted.anew, counted.given) == (2, 0)


def test_a_value_without_gradient_is_no_design():
    x = 0.9 * np.ones(2)
    r = responses(method=Counted(broken=0.9 * SYSTEM.b[0]))
    start, value = r["y"](r.start), r["y"](x)
    with pytest.warns(FailedDesignWarning, match="not finite"):
        slope = r["y"].gradient(x)
    assert r["y"](x) > start != value
    assert slope @ (x - r.start) > 0
    alone = responses(method=Counted(broken=SYSTEM.b[0]))
    with pytest.raises(NonFiniteObjectiveError):
        alone["y"].gradient(alone.start)


@pytest.mark.parametrize("method", ["SLSQP", "trust-constr", "L-BFGS-B", "BFGS"])
def test_optimisers_step_back_from_designs_without_values(method):
    r = responses()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = minimize(r["miss"], r.start, jac=r["miss"].gradient, method=method)
    failed = [each for each in told if each.category is FailedDesignWarning]
    assert len(failed) == len(r.history.failed) > 0
    assert r.solution(found.x).outcome.success
    # It is an optimum: SciPy's tests of convergence leave 1e-3 of the gradient at most.
    slope = [np.linalg.norm(r["miss"].gradient(x)) for x in (found.x, r.start)]
    assert slope[0] < 1e-2 * slope[1]


def test_a_constraint_holds_at_the_optimum():
    system = CartesianPendulum(-1.0, 2.0)
    r = Responses(system, {"x": X, "y": Y}, 0.5, STEPS, scale=system.b)
    upper = float(r["y"](r.start)) + 0.1
    found = minimize(
        r["x"],
        r.start,
        jac=r["x"].gradient,
        method="SLSQP",
        bounds=[(0.5, 2.0)] * 2,
        constraints=r.constraint("y", upper=upper),
    )
    assert found.success
    assert r["y"](found.x) == pytest.approx(upper, abs=1e-5)  # Its tolerance is 1e-6.


def test_least_squares_steps_back_too(monkeypatch):
    monkeypatch.setattr(Short, "limit", 1.1)
    r = Responses(SYSTEM, {"x": X - 1.2, "y": 0.1 * Y}, 1.0, STEPS, scale=SYSTEM.b)
    with pytest.warns(
        FailedDesignWarning, match="has no values: no gradient: the residual is not finite"
    ):
        found = least_squares(r.values, [0.7, 1.0], r.jacobian, max_nfev=12)
    # The best fit is longer than the longest pendulum that runs.
    assert 1.0 < found.x[0] <= 1.1
    assert r.solution(found.x).outcome.success


def test_a_design_without_values_is_an_error_where_nothing_else_can_be_said():
    bad = [1.5, 1.0]
    with pytest.raises(UnfinishedRunError):
        responses()["miss"](bad)
    strict = responses(strict=True)
    strict["miss"](strict.start)
    with pytest.raises(UnfinishedRunError):
        strict["miss"](bad)
    r = responses()
    good = r["y"](r.start)
    with pytest.warns(FailedDesignWarning):
        assert np.all(np.isinf(r.values(bad)))
    assert np.all(np.isnan(r.jacobian(bad)))
    # The parabola along d through y_0 that falls by r at first: y_0 - r s + 2 r s^2, s = 1 at bad.
    d, rise = bad - r.start, r["y"](bad) - good
    assert rise == pytest.approx(np.linalg.norm(r["y"].gradient(r.start)) * np.linalg.norm(d))
    assert r["y"].gradient(bad) == pytest.approx(3 * rise * d / (d @ d))
    # A constraint turns to what it forbids.
    assert r.constraint("y", upper=0.0).fun(bad) > good > r.constraint("y", lower=0.0).fun(bad)
    with pytest.raises(UnfinishedRunError):
        r.solution(bad)


def test_bounds_come_from_the_design_variables():
    design = [DesignVariable("h", {"pendulum.height": 1.0}, bounds=(0.02, 0.08)), "pendulum.width"]
    r = Responses(
        pendulum(elements=1), {"m": Terminal(mass())}, 0.25, STEPS, design=design, scale=2
    )
    np.testing.assert_array_equal(r.bounds.lb, [0.01, -np.inf])
    np.testing.assert_array_equal(r.bounds.ub, [0.04, np.inf])


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: responses(scale=0.0), "scale: must be positive"),
        (lambda: responses(scale=[1.0]), "one for each of 2"),
        (lambda: responses(strict=3), "strict: must be True or False"),
        (lambda: Responses(SYSTEM, {}, 1.0, STEPS), "functions: must not be empty"),
        (lambda: Responses(SYSTEM, [X], 1.0, STEPS), "functions: must be of type Mapping"),
        (lambda: Responses(SYSTEM, {1: X}, 1.0, STEPS), "functions: must be of type str"),
        (lambda: Responses(SYSTEM, {"x": position}, 1.0, STEPS), "objective: must be of type"),
        (lambda: responses().constraint("y"), "lower and upper must bound it"),
        (lambda: responses().values([1.0]), r"design values: must be an array .* of shape \(2,\)"),
    ],
)
def test_nonsense_is_refused(call, match):
    with pytest.raises(InvalidInputError, match=match):
        call()
    with pytest.raises(UnknownNameError):
        responses()["z"]


def test_openmdao_finds_its_partials_right():
    om = pytest.importorskip("openmdao.api", reason="needs openmdao: pip install ancfdae[openmdao]")
    from openmdao.utils.assert_utils import assert_check_partials

    from ancfdae.studies.openmdao import ResponsesComponent

    problem = om.Problem(reports=False)
    problem.model.add_subsystem("rod", ResponsesComponent(responses=responses()), promotes=["*"])
    problem.setup()
    problem.run_model()
    assert problem.get_val("y") == pytest.approx(SYSTEM_Y)
    told = problem.check_partials(out_stream=None, method="fd", form="central", step=1e-5)
    # Central differences err by a third derivative, of size ten at most, times step^2/6, and by
    # round-off of the run, 1e-13, over the step.
    assert_check_partials(told, atol=1e-7, rtol=1e-6)
    problem.set_val("x", [1.5, 1.0])
    with pytest.warns(FailedDesignWarning), pytest.raises(om.AnalysisError, match="not finite"):
        problem.run_model()


SYSTEM_Y = gradients(SYSTEM, [Y], 1.0, STEPS, method=DirectDifferentiation())[0].value


def test_openmdao_that_is_missing_is_named(monkeypatch):
    import sys

    from ancfdae.errors import MissingPackageError

    monkeypatch.setitem(sys.modules, "openmdao", None)
    monkeypatch.setitem(sys.modules, "openmdao.api", None)
    monkeypatch.delitem(sys.modules, "ancfdae.studies.openmdao", raising=False)
    with pytest.raises(MissingPackageError, match=r"pip install \"ancfdae\[openmdao\]\""):
        importlib.import_module("ancfdae.studies.openmdao")


def test_the_wrapper_for_jax_in_the_documents_has_the_gradient_of_the_run():
    pytest.importorskip("jax", reason="needs JAX: python3 -m pip install 'ancfdae[jax]'")
    text = (Path(__file__).parents[2] / "docs" / "other-tools.md").read_text(encoding="utf-8")
    code = text.split("<!-- test: jax -->")[1].split("\n\nValues")[0]
    names = {"design": responses()}
    exec(compile(textwrap.dedent(code), "docs/other-tools.md", "exec"), names)
    r, x = responses(), np.ones(2)
    weights = np.array([1.0, 2 * r["y"](x)])
    # In double precision, whose round-off alone differs.
    np.testing.assert_allclose(names["slope"], 0.1 * weights @ r.jacobian(x), rtol=1e-13)
    assert float(names["value"]) == pytest.approx(r["miss"](x) + r["y"](x) ** 2, rel=1e-13)


def test_distributed_variables_carry_their_bounds_to_an_optimiser_beside_a_free_end_time():
    """Bounds are those of the scaled variables; the end time is positive."""
    ball = RigidBody("ball", (0, 0), mass=1.0, inertia=0.1)
    spin = MotorTorque(ball.origin, 1.0, law=BSpline(0.0, 1.0, [0.0, 1.0]), name="spin")
    scene = Scene(bodies=[ball], loads=[spin])
    design = [*distributed_variables("spin.value", 2, (-4.0, 6.0)), "t_end"]
    functions = {"time": Terminal(elapsed_time())}
    bounds = Responses(scene, functions, 0.5, HHT(0.1), design=design, scale=[2.0, 2.0, 1.0]).bounds
    assert bounds.lb.tolist() == [-2.0, -2.0, 0.0]
    assert bounds.ub.tolist() == [3.0, 3.0, np.inf]
