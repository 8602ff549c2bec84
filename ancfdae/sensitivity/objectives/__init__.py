"""Objectives: functions of a whole run, built from observables, with exact partials."""

from ancfdae.sensitivity.objectives.objective import (
    NonFiniteObjectiveError,
    Objective,
    ObjectivePartials,
)
from ancfdae.sensitivity.objectives.reductions import (
    AtTimes,
    Integral,
    SmoothMaximum,
    SmoothUpperBound,
    Terminal,
)
