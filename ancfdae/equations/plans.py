"""Plans of systems for kernels: arrays of a scene, lists of operations, or functions to call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.kernels import Block, ConstraintPlan, LoadPlan, OperationList
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Csr


class Plan(NamedTuple):
    """A system of elements, joints and loads, for `Model` and `ComplexModel`.

    `mass` is the mass matrix on the system's pattern, `places` the indices of the elements'
    tangents on it, and M the mass matrix without zeros. `loads` are rows of forces, and `B` is
    Phi_q with any values. Time factors are functions of times, (k,): of constraints with
    derivatives, (orders, k, n_parts), None if nothing is driven, and of loads, (k, n_loads), with
    `moving` loads last. `moving` says whether they use velocities, `turning` whether they turn with
    the motion without being elastic, as numbers.
    """

    block: Block
    places: Array
    M: Csr
    mass: Csr
    gravity: Array
    loads: Array
    weights: Array
    inverse_weights: Array
    constraints: ConstraintPlan
    B: Csr
    joint_factors: Callable[[Array, int], Array] | None
    load_factors: Callable[[Array], Array]
    moving: tuple[tuple[LoadPlan, bool], ...]
    turning: Array


@final
class DesignPlan(NamedTuple):
    """What n_b design variables change in a system with a `Plan`, for `SceneAccelerations`.

    `elements` are partials of the laws of the elements, as `Block.force_totals` takes them. `mass`
    maps a to (M a)_b, `loads` the factors of the loads to theirs, with n_b n_q rows each. `forces`,
    (n_b, n_q), are derivatives of gravity and steady loads, `constraints` as
    `ConstraintPlan.totals` takes them. `moved` names a moving load and a design variable by their
    numbers, with the load perturbed by an imaginary step.
    """

    n_b: int
    elements: tuple[Array, ...]
    mass: Csr
    forces: Array
    loads: Csr
    constraints: tuple[Array, ...]
    moved: tuple[tuple[int, int, LoadPlan], ...]


#: Factors of joints with two time derivatives, (3, k, n_parts), and of loads, (k, n_loads), at k
#: times, and their design partials, (n_b, 3, k, n_parts) and (n_b, k, n_loads), None where zero.
FactorTable: TypeAlias = tuple[Array, Array, Array | None, Array | None]


@final
class ListPlan(NamedTuple):
    """A system of lists of operations, for `Model` and `ComplexModel`.

    Lists take t, q, v, A, lam and b, and return Phi_q, Phi, dPhi/dt, d^2 Phi/dt^2, Q, M, and f_q
    with f_v behind it if forces use velocities. Values of matrices stand on the patterns B of Phi_q
    and K of all others. t is the time of a run plus `start`.
    """

    lists: tuple[OperationList, ...]
    b: Array
    weights: Array
    inverse_weights: Array
    B: Csr
    K: Csr
    velocity: bool
    start: float = 0.0

    def joint_factors(self, t: Array, orders: int) -> Array:
        """Return times in place of the time factors of a scene, shape (orders, k, 1); s."""
        return np.stack([self.start + t[:, None]] * orders)

    def load_factors(self, t: Array) -> Array:
        """Return times in place of the load factors of a scene, shape (k, 1); s."""
        return self.start + t[:, None]


@final
class CalledPlan(NamedTuple):
    """A system whose equations Python evaluates, for `Model` and `ComplexModel`.

    The functions return M(q), Phi_q(t, q), Phi(t, q) or its rates of the order of the motion behind
    t, and Q(t, q, v). Two
    more return (f_q, f_v or None) of (t, q, v, a, lam), and (P, P_q) of (t, q), the loads that turn
    with the motion. Values of matrices have the patterns B of Phi_q and K of all others.
    """

    functions: tuple[Callable[..., Any], ...]
    weights: Array
    inverse_weights: Array
    B: Csr
    K: Csr
    velocity: bool

    def joint_factors(self, t: Array, orders: int) -> Array:
        """Return times in place of the time factors of a scene, shape (orders, k, 1); s."""
        return np.stack([t[:, None]] * orders)

    def load_factors(self, t: Array) -> Array:
        """Return times in place of the load factors of a scene, shape (k, 1); s."""
        return t[:, None]


def real_part(plan: Any) -> Any:
    """Return a plan, or a part of one, with the real parts of its numbers, for `Model`."""
    if isinstance(plan, np.ndarray):
        return plan.real
    if isinstance(plan, tuple):
        return tuple(map(real_part, plan))
    if isinstance(plan, Block | ConstraintPlan | LoadPlan):
        kind, arguments = plan.__reduce__()
        return kind(*real_part(arguments))
    return plan
