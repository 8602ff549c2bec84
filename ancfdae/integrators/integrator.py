"""Base class of all integrators, and integrals along a motion.

Integrals along a motion: functions of the states, on panels of quadrature points.

The integrator says where the points lie and which weights they have; what is made of the values
there is the integrand's.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array

# How the errors of two rules make that of the better one (DOP853: Hairer, Norsett & Wanner, II.10).
_COARSE = 0.1


@final
@dataclass(frozen=True)
class Rule:
    """Quadrature on a panel of length one.

    `error` is the weights minus those of a rule of lower order, `coarse` the same for a rule of
    lower order yet; zero without one.
    """

    weights: Array
    error: Array
    coarse: Array


@final
@dataclass(frozen=True)
class Points:
    """States at k points of some panels, panel after panel; h are the lengths of the panels.

    q, v and lam have the shape (k, n), q_b, v_b and lam_b (k, n, n_b). What is not asked for is
    None.
    """

    rule: Rule
    h: Array
    t: Array
    q: Array
    v: Array
    q_b: Array | None = None
    v_b: Array | None = None
    lam: Array | None = None
    lam_b: Array | None = None

    @property
    def weights(self) -> Array:
        """Weights of the points, shape (k,); they sum to the duration."""
        return np.outer(self.h, self.rule.weights).ravel()

    @property
    def weights_size(self) -> Array:
        """Positive weights of the same duration, for sizes."""
        size = np.abs(self.rule.weights)
        return np.outer(self.h, size / np.sum(size)).ravel()

    def errors(self, x: Array) -> Array:
        """Estimate the errors of the integrals of the columns of x, shape (k, n) to (n,)."""
        panels = x.reshape(len(self.h), -1, x.shape[1])
        fine, coarse = (
            np.abs(np.einsum("p,kpn->kn", e, panels)) for e in (self.rule.error, self.rule.coarse)
        )
        size = np.hypot(fine, _COARSE * coarse)
        share = np.divide(fine, size, out=np.zeros_like(size), where=size != 0)
        total: Array = self.h @ (fine * share)
        return total


@final
@dataclass(frozen=True)
class PartialIntegral:
    """Integral of an integrand over a part of the run.

    `slopes` has the shape (n_b,); `size`, (n,), are integrals without signs. The error is
    estimated, relative to the size of the integral, nan if anything is not finite; `not_finite` is
    the time of the first such point.
    """

    duration: float
    value: float
    slopes: Array
    size: Array
    error: float
    not_finite: float | None


class Integrand(abc.ABC):
    """A function of the states that is summed up along a run."""

    @abc.abstractmethod
    def part(self, points: Points) -> PartialIntegral:
        """Evaluate it on the next part of the run; without multipliers as if they were NaN."""

    @abc.abstractmethod
    def add(self, part: PartialIntegral) -> None:
        """Add the next part of the run, in the order of time."""


class Density(abc.ABC):
    """Partials of an integrand, for adjoint equations."""

    @abc.abstractmethod
    def partials(self, t: Array, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Return H_q, H_v and H_lam at states, one row each."""


class Integrator(abc.ABC):
    """Frozen settings of an integration method.

    `real_only` ones refuse systems at complex design values, as the complex step needs them;
    `order` is the power of the step with which errors fall, None where a tolerance controls them.
    """

    real_only: ClassVar[bool] = False
    #: Whether runs come with the outcome that they miss a contact (`with_contacts`).
    checks_contacts: ClassVar[bool] = False
    order: ClassVar[int | None] = None

    @property
    def differentiates_runs(self) -> bool:
        """Whether `resume` can add the derivatives to a run that has reached its end."""
        return False

    def frozen(self, solution: Solution) -> Integrator:
        """Return the integrator that repeats the steps of a run at another design.

        Steps that follow from an error estimate jump with the design, and differences of runs show
        it. Integrators that cannot repeat them return themselves.
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
            End time; s.
        sensitivities : bool
            Whether the design derivatives are integrated along (direct differentiation).
        progress : bool
            Whether to show a progress bar.

        Returns
        -------
        Solution
            A failure on the way is reported by its outcome, and what was computed is kept.
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
        InvalidInputError where the run is another one, or the integrator cannot go on.
        """
        rule = "needs an integrator whose runs can go on, such as HHT"
        raise InvalidInputError("after", rule, repr(self), "Run again from t = 0.")


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

    def at_end(self, system: MechanicalSystem, t_end: float) -> Self:
        """Return the integrator for a run that is read at its end alone; by default itself."""
        return self


#: Covectors of an objective on q, v and lam, rows of states; None for zeros.
OnStates: TypeAlias = tuple[Array | None, Array | None, Array | None]


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

    def rows(self, part: slice) -> OnStates:
        """Return the seeds on q, v and lam of the states `part`."""
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

    def back_factorisations(self, solution: Solution) -> int:
        """Return how many matrices `pull_back` factorises over a run; zero if it is not counted."""
        return 0


class DefectIntegrator(AdjointIntegrator):
    """An integrator that knows the defects which the smooth motion leaves in its steps."""

    @abc.abstractmethod
    def discretisation_error(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds
    ) -> float:
        """Return the change of an objective if the steps had no defects, in its unit.

        The arguments are those of `pull_back`; there are three instants at least.
        """


class RunInParts(abc.ABC):
    """A run whose parts can be taken again, from instant `first` to instant `last` of `t`.

    A part begins with the node that the one before ends with, all that the method knows there.
    `taken` counts the steps, repeated ones included. A step has `degree` instants, as in a
    solution; parts end at ends of steps.
    """

    degree: ClassVar[int] = 1
    t: Array
    taken: int

    @abc.abstractmethod
    def start(self) -> Any:
        """Return the node before the first step."""

    @abc.abstractmethod
    def part(self, node: Any, first: int, last: int) -> tuple[Solution, Any]:
        """Step from a node at `first` to `last`; return the states there and between, and the end.

        A part that fails or is interrupted holds the steps so far; its outcome says so.
        """

    @abc.abstractmethod
    def pull_back(
        self, run: Solution, node: Any, first: int, seeds: Seeds, on: Array
    ) -> tuple[Array, Array]:
        """Run the transposed recurrence back over a part that begins with a node.

        Returns the gradient of the part, (n_b,), and covectors on the states before it from those
        after it, `on`.
        """

    @abc.abstractmethod
    def close(self, on: Array, seeds: Seeds, gradient: Array) -> Array:
        """Pull covectors on the states before the first step back through the start."""

    @abc.abstractmethod
    def no_covectors(self) -> Array:
        """Return the zero adjoint vectors with which the backward pass starts."""


class PartwiseIntegrator(Integrator):
    """An integrator whose runs can be taken part by part."""

    @abc.abstractmethod
    def replay(self, system: MechanicalSystem, t_end: float) -> RunInParts:
        """Return the run to `t_end`; InvalidInputError where its steps are not known before."""


def require_rtol(where: str, rtol: float, least: float) -> None:
    """Refuse a relative tolerance outside the range that makes sense."""
    require_positive(where, rtol)
    if not least <= rtol <= 1e-2:
        repair = "For example 1e-6, or 1e-8 for gradients."
        raise InvalidInputError(where, f"must lie in [{least:.0e}, 1e-2]", rtol, repair)
