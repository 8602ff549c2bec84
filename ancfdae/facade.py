"""Public modules: their names are listed in a stub (.pyi) and imported when they are first used."""

import ast
import importlib
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

# Modules of public names beside the top level, each for one kind of object.
PARTS = ("errors", "extend", "laws", "observables", "results", "sections")


class PublicModule(NamedTuple):
    """Attributes through which Python finds the names of a public module.

    Attributes
    ----------
    homes : dict of str to str
        The public names, each with the module that defines it.
    names : list of str
        `__all__` of the module.
    get : callable
        `__getattr__` of the module.
    list_names : callable
        `__dir__` of the module.
    """

    homes: dict[str, str]
    names: list[str]
    get: Callable[[str], Any]
    list_names: Callable[[], list[str]]


def public_module(name: str, file: str, others: Iterable[str] = ()) -> PublicModule:
    """Return the attributes of the public module `name`, whose names the stub beside `file` lists.

    An unknown name raises AttributeError with the call or page to use, or with similar names;
    ``from package import`` of it raises ImportError with the same text. `others` are public names
    that the module defines itself.
    """
    homes = listed_names(Path(file).with_suffix(".pyi"))
    module = sys.modules[name]

    def get(wanted: str) -> Any:
        if name == "ancfdae" and wanted in (*PARTS, "plotting"):
            return importlib.import_module(f"{name}.{wanted}")
        if wanted not in homes:
            raise _unknown(module, wanted)
        value = getattr(importlib.import_module(homes[wanted]), wanted)
        setattr(module, wanted, value)
        return value

    names = [*homes, *others]
    # With a `__path__` the import system takes the module for a package, and keeps our message.
    vars(module).setdefault("__path__", [])
    module.__class__ = _Names
    return PublicModule(homes, names, get, lambda: sorted({*vars(module), *names}))


def public_names() -> dict[str, str]:
    """Return every public name with the module from which it is imported."""
    package = Path(__file__).parent
    stubs = {"ancfdae": package / "__init__.pyi", "ancfdae.errors": package / "errors/__init__.pyi"}
    stubs |= {f"ancfdae.{part}": package / f"{part}.pyi" for part in PARTS if part != "errors"}
    return {name: module for module, stub in stubs.items() for name in listed_names(stub)}


def listed_names(stub: Path) -> dict[str, str]:
    """Return the names that a stub imports, each with the module that defines it."""
    return {
        alias.name: str(line.module)
        for line in ast.parse(stub.read_text(encoding="utf-8")).body
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }


def _unknown(module: ModuleType, name: str) -> Exception:
    """Return the error for a name that the module does not have, with the message of `answer`."""
    here = Path(str(module.__file__)).parent
    if name.startswith("_") or (here / name).is_dir() or list(here.glob(f"{name}.*")):
        return AttributeError(f"module {module.__name__!r} has no attribute {name!r}")
    from ancfdae.errors.unknown_names import answer

    # The import system asks for names by `hasattr` first, and would replace the text by its own.
    importing = sys._getframe(2).f_code.co_name == "_handle_fromlist"
    return (ImportError if importing else AttributeError)(answer(name, module.__name__))


class _Names(ModuleType):
    """A module whose public names are not replaced by submodules: `modes` stays a function."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute, unless it is a loaded submodule with the name of a public object."""
        if not (isinstance(value, ModuleType) and name in self.__all__):
            super().__setattr__(name, value)
