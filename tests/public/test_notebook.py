"""Results and films show in the cells of a notebook; the notebook of the docs runs."""

import base64
import html
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ancfdae import HHT, Beam, Material, Pin, Scene, simulate
from ancfdae.plotting import Film, animate
from ancfdae.sections import Rectangle
from tests.support.documents import ROOT

ROD = Beam("rod", (0, 0), (0.4, 0), 2, Rectangle(0.02, 0.02), Material(1100, 5e6, 0.45))
SCENE = Scene([ROD], [Pin(ROD.at_start)], gravity=(0, -9.81))


@pytest.fixture(scope="module")
def run():
    return simulate(SCENE, 0.1, HHT(1 / 64))


def test_a_page_shows_in_a_frame_that_holds_it_whole(run, tmp_path):
    film = animate(SCENE, run, tmp_path / "swing.html", frames=2)
    shown = film._repr_html_()
    inside = re.search(r'srcdoc="([^"]*)"', shown)[1]
    assert html.unescape(inside) == film.path.read_text(encoding="utf-8")


def test_a_gif_is_embedded_byte_by_byte(run, tmp_path):
    film = animate(SCENE, run, tmp_path / "swing.gif", frames=2, dpi=30)
    data = re.search(r'src="data:image/gif;base64,([^"]*)"', film._repr_html_())[1]
    assert base64.b64decode(data) == film.path.read_bytes()
    assert Path(film) == tmp_path / "swing.gif"


def test_a_film_as_mp4_has_controls(tmp_path):
    (tmp_path / "swing.mp4").write_bytes(b"film")
    shown = Film(tmp_path / "swing.mp4")._repr_html_()
    assert shown == '<video controls src="data:video/mp4;base64,ZmlsbQ=="></video>'


def test_the_notebook_of_the_docs_runs_and_shows_tables_and_the_film(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="needs nbformat: pip install ancfdae[test]")
    nbclient = pytest.importorskip("nbclient", reason="needs nbclient: pip install ancfdae[test]")
    pytest.importorskip("ipykernel", reason="needs ipykernel: pip install ancfdae[test]")
    notebook = nbformat.read(ROOT / "docs" / "notebook.ipynb", as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    # The kernel of this interpreter, whatever others the machine has.
    subprocess.run(
        [sys.executable, "-m", "ipykernel", "install", "--prefix", str(tmp_path), "--name", "own"],
        check=True,
        capture_output=True,
    )
    kernels = str(tmp_path / "share" / "jupyter")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JUPYTER_PATH", kernels)
        patch.setenv("PYTHONPATH", f"{ROOT}:{':'.join(sys.path)}")
        client = nbclient.NotebookClient(
            notebook,
            timeout=120,
            kernel_name="own",
            resources={"metadata": {"path": str(tmp_path)}},
        )
        client.execute()
    shown = [
        output.data.get("text/html", output.data["text/plain"])
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if output.output_type == "execute_result"
    ]
    assert "<td>beam.youngs_modulus</td>" in shown[0]
    assert "<iframe srcdoc=" in shown[1]
    assert "natural frequency" in shown[2]
    assert "d/d beam.height" in shown[2]
    assert shown[3].endswith("mm'")
    assert np.size(shown) == 4
    assert (tmp_path / "swing.html").exists()
