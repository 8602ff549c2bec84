"""Every report runs through with coarse settings and leaves finite figures."""

import importlib.util
import json

import pytest

from ancfdae import plotting
from validation.__main__ import main
from validation.catalogue import CATALOGUE


@pytest.mark.parametrize("definition", CATALOGUE, ids=lambda definition: definition.name)
def test_quick_report_is_written_with_its_figures_and_plots(
    definition, tmp_path, capsys, monkeypatch
):
    if definition.name != "pendulum":  # One report writes its plots as PNG, too.
        save = plotting.save
        monkeypatch.setattr(plotting, "save", lambda x, path: save(x, f"{path}.svg"))
    done = main(["run", definition.name, "--quick", "--out", str(tmp_path)])
    peers = all(map(importlib.util.find_spec, ("exudyn", "jax", "diffrax", "casadi", "qdldl")))
    if definition.name == "peers" and not peers:
        assert done == 1
        assert "pip install -e '.[peers]'" in capsys.readouterr().err
        return
    assert done == 0
    assert "report.md" in capsys.readouterr().out
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert results["figures"]
    missing = [key for key, value in results["figures"].items() if value is None]
    assert not missing
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert f"| what the {definition.prose.source} says |" in text
    for plot in tmp_path.glob("*.svg"):
        assert plot.name in text
