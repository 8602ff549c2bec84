"""Programs of the gallery run, are short, draw a picture, and find what they say."""

import ast
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ancfdae import HHT, Terminal, equilibrium_gradient, gradient, simulate
from tests.support.documents import ROOT

GALLERY = ROOT / "docs" / "gallery"
Names = dict[str, Any]


def four_bar(x: Names) -> bool:
    """The coupler is stressed to the limit, and the mechanism is a quarter as heavy."""
    found, model = x["found"], x["model"]
    light = found.fun < 0.3 * model["mass"](model.start)
    return bool(light and abs(model["coupler"](found.x) - 1) < 1e-3)


def paper_crank_slider(x: Names) -> bool:
    """The derivatives of the position equal a central difference of the motion."""
    scene, rod, step = x["scene"], x["rod"], 1e-4
    ends = [
        simulate(scene.with_values({"rod.height": 0.05 * (1 + s * step)}), 1.0, HHT(2**-8))
        for s in (-1, 1)
    ]
    found = x["solution"].derivative(rod.at_end, "rod.height")[-1, 0]
    below, above = (run.position(rod.at_end)[-1, 0] for run in ends)
    return bool(abs((above - below) / (0.1 * step) - found) < 1e-4 * abs(found))


def tracked_arm(x: Names) -> bool:
    """The tip keeps within 6 mm of its path of 0.8 m, and torques within their bounds."""
    return x["miss"].max() < 6e-3 and np.abs(x["found"].x).max() <= 1.5


def net(x: Names) -> bool:
    """The vertical pulls of the four ropes to the ball carry its weight, to 1 %."""
    pull = equilibrium_gradient(x["scene"], x["pull"], design=["ball.mass"]).value
    rest, rope = x["rest"].solution, x["ropes"][x["n"] * (x["n"] // 2 - 1) + x["n"] // 2]
    first, last = rest.position(rope.at_start)[0], rest.position(rope.at_end)[0]
    down = abs(last[2] - first[2]) / np.linalg.norm(last - first)
    return bool(abs(4 * pull * down - 5 * 9.81) < 0.01 * 5 * 9.81)


def rotor(x: Names) -> bool:
    """A critical speed lies where forward whirl, as seen at rest, turns with the frame."""
    diagram = x["diagram"]
    speeds = [
        np.interp(c, diagram.rates, diagram.whirl_speeds[:, j])
        for c, j in zip(diagram.critical_speeds, (1, 4), strict=True)
    ]
    return bool(np.allclose(speeds, diagram.critical_speeds, rtol=2e-3))


def arch(x: Names) -> bool:
    """The arch gives way to one side while its crown still sinks under a growing force."""
    return x["snap"].kind == "bifurcation" and bool(np.all(np.diff(x["sag"]) > 0))


def fit(x: Names) -> bool:
    """The intervals hold the modulus and the retardation time with which the data were made."""
    limits = x["fit"].intervals(x["found"].x).values()
    return all(a < true < b for (a, b), true in zip(limits, (6e6, 8e-3), strict=True))


def magnet(x: Names) -> bool:
    """The strongest magnet catches the leaf, the others do not."""
    last = [series.y[len(series.y) // 2 :].min() for series in x["lines"]]
    return last[2] > 0.05 > max(last[:2])


def whirling_bead(x: Names) -> bool:
    """The bead comes to rest where cos(angle) = g/(w^2 R)."""
    found = gradient(x["Bead"](), Terminal(x["angle"]), 60.0, HHT(2**-6))
    return abs(found.value - np.arccos(9.81 / 18.0)) < 1e-4


def impact(x: Names) -> bool:
    """No impact brings the tip below the stop, and each one throws it back with e = 0.7."""
    run, tip = x["run"], x["points"]["tip"]
    before, after = (run.phases[k].velocity(tip)[i, 1] for k, i in ((0, -1), (1, 0)))
    return abs(after + 0.7 * before) < 1e-9 and run.position(tip)[:, 1].min() > -0.3 - 1e-9


def crane(x: Names) -> bool:
    """The load that swung by 3 m stays within a micrometre, at rest on arrival."""
    before, after = (np.ptp(series.y[series.x > x["t_end"]]) for series in x["lines"])
    return bool(before > 2.0 and after < 1e-6)


def controller(x: Names) -> bool:
    """Tuned gains cost less than the first ones."""
    return x["found"].fun < 0.9 * x["model"]["cost"](x["model"].start)


CHECKS: list[Callable[[Names], bool]] = [
    four_bar, paper_crank_slider, tracked_arm, net, rotor, arch, fit, magnet, whirling_bead,
    impact, crane, controller,
]  # fmt: skip


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_an_example_runs_and_finds_what_it_says(
    check: Callable[[Names], bool], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(GALLERY / f"{check.__name__}.py"))
    assert check(names), check.__doc__
    assert sorted(path.suffix for path in tmp_path.iterdir()) in ([".png"], [".png", ".png"])


def test_there_are_twelve_and_each_but_the_table_of_elements_is_under_forty_lines() -> None:
    programs = sorted(GALLERY.glob("*.py"))
    assert len(programs) >= 12
    for path in programs:
        text = path.read_text(encoding="utf-8")
        shown = text.split("\n")[ast.parse(text).body[0].end_lineno :]
        lines = [line for line in shown if line.strip() and not line.startswith("#")]
        assert len(lines) < 40 or path.stem == "elements", (path.name, len(lines))
