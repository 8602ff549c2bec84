"""Settings that all tests share."""

import gc
import importlib.util
import signal

import hypothesis
import pytest

# Derandomised and without a database: the same examples on every machine and in every run.
hypothesis.settings.register_profile("ancfdae", derandomize=True, database=None, deadline=None)
hypothesis.settings.load_profile("ancfdae")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect without the garbage collector: it would look at all that stays again and again."""
    gc.disable()
    collected = yield
    gc.freeze()
    gc.enable()
    return collected


@pytest.fixture(autouse=True)
def interruptible():
    """Let Ctrl-C interrupt, as in a terminal: a shell's background jobs start deaf to it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def pytest_collection_modifyitems(items):
    """Put reports first; skip tests of IDAS, in words, where its package is missing.

    A report takes up to 20 s: among the last ones it leaves the other process without work.
    """
    items.sort(key=lambda item: item.path.name != "test_quick_reports.py")
    if importlib.util.find_spec("sundials4py") is None:
        missing = pytest.mark.skip(reason="sundials4py is not installed; .ci/run has its own stage")
        for item in items:
            if item.get_closest_marker("idas"):
                item.add_marker(missing)
