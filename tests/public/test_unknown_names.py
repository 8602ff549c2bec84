"""Names that users reach for get an answer; arguments that look exchanged get a warning."""

import re
import subprocess
import sys
import warnings

import pytest

import ancfdae
import ancfdae.plotting
from ancfdae import Material
from ancfdae.errors import UnlikelyValueWarning
from ancfdae.errors.unknown_names import _ANSWERS, _RENAMED, answer
from ancfdae.facade import public_names
from tests.support.documents import ROOT


@pytest.mark.parametrize(
    ("name", "serves"),
    [
        ("Cable", "CABLE_2D"),
        ("Contact", "not supported"),
        ("Gear", "not supported"),
        ("time", "elapsed_time()"),
        ("accelerations", "solution.acceleration(point)"),
        ("acceleration", "from ancfdae.observables import acceleration"),
        ("ANCFCable2D", "CABLE_2D"),
        ("Simulate", "Did you mean ancfdae.simulate?"),
        ("Hinge", "Pin"),
        ("bending_momnet", "Did you mean ancfdae.observables.bending_moment"),
        ("zzz", "dir(ancfdae)"),
    ],
)
def test_an_unknown_name_is_answered_by_attribute_and_by_import(name, serves):
    with pytest.raises(AttributeError, match=re.escape(serves)):
        getattr(ancfdae, name)
    with pytest.raises(ImportError, match=re.escape(serves)):
        exec(f"from ancfdae import {name}")
    assert not hasattr(ancfdae, name)


def test_answers_name_calls_and_pages_that_exist():
    """Words with a parenthesis, and words with capitals inside or alone, are public names."""
    known = {*public_names(), *dir(ancfdae.plotting), "Solution", "SciPy", "step"}
    for text in set(_ANSWERS.values()):
        for page in re.findall(r"docs/\S+\.md", text):
            assert (ROOT / page).is_file(), page
        names = re.findall(r"(?<![\w.])(\w+)\(", text)
        names += re.findall(r"\b(?:[A-Z][a-z]+[A-Z]\w+|CABLE_\dD)\b", text)
        assert set(names) <= known, (set(names) - known, text)


def test_no_answer_hides_a_public_name():
    assert not set(_ANSWERS) & {name.lower() for name in public_names() if name not in ("step",)}


def test_answers_are_loaded_when_one_is_needed():
    program = (
        "import sys; from ancfdae import Beam, simulate; import ancfdae.plotting.shapes\n"
        "from ancfdae import studies\n"
        "print('ancfdae.errors.unknown_names' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.stdout.split() == ["False"], run.stderr


def test_private_names_and_modules_are_refused_in_plain_words():
    with pytest.raises(AttributeError, match="has no attribute '_x'"):
        ancfdae._x  # noqa: B018
    assert "Did you mean ancfdae.Beam or" in answer("Beem", "ancfdae")


@pytest.mark.parametrize(
    ("name", "serves"),
    [
        ("position", "It is: from ancfdae.observables import position."),
        ("Explicit", "It is called DOP853 now: from ancfdae import DOP853."),
        ("Ramp", "It is called SmoothStep now: from ancfdae.laws import SmoothStep."),
    ],
)
def test_a_name_of_old_or_of_another_module_is_told_where_it_is(name, serves):
    with pytest.raises(AttributeError, match=re.escape(serves)):
        getattr(ancfdae, name)
    with pytest.raises(AttributeError, match=re.escape(serves)):
        getattr(ancfdae.results, name)
    with pytest.raises(ImportError, match=re.escape(serves)):
        exec(f"from ancfdae.results import {name}")


def test_every_renamed_name_is_one_of_today():
    assert set(_RENAMED.values()) <= set(public_names())
    assert not set(_RENAMED) & set(public_names())


@pytest.mark.parametrize("values", [(2e11, 7850.0), (7e10, 2700.0), (1e7, 1.1e3)])
def test_a_density_that_looks_like_a_modulus_warns(values):
    with pytest.warns(
        UnlikelyValueWarning, match=r"order is Material\(density, youngs_modulus"
    ) as told:
        Material(*values, 0.3)
    assert told[0].filename == __file__


@pytest.mark.parametrize(
    ("length", "mass", "time"),
    [(1, 1, 1), (1e3, 1e-3, 1), (1e3, 1, 1e3), (1e2, 1e3, 1), (1e-3, 1, 1), (1e6, 1e9, 1e6)],
    ids=["SI", "mm t s", "mm kg ms", "cgs", "km kg s", "um ug us"],
)
def test_no_material_warns_in_any_usual_units(length, mass, time):
    """Steel, aluminium and soft rubber in units of 1/length m, 1/mass kg and 1/time s."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for rho, E in ((7850.0, 2.1e11), (2700.0, 7e10), (1000.0, 1e6)):
            Material(rho * mass / length**3, E * mass / length / time**2, 0.3)
