"""Objectives: functions of a whole run, built from observables, with exact partials."""

from ancfdae.objectives.objective import NonFiniteObjective, Objective, ObjectivePartials
from ancfdae.objectives.reductions import (
    AtTimes,
    Integral,
    SmoothMaximum,
    Terminal,
    UpperMaximum,
)
