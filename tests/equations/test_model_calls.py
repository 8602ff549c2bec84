"""Models refuse spoiled arguments in words, for scenes, lists of operations and functions.

A good call is spoiled in one place: an array has another shape, type or number, or something else
stands there. What is accepted runs; all else is a ValueError or a TypeError, and nothing crashes.
"""

import random

import numpy as np
import pytest

from ancfdae import assemble, kernels
from ancfdae.equations.plans import Plan
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.equations.system import called_plan, planned
from ancfdae.integrators.radau.stages import TABLEAU
from ancfdae.numerics.linear_solvers import coupled_arrays
from tests.support.mechanisms import CartesianPendulum, GuidedDoublePendulum
from tests.support.nets import net
from validation.scenes import pendulum

STEPS, CALLS = 3, 60
RULES = np.array(
    [-0.3, 1e-12, 5, 0, 0.2, 1e-5, 20, 0.1, 1e-6, 100, 1e-9, 0.1, 0.5, 0.9, 5 / 18, 8 / 18, 5 / 18]
)
MAKE = {
    "scene": lambda: assemble(pendulum()),
    "wide scene": lambda: assemble(net(7)),
    "functions": CartesianPendulum,
    "lists": GuidedDoublePendulum,
}


def spoiled_array(x, rng):
    """Return an array with another shape, type or number."""
    other = np.array(x)
    if other.size:
        bad = (-1, 2**31 - 1, 10**6) if other.dtype.kind == "i" else (np.nan, -1.0)
        other.flat[rng.randrange(other.size)] = rng.choice(bad)
    return rng.choice(
        [
            *(other, x.reshape(-1)[1:], np.stack([x, x]), x * (1 + 1j), np.asfortranarray(x)),
            *(x.tolist(), None, "x", np.zeros(0), np.array(x, dtype=object)),
        ]
    )


def places(x, at=()):
    """Return the paths to all parts of nested tuples."""
    yield at
    if isinstance(x, tuple):
        for i, part in enumerate(x):
            yield from places(part, (*at, i))


def spoiled(x, at, rng):
    """Return nested tuples with another part at a place."""
    if at:
        return tuple(spoiled(y, at[1:], rng) if i == at[0] else y for i, y in enumerate(x))
    if isinstance(x, np.ndarray):
        return spoiled_array(x, rng)
    if isinstance(x, tuple):
        return rng.choice([None, x[1:], x + x[:1], x[::-1]])
    return rng.choice([None, -1, 100, 2.5, "x", np.zeros(2)])


def drivers(system, plan, dtype):
    """Return good arguments of march, rest and march_stages."""
    n, m = system.n_q, system.n_lam
    t = 1e-3 * np.arange(STEPS + 1)
    joints = np.ones((1, 1)) if plan.joint_factors is None else plan.joint_factors(t, 1)[0]
    loads, q = plan.load_factors(t), system.start()[0].astype(dtype)
    z, lam = np.zeros(n, dtype), np.zeros(m, dtype)
    rows = tuple(np.zeros((STEPS, k), dtype) for k in (n, n, n, m))
    each = joints if len(joints) == 1 else joints[1:]
    tables = np.stack([each] * 8, axis=1), np.stack([loads[1:]] * 2, axis=1)
    march = (q, z, z, lam, z), np.inf, np.full(STEPS, 1e-3), *tables, 1.0, rows, (z, lam)
    state, given = (q.copy(), lam.copy(), q.copy(), lam.copy()), (q, q, z, lam)
    rules = np.array([0.5, 1.0, 1, 1, 1, 1, 1e-12, 100, 4, 3, 1e-13])
    coupled = coupled_matrix(system)
    numbers = TABLEAU, np.array([1e-3, 1e-12, 3, 1e-300, 4, 10, 100, 0.5, 1e-6, 1e4])
    before = tuple(x[None] for x in (q, z, z, lam))
    stages = np.zeros(3 * STEPS), *(np.zeros((3 * STEPS, k), dtype) for k in (n, n, n, m))
    of_steps = np.zeros(STEPS), np.zeros((STEPS, kernels.FILTER))
    control = np.zeros(0), np.zeros(0), np.full(STEPS, 1e-3), t[1:].copy()
    least = np.full(n, 1e-3)
    tolerance = 1e-3, least, 1e-3, least, np.zeros(n), least, 1
    at = np.tile(joints[:1], (12, 1)), np.tile(loads[:1], (4, 1)), 0.0
    laws = (lambda *_: at), 0.0
    return {
        "march": (*march, (1e-12, 0.5, 3)),
        "rest": (state, given, (joints[0], loads[0], loads[0]), rules),
        "march_stages": (
            *(coupled, before, (0, 0.0, 1e-3), control, tolerance, laws, lambda h, end: 0.0),
            *(stages, of_steps, numbers, 1.0),
        ),
    }


def coupled_matrix(system):
    """Return the matrix of the three stages of a step."""
    layout = saddle_point(system, 0.0).layout(band=False)
    patterns = system.pattern, system.constraint_pattern
    values = system.weights, system.constraint_q(0.0, system.start()[0])
    return coupled_arrays(3, *patterns, *values, layout and layout.order)


def passes_over_stages(system, plan):
    """Return good arguments of find_stages, differentiate_stages and pull_back_stages."""
    n, m, k = system.n_q, system.n_lam, 3 * STEPS
    t, q, wide = 1e-3 * np.arange(1, k + 1), np.tile(system.start()[0], (k, 1)), n + m
    joints = np.ones((1, 1, 1)) if plan.joint_factors is None else plan.joint_factors(t, 2)
    found = (joints, plan.load_factors(t)), (q, np.ones((k, n)), np.ones((k, n)))
    K, B = np.ones((k, system.pattern.size)), system.constraints_q(t, q)
    M = np.array([system.mass(q[0])])
    f_v = K.copy() if system.traits.velocity_forces else None
    steps = np.full(STEPS, 1e-3), M, B, K, f_v, K, f_v, K, (B, B), TABLEAU
    coupled = coupled_matrix(system)
    known = tuple(np.ones((k, 2, wide)) for _ in range(3))
    out = np.ones((k + 1, 3, 2, n)), np.ones((k + 1, 2, m)), np.ones((k, 2, n))
    seeds, rows = (None, np.ones((k, n)), np.ones((k, m))), [np.ones((k, wide)) for _ in range(3)]
    return {
        "find_stages": (*found, np.ones((k, 2, wide)), 0),
        "differentiate_stages": (coupled, steps, known, *out, 0),
        "pull_back_stages": (coupled, steps, seeds, np.ones((2, n)), tuple(rows), STEPS),
    }


def passes(system, plan):
    """Return good arguments of differentiate_steps and pull_back_steps."""
    n, m, k = system.n_q, system.n_lam, STEPS
    nnz, n_B = system.pattern.size, system.constraint_pattern.size
    t = 1e-3 * np.arange(1, k + 1)
    joints = np.ones((1, 1)) if plan.joint_factors is None else plan.joint_factors(t, 1)[0]
    rows = np.full(k, 1e-3), np.ones((k, n)), np.ones((k, n)), np.zeros((k, m)), joints.copy()
    local = np.ones((1, nnz)), np.ones((k, nnz)), np.ones((k, nnz)), np.ones((k, n_B))
    if isinstance(plan, Plan):
        local = None
    elif not plan.velocity:
        local = (*local[:2], None, local[3])
    small = np.array([0, 1, 0], dtype=np.int32), np.ones((k, n_B)), np.ones((k, m, 2))
    steps = *rows, plan.load_factors(t).copy(), np.ones((k, 6, 4)), local, small
    out = np.ones((k, 2, n + m)), np.ones((4, 2, n)), np.ones((k + 1, 3, 2, n)), np.ones((k, 2, m))
    on = np.ones((6, n)), np.ones((k, n)), np.ones((k, m)), np.ones((k, 3, n))
    seeds = None, np.ones((k, n)), np.ones((k, m))
    return {
        "differentiate_steps": (steps, *out, 0),
        "pull_back_steps": (steps, seeds, on, k),
    }


@pytest.mark.parametrize("kind", ["scene", "wide scene"])
def test_spoiled_parts_of_a_plan_are_refused_or_used(kind):
    system, rng = MAKE[kind](), random.Random(5)
    matrices, plan = saddle_point(system, 0.0), planned(system)
    layout = matrices.layout(band=True) or matrices.layout_out_of_band()
    values = (((1.0, np.ones(system.pattern.size)),), np.ones(system.constraint_pattern.size))
    objects = [plan.block, plan.constraints, *(x for x in layout[2:] if x is not None)]
    objects.append(coupled_matrix(system))
    refused = 0
    for _ in range(CALLS):
        kind, good = rng.choice(objects).__reduce__()
        bad = spoiled(good, rng.choice(list(places(good))[1:]), rng)
        try:
            made = kind(*bad)
            if isinstance(made, kernels.Envelope | kernels.FrontPlan):
                factors, _ = made.factor(*values)
                more = (0.0,) if isinstance(made, kernels.FrontPlan) else ()
                made.solve(factors, np.ones(len(matrices.scale)), *more)
            elif isinstance(made, kernels.Band):
                lu, pivots, _, _ = made.factor(values[0][0][1], values[1])
                made.solve(lu, pivots, matrices.scale, np.ones(len(matrices.scale)), False)
        except (ValueError, TypeError, MemoryError):
            refused += 1
    assert CALLS / 3 < refused < CALLS


@pytest.mark.parametrize("form", [planned, called_plan], ids=["as it is", "called"])
@pytest.mark.parametrize("kind", MAKE)
@pytest.mark.parametrize("dtype", [float, complex])
def test_spoiled_arguments_are_refused_or_run(kind, form, dtype):
    system, rng = MAKE[kind](), random.Random(3)
    plan, matrices = form(system), saddle_point(system, 0.0)
    layout = matrices.layout(band=True) or matrices.layout_out_of_band()
    given = tuple(plan), tuple(layout), RULES, matrices.exchanging(layout)

    def model(*given):
        real = kernels.Model(*given)
        return real if dtype is float else kernels.ComplexModel(tuple(plan), real, RULES)

    calls = drivers(system, plan, dtype)
    if dtype is float:
        calls |= passes(system, plan) | passes_over_stages(system, plan)
    one, refused = model(*given), 0
    for name, arguments in calls.items():
        getattr(one, name)(*arguments)  # What is good runs.
    for _ in range(CALLS):
        name = rng.choice([*calls, "model"])
        good = given if name == "model" else calls[name]
        bad = spoiled(good, rng.choice(list(places(good))[1:]), rng)
        try:
            model(*bad) if name == "model" else getattr(one, name)(*bad)
        except (ValueError, TypeError, MemoryError):
            refused += 1
    assert CALLS / 3 < refused < CALLS
