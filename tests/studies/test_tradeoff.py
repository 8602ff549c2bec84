"""`work_precision`: rows, Pareto front, recommendation, failures as rows, worker processes."""

import multiprocessing
import pickle
import signal
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    AdaptiveSteps,
    Adjoint,
    DirectDifferentiation,
    Integral,
    Pin,
    PrescribedSteps,
    RigidBody,
    Scene,
    assemble,
    gradient,
    simulate,
    work_precision,
)
from ancfdae.errors import Interrupted, InvalidInputError, TargetNotReachedError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.observables import angular_velocity, custom, kinetic_energy, position, strain_energy
from ancfdae.results import MeasuredSetting, WorkPrecision
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

TIP = MaterialPoint("pendulum", 1.0)
OBJECTIVE = Integral((position(TIP, 1) + 0.5) ** 2 + 1e-3 * strain_energy() + kinetic_energy())
SCENE = pendulum(elements=1, youngs_modulus=1e6)
DESIGN = ("pendulum.height", "pendulum.youngs_modulus")
T_END = 0.125
SETTINGS = [HHT(2.0**-8), HHT(2.0**-10), HHT(rtol=1e-2), HHT(rtol=1e-4), IDA(1e-7), DOP853(1e-6)]
FAILING = HHT(AdaptiveSteps(1e-7, max_steps=5))


def square(t, q, v, lam, b):
    return q[:, 0] ** 2 + v[:, 1]


X2 = Integral(custom(square))


@pytest.fixture(scope="module")
def measured():
    return work_precision(
        SCENE, OBJECTIVE, T_END, [*SETTINGS, FAILING], design=DESIGN, reference=DOP853(1e-9)
    )


def test_a_row_for_every_setting_in_order(measured):
    assert [row.integrator for row in measured.rows] == [*SETTINGS, FAILING]
    assert measured.reference.integrator == DOP853(1e-9)
    for row in measured.rows[:-1]:
        assert row.finished
        assert row.seconds > 0
        assert row.outcome.startswith("the end time was reached")
        assert 0 <= row.drift < 1e-8


def test_errors_are_those_against_the_reference(measured):
    fine, coarse = (
        gradient(SCENE, OBJECTIVE, T_END, i, design=DESIGN) for i in (DOP853(1e-9), SETTINGS[0])
    )
    b = np.array([0.05, 1e6])
    away = np.linalg.norm((coarse.gradient - fine.gradient) * b) / np.linalg.norm(fine.gradient * b)
    assert measured.rows[0].gradient == pytest.approx(away, rel=1e-6)
    value = abs(coarse.value - fine.value) / fine.value
    assert measured.rows[0].objective == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("of", ["states", "multipliers", "objective", "gradient"])
def test_errors_fall_with_step_and_tolerance(measured, of):
    errors = [row.error(of) for row in measured.rows]
    assert errors[0] > 4 * errors[1]
    assert errors[2] > 3 * errors[3]
    assert errors[1] > errors[4]
    assert measured.reference.error(of) == 0


def test_energy_is_compared_at_the_instants_of_the_run(measured):
    energies = [row.energy for row in measured.rows[:-1]]
    assert energies[0] > 8 * energies[1]
    assert energies[4] < 1e-4
    assert energies[5] < 1e-4


def test_pareto_front_goes_from_cheap_to_accurate(measured):
    front = measured.pareto()
    assert front
    seconds, errors = ([getattr(row, n) for row in front] for n in ("seconds", "gradient"))
    assert seconds == sorted(seconds)
    assert errors == sorted(errors, reverse=True)
    for row in measured.rows[:-1]:
        assert row in front or any(
            other.seconds <= row.seconds and other.gradient <= row.gradient for other in front
        )


def made(seconds, gradient, states=0.0):
    return MeasuredSetting(HHT(0.1), seconds, "made", states=states, gradient=gradient)


def test_recommends_the_cheapest_that_is_good_enough():
    a, b, c = made(1.0, 1e-2, 1e-5), made(2.0, 1e-4), made(1.5, 1e-3)
    failed = MeasuredSetting(HHT(0.2), 0.1, "failed")
    table = WorkPrecision((a, b, c, failed), made(9.0, 0.0))
    assert table.recommend(0.5) is a
    assert table.recommend(1e-3) is c
    assert table.recommend(5e-4) is b
    assert table.recommend(1e-4, of="states") is a
    assert table.pareto() == (a, c, b)


@pytest.mark.parametrize("off", [-0.1, 0.0, 0.1])
def test_times_that_differ_from_call_to_call_do_not_change_the_choice(off):
    """Two settings that cost the same, the second measured ten per cent slower or faster."""
    first, second, slow = made(1.0, 1e-4), made(1.0 + off, 1e-5), made(1.5, 1e-6)
    assert WorkPrecision((slow, first, second), made(9.0, 0.0)).recommend(1e-3) is first
    assert WorkPrecision((second, slow, first), made(9.0, 0.0)).recommend(1e-3) is second


def test_a_target_out_of_reach_names_the_best():
    best = made(2.0, 1e-4)
    table = WorkPrecision((made(1.0, 1e-2), best), made(9.0, 0.0))
    with pytest.raises(
        TargetNotReachedError, match=r"1e-05 in the gradient.*0\.0001 in 2 s"
    ) as error:
        table.recommend(1e-5)
    assert error.value.best is best
    with pytest.raises(TargetNotReachedError, match="all of them failed"):
        WorkPrecision((MeasuredSetting(HHT(0.2), 0.1, "failed"),), best).recommend(1.0)
    for wrong in (0.0, -1.0, np.nan, "1"):
        with pytest.raises(InvalidInputError, match="target_error"):
            table.recommend(wrong)
    with pytest.raises(InvalidInputError, match="must be one of"):
        table.recommend(1e-3, of="colour")


def test_a_failed_setting_is_a_row_with_its_message(measured):
    failed = measured.rows[-1]
    assert not failed.finished
    assert "limit of steps" in failed.outcome
    assert failed.gradient is None
    assert failed.error("gradient") == np.inf
    assert failed not in measured.pareto()
    # Given steps end elsewhere: the integrator refuses, the table goes on.
    settings = [HHT(0.1), HHT(PrescribedSteps((0.0, 0.3)))]
    one, refused = work_precision(CartesianPendulum(), X2, 1.0, settings, reference=HHT(0.01)).rows
    assert one.finished
    assert "where the given instants end" in refused.outcome


def test_systems_of_any_kind(measured):
    table = work_precision(
        CartesianPendulum(),
        X2,
        1.0,
        [HHT(0.05), IDA(1e-6)],
        method=DirectDifferentiation(),
        repeats=2,
    )
    coarse, fine = table.rows
    assert coarse.energy is None
    assert coarse.gradient > 10 * fine.gradient


def test_table_names_settings_errors_and_outcomes(measured):
    lines = measured.table().splitlines()
    assert len(lines) == 2 + len(SETTINGS) + 1
    assert lines[0].split()[:3] == ["integrator", "setting", "CPU"]
    assert lines[1].startswith("HHT fixed")
    assert "step 0.003906" in lines[1]
    assert lines[3].startswith("HHT controlled")
    assert "limit of steps" in lines[-2]
    assert "(reference)" in lines[-1]
    row = MeasuredSetting(HHT(0.1, hht_alpha=-0.05), 1.0, "")
    assert (row.family, row.label) == ("HHT fixed, hht_alpha = -0.05", "step 0.1")
    row = MeasuredSetting(HHT(AdaptiveSteps(1e-3, 1e-5, 9, True)), 1.0, "")
    assert (row.family, row.label) == (
        "HHT controlled, sensitivities = True",
        "rtol 0.001, atol 1e-05",
    )
    assert MeasuredSetting(HHT(PrescribedSteps((0.0, 0.1))), 1.0, "").label == "given"


def test_plot_is_a_picture(measured, tmp_path):
    svg, png = measured.plot(tmp_path / "trade")
    assert svg.exists()
    assert png.exists()
    titles = [panel.title for panel in measured.panels()]
    assert titles == ["Error of the states", "Error of the gradient"]
    failed = WorkPrecision((MeasuredSetting(HHT(0.2), 0.1, "failed"),), made(1.0, 0.0))
    with pytest.raises(InvalidInputError, match=r"WorkPrecision\.plot"):
        failed.plot(tmp_path / "none")


def test_worker_processes_measure_the_same(measured):
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as executor:
        table = work_precision(
            SCENE,
            OBJECTIVE,
            T_END,
            [SETTINGS[0], FAILING],
            design=DESIGN,
            reference=DOP853(1e-9),
            executor=executor,
        )
        here, there = measured.rows[0], table.rows[0]
        assert there.gradient == pytest.approx(here.gradient, rel=1e-9)
        assert there.energy == pytest.approx(here.energy, rel=1e-9)
        assert table.rows[1].outcome == measured.rows[-1].outcome
        unsent = Integral(custom(lambda t, q, v, lam, b: q[:, 0]))
        with pytest.raises(InvalidInputError, match="objective, executor: must pickle"):
            work_precision(SCENE, unsent, T_END, SETTINGS, design=DESIGN, executor=executor)
    assert pickle.loads(pickle.dumps(table)) == table


class Breaking(ThreadPoolExecutor):
    """Loses every job but the first two."""

    count = 0

    def submit(self, *args, **kwargs):
        self.count += 1
        if self.count < 3:
            return super().submit(*args, **kwargs)
        lost = Future()
        lost.set_exception(OSError("the worker died"))
        return lost


def test_a_lost_worker_is_a_row():
    with Breaking(1) as executor:
        table = work_precision(
            CartesianPendulum(), X2, 1.0, [HHT(0.1), HHT(0.05)], executor=executor
        )
    assert table.rows[0].finished
    assert "the worker died" in table.rows[1].outcome


SLOW = HHT(2.0**-20)


@pytest.mark.parametrize("threads", [False, True])
def test_a_setting_that_meets_its_limit_of_time_is_a_row(threads):
    settings, options = [HHT(0.1), SLOW, HHT(0.05)], {"reference": HHT(0.02), "time_limit": 1.0}
    with ThreadPoolExecutor(1) if threads else nullcontext() as executor:
        table = work_precision(CartesianPendulum(), X2, 1.0, settings, executor=executor, **options)
    assert [row.finished for row in table.rows] == [True, False, True]
    assert table.rows[1].outcome == "the limit of time (time_limit = 1 s) was reached"
    # It took a part of the second; the run would take minutes.
    assert 0 < table.rows[1].seconds < 10


class Pressing(CartesianPendulum):
    """Presses Ctrl-C at t = 1/16, an instant of a step of 1/16 but not of 0.1 or 0.02."""

    def with_values(self, b):
        return Pressing(self.angle, self.spin, b)

    def force(self, t, q, v):
        if t == 2.0**-4:
            signal.raise_signal(signal.SIGINT)
        return super().force(t, q, v)


def test_an_interrupt_keeps_the_rows():
    settings = [HHT(0.1), HHT(2.0**-4), HHT(0.05)]
    with pytest.raises(Interrupted, match="1 of 3 settings were measured") as caught:
        work_precision(Pressing(), X2, 1.0, settings, reference=HHT(0.02))
    table = caught.value.result
    (whole,) = work_precision(CartesianPendulum(), X2, 1.0, [HHT(0.1)], reference=HHT(0.02)).rows
    assert table.rows[0].gradient == whole.gradient
    assert [row.finished for row in table.rows] == [True, False, False]
    assert table.rows[1].outcome == "not measured: the comparison was interrupted"
    with pytest.raises(KeyboardInterrupt):
        work_precision(Pressing(), X2, 1.0, [HHT(0.1)], reference=HHT(2.0**-4))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"settings": []}, "settings: must not be empty"),
        ({"settings": HHT(0.1)}, "settings"),
        ({"settings": [HHT(0.1), 0.1]}, "settings: must be of type Integrator"),
        ({"reference": "fine"}, "reference"),
        ({"reference": FAILING}, "reference: must finish"),
        ({"objective": 3.0}, "objective"),
        ({"objective": Integral(position(MaterialPoint("rod", 1.0), 0))}, "rod"),
        ({"design": ()}, "design"),
        ({"t_end": -1.0}, "t_end"),
        ({"repeats": 0}, "repeats"),
        ({"time_limit": 0.0}, "time_limit"),
        ({"method": "direct"}, "method"),
        ({"executor": 2}, "executor"),
    ],
)
def test_bad_input_is_refused_by_name(change, match):
    given = {"objective": OBJECTIVE, "design": DESIGN, "t_end": T_END, "settings": SETTINGS}
    given |= change
    with pytest.raises(InvalidInputError, match=match):
        work_precision(SCENE, **given)


def test_adjoint_where_it_exists_else_a_row():
    table = work_precision(
        CartesianPendulum(), X2, 1.0, [HHT(0.05), IDA(1e-6)], reference=HHT(0.01), method=Adjoint()
    )
    assert table.rows[0].finished
    assert "InvalidInputError" in table.rows[1].outcome


@pytest.mark.filterwarnings("ignore::ancfdae.errors.ManyStepsWarning")
@pytest.mark.parametrize(
    ("damping_time", "t_end", "why"),
    [(0.0, 2.0**-6, ""), (1.0, 2.0**-6, "to be stable"), (1.0, 2.0**-3, "more than 50000 steps")],
)
def test_the_default_reference_can_finish(damping_time, t_end, why):
    """Damped so, DOP853 would need 40,000 steps for 2^-6 s."""
    scene = pendulum(elements=1, youngs_modulus=1e7, damping_time=damping_time)
    table = work_precision(scene, Integral(position(TIP, 1)), t_end, [HHT(2.0**-11)], design=DESIGN)
    assert why in table.reference.outcome
    assert ("Chosen" in table.reference.outcome) == bool(why)
    assert isinstance(table.reference.integrator, IDA if why else DOP853)
    assert table.rows[0].error("states") < 1e-4


@pytest.mark.parametrize("reference", [DOP853(1e-8, max_steps=3), FAILING])
def test_a_reference_that_meets_its_limit_of_steps_is_told_so(reference):
    with pytest.raises(InvalidInputError, match="Raise its max_steps"):
        work_precision(CartesianPendulum(), X2, 1.0, [HHT(2.0**-4)], reference=reference)


def test_a_reference_that_fails_otherwise_is_to_be_loosened():
    # Newton's method does not converge in one iteration.
    reference = HHT(0.25, max_iterations=1)
    with pytest.raises(InvalidInputError, match="Loosen it") as caught:
        work_precision(CartesianPendulum(), X2, 1.0, [HHT(2.0**-4)], reference=reference)
    assert "max_steps" not in str(caught.value)


def swinging(place):
    """A rod of one metre that swings from level about a pin at (place, -place)."""
    rod = RigidBody("rod", (place + 0.5, -place), mass=2.0, inertia=0.2)
    pin = Pin(rod.at(-0.5, 0.0), ground=(place, -place))
    return Scene([], [pin], (0.0, -9.81), bodies=[rod])


def test_errors_do_not_depend_on_the_place_of_a_scene():
    rows = []
    for place in (0.0, 1e3):
        scene = swinging(place)
        speed = angular_velocity(scene.bodies[0].at(0.0, 0.0))
        call = scene, Integral(speed**2), 0.5, [HHT(2.0**-6)]
        found = work_precision(*call, design=["rod.mass"], reference=DOP853(1e-9))
        rows.append(found.rows[0])
    near, far = rows
    assert far.states == pytest.approx(near.states, rel=1e-4)
    assert far.multipliers == pytest.approx(near.multipliers, rel=1e-4)
    assert far.drift < 1e-11
    # By hand: positions count from the centre of mass at the start.
    scene = swinging(0.0)
    run, exact = (simulate(scene, 0.5, i) for i in (HHT(2.0**-6), DOP853(1e-9)))
    root, moved = np.sqrt(assemble(scene).weights), exact.at(run.t).q
    away = np.max(np.linalg.norm((run.q - moved) * root, axis=1))
    moved[:, :2] -= (0.5, 0.0)
    expected = away / np.max(np.linalg.norm(moved * root, axis=1))
    assert near.states == pytest.approx(expected, rel=2e-2)
