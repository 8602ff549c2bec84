"""Runs chosen tests with the oldest dependencies that are declared, or on a newer Python.

Run as ``python tests/other_versions.py install oldest PYTHON``, then ``... run oldest``, or
``newest`` instead, from the checkout.
"""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
FILES = ("kernels", "readme", "plotting", "solution", "high_order", "modes")


def oldest() -> list[str]:
    """Return the least versions in pyproject.toml: numpy>=2.0 means numpy 2.0.*."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return [f"{x.replace('>=', '==')}.*" for x in project["dependencies"] if ";" not in x]


def folder(which: str) -> Path:
    return ROOT / f".venv-{which}"


def install(which: str, python: str) -> None:
    # Debian's Python has no pip of its own: the one that runs this serves both.
    subprocess.run([python, "-m", "venv", "--without-pip", folder(which)], check=True)
    versions = oldest() if which == "oldest" else []
    needed = [*versions, "-e", ROOT, "pytest", "hypothesis"]
    own = folder(which) / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", own, "install", "--quiet"]
    subprocess.run([*pip, *needed], check=True)


def run(which: str) -> None:
    own = folder(which) / "bin" / "python"
    tests = [f"tests/test_{name}.py" for name in FILES]
    # Old versions of other packages warn of each other; the tests of .ci/run run elsewhere.
    options = ["-q", "-W", "ignore::DeprecationWarning", "-k", "not spatial and not test_ci"]
    subprocess.run([own, "-m", "pytest", *options, *tests], cwd=ROOT, check=True)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["install", which, python]:
            install(which, python)
        case ["run", which]:
            run(which)
        case _:
            sys.exit(__doc__)
