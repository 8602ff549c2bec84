"""Joints and loads in kernels against what they declare, by plain arithmetic.

CLOSE: forces and constraints are sums of at most 1e2 terms of their size, n eps = 2e-14, with a
factor of ten for tangents of quotients. A wrong term shows at 1e-3 and more.
"""

import pickle
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from ancfdae import RigidBody, Scene, assemble, kernels
from ancfdae.extend import MaterialPoint
from ancfdae.model.bodies import Quantity
from ancfdae.model.joints.joint import DrivenJoint, FormulaJoint
from ancfdae.model.loads.load import LAW_FIELD, Load
from ancfdae.numerics.vector_formulas import angle
from tests.support import parts
from tests.support.examples import scene_of
from tests.support.jets import Jet
from tests.support.parts import PAIRS

CLOSE = 1e-12
STEP = 2.0**-133


def examples(parts):
    """The examples among the parts with the two beams that they stand on."""
    pairs = ((name, PAIRS[name.split()[0]], part) for name, part in parts.items())
    return {name: (pair, part) for name, pair, part in pairs if type(part).__name__ in name}


JOINTS, LOADS = examples(parts.JOINTS), examples(parts.LOADS)


def close(x, y):
    assert x.shape == y.shape
    assert np.max(np.abs(x - y), initial=0) <= CLOSE * max(1.0, np.max(np.abs(y), initial=0))


def assembled(case):
    members, part = case
    return assemble(scene_of(members, part))


def random_numbers(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def declared(item, U, t):
    """Equations of a joint at vectors, from what it declares alone."""
    value, *moving = (c.at(U) for c in item.parts)
    if isinstance(item.joint, DrivenJoint):
        factors = item.joint.factors(item.p, np.array([t]), 0)
        value = value + sum(f * x for f, x in zip(factors, moving, strict=True))
    return value


BY_COEFFICIENTS = {
    name: case for name, case in JOINTS.items() if not isinstance(case[1], FormulaJoint)
}


@pytest.mark.parametrize("case", BY_COEFFICIENTS.values(), ids=BY_COEFFICIENTS)
def test_constraints_are_what_the_joint_declares(case):
    system, rng, t = assembled(case), np.random.default_rng(7), 0.3
    constraints = system._constraints
    (slot,) = constraints.structure.slots
    matrix = constraints.structure.vectors.of(np.eye(system.n_q)).reshape(system.n_q, -1).T

    def phi(q):
        return declared(slot.item, (matrix @ q).reshape(slot.item.reference.shape), t)

    q, lam = (random_numbers(rng, n) for n in (system.n_q, system.n_lam))
    close(constraints.constraint(t, q), phi(q))
    # Phi is a polynomial of degree two: central differences of size one are exact.
    unit = np.eye(system.n_q)
    Phi_q = np.array([(phi(q + e) - phi(q - e)) / 2 for e in unit]).T
    close(constraints.structure.pattern.dense(constraints.constraint_q(t, q)), Phi_q)
    close(constraints.reaction(t, q, lam), Phi_q.T @ lam)
    bent = constraints.constraint_force_q(q[None], lam[None], np.array([t]))[0]
    ahead, behind = (constraints.reaction(t, q + s * unit[0], lam) for s in (1, -1))
    close(system.pattern.dense(bent)[:, 0], (ahead - behind) / 2)


def called(item, x, q, v):
    """x has the law and behind it the signals of a load."""
    U, V = item.vectors.of(q), item.vectors.of(v)
    return item.vectors.lift(x[:, :1, None] * item.forces(U, V, x[:, 1:]))


def along(item, x, dx, q, v, dq, dv):
    """The derivative by jets; zero of a force that is constant. Copies take a complex step."""
    if item.own.size:
        signals = np.insert(dx[:, 1:], 0, 0.0, axis=1)  # the law is held
        moved = (a + 1j * STEP * b for a, b in ((x, signals), (q, dq), (v, dv)))
        return called(item, *moved).imag / STEP
    U, V, dU, dV = (item.vectors.of(state) for state in (q, v, dq, dv))
    F = item.force(Jet(U, dU), Jet(V, dV), Jet(x[:, 1:], dx[:, 1:]))
    dF = F.derivatives[1] if isinstance(F, Jet) else np.zeros_like(U)
    return item.vectors.lift(x[:, :1, None] * dF)


def times(matrices, vectors):
    return np.array([A @ x for A, x in zip(matrices, vectors, strict=True)])


@pytest.mark.parametrize("case", LOADS.values(), ids=LOADS)
def test_loads_are_what_their_formulas_say(case):
    system, rng = assembled(case), np.random.default_rng(8)
    (item,) = system.inputs.loads()
    if item.load.constant:
        return
    plan = item.plan(system.pattern)
    q_o = system.start()[0]
    for s in (0.0,) if item.own.size else (0.0, 1j * STEP):
        q, v, dq, dv = (
            x + 0.1 * rng.normal(size=(2, system.n_q)) + s * rng.normal(size=(2, system.n_q))
            for x in (q_o, 0, 0, 0)
        )
        x, dx = rng.normal(size=(2, 2, item.factors(np.zeros(1), 0).shape[1]))
        still, dense = 0 * q, system.pattern.dense
        by_q, by_v = (plan.tangents(x, q, v, which) for which in (False, True))
        pairs = [
            (plan.forces(x, q, v), called(item, x, q, v)),
            (
                plan.forces_along(x, dx, q, v, dq, dv),
                along(item, x, dx, q, v, dq, dv),
            ),
            (times(map(dense, by_q), dq), along(item, x, 0 * x, q, v, dq, still)),
            (times(map(dense, by_v), dv), along(item, x, 0 * x, q, v, still, dv)),
        ]
        for one, other in pairs:
            size = np.max(np.abs(other.real)) or 1.0
            close(one.real / size, other.real / size)
            size = (np.max(np.abs(other.imag)) or 1.0) if s else 1.0
            close(one.imag / size, other.imag / size)


@dataclass(frozen=True)
class Formula(Load):
    """A force that is a function of NumPy of the place x and the velocity v of a point."""

    point: MaterialPoint
    function: ClassVar[object]

    kind = "formula"
    design_fields = (LAW_FIELD,)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION),)

    def force(self, U, V, p, U_o):
        return type(self).function(U, V)


FUNCTIONS = {
    "add": lambda x, v: x + v,
    "subtract": lambda x, v: x - v,
    "multiply": lambda x, v: x * v,
    "divide": lambda x, v: x / v,
    "power": lambda x, v: x**2.5 + v**-1.5,
    "negative": lambda x, v: -x,
    "square": lambda x, v: np.square(x) - np.square(v),
    "reciprocal": lambda x, v: np.reciprocal(x) + 2 * np.reciprocal(v),
}
NAMES = ["sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "arctan"]
FUNCTIONS |= {name: (lambda f: lambda x, v: f(x) + 2 * f(v))(getattr(np, name)) for name in NAMES}


@pytest.mark.parametrize("function", [*FUNCTIONS.values(), angle], ids=[*FUNCTIONS, "angle"])
def test_derivatives_of_every_operation_are_those_of_its_formula(function):
    # Complex steps of the formula in NumPy alone; the angle of two numbers, which has none, is
    # arctan(x/v) where both are positive.
    plain = (lambda x, v: np.arctan(x / v)) if function is angle else function
    body = RigidBody("body", (0.0, 0.0), 1.0, 1.0)
    load = type("Own", (Formula,), {"function": staticmethod(function)})(body.at(0.0, 0.0))
    system = assemble(Scene([], bodies=[body], loads=[load]))
    (item,) = system.inputs.loads()
    plan = item.plan(system.pattern)
    rng, n = np.random.default_rng(9), system.n_q
    q, v, dq, dv = (rng.uniform(0.3, 0.9, (1, n)) for _ in range(4))
    U, V, dU, dV = (item.vectors.of(x) for x in (q, v, dq, dv))

    def rate(dU, dV):
        return item.vectors.lift(plain(U + 1j * STEP * dU, V + 1j * STEP * dV).imag / STEP)

    one = np.ones((1, 1))
    close(plan.forces(one, q, v), item.vectors.lift(plain(U, V)))
    close(plan.forces_along(one, 0 * one, q, v, dq, dv), rate(dU, dV))
    for velocity, direction in enumerate((dq, dv)):
        (tangent,) = plan.tangents(one, q, v, bool(velocity))
        rates = [np.zeros_like(U), np.zeros_like(U)]
        rates[velocity] = item.vectors.of(direction)
        close(system.pattern.dense(tangent) @ direction[0], rate(*rates)[0])


def broken(arguments, number, change):
    arrays = list(arguments[0])
    arrays[number] = change(np.array(arrays[number]))
    return (tuple(arrays), *arguments[1:])


CHANGES = {
    "shorter": lambda x: x.ravel()[:-1],
    "negative": lambda x: x - 1000,
    "beyond": lambda x: x + 1000,
}


@pytest.mark.parametrize("change", CHANGES)
def test_indices_that_do_not_fit_are_no_plan(change):
    system = assembled(next(case for case in JOINTS.values() if isinstance(case[1], DrivenJoint)))
    plan = system._constraints.plan
    _, arguments = plan.__reduce__()
    again = pickle.loads(pickle.dumps(plan))
    factors = system._constraints.factors.at(0.2)
    q = system.start()[0]
    same = (x.evaluate(kernels.Constraints.RATE, factors, None, q) for x in (plan, again))
    assert np.array_equal(*same)
    for number, array in enumerate(arguments[0]):
        if np.size(array):
            with pytest.raises((ValueError, TypeError)):
                kernels.ConstraintPlan(*broken(arguments, number, CHANGES[change]))
    load = next(case for case in LOADS.values() if not case[1].constant)
    system = assembled(load)
    (item,) = system.inputs.loads()
    _, arguments = item.plan(system.pattern).__reduce__()
    for number, array in enumerate(arguments[0]):
        if np.size(array):
            with pytest.raises((ValueError, TypeError)):
                kernels.LoadPlan(*broken(arguments, number, CHANGES[change]))
