"""Public names of errors, warnings and interruptions that calls of the package raise."""

from ancfdae.facade import public_module

_HOMES, __all__, __getattr__, __dir__ = public_module(__name__, __file__)
