"""IDA, IDAS and the explicit path behind the contract that HHT-I3 has."""

import importlib.util
import warnings
from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    PID,
    Adjoint,
    AtTimes,
    Beam,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    FiniteDifference,
    FirstOrderLag,
    IndexReduction,
    Integral,
    Material,
    Pin,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    differentiate,
    gradient,
    load_solution,
    simulate,
)
from ancfdae.errors import (
    Interrupted,
    InvalidInputError,
    ManyStepsWarning,
    MissingPackageError,
    UnlikelyValueWarning,
)
from ancfdae.integrators.step_control.steps import Pace
from ancfdae.laws import Constant
from ancfdae.numerics.time_grid import TimeGrid
from ancfdae.observables import custom
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum

IDAS_MARK = pytest.mark.idas
INTEGRATORS = [
    pytest.param(IDA(1e-9, intervals=8), id="IDA"),
    pytest.param(IDA(1e-9, form=IndexReduction.INDEX_1, intervals=8), id="IDA index 1"),
    pytest.param(IDAS(1e-9, intervals=8), id="IDAS", marks=IDAS_MARK),
    pytest.param(
        IDAS(1e-9, form=IndexReduction.INDEX_1, intervals=8), id="IDAS index 1", marks=IDAS_MARK
    ),
    pytest.param(DOP853(1e-9, intervals=8), id="DOP853"),
]
OBJECTIVES = {
    "q": lambda t, q, v, lam, b: q[:, 0] ** 2,
    "v": lambda t, q, v, lam, b: v[:, 1] ** 2 * q[:, 0],
    "lam": lambda t, q, v, lam, b: lam[:, 0] ** 2 / b[1],
}


class Disturbed(CartesianPendulum):
    """The pendulum with another force; derivatives of it are left out."""

    def __init__(self, disturb):
        super().__init__(0.5, 1.0)
        self.disturb = disturb

    def with_values(self, b):
        return self

    def force(self, t, q, v):
        return super().force(t, q, v) + self.disturb(q, v, t)


def test_panels_integrate_to_degree_15_and_interpolate_to_degree_8():
    grid = TimeGrid.lobatto(2.0, 3)
    for k in (0, 7, 15):
        assert grid.weights() @ grid.t**k == pytest.approx(2.0 ** (k + 1) / (k + 1), rel=1e-13)
    which, share = grid.interpolation(1.234)
    assert share @ grid.t[which] ** 8 == pytest.approx(1.234**8, rel=1e-12)
    assert abs(share @ grid.t[which] ** 12 - 1.234**12) > 1e-9
    early = TimeGrid(grid.t[:12], 8)
    assert early.weights() @ np.ones(12) == pytest.approx(grid.t[11], rel=1e-14)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_states_multipliers_and_derivatives_agree(integrator):
    ours = differentiate(CartesianPendulum(0.5, 2.0), 1.0, integrator)
    other = differentiate(CartesianPendulum(0.5, 2.0), 1.0, DOP853(1e-12, intervals=8))
    assert ours.outcome.success
    assert ours.degree == 8
    assert ours.statistics.steps > 10
    assert ours.statistics.residuals > 10
    for name in ("q", "v", "a", "lam"):
        value, reference = getattr(ours, name), getattr(other, name)
        assert np.max(np.abs(value - reference)) < 1e-6 * np.max(np.abs(reference)), name
        value = getattr(ours.sensitivities, f"{name}_b")
        reference = getattr(other.sensitivities, f"{name}_b")
        assert np.max(np.abs(value - reference)) < 1e-5 * np.max(np.abs(reference)), name


@pytest.mark.parametrize("kind", OBJECTIVES)
@pytest.mark.parametrize("reduce", [Integral, Terminal, lambda x: AtTimes(x, [0.3, 0.7])])
@pytest.mark.idas
def test_adjoint_of_idas_is_direct_differentiation(kind, reduce):
    objective = reduce(custom(OBJECTIVES[kind], kind))
    system = CartesianPendulum(0.5, 2.0)
    exact = gradient(system, objective, 1.0, DOP853(1e-12)).gradient
    for method in (Adjoint(), DirectDifferentiation()):
        found = gradient(system, objective, 1.0, IDAS(1e-10), method=method).gradient
        assert np.max(np.abs(found - exact)) < 1e-6 * np.max(np.abs(exact)), method


def test_hht_converges_to_the_index_reduced_path():
    objective = Integral(custom(OBJECTIVES["lam"], "lam"))
    system = CartesianPendulum(0.5, 2.0)
    exact = gradient(system, objective, 1.0, IDA(1e-11)).gradient
    errors = [
        np.linalg.norm(gradient(system, objective, 1.0, HHT(h)).gradient - exact)
        for h in (2.0**-7, 2.0**-8)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_differences_of_runs_agree_with_appended_sensitivities():
    objective, system = Integral(custom(OBJECTIVES["v"], "v")), CartesianPendulum(0.5, 2.0)
    exact = gradient(system, objective, 1.0, DOP853(1e-12)).gradient
    method = FiniteDifference(1e-4, central=True)
    found = gradient(system, objective, 1.0, DOP853(1e-12), method=method).gradient
    assert np.max(np.abs(found - exact)) < 1e-6 * np.max(np.abs(exact))


def test_continuous_adjoint_takes_the_instants_of_any_integrator():
    objective, system = Integral(custom(OBJECTIVES["v"], "v")), CartesianPendulum(0.5, 2.0)
    exact = gradient(system, objective, 1.0, DOP853(1e-12)).gradient
    for kind in (IDA, DOP853):
        errors = []
        for n in (50, 200):
            integrator = kind(1e-9, intervals=n)
            found = gradient(system, objective, 1.0, integrator, method=ContinuousAdjoint())
            errors.append(np.max(np.abs(found.gradient - exact)) / np.max(np.abs(exact)))
        # First order at least where instants are not evenly spaced: 4 times as many, with a margin.
        assert errors[1] < errors[0] / 3 < 1e-4
    steps = [
        gradient(system, objective, 1.0, Radau(h), method=ContinuousAdjoint()).gradient
        for h in (2.0**-5, 2.0**-7)
    ]
    errors = [np.max(np.abs(x - exact)) / np.max(np.abs(exact)) for x in steps]
    assert errors[1] < errors[0] / 3 < 1e-2


def test_refusals():
    objective, system = Integral(custom(OBJECTIVES["q"], "q")), CartesianPendulum()
    for method in (Adjoint(), Adjoint("1 GB")):
        with pytest.raises(InvalidInputError, match="HHT"):
            gradient(system, objective, 1.0, IDA(), method=method)
    for integrator in (IDA(), IDAS(), DOP853()):
        with pytest.raises(InvalidInputError, match="complex numbers"):
            gradient(system, objective, 1.0, integrator, method=ComplexStep())
    for wrong in ({"rtol": 0.1}, {"rtol": 0.0}, {"intervals": 0}, {"max_steps": 0}):
        for kind in (IDA, IDAS, DOP853):
            with pytest.raises(InvalidInputError):
                kind(**wrong)
    with pytest.raises(InvalidInputError, match="t_end"):
        simulate(system, -1.0, IDA())


@pytest.mark.skipif(importlib.util.find_spec("sundials4py") is not None, reason="it is installed")
def test_the_missing_package_is_named():
    with pytest.raises(MissingPackageError, match="pip install sundials4py"):
        simulate(CartesianPendulum(), 1.0, IDAS())


def test_files_keep_the_degree(tmp_path):
    run = simulate(CartesianPendulum(), 0.5, DOP853(intervals=2))
    assert load_solution(run.save(tmp_path / "run.npz")).degree == 8


TROUBLE = {
    "not a number": lambda q, v, t: np.full(2, np.nan if t > 0.3 else 0.0),
    "infinite": lambda q, v, t: np.full(2, np.inf if t > 0.3 else 0.0),
    "blow-up": lambda q, v, t: 5.0 * v * (v @ v),
    "growing": lambda q, v, t: np.exp(200.0 * t) * np.ones(2),
}


@pytest.mark.parametrize("name", TROUBLE)
@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=IDAS_MARK), DOP853])
def test_trouble_on_the_way_is_an_outcome(name, kind):
    run = simulate(Disturbed(TROUBLE[name]), 4.0, kind(1e-6, intervals=16, max_steps=200))
    assert not run.outcome.success
    assert run.outcome.verdict in Verdict
    assert 0 < len(run.t) < 129
    for x in (run.q, run.v, run.a, run.lam):
        assert np.all(np.isfinite(x))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_jump_of_the_force_is_passed(integrator):
    def push(q, v, t):
        return np.full(2, 10.0 * (t > 0.3))

    ours = simulate(Disturbed(push), 1.0, integrator)
    other = simulate(Disturbed(push), 1.0, DOP853(1e-11, intervals=8))
    assert ours.outcome.success
    assert np.max(np.abs(ours.q - other.q)) < 1e-6


def test_a_first_step_that_overshoots_is_no_end_of_an_explicit_run():
    steel = Material(7800, 2e11, 0.3)
    rod = Beam("a", (0, 0), (1, 0), 2, Rectangle(0.02, 0.02), steel)
    scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81))
    run = simulate(scene, 0.5, DOP853(1e-6, max_steps=50))
    assert run.outcome.verdict is Verdict.STEP_LIMIT
    assert run.outcome.step == 50


STUCK = {
    "blow-up": TROUBLE["blow-up"],
    "pole": lambda q, v, t: np.ones(2) / (1 - t),
    "jump": lambda q, v, t: np.full(2, 1e30 * (t > 0.3)),
}


@pytest.mark.filterwarnings("ignore::ancfdae.errors.ManyStepsWarning")
@pytest.mark.parametrize("name", STUCK)
@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=IDAS_MARK), DOP853])
def test_steps_lost_in_round_off_end_a_run_long_before_the_limit(name, kind):
    run = simulate(Disturbed(STUCK[name]), 4.0, kind(1e-6, intervals=16))
    ends = (Verdict.ERROR_TEST, Verdict.NO_CONVERGENCE, Verdict.NOT_FINITE)
    assert run.outcome.verdict in ends
    assert run.statistics.steps < 5000


@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=IDAS_MARK), DOP853])
def test_max_steps_is_a_limit_of_the_whole_run(kind):
    run = simulate(CartesianPendulum(0.5, 2.0), 20.0, kind(1e-9, intervals=256, max_steps=120))
    assert run.outcome.verdict is Verdict.STEP_LIMIT
    assert run.outcome.step == 120
    assert len(run.t) > 2


def test_times_beyond_a_run_that_ended_early_are_refused_with_its_outcome():
    run = simulate(CartesianPendulum(0.5, 2.0), 20.0, DOP853(1e-9, max_steps=30))
    assert len(run.at([0.5 * run.t[-1]]).t) == 1
    with pytest.raises(
        InvalidInputError, match=r"ended early: the limit of steps \(max_steps\) was"
    ):
        run.at([0.5 * run.t[-1], 20.0])
    whole = simulate(CartesianPendulum(), 0.5, DOP853(1e-6))
    with pytest.raises(InvalidInputError, match=r"lie in \[0, 0.5\]; got"):
        whole.at([1.0])


@pytest.mark.parametrize(
    ("integrator", "needed"),
    # The crank-slider of the paper over 2 s by DOP853; its pendulum over 1 s, IDA(1e-10) with
    # three variables: 100,000 steps reach 0.964 s.
    [(DOP853(), 29_410), (IDA(), 103_800), (IDAS(), 103_800)],
)
def test_runs_of_the_paper_do_not_meet_the_default_limit_of_steps(integrator, needed):
    assert integrator.max_steps > 5 * needed


# Steps shrink before the run ends: it warns of their number, rightly.
@pytest.mark.filterwarnings("ignore::ancfdae.errors.ManyStepsWarning")
@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=IDAS_MARK), DOP853])
def test_trouble_prints_nothing_but_what_the_user_prints(kind, capfd):
    rng = np.random.default_rng(0)

    def noise(q, v, t):
        print("mine\n")  # noqa: T201
        return 1e3 * rng.standard_normal(2) * (t > 0.3)

    run = simulate(Disturbed(noise), 4.0, kind(1e-6, intervals=16, max_steps=200))
    assert not run.outcome.success
    written = capfd.readouterr()
    # SUNDIALS says of this run that the corrector failed repeatedly.
    assert set(written.out.split("\n")) == {"mine", ""}
    assert written.err == ""


@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=IDAS_MARK), DOP853])
def test_what_a_force_raises_comes_through(kind):
    def broken(q, v, t):
        if t > 0.3:
            raise ZeroDivisionError("mine")
        return np.zeros(2)

    with pytest.raises(ZeroDivisionError, match="mine"):
        simulate(Disturbed(broken), 1.0, kind(1e-6))


@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=IDAS_MARK), DOP853])
def test_interrupt_keeps_what_was_computed(kind):
    def stop(q, v, t):
        if t > 0.3:
            raise KeyboardInterrupt
        return np.zeros(2)

    with pytest.raises(Interrupted) as stopped:
        simulate(Disturbed(stop), 1.0, kind(1e-6))
    run = stopped.value.result
    assert run.outcome.verdict is Verdict.INTERRUPTED
    # A step may begin well before the force that its stages meet: those of DOP853 are 0.13 long.
    assert 0.15 < run.t[-1] <= 0.35


@pytest.mark.parametrize("kind", [IDA, pytest.param(IDAS, marks=IDAS_MARK)])
def test_two_hundred_random_bad_starts(kind):
    rng, verdicts = np.random.default_rng(4), set()
    for _ in range(200):
        system = Disturbed(lambda q, v, t: np.zeros(2))
        q, v = (rng.standard_normal(2) * 10 ** rng.uniform(-3, 6) for _ in range(2))
        if rng.random() < 0.2:
            q[rng.integers(2)] = rng.choice([np.nan, np.inf, 0.0])
        system.start = lambda q=q, v=v: (q, v)
        project = bool(rng.random() < 0.5)
        system.traits = replace(system.traits, project_start=project)
        try:
            run = simulate(system, 1.0, kind(1e-4, intervals=1, max_steps=30))
        except InvalidInputError as error:
            verdicts.add(type(error).__name__)
        else:
            verdicts.add(run.outcome.verdict)
            assert np.all(np.isfinite(run.q))
    assert len(verdicts) > 1


def test_a_controller_that_tears_at_its_section_is_told_the_steps_to_come():
    """The damping D/J = 1e7/s limits a step of DOP853 to 6.1 J/D (|R| = 1 on the real axis).

    Its angle meets pi and jumps to -pi, so that steps of 25 differ and only hundreds are alike.
    """
    disc = RigidBody("disc", (0, 0), mass=1.0, inertia=0.1)
    servo = PID(disc.origin, Constant(20.0), -3.8e9, 0.0, 1e6, name="servo")
    scene = Scene([], [Pin(disc.origin)], bodies=[disc], loads=[servo])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnlikelyValueWarning)
        warnings.simplefilter("error", ManyStepsWarning)
        with pytest.raises(ManyStepsWarning) as told:
            simulate(scene, 1.0, DOP853(1e-6, max_steps=4000))
    count = float(str(told.value).split()[1])
    assert 1e7 / 6.5 < count < 1e7 / 4


def test_steps_that_noise_disturbs_are_counted_over_many_hundreds():
    """Hundreds of steps of 1 ms and 0.3 ms in turn: the mean, 0.65 ms, predicts the rest."""
    pace, t = Pace(100.0, 100_000, "remedy.", 10**6), 0.0
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for k in range(2200):
            t += 1e-3 if k // 100 % 2 else 3e-4
            assert not pace.ends_run(t)
            assert (len(told) > 0) == (k >= 1999)
    assert f"about {(100.0 - 1.3) / 6.5e-4:.2g} steps are to come" in str(told[0].message)
    quiet = Pace(60.0, 100_000, "remedy.", 10**6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k in range(2200):
            assert not quiet.ends_run(6.5e-4 * (k + 1))


@pytest.mark.filterwarnings("ignore::ancfdae.errors.ManyStepsWarning")
@pytest.mark.parametrize(
    "integrator",
    [HHT(0.01), HHT(rtol=1e-4), Radau(0.01), Radau(rtol=1e-4), DOP853(1e-6), IDA(1e-6)],
    ids=repr,
)
def test_a_start_whose_derivatives_overflow_ends_the_run_in_words(integrator):
    """A lag of 1e-5 s with a command of 1e300 N: c/tau is a number, c/tau^2 is not."""
    body = RigidBody("body", (0, 0), mass=1.0, inertia=0.1)
    lag = FirstOrderLag(body.origin, Constant(1e300), 1e-5, direction=(1.0, 0.0), name="lag")
    run = simulate(Scene([], [], loads=[lag], bodies=[body]), 0.1, integrator)
    assert not run.outcome.success
