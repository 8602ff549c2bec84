"""Flips in the compiled kernels (.github/CONTRIBUTING.md).

Run as ``python -m tests.tools.kernel_mutation NUMBER SEED``. Writes one wrong sign, number,
comparison or index at a time into the C++ sources, compiles without optimisation, and tells which
flips tests/kernels/test_kernels.py and tests/integrators/test_march.py let pass.
"""

import random
import re
import resource
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np

FOLDER = Path("ancfdae/kernels")
LIBRARY = FOLDER / f"_kernels{sysconfig.get_config_var('EXT_SUFFIX')}"
INCLUDES = [f"-I{sysconfig.get_paths()['include']}", f"-I{np.get_include()}"]
COMPILE = [
    "g++",
    "-std=c++17",
    "-O0",
    "-w",
    "-shared",
    "-fPIC",
    *INCLUDES,
    str(FOLDER / "kernels.cpp"),
]
TESTS = [
    "tests/kernels/test_kernels.py",
    "tests/integrators/test_march.py",
    "-x",
    "-q",
    "-p",
    "no:cacheprovider",
    "-p",
    "no:xdist",
]
SECONDS = 120  # Of processor time: a loop that never ends is killed.
# What is flipped, and into what; digits that are whole words become the next one.
FLIPS = {"+=": "-=", "-=": "+=", " + ": " - ", " - ": " + ", " < ": " <= ", " > ": " >= "}
FLIPS |= {" == ": " != ", " != ": " == ", " && ": " || ", " || ": " && "}
PLACES = re.compile("|".join(map(re.escape, FLIPS)) + r"|\b\d\b")
COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*|\"[^\"\n]*\"|^#[^\n]*", re.DOTALL | re.MULTILINE)


def flips(path):
    """Every flip of a file as (path, place, length of the old text, new text)."""
    text = path.read_text()
    code = COMMENT.sub(lambda x: re.sub(r"[^\n]", "\0", x[0]), text)
    for found in PLACES.finditer(code):
        old = found[0]
        yield path, found.start(), len(old), FLIPS.get(old) or str(int(old) + 1)


def survives(path, place, length, new):
    """Whether the tests pass with a flip; what does not compile is None."""
    text = path.read_text()
    try:
        path.write_text(text[:place] + new + text[place + length :])
        if subprocess.run([*COMPILE, "-o", LIBRARY], capture_output=True).returncode:
            return None
        run = [sys.executable, "-m", "pytest", *TESTS]
        return subprocess.run(run, capture_output=True, preexec_fn=_limit).returncode == 0
    finally:
        path.write_text(text)


def _limit():
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))


def main(number, seed):
    found = [
        x for path in sorted([*FOLDER.glob("*.h"), *FOLDER.glob("*.cpp")]) for x in flips(path)
    ]
    words = {None: "does not compile", True: "SURVIVES", False: "killed"}
    outcomes = []
    for path, place, length, new in random.Random(seed).sample(found, int(number)):
        outcomes.append(survives(path, place, length, new))
        text = path.read_text()
        row, old = text[:place].count("\n"), text[place : place + length]
        line = text.splitlines()[row].strip()
        what = f"{path.name}:{row + 1} {old!r} to {new!r} in {line}"
        print(f"{words[outcomes[-1]]}: {what}", flush=True)
    print(f"{outcomes.count(False)} killed, {outcomes.count(True)} survive, of {len(found)} flips")


if __name__ == "__main__":
    main(*sys.argv[1:])
