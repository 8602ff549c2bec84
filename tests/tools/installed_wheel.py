"""Builds sdist and wheel and uses the wheel alone: README's program and the tutorial.

Run as ``python -m tests.tools.installed_wheel`` from the checkout. The wheel is built from the
sdist, so that a file missing there is missed here.
"""

import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

from tests.support.documents import README, ROOT, python_blocks

TUTORIAL = ROOT / "docs" / "tutorial"

# Imports every module: none needs the checkout, and one that needs an extra says how to get it.
IMPORT_ALL = """
import importlib, importlib.util, pathlib, pkgutil, sys
import ancfdae
assert pathlib.Path(ancfdae.__file__).is_relative_to(sys.prefix), ancfdae.__file__
assert importlib.util.find_spec("validation") is None
for module in pkgutil.walk_packages(ancfdae.__path__, "ancfdae."):
    try:
        importlib.import_module(module.name)
    except ancfdae.errors.MissingPackageError as error:
        assert "pip install" in str(error), error
"""


def run(*command: object, folder: Path) -> None:
    subprocess.run([str(word) for word in command], cwd=folder, check=True)


def check_names(wheel: Path) -> None:
    """Refuse a wheel that installs more than the package, or lacks what goes with it."""
    names = zipfile.ZipFile(wheel).namelist()
    top = {name.split("/")[0] for name in names}
    stray = {name for name in top if name != "ancfdae" and not name.endswith(".dist-info")}
    assert not stray, f"the wheel installs {sorted(stray)}"
    for needed in ("ancfdae/py.typed", "licenses/LICENSE"):
        assert any(name.endswith(needed) for name in names), f"the wheel lacks {needed}"


def check_sdist(sdist: Path) -> None:
    """Refuse an sdist that lacks a module or a text of the checkout."""
    with tarfile.open(sdist) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    modules = (path.relative_to(ROOT).as_posix() for path in (ROOT / "ancfdae").rglob("*.py"))
    missing = {*modules, "README.md", "LICENSE", "pyproject.toml"} - names
    assert not missing, f"the sdist lacks {sorted(missing)}"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(sys.executable, "-m", "build", "--outdir", folder, ROOT, folder=folder)
        (wheel,) = folder.glob("*.whl")
        check_names(wheel)
        (sdist,) = folder.glob("*.tar.gz")
        check_sdist(sdist)
        run(sys.executable, "-m", "venv", "clean", folder=folder)
        python = folder / "clean" / "bin" / "python"
        run(python, "-m", "pip", "install", "--quiet", wheel, folder=folder)
        first = python_blocks("README.md", README.read_text())[0].code
        tutorial = [path.read_text() for path in sorted(TUTORIAL.glob("step_*.py"))]
        for program in (IMPORT_ALL, first, *tutorial):
            # Isolated: neither the checkout nor PYTHONPATH is seen.
            run(python, "-I", "-W", "error", "-c", program, folder=folder)


if __name__ == "__main__":
    main()
