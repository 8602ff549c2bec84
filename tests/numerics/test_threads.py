"""Threads of BLAS: one while a computation runs, and the user's number after every end of it."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import threadpoolctl

from ancfdae import (
    BEAM_2D,
    DOP853,
    HHT,
    Adjoint,
    ContinuousAdjoint,
    DirectDifferentiation,
    FiniteDifference,
    Integral,
    Radau,
    assemble,
    differentiate,
    equilibrium,
    equilibrium_gradient,
    estimate_adjoint_error,
    evaluate,
    gradient,
    modes,
    record_observables,
    simulate,
    suggest_step,
)
from ancfdae.assembly import block
from ancfdae.numerics import threads
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.numerics.threads import in_one_thread
from ancfdae.observables import custom, observe, position
from ancfdae.studies.parts import RunOfParts
from tests.support.scenes import clamped, planar_pair
from validation.scenes import pendulum

USER = 3
DESIGN = ["rod.height"]


def blas():
    """Return the controller of all BLAS libraries that are loaded."""
    return threadpoolctl.ThreadpoolController().select(user_api="blas")


def counts():
    """Return their limits, each once."""
    return {x.num_threads for x in blas().lib_controllers}


def limit(count):
    """Set all limits, and let other Python threads set them, too."""
    blas().limit(limits=count)
    with blas().limit():
        pass


@pytest.fixture(autouse=True)
def three_threads():
    """Give the libraries three threads, as a user does who knows why."""
    before = counts().pop()
    limit(USER)
    assert counts() == {USER}
    yield
    assert counts() == {USER}
    limit(before)


@pytest.fixture
def seen(monkeypatch):
    """Return what the limits are at every factorisation in Python."""
    found, factor = [], SaddlePoint.factor

    def watched(self, K, B):
        found.append(counts())
        return factor(self, K, B)

    monkeypatch.setattr(SaddlePoint, "factor", watched)
    return found


def calls():
    """Return calls of all kinds, by name."""
    scene, held, step, end = planar_pair(), clamped(BEAM_2D), 2**-9, 2**-6
    rod = scene.members[1]
    bend = Integral(position(rod.at_end, 1) ** 2)

    def gradient_by(method, integrator=None, **more):
        integrator = integrator or HHT(step)
        return gradient(scene, bend, end, integrator, design=DESIGN, method=method, **more)

    return {
        "HHT": lambda: simulate(scene, end, HHT(step)),
        "HHT, controlled": lambda: simulate(scene, end, HHT(rtol=1e-3)),
        "Radau": lambda: simulate(scene, end, Radau(step)),
        "DOP853": lambda: simulate(scene, 2**-9, DOP853(1e-4, intervals=1)),
        "kept instants": lambda: simulate(scene, end, HHT(step), keep=2),
        "observations": lambda: record_observables(
            scene, [position(rod.at_end, 1)], end, HHT(step), keep=2
        ),
        "direct": lambda: differentiate(scene, end, Radau(step), design=DESIGN),
        "adjoint": lambda: gradient_by(Adjoint()),
        "adjoint of Radau": lambda: gradient_by(Adjoint(), Radau(step)),
        "checkpoints": lambda: gradient_by(Adjoint(memory=20_000)),
        "continuous adjoint": lambda: gradient_by(ContinuousAdjoint()),
        "error from one run": lambda: estimate_adjoint_error(scene, bend, end, HHT(step)),
        "equilibrium": lambda: equilibrium(held, design=DESIGN),
        "static gradient": lambda: equilibrium_gradient(
            held, position(held.members[0].at_end, 1), design=DESIGN, method=Adjoint()
        ),
        "modes": lambda: modes(scene, 2, design=DESIGN),
        "step": lambda: suggest_step(scene),
    }


@pytest.mark.parametrize("name", calls())
def test_matrices_are_factorised_in_one_thread(name, seen):
    calls()[name]()
    assert seen
    assert all(each == {1} for each in seen)


def in_its_own_process(program):
    """Run a program without the variables of BLAS: one thread for each core of the machine."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "GOTO_NUM_THREADS", "MKL_NUM_THREADS")
    free = {name: x for name, x in os.environ.items() if name not in names}
    free["PYTHONPATH"] = os.pathsep.join(sys.path)
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], env=free, check=True)


def test_a_run_without_the_variables_has_one_thread():
    program = """
        import threadpoolctl
        from test_threads import calls, counts
        from ancfdae.numerics.linear_solvers import SaddlePoint
        run = calls()["Radau"]
        before, factor, seen = counts(), SaddlePoint.factor, set()
        def watched(self, K, B):
            seen.update(counts())
            return factor(self, K, B)
        SaddlePoint.factor = watched
        run()
        assert seen == {1}, seen
        assert counts() == before, before
    """
    in_its_own_process(program)


def test_a_library_that_a_run_loads_has_one_thread():
    """The first wide band of a process loads LAPACK of SciPy: once 125 ms a step, 3 later on."""
    program = """
        import sys
        import threadpoolctl
        from ancfdae import Beam, Material, Pin, Radau, Scene, simulate
        from ancfdae.numerics.threads import in_one_thread
        from ancfdae.sections import Rectangle
        def counts():
            blas = threadpoolctl.ThreadpoolController().select(user_api="blas")
            return [x.num_threads for x in blas.lib_controllers]
        material = Material(1000.0, 1e7, 0.3)
        rod = Beam("rod", (0, 0, 0), (1, 0, 0), 10, Rectangle(0.02, 0.02), material)
        scene = Scene([rod], [Pin(rod.at_start)], gravity=(0, 0, -9.81))
        @in_one_thread
        def run():
            assert simulate(scene, 0.001, Radau(0.001)).outcome.success
            return counts()
        before, within = counts(), run()
        assert "scipy.linalg.cython_lapack" in sys.modules
        assert set(within) == {1}, within
        assert set(counts()) == set(before), counts()
    """
    in_its_own_process(program)


def test_elements_are_prepared_in_one_thread(monkeypatch):
    """Products of small matrices cost 20 times as much where two threads wait for each other."""
    seen, prepare = [], block.prepare

    def watched(*arguments):
        seen.append(counts())
        return prepare(*arguments)

    monkeypatch.setattr(block, "prepare", watched)
    system = assemble(clamped(BEAM_2D), [f"{clamped(BEAM_2D).members[0].name}.height"])
    assert seen == [{1}] * len(seen) != []
    seen.clear()
    system.with_values(1.01 * system.b)
    assert seen == [{1}] * len(seen) != []
    assert counts() == {USER}


@pytest.mark.parametrize("call", ["observe", "evaluate", "direct", "differences"])
def test_observables_are_evaluated_in_one_thread(call):
    """The largest stress of a beam in space and its derivative: small matrices at each point."""
    seen, scene = [], clamped(BEAM_2D)
    system = assemble(scene, [f"{scene.members[0].name}.height"])

    def watched(t, q, v, lam, b):
        seen.append(counts())
        return q[:, 1]

    y = custom(watched, "y")
    run = simulate(system, 2**-7, HHT(2**-9))
    seen.clear()
    match call:
        case "observe":
            observe(y, run, system)
        case "evaluate":
            evaluate(Integral(y), run, system)
        case _:
            method = DirectDifferentiation() if call == "direct" else FiniteDifference()
            gradient(system, Integral(y), 2**-7, HHT(2**-9), method=method)
    # A function of the user is tried before a run, with the user's number of threads.
    assert all(each == {1} for each in seen[seen.index({1}) :])


@in_one_thread
def inside(function=lambda: None):
    """Call a function where the limit is one; it is one before and after."""
    assert counts() == {1}
    function()
    assert counts() == {1}


def test_nested_calls_end_with_the_outer_one():
    inside(inside)
    assert counts() == {USER}


def test_an_exception_restores_the_limits():
    with pytest.raises(ZeroDivisionError):
        inside(lambda: 1 // 0)
    assert counts() == {USER}


def test_a_formula_may_take_threads_for_itself():
    def formula():
        with threadpoolctl.threadpool_limits(2, "blas"):
            assert counts() == {2}
            inside()
            assert counts() == {1}, "the outer call still needs one thread"

    inside(formula)
    assert counts() == {USER}


def test_a_generator_leaves_the_limits_between_its_parts():
    scene = planar_pair()
    for part, _ in RunOfParts(assemble(scene), 2**-7, HHT(2**-9), keep=1):
        assert part.outcome.success
        assert counts() == {USER}


def test_the_last_of_several_python_threads_restores_the_limits():
    entered, leave = threading.Event(), threading.Event()

    def wait():
        entered.set()
        leave.wait()

    thread = threading.Thread(target=inside, args=[wait])

    def begin():
        thread.start()
        entered.wait()

    inside(begin)
    assert counts() == {1}, "the other thread still computes"
    leave.set()
    thread.join()
    assert counts() == {USER}


def test_gradients_in_two_python_threads_agree_with_one_after_the_other(seen):
    alone = calls()["adjoint of Radau"]().gradient
    with ThreadPoolExecutor(2) as pool:
        both = [pool.submit(calls()["adjoint of Radau"]) for _ in range(2)]
        assert all(np.array_equal(each.result().gradient, alone) for each in both)
    assert all(each == {1} for each in seen)


def places():
    """Return the code of what sets and restores limits, with its lines; None is its call."""
    kinds = threads._Pools, threads._Block
    parts = [x for kind in kinds for name, x in vars(kind).items() if name in NAMES]
    assert len(parts) == 4
    for part in parts:
        code = part.__code__
        lines = {line for _, _, line in code.co_lines() if line not in (None, code.co_firstlineno)}
        yield from ((code, line) for line in (None, *sorted(lines)))


NAMES = "hold", "release", "__enter__", "__exit__"


@pytest.mark.parametrize(("code", "line"), [*places()], ids=lambda x: getattr(x, "co_name", None))
def test_ctrl_c_at_any_line_restores_the_limits(code, line):
    # Ctrl-C arrives while limits are set or restored: at this line, when it is first met.
    left = [True]

    def trace(frame, event, _):
        at = None if event == "call" else frame.f_lineno
        if frame.f_code is code and event in ("call", "line") and at == line and left:
            left.pop()
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    try:
        sys.settrace(trace)
        inside()
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    assert counts() == {USER}


def test_ctrl_c_in_a_run_restores_the_limits():
    timer = threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        simulate(pendulum(), 1e4, HHT(2**-9))
    assert counts() == {USER}
