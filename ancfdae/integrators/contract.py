"""What every integrator offers: same call, same solution, same statistics."""

from __future__ import annotations

import abc

from ancfdae.solution import Solution
from ancfdae.system import MechanicalSystem


class Integrator(abc.ABC):
    """Frozen settings of an integration method."""

    @abc.abstractmethod
    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate from t = 0 to `t_end`.

        Parameters
        ----------
        system : MechanicalSystem
        t_end : float
            End time; s.
        sensitivities : bool
            Whether the design derivatives of the trajectory are integrated along
            (direct differentiation).
        progress : bool
            Whether to show a progress bar.

        Returns
        -------
        Solution
            Trouble on the way is told by its outcome, and what was computed is kept.

        Raises
        ------
        InvalidInput
            If settings, end time or start make no sense; before anything is integrated.
        """
