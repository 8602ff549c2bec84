"""Ten figures of report `performance` in processor time, each on a scene of that report."""

import sys
import time
from pathlib import Path

# Behind what is installed, so that asv measures the package of the commit that it has built, on
# the scenes of this checkout.
sys.path.append(str(Path(__file__).resolve().parents[1]))

from ancfdae import DOP853, HHT, Adjoint, Integral, assemble, differentiate, gradient, simulate
from ancfdae.observables import position
from validation.performance.mechanisms import chain, flexible_slider_crank, rigid_slider_crank
from validation.performance.scale import cantilever, variables
from validation.performance.steps import crank_variables
from validation.scenes import crank_slider, pendulum

STEP = 2.0**-10
HHT_I3 = HHT(STEP, newton_tolerance=1e-8)
SCENES = {
    "pendulum": (pendulum, 256),
    "crank-slider": (crank_slider, 128),
    "rigid slider-crank": (rigid_slider_crank, 512),
    "slider-crank with 4 cables": (lambda: flexible_slider_crank(4), 256),
    "chain of 20 bodies": (lambda: chain(20), 128),
    "1,000 elements": (lambda: cantilever(1_000), 8),
}


class Steps:
    """Runs of HHT-I3; the number of steps is that of `SCENES`."""

    timer = time.process_time
    param_names = ("scene",)
    params = (list(SCENES),)

    def setup(self, name: str) -> None:
        """Assemble the scene."""
        make, self.steps = SCENES[name]
        self.system = assemble(make())

    def time_steps(self, name: str) -> None:
        """Measure the run."""
        simulate(self.system, self.steps * STEP, HHT_I3)


class Derivatives:
    """Derivatives of the crank-slider in six variables, 128 steps, and an explicit run."""

    timer = time.process_time

    def setup(self) -> None:
        """Assemble the scene."""
        scene = crank_slider()
        self.system = assemble(scene, crank_variables())
        self.objective = Integral(position(scene.beams[-1].at_end, 0))

    def time_direct(self) -> None:
        """Measure direct differentiation."""
        differentiate(self.system, 128 * STEP, HHT_I3)

    def time_adjoint(self) -> None:
        """Measure the discrete adjoint."""
        gradient(self.system, self.objective, 128 * STEP, HHT_I3, method=Adjoint())

    def time_explicit(self) -> None:
        """Measure DOP853 with the derivatives beside the motion."""
        differentiate(self.system, 0.01, DOP853(1e-6))


class Assembly:
    """A thousand elements whose heights are design variables."""

    timer = time.process_time

    def time_assembly(self) -> None:
        """Measure the assembly."""
        assemble(cantilever(1_000), variables(1_000))
