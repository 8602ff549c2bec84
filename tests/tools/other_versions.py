"""Runs tests with the oldest dependencies that are declared, with IDAS, or on the newest Python.

Run as ``python -m tests.tools.other_versions install oldest PYTHON``, then ``... run oldest``;
``idas`` or ``newest`` instead of ``oldest``; from a checkout whose kernels are built: the stable
ABI of Python lets every version use that one build. ``... extras docs jax`` installs what those
extras of the package need into the environment that runs this, without another build.
"""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILES = ("kernels", "readme", "plotting", "solution", "high_order", "modes")
TESTS = sorted((ROOT / "tests").rglob("test_*.py"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Old versions of other packages warn of each other; the tests of .ci/run run elsewhere.
CHOSEN = [
    *("-q", "-W", "ignore::DeprecationWarning", "-k", "not spatial and not test_ci"),
    *(str(path) for path in TESTS if path.stem.removeprefix("test_") in FILES),
]


def oldest() -> list[str]:
    """Return the least versions in pyproject.toml: numpy>=2.0 means numpy 2.0.*."""
    return [f"{x.replace('>=', '==')}.*" for x in PROJECT["dependencies"] if ";" not in x]


def needed(which: str) -> list[str]:
    """Return what pip installs beside the package."""
    if which == "idas":
        return [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["test"]]
    versions = oldest() if which == "oldest" else PROJECT["dependencies"]
    return [*versions, "pytest", "hypothesis"]


def folder(which: str) -> Path:
    return ROOT / f".venv-{which}"


def install(which: str, python: str) -> None:
    # Debian's Python has no pip of its own: the one that runs this serves both.
    subprocess.run([python, "-m", "venv", "--without-pip", folder(which)], check=True)
    own = folder(which) / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", own, "install", "--quiet"]
    subprocess.run([*pip, *needed(which)], check=True)
    (packages,) = (folder(which) / "lib").glob("python*/site-packages")
    (packages / "ancfdae.pth").write_text(f"{ROOT}\n")


def extras(names: list[str]) -> None:
    requirements = [x for name in names for x in PROJECT["optional-dependencies"][name]]
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", *requirements], check=True)


def run(which: str) -> None:
    own = folder(which) / "bin" / "python"
    marked = [str(path) for path in TESTS if "pytest.mark.idas" in path.read_text()]
    chosen = ["-m", "idas", *marked] if which == "idas" else CHOSEN
    subprocess.run([own, "-m", "pytest", *chosen], cwd=ROOT, check=True)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["install", which, python]:
            install(which, python)
        case ["extras", *names]:
            extras(names)
        case ["run", which]:
            run(which)
        case _:
            sys.exit(__doc__)
