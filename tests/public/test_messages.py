"""What a user mistypes in calls is refused in the package's own words: cases that were found."""

import numpy as np
import pytest

from ancfdae import (
    BEAM_2D,
    HHT,
    Beam,
    Integral,
    Material,
    NodalState,
    Pin,
    Scene,
    assemble,
    differentiate,
    distributed_variables,
    load_solution,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import apply, custom, observe, position
from ancfdae.sections import Rectangle

ROD = Beam(
    "rod",
    start=(0.0, 0.0),
    end=(1.0, 0.0),
    elements=1,
    section=Rectangle(0.05, 0.04),
    material=Material(1000.0, 1e7, 0.3),
)
SCENE = Scene([ROD], joints=[Pin(ROD.at_start)], gravity=(0.0, -9.81))
TIP = position(ROD.at_end, 0)


@pytest.fixture(scope="module")
def solution():
    return differentiate(SCENE, 1 / 64, HHT(1 / 64), design=["rod.height"])


CALLS = {
    "observe text": (lambda s: observe("x", s), "observe, observable: must be of type Observable"),
    "observe an objective": (lambda s: observe(Integral(TIP), s), "without Integral or Terminal"),
    "observe of a scene": (lambda s: observe(TIP, SCENE), "observe, solution: must be of type"),
    "observe with a scene": (
        lambda s: observe(TIP, s, SCENE),
        "observe, system: must be of type Mech",
    ),
    "times that are text": (lambda s: s.at("x"), "times: must be an array of finite numbers"),
    "derivative of a number": (
        lambda s: s.derivative(3),
        "point: must be of type MaterialPoint; got 3",
    ),
    "file that is a number": (lambda s: s.save(3), "path of a solution: must be of type str or"),
    "load of a number": (lambda s: load_solution(3), "path of a solution: must be of type str or"),
    "no such folder": (lambda s: s.save("no/such/folder.npz"), "must lie in a folder that exists"),
    "no such file": (lambda s: load_solution("nowhere.npz"), "must exist; got 'nowhere.npz'"),
    "custom number": (lambda s: custom(3), "custom, function: must be a function; got 3"),
    "custom named 3": (lambda s: custom(np.sin, 3), "custom, name: must be of type str; got 3"),
    "apply number": (lambda s: apply(3, TIP), "apply, function: must be a function; got 3"),
    "count as text": (
        lambda s: distributed_variables("rod.height", "3"),
        "count: must be a positive int",
    ),
    "count below one": (
        lambda s: distributed_variables("rod.height", -2),
        "count: must be a positive int",
    ),
    "project_start": (
        lambda s: Scene([ROD], project_start="no"),
        "Scene.project_start: must be True or False",
    ),
    "assemble": (lambda s: Scene([ROD], assemble="no"), "Scene.assemble: must be True or False"),
}


@pytest.mark.parametrize("name", CALLS)
def test_call_is_refused(name, solution, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, message = CALLS[name]
    with pytest.raises(InvalidInputError, match=message):
        call(solution)
    assert list(tmp_path.iterdir()) == []


NODES = assemble(SCENE).start()[0].reshape(2, BEAM_2D.n_s, 2)


@pytest.mark.parametrize(
    "nodes",
    {
        "zeros": 0 * NODES,
        "no slope across": NODES * [[1], [1], [0]],
        "section along the centre line": NODES[:, [0, 1, 1]],
        "inside out": NODES * [[1], [1], [-1]],
    }.values(),
)
def test_nodes_without_a_section_are_refused(nodes):
    with pytest.raises(InvalidInputError, match="start of 'rod', coordinates: slopes must span"):
        Scene([ROD], start=[NodalState("rod", nodes)])
    # A shear or a stretch is none of them, in whatever units.
    sheared = 1e-9 * (NODES + 0.8 * NODES[:, [0, 2, 1]] * [[0], [0], [1]])
    Scene([ROD], start=[NodalState("rod", sheared)])
