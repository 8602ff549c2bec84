"""Results: classes that calls return and that nobody constructs."""

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import ErrorEstimates, Sensitivities, Solution, Statistics
from ancfdae.equations.conformance import SystemCheck
from ancfdae.equations.event_solution import EventRecord, EventSolution
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.modes.analysis import StepSuggestion
from ancfdae.modes.linearised import LinearisationPoint
from ancfdae.modes.result import ModeKind, Modes
from ancfdae.sensitivity.method import Accuracy, Gradient
from ancfdae.statics.critical import CriticalLoad
from ancfdae.statics.equilibrium import Equilibrium
from ancfdae.statics.outcome import EquilibriumOutcome
from ancfdae.studies.accuracy.error_bars import AdjointErrorEstimate, ErrorBars
from ancfdae.studies.accuracy.search import ObservableEstimates
from ancfdae.studies.fit import ResidualFunction, RunResidualFunction
from ancfdae.studies.ladder import ModelChoice, ModelComparison, ModelVariant, VariantRun
from ancfdae.studies.mass_properties import MassProperties
from ancfdae.studies.modes import Campbell
from ancfdae.studies.observing import ObservableRecord
from ancfdae.studies.responses import Response
from ancfdae.studies.sweep_file import Sweep, SweepRow
from ancfdae.studies.taylor import TaylorTest
from ancfdae.studies.tradeoff_result import MeasuredSetting, WorkPrecision

__all__ = [
    "Accuracy",
    "AdjointErrorEstimate",
    "AncfSystem",
    "Campbell",
    "CriticalLoad",
    "Equilibrium",
    "EquilibriumOutcome",
    "ErrorBars",
    "ErrorEstimates",
    "EventRecord",
    "EventSolution",
    "Gradient",
    "LinearisationPoint",
    "MassProperties",
    "MeasuredSetting",
    "ModeKind",
    "ModelChoice",
    "ModelComparison",
    "ModelVariant",
    "Modes",
    "ObservableEstimates",
    "ObservableRecord",
    "ResidualFunction",
    "Response",
    "RunOutcome",
    "RunResidualFunction",
    "Sensitivities",
    "Solution",
    "Statistics",
    "StepSuggestion",
    "Sweep",
    "SweepRow",
    "SystemCheck",
    "TaylorTest",
    "VariantRun",
    "Verdict",
    "WorkPrecision",
]
