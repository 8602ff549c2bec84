"""Observables: scalar quantities of a motion over time, with exact partial derivatives."""

from ancfdae.facade import public_module

_HOMES, __all__, __getattr__, __dir__ = public_module(__name__, __file__)
