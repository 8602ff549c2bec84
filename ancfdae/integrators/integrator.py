"""What every integrator offers: same call, same solution, same statistics."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors import InvalidInput, require_positive
from ancfdae.integrators.integrand import Density, Integrand
from ancfdae.numerics.arrays import Array


class Integrator(abc.ABC):
    """Frozen settings of an integration method.

    `real_only` ones refuse systems at complex design values, as the complex step needs them;
    `order` is the power of the step with which errors fall, None where a tolerance controls them.
    """

    real_only: ClassVar[bool] = False
    order: ClassVar[int | None] = None

    def frozen(self, solution: Solution) -> Integrator:
        """Return the integrator that repeats the steps of a run at another design.

        Steps that follow from an error estimate jump with the design, and differences of runs show
        it. `HHT` can repeat them; other integrators return themselves.
        """
        return self

    @abc.abstractmethod
    def refined(self, solution: Solution) -> Integrator:
        """Return the integrator of a finer run: half the steps or a tenth of the tolerance."""

    @abc.abstractmethod
    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate from t = 0 to `t_end` (s).

        Parameters
        ----------
        system : MechanicalSystem
        t_end : float
        sensitivities : bool
            Whether the design derivatives are integrated along (direct differentiation).
        progress : bool
            Whether to show a progress bar.

        Returns
        -------
        Solution
            A failure on the way is reported by its outcome, and what was computed is kept.

        Raises
        ------
        InvalidInput
            If settings, end time or start make no sense; before anything is integrated.
        """

    def resume(
        self,
        system: MechanicalSystem,
        t_end: float,
        after: Solution,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Go on with a run of this integrator on this system, from its last instant to `t_end`.

        Returns the whole solution, which is that of a run in one go to round-off. Raises
        InvalidInput where the run is another one, or the integrator is not `HHT`.
        """
        raise InvalidInput(
            "after", "needs HHT, whose runs can go on", repr(self), "Run again from t = 0."
        )


class QuadratureIntegrator(Integrator):
    """An integrator that takes integrals beside the motion; others sum over their instants."""

    @abc.abstractmethod
    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
        integrands: Sequence[Integrand] = (),
    ) -> Solution:
        """Integrate, and feed the integrands; they are complete where the run reached `t_end`."""


@final
@dataclass(frozen=True)
class Seeds:
    """Partials of an objective in the states of every instant, rows; None for none.

    `densities` are the partials in integrals that a `QuadratureIntegrator` took beside the motion.
    """

    q: Array | None
    v: Array | None
    lam: Array | None
    densities: tuple[tuple[float, Density], ...] = ()

    def rows(self, part: slice) -> tuple[Array | None, Array | None, Array | None]:
        """Return those on q, v and lam of some instants."""
        q, v, lam = (
            None if x is None else np.ascontiguousarray(x[part], dtype=float)
            for x in (self.q, self.v, self.lam)
        )
        return q, v, lam


class AdjointIntegrator(Integrator):
    """An integrator that can also run backward through a finished run."""

    @abc.abstractmethod
    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient of an objective from its partials in the states (adjoint), (n_b,).

        The solution is a finished run of this integrator on this system. The explicit partial of
        the objective in b is left out.
        """


def require_rtol(where: str, rtol: float, least: float) -> None:
    """Refuse a relative tolerance outside the range that makes sense."""
    require_positive(where, rtol)
    if not least <= rtol <= 1e-2:
        raise InvalidInput(where, f"must lie in [{least:.0e}, 1e-2]", rtol, "Try 1e-8.")
