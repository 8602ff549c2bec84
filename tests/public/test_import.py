"""`import ancfdae` loads nothing; its names load what they need, the rest where it is used."""

import ast
import builtins
import subprocess
import sys
import types
from pathlib import Path

import ancfdae
from ancfdae.facade import PARTS, listed_names, public_names

# SciPy loads its parts at their first use, which an import must not be.
HEAVY_PARTS = ("sparse", "linalg", "special", "interpolate", "integrate", "optimize")
HEAVY = {f"scipy.{part}" for part in HEAVY_PARTS}


def packages_after(program: str) -> set[str]:
    """Packages that a program loads in a new process, beyond those of an empty one."""
    loaded, told = [], "print(*(x for x, m in sys.modules.items() if hasattr(m, '__path__')))"
    for each in ("", program):
        call = [sys.executable, "-c", f"import sys\n{each}\n{told}"]
        run = subprocess.run(call, capture_output=True, text=True, check=True)
        loaded.append(set(run.stdout.split()))
    return loaded[1] - loaded[0]


def third_party(packages: set[str]) -> set[str]:
    """Return the top-level packages that belong neither to Python nor to this package."""
    return {name.partition(".")[0] for name in packages} - sys.stdlib_module_names - {"ancfdae"}


def test_the_import_alone_loads_no_other_package_and_no_room() -> None:
    loaded = packages_after("import ancfdae")
    assert third_party(loaded) == set()
    assert [name for name in loaded if name.startswith("ancfdae")] == ["ancfdae"]


def test_all_public_names_load_numpy_and_scipy_and_no_part_of_scipy() -> None:
    loaded = packages_after("from ancfdae import *")
    assert third_party(loaded) == {"numpy", "scipy"}
    assert HEAVY.isdisjoint(loaded)


def test_a_first_assembly_and_step_load_no_other_package_either() -> None:
    """A first assembly and step load nothing new: they take hundredths of a second, not tenths."""
    scene = "Scene([rod], [Pin(rod.at_start)], (0, -9.81))"
    rod = "Beam('rod', (0, 0), (1.2, 0), 6, Rectangle(0.02, 0.02), Material(5540, 1e7, 0.3))"
    run = f"rod = {rod}\nsimulate(assemble({scene}), 1e-3, HHT(1e-3))"
    before, after = (
        packages_after(f"from ancfdae import *\nfrom ancfdae.sections import *\n{x}")
        for x in ("", run)
    )
    assert {x for x in after - before if not x.startswith("ancfdae")} == set()


def test_the_names_of_a_first_program_load_no_study_of_another_kind() -> None:
    """Packages are imported without their modules; what an ended run is told is loaded then."""
    program = "from ancfdae import Scene, Beam, simulate, gradient, HHT"
    told = "print(*(x for x in sys.modules if x.startswith('ancfdae')))"
    call = [sys.executable, "-c", f"import sys\n{program}\n{told}"]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    others = ("fit", "ladder", "modes", "responses", "sweep", "tradeoff")
    unused = {f"ancfdae.studies.{name}" for name in others}
    unused |= {"ancfdae.modes.solver", "ancfdae.statics.critical", "ancfdae.plotting"}
    unused |= {f"ancfdae.integrators.sundials.{name}" for name in ("ida", "idas")}
    # A tenth of a second of the 0.25 s that these names may take (report `performance`).
    unused |= {"ancfdae.studies.accuracy", "ancfdae.integrators.radau", "ancfdae.statics"}
    unused |= {"ancfdae.integrators.explicit", "ancfdae.equations.conformance"}
    unused |= {"ancfdae.model.joints.drive", "ancfdae.model.loads.springs"}
    unused |= {"ancfdae.sensitivity.observables.sections", "ancfdae.equations.solution_file"}
    assert loaded & unused == set()
    packages = packages_after(program)
    assert third_party(packages) == {"numpy", "scipy"}
    assert HEAVY.isdisjoint(packages)
    assert "numpy.random" not in packages


def test_every_listed_name_is_the_one_of_its_module() -> None:
    modules = [ancfdae, *(getattr(ancfdae, part) for part in PARTS)]
    for module in modules:
        stub = Path(module.__file__).with_suffix(".pyi")
        for name, home in listed_names(stub).items():
            assert getattr(module, name) is getattr(sys.modules[home], name)
        (listed,) = (x for x in ast.parse(stub.read_text()).body if isinstance(x, ast.Assign))
        assert sorted(ast.literal_eval(listed.value)) == sorted(module.__all__)


def test_a_public_name_stands_in_one_module():
    listed = [name for part in PARTS for name in getattr(ancfdae, part).__all__]
    listed += ancfdae.__all__
    assert len(listed) == len(set(listed)) == len(public_names()) + 1  # and __version__


def test_a_module_of_the_name_of_a_function_does_not_replace_it() -> None:
    program = "import ancfdae.modes.solver, ancfdae; print(type(ancfdae.modes).__name__)"
    call = [sys.executable, "-c", program]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    assert run.stdout.split() == [types.FunctionType.__name__]


def test_a_star_import_replaces_no_module_and_no_builtin() -> None:
    """People write ``from ancfdae import *`` beside ``import time``."""
    assert {"__version__"} == set(ancfdae.__all__) & {*dir(builtins), "__version__"}
    assert not set(ancfdae.__all__) & sys.stdlib_module_names
