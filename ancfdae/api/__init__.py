"""Calls that take a scene or a mechanical system: what a user of the package calls."""

from ancfdae.api.adjoint_error import AdjointError, adjoint_error
from ancfdae.api.calls import as_system, cheapest, differentiate, gradient, gradients, simulate
from ancfdae.api.error_bars import ErrorBars, error_bars
from ancfdae.api.mass_properties import MassProperties, mass_properties
from ancfdae.api.misfit import Fit, Misfit
from ancfdae.api.modes import modes, suggest_step
from ancfdae.api.responses import Response, Responses
from ancfdae.api.statics import equilibrium, static_gradient
from ancfdae.api.sweep import Evaluate, sweep
from ancfdae.api.sweep_result import Sweep, SweepRow
from ancfdae.api.taylor import TaylorTest, taylor_test
from ancfdae.api.tradeoff import tradeoff
from ancfdae.api.tradeoff_result import Setting, TargetNotReached, Tradeoff
