"""Files on a full disk: a clear error, what was there before, and a process that lives."""

import subprocess
import sys
import textwrap

import pytest

from ancfdae import HHT, load_solution, simulate
from validation.scenes import pendulum

# No file may grow beyond this, which a system tells like a full disk; bytes.
LIMIT = 20_000

FULL = f"""
import resource, sys
from pathlib import Path
import numpy as np
from ancfdae import HHT, load_solution, plotting, record_observables, sweep
from ancfdae.errors import SaveError
from ancfdae.observables import position
from validation.scenes import pendulum
from tests.support.mechanisms import CartesianPendulum

folder, system = Path(sys.argv[1]), CartesianPendulum()
solution = load_solution(folder / "run.npz")
resource.setrlimit(resource.RLIMIT_FSIZE, ({LIMIT}, {LIMIT}))

def refused(call):
    try:
        call()
    except SaveError as error:
        print(error)

for name in ("new.npz", "new.h5", "run.npz", "run.h5"):
    refused(lambda: solution.save(folder / name))
drop = [position(pendulum().beams[0].at_end, 1)]
x = folder / "x.npy"
refused(lambda: record_observables(pendulum(), drop, 32.0, HHT(2.0**-6), keep=1, file=x))
rows = folder / "rows.jsonl"
refused(lambda: sweep(system, [[1.0, 9.0], [2.0, 9.0]], lambda s: np.ones(3000), file=rows))
scene, shown = pendulum(elements=1), solution.at(np.linspace(0, 1, 40))
for name in ("film.gif", "page.html"):
    refused(lambda: plotting.animate(scene, shown, folder / name))
figure = plotting.snapshots(scene, shown, times=np.linspace(0, 1, 20))
refused(lambda: plotting.save(figure, folder / "figure"))
refused(lambda: plotting.write_vtk(scene, shown, folder / "motion.pvd"))
print("alive")
"""
# What is written whole or not at all, and stands there before.
OLD = ("x.npy", "film.gif", "page.html", "figure.svg", "figure.png", "motion.pvd")


def test_a_full_disk_is_told_and_harms_nothing(tmp_path):
    pytest.importorskip("h5py")
    run = simulate(pendulum(elements=1), 1.0, HHT(2.0**-7))
    for name in ("run.npz", "run.h5"):
        assert run.save(tmp_path / name).stat().st_size > 2 * LIMIT
    for name in OLD:
        (tmp_path / name).write_bytes(b"old")
    (tmp_path / "motion").mkdir()
    (tmp_path / "motion" / "00000.vtu").write_bytes(b"old")
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(FULL), tmp_path], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    *refused, last = done.stdout.splitlines()
    assert last == "alive"
    names = ["new.npz", "new.h5", "run.npz", "run.h5", "x.npy", "rows.jsonl"]
    names += ["film.gif", "page.html", "figure.svg", "motion.pvd"]
    for name, line in zip(names, refused, strict=True):
        assert name in line
        assert "must be written whole; got File too large" in line
    left = sorted({*names[2:], *OLD, "motion"})
    assert sorted(path.name for path in tmp_path.iterdir()) == left
    assert all((tmp_path / name).read_bytes() == b"old" for name in OLD)
    assert [x.read_bytes() for x in (tmp_path / "motion").iterdir()] == [b"old"]
    for name in ("run.npz", "run.h5"):
        assert (load_solution(tmp_path / name).q == run.q).all()
    # The first line and a whole row of an array of 3,000 ones in 15,000 bytes; nothing of another.
    assert len((tmp_path / "rows.jsonl").read_text().splitlines()) == 2
    assert (tmp_path / "rows.jsonl").read_text().endswith("\n")
