"""Builds the extension module: setuptools with the headers of NumPy (see pyproject.toml)."""

from __future__ import annotations

from typing import final

import numpy as np
from setuptools.command.build_ext import build_ext


@final
class BuildKernels(build_ext):
    """The usual command, which finds NumPy where the package is built."""

    def finalize_options(self) -> None:
        """Add the headers."""
        super().finalize_options()
        self.include_dirs.append(np.get_include())
