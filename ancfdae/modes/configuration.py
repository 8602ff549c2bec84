"""The configuration about which motions are small, and its design derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.errors.checks import require_array
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class LinearisationPoint:
    """Coordinates and multipliers at rest.

    Attributes
    ----------
    q : array, shape (n_q,)
        Coordinates; m, slopes dimensionless.
    lam : array, shape (n_lam,)
        Multipliers, whose reactions pre-stress the joints; in N for constraints in m.
    q_b, lam_b : array, shape (n_q, n_b) and (n_lam, n_b), or None
        Design derivatives of q and lam; None if q and lam do not depend on the design.
    t : float
        Time at which prescribed motions are evaluated; s.
    v : array, shape (n_q,), or None
        Velocities there, which must be small; None for rest.
    """

    q: Array
    lam: Array
    q_b: Array | None = None
    lam_b: Array | None = None
    t: float = 0.0
    v: Array | None = None

    def __repr__(self) -> str:
        sizes = f"{len(self.q)} coordinates, {len(self.lam)} multipliers"
        return f"LinearisationPoint: {sizes}, t = {self.t:.6g}"

    @staticmethod
    def of(solution: Solution, instant: int = -1) -> LinearisationPoint:
        """Return an instant of a run, with its derivatives if the run has them.

        Parameters
        ----------
        solution : Solution
        instant : int
            Its number; the last by default.

        Raises
        ------
        InvalidInputError
            If the run has fewer than `instant` + 1 states.
        """
        count = len(solution.t)
        if not -count <= instant < count:
            raise InvalidInputError(
                "instant", f"must lie in 0 to {count - 1}", instant, "-1 is the last."
            )
        sensitivities = solution.sensitivities
        return LinearisationPoint(
            solution.q[instant],
            solution.lam[instant],
            None if sensitivities is None else sensitivities.q_b[instant],
            None if sensitivities is None else sensitivities.lam_b[instant],
            float(solution.t[instant]),
            solution.v[instant],
        )

    def check(self, system: MechanicalSystem) -> None:
        """Refuse other shapes than those of a system, and values that are not finite."""
        require_array("LinearisationPoint.q", self.q, (system.n_q,))
        require_array("LinearisationPoint.lam", self.lam, (system.n_lam,))
        if self.q_b is not None:
            require_array("LinearisationPoint.q_b", self.q_b, (system.n_q, system.n_b))
        if self.lam_b is not None:
            require_array("LinearisationPoint.lam_b", self.lam_b, (system.n_lam, system.n_b))
        if self.v is not None:
            require_array("LinearisationPoint.v", self.v, (system.n_q,))
