"""The contracts between layers (`[tool.importlinter]`, pyproject.toml) refuse forbidden imports.

And tests import what they share from helper modules, none from another test.
"""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LAYERS = "A room of ancfdae imports only from those below it"
INJECTIONS = [
    ("model/scene.py", "from ancfdae.integrators.integrator import Integrator", LAYERS),
    ("model/scene.py", "from ancfdae.equations.system import MechanicalSystem", LAYERS),
    ("model/scene.py", "import matplotlib", "Only ancfdae.plotting imports matplotlib"),
    ("model/joints/joint.py", "from ancfdae.equations.system import MechanicalSystem", LAYERS),
    ("integrators/hht/method.py", "from ancfdae.sensitivity.observables import position", LAYERS),
    (
        "assembly/parameters.py",
        "from ancfdae.equations import MechanicalSystem",
        "Of the assembler only the assembled system, its names",
    ),
    (
        "sensitivity/adjoint.py",
        "from ancfdae.model.scene import Scene",
        "Integrators and sensitivity methods know the equations, no scene and no beam",
    ),
    (
        "numerics/arrays.py",
        "from validation.scenes import pendulum",
        "The library does not know its validation reports",
    ),
    (
        "equations/conformance.py",
        "import sksundae",
        "Only ancfdae.integrators.sundials.ida imports sksundae",
    ),
    (
        "studies/responses.py",
        "import openmdao",
        "Only ancfdae.studies.openmdao imports openmdao",
    ),
    ("integrators/start.py", "from ancfdae.integrators import hht", "Layers of the integrators"),
    (
        "integrators/step_control/contracts.py",
        "from ancfdae.integrators.hht.equations import Coefficients",
        "Layers of the integrators",
    ),
    (
        "integrators/step_control/contracts.py",
        "from ancfdae.integrators.step_control.steps import FixedSteps",
        "Layers of step control, which knows no method",
    ),
    ("statics/balance.py", "from ancfdae.statics import softness", "Layers of statics"),
    ("statics/balance.py", "from ancfdae.integrators import HHT", LAYERS),
    ("assembly/naming.py", "from ancfdae.assembly import system", "Layers of the assembler"),
    (
        "model/laws/law.py",
        "from ancfdae.model.loads import PointForce",
        "Layers of the model",
    ),
    (
        "equations/system.py",
        "from ancfdae.equations.conformance import prove",
        "Layers of the equations",
    ),
    (
        "sensitivity/observables/mass.py",
        "from ancfdae.sensitivity.objectives import Integral",
        "Layers of the sensitivities",
    ),
    ("modes/dense.py", "from ancfdae.modes.analysis import solve", "Layers of modes"),
    (
        "modes/analysis.py",
        "from ancfdae.model.scene import Scene",
        "Integrators and sensitivity methods know the equations, no scene and no beam",
    ),
]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Copy what the contracts speak of."""
    for package in ("ancfdae", "validation"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def broken(tree: Path) -> tuple[list[str], str]:
    """Return the contracts that a tree breaks, their names on one line each, and the report."""
    command = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [command, "--no-cache"],
        cwd=tree,
        env={"COLUMNS": "1000"},  # Long names would be wrapped.
        capture_output=True,
        text=True,
        check=False,
    )
    names = re.findall(r"^(.+) BROKEN\b", done.stdout, re.MULTILINE)
    kept = re.search(r"Contracts: (\d+) kept, (\d+) broken", done.stdout)
    assert kept, done.stdout + done.stderr
    assert (len(names), bool(names)) == (int(kept[2]), done.returncode != 0)
    return names, done.stdout


def test_the_tree_as_it_is_keeps_every_contract(tree: Path) -> None:
    assert broken(tree)[0] == []


def rounds() -> list[list[tuple[str, str, str]]]:
    """Return the injections in rounds, in each of which a contract is broken once."""
    told: list[list[tuple[str, str, str]]] = []
    for injection in INJECTIONS:
        free = (each for each in told if injection[2] not in {contract for _, _, contract in each})
        chosen = next(free, None)
        if chosen is None:
            told.append(chosen := [])
        chosen.append(injection)
    return told


@pytest.mark.parametrize("injections", rounds())
def test_an_import_across_layers_is_refused(
    tree: Path, injections: list[tuple[str, str, str]]
) -> None:
    for module, line, _ in injections:
        path = tree / "ancfdae" / module
        path.write_text(f"{path.read_text(encoding='utf-8')}\n{line}\n", encoding="utf-8")
    names, report = broken(tree)
    for module, line, contract in injections:
        assert any(name.startswith(contract) for name in names), contract
        importer = f"ancfdae.{module.removesuffix('.py').replace('/', '.')}"
        assert f"{importer} -> {line.split()[1]}" in report


def test_every_contract_has_an_import_that_breaks_it() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    names = re.findall(r'importlinter\.contracts\]\]\n(?:#.*\n)*name = "(.+)"', text)
    assert len(names) == text.count("[[tool.importlinter.contracts]]")
    for name in names:
        assert any(name.startswith(contract) for _, _, contract in INJECTIONS), name


def imported(source: str) -> set[str]:
    """Return every part of the names of modules that a source imports."""
    modules = [
        name
        for node in ast.walk(ast.parse(source))
        for name in (
            [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else []
        )
    ]
    return {part for module in modules for part in module.split(".")}


def test_no_module_of_the_tests_imports_a_test() -> None:
    assert "test_a" in imported("def f():\n    from tests.test_a import x")
    for path in (ROOT / "tests").rglob("*.py"):
        names = imported(path.read_text(encoding="utf-8"))
        tests = names & {test.stem for test in (ROOT / "tests").rglob("test_*.py")}
        assert not tests, f"{path.name} imports {tests}: move what they share to a helper module"


def test_studies_and_reports_read_no_clock_but_that_of_timing():
    readers = [
        path
        for folder in (ROOT / "ancfdae/studies", ROOT / "validation")
        for path in sorted(folder.rglob("*.py"))
        if re.search(r"^\s+[^#\"]*\btime\.(process_time|perf_counter)\(", path.read_text(), re.M)
    ]
    assert not readers
