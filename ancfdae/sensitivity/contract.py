"""What every method of differentiating a run offers."""

from __future__ import annotations

import abc
from collections.abc import Sequence

import numpy as np

from ancfdae.integrators import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.solution import Sensitivities, Solution
from ancfdae.system import MechanicalSystem


class Method(abc.ABC):
    """Frozen settings of a method that differentiates a whole run."""

    @abc.abstractmethod
    def differentiate(
        self, system: MechanicalSystem, t_end: float, integrator: Integrator, progress: bool
    ) -> Solution:
        """Return the solution with the design derivatives of its trajectory.

        A run that ends early yields derivatives up to the last instant that all runs reached.
        """


def with_sensitivities(
    system: MechanicalSystem,
    solution: Solution,
    columns: Sequence[tuple[Array, Array, Array, Array]],
) -> Solution:
    """Attach derivatives given as columns (q_b, v_b, a_b, lam_b), one per design variable.

    Everything is cut to the shortest column.
    """
    rows = min([len(solution.t), *(len(column[0]) for column in columns)])
    parts = [
        np.stack([column[k][:rows] for column in columns], axis=-1)
        if columns
        else np.zeros((rows, n, 0))
        for k, n in enumerate((system.n_q, system.n_q, system.n_q, system.n_lam))
    ]
    return Solution(
        t=solution.t[:rows],
        q=solution.q[:rows],
        v=solution.v[:rows],
        a=solution.a[:rows],
        lam=solution.lam[:rows],
        statistics=solution.statistics,
        outcome=solution.outcome,
        naming=solution.naming,
        sensitivities=Sensitivities(
            system.design_names, system.b, parts[0], parts[1], parts[2], parts[3]
        ),
    )
