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
    """Return a public name, and store it for the next use.

    An unknown name raises AttributeError with the call or page that serves, or with near names;
    `from ancfdae import` of it raises ImportError with the same text.
    """
    if name not in _MODULES:
        raise _unknown(name)
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def _unknown(name: str) -> Exception:
    """Return the error for a name that the package does not have, with an answer to it."""
    here = Path(__file__).parent
    if name.startswith("_") or (here / name).is_dir() or list(here.glob(f"{name}.*")):
        return AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from ancfdae.errors.unknown_names import answer

    # The import system asks for names by `hasattr` first, and would replace the text by its own.
    importing = sys._getframe(2).f_code.co_name == "_handle_fromlist"
    kind = ImportError if importing else AttributeError
    return kind(answer(name, _MODULES))


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
