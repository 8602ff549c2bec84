"""IDA, IDAS and the explicit integrator: one solution, whatever the method and the units."""

from functools import lru_cache

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    Adjoint,
    AtTimes,
    Beam,
    DirectDifferentiation,
    IndexReduction,
    Integral,
    Material,
    Pin,
    RotationDriver,
    Scene,
    SmoothMaximum,
    Terminal,
    assemble,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.extend import MaterialPoint
from ancfdae.laws import Harmonic
from ancfdae.observables import custom, position
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum, chain
from tests.support.members import constraint_b, velocity_side

GGL, INDEX_1 = IndexReduction
DESIGN = ("a.height", "m.frequency")
T_END = 2.0**-6
STATES, RATES = ("q", "v", "lam"), ("q_b", "v_b", "lam_b")


def swinging():
    return CartesianPendulum(0.5, 3.0)


def driven():
    return chain(design=DESIGN)


def idas(*values):
    return pytest.param(*values, marks=pytest.mark.idas)


def every_method(rtol, intervals=2):
    """All integrators of high order at a tolerance."""
    return [
        DOP853(rtol, intervals),
        IDA(rtol, intervals, form=GGL),
        IDA(rtol, intervals, form=INDEX_1),
        idas(IDAS(rtol, intervals, form=GGL)),
        idas(IDAS(rtol, intervals, form=INDEX_1)),
    ]


def name_of(value):
    form = getattr(value, "form", None)
    kind = type(value).__name__
    return value if isinstance(value, str) else kind if form is None else f"{kind}-{form.name}"


@lru_cache(maxsize=1)
def reference():
    return differentiate(driven(), T_END, DOP853(1e-11, 2))


def errors(run, exact):
    """Largest errors of states and sensitivities, each relative to its largest value."""
    pairs = [(getattr(run, x), getattr(exact, x)) for x in STATES]
    if run.sensitivities is not None:
        for x in RATES:
            ours, other = (getattr(s.sensitivities, x) for s in (run, exact))
            pairs += [(ours[..., i], other[..., i]) for i in range(ours.shape[-1])]
    return np.array([np.max(np.abs(x - y)) / np.max(np.abs(y)) for x, y in pairs])


@pytest.mark.parametrize("integrator", every_method(1e-7), ids=name_of)
def test_methods_agree_on_a_driven_flexible_scene(integrator):
    run = differentiate(driven(), T_END, integrator)
    assert run.outcome.success
    np.testing.assert_array_equal(run.t, reference().t)
    found = errors(run, reference())
    # The error of a run is up to some hundred times the tolerance of a step.
    assert np.max(found) < 1e-4, found
    assert np.max(found[:3]) < 2e-5, found


def test_hht_tends_to_the_same_end():
    runs = [differentiate(driven(), T_END, HHT(T_END / n)) for n in (256, 512)]
    for name in (*STATES, *RATES):
        holders = [run if name in STATES else run.sensitivities for run in (*runs, reference())]
        coarse, fine, exact = (getattr(holder, name)[-1] for holder in holders)
        before, after = (np.max(np.abs(x - exact)) for x in (coarse, fine))
        limit, size = (4 * fine - coarse) / 3, np.max(np.abs(exact))
        # Order two, and its extrapolation is a good deal better still.
        assert 3.0 < before / after < 5.0, name
        assert np.max(np.abs(limit - exact)) < max(0.05 * after, 1e-9 * size), name


@pytest.mark.parametrize("integrator", every_method(1e-8), ids=name_of)
def test_error_falls_with_the_tolerance(integrator):
    exact, found = simulate(swinging(), 1.0, DOP853(1e-11, 2)), []
    for rtol in (1e-4, 1e-6, 1e-8):
        changed = type(integrator)(**{**vars(integrator), "rtol": rtol})
        found.append(np.max(errors(simulate(swinging(), 1.0, changed), exact)))
    assert found[0] > 10 * found[1] > 100 * found[2], found
    assert found[2] < 1e-5


@lru_cache(maxsize=8)
def in_own_units(integrator):
    return differentiate(driven(), T_END / 2, integrator)


# Powers of four: no rounding changes, nor that of a root, so neither may a bit of the result.
UNITS = {"length": (4.0**10, 1.0, 1.0), "mass": (1.0, 4.0**-10, 1.0), "time": (1.0, 1.0, 4.0**10)}


@pytest.mark.parametrize("integrator", every_method(1e-5, 1), ids=name_of)
@pytest.mark.parametrize("unit", UNITS)
def test_runs_are_the_same_to_the_last_bit_in_other_units(integrator, unit):
    length, mass, time = UNITS[unit]
    base = in_own_units(integrator)
    run = differentiate(chain(length, mass, time, DESIGN), T_END / 2 * time, integrator)
    assert run.outcome.success
    ours, other = (vars(x.statistics) | {"wall_seconds": 0} for x in (run, base))
    assert ours == other
    # Every node has a position and two slopes, which are free of length.
    size = np.tile(np.repeat([length, 1.0], [2, 4]), base.q.shape[1] // 6)
    design = np.array([length, 1 / time])
    for k, name in enumerate("qva"):
        np.testing.assert_array_equal(getattr(run, name) / (size / time**k), getattr(base, name))
        ours, other = (getattr(x.sensitivities, f"{name}_b") for x in (run, base))
        np.testing.assert_array_equal(ours / (size[:, None] / time**k / design), other)


@pytest.mark.parametrize("integrator", every_method(1e-6, 8), ids=name_of)
def test_constraints_drift_as_much_as_the_form_says(integrator):
    system = swinging()
    run = simulate(system, 4.0, integrator)
    off_place = np.max([np.abs(system.constraint(0.0, q)) for q in run.q])
    off_speed = np.max(np.abs(np.sum(run.q * run.v, axis=1)))
    acceleration = np.max(np.abs(np.sum(run.q * run.a, axis=1) + np.sum(run.v**2, axis=1)))
    # Accelerations are recomputed from each state, and keep their equation to round-off.
    assert acceleration < 1e-12 * np.max(np.abs(run.lam))
    if isinstance(integrator, DOP853):
        # Projected by one Newton step: what is left is the square of the drift.
        assert max(off_place, off_speed) < 1e-10
    elif integrator.form is GGL:
        assert max(off_place, off_speed) < 1e-5
    else:
        assert 1e-9 < off_place < 1e-3


def test_explicit_runs_stay_on_driven_constraints():
    # Linear in q, but stages of a step integrate the drive with an error.
    rod = Beam("a", (0, 0), (0.5, 0), 2, Rectangle(0.05, 0.04), Material(4000, 1e6, 0.3))
    joints = [Pin(rod.at_start), RotationDriver(rod.at_start, Harmonic(0.5, 4.0), name="m")]
    system = assemble(Scene([rod], joints, (0, -9.81), project_start=True), ["m.frequency"])
    assert system.traits.linear_constraints
    run = differentiate(system, 0.125, DOP853(1e-4, 2))
    B, b = system.constraint_pattern, run.sensitivities
    for t, q, v, q_b in zip(run.t, run.q, run.v, b.q_b, strict=True):
        Phi_q = system.constraint_q(t, q)
        assert np.max(np.abs(system.constraint(t, q))) < 1e-14
        assert np.max(np.abs(B.dot(Phi_q, v) - velocity_side(system, t, q))) < 1e-13
        assert np.max(np.abs(B.dot(Phi_q, q_b) + constraint_b(system, t, q))) < 1e-13


@pytest.mark.parametrize("integrator", every_method(1e-6), ids=name_of)
def test_statistics_count_what_was_done(integrator):
    system, calls = swinging(), []
    force = system.force
    system.force = lambda q, v, t: calls.append(t) or force(q, v, t)
    run = simulate(system, 1.0, integrator)
    s = run.statistics
    assert run.outcome.step == s.steps
    assert 5 < s.steps < s.residuals < len(calls)
    assert s.factorisations > 0
    assert s.wall_seconds > 0
    assert s.iterations == (0 if isinstance(integrator, DOP853) else s.residuals)


@pytest.mark.parametrize("integrator", every_method(1e-6, 1), ids=name_of)
def test_steps_are_not_counted_twice_at_instants(integrator):
    # The instants are interpolated: more of them cost no step.
    more = type(integrator)(**{**vars(integrator), "intervals": 8})
    few, many = (simulate(swinging(), 1.0, x).statistics.steps for x in (integrator, more))
    assert few == many


@pytest.mark.parametrize("integrator", every_method(1e-6, 1), ids=name_of)
def test_progress_bar_counts_instants(integrator, capfd):
    simulate(swinging(), 0.25, integrator)
    assert capfd.readouterr().err == ""
    simulate(swinging(), 0.25, integrator, progress=True)
    assert "8/8" in capfd.readouterr().err


# ---------------------------------------------------------------- gradients


def x_of(power):
    return custom(lambda t, q, v, lam, b: q[:, 0] ** power, "x")


# Functions of t and b and all states together; each for itself is in test_high_order.py.
SPEED = custom(lambda t, q, v, lam, b: v[:, 0] * v[:, 1] + t * v[:, 0], "speed")
TENSION = custom(lambda t, q, v, lam, b: lam[:, 0] ** 2 * b[1], "tension")
OBJECTIVES = {
    "smooth maximum": SmoothMaximum(x_of(1), 5.0),
    "mixed terminal": Terminal(x_of(1) + 0.1 * TENSION),
    "mixed at times": AtTimes(x_of(3) + SPEED + 0.1 * TENSION, [0.2, 0.5, 0.77]),
    "sum of integrals": Integral(x_of(2)) + 0.01 * Integral(TENSION) ** 2,
    "sum of all": Integral(SPEED) + Terminal(x_of(1)) * AtTimes(SPEED, 0.3) + Integral(x_of(2)),
}


@lru_cache(maxsize=8)
def exact_gradient(name):
    return gradient(
        swinging(), OBJECTIVES[name], 1.0, DOP853(1e-11, 4), method=DirectDifferentiation()
    )


@pytest.mark.parametrize("name", OBJECTIVES)
@pytest.mark.parametrize(
    ("integrator", "method"),
    [
        (IDA(1e-8, 4, form=GGL), DirectDifferentiation()),
        idas(IDAS(1e-8, 4, form=GGL), DirectDifferentiation()),
        idas(IDAS(1e-8, 4, form=GGL), Adjoint()),
        idas(IDAS(1e-8, 4, form=INDEX_1), Adjoint()),
    ],
    ids=name_of,
)
def test_gradients_of_composed_objectives(name, integrator, method):
    found = gradient(swinging(), OBJECTIVES[name], 1.0, integrator, method=method)
    exact = exact_gradient(name)
    assert found.value == pytest.approx(exact.value, rel=1e-5)
    size = np.max(np.abs(exact.gradient))
    np.testing.assert_allclose(found.gradient, exact.gradient, rtol=0, atol=1e-5 * size)


@pytest.mark.idas
def test_adjoint_of_idas_on_a_driven_scene():
    system, tip = driven(), position(MaterialPoint("b", 1.0), 1)
    results = [
        gradient(system, Integral(tip**2), T_END, integrator, method=method).gradient
        for integrator, method in (
            (IDAS(1e-7, 2, form=GGL), Adjoint()),
            (DOP853(1e-9, 2), DirectDifferentiation()),
        )
    ]
    np.testing.assert_allclose(results[0] * system.b, results[1] * system.b, rtol=1e-4, atol=1e-11)


@pytest.mark.parametrize("integrator", [IDA(1e-8), idas(IDAS(1e-8)), DOP853()], ids=name_of)
def test_direct_is_the_default_method(integrator):
    found = gradient(swinging(), OBJECTIVES["smooth maximum"], 0.1, integrator)
    assert isinstance(found.method, DirectDifferentiation)
