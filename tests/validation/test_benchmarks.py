"""Benchmarks whose history asv keeps run on today's package."""

import importlib.util
import inspect
import json
from itertools import product

import numpy as np

from tests.support.documents import ROOT


def load():
    spec = importlib.util.spec_from_file_location("speed", ROOT / "benchmarks" / "speed.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_ten_benchmarks_run():
    speed, ran = load(), []
    for name, kind in inspect.getmembers(speed, inspect.isclass):
        if kind.__module__ != "speed":
            continue
        for arguments in product(*getattr(kind, "params", ())):
            it = kind()
            getattr(it, "setup", lambda *_: None)(*arguments)
            for member in vars(kind):
                if member.startswith("time_"):
                    getattr(it, member)(*arguments)
                    ran.append((name, member, *arguments))
    assert len(ran) == len(set(ran)) == 10


def test_runs_that_are_measured_reach_their_end():
    speed = load()
    for make, steps in speed.SCENES.values():
        run = speed.simulate(make(), 2 * speed.STEP, speed.HHT_I3)
        assert run.outcome.success
        assert np.all(np.isfinite(run.q))
        assert steps >= 8


def test_asv_finds_the_benchmarks():
    settings = json.loads((ROOT / "asv.conf.json").read_text(encoding="utf-8"))
    assert (ROOT / settings["benchmark_dir"] / "speed.py").is_file()
