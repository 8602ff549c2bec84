"""Calls that last show a progress bar if they are asked to, which counts what they do."""

import re

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    FrequencyMisfit,
    Material,
    Misfit,
    Pin,
    PointForce,
    Responses,
    RotatingFrame,
    Scene,
    StaticMisfit,
    Terminal,
    campbell,
    critical_load,
    taylor_test,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import position
from ancfdae.sections import Circle, Rectangle

ROD = Beam("rod", (0, 0), (1, 0), 4, Rectangle(0.02, 0.02), Material(1000, 1e7, 0.3))
COLUMN = Scene(
    [ROD], [Clamp(ROD.at_start)], loads=[PointForce(ROD.at_end, (-1e-3, 0), name="load")]
)
PENDULUM = Scene([ROD], [Pin(ROD.at_start)], gravity=(0, -9.81))
SHAFT = Beam("shaft", (0, 0, 0), (1, 0, 0), 2, Circle(0.02), Material(7850, 2e11, 0.3))
SPUN = Scene([SHAFT], [Clamp(SHAFT.at_start)], frame=RotatingFrame(0.0, (1, 0, 0)))
TIP = position(ROD.at_end, 1)
RUN = (PENDULUM, Terminal(TIP), 1 / 16, HHT(1 / 64))
DESIGN = ["rod.height"]


def designs(progress):
    """Three designs of each fit, one of them twice."""
    static = StaticMisfit([TIP], [0.0]).fit(COLUMN, design=DESIGN, progress=progress)
    moving = Misfit([TIP], [1 / 16], [[0.0]]).fit(
        PENDULUM, 1 / 16, HHT(1 / 64), design=DESIGN, progress=progress
    )
    tuned = FrequencyMisfit([5.0]).fit(COLUMN, design=DESIGN, progress=progress)
    for fit in (static, moving, tuned):
        for factor in (1.0, 1.1, 1.1, 1.2):
            fit.residuals(factor * fit.start)
            fit.jacobian(factor * fit.start)
    functions = {"tip": Terminal(TIP)}
    seen = Responses(PENDULUM, functions, 1 / 16, HHT(1 / 64), design=DESIGN, progress=progress)
    for factor in (1.0, 1.1, 1.2):
        seen.values(factor * seen.start)


CALLS = {
    "campbell": (lambda p: campbell(SPUN, [0.0, 10.0, 20.0], 2, progress=p), "3/3"),
    "taylor_test": (lambda p: taylor_test(*RUN, design=DESIGN, progress=p), "3/3"),
    "designs": (designs, "3design"),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_bar_counts_only_on_request(name, capsys):
    call, end = CALLS[name]
    call(False)
    assert capsys.readouterr().err == ""
    call(True)
    shown = capsys.readouterr().err.replace(" ", "")
    assert end in shown
    if name == "designs":
        assert shown.count("3design[") >= 4
        assert "\r4design" not in shown


def test_the_bar_of_a_search_ends_at_the_part_of_the_way_to_the_critical_load(capsys):
    """Euler's load of the clamped column, pi^2 E I/(4 L^2), lies at a third of the range."""
    euler = np.pi**2 / 4 * 1e7 * 0.02**4 / 12
    found = critical_load(COLUMN, "load.force_x", -3 * euler, progress=True)
    assert found.value == pytest.approx(-euler, rel=2e-3)
    lines = re.split(r"[\r\n]", capsys.readouterr().err)
    parts = [int(x[1]) for line in lines if (x := re.search(r"load.force_x: +(\d+)%", line))]
    assert 20 < parts[-1] <= 33
    assert parts == sorted(parts)


@pytest.mark.parametrize("name", CALLS)
def test_progress_is_yes_or_no(name):
    with pytest.raises(InvalidInputError, match="progress"):
        CALLS[name][0]("yes")
