"""First-order design sensitivities of flexible multibody systems in ANCF.

The names here build a scene or start a computation. Further names are in `ancfdae.laws`,
`ancfdae.sections`, `ancfdae.observables`, `ancfdae.results`, `ancfdae.errors`, `ancfdae.extend` and
`ancfdae.plotting`.
"""

from ancfdae.facade import public_module

__version__ = "0.1.0"

_HOMES, __all__, __getattr__, __dir__ = public_module(__name__, __file__, ["__version__"])
