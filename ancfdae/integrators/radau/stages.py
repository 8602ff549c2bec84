"""The equations of the three stages of a step, and their matrices.

With h^2 x the displacements of the stages from the motion at constant velocity,

    Q = q_0 + h c v_0 + h^2 x,     V = v_0 + h A^-1 x,     Q'' = A^-2 x,

the equations of a step are those of motion and the constraints at every stage,

    M(Q_i) Q_i'' + Phi_q^T lam_i - Q(t_i, Q_i, V_i) = 0,     Phi(t_i, Q_i) / h^2 = 0.

**Matrix.** With the matrices of every stage at its own state block (i, j) of K is
(A^-2)_ij M_i + h (A^-1)_ij f_v,i, and h^2 f_q,i more for i = j.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ancfdae.equations import Linearisation, MechanicalSystem
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.tableau import INVERSE, PLACES, SQUARED, at_stages
from ancfdae.kernels import CoupledArrays
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.coupled import coupled_arrays


class Stages(NamedTuple):
    """Positions, velocities, accelerations and multipliers of the stages, as rows."""

    q: Array
    v: Array
    a: Array
    lam: Array


class Begin(NamedTuple):
    """A step: its size, and the state that it begins from."""

    h: float
    t: float
    q: Array
    v: Array
    a: Array
    lam: Array

    @property
    def state(self) -> tuple[Array, Array, Array, Array]:
        """Coordinates, velocities, accelerations and multipliers at the start of the step."""
        return self[2:]

    @property
    def times(self) -> Array:
        """Times of the three stages, shape (3,); s."""
        return self.t + self.h * PLACES[:, 0]

    def stages(self, x: Array, lam: Array) -> Stages:
        """Return the stages of scaled displacements and multipliers."""
        h = self.h
        q = self.q + h * PLACES * self.v + h**2 * x
        return Stages(q, self.v + h * at_stages(INVERSE, x), at_stages(SQUARED, x), lam)


def linearised(system: MechanicalSystem, t: Array, *states: Array) -> Linearisation:
    """Linearise at some instants; an imaginary perturbation is left out."""
    local = system.linearise(t, *map(np.real, states))
    f_v = None if local.f_v is None else local.f_v.real
    return Linearisation(local.M.real, local.f_q.real, f_v, local.Phi_q.real)


def stage_matrices(problem: InitialValueProblem) -> CoupledArrays:
    """Return the coupled matrix for kernels; constraints are scaled by their rows at the start."""
    system, Phi_q = problem.system, problem.system.constraint_q(0.0, problem.initial.q)
    patterns = system.pattern, system.constraint_pattern
    layout = problem.matrices.layout(band=False)
    return coupled_arrays(3, *patterns, system.weights, Phi_q, layout and layout.order)
