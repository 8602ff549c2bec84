"""Whatever calls that take a model are given, they answer or refuse it in their own words.

Arguments are good ones, one or two of them spoiled. A spoiled one that is accepted must be what the
parameter of that name stands for, and nothing takes longer than ten seconds
of processor time.
"""

import inspect
import os
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

import ancfdae
from ancfdae import (
    HHT,
    Adjoint,
    DesignVariable,
    DirectDifferentiation,
    Evaluator,
    Misfit,
    Pin,
    Scene,
    Terminal,
    assemble,
    equilibrium,
    plotting,
    simulate,
)
from ancfdae.errors import AncfdaeError
from ancfdae.extend import Integrator, MechanicalSystem, Objective, Observable
from ancfdae.observables import kinetic_energy
from ancfdae.results import Equilibrium, LinearisationPoint, Solution
from ancfdae.sensitivity.method import GradientMethod, Method
from tests.support.junk import JUNK, ROD, TIP

SCENE = Scene([ROD], [ancfdae.Clamp(ROD.at_start)], gravity=(0.0, -9.81))
SWINGING = Scene([ROD], [Pin(ROD.at_start)], gravity=(0.0, -9.81))
SYSTEM = assemble(SCENE, ["rod.height"])
TWO = Scene([replace(ROD, elements=2)], [ancfdae.Clamp(ROD.at_start)], gravity=(0.0, -9.81))
STEP = HHT(0.01)
RUN = simulate(SCENE, 0.05, STEP)
OBJECTIVE = Terminal(TIP)
#: What the parameter of a name is given.
GOOD: dict[str, list[Any]] = {
    "model": [SCENE, SYSTEM, SWINGING],
    "scene": [SCENE],
    "t_end": [0.05, 0.04],
    "integrator": [STEP, HHT(0.005)],
    "design": [["rod.height"], [DesignVariable("h", {"rod.height": 2.0})]],
    "method": [DirectDifferentiation(), Adjoint()],
    "objective": [OBJECTIVE],
    "objectives": [[OBJECTIVE, 2 * OBJECTIVE]],
    "observable": [TIP],
    "solution": [RUN],
    "system": [SYSTEM],
    "after": [RUN],
    "progress": [False],
    "settings": [[STEP], [STEP, HHT(0.005)]],
    "reference": [HHT(0.005)],
    "repeats": [1],
    "time_limit": [5.0],
    "executor": [None],
    "designs": [[{"rod.height": 0.04}], [[0.04], [0.05]]],
    "what": [Evaluator(OBJECTIVE, 0.05, STEP)],
    "functions": [{"tip": OBJECTIVE}],
    "scale": [1.0, [0.05]],
    "strict": [True],
    "count": [1, 2],
    "at": [None],
    "start": [None, equilibrium(SCENE)],
    "max_steps": [50],
    "runs": [2],
    "file": [None],
    "observables": [[TIP]],
    "every": [1],
    "samples": [1],
    "times": [[0.02]],
    "data": [[[1.0]]],
    "x": [[0.04]],
    "b": [[0.04]],
    "name": ["rod", "tip"],
    "owner": ["rod"],
    "upper": [1.0],
    "mode": [0],
    "point": [ROD.at_end],
    "joint": ["clamp(rod@0)"],
    "values": [{"rod.height": 0.04}],
    "variable": [DesignVariable("h", {"rod.height": 2.0})],
    "of": ["gradient"],
    "target_error": [0.1],
    "rates": [[0.0, 1.0]],
    "parameter": ["load.force_x"],
    "to": [-1e7],
    "size": [0.01],
    "tolerance": [0.1],
}
RESPONSES = ancfdae.Responses(SYSTEM, {"tip": OBJECTIVE}, 0.05, STEP)
FIT = Misfit([TIP], [0.02], [[1.0]]).fit(SYSTEM, 0.05, STEP)
MODES = ancfdae.modes(SYSTEM)
TRADE = ancfdae.work_precision(SYSTEM, OBJECTIVE, 0.05, [STEP], reference=HHT(0.005))
DERIVED = ancfdae.differentiate(SYSTEM, 0.05, STEP)
PRESSED = replace(
    SCENE, gravity=(0.0, 0.0), loads=[ancfdae.PointForce(ROD.at_end, (0.0, 0.0), name="load")]
)
CRITICAL = ancfdae.critical_load(PRESSED, "load.force_x", -1e7)
TURNING = replace(SCENE, frame=ancfdae.RotatingFrame(1.0), gravity=(0.0, 0.0))


def campbell(rates: Any, count: Any) -> ancfdae.results.Campbell:
    return ancfdae.campbell(TURNING, rates, count)


def critical_load(parameter: Any, to: Any, design: Any = None) -> ancfdae.results.CriticalLoad:
    return ancfdae.critical_load(PRESSED, parameter, to, design=design)


def within(
    t_end: Any, observables: Any, tolerance: Any, at_times: Any = None
) -> ancfdae.results.ObservableEstimates:
    return simulate(SCENE, t_end, tolerance=tolerance, observables=observables, at=at_times)


def gradient_within(objective: Any, tolerance: Any, design: Any) -> ancfdae.results.Gradient:
    return ancfdae.gradient(SCENE, objective, 0.05, tolerance=tolerance, design=design)


CALLS = [
    *(ancfdae.simulate, ancfdae.differentiate, ancfdae.gradient, ancfdae.gradients),
    *(ancfdae.observables.observe, ancfdae.evaluate, ancfdae.modes, ancfdae.equilibrium),
    *(
        ancfdae.equilibrium_gradient,
        ancfdae.error_bars,
        ancfdae.estimate_adjoint_error,
        ancfdae.work_precision,
    ),
    *(ancfdae.sweep, ancfdae.mass_properties, ancfdae.suggest_step, ancfdae.Responses, assemble),
    *(ancfdae.taylor_test, ancfdae.record_observables, ancfdae.check_system),
    *(RUN.at, RUN.position, RUN.slope, RUN.reaction, RUN.to_dataframe, DERIVED.design_index),
    *(RESPONSES.values, RESPONSES.constraint, RESPONSES.__getitem__, FIT.residuals, Misfit),
    *(MODES.shape_b, SCENE.with_values, SCENE.beam, SCENE.member, SCENE.numbers, SCENE.value),
    *(TRADE.pareto, TRADE.recommend, plotting.snapshots, plotting.history),
    *(campbell, critical_load, CRITICAL.branch, within, gradient_within),
]


def number(x: Any) -> bool:
    real = isinstance(x, int | float | np.integer | np.floating) and not isinstance(x, bool)
    return real and bool(abs(x) < float("inf")) and x > 0


def all_of(kinds: Any) -> Callable[[Any], bool]:
    # What is empty holds nothing wrong.
    sized = Sequence | Mapping | np.ndarray
    return lambda x: isinstance(x, sized) and all(isinstance(each, kinds) for each in x)


#: What the parameter of a name may be; another name may be anything.
VALID: dict[str, Callable[[Any], bool]] = {
    "model": lambda x: isinstance(x, Scene | MechanicalSystem),
    "scene": lambda x: isinstance(x, Scene),
    "t_end": number,
    "integrator": lambda x: isinstance(x, Integrator),
    "design": lambda x: x is None or all_of(str | DesignVariable)(x),
    "method": lambda x: x is None or isinstance(x, GradientMethod | Method),
    "objective": lambda x: isinstance(x, Objective),
    "objectives": lambda x: len(x) > 0 and all_of(Objective)(x),
    "observable": lambda x: isinstance(x, Observable),
    "solution": lambda x: isinstance(x, Solution),
    "system": lambda x: x is None or isinstance(x, MechanicalSystem),
    "after": lambda x: x is None or isinstance(x, Solution),
    "progress": lambda x: isinstance(x, bool | np.bool_),
    "settings": all_of(Integrator),
    "reference": lambda x: x is None or isinstance(x, Integrator),
    "repeats": number,
    "time_limit": lambda x: x is None or number(x),
    "executor": lambda x: x is None,
    "functions": lambda x: isinstance(x, Mapping),
    "strict": lambda x: isinstance(x, bool | np.bool_),
    "count": number,
    "at": lambda x: x is None or isinstance(x, LinearisationPoint | Equilibrium | Solution),
    "start": lambda x: x is None or isinstance(x, Equilibrium),
    "max_steps": number,
    "rates": lambda x: np.ndim(x) == 1 and len(x) > 0,
    "parameter": lambda x: isinstance(x, str | DesignVariable),
    "to": lambda x: number(x) or number(-x),
    "size": lambda x: number(x) or number(-x),
    "tolerance": number,
}


def parameters(call: Callable[..., Any]) -> list[str]:
    call = inspect.unwrap(call)
    code = (call.__init__ if isinstance(call, type) else call).__code__
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    return [name for name in names if name != "self"]


def optional(call: Callable[..., Any], name: str) -> bool:
    function = call.__init__ if isinstance(call, type) else inspect.unwrap(call)
    code, known = function.__code__, function.__kwdefaults__ or {}
    plain = code.co_varnames[: code.co_argcount][-len(function.__defaults__ or ()) :]
    if name == "reference":
        return False  # The default takes 10,000 steps of a stiff beam.
    return name in known or (bool(function.__defaults__) and name in plain)


@st.composite
def calls(draw: st.DrawFn) -> tuple[Callable[..., Any], dict[str, Any], set[str]]:
    call = draw(st.sampled_from(CALLS))
    names = parameters(call)
    given = {
        name: draw(st.sampled_from(GOOD[name]))
        for name in names
        if name in GOOD and (not optional(call, name) or draw(st.booleans()))
    }
    spoiled = set(draw(st.lists(st.sampled_from(names), max_size=2)))
    # Files are written, and many repeats take long because they are asked for.
    spoiled -= {"file", "repeats"}
    for name in sorted(spoiled):
        given[name] = draw(st.sampled_from(JUNK))
    return call, given, spoiled


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    def strike(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, strike)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def with_junk(call: Callable[..., Any], **junk: Any) -> tuple[Any, dict[str, Any], set[str]]:
    needed = {x: GOOD[x][0] for x in parameters(call) if x in GOOD and not optional(call, x)}
    return call, needed | junk, set(junk)


@settings(max_examples=int(os.environ.get("FUZZ", "60")), deadline=None)
@given(calls())
@example(with_junk(ancfdae.simulate, progress="x"))
@example(with_junk(ancfdae.estimate_adjoint_error, progress=object()))
@example(with_junk(ancfdae.work_precision, progress=3))
@example(with_junk(ancfdae.work_precision, time_limit=1e308))
@example(with_junk(ancfdae.error_bars, levels=np.zeros(3)))
@example(with_junk(ancfdae.gradient, model=SYSTEM, design=0.5))
@example(with_junk(ancfdae.mass_properties, model=SYSTEM, design=int))
@example(with_junk(ancfdae.sweep, designs=[[0.04]], design=b"x"))
@example(with_junk(assemble, scene="a.b"))
@example(with_junk(ancfdae.gradients, objectives=[]))
@example(with_junk(ancfdae.modes, highest=[]))
@example(with_junk(ancfdae.modes, model=SYSTEM, at=equilibrium(TWO)))
@example(with_junk(ancfdae.observables.observe, observable=kinetic_energy(), system=assemble(TWO)))
@example(with_junk(ancfdae.taylor_test, sizes=[]))
@example(with_junk(ancfdae.taylor_test, direction=[0.0]))
@example(with_junk(ancfdae.check_system, seed=iter([1.0])))
@example(with_junk(ancfdae.sweep, file=__file__))
@example(with_junk(ancfdae.sweep, file=""))
@example(with_junk(ancfdae.sweep, file="no such folder/rows"))
@example(with_junk(ancfdae.record_observables, keep=1, file="no such folder/rows.npy"))
@example(with_junk(RUN.save, path=""))
@example(with_junk(RUN.slope, along=np.zeros(3)))
@example(with_junk(RUN.reaction, joint=np.zeros(3)))
@example(with_junk(RUN.to_dataframe, columns=np.zeros(3)))
@example(with_junk(RUN.to_dataframe, derivatives=[]))
@example(with_junk(DERIVED.design_index, name=np.zeros(3)))
@example(with_junk(MODES.shape_b, mode="3"))
@example(with_junk(MODES.shape_b, mode=len(MODES.frequencies)))
@example(with_junk(SCENE.beam, name=np.zeros(3)))
@example(with_junk(SCENE.member, name=[]))
@example(with_junk(SCENE.numbers, owner={}))
@example(with_junk(SCENE.value, variable="x"))
@example(with_junk(RESPONSES.constraint, upper="3"))
@example(with_junk(RESPONSES.__getitem__, name=np.zeros(3)))
@example(with_junk(Misfit, times=[[0.1]]))
@example(with_junk(Misfit, data="a.b"))
@example(with_junk(TRADE.pareto, of=np.zeros(3)))
@example(with_junk(TRADE.plot, path=""))
@example(with_junk(campbell, rates=0.5))
@example(with_junk(campbell, rates=[]))
@example(with_junk(CRITICAL.branch, size="x"))
@example(with_junk(CRITICAL.branch, size=0))
@example(with_junk(critical_load, to=float("nan")))
@example(with_junk(within, observables=np.zeros(3)))
@example(with_junk(plotting.snapshots, scene=SCENE, solution=-2))
def test_calls_answer_or_refuse(call: tuple[Callable[..., Any], dict[str, Any], set[str]]) -> None:
    function, given, spoiled = call
    try:
        with warnings.catch_warnings(), at_most(10.0):
            warnings.simplefilter("ignore")
            repr(function(**given))
    except AncfdaeError:
        return
    except TypeError as error:
        # Python's own word on arguments that are missing.
        if "required" in str(error):
            return
        raise
    wrong = [name for name in spoiled if name in VALID and not VALID[name](given[name])]
    assert not wrong, f"{function.__name__} accepted {wrong}: {given}"
