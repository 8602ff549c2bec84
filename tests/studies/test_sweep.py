"""`sweep`: rows in order, errors as rows, interrupts, files, processes and a Dask cluster."""

import dataclasses
import functools
import importlib.util
import inspect
import multiprocessing
import pickle
import signal
import threading
import typing
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    AdaptiveSteps,
    AtTimes,
    Beam,
    DesignVariable,
    Evaluator,
    FiniteDifference,
    Integral,
    Material,
    Pin,
    PointOnLine,
    RotationDriver,
    Scene,
    SmoothUpperBound,
    Terminal,
    assemble,
    equilibrium,
    gradient,
    simulate,
    sweep,
)
from ancfdae.assembly.numbers import Numbers
from ancfdae.errors import AncfdaeError, Interrupted, InvalidInputError
from ancfdae.laws import ConstantAcceleration, UserLaw
from ancfdae.model.bodies import MaterialPoint
from ancfdae.observables import kinetic_energy, observe, position
from ancfdae.results import MeasuredSetting, Solution, Verdict
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.objectives.reductions import read_at_end
from ancfdae.statics.equilibrium import Equilibrium
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

SCENE = pendulum(elements=1, youngs_modulus=1e6)
STEEL = Material(7850.0, 2.1e11, 0.3)
TIP = MaterialPoint("pendulum", 1.0)
T_END = 2.0**-4
HEIGHT = "pendulum.height"
VARIABLE = DesignVariable("h", [HEIGHT])
DROP = Terminal(position(TIP, 1))
VALUE = Evaluator(DROP, T_END, HHT(2.0**-7))
HEIGHTS = [0.04, 0.05, -1.0, 0.06]
DESIGNS = [{HEIGHT: h} for h in HEIGHTS]


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        yield executor


# ---- errors come back from workers


def kinds(kind=AncfdaeError):
    return {kind}.union(*map(kinds, kind.__subclasses__()))


def sample(hint):
    """Return an argument for an annotation of an error's signature."""
    if hint is Solution:
        return simulate(SCENE, 2.0**-6, HHT(2.0**-7))
    if hint is Equilibrium:
        return equilibrium(SCENE)
    if hint is Verdict:
        return Verdict.SINGULAR
    if typing.get_origin(hint) is typing.Literal:
        return typing.get_args(hint)[0]
    if typing.get_origin(hint) is typing.Union or "None" in str(hint):
        return sample(next(x for x in typing.get_args(hint) if x is not type(None)))
    if typing.get_origin(hint) is not None:
        return ["one", "two"]
    if hint is MeasuredSetting:
        return MeasuredSetting(HHT(0.1), 1.0, "made", states=1.0)
    return {str: "states", float: 0.25}.get(hint, "got")


def made(kind):
    if not inspect.isfunction(kind.__init__):
        return kind("what went wrong")
    hints = typing.get_type_hints(kind.__init__)
    names = list(inspect.signature(kind).parameters)
    return kind(*(sample(hints[name]) for name in names))


def fail(kind):
    raise made(kind)


@pytest.mark.parametrize("kind", sorted(kinds(), key=lambda kind: kind.__name__))
def test_every_error_arrives_from_a_worker_process(kind, pool):
    error = pool.submit(fail, kind).exception()
    here = made(kind)
    assert type(error) is kind
    assert str(error) == str(here)
    assert error.args == here.args
    assert error.__dict__.keys() == here.__dict__.keys()


def test_an_error_about_a_function_arrives_too():
    error = InvalidInputError("where", "rule", lambda x: x, "Pass a number instead.")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)
    assert "lambda" in again.got


# ---- rows


def test_rows_stand_in_order_and_a_bad_design_is_one_of_them():
    done = sweep(SCENE, DESIGNS, VALUE)
    for row, height in zip(done.rows, HEIGHTS, strict=True):
        assert row.values == {HEIGHT: height}
        if height > 0:
            moved = simulate(SCENE.with_values({HEIGHT: height}), T_END, HHT(2.0**-7))
            assert row.result["value"] == observe(position(TIP, 1), moved)[-1]
    assert list(done.failed) == [2]
    assert "InvalidInputError" in done.failed[2]
    assert done.results[2] is None
    assert "4 designs, 1 without result" in repr(done)


def test_gradients_and_observables_are_those_of_the_calls():
    method = {"design": [HEIGHT]}
    what = Evaluator(DROP, T_END, HHT(2.0**-7), gradient=True, **method)
    (row,) = sweep(SCENE, DESIGNS[:1], what).rows
    moved = SCENE.with_values(DESIGNS[0])
    own = gradient(moved, DROP, T_END, HHT(2.0**-7), **method)
    assert row.result["value"] == own.value
    assert np.array_equal(row.result["gradient"], own.gradient)
    (row,) = sweep(SCENE, DESIGNS[:1], Evaluator(kinetic_energy(), T_END, HHT(2.0**-7))).rows
    assert row.result["value"].shape == row.result["t"].shape
    assert row.result["value"][-1] > row.result["value"][0] == 0


def test_gradients_are_taken_by_the_method_that_was_given():
    """Finite differences, because the exact methods give one gradient."""
    method = FiniteDifference(0.1)
    given = {"design": [HEIGHT], "method": method}
    what = Evaluator(DROP, T_END, HHT(2.0**-7), gradient=True, **given)
    (result,) = sweep(SCENE, [{}], what).results
    own = gradient(SCENE, DROP, T_END, HHT(2.0**-7), **given)
    exact = gradient(SCENE, DROP, T_END, HHT(2.0**-7), design=[HEIGHT])
    assert np.array_equal(result["gradient"], own.gradient)
    assert not np.allclose(result["gradient"], exact.gradient, rtol=1e-6)


def length(system):
    return float(system.b @ (1.0, 100.0))


def test_rows_of_values_mappings_and_variables_mean_the_same():
    system = CartesianPendulum()
    L, g = system.b
    rows = sweep(system, np.array([[L, g], [2.0, g]]), length)
    named = sweep(system, [{}, {"L": 2.0}], length)
    assert rows.results == named.results == [L + 100 * g, 2 + 100 * g]
    assert "UnknownNameError" in sweep(system, [{"M": 1.0}], length).failed[0]
    by_variable = sweep(SCENE, [[0.04]], VALUE, design=[VARIABLE])
    assert by_variable.rows[0].values == {"h": 0.04}
    assert by_variable.results == sweep(SCENE, DESIGNS[:1], VALUE).results


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"model": 3}, "model"),
        ({"designs": 3}, "designs"),
        ({"designs": [[0.1]]}, "design"),
        ({"designs": [[0.1, 0.2]], "design": [HEIGHT]}, r"designs\[0\]: must have 1 values"),
        ({"designs": [{HEIGHT: 1.0}, [0.1]], "design": [HEIGHT]}, r"designs\[0\]"),
        ({"design": [HEIGHT]}, "must be left out where designs are mappings"),
        ({"what": DROP}, "what"),
        ({"executor": 2}, "executor"),
    ],
)
def test_bad_input_is_refused_by_name(change, match):
    with pytest.raises(InvalidInputError, match=match):
        sweep(**({"model": SCENE, "designs": DESIGNS, "what": VALUE} | change))


def test_what_is_evaluated_is_checked_at_once():
    with pytest.raises(InvalidInputError, match=r"Evaluator\.of"):
        Evaluator(kinetic_energy(), 1.0, HHT(0.1), gradient=True)
    with pytest.raises(InvalidInputError, match=r"Evaluator\.integrator"):
        Evaluator(DROP, 1.0, 0.1)


# ---- workers


def test_worker_processes_give_the_same_rows(pool):
    assert sweep(SCENE, DESIGNS, VALUE, executor=pool) == sweep(SCENE, DESIGNS, VALUE)
    with pytest.raises(InvalidInputError, match="what, executor: must pickle"):
        sweep(SCENE, DESIGNS, lambda scene: 1, executor=pool)


@pytest.mark.parametrize("threads", [2, 4])
def test_threads_give_the_same_bits_on_one_structure(threads):
    """Designs share what is kept of rigid bodies and prescribed angles; no result may show it."""
    arm = Beam("arm", (0, 0), (0.2, 0), 1, Rectangle(0.02, 0.02), STEEL, rigid=True)
    rod = Beam("rod", (0.2, 0), (0.7, 0), 2, Rectangle(0.01, 0.01), STEEL)
    joints = [
        Pin(arm.at_start),
        RotationDriver(arm.at_start, ConstantAcceleration(3.0)),
        Pin(arm.at_end, rod.at_start),
        PointOnLine(rod.at_end, direction=(1, 0)),
    ]
    scene = Scene([arm, rod], joints, (0, -9.81))
    of = Terminal(position(rod.at(0.5), 1)) + Integral(kinetic_energy())
    names = ["arm.density", "rod.youngs_modulus", "rod.height"]
    what = Evaluator(of, 0.0625, HHT(2.0**-9), gradient=True, design=names)
    moduli = [scene.value(DesignVariable("x", [name])) for name in names]
    rows = np.random.default_rng(0).uniform(0.9, 1.1, (24, 3)) * moduli
    here = sweep(scene, rows, what, design=names).rows
    with ThreadPoolExecutor(threads) as executor:
        there = sweep(scene, rows, what, design=names, executor=executor).rows
    assert not any(row.error for row in here)
    for one, other in zip(here, there, strict=True):
        assert one.result["value"] == other.result["value"]
        assert np.array_equal(one.result["gradient"], other.result["gradient"])


class Counting(ThreadPoolExecutor):
    """Counts its jobs."""

    count = 0

    def submit(self, *args, **kwargs):
        self.count += 1
        return super().submit(*args, **kwargs)


MANY = np.linspace(1.0, 2.0, 400)[:, None]


SYSTEM = CartesianPendulum()


def test_short_calls_travel_in_chunks():
    with Counting(2) as executor:
        done = sweep(SYSTEM, MANY, length, design=["L"], executor=executor, chunk=9)
    assert done == sweep(SYSTEM, MANY, length, design=["L"])
    assert executor.count == 45  # 44 chunks of 9, and one of 4


def length_until_interrupted(system):
    if system.b[0] == MANY[200, 0]:
        raise KeyboardInterrupt
    return length(system)


class Immediate(Executor):
    """Has done every job when it is sent, so that answers arrive in any order."""

    def submit(self, function, *args):
        future = Future()
        future.set_result(function(*args))
        return future


def test_an_interrupt_keeps_what_workers_have_done():
    with pytest.raises(Interrupted) as stopped:
        sweep(SYSTEM, MANY, length_until_interrupted, design=["L"], executor=Immediate(), chunk=8)
    done = stopped.value.result
    # The one that was interrupted, and what travelled with it and was not begun.
    assert list(done.failed) == [*range(200, 208)]
    whole = sweep(SYSTEM, MANY, length, design=["L"]).results
    assert [done.results[k] for k in (0, 199, 208, 399)] == [whole[k] for k in (0, 199, 208, 399)]


class Breaking(ThreadPoolExecutor):
    """Loses the second job."""

    count = 0

    def submit(self, *args, **kwargs):
        self.count += 1
        if self.count != 2:
            return super().submit(*args, **kwargs)
        lost = Future()
        lost.set_exception(OSError("the worker died"))
        return lost


def test_a_lost_worker_is_a_row_that_a_resumed_sweep_computes(tmp_path):
    file = tmp_path / "rows.jsonl"
    with Breaking(1) as executor:
        done = sweep(SCENE, DESIGNS, VALUE, executor=executor, file=file)
    assert list(done.failed) == [1, 2]
    assert "the worker died" in done.failed[1]
    assert list(sweep(SCENE, DESIGNS, VALUE, file=file).failed) == [2]


@pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="needs a Dask cluster: python3 -m pip install 'ancfdae[dask]'",
)
def test_a_dask_cluster_gives_the_same_rows():
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
        client.get_executor() as executor,
    ):
        assert sweep(SCENE, DESIGNS, VALUE, executor=executor) == sweep(SCENE, DESIGNS, VALUE)
        many = SYSTEM, MANY, length
        found = sweep(*many, design=["L"], executor=executor, chunk=50)
        assert found == sweep(*many, design=["L"])


# ---- interrupts and files


def pressed(scene):
    """Press Ctrl-C at one design."""
    if scene.value(VARIABLE) == 0.05:
        signal.raise_signal(signal.SIGINT)
    return VALUE(scene)


def test_an_interrupt_keeps_what_is_done():
    with pytest.raises(Interrupted, match="1 of 4 designs were done") as caught:
        sweep(SCENE, DESIGNS, pressed)
    done = caught.value.result
    assert done.rows[0] == sweep(SCENE, DESIGNS[:1], VALUE).rows[0]
    assert list(done.failed) == [1, 2, 3]
    assert set(done.failed.values()) == {"not computed: the sweep was interrupted"}


def test_an_interrupted_worker_ends_the_sweep(pool):
    with pytest.raises(Interrupted) as caught:
        sweep(SCENE, DESIGNS, pressed, executor=pool)
    assert 1 in caught.value.result.failed


CALLS = []


def counted(scene):
    CALLS.append(scene.value(VARIABLE))
    return {"drop": VALUE(scene)["value"], "list": (1, np.float64(2)), "array": np.eye(2)}


def counted_set(scene):
    return {1, 2}


def test_a_sweep_resumes_from_its_file(tmp_path):
    file = tmp_path / "rows.jsonl"
    CALLS.clear()
    first = sweep(SCENE, DESIGNS[:3], counted, file=file)
    assert CALLS == [0.04, 0.05]
    lines = file.read_text().splitlines()
    assert len(lines) == 4
    # A crash while the last row was written.
    file.write_text("\n".join([*lines[:-1], lines[-1][:20]]))
    CALLS.clear()
    again = sweep(SCENE, DESIGNS, counted, file=file)
    assert CALLS == [0.06]
    assert list(again.failed) == [2]
    assert repr(again.rows[:3]) == repr(first.rows)
    assert isinstance(again.results[0]["array"], np.ndarray)
    assert again.results[0]["list"] == again.results[3]["list"] == [1, 2.0]
    CALLS.clear()  # It is a global that `counted` reads.
    assert repr(sweep(SCENE, DESIGNS, counted, file=file)) == repr(again)


def test_a_file_of_another_sweep_is_refused(tmp_path):
    file, text = tmp_path / "rows.jsonl", tmp_path / "text"
    sweep(SCENE, DESIGNS[:1], VALUE, file=file)
    before = file.read_text()
    for other, match in (
        ((pendulum(elements=2), DESIGNS, VALUE), "rows of another model"),
        ((SCENE, DESIGNS, Evaluator(DROP, 2 * T_END, HHT(2.0**-7))), "rows of another what"),
        ((SCENE, DESIGNS, counted), "rows of another what"),
        ((SCENE, DESIGNS[1:], VALUE), "rows of these designs; got row 0 at"),
    ):
        with pytest.raises(InvalidInputError, match=match):
            sweep(*other, file=file)
    assert file.read_text() == before
    for content in ("no sweep", "no sweep\n", "3\n"):
        text.write_text(content)
        with pytest.raises(InvalidInputError, match="must be the file of a sweep"):
            sweep(SCENE, DESIGNS, VALUE, file=text)
        assert text.read_text() == content


FACTOR = 2.0


@dataclasses.dataclass
class Times:
    """Callable with contents."""

    factor: float

    def __call__(self, system):
        return self.factor * system.b[0]


class Plain:
    def __init__(self, factor):
        self.factor = factor

    def times(self, system):
        return self.factor * system.b[0]


def closing_over(factor):
    return lambda system: factor * system.b[0]


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line[:-9],
        lambda line: line.replace("row", "raw", 1),
        lambda line: line.replace('"row": 0', '"row": -1'),
        lambda line: line.replace('"row": 0', '"row": "0"'),
        lambda line: line.replace("result", "error", 1),
        lambda line: '{"some": "thing else"}',
        lambda line: "[]",
        lambda line: "[" * 100_000,
        lambda line: '{"array": [[1], 2]}',
    ],
    ids=["cut", "renamed", "below", "text", "no result", "foreign", "list", "deep", "ragged"],
)
def test_a_damaged_line_of_a_file_is_named(tmp_path, damage):
    file = tmp_path / "rows.jsonl"
    first = sweep(SCENE, DESIGNS[:2], VALUE, file=file)
    head, row, last = file.read_text().splitlines()
    file.write_text("\n".join([head, damage(row), last, ""]))
    with pytest.raises(
        InvalidInputError, match=r"rows.jsonl: must hold rows; got .* in line 2\. Remove"
    ):
        sweep(SCENE, DESIGNS[:2], VALUE, file=file)
    # The advice helps.
    file.write_text("\n".join([head, last, ""]))
    assert repr(sweep(SCENE, DESIGNS[:2], VALUE, file=file)) == repr(first)


@pytest.mark.parametrize(
    "line", ["[]", '"sweep of"', '{"sweep of": 3}', '{"sweep of": {}}', "[" * 9999]
)
def test_a_first_line_that_is_none_of_a_sweep_is_refused(tmp_path, line):
    file = tmp_path / "rows.jsonl"
    file.write_text(line + "\n")
    with pytest.raises(InvalidInputError, match="must be the file of a sweep"):
        sweep(SCENE, DESIGNS[:1], VALUE, file=file)


def test_a_file_tells_functions_by_what_they_do(tmp_path, monkeypatch):
    """Lambdas have one name; so have closures, and functions that read a global."""
    functions = {
        "constant": (lambda s: 2 * s.b[0], lambda s: 3 * s.b[0]),
        "member": (lambda s: s.b[0], lambda s: s.n_q),
        "index": (lambda s: s.b[0], lambda s: s.b[1]),
        "inner": (lambda s: max(s.b, key=lambda x: x), lambda s: max(s.b, key=lambda x: -x)),
        "closure": (closing_over(2.0), closing_over(3.0)),
        "default": (lambda s, k=2.0: k * s.b[0], lambda s, k=3.0: k * s.b[0]),
        "keyword": (lambda s, *, k=2.0: k * s.b[0], lambda s, *, k=3.0: k * s.b[0]),
        "partial": (functools.partial(Times.__call__, Times(2.0)), Times(2.0).__call__),
        "contents": (Times(2.0), Times(3.0)),
        "method": (Plain(2.0).times, Plain(3.0).times),
        "array": (closing_over(np.ones(2)), closing_over(np.array([1.0, 2.0]))),
        "set": (lambda s: s.n_q in {1, 2}, lambda s: s.n_q in {1, 3}),
    }
    for name, (what, other) in functions.items():
        file = tmp_path / name
        done = sweep(SYSTEM, MANY[:1], what, design=["L"], file=file)
        assert repr(sweep(SYSTEM, MANY[:1], what, design=["L"], file=file)) == repr(done)
        with pytest.raises(InvalidInputError, match="rows of another what"):
            sweep(SYSTEM, MANY[:1], other, design=["L"], file=file)
    call = SYSTEM, MANY[:1], lambda s: FACTOR * s.b[0]
    assert sweep(*call, design=["L"], file=tmp_path / "global").results == [2.0]
    monkeypatch.setitem(globals(), "FACTOR", 3.0)
    with pytest.raises(InvalidInputError, match="rows of another what"):
        sweep(*call, design=["L"], file=tmp_path / "global")
    with pytest.raises(InvalidInputError, match="what, file: needs arguments that pickle"):
        sweep(SYSTEM, [{}], closing_over(threading.Lock()), file=tmp_path / "lock")


def test_a_file_of_a_system_of_other_values_is_refused(tmp_path):
    file = tmp_path / "rows.jsonl"
    sweep(SYSTEM, [{"L": 1.0}], length, file=file)
    # Before and after a run, whose results a system may keep.
    simulate(SYSTEM, 2.0**-6, HHT(2.0**-7))
    sweep(SYSTEM, [{"L": 1.0}], length, file=file)
    heavier = SYSTEM.with_values(SYSTEM.b * (1.0, 2.0))
    law = [UserLaw(lambda t: 2 * t), UserLaw(lambda t: 3 * t)]
    scenes = [pendulum_driven_by(each) for each in law]
    sweep(scenes[0], [{}], assemble_only, file=tmp_path / "driven")
    for model, name in ((heavier, file), (scenes[1], tmp_path / "driven")):
        with pytest.raises(InvalidInputError, match="rows of another model"):
            sweep(model, [{}], length if name == file else assemble_only, file=name)


def pendulum_driven_by(law):
    rod = SCENE.beams[0]
    return Scene([rod], [Pin(rod.at_start), RotationDriver(rod.at_start, law)])


def assemble_only(scene):
    return scene.dimension


def test_what_a_file_cannot_hold_is_told_at_the_first_row(tmp_path):
    with pytest.raises(InvalidInputError, match="what, file: results must be numbers"):
        sweep(SCENE, DESIGNS, counted_set, file=tmp_path / "rows.jsonl")


def of_scene(scene):
    """`VALUE`, and its gradient, by a function that is given each scene."""
    return VALUE(scene), dataclasses.replace(VALUE, gradient=True, design=[VARIABLE])(scene)


def test_a_scene_is_assembled_once_and_its_rows_are_those_of_each_scene(monkeypatch):
    """Numbers at a design follow from the first scene's: to round-off of a height's powers."""
    made = []
    first = Numbers.first
    monkeypatch.setattr(Numbers, "first", lambda *args: made.append(1) or first(*args))
    designs = [{VARIABLE: height} for height in (0.04, 0.05, 0.06)]
    values = sweep(SCENE, designs, VALUE)
    gradients = sweep(SCENE, designs, dataclasses.replace(VALUE, gradient=True, design=[VARIABLE]))
    assert len(made) == 2
    for row, slope, each in zip(
        values.rows, gradients.rows, sweep(SCENE, designs, of_scene).rows, strict=True
    ):
        value, with_gradient = each.result
        assert row.result["value"] == pytest.approx(value["value"], rel=1e-11)
        assert slope.result["gradient"] == pytest.approx(with_gradient["gradient"], rel=1e-9)
    assert len({row.result["value"] for row in values.rows}) == 3


def test_designs_do_not_depend_on_those_before_them():
    designs = [{HEIGHT: 0.05}, {HEIGHT: 0.06}, {HEIGHT: 0.05}]
    first, _, again = sweep(SCENE, designs, VALUE).rows
    assert first.result == again.result
    assert sweep(SCENE, designs[:1], VALUE).rows[0].result == first.result


def test_a_sweep_closes_joints_that_are_declared_open():
    """As `Scene.with_values` does: here the rod stands 1 mm from its pin."""
    rod = SCENE.beams[0]
    scene = Scene([rod], [Pin(rod.at_start, ground=(0.0, 1e-3))], gravity=(0, -9.81))
    (row,) = sweep(scene, [{HEIGHT: 0.04}], VALUE).rows
    assert row.result == VALUE(scene.with_values({HEIGHT: 0.04}))


def test_a_gradient_in_other_variables_is_that_of_the_scene():
    what = dataclasses.replace(VALUE, gradient=True, design=["pendulum.density"])
    (row,) = sweep(SCENE, [{HEIGHT: 0.04}], what).rows
    result = what(SCENE.with_values({HEIGHT: 0.04}))
    assert row.result["gradient"].tolist() == result["gradient"].tolist()


def test_the_variables_of_a_sweep_do_not_control_its_steps():
    steps = AdaptiveSteps(1e-3, sensitivities=True)
    what = Evaluator(DROP, T_END, HHT(steps))
    (row,) = sweep(SCENE, [{HEIGHT: 0.04}], what).rows
    assert row.result == what(SCENE.with_values({HEIGHT: 0.04}))


@pytest.mark.parametrize("integrator", [DOP853(1e-6), IDA(1e-5)])
def test_runs_of_high_order_report_what_is_asked_for(monkeypatch, integrator):
    """The end alone, to the same digits; instants between that something reads; driven motions."""
    system = assemble(SCENE)
    what = Evaluator(DROP + Integral(position(TIP, 0)), T_END, integrator)
    (row,) = sweep(SCENE, [{HEIGHT: 0.05}], what).rows
    assert integrator.at_end(system, T_END).intervals == 4
    assert dataclasses.replace(integrator, intervals=2).at_end(system, T_END).intervals == 2
    driven = assemble(pendulum_driven_by(UserLaw(lambda t: t)))
    assert integrator.at_end(driven, T_END) == integrator
    half = AtTimes(position(TIP, 1), T_END / 2)
    assert read_at_end(system, [what.of], T_END)
    assert not read_at_end(system, [DROP + half], T_END)
    assert not read_at_end(system, [SmoothUpperBound(position(TIP, 1), 5.0)], T_END)
    monkeypatch.setattr(type(integrator), "at_end", lambda self, *_: self)
    (again,) = sweep(SCENE, [{HEIGHT: 0.05}], what).rows
    assert row.result["value"] == again.result["value"]


@pytest.mark.parametrize("integrator", [DOP853(1e-6), IDA(1e-5)])
def test_a_gradient_records_the_instants_that_its_objective_reads(integrator):
    """Value and derivatives are those of a run with all instants; given intervals are kept."""
    of = DROP + Integral(position(TIP, 0))
    found = gradient(SCENE, of, T_END, integrator, design=[HEIGHT])
    full = dataclasses.replace(integrator, intervals=64)
    whole = gradient(SCENE, of, T_END, full, design=[HEIGHT])
    assert (len(found.solution.t), len(whole.solution.t)) == (33, 513)
    assert found.value == whole.value
    assert np.array_equal(found.gradient, whole.gradient)
    between = gradient(
        SCENE, SmoothUpperBound(position(TIP, 1), 5.0), T_END, integrator, design=[HEIGHT]
    )
    assert len(between.solution.t) == 513
