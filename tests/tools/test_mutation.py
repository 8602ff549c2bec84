"""The mutation tool chooses tests that exist for each module that it changes."""

import tomllib
from pathlib import Path

from tests.tools.mutation import TESTS, package

ROOT = Path(__file__).parents[2]


def test_every_module_that_is_changed_has_tests_and_every_group_a_module():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    found = set()
    for name in settings["cosmic-ray"]["module-path"]:
        modules = [ROOT / name] if name.endswith(".py") else (ROOT / name).rglob("*.py")
        paths = [path.relative_to(ROOT) for path in modules]
        assert paths
        found |= {package(path) for path in paths}
    assert found == set(TESTS)
    chosen = {word for tests in TESTS.values() for test in tests for word in test if "/" in word}
    assert not [path for path in chosen if not (ROOT / path).is_file()]
