"""Elements and integrators from outside the package: what the how-to page does not run."""

import re
from pathlib import Path

import numpy as np
import pytest

from ancfdae import HHT, Terminal, gradient, load_solution, simulate, sweep
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.observables import position
from tests.tools.call_path import ROOT, passed, run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "howto" / "own-parts.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def names(first):
    """Run the block of the page that begins with a class, and return what it made."""
    (block,) = (each for each in BLOCKS if first in each)
    made = {"__name__": "own_parts"}
    exec(block, made)
    return made


@pytest.fixture(scope="module")
def string():
    return names("class String(BeamElement)")


def test_a_file_of_an_own_element_is_read_with_it(string, tmp_path):
    run = simulate(string["hanging"], 2.0**-5, HHT(2.0**-7))
    file = run.save(tmp_path / "run.npz")
    again = load_solution(file, elements=[string["STRING"]])
    assert np.array_equal(
        again.position(string["rope"].at_end), run.position(string["rope"].at_end)
    )
    with pytest.raises(UnknownNameError, match=r"'STRING_2D'.*BEAM_2D"):
        load_solution(file)
    with pytest.raises(InvalidInputError, match="load_solution, elements"):
        load_solution(file, elements=["STRING_2D"])


def test_an_own_element_has_exact_gradients_and_sweeps(string):
    scene, end = string["hanging"], Terminal(position(string["rope"].at_end, 1))
    call = end, 2.0**-5, HHT(2.0**-7)
    found = gradient(scene, *call, design=["rope.length"]).gradient[0]
    moved = [
        gradient(scene.with_values({"rope.length": x}), *call, design=["rope.length"]).value
        for x in (1.999, 2.001)
    ]
    # The second differences are of the order of the step squared.
    assert found == pytest.approx((moved[1] - moved[0]) / 2e-3, rel=1e-5)
    assert sweep(scene, [{}], lambda model: model.beams[0].element.name).results == ["STRING_2D"]


def test_an_integrator_that_leaves_out_derivatives_is_told():
    made = names("class RungeKutta(Integrator)")

    class Careless(made["RungeKutta"]):
        def integrate(self, system, t_end, *, sensitivities=False, progress=False):
            return super().integrate(system, t_end, progress=progress)

    call = made["swing"], made["fall"], 0.25
    with pytest.raises(InvalidInputError, match="Careless: must integrate design derivatives"):
        gradient(*call, Careless(8), design=["rod.inertia"])
    with pytest.raises(InvalidInputError, match="RungeKutta: has no sensitivities"):
        gradient(*call, made["RungeKutta"](8), design=["rod.inertia"])
    # The compound pendulum: an independent method of fourth order agrees with it.
    value = made["result"].value
    assert value == pytest.approx(
        simulate(made["swing"], 0.25, HHT(rtol=1e-8)).position(made["rod"].at(0.5, 0))[-1, 1],
        rel=1e-6,
    )


def test_a_gradient_passes_the_files_to_read_and_few_others():
    run()  # What is made once a process is left out.
    calls = passed()
    files = {str(Path(code.co_filename).relative_to(ROOT)) for code in calls}
    listed = re.findall(r"^\| `(\w[\w/]*\.py)` \|", PAGE.read_text(), re.MULTILINE)
    assert len(listed) == 20
    assert not set(listed) - files
    # 90 and 586, 65 and 581 before: what a scene does not have is not visited.
    assert len(files) <= 64
    assert len(calls) <= 530
