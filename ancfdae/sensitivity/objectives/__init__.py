"""Objectives: functions of a whole run, built from observables, with exact partials."""

from ancfdae.sensitivity.objectives.objective import (
    NonFiniteObjective,
    Objective,
    ObjectivePartials,
)
from ancfdae.sensitivity.objectives.reductions import (
    AtTimes,
    Integral,
    SmoothMaximum,
    Terminal,
    UpperMaximum,
)
