"""Base classes of the integrators, and of the integrals that they evaluate along a motion.

Integrals are sums over panels of quadrature points. The integrator chooses points and weights; the
integrand evaluates its function at the states there.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import ContactRecord, MissedContact
from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import Verdict
from ancfdae.numerics.arrays import Array

# Weight of the coarse error in the error estimate (DOP853: Hairer, Norsett & Wanner, II.10).
_COARSE = 0.1


@final
@dataclass(frozen=True)
class Rule:
    """Quadrature rule on a panel of length one, with n points.

    `weights`, (n,), minus the weights of an embedded rule of lower order are `error`, minus those
    of a rule of still lower order `coarse`; zero without such a rule.
    """

    weights: Array
    error: Array
    coarse: Array


@final
@dataclass(frozen=True)
class Points:
    """States at k quadrature points of several panels, panel after panel; h are panel lengths, s.

    q, v and lam have the shape (k, n), q_b, v_b and lam_b (k, n, n_b). Arrays that were not
    requested are None.
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
        """Quadrature weights of the points, shape (k,); s.

        They sum to the duration of the panels.
        """
        return np.outer(self.h, self.rule.weights).ravel()

    @property
    def weights_size(self) -> Array:
        """Positive weights with the sum of `weights`, (k,); s; for integrals of magnitudes."""
        size = np.abs(self.rule.weights)
        return np.outer(self.h, size / np.sum(size)).ravel()

    def errors(self, x: Array) -> Array:
        """Return estimated errors, (n,), of the integrals over time of the columns of x, (k, n)."""
        panels = x.reshape(len(self.h), -1, x.shape[1])
        fine, coarse = np.abs(np.stack([self.rule.error, self.rule.coarse]) @ panels).swapaxes(0, 1)
        size = np.hypot(fine, _COARSE * coarse)
        share = np.divide(fine, size, out=np.zeros_like(size), where=size != 0)
        total: Array = self.h @ (fine * share)
        return total


@final
@dataclass(frozen=True)
class PartialIntegral:
    """Integral of an integrand over a part of the run, of `duration` s.

    `slopes`, (n_b,), are the design derivatives of `value`; `size`, (n,), are integrals of
    magnitudes. `error` is estimated, relative to the size of the integral, and NaN if any value is
    not finite; `not_finite` is the time of the first such point, s, or None.
    """

    duration: float
    value: float
    slopes: Array
    size: Array
    error: float
    not_finite: float | None


class Integrand(abc.ABC):
    """A function of the states that is integrated over time along a run."""

    @abc.abstractmethod
    def part(self, points: Points) -> PartialIntegral:
        """Return the integral over the next part of the run; multipliers None count as NaN."""

    @abc.abstractmethod
    def add(self, part: PartialIntegral) -> None:
        """Add the integral over the next part of the run; parts come in the order of time."""


class Density(abc.ABC):
    """Partial derivatives of an integrand H(t, q, v, lam), for adjoint equations."""

    @abc.abstractmethod
    def partials(self, t: Array, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Return H_q and H_v, (k, n_q), and H_lam, (k, n_lam), at k states."""


class Integrator(abc.ABC):
    """Immutable settings of an integration method.

    If `real_only`, complex design values, which the complex step needs, are rejected. `order` is
    the power of the step size with which errors fall, None where a tolerance controls them.
    """

    real_only: ClassVar[bool] = False
    #: Whether the outcome of a run reports contacts that its steps passed over (`with_contacts`).
    checks_contacts: ClassVar[bool] = False
    order: ClassVar[int | None] = None

    @property
    def differentiates_runs(self) -> bool:
        """Whether `resume` can add the design derivatives to a run that has reached its end."""
        return False

    def frozen(self, solution: Solution) -> Integrator:
        """Return the integrator that repeats the steps of `solution` at another design.

        Steps chosen by an error estimate jump with the design, and so do differences of runs.
        Integrators that cannot repeat steps return themselves.
        """
        return self

    @abc.abstractmethod
    def refined(self, solution: Solution) -> Integrator:
        """Return the integrator for a finer run: half the step size or a tenth of the tolerance."""

    @abc.abstractmethod
    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate the motion of a system from t = 0 to `t_end` (s).

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
            If the run fails on the way, the solution holds the states up to there, and its outcome
            the reason.
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
        """Continue `after`, a run of this integrator on this system, from its last time to `t_end`.

        Returns the whole solution, equal to an uninterrupted run to round-off. Raises
        InvalidInputError if `after` is a run of another system or integrator, or the integrator
        cannot continue runs.
        """
        rule = "needs an integrator whose runs can go on, such as HHT"
        raise InvalidInputError("after", rule, repr(self), "Run again from t = 0.")


class QuadratureIntegrator(Integrator):
    """An integrator that evaluates integrals during its steps; others sum over output times."""

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
        """Integrate the motion and feed `integrands`, complete if the run reaches `t_end` (s)."""

    def at_end(self, system: MechanicalSystem, t_end: float) -> Self:
        """Return the integrator for a run of which only the end is read; by default itself."""
        return self


#: Partial derivatives of an objective in q, v and lam, one row per state; None for zeros.
OnStates: TypeAlias = tuple[Array | None, Array | None, Array | None]


@final
@dataclass(frozen=True)
class Seeds:
    """Partial derivatives of an objective in q, v and lam, one row per output time; None for zeros.

    They start the backward pass. `densities` are pairs of a weight and the partial derivatives of
    an integrand that a `QuadratureIntegrator` integrated during its steps.
    """

    q: Array | None
    v: Array | None
    lam: Array | None
    densities: tuple[tuple[float, Density], ...] = ()

    def rows(self, part: slice) -> OnStates:
        """Return the partial derivatives in q, v and lam of the states with indices `part`."""
        q, v, lam = (
            None if x is None else np.ascontiguousarray(x[part], dtype=float)
            for x in (self.q, self.v, self.lam)
        )
        return q, v, lam


class AdjointIntegrator(Integrator):
    """An integrator that can also run backward through a finished run (adjoint)."""

    @abc.abstractmethod
    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient of an objective, (n_b,), from its partial derivatives in the states.

        `solution` is a finished run of this integrator on this system. The explicit partial
        derivative of the objective in b is not included.
        """

    def back_factorisations(self, solution: Solution) -> int:
        """Return how many matrices `pull_back` factorises for a run; zero if not counted."""
        return 0


class DefectIntegrator(AdjointIntegrator):
    """An adjoint integrator that can compute the residuals of the smooth motion in its steps."""

    @abc.abstractmethod
    def discretisation_error(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds
    ) -> float:
        """Return the estimated change of an objective if the steps had no defects, in its unit.

        Arguments as in `pull_back`; the solution must have at least three output times.
        """


class RunInParts(abc.ABC):
    """A run whose parts can be integrated again, from one index of its time points `t` to another.

    A part starts from a checkpoint, the full state of the method at the end of the part before.
    `taken` counts the steps, repeated ones included. A step has `degree` time points, as in a
    solution; parts end at ends of steps.
    """

    degree: ClassVar[int] = 1
    t: Array
    taken: int

    @abc.abstractmethod
    def start(self) -> Any:
        """Return the checkpoint at the start of the run."""

    @abc.abstractmethod
    def part(self, node: Any, first: int, last: int) -> tuple[Solution, Any]:
        """Integrate from a checkpoint at index `first` of `t` to index `last`.

        Return the states from `first` to `last` as a solution, and the checkpoint at its end. If
        the part fails or is interrupted, the solution holds the steps so far and its outcome says
        so.
        """

    @abc.abstractmethod
    def pull_back(
        self, run: Solution, node: Any, first: int, seeds: Seeds, on: Array
    ) -> tuple[Array, Array]:
        """Run the adjoint recurrence backward over a part that starts at the checkpoint `node`.

        `on` are the adjoint vectors of the states after the part. Return its contribution to the
        gradient, (n_b,), and the adjoint vectors of the states before it.
        """

    @abc.abstractmethod
    def close(self, on: Array, seeds: Seeds, gradient: Array) -> Array:
        """Return the gradient, (n_b,), with adjoint vectors `on` pulled back through the start."""

    @abc.abstractmethod
    def no_covectors(self) -> Array:
        """Return the zero adjoint vectors with which the backward pass starts."""


class PartwiseIntegrator(Integrator):
    """An integrator whose runs can be integrated part by part, as checkpointing needs."""

    @abc.abstractmethod
    def replay(self, system: MechanicalSystem, t_end: float) -> RunInParts:
        """Return the run to `t_end` in parts; InvalidInputError unless its steps are known."""


def require_rtol(where: str, rtol: float, least: float) -> None:
    """Raise InvalidInputError unless a relative tolerance lies between `least` and 1e-2."""
    require_positive(where, rtol)
    if not least <= rtol <= 1e-2:
        repair = "For example 1e-6, or 1e-8 for gradients."
        raise InvalidInputError(where, f"must lie in [{least:.0e}, 1e-2]", rtol, repair)


def with_contacts(run: Solution, contacts: ContactRecord, whole: bool = True) -> Solution:
    """Return `run`, with the outcome MISSED_CONTACT if its steps passed over a contact.

    `contacts` records the states of the run, which may be a part of a longer one. Contacts are
    judged only if the run is `whole`, or the last part.
    """
    if not run.outcome.success:
        return run
    contacts.follow(run.t, run.q, run.v)
    return refused(run, contacts.missed() if whole else None)


def refused(run: Solution, missed: MissedContact | None) -> Solution:
    """Return `run` with the outcome that it missed a contact; unchanged if `missed` is None."""
    if missed is None:
        return run
    step = max(int(np.searchsorted(run.t, missed.time, side="right")) - 1, 0) // run.degree
    verdict, advice = Verdict.MISSED_CONTACT, missed.advice
    outcome = replace(run.outcome, verdict=verdict, time=missed.time, step=step, advice=advice)
    return replace(run, outcome=outcome)
