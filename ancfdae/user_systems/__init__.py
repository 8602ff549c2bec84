"""Toolkit for mechanical systems that a user writes: partials by complex numbers, and a check."""

from ancfdae.user_systems.complex_step import ComplexStepSystem
from ancfdae.user_systems.conformance import Conformance, Finding, check_system
