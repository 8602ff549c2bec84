"""`import ancfdae` loads what every run needs; the rest is loaded where it is used."""

import builtins
import subprocess
import sys

import ancfdae

# SciPy loads its parts at their first use, which `import ancfdae` must not be.
HEAVY = {"matplotlib", "pandas", "sksundae", "sundials4py", "tqdm", "distributed"}
HEAVY |= {
    f"scipy.{part}"
    for part in ("sparse", "linalg", "special", "interpolate", "integrate", "optimize")
}


def test_import_loads_nothing_that_a_declared_scene_does_not_need() -> None:
    program = "import sys, ancfdae; print(*sys.modules)"
    call = [sys.executable, "-c", program]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    loaded = run.stdout.split()
    assert "ancfdae" in loaded
    assert HEAVY.isdisjoint(loaded)


def test_a_star_import_replaces_no_module_and_no_builtin() -> None:
    """People write ``from ancfdae import *`` beside ``import time``."""
    assert {"__version__"} == set(ancfdae.__all__) & {*dir(builtins), "__version__"}
    assert not set(ancfdae.__all__) & sys.stdlib_module_names
