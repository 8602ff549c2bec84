"""The search for an equilibrium, its result, and equilibria as the start of a motion.

**Design derivatives**, direct and transposed:

K q_b + Phi_q^T lam_b = Q_b - (Phi_q^T lam)_b,      K = (Phi_q^T lam)_q - Q_q Phi_q q_b = -Phi_b

In K of a thin beam, sums of axial stiffness leave the bending stiffness, (h/L)^2 times as large. A
solution with its factors is right to (L/h)^2 units of round-off, and Q_b for a length is the force
of a stretch that q_b takes back. Both are corrected by refinement: the residual of a solution is
differentiated as a whole, element by element, before anything is summed
(docs/theory/11-statics.md).
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.meshes import warn_of_mesh
from ancfdae.equations.saddle_points import (
    force_total,
    held_total,
    refuse_opened,
    solve,
    solve_transposed,
)
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import (
    Sensitivities,
    Statistics,
    pandas,
    rows_of_design,
)
from ancfdae.errors.kinds import (
    AncfdaeError,
    StabilityWarning,
    UnlikelyValueWarning,
)
from ancfdae.errors.outcomes import Verdict, uninterrupted
from ancfdae.errors.text import PrintedTable, TableText
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization
from ancfdae.numerics.threads import in_one_thread
from ancfdae.statics.balance import Balance
from ancfdae.statics.controlled import at_rest, with_states, without_states
from ancfdae.statics.exact_products import ExactProducts, Parts, refined
from ancfdae.statics.outcome import EquilibriumOutcome
from ancfdae.statics.search import SearchEnd, search
from ancfdae.statics.softness import softest


@final
class Tangent:
    """The factorised tangent matrix of an equilibrium; raises SingularMatrix if it is singular."""

    def __init__(self, system: MechanicalSystem, t: float, q: Array, lam: Array) -> None:
        balance = Balance(system, t, q, lam)
        self._system, self._t = system, t
        zero = np.zeros_like(q)
        self._q, self._lam, self._rest = q, lam, zero
        K, self._Phi_q = balance.tangent(1.0, q, lam), system.constraint_q(t, q)
        self._factors: Factorization = balance.factor(K, self._Phi_q)
        R, Phi = balance.unbalanced(q, lam), system.constraint(t, q)
        # The correction is not used if the state is not an equilibrium.
        beyond = solve(self._factors, R, -Phi)[0]
        balanced = balance.is_round_off(R, K, q, lam, beyond)
        self.exact = ExactProducts(system, t, q, lam, K, beyond if balanced else zero)

    @staticmethod
    def of(system: MechanicalSystem, at: Solution) -> Tangent:
        """Return the tangent matrix at the first time of an equilibrium of a system.

        With controllers it is the one of `Steady`, whose coordinates contain the states.
        """
        q = with_states(system, at.q[0], at.v[0])
        return Tangent(at_rest(system), float(at.t[0]), q, at.lam[0])

    def sensitivities(self) -> Parts:
        """Return q_b and lam_b, shapes (n_q, n_b) and (n_lam, n_b)."""
        system = self._system
        start = np.zeros((system.n_q, system.n_b)), np.zeros((system.n_lam, system.n_b))
        return refined(system, self._factors, start, self._left, solve)

    def pull_back(self, on_q: Array, on_lam: Array) -> Array:
        """Return q_b^T on_q + lam_b^T on_lam by transposed solves, shape (n_b,).

        With [mu, zeta] the transposed solution it is on_q^T s_b - [mu, zeta]^T r_b, where r_b is
        the total derivative of the equations along any s_b. With s_b of the start, which contains
        most of the stretch, round-off of mu is not multiplied by the force of that stretch.
        """
        system = self._system

        def left(mu: Array, zeta: Array) -> Parts:
            pushed = on_q - self.exact.transposed_times(mu)
            pushed = pushed - system.constraint_pattern.dot_transposed(self._Phi_q, zeta)
            return pushed, on_lam - system.constraint_pattern.dot(self._Phi_q, mu)

        none = 0 * on_q, 0 * on_lam
        mu, zeta = refined(system, self._factors, none, left, solve_transposed)
        s_b = system.start_b()[0]
        if not np.any(s_b):
            rest = self._rest[None]
            states = self._q[None], rest, rest, self._lam[None]
            return -system.pull_back(np.array([self._t]), states, (mu[None], zeta[None]))
        force, side = self._left(s_b, np.zeros((system.n_lam, system.n_b)))
        return np.asarray(on_q @ s_b + mu @ force + zeta @ side)

    def _left(self, q_b: Array, lam_b: Array) -> Parts:
        """Return minus the total derivatives of Phi_q^T lam - Q and of Phi along q_b, lam_b."""
        system, q, lam, t = self._system, self._q, self._lam, self._t
        still = np.zeros_like(q_b)
        force = self.exact.corrected(lambda q: force_total(system, t, q, self._rest, q_b, still))
        force = force - held_total(system, t, q, self._rest, lam, q_b)
        force = force - system.constraint_pattern.dot_transposed(self._Phi_q, lam_b)
        side = system.constraint_total(t, (q,), (q_b,))
        return force, -side


# -- equilibria --------------------------------------------------------------------------------


# Default limit of attempted load steps.
MAX_STEPS = 1000


@final
@dataclass(frozen=True, repr=False)
class Equilibrium(PrintedTable):
    """A state of static equilibrium under load, or the state at which the search for it ended.

    Attributes
    ----------
    q : array, shape (n_q,)
        Coordinates at equilibrium; m, slopes dimensionless.
    lam : array, shape (n_lam,)
        Lagrange multipliers of the joints; in N for constraints in m.
    outcome : EquilibriumOutcome
        How the search ended; `success` only if this is an equilibrium under the full load.
    solution : Solution
        The state as a solution with one time point and zero velocity, for all calls that take a
        solution: `position`, `reaction`, `observe`, plots.
    q_b, lam_b : array, shape (n_q, n_b) and (n_lam, n_b), or None
        Design derivatives; None without design variables or without success.
    """

    q: Array
    lam: Array
    outcome: EquilibriumOutcome
    solution: Solution
    q_b: Array | None = None
    lam_b: Array | None = None

    @property
    def fraction(self) -> float:
        """Load factor of the state, dimensionless; one if the search succeeded."""
        return self.outcome.fraction

    @property
    def statistics(self) -> Statistics:
        """Counters of the search; `steps` counts load steps."""
        return self.solution.statistics

    def to_dataframe(self) -> Any:
        """Return the coordinates as a pandas table, a row for each, by name.

        The column ``value`` is in m, for slopes dimensionless. Each design variable has a column of
        derivatives, such as ``d/d rod.height``.
        """
        table, sensitivities = {"value": self.q}, self.solution.sensitivities
        if sensitivities is not None:
            columns = zip(sensitivities.names, sensitivities.q_b[0].T, strict=True)
            table |= {f"d/d {name}": column for name, column in columns}
        coordinates = self.solution.to_dataframe().columns.rename("coordinate")
        return pandas().DataFrame(table, index=coordinates)

    def _printed(self) -> TableText:
        head = f"Equilibrium: {len(self.q)} coordinates, {len(self.lam)} multipliers"
        sensitivities = self.solution.sensitivities
        rows = [] if sensitivities is None else rows_of_design(sensitivities)
        return head, rows, str(self.outcome)


@final
class NoEquilibriumError(AncfdaeError):
    """Raised if no equilibrium was found from which a motion was to start.

    Attributes
    ----------
    equilibrium : Equilibrium
        The state at which the search ended.
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        super().__init__(f"start at rest: {equilibrium.outcome}")
        self.equilibrium = equilibrium


@in_one_thread
def find_equilibrium(
    system: MechanicalSystem,
    *,
    start: tuple[Array, Array] | None = None,
    near: bool = False,
    max_steps: int = MAX_STEPS,
    sensitivities: bool = False,
) -> Equilibrium:
    """Search for q and lam with Q(q) = Phi_q^T lam and Phi(q) = 0 at t = 0.

    The search begins at `start` (q, lam), or at the start of the system, and takes at most
    `max_steps` attempted load steps; with `sensitivities` the result has design derivatives. If the
    start is `near` the equilibrium, follower loads act in full from the beginning.

    Raises FreeMotionError if nothing restrains a motion; InvalidInputError if the start is not
    finite, constraints are linearly dependent, or a driver moves.
    """
    began = time.perf_counter()
    of = at_rest(system)
    q, lam = (of.start()[0], np.zeros(system.n_lam)) if start is None else start
    balance = Balance.of(of, 0.0, q, lam, follows=not near)
    balance.refuse_motion()
    end, derivatives = search(balance, max_steps), None
    if end.outcome.stable_to is not None and balance.gyroscopic:
        end = replace(end, outcome=replace(end.outcome, gyroscopic=True))
    if sensitivities and end.outcome.success:
        balance.work.factorisations += 1
        derivatives = Tangent(of, 0.0, end.q, end.lam).sensitivities()
    if end.outcome.success and system.traits.rows_left_out:
        refuse_opened(of, 0.0, end.q)
    if end.outcome.success and not near:
        warn_of_mesh("equilibrium", system, end.q[None], stacklevel=5)
        _warn_of_passage(system, np.stack([q, end.q]))
        if balance.judges and not (end.definite and system.traits.symmetric):
            end = _judged(balance, end)
    work, seconds = balance.work, time.perf_counter() - began
    counted = (work.steps, work.iterations, work.factorisations, work.residuals)
    statistics = Statistics(*counted, 0, seconds, work.rejected)
    solution = _solution(of, end, derivatives, statistics)
    q_b, lam_b = (None, None) if derivatives is None else derivatives
    if solution.sensitivities is not None:
        q_b = solution.sensitivities.q_b[0]
    return Equilibrium(solution.q[0], end.lam, end.outcome, solution, q_b, lam_b)


def _warn_of_passage(system: MechanicalSystem, q: Array) -> None:
    """Warn if surfaces touch on the straight way between two states q, (2, n_q), but at neither."""
    contacts = system.contacts()
    rate = q[1:] - q[:1]
    if contacts is None or not contacts.passes(np.array([0.0, 1.0]), q, np.repeat(rate, 2, axis=0)):
        return
    warnings.warn(
        "equilibrium: bodies or obstacles in contact loads lie between the start and this state, "
        "and the search may have passed through them. Plot both states; to end on the side of the "
        "start, bring bodies into touch by a damped motion, and start from its last state "
        "(NodalState).",
        UnlikelyValueWarning,
        stacklevel=5,
    )


def _judged(balance: Balance, end: SearchEnd) -> SearchEnd:
    """Return the end with its flutter; warn if round-off hides whether it is stable."""
    soft = softest(balance, 1.0, end.q, end.lam)
    if end.outcome.stable_to is None and not (end.definite or soft.judged):
        warnings.warn(
            "equilibrium: stability is undecided: its softest motion is neutral within the "
            "round-off of the stiffness, or joints that depend on each other hide it. Repeat it at "
            "a load that differs by 1 %, or look at the modes about this state.",
            StabilityWarning,
            stacklevel=4,
        )
    outcome = replace(end.outcome, flutter=soft.flutter, flutter_searched=soft.seen_whole)
    return replace(end, outcome=outcome)


def resting(system: MechanicalSystem, q: Array, lam: Array, stable: bool) -> Equilibrium:
    """Return the state q, lam, known to be in balance, as an `Equilibrium` without a search."""
    folded = system.folded(q)
    verdict = Verdict.FOLDED if folded else Verdict.EQUILIBRIUM
    outcome = EquilibriumOutcome(verdict, 1.0, 0, 0.0, None if stable else 0.0, folded=folded)
    statistics = Statistics(0, 0, 0, 0, 0, 0.0)
    solution = _solution(system, SearchEnd(q, lam, outcome), None, statistics)
    return Equilibrium(q, lam, outcome, solution)


def _solution(
    system: MechanicalSystem,
    end: SearchEnd,
    derivatives: tuple[Array, Array] | None,
    statistics: Statistics,
) -> Solution:
    (q, v), sensitivities = without_states(system, end.q), None
    if derivatives is not None:
        q_b, v_b = without_states(system, derivatives[0])
        rates = q_b[None], v_b[None], np.zeros_like(q_b)[None], derivatives[1][None]
        sensitivities = Sensitivities(system.design_names, system.b, *rates)
    zero, outcome = np.zeros_like(q)[None], end.outcome.of_run()
    return Solution(
        np.zeros(1),
        q[None],
        v[None],
        zero,
        end.lam[None],
        statistics,
        outcome,
        system.naming,
        sensitivities,
    )


@final
class RestingStart:
    """The equilibrium of a system at t = 0 as a start, computed when it is first needed.

    The system has the coordinates and design variables of the one that moves; the search starts at
    its own start.
    """

    def __init__(self, system: MechanicalSystem) -> None:
        self._system = system

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """The equilibrium under the full load.

        Raises NoEquilibriumError if there is none, FreeMotionError if nothing restrains a motion.
        Warns if it is unstable (StabilityWarning).
        """
        found = uninterrupted(find_equilibrium(self._system))
        if not found.outcome.success:
            raise NoEquilibriumError(found)
        if found.outcome.stable_to is not None or found.outcome.flutter is not None:
            warnings.warn(
                f"start at rest: {found.outcome} Round-off grows in a motion that starts there, "
                "and takes its derivatives with it. Start from another NodalState, near a stable "
                "equilibrium, or declare what pushes it.",
                StabilityWarning,
                stacklevel=2,
            )
        return found

    @cached_property
    def _tangent(self) -> Tangent:
        return Tangent.of(self._system, self.equilibrium.solution)

    @property
    def state(self) -> tuple[Array, Array]:
        """Q and v at the equilibrium, (n_q,) each; v has states of controllers alone."""
        return self.equilibrium.q, self.equilibrium.solution.v[0]

    @cached_property
    def state_b(self) -> tuple[Array, Array]:
        """Design derivatives of `state`, shape (n_q, n_b) each."""
        return without_states(self._system, self._tangent.sensitivities()[0])

    def pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return q_b^T on_q + v_b^T on_v for adjoint vectors of the start, (n_b,)."""
        on_q = with_states(self._system, on_q, on_v)
        return self._tangent.pull_back(on_q, 0 * self.equilibrium.lam)
