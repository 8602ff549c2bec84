"""Small motions about a configuration: natural frequencies, shapes, damping, derivatives."""

from ancfdae.modes.adjoint import PullBack
from ancfdae.modes.analysis import modes_about
from ancfdae.modes.configuration import Configuration
from ancfdae.modes.periods import StepSuggestion, advice, advised, suggestion
from ancfdae.modes.result import ModeDerivatives, Modes, MotionKind
