"""Errors, warnings and interruptions that calls raise or warn of."""

from ancfdae.equations.files import SaveError
from ancfdae.errors.kinds import (
    AncfdaeError,
    CoarseMeshWarning,
    FailedDesignWarning,
    InconsistentStartError,
    InvalidInputError,
    LargeStrainWarning,
    ManyStepsWarning,
    MissingPackageError,
    NotTracedWarning,
    RedundantConstraintsError,
    StabilityWarning,
    ToleranceWarning,
    UnknownNameError,
    UnlikelyValueWarning,
)
from ancfdae.errors.outcomes import Interrupted
from ancfdae.sensitivity.method import UnfinishedRunError
from ancfdae.sensitivity.objectives import NonFiniteObjectiveError
from ancfdae.statics.critical import NoCriticalPointError
from ancfdae.statics.equilibrium import NoEquilibriumError
from ancfdae.statics.outcome import FreeMotionError
from ancfdae.studies.ladder import NoAccurateModelError
from ancfdae.studies.tradeoff_result import TargetNotReachedError

__all__ = [
    "AncfdaeError",
    "CoarseMeshWarning",
    "FailedDesignWarning",
    "FreeMotionError",
    "InconsistentStartError",
    "Interrupted",
    "InvalidInputError",
    "LargeStrainWarning",
    "ManyStepsWarning",
    "MissingPackageError",
    "NoAccurateModelError",
    "NoCriticalPointError",
    "NoEquilibriumError",
    "NonFiniteObjectiveError",
    "NotTracedWarning",
    "RedundantConstraintsError",
    "SaveError",
    "StabilityWarning",
    "TargetNotReachedError",
    "ToleranceWarning",
    "UnfinishedRunError",
    "UnknownNameError",
    "UnlikelyValueWarning",
]
