"""HHT-I3 with error control: tolerance, frozen steps, both adjoints, outcomes, other units."""

import pickle

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    AdaptiveSteps,
    Adjoint,
    AtTimes,
    Beam,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    FiniteDifference,
    FixedSteps,
    Integral,
    Material,
    Pin,
    PrescribedSteps,
    Scene,
    Terminal,
    assemble,
    differentiate,
    gradient,
    load_solution,
    simulate,
    taylor_test,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import MaterialPoint
from ancfdae.observables import custom
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum, NeverRight
from validation.external.slider_crank import SliderCrank
from validation.scenes import pendulum

SCENES = {
    "Cartesian pendulum": (lambda: CartesianPendulum(), 2.0),
    "slider-crank": (SliderCrank, 10.0),
    "soft pendulum": (lambda: assemble(pendulum(), ["pendulum.height"]), 0.5),
}
X = custom(lambda t, q, v, lam, b: q[:, 0], "x")
OBJECTIVES = {
    "integral": Integral(custom(lambda t, q, v, lam, b: q[:, 0] ** 2 + v[:, 1] ** 2, "qv")),
    "reaction": Integral(custom(lambda t, q, v, lam, b: lam[:, 0] ** 2, "lam")),
    "terminal": Terminal(X),
    "at times": AtTimes(X, [0.21, 0.77]),
}


@pytest.mark.parametrize("name", SCENES)
def test_error_of_the_run_follows_the_tolerance(name):
    build, t_end = SCENES[name]
    system = build()
    exact = simulate(system, t_end, DOP853(1e-9))
    size = np.max(np.abs(exact.q))
    errors = []
    for rtol in (1e-2, 1e-3, 1e-4):
        run = simulate(system, t_end, HHT(rtol=rtol))
        assert run.outcome.success
        assert run.t[-1] == t_end
        errors.append(np.max(np.abs(run.at(exact.t[:-1]).q - exact.q[:-1])) / size)
        # The claim: never wrong by more than ten times the tolerance.
        assert errors[-1] < 10 * rtol, rtol
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_multipliers_and_accelerations_keep_their_order():
    # Steps that jump would leave transients of first order in them; of those that the first steps
    # leave, before the filter settles, some 0.2 are missing to order two.
    system, t_end = SliderCrank(), 10.0
    exact = simulate(system, t_end, DOP853(1e-10))
    errors, counts = [], []
    for rtol in (1e-3, 1e-4, 1e-5):
        run = simulate(system, t_end, HHT(rtol=rtol))
        lam = run.at(exact.t[:-1]).lam
        errors.append(np.sqrt(np.mean((lam - exact.lam[:-1]) ** 2)))
        counts.append(run.statistics.steps)
    orders = -np.diff(np.log(errors)) / np.diff(np.log(counts))
    assert np.all(orders > 1.7), orders


@pytest.mark.parametrize("name", OBJECTIVES)
def test_gradients_are_those_of_the_frozen_steps(name):
    integrator, objective = HHT(rtol=1e-3, newton_tolerance=1e-14), OBJECTIVES[name]
    direct, adjoint, check = (
        gradient(CartesianPendulum(0.7, 1.0), objective, 1.0, integrator, method=method)
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    )
    assert len(np.unique(np.round(np.diff(direct.solution.t), 12))) > 15
    size = np.linalg.norm(direct.gradient)
    assert np.linalg.norm(adjoint.gradient - direct.gradient) < 1e-12 * size
    assert np.linalg.norm(check.gradient - direct.gradient) < 1e-11 * size
    assert direct.value == adjoint.value == check.value


def test_gradients_of_a_scene_at_frozen_steps():
    system = assemble(pendulum(), ["pendulum.height", "pendulum.youngs_modulus"])
    integrator = HHT(rtol=1e-2, newton_tolerance=1e-14)
    run = differentiate(system, 0.25, integrator)
    check = differentiate(system, 0.25, integrator, method=ComplexStep())
    for name in ("q_b", "v_b", "a_b", "lam_b"):
        ours, theirs = getattr(run.sensitivities, name), getattr(check.sensitivities, name)
        assert np.max(np.abs(ours - theirs)) < 1e-9 * np.max(np.abs(theirs)), name


def test_continuous_adjoint_approaches_the_discrete_one():
    errors = []
    for rtol in (1e-3, 1e-4):
        integrator = HHT(rtol=rtol)
        found, exact = (
            gradient(CartesianPendulum(), OBJECTIVES["reaction"], 1.0, integrator, method=method)
            for method in (ContinuousAdjoint(), Adjoint())
        )
        size = np.linalg.norm(exact.gradient)
        errors.append(np.linalg.norm(found.gradient - exact.gradient) / size)
    # A tenth of the tolerance is a third of the step: a factor of 10 at second order.
    assert errors[1] < 0.2 * errors[0], errors
    assert errors[1] < 1e-3


def test_finite_differences_and_taylor_test_freeze_the_steps():
    integrator = HHT(rtol=1e-3)
    exact = differentiate(CartesianPendulum(), 1.0, integrator)
    near = differentiate(
        CartesianPendulum(), 1.0, integrator, method=FiniteDifference(1e-5, central=True)
    )
    size = np.max(np.abs(exact.sensitivities.q_b))
    assert np.max(np.abs(near.sensitivities.q_b - exact.sensitivities.q_b)) < 1e-6 * size
    test = taylor_test(
        CartesianPendulum(), OBJECTIVES["integral"], 1.0, integrator, direction=(1.0, 0.3)
    )
    assert test.order > 1.9


def test_frozen_steps_repeat_the_run():
    integrator = HHT(rtol=1e-3)
    run = simulate(CartesianPendulum(), 1.0, integrator)
    again = simulate(CartesianPendulum(), 1.0, integrator.frozen(run))
    np.testing.assert_array_equal(again.t, run.t)
    np.testing.assert_allclose(again.q, run.q, rtol=0, atol=1e-9)
    fixed = HHT(0.01)
    assert fixed.frozen(run) is fixed


def test_halved_steps_are_solved_four_times_as_exactly():
    """Newton's tolerance is a share of the error of a step, which falls with its square."""
    integrator = HHT(rtol=1e-4)
    found = simulate(CartesianPendulum(), 0.25, integrator)
    assert integrator.refined(found).newton_tolerance == integrator.newton_tolerance / 4
    fixed = HHT(2.0**-6, newton_tolerance=1e-10)
    assert fixed.refined(simulate(CartesianPendulum(), 0.25, fixed)).newton_tolerance == 1e-10


def test_uniform_instants_are_a_fixed_step():
    fixed = differentiate(CartesianPendulum(), 1.0, HHT(2.0**-6))
    times = tuple(np.arange(65) / 64)
    given = differentiate(CartesianPendulum(), 1.0, HHT(PrescribedSteps(times)))
    for name in ("t", "q", "v", "a", "lam"):
        np.testing.assert_array_equal(getattr(given, name), getattr(fixed, name))
    np.testing.assert_array_equal(given.sensitivities.lam_b, fixed.sensitivities.lam_b)


@pytest.mark.parametrize("units", [(1e3, 1e-3, 1.0), (1e-6, 1.0, 1e-3), (1e6, 1.0, 1e3)])
def test_same_steps_and_digits_in_other_units(units):
    time = units[2]
    base, other = (
        simulate(pendulum_in(*x), 0.25 * x[2], HHT(rtol=1e-2)) for x in ((1.0, 1.0, 1.0), units)
    )
    assert other.statistics.steps == base.statistics.steps
    assert other.statistics.rejected == base.statistics.rejected
    np.testing.assert_allclose(other.t / time, base.t, rtol=1e-9, atol=0)
    ours, theirs = (run.position(MaterialPoint("beam", 1.0)) for run in (other, base))
    np.testing.assert_allclose(ours / units[0], theirs, rtol=0, atol=1e-9)


def pendulum_in(length, mass, time):
    """The paper's pendulum in units smaller by the given factors."""
    beam = Beam(
        "beam",
        (0, 0),
        (1.2 * length, 0),
        4,
        Rectangle(0.05 * length, 0.04 * length),
        Material(4000 * mass / length**3, 1e7 * mass / (length * time**2), 0.3),
    )
    return Scene([beam], [Pin(beam.at_start)], (0, -9.81 * length / time**2))


def test_output_at_asked_times():
    run = differentiate(CartesianPendulum(), 2.0, HHT(rtol=1e-4))
    times = np.linspace(0, 2, 41)
    sampled = run.at(times)
    exact = differentiate(CartesianPendulum(), 2.0, DOP853(1e-9)).at(times)
    np.testing.assert_array_equal(sampled.t, times)
    for name in ("q", "v", "a", "lam"):
        ours, theirs = getattr(sampled, name), getattr(exact, name)
        assert np.max(np.abs(ours - theirs)) < 2e-3 * np.max(np.abs(theirs)), name
    ours, theirs = sampled.sensitivities.lam_b, exact.sensitivities.lam_b
    assert np.max(np.abs(ours - theirs)) < 5e-3 * np.max(np.abs(theirs))
    # Instants are returned as they are.
    np.testing.assert_allclose(run.at(run.t[3:5]).q, run.q[3:5], rtol=1e-13)
    for wrong in ([0.5, 0.4], [2.1], [], [np.nan]):
        with pytest.raises(InvalidInputError, match="times"):
            run.at(wrong)


def test_files_keep_controlled_runs(tmp_path):
    run = simulate(CartesianPendulum(), 0.5, HHT(rtol=1e-3))
    again = load_solution(run.save(tmp_path / "run.npz"))
    assert again.statistics == run.statistics
    assert run.statistics.rejected >= 0


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: HHT(), "exactly one of steps, step and rtol; got 0"),
        (lambda: HHT(0.1, rtol=1e-3), "exactly one"),
        (lambda: HHT(step=0.1, steps=FixedSteps(0.1)), "exactly one"),
        (lambda: HHT(rtol=0.0), r"HHT\.rtol"),
        (lambda: HHT(rtol=0.5), r"HHT\.rtol"),
        (lambda: HHT(rtol=float("nan")), r"HHT\.rtol"),
        (lambda: HHT([0.0, 0.1]), r"HHT\.step"),
        (lambda: FixedSteps(-0.1), r"FixedSteps\.step: must be positive"),
        (lambda: AdaptiveSteps(0.5), r"AdaptiveSteps\.rtol"),
        (lambda: AdaptiveSteps(1e-3, atol=-1.0), r"AdaptiveSteps\.atol"),
        (lambda: AdaptiveSteps(1e-3, max_steps=0), r"AdaptiveSteps\.max_steps"),
        (
            lambda: PrescribedSteps((0.0,)),
            r"PrescribedSteps\.times: must be two or more.*got 1 instant",
        ),
        (lambda: PrescribedSteps(((0.0, 0.1),)), r"got an array of shape \(1, 2\)"),
        (lambda: PrescribedSteps(0.1), r"got an array of shape \(\)"),
        (
            lambda: PrescribedSteps((0.0, 0.2, 0.1)),
            r"times\[2\] = 0.1 after times\[1\] = 0.2\. Sort",
        ),
        (lambda: PrescribedSteps((0.0, 0.1, 0.1)), "must increase"),
        (lambda: PrescribedSteps((0.1, 0.2)), "must begin at 0, as every run does; got 0.1"),
        (lambda: PrescribedSteps((0.0, float("nan"))), "finite numbers; got NaN"),
        (
            lambda: PrescribedSteps((0.0, "1")),
            r"PrescribedSteps\.times: must be an array of finite numbers",
        ),
    ],
)
def test_settings_out_of_range_are_refused_by_name(make, match):
    with pytest.raises(InvalidInputError, match=match):
        make()


def test_an_end_that_is_no_given_instant_is_refused_with_both():
    match = (
        r"PrescribedSteps\.times\[-1\] = 1; got 2\.0\. Run to t_end = 1, or give instants up to 2"
    )
    with pytest.raises(InvalidInputError, match=match):
        simulate(CartesianPendulum(), 2.0, HHT(PrescribedSteps((0.0, 0.5, 1.0))))


SPELLINGS = [
    (HHT(0.01), HHT(step=0.01)),
    (HHT(0.01), HHT(FixedSteps(np.float64(0.01)))),
    (HHT(rtol=1e-5), HHT(steps=AdaptiveSteps(1e-5))),
    (
        HHT(AdaptiveSteps(1e-5, 1e-3, 10, True), -0.1),
        HHT(steps=AdaptiveSteps(1e-5, atol=1e-3, max_steps=10, sensitivities=True), hht_alpha=-0.1),
    ),
    (HHT(PrescribedSteps([0, 1, 2])), HHT(steps=PrescribedSteps(times=(0.0, 1.0, 2.0)))),
]


@pytest.mark.parametrize(("short", "full"), SPELLINGS)
def test_short_and_full_form_are_the_same(short, full):
    assert short == full
    assert hash(short) == hash(full)
    # What is printed can be typed back.
    names = {x.__name__: x for x in (HHT, FixedSteps, AdaptiveSteps, PrescribedSteps)}
    for same in (eval(repr(short), names), pickle.loads(pickle.dumps(short))):
        assert same == short
        assert same.newton_tolerance == short.newton_tolerance
    assert len({HHT(0.01), HHT(0.02), *(x for x, _ in SPELLINGS)}) == 5


def test_many_instants_print_in_short():
    shown = repr(PrescribedSteps(np.arange(1000.0)))
    assert shown == "PrescribedSteps(times=(0.0, 1.0, 2.0, ..., 999.0))"


class Exploding(CartesianPendulum):
    """A pendulum whose force is NaN after t = 0.3 s."""

    def force(self, t, q, v):
        return super().force(t, q, v) * (np.nan if t > 0.3 else 1.0)


class Kicked(CartesianPendulum):
    """A force of a random size at every call: no step is good enough."""

    def __init__(self):
        super().__init__()
        self.rng = np.random.default_rng(0)

    def force(self, t, q, v):
        return super().force(t, q, v) + (1e6 * self.rng.standard_normal(2) if t > 0.3 else 0.0)


@pytest.mark.parametrize("kind", [Exploding, Kicked])
def test_trouble_on_the_way_is_an_outcome(kind):
    run = simulate(kind(), 1.0, HHT(AdaptiveSteps(1e-3, max_steps=2000)))
    assert not run.outcome.success
    assert 0.2 < run.t[-1] <= 0.35
    assert run.outcome.time == run.t[-1]
    assert np.all(np.isfinite(run.q))


@pytest.mark.parametrize("integrator", [HHT(0.01), HHT(rtol=1e-3)])
def test_a_run_that_ends_in_its_first_step_has_the_derivatives_of_its_start(integrator):
    run = differentiate(NeverRight(), 1.0, integrator)
    assert not run.outcome.success
    assert len(run.t) == 1
    exact = differentiate(CartesianPendulum(), 1.0, HHT(0.01)).sensitivities
    for name in ("q_b", "v_b", "a_b", "lam_b"):
        ours = getattr(run.sensitivities, name)
        np.testing.assert_allclose(ours, getattr(exact, name)[:1], atol=1e-12)


def test_the_limit_of_steps_is_an_outcome():
    run = simulate(CartesianPendulum(), 2.0, HHT(AdaptiveSteps(1e-6, max_steps=50)))
    assert run.outcome.verdict is Verdict.STEP_LIMIT
    assert len(run.t) <= 51
