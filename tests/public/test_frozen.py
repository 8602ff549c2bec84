"""Data of the library is frozen: what a user holds does not change under the hand."""

import dataclasses
import importlib
import inspect
import pkgutil

import ancfdae

# Counters of a search; the last evaluation, kept for SciPy, which asks for its parts one by one.
CHANGING = {"SearchCounts"}


def test_every_dataclass_is_frozen():
    modules = [
        importlib.import_module(module.name)
        for module in pkgutil.walk_packages(ancfdae.__path__, "ancfdae.")
        if not module.name.endswith("bindings")  # of sundials4py
    ]
    classes = {x for module in modules for x in vars(module).values() if inspect.isclass(x)}
    found = {x for x in classes if dataclasses.is_dataclass(x) and "ancfdae" in x.__module__}
    assert len(found) > 100
    assert {x.__name__ for x in found if not x.__dataclass_params__.frozen} == CHANGING
