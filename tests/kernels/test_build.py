"""Installation from source where nothing can be compiled ends in one sentence."""

import pytest
from setuptools import Distribution, Extension

from ancfdae.kernels.build import BuildKernels


@pytest.mark.parametrize(
    ("compiler", "match"),
    [
        ("no-such-c++", "got none under the name 'no-such-c\\+\\+'"),
        ("false", "could not be compiled"),
    ],
)
def test_a_missing_or_failing_compiler_is_told_with_the_package(
    compiler, match, tmp_path, monkeypatch
):
    monkeypatch.setenv("CXX", compiler)
    source = tmp_path / "empty.cpp"
    source.touch()
    command = BuildKernels(Distribution({"ext_modules": [Extension("empty", [str(source)])]}))
    command.build_temp, command.build_lib = str(tmp_path), str(tmp_path)
    command.ensure_finalized()
    with pytest.raises(SystemExit, match=match) as stopped:
        command.run()
    assert "apt install g++" in str(stopped.value)
