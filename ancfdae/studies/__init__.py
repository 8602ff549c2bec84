"""Calls that take a scene or a mechanical system: what a user of the package calls."""

from ancfdae.studies.calls import (
    as_system,
    cheapest,
    differentiate,
    evaluate,
    gradient,
    gradients,
    simulate,
)
from ancfdae.studies.campbell import Campbell, campbell
from ancfdae.studies.error_bars import AdjointError, ErrorBars, adjoint_error, error_bars
from ancfdae.studies.fit import Fit
from ancfdae.studies.ladder import choose_model
from ancfdae.studies.ladder_result import Choice, ModelLadder, NoModel, Rung, RungRun
from ancfdae.studies.mass_properties import MassProperties, mass_properties
from ancfdae.studies.misfit import FrequencyMisfit, Misfit, RunFit, StaticMisfit
from ancfdae.studies.modes import modes, suggest_step
from ancfdae.studies.observing import Observations, observations
from ancfdae.studies.responses import Response, Responses
from ancfdae.studies.statics import CriticalValue, critical_load, equilibrium, static_gradient
from ancfdae.studies.sweep import Evaluate, sweep
from ancfdae.studies.sweep_file import Sweep, SweepRow
from ancfdae.studies.taylor import TaylorTest, taylor_test
from ancfdae.studies.tolerance.observables import Observed
from ancfdae.studies.tradeoff import tradeoff
from ancfdae.studies.tradeoff_result import Setting, TargetNotReached, Tradeoff
