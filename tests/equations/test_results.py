"""Results that outlive their call: runs that go on, objectives on them, and files of both kinds."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    AdaptiveSteps,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    InitialVelocity,
    Integral,
    PrescribedSteps,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    differentiate,
    evaluate,
    gradient,
    load_solution,
    simulate,
)
from ancfdae.errors import Interrupted, InvalidInputError, MissingPackageError, UnfinishedRunError
from ancfdae.observables import custom, position
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

DATA = Path(__file__).parent / "data"
X = custom(lambda t, q, v, lam, b: q[:, 0], "x")
STATES = ("t", "q", "v", "a", "lam")
FIXED, CONTROLLED = HHT(2.0**-6), HHT(rtol=1e-5)
UNEVEN = HHT(PrescribedSteps(tuple(np.linspace(0.0, 1.0, 65) ** 1.5)))


class Pressed(CartesianPendulum):
    """Ctrl-C comes at a time."""

    def force(self, t, q, v):
        if t > 0.6:
            raise KeyboardInterrupt
        return super().force(t, q, v)


def interrupted(integrator):
    with pytest.raises(Interrupted) as caught:
        simulate(Pressed(-1.0, 2.0), 1.0, integrator)
    return caught.value.result


def require_same(ours, theirs, tolerance):
    for name in STATES:
        x, y = getattr(ours, name), getattr(theirs, name)
        assert x.shape == y.shape
        assert np.max(np.abs(x - y)) <= tolerance * np.max(np.abs(y)), name


@pytest.mark.parametrize("integrator", [FIXED, UNEVEN, CONTROLLED])
def test_an_interrupted_run_goes_on_as_if_nothing_had_been(integrator):
    system = CartesianPendulum(-1.0, 2.0)
    run, whole = interrupted(integrator), simulate(system, 1.0, integrator)
    assert 2 < len(run.t) < len(whole.t)
    done = simulate(system, 1.0, integrator, after=run)
    # Newton's method leaves 1e-14 (fixed steps) and 1e-9 of the forces, and its first matrix after
    # the break is another one.
    require_same(done, whole, 1e-11 if integrator is not CONTROLLED else 1e-8)
    assert done.statistics.steps == whole.statistics.steps
    assert done.statistics.rejected >= whole.statistics.rejected
    # The start of a new run there would be 1e-5 off.
    np.testing.assert_array_equal(done.q[: len(run.t)], run.q)


@pytest.mark.parametrize("suffix", ["npz", "h5"])
def test_a_flexible_run_goes_on_from_its_file_to_a_later_end(suffix, tmp_path):
    scene, step = pendulum(elements=2), HHT(2.0**-7)
    file = simulate(scene, 0.125, step).save(tmp_path / f"run.{suffix}")
    whole = differentiate(scene, 0.25, step, design=["pendulum.height"])
    done = differentiate(scene, 0.25, step, design=["pendulum.height"], after=load_solution(file))
    # Round-off of the elastic forces, 1e-16 E A, is 1e-11 of the motion's (measured: 4e-11).
    require_same(done, whole, 1e-9)
    ours, theirs = done.sensitivities.q_b, whole.sensitivities.q_b
    assert np.max(np.abs(ours - theirs)) <= 1e-9 * np.max(np.abs(theirs))


def test_a_run_out_of_steps_goes_on_with_more():
    system = CartesianPendulum(-1.0, 2.0)
    short = simulate(system, 1.0, HHT(AdaptiveSteps(1e-5, max_steps=40)))
    assert not short.outcome.success
    done = simulate(system, 1.0, CONTROLLED, after=short)
    require_same(done, simulate(system, 1.0, CONTROLLED), 1e-8)


@pytest.mark.parametrize("method", [None, Adjoint(), ComplexStep()])
def test_a_run_that_is_there_gets_gradients_without_another(method):
    system = CartesianPendulum(-1.0, 2.0)
    run = simulate(system, 1.0, FIXED)
    found = gradient(system, Integral(X), 1.0, FIXED, method=method, after=run)
    fresh = gradient(system, Integral(X), 1.0, FIXED, method=method)
    # The run is the same to the last bit.
    np.testing.assert_array_equal(found.gradient, fresh.gradient)
    assert found.solution.statistics.iterations == run.statistics.iterations
    assert evaluate(Integral(X), run, system) == fresh.value


def thrown(speed):
    """Return a body in free fall: its velocity changes no force."""
    ball = RigidBody("ball", (0.0, 0.0), mass=1.0, inertia=0.01)
    start = [InitialVelocity("ball", 0.0, (0, 0), (speed, 0))]
    return Scene([], bodies=[ball], gravity=(0.0, -9.81), start=start)


@pytest.mark.parametrize("millionths", [0, 1])
def test_runs_of_nearly_the_same_model_are_refused(millionths):
    """A millionth in what pulls, or in the speed, is another motion; round-off is 1e-15."""
    system, factor = CartesianPendulum(-1.0, 2.0), 1 + millionths * 1e-6
    # Length stays, so that positions and velocities of the start do.
    pulled = system.with_values(system.b * (1.0, factor))
    for model, other in ((system, pulled), (thrown(1.0), thrown(factor))):
        run = simulate(model, 2**-4, FIXED)
        if millionths == 0:
            assert simulate(other, 2**-3, FIXED, after=run).outcome.success
            continue
        with pytest.raises(InvalidInputError, match="another start"):
            simulate(other, 2**-3, FIXED, after=run)


def test_other_runs_are_refused():
    system = CartesianPendulum(-1.0, 2.0)
    run = simulate(system, 0.5, FIXED)
    stages = simulate(system, 0.5, Radau(rtol=1e-5))
    controlled = simulate(system, 0.5, CONTROLLED)
    for call, match in (
        (lambda: simulate(CartesianPendulum(0.0, 2.0), 1.0, FIXED, after=run), "another start"),
        (lambda: simulate(CartesianPendulum(-1.0, 1.9), 1.0, FIXED, after=run), "another start"),
        (lambda: simulate(pendulum(elements=1), 1.0, FIXED, after=run), "2 coordinates and 1"),
        (lambda: simulate(system, 1.0, HHT(2.0**-5), after=run), "under the same steps"),
        (lambda: simulate(system, 1.0, UNEVEN, after=run), "under the same steps"),
        (lambda: simulate(system, 1.0, CONTROLLED, after=run), "under the same steps"),
        (lambda: simulate(system, 1.0, CONTROLLED, after=stages), "of the same integrator"),
        (lambda: simulate(system, 1.0, Radau(rtol=1e-5), after=controlled), "of the same integ"),
        (lambda: simulate(system, 0.25, FIXED, after=run), "must end at 0.25 or before; got 0.5"),
        (lambda: simulate(system, 1.0, DOP853(), after=run), "after: needs an integrator"),
        (
            lambda: gradient(system, Integral(X), 1.0, IDA(), after=run),
            "after: needs an integrator",
        ),
        (lambda: simulate(system, 1.0, FIXED, after=3), "after: must be of type Solution"),
        (lambda: evaluate(Integral(X), run, CartesianPendulum(0.0)), "solution: .* another start"),
        (lambda: evaluate(Integral(X), 3, system), "solution: must be of type Solution"),
        (lambda: evaluate(X, run, system), "objective: must be of type Objective"),
    ):
        with pytest.raises(InvalidInputError, match=match):
            call()
    along = HHT(AdaptiveSteps(1e-3, sensitivities=True))
    with pytest.raises(InvalidInputError, match="error of its derivatives"):
        simulate(system, 1.0, along, after=run)
    with pytest.raises(UnfinishedRunError):
        evaluate(Terminal(X), interrupted(FIXED), system)


def test_passes_show_bars_where_asked(capsys):
    system = CartesianPendulum()
    for method, bars in (
        (Adjoint(), ("adjoint",)),
        (ContinuousAdjoint(), ("multipliers", "adjoint")),
        (DirectDifferentiation(), ("derivatives",)),
    ):
        gradient(system, Integral(X), 1.0, FIXED, method=method)
        assert capsys.readouterr().err == ""
        gradient(system, Integral(X), 1.0, FIXED, method=method, progress=True)
        told = capsys.readouterr().err
        assert all(f"{bar}: 100%" in told for bar in bars)


# ---- files


@pytest.mark.parametrize("name", ["solution_6.npz", "solution_6.h5"])
def test_a_file_of_format_6_is_read(name):
    """Written once by `differentiate(SCENE, 0.05, HHT(rtol=1e-3), design=["pendulum.height"])`."""
    run = load_solution(DATA / name)
    scene = pendulum(elements=1, youngs_modulus=1e6)
    # The steps of that time, which another rule of their control may have chosen.
    steps = PrescribedSteps(tuple(run.t.tolist()))
    again = differentiate(scene, 0.05, HHT(steps), design=["pendulum.height"])
    # Newton's method leaves 1e-6 of the forces.
    require_same(run, again, 1e-5)
    assert run.control
    assert run.sensitivities.names == ("pendulum.height",)
    assert run.outcome.success
    tip = scene.beams[0].at_end
    np.testing.assert_allclose(run.position(tip), again.position(tip), rtol=1e-6)
    height = np.max(np.abs(again.sensitivities.q_b))
    assert np.max(np.abs(run.sensitivities.q_b - again.sensitivities.q_b)) < 1e-4 * height


@pytest.mark.parametrize("name", ["solution_6.npz", "solution_6.h5"])
def test_damaged_files_are_refused_in_words(name, tmp_path):
    good, path = (DATA / name).read_bytes(), tmp_path / name
    for broken in (good[: len(good) // 2], good[:-1], good[:100]):
        path.write_bytes(broken)
        with pytest.raises(InvalidInputError, match=r"whole file written by Solution\.save"):
            load_solution(path)


def test_a_file_of_another_version_says_which(tmp_path):
    with np.load(DATA / "solution_6.npz") as file:
        arrays = dict(file)
    path = tmp_path / "run.npz"
    for version, match in ((11, "format 11, of a newer ancfdae. Install"), (4, "of an older")):
        told = json.loads(str(arrays["meta"])) | {"format": f"ancfdae solution {version}"}
        np.savez(path, **(arrays | {"meta": np.array(json.dumps(told))}))
        with pytest.raises(InvalidInputError, match=match):
            load_solution(path)
    # Format 5 had no state of step control.
    told = json.loads(str(arrays["meta"])) | {"format": "ancfdae solution 5"}
    del told["control"]
    np.savez(path, **(arrays | {"meta": np.array(json.dumps(told))}))
    assert load_solution(path).control == ()


def test_both_kinds_of_file_hold_the_same(tmp_path):
    run = load_solution(DATA / "solution_6.npz")
    # Nothing to compress: as of a system without joints.
    s = replace(run.sensitivities, lam_b=run.sensitivities.lam_b[:, :0])
    run = replace(run, lam=run.lam[:, :0], sensitivities=s, naming=None)
    again = load_solution(run.save(tmp_path / "run.HDF5"))
    for name in STATES:
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))
    assert (again.outcome, again.statistics, again.control) == (
        *(run.outcome, run.statistics),
        run.control,
    )


def test_h5py_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    run = load_solution(DATA / "solution_6.npz")
    with pytest.raises(MissingPackageError, match=r"ancfdae\[hdf5\]"):
        run.save(tmp_path / "run.h5")
    assert not list(tmp_path.iterdir())
    with pytest.raises(MissingPackageError):
        load_solution(DATA / "solution_6.h5")


def test_position_is_an_observable_of_a_file():
    scene = pendulum(elements=1, youngs_modulus=1e6)
    run, tip = load_solution(DATA / "solution_6.npz"), scene.beams[0].at_end
    found = evaluate(Terminal(position(tip, 1)), run, scene)
    assert found == run.position(tip)[-1, 1]
