"""Classes of the results that calls return; users do not construct them."""

from ancfdae.facade import public_module

_HOMES, __all__, __getattr__, __dir__ = public_module(__name__, __file__)
