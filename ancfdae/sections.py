"""Cross-sections of beams: shapes, walled profiles, and sections given by moments or points."""

from ancfdae.facade import public_module

_HOMES, __all__, __getattr__, __dir__ = public_module(__name__, __file__)
