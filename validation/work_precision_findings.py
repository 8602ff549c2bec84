"""What the measured tables say: time for an accuracy, gain and honesty of the controlled step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ancfdae import HHT, AdaptiveSteps
from ancfdae.errors import TargetNotReachedError
from ancfdae.results import MeasuredSetting, WorkPrecision

ModelChoice = Callable[[MeasuredSetting], bool]


def fixed(row: MeasuredSetting) -> bool:
    """Whether a setting is HHT-I3 at a fixed step."""
    return alpha(row) is not None and control(row) is None


def controlled(row: MeasuredSetting) -> bool:
    """Whether a setting is HHT-I3 with error control of the motion alone."""
    return control(row) is not None and not controlled_both(row)


def controlled_both(row: MeasuredSetting) -> bool:
    """Whether a setting is HHT-I3 with error control of motion and derivatives."""
    steps = control(row)
    return steps is not None and steps.sensitivities


def control(row: MeasuredSetting) -> AdaptiveSteps | None:
    """Return the error control of HHT-I3; None for other integrators and fixed steps."""
    steps = row.integrator.steps if isinstance(row.integrator, HHT) else None
    return steps if isinstance(steps, AdaptiveSteps) else None


def alpha(row: MeasuredSetting) -> float | None:
    """Return the numerical damping of HHT-I3; None for other integrators."""
    return row.integrator.hht_alpha if isinstance(row.integrator, HHT) else None


def short_name(row: MeasuredSetting) -> str:
    """Return family and setting in a few characters."""
    damping = alpha(row)
    if damping is not None:
        both = " of both" if controlled_both(row) else ""
        return f"HHT {row.label}{both}, alpha {damping:g}"
    return f"{type(row.integrator).__name__} {row.label}"


def cheapest_of(table: WorkPrecision, target: float, choice: ModelChoice) -> MeasuredSetting | None:
    """Return the recommendation among some settings; None if none is accurate enough."""
    rows = tuple(row for row in table.rows if choice(row))
    try:
        return WorkPrecision(rows, table.reference).recommend(target)
    except TargetNotReachedError:
        return None


def settled(table: WorkPrecision) -> WorkPrecision:
    """Leave out what is accurate by chance: settings whose finer ones have larger errors.

    Settings of a family stand in the table from coarse to fine.
    """
    families: dict[str, list[MeasuredSetting]] = {}
    for row in table.rows:
        families.setdefault(row.family, []).append(row)
    kept: list[MeasuredSetting] = []
    for rows in families.values():
        worst = 0.0
        for row in reversed(rows):
            if row.error("gradient") >= worst:
                worst = row.error("gradient")
                kept.append(row)
    return WorkPrecision(tuple(kept), table.reference)


def seconds_for(table: WorkPrecision, error: float, choice: ModelChoice) -> float:
    """Return the processor time at which a family reaches an error of the gradient.

    Between the measured settings of the Pareto front the time is interpolated in logarithms, as if
    any step could be chosen; outside of them it is not a number.
    """
    rows = tuple(row for row in table.rows if choice(row))
    front = [
        row for row in WorkPrecision(rows, table.reference).pareto() if row.error("gradient") > 0
    ]
    front.sort(key=lambda row: row.error("gradient"))
    errors = np.log([row.error("gradient") for row in front])
    if not front or not errors[0] <= np.log(error) <= errors[-1]:
        return float("nan")
    return float(np.exp(np.interp(np.log(error), errors, np.log([row.seconds for row in front]))))


@dataclass(frozen=True)
class Gain:
    """The controlled setting that gains most, and the time of the best fixed step for its error."""

    row: MeasuredSetting
    fixed_seconds: float

    @property
    def ratio(self) -> float:
        """Processor time of the controlled step over that of the best fixed one."""
        return self.row.seconds / self.fixed_seconds


def best_gain(
    table: WorkPrecision, floor: float, same_alpha: bool, choice: ModelChoice, ceiling: float = 0.1
) -> Gain | None:
    """Return the controlled setting that gains most against the best fixed step.

    Settings that `choice` takes are considered. Errors below the floor are not known, for the
    reference is no better; errors above the ceiling are not counted. With `same_alpha` the fixed
    step must have the same hht_alpha; otherwise the best of all counts.
    """
    gains = []
    for row in settled(table).rows:
        if choice(row) and floor <= row.error("gradient") <= ceiling:
            same = alpha(row) if same_alpha else None
            seconds = seconds_for(table, row.error("gradient"), partial(_is_fixed, damping=same))
            if np.isfinite(seconds):
                gains.append(Gain(row, seconds))
    return min(gains, key=lambda gain: gain.ratio, default=None)


def _is_fixed(row: MeasuredSetting, damping: float | None) -> bool:
    return fixed(row) and damping in (None, alpha(row))


def largest_ratio(
    tables: Sequence[WorkPrecision], of: str, choice: ModelChoice
) -> tuple[float, MeasuredSetting | None]:
    """Return the largest error over tolerance of some settings, and where it was."""
    worst, where = 0.0, None
    for table in tables:
        for row in table.rows:
            error = getattr(row, of)
            if choice(row) and error is not None:
                steps = control(row)
                assert steps is not None
                if error / steps.rtol > worst:
                    worst, where = error / steps.rtol, row
    return worst, where
