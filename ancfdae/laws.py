"""Laws: functions of time that drivers, loads and supports follow."""

from ancfdae.facade import public_module

_HOMES, __all__, __getattr__, __dir__ = public_module(__name__, __file__)
