"""Base classes for your own joints, loads, laws, sections, systems and integrators."""

from ancfdae.facade import public_module

_HOMES, __all__, __getattr__, __dir__ = public_module(__name__, __file__)
