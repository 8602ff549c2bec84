"""The search for an equilibrium, and what it found."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.errors import AncfdaeError, SingularMatrix, Verdict
from ancfdae.numerics.arrays import Array
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution
from ancfdae.protocol.solution_parts import Sensitivities, Statistics
from ancfdae.statics.balance import Balance, Failure, Work
from ancfdae.statics.derivatives import Tangent
from ancfdae.statics.load_path import LoadPath, Place
from ancfdae.statics.mobility import free_mechanism
from ancfdae.statics.outcome import LoadOutcome
from ancfdae.statics.settle import Settling
from ancfdae.statics.softness import Softness, softest
from ancfdae.text import listed

# The tangent has lost its stiffness where the softest motion keeps this part of that at the start.
_LOST = 0.05
# Cosine between path and softest motion above which the path turns back along it.
_ALONG = 0.5
# Attempted steps of the load.
MAX_STEPS = 1000


@final
@dataclass(frozen=True)
class Equilibrium:
    """A state of rest under load, or how far a search for one has come.

    Attributes
    ----------
    q : array, shape (n_q,)
        Coordinates.
    lam : array, shape (n_lam,)
        Multipliers.
    outcome : LoadOutcome
        How the search ended; `success` only if this is an equilibrium under the full load.
    solution : Solution
        The same as a solution of one instant at rest, with which everything that takes a
        solution works: `position`, `reaction`, `observe`, plots.
    q_b, lam_b : array, shape (n_q, n_b) and (n_lam, n_b), or None
        Design derivatives; None without design variables or without success.
    """

    q: Array
    lam: Array
    outcome: LoadOutcome
    solution: Solution
    q_b: Array | None = None
    lam_b: Array | None = None

    @property
    def fraction(self) -> float:
        """Part of the load that it is in balance with; one if the search succeeded."""
        return self.outcome.fraction

    @property
    def statistics(self) -> Statistics:
        """What the search cost; steps are those of the load."""
        return self.solution.statistics

    def __repr__(self) -> str:
        """Return sizes, outcome and design variables."""
        own = self.solution.sensitivities
        lines = [f"Equilibrium: {len(self.q)} coordinates, {len(self.lam)} multipliers"]
        lines += [str(self.outcome)]
        lines += [] if own is None else [f"derivatives in {listed(own.names)}"]
        return "\n".join(lines)


@final
class NoEquilibrium(AncfdaeError):
    """A motion was to start from an equilibrium that was not found.

    Attributes
    ----------
    equilibrium : Equilibrium
        What was found.
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        super().__init__(f"start at rest: {equilibrium.outcome}")
        self.equilibrium = equilibrium


def find_equilibrium(
    system: MechanicalSystem,
    *,
    start: Equilibrium | None = None,
    max_steps: int = MAX_STEPS,
    sensitivities: bool = False,
    t: float = 0.0,
) -> Equilibrium:
    """Search for q and lam with Q(q) = Phi_q^T lam and Phi(q) = 0.

    Parameters
    ----------
    system : MechanicalSystem
    start : Equilibrium, optional
        Where to start instead of at the start of the system.
    max_steps : int
        Attempted steps of the load.
    sensitivities : bool
        Whether to differentiate what was found.
    t : float
        Instant at which forces and constraints count; s.

    Raises
    ------
    FreeMechanism
        If a motion is held by nothing.
    InvalidInput
        If the start is not finite, or constraints depend on each other.
    """
    began = time.perf_counter()
    q, lam = (system.start()[0], np.zeros(system.n_lam)) if start is None else (start.q, start.lam)
    search = _Search(Balance.of(system, t, q, lam), max_steps)
    search.run()
    work, outcome = search.balance.work, search.outcome()
    derivatives = None
    if sensitivities and outcome.success:
        work.factorisations += 1
        derivatives = Tangent(system, t, search.q, search.lam).sensitivities()
    solution = _solution(search, outcome, derivatives, time.perf_counter() - began)
    return Equilibrium(search.q, search.lam, outcome, solution, *(derivatives or (None, None)))


@final
class _Search:
    """One search: along the path of loads, or downhill where the start has no stiffness."""

    def __init__(self, balance: Balance, max_steps: int) -> None:
        self.balance, self._max_steps = balance, max_steps
        self.q, self.lam = balance.q_0, balance.lam_0
        self._verdict, self._fraction, self._residual = Verdict.INTERRUPTED, 0.0, 0.0
        self._unstable = False

    @cached_property
    def _at_start(self) -> Softness:
        return softest(self.balance, self.balance.q_0, self.balance.lam_0)

    def outcome(self) -> LoadOutcome:
        """Return how it ended."""
        steps = self.balance.work.steps
        return LoadOutcome(self._verdict, self._fraction, steps, self._residual, self._unstable)

    def run(self) -> None:
        """Search."""
        if self._at_start.free.shape[1]:
            self._settle()
        else:
            self._follow()

    def _follow(self) -> None:
        balance = self.balance
        try:
            factors = balance.factor(balance.tangent(self.q, self.lam), self.q)
        except SingularMatrix:
            self._verdict = Verdict.SINGULAR
            return
        first = Place(0.0, self.q, self.lam, *balance.path_tangent(factors), factors.sign())
        path = LoadPath(balance, first, self._max_steps)
        self._verdict = path.follow()
        last = path.places[-1]
        self.q, self.lam, self._fraction = last.q, last.lam, last.s
        self._unstable = self._is_unstable(last.sign)
        if self._verdict is not Verdict.EQUILIBRIUM:
            self._residual = path.residual
            self._verdict = self._reason(last, self._verdict)

    def _reason(self, last: Place, verdict: Verdict) -> Verdict:
        """Tell a load that cannot grow, and a branching of the path, from other failures."""
        if verdict in (Verdict.INTERRUPTED, Verdict.STEP_LIMIT):
            return verdict
        now, before = softest(self.balance, last.q, last.lam), self._at_start
        if len(now.kappa) == 0 or now.kappa[0] > _LOST * before.kappa[0]:
            return verdict
        along = now.aligned(last.q_s) > _ALONG
        return Verdict.LIMIT_POINT if along else Verdict.BIFURCATION

    def _settle(self) -> None:
        balance = self.balance
        downhill = Settling(balance, self._max_steps)
        self._verdict = downhill.run()
        self.q, self.lam, self._residual = downhill.q, downhill.lam, downhill.residual
        if downhill.gone:
            raise self._free(balance.q_0, self._at_start.free)
        if self._verdict is not Verdict.EQUILIBRIUM:
            return
        left = softest(balance, self.q, self.lam).free
        if left.shape[1]:
            raise self._free(self.q, left)
        found = balance.solve(1.0, self.q, self.lam)
        if isinstance(found, Failure):
            self._verdict, self._residual = found.verdict, found.residual
            return
        self.q, self.lam = found.q, found.lam
        self._fraction, self._residual = 1.0, 0.0
        self._unstable = self._is_unstable(found.factors.sign())

    def _is_unstable(self, sign: float) -> bool:
        """Compare with a stable tangent: as many negative eigenvalues as constraints."""
        return sign != (-1.0) ** self.balance.system.n_lam

    def _free(self, q: Array, motions: Array) -> Exception:
        return free_mechanism(self.balance.system.naming, q, motions)


def _solution(
    search: _Search,
    outcome: LoadOutcome,
    derivatives: tuple[Array, Array] | None,
    seconds: float,
) -> Solution:
    system, work = search.balance.system, search.balance.work
    q, zero = search.q[None], np.zeros_like(search.q)[None]
    own = None
    if derivatives is not None:
        q_b, lam_b = (x[None] for x in derivatives)
        still = np.zeros_like(q_b)
        own = Sensitivities(system.design_names, system.b, q_b, still, still, lam_b)
    return Solution(
        t=np.array([search.balance.t]),
        q=q,
        v=zero,
        a=zero,
        lam=search.lam[None],
        statistics=_statistics(work, seconds),
        outcome=outcome.of_run(),
        naming=system.naming,
        sensitivities=own,
    )


def _statistics(work: Work, seconds: float) -> Statistics:
    counted = (work.steps, work.iterations, work.factorisations, work.residuals)
    return Statistics(*counted, 0, seconds, work.rejected)
