"""First-order design sensitivities of flexible multibody systems in ANCF.

Every public name is listed once, in `__init__.pyi`, with the module that defines it; that module is
imported when the name is first used.
"""

import ast
import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

__version__ = "0.1.0"

_LISTED = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
# Public names, each with the module it comes from.
_MODULES = {
    name.name: str(line.module)
    for line in _LISTED
    if isinstance(line, ast.ImportFrom)
    for name in line.names
}
__all__ = [*_MODULES, "__version__"]


def __getattr__(name: str) -> Any:
    """Return a public name, and keep it for the next time."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names and what is imported already."""
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """A package whose public names no module of it replaces: `modes` is a function."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; the import system does so with every module that it has loaded."""
        if not (name in _MODULES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
