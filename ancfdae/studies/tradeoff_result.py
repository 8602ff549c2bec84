"""Measured settings: one run of each, its errors, Pareto front, recommendation, table and plot.

Every error is the largest over the common times relative to the largest value of the reference, in
dimensionless norms: coordinates in the weighted form sqrt(w_i) q_i, with positions from the mean
position of the start, multipliers by the forces Phi_q^T lam, gradients times the values of the
design variables.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, final

import numpy as np
import scipy

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError
from ancfdae.errors.outcomes import Verdict
from ancfdae.errors.text import PrintedTable, TableText, columns
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.step_control import StepControl
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch, timed
from ancfdae.sensitivity.method import Gradient, GradientMethod, UnfinishedRunError
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.accuracy.bars import ratio
from ancfdae.studies.calls import gradient
from ancfdae.studies.jobs import TimeLimit

if TYPE_CHECKING:
    from ancfdae.plotting import Panel, Series


# Number of times at which trajectories are compared, and at which drift and energy are computed.
_SAMPLES = 201
_LOOKS = 1000
# Time above which runs are not repeated; s.
_LONG = 1.0


@final
@dataclass(frozen=True)
class Task:
    """A measurement to make: a setting on a model; it pickles if system and objective do.

    `model` is the name of another model than the reference's, else empty. `given` are the events
    and modes that `gradient` takes; empty without events.
    """

    system: MechanicalSystem
    objective: Objective
    t_end: float
    integrator: Integrator
    method: GradientMethod | None
    repeats: int
    time_limit: float | None
    model: str = ""
    given: Mapping[str, Any] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Results:
    """Value, gradient and errors of a finished run.

    q, (k, n), are the coordinates at the common times, t_end the last of these. `along` is None for
    a run with events.
    """

    value: float
    gradient: Array
    q: Array
    t_end: float
    along: AlongMotion | None


@final
@dataclass(frozen=True)
class AlongMotion:
    """Errors along the motion of one system.

    lam, (k, m), are the multipliers at the common times. `drift`, (j, m), holds the constraints and
    `energy`, (j,), the total energy, J, at the times t of the run; `energy` is empty for a system
    that is not a scene. `kinetic` is the largest kinetic energy, J.
    """

    lam: Array
    drift: Array
    t: Array
    energy: Array
    kinetic: float


@final
@dataclass(frozen=True)
class Measurement:
    """Measured integrator setting: least processor time, s, outcome as text, results if any.

    `verdict` is how a run ended that did not reach its end time.
    """

    seconds: float
    outcome: str
    results: Results | None = None
    verdict: Verdict | None = None


def common_times(t_end: float) -> Array:
    """Return the times at which trajectories are compared, shape (201,); s."""
    return np.linspace(0.0, t_end, _SAMPLES)


def measure(task: Task) -> Measurement:
    """Return cost and errors of one integrator setting; without results if its run failed."""
    clock, limit = stopwatch(), TimeLimit(task.time_limit)
    try:
        with limit:
            return _repeated(task)
    except KeyboardInterrupt:
        if not limit.expired:
            raise
    outcome = f"the limit of time (time_limit = {limit.seconds:g} s) was reached"
    return Measurement(clock(), outcome)


def _repeated(task: Task) -> Measurement:
    def run() -> Gradient:
        settings = task.objective, task.t_end, task.integrator
        return gradient(task.system, *settings, method=task.method, **task.given)

    clock = stopwatch()
    try:
        seconds, answer = timed(run, task.repeats, long=_LONG)
    except UnfinishedRunError as error:
        outcome = error.solution.outcome
        return Measurement(clock(), str(outcome), verdict=outcome.verdict)
    except (AncfdaeError, ArithmeticError, ValueError, RuntimeError, MemoryError) as error:
        return Measurement(clock(), f"{type(error).__name__}: {error}")
    return Measurement(seconds, str(answer.solution.outcome), _results(task.system, answer))


def _results(system: MechanicalSystem, answer: Gradient) -> Results:
    if answer.event_solution is not None:
        end = float(answer.event_solution.t[-1])
        q, _ = answer.event_solution.at(common_times(end))
        return Results(answer.value, answer.gradient, q, end, None)
    solution = answer.solution
    # The end of a run with a fixed step may miss the end time by round-off.
    end = float(solution.t[-1])
    common = solution.at(common_times(end))
    rows = np.unique(np.linspace(0, len(solution.t) - 1, _LOOKS).round().astype(int))
    t, q = solution.t[rows], solution.q[rows]
    drift = np.array([system.constraint(s, x) for s, x in zip(t.tolist(), q, strict=True)])
    along = AlongMotion(common.lam, drift, t, *_energy(system, solution, rows))
    return Results(answer.value, answer.gradient, common.q, end, along)


def _energy(system: MechanicalSystem, solution: Solution, rows: Array) -> tuple[Array, float]:
    """Return the total energy of a scene at `rows`, and the largest kinetic energy; J."""
    if not isinstance(system, AncfSystem):
        return np.zeros(0), 0.0
    q, v = solution.q[rows], solution.v[rows]
    return system.energies.total(q, v), float(np.max(system.energies.kinetic(v)))


# -- errors ------------------------------------------------------------------------------------


ErrorKind = Literal["states", "multipliers", "objective", "gradient"]
_KINDS: Final[tuple[ErrorKind, ...]] = ("states", "multipliers", "objective", "gradient")
# Ratio of processor times up to which they count as equal: times of one run differ by 10 % and
# more.
_NEAR: Final = 1.25
# Names of settings that vary along one line of a plot, and of purely technical settings.
_ACCURACY: Final = ("step", "rtol", "atol", "times")
_TECHNICAL: Final = ("newton_tolerance", "max_iterations", "max_steps", "intervals")


@final
@dataclass(frozen=True)
class MeasuredSetting:
    """One measured integrator setting with its cost and errors.

    Attributes
    ----------
    integrator : Integrator
    seconds : float
        Smallest processor time of value and gradient over the repeats, s; time until the failure if
        the setting failed.
    states, multipliers, objective, gradient : float or None
        Errors relative to the reference; None if the setting failed, and of multipliers with
        events.
    drift : float or None
        Largest violation of a constraint as a distance, relative to the norm of the coordinates,
        with positions from the mean position of the start; None with events.
    energy : float or None
        Largest difference of the total energy (kinetic, strain and gravity) from the reference,
        relative to the largest kinetic energy; None with events, and for systems that are not
        scenes.
    outcome : str
        How the run ended, or why there is none.
    model : str
        Name of the model, if it differs from the model of the reference; it has errors of
        objective and gradient only.
    """

    integrator: Integrator
    seconds: float
    outcome: str
    states: float | None = None
    multipliers: float | None = None
    objective: float | None = None
    gradient: float | None = None
    drift: float | None = None
    energy: float | None = None
    model: str = ""

    @property
    def finished(self) -> bool:
        """Whether the run of the setting gave a gradient."""
        return self.gradient is not None

    @property
    def family(self) -> str:
        """Model and integrator without settings of accuracy, for example ``"HHT fixed"``."""
        words = [type(self.integrator).__name__]
        words += [x.kind for x in vars(self.integrator).values() if isinstance(x, StepControl)]
        return ", ".join(filter(None, [self.model, " ".join(words), *_chosen(self.integrator)]))

    @property
    def label(self) -> str:
        """Settings of accuracy, such as ``"step 0.01"`` or ``"rtol 1e-05"``."""
        given = [
            f"{name} {value:.4g}"
            for name, value, _ in _settings(self.integrator)
            if name in _ACCURACY and isinstance(value, float)
        ]
        return ", ".join(given) or "given"

    def error(self, of: ErrorKind) -> float:
        """Return one of the four relative errors of the setting; infinite if the run failed."""
        if str(of) not in _KINDS:  # `str`, because an array would compare entry by entry.
            known = ", ".join(_KINDS)
            raise InvalidInputError("of", f"must be one of {known}", repr(of))
        value: float | None = getattr(self, of)
        return np.inf if value is None else value


@final
class TargetNotReachedError(AncfdaeError):
    """No measured setting is accurate enough; the message names the best one.

    `best` is the most accurate setting; None if all failed.
    """

    def __init__(self, target: float, of: str, best: MeasuredSetting | None) -> None:
        start = f"no measured setting reaches an error of {target:.3g} in the {of}"
        if best is None:
            super().__init__(f"{start}: all of them failed. Look at their outcomes in table().")
        else:
            super().__init__(
                f"{start}; the best is {best.integrator} with {getattr(best, of):.3g} in "
                f"{best.seconds:.3g} s. Measure smaller steps (`suggest_step`) or tolerances."
            )
        self.best = best


@final
@dataclass(frozen=True, repr=False)
class WorkPrecision(PrintedTable):
    """Cost and accuracy of settings on one scene, in the order of the settings.

    Errors are measured relative to a reference, whose own error is not known; errors below that are
    meaningless.
    """

    rows: tuple[MeasuredSetting, ...]
    reference: MeasuredSetting

    def pareto(self, of: ErrorKind = "gradient") -> tuple[MeasuredSetting, ...]:
        """Return the settings that no other beats in both processor time and error, cheap first."""
        front: list[MeasuredSetting] = []
        least = np.inf
        for row in sorted(self.rows, key=lambda row: (row.seconds, row.error(of))):
            if row.error(of) < least:
                front.append(row)
                least = row.error(of)
        return tuple(front)

    def recommend(self, target_error: float, of: ErrorKind = "gradient") -> MeasuredSetting:
        """Return the cheapest measured setting whose relative error is at most the target.

        Processor times of the same run differ from call to call. Settings that take at most a
        quarter more than the cheapest therefore count as equally cheap, and the first of them in
        the order of `rows` is returned. The recommendation holds for this scene, objective and end
        time; nothing is extrapolated.

        Raises
        ------
        TargetNotReachedError
            If no setting is accurate enough.
        """
        require_positive("target_error", target_error)
        good = [row for row in self.rows if row.error(of) <= target_error]
        if not good:
            finished = [row for row in self.rows if np.isfinite(row.error(of))]
            best = min(finished, key=lambda row: row.error(of), default=None)
            raise TargetNotReachedError(target_error, of, best)
        least = min(row.seconds for row in good)
        return next(row for row in good if row.seconds <= _NEAR * least)

    def table(self) -> str:
        """Return all settings with their errors as a plain-text table, the reference last."""
        return columns(self._lines(), shorten=False)

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each setting, the reference last."""
        names = ("family", "label", "seconds", *_KINDS, "drift", "energy", "outcome")
        rows = [
            {name: getattr(row, name) for name in names} for row in (*self.rows, self.reference)
        ]
        return pandas().DataFrame(rows)

    def _printed(self) -> TableText:
        header, *lines, reference = self._lines()
        return "", [header, reference, *lines], ""

    def _lines(self) -> list[list[str]]:
        header = ["integrator", "setting", "CPU [s]", *_KINDS, "drift", "energy", "outcome"]
        lines = [header, *(_cells(row) for row in (*self.rows, self.reference))]
        lines[-1][0] += " (reference)"
        return lines

    def plot(self, path: str | os.PathLike[str]) -> tuple[Path, ...]:
        """Draw errors of states and gradient over processor time, and save them.

        Returns the paths of the files: ``trade.png`` or ``trade.svg`` if the path ends so, else
        both.

        Raises
        ------
        InvalidInputError
            If no setting has an error that can be shown.
        """
        from ancfdae import plotting

        return plotting.save(plotting.draw(self.panels(), columns=2), path)

    def panels(self) -> list[Panel]:
        """Return the panels of `plot`, to be drawn in other figures."""
        from ancfdae.plotting import Panel

        return [
            Panel(
                f"Error of the {of}",
                "processor time [s]",
                "relative error",
                self._series(of),
                x_scale="log",
                y_scale="log",
            )
            for of in ("states", "gradient")
        ]

    def _series(self, of: str) -> list[Series]:
        from ancfdae.plotting import Series

        lines: dict[str, list[tuple[float, float]]] = {}
        for row in self.rows:
            error = getattr(row, of)
            if error is not None and np.isfinite(error) and error > 0 and row.seconds > 0:
                lines.setdefault(row.family, []).append((row.seconds, error))
        if not lines:
            raise InvalidInputError(
                "WorkPrecision.plot",
                "needs a setting with an error",
                "none",
                "See table() for the reasons.",
            )
        return [
            Series(name, [x for x, _ in points], [y for _, y in points], marker=True)
            for name, points in lines.items()
        ]


def compared(
    system: MechanicalSystem, task: Task, run: Measurement, exact: Results
) -> MeasuredSetting:
    """Return a measured setting with the errors of a run relative to the reference `exact`.

    `system` is the system of the reference.
    """
    given = run.results
    row = MeasuredSetting(task.integrator, run.seconds, run.outcome, model=task.model)
    if given is None:
        return row
    names = list(system.design_names)
    slope = np.zeros(system.n_b)
    slope[[names.index(name) for name in task.system.design_names]] = given.gradient
    b = np.where(system.b == 0, 1.0, system.b)
    row = replace(
        row,
        objective=ratio(abs(given.value - exact.value), abs(exact.value)),
        gradient=_largest_ratio(((slope - exact.gradient) * b)[None], (exact.gradient * b)[None]),
    )
    if task.model:
        return row
    root, moved = np.sqrt(system.weights), _from_start(system, exact.q)
    row = replace(row, states=_largest_ratio((given.q - exact.q) * root, moved * root))
    if given.along is None or exact.along is None:
        return row
    t = common_times(exact.t_end)
    forces, forces_0 = (
        _forces(system, exact.q, lam, t) / root
        for lam in (given.along.lam - exact.along.lam, exact.along.lam)
    )
    return replace(
        row,
        multipliers=_largest_ratio(forces, forces_0),
        drift=_drift(system, exact.q, t, given.along.drift),
        energy=_energy_error(given.along, exact.along),
    )


def _from_start(system: MechanicalSystem, q: Array) -> Array:
    """Return coordinates q, (k, n_q), with positions from the mean position of the start."""
    start = system.start()[0].real
    return q - (start - system.centred(start))


def _forces(system: MechanicalSystem, q: Array, lam: Array, t: Array) -> Array:
    """Return the constraint forces Phi_q^T lam at times t, shape (k, n_q)."""
    return np.array(
        [reaction(system, *state) for state in zip(t.tolist(), q, lam, strict=True)]
    ).reshape(len(t), -1)


def _drift(system: MechanicalSystem, q: Array, t: Array, drift: Array) -> float:
    """Return the largest constraint error |Phi_i| over the norm of its row of Phi_q and of q."""
    if not system.n_lam:
        return 0.0
    inverse = 1 / system.weights[system.constraint_pattern.columns]
    rows = system.constraint_pattern.rows
    squares = [
        np.bincount(rows, system.constraint_q(s, x) ** 2 * inverse, minlength=system.n_lam)
        for x, s in zip(q, t, strict=True)
    ]
    length = np.sqrt(np.max(squares, axis=0))
    moved = _from_start(system, q) * np.sqrt(system.weights)
    size = float(np.max(np.linalg.norm(moved, axis=1)))
    away = np.max(np.abs(drift), axis=0)
    return max(ratio(float(x), float(y) * size) for x, y in zip(away, length, strict=True))


def _energy_error(given: AlongMotion, exact: AlongMotion) -> float | None:
    """Return the largest difference of energies over the largest kinetic energy.

    The energy of the reference is interpolated at the times of the run. None for systems that are
    not scenes.
    """
    if not len(given.energy):
        return None
    k = min(3, len(exact.energy) - 1)
    energy = scipy.interpolate.make_interp_spline(exact.t, exact.energy, k=k)
    away = given.energy - energy(np.minimum(given.t, exact.t[-1]))
    return ratio(float(np.max(np.abs(away))), exact.kinetic)


def _largest_ratio(x: Array, reference: Array) -> float:
    """Return the largest norm of a row of x over the largest norm of a row of the reference."""
    return ratio(
        float(np.max(np.linalg.norm(x, axis=1))), float(np.max(np.linalg.norm(reference, axis=1)))
    )


def _cells(row: MeasuredSetting) -> list[str]:
    numbers = (row.states, row.multipliers, row.objective, row.gradient, row.drift, row.energy)
    shown = ["-" if x is None else f"{x:.2g}" for x in numbers]
    return [row.family, row.label, f"{row.seconds:.3g}", *shown, row.outcome]


def _settings(owner: object) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, value and default of the settings of an integrator and of its step control."""
    for f in dataclasses.fields(owner) if dataclasses.is_dataclass(owner) else ():
        value = getattr(owner, f.name)
        if isinstance(value, StepControl):
            yield from _settings(value)
        else:
            yield f.name, value, f.default


def _chosen(integrator: Integrator) -> Sequence[str]:
    """Return the settings that are neither defaults nor settings of accuracy, as texts."""
    return [
        f"{name} = {value}"
        for name, value, default in _settings(integrator)
        if name not in (*_ACCURACY, *_TECHNICAL) and value != default
    ]
