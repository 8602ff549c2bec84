"""Builds the extension module: setuptools with the headers of NumPy (see pyproject.toml)."""

from __future__ import annotations

import importlib.util
import inspect
import shlex
import shutil
import sysconfig
import textwrap
from enum import IntEnum
from os import environ
from pathlib import Path
from types import ModuleType
from typing import final

import numpy as np
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

_PACKAGES = (
    "Debian and Ubuntu: apt install g++ python3-dev; Fedora: dnf install gcc-c++ "
    "python3-devel; macOS: xcode-select --install; conda: conda install cxx-compiler"
)


_STUB_HEAD = '''"""What `kernels.cpp` declares, written by `build.py`."""

from enum import IntEnum
from typing import Any

from ancfdae.numerics.arrays import Array
'''


def stub(module: ModuleType) -> str:
    """Return the stub of a compiled module, whose documentation begins with the signatures."""
    parts = [_STUB_HEAD]
    for name, value in vars(module).items():
        if inspect.isclass(value) and issubclass(value, IntEnum):
            members = (f"    {member.name} = {member.value}" for member in value)
            parts.append("\n".join([f"class {name}(IntEnum):", *members]))
        elif inspect.isclass(value):
            first, _, about = (value.__doc__ or "").partition("\n")
            methods = [x.__doc__ for x in vars(value).values() if inspect.ismethoddescriptor(x)]
            own = [_declared(x) for x in methods if x and "->" in x]
            body = f'"""{about}\n"""\n\n' + "\n".join([_declared(first), *own])
            parts.append(f"class {name}:\n" + textwrap.indent(body, "    "))
        elif inspect.isbuiltin(value):
            parts.append(_declared(value.__doc__ or ""))
        elif isinstance(value, int):
            parts.append(f"{name}: int")
    return "\n\n".join(parts) + "\n"


def _declared(doc: str) -> str:
    """Return a function from its documentation, the first line of which is its signature."""
    first, _, about = doc.partition("\n")
    return f"def {first}: " + (f'\n    """{about}"""\n' if about else "...")


@final
class BuildKernels(build_ext):
    """The usual command, which finds NumPy where the package is built."""

    def finalize_options(self) -> None:
        """Add the headers of NumPy to the include path."""
        super().finalize_options()
        self.include_dirs.append(np.get_include())

    def run(self) -> None:
        """Build; end in one sentence where there is no C++ compiler."""
        command = environ.get("CXX") or sysconfig.get_config_var("CXX") or "c++"
        compiler = shlex.split(command)[0]
        if shutil.which(compiler) is None:
            raise SystemExit(
                "ancfdae: needs a C++ compiler to be installed from source; got none under the "
                f"name {compiler!r}. {_PACKAGES}; or name yours in CXX, or install a wheel."
            )
        try:
            super().run()
        except CompileError as error:
            raise SystemExit(
                "ancfdae: its C++ code could not be compiled; the words of the compiler are above. "
                f"Where Python.h or another header is missing: {_PACKAGES}."
            ) from error
        for extension in self.extensions:
            self._write_stub(extension.name, Path(self.get_ext_fullpath(extension.name)))

    def _write_stub(self, name: str, path: Path) -> None:
        """Write the stub beside a module, unless it is compiled for another machine."""
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is None or spec.loader is None:
            return
        try:
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
        except ImportError:
            return
        path.with_name(name.rpartition(".")[2] + ".pyi").write_text(stub(module))
