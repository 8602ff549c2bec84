"""`simulate(keep=)` and `record_observables` give the full run at the kept times."""

import numpy as np
import pytest

from ancfdae import HHT, IDA, assemble, record_observables, simulate
from ancfdae.errors import Interrupted, InvalidInputError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.observables import custom, kinetic_energy, observe, position
from ancfdae.results import Verdict
from ancfdae.sensitivity.observables.observable import states_of
from ancfdae.studies import observing, parts
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

SCENE = pendulum(elements=1, youngs_modulus=1e6)
STEP, T_END = 2.0**-8, 23 * 2.0**-8
TIP = position(MaterialPoint("pendulum", 1.0), 1)
# Newton's method begins a part with a matrix of its own. Its tolerance of 1e-14 in the forces is
# 1e-9 in accelerations: positions within it are divided by beta h^2 = 6e-6.
CLOSE = {"rtol": 1e-8, "atol": 1e-9}


@pytest.fixture(autouse=True)
def short_parts(monkeypatch):
    """Let parts have 5 steps, so that there are several, the last one shorter."""
    monkeypatch.setattr(parts, "_NUMBERS", 5 * (3 * 12 + 2 + 1))


@pytest.fixture(scope="module")
def whole():
    return simulate(SCENE, T_END, HHT(STEP))


@pytest.mark.parametrize("every", [1, 4, 5, 23, 100])
def test_every_so_many_steps_are_kept(whole, every):
    thin = simulate(SCENE, T_END, HHT(STEP), keep=every)
    rows = sorted({*range(0, 24, every), 23})
    for name in ("t", "q", "v", "a", "lam"):
        np.testing.assert_allclose(getattr(thin, name), getattr(whole, name)[rows], **CLOSE)
    assert thin.statistics.steps == 23
    assert thin.outcome.success


def test_chosen_instants_are_those_between_the_steps(whole):
    times = [0.0, 0.011, 5 * STEP, 0.05, T_END]
    thin, exact = simulate(SCENE, T_END, HHT(STEP), keep=times), whole.at(times)
    for name in ("t", "q", "v", "a", "lam"):
        np.testing.assert_allclose(getattr(thin, name), getattr(exact, name), **CLOSE)


def test_observables_are_kept_here_and_on_disk(whole, tmp_path):
    own = [TIP, kinetic_energy()]
    file = tmp_path / "run.npy"
    for options in ({}, {"file": file}):
        seen = record_observables(SCENE, own, T_END, HHT(STEP), keep=4, **options)
        for k, each in enumerate(own):
            values = observe(each, whole, assemble(SCENE))[[0, 4, 8, 12, 16, 20, 23]]
            np.testing.assert_allclose(seen.values[:, k], values, **CLOSE)
        assert seen.steps == 23
    stored = np.load(file, mmap_mode="r")
    np.testing.assert_array_equal(stored, np.column_stack([seen.t, seen.values]))
    assert "7 instants of 23 steps" in repr(seen)


def own(t, q, v, lam, b):
    return q[:, 0]


class Stopping(CartesianPendulum):
    """Presses Ctrl-C after half a second."""

    def with_values(self, b):
        return Stopping(self.angle, self.spin, b)

    def force(self, t, q, v):
        if t > 0.5:
            raise KeyboardInterrupt
        return super().force(t, q, v)


def test_a_run_that_ends_early_keeps_what_it_has(tmp_path):
    given = 1.0, HHT(2.0**-4)
    with pytest.raises(Interrupted) as stopped:
        simulate(Stopping(), *given, keep=2)
    thin = stopped.value.result
    assert thin.outcome.verdict is Verdict.INTERRUPTED
    np.testing.assert_array_equal(thin.t, [0, 0.125, 0.25, 0.375, 0.5])
    with pytest.raises(Interrupted) as stopped:
        record_observables(Stopping(), [custom(own)], *given, keep=2, file=tmp_path / "run.npy")
    seen = stopped.value.result
    np.testing.assert_array_equal(seen.values[:, 0], thin.q[:, 0])
    stored = np.load(tmp_path / "run.npy")
    np.testing.assert_array_equal(stored[:5, 1], thin.q[:, 0])
    assert np.isnan(stored[5:]).all()


def test_an_interrupt_between_parts_keeps_the_rows_so_far(monkeypatch):
    calls = []

    def late(*given):
        calls.append(given)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return states_of(*given)

    monkeypatch.setattr(observing, "states_of", late)
    monkeypatch.setattr(parts, "_NUMBERS", 4 * 8)  # parts of four steps
    with pytest.raises(Interrupted) as stopped:
        record_observables(CartesianPendulum(), [custom(own)], 1.0, HHT(2.0**-4), keep=2)
    seen = stopped.value.result
    assert seen.outcome.verdict is Verdict.INTERRUPTED
    np.testing.assert_array_equal(seen.t, [0, 0.125, 0.25, 0.375, 0.5])
    assert (len(seen.values), seen.steps) == (5, 8)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"keep": 0}, "keep: must be a positive integer"),
        ({"keep": True}, "keep: must be a positive integer"),
        ({"keep": "all"}, "keep"),
        ({"keep": None}, "keep"),
        ({"keep": [0.2, 0.1]}, "keep: must be ascending times"),
        ({"keep": [0.0, 1.0]}, "keep: must lie in"),
        ({"integrator": IDA(1e-6)}, "keep, integrator: needs"),
        ({"integrator": HHT(rtol=1e-3)}, r"HHT\.steps: needs steps that are known"),
        ({"observables": TIP}, "observables"),
        ({"observables": [3]}, "observables"),
    ],
)
def test_bad_input_is_refused(change, match):
    given = {"observables": [TIP], "integrator": HHT(STEP), "keep": 2} | change
    with pytest.raises(InvalidInputError, match=match):
        record_observables(SCENE, t_end=T_END, **given)


def test_a_run_that_goes_on_is_not_thinned(whole):
    with pytest.raises(InvalidInputError, match="keep: a run that continues another must keep all"):
        simulate(SCENE, T_END, HHT(STEP), after=whole, keep=2)
