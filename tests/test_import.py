"""`import ancfdae` loads what every run needs; the rest is loaded where it is used."""

import subprocess
import sys

# SciPy loads its parts at their first use, which `import ancfdae` must not be.
HEAVY = {"matplotlib", "pandas", "sksundae", "sundials4py", "tqdm", "distributed"}
HEAVY |= {f"scipy.{part}" for part in ("sparse", "linalg", "interpolate", "integrate", "optimize")}


def test_import_loads_nothing_that_a_declared_scene_does_not_need() -> None:
    program = "import sys, ancfdae; print(*sys.modules)"
    call = [sys.executable, "-c", program]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    loaded = run.stdout.split()
    assert "ancfdae" in loaded
    assert HEAVY.isdisjoint(loaded)
