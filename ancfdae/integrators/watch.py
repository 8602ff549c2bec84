"""Checks recorded states of a run in groups, and cuts the run back to the last correct state."""

from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.integrators.prescribed_motion import Branch, Lost
from ancfdae.integrators.recorder import SolutionRecorder

# Instants that are checked together: one by one they would cost a quarter of a small step.
_TOGETHER = 64


@final
class Watch:
    """Checks each instant of a recorder once."""

    def __init__(self, system: MechanicalSystem, recorder: SolutionRecorder) -> None:
        self._branch, self._recorder = Branch(system), recorder
        self._right = max(recorder.instants, 1)

    def missed(self, all_of_them: bool = False) -> Lost | None:
        """Check recorded states, in packets or all; return the first step that went wrong, or None.

        The recorder then forgets the step in which that happened and all after it.
        """
        recorder = self._recorder
        self._right = min(self._right, recorder.instants)
        late = recorder.instants - self._right
        if not late or (late < _TOGETHER and not all_of_them):
            return None
        # What has diverged overflows: it is on no branch.
        with np.errstate(all="ignore"):
            lost = self._branch.lost(recorder.last(late + 1))
        if lost is None:
            self._right = recorder.instants
            return None
        recorder.cut(self._right + lost.first)
        self._right = recorder.instants
        return lost
