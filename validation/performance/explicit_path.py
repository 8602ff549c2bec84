"""The explicit path: a right-hand side, and a derivative to given accuracies."""

from functools import partial

import numpy as np

from ancfdae import DOP853, assemble, differentiate, simulate
from ancfdae.equations import MechanicalSystem
from ancfdae.integrators.problem import InitialValueProblem, stacked
from ancfdae.numerics.timing import medians
from validation.performance.row import Row
from validation.performance.steps import crank_variables, pendulum_variables
from validation.scenes import crank_slider, pendulum

_EXACT = 1e-11
_MOST = 400_000
# Of a right-hand side: what is done once before takes a millisecond.
_CALLS = 2_000


def measure(repeats: int = 5) -> list[Row]:
    """Return microseconds of a right-hand side, and seconds to an accuracy of E d/dE."""
    rows = []
    for what, design, asked in (
        ("alone", [], "at most 15"),
        ("with six variables", crank_variables(), "at most 50"),
    ):
        system = assemble(crank_slider(), design)
        calls = partial(_evaluate, system), partial(_run, system, 1e-6)
        evaluated, run = medians(calls, repeats)
        for how, value in (
            ("itself, called at one state", evaluated / _CALLS),
            ("in a run, the method and its instants around it", run / _evaluations(system)),
        ):
            rows.append(Row(f"right-hand side {what}, {how}", 1e6 * value, "us", asked))
    return rows + _pendulum(repeats)


def _evaluate(system: MechanicalSystem) -> None:
    """Call the right-hand side of an explicit run, at its start, many times."""
    problem = InitialValueProblem.of(system, 1.0)
    problem = problem.differentiated() if system.n_b else problem
    first, b, rows = problem.initial, problem.derivative, problem.accelerations.rows
    q, v = stacked(first.q, first.v, *(b or ())[:2])
    for _ in range(_CALLS):
        rows(0.0, q, v)


def _run(system: MechanicalSystem, rtol: float, t_end: float = 0.02) -> object:
    explicit = DOP853(rtol, max_steps=_MOST)
    if system.n_b:
        return differentiate(system, t_end, explicit)
    return simulate(system, t_end, explicit)


def _evaluations(system: MechanicalSystem) -> int:
    explicit = DOP853(1e-6, max_steps=_MOST)
    run = differentiate if system.n_b else simulate
    return run(system, 0.02, explicit).statistics.residuals


def _pendulum(repeats: int) -> list[Row]:
    """Return the least time, of a few tolerances, that reaches an accuracy of E d/dE at 1 s."""
    system, rows = assemble(pendulum(), pendulum_variables()), []
    exact = differentiate(system, 1.0, DOP853(_EXACT, max_steps=_MOST)).sensitivities
    assert exact is not None
    size = np.max(np.abs(exact.q_b[-1, :, 0]))
    for accuracy, asked in ((1e-3, "at most 0.3"), (1e-6, "at most 0.5")):
        for rtol in accuracy * np.array([10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01]):
            run = partial(differentiate, system, 1.0, DOP853(float(rtol), max_steps=_MOST))
            found = run().sensitivities
            assert found is not None
            if np.max(np.abs(found.q_b[-1] - exact.q_b[-1])[:, 0]) <= accuracy * size:
                what = f"pendulum, E d/dE at 1 s to {accuracy:g} (rtol {rtol:g})"
                rows.append(Row(what, medians([run], repeats)[0], "s", asked))
                break
    return rows
