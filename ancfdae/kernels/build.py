"""Builds the extension module: setuptools with the headers of NumPy (see pyproject.toml)."""

from __future__ import annotations

import shlex
import shutil
import sysconfig
from os import environ
from typing import final

import numpy as np
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

_PACKAGES = (
    "Debian and Ubuntu: apt install g++ python3-dev; Fedora: dnf install gcc-c++ "
    "python3-devel; macOS: xcode-select --install; conda: conda install cxx-compiler"
)


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
