"""The reports that can be run, as an explicit list.

To add one, write a module with a function that fills a `Report`, and enter it in `CATALOGUE`.
"""

from collections.abc import Callable
from dataclasses import dataclass

from validation import (
    elements,
    error_bars,
    external_dae,
    integrators,
    work_precision,
)
from validation.crank_slider import report as crank_slider
from validation.design import report as design
from validation.events import report as events
from validation.extremes import report as extremes
from validation.literature import report as literature
from validation.models import report as models
from validation.peers import report as peers
from validation.pendulum import report as pendulum
from validation.performance import report as performance
from validation.report import Report
from validation.rods import report as rods
from validation.rotation import report as rotation
from validation.test_set import report as test_set
from validation.tolerance import report as tolerance

__all__ = ["CATALOGUE", "Definition"]


@dataclass(frozen=True)
class Definition:
    """A report that can be run.

    Parameters
    ----------
    name : str
        Name on the command line and of the output folder.
    title : str
        Heading of the report.
    question : str
        What the report answers, one sentence.
    run : callable
        ``run(report, quick)`` fills the report; `quick` asks for coarse settings that exercise
        every part of it without giving figures worth quoting.
    source : str
        What the claims of the report are compared with, one word.
    """

    name: str
    title: str
    question: str
    run: Callable[[Report, bool], None]
    source: str = "paper"


CATALOGUE: tuple[Definition, ...] = (
    Definition(
        name="pendulum",
        title="The paper's flexible pendulum",
        question="Do the motion and the design sensitivities of the paper's planar pendulum come "
        "out as printed, and how far are they from the continuous-in-time answer?",
        run=pendulum.run,
    ),
    Definition(
        name="elements",
        title="How many elements a beam needs",
        question="How fast do deflection, large rotation and first frequency converge with the "
        "number of elements, for every strain energy and slenderness?",
        run=elements.run,
        source="theory",
    ),
    Definition(
        name="crank-slider",
        title="The paper's spatial crank-slider",
        question="Do direct differentiation and the adjoint, discrete and continuous, agree on the "
        "paper's second experiment, what do they cost, and why do two of its sensitivities "
        "disagree with finite differences?",
        run=crank_slider.run,
    ),
    Definition(
        name="external-dae",
        title="External DAE benchmarks",
        question="Do published multibody problems that a user brings as a system of equations come "
        "out right, motion and design sensitivities, by every integrator and every method?",
        run=external_dae.run,
        source="benchmark",
    ),
    Definition(
        name="integrators",
        title="The integrators compared on the paper's scenes",
        question="How many digits of motion, multipliers and sensitivities do HHT-I3, IDA, IDAS "
        "and the explicit integrator agree on, at what cost, and why not on more?",
        run=integrators.run,
    ),
    Definition(
        name="error-bars",
        title="How often error bars hold",
        question="Do the error bars of objectives and gradients contain the true error, and how "
        "much better are the extrapolated values?",
        run=error_bars.run,
        source="literature",
    ),
    Definition(
        name="extremes",
        title="Where the numerics end",
        question="Which moduli, shapes, steps, sizes, ratios, places and units does a simulation "
        "survive, how exactly, and how does it say so where it does not?",
        run=extremes.run,
        source="aim",
    ),
    Definition(
        name="work-precision",
        title="Work and precision of motion and gradient",
        question="Which integrator gives a motion or a gradient of a wanted accuracy at the least "
        "processor time, on soft and stiff, damped and undamped scenes, and what does error "
        "control of HHT-I3 gain?",
        run=work_precision.run,
        source="expectation",
    ),
    Definition(
        name="tolerance",
        title="Gradients to a tolerance",
        question="Is a gradient that was asked for to a tolerance right to it, do its bars "
        "hold, and what does it cost against the best setting in hindsight?",
        run=tolerance.run,
        source="expectation",
    ),
    Definition(
        name="literature",
        title="Beams of the literature",
        question="Do published problems of beams and cables, at rest, vibrating and moving, come "
        "out right, how fast with the mesh, and are the derivatives those of the solution?",
        run=literature.run,
        source="literature",
    ),
    Definition(
        name="rotation",
        title="Blades and shafts that turn steadily",
        question="Are equilibria, modes and their derivatives in a turning frame those of rotating "
        "blades and whirling shafts, over the speed?",
        run=rotation.run,
        source="aim",
    ),
    Definition(
        name="design",
        title="Mechanisms designed by gradients",
        question="Do optimisations of mechanisms, a page of code each, solved by SciPy "
        "with adjoint gradients, end at optima that searches without gradients confirm, and at "
        "what cost?",
        run=design.run,
        source="other way",
    ),
    Definition(
        name="test-set",
        title="Published problems of differential-algebraic equations",
        question="Do published problems come out as printed, and their gradients as a method that "
        "shares nothing with this package finds them, by every integrator and at which cost?",
        run=test_set.run,
        source="source",
    ),
    Definition(
        name="peers",
        title="Beside Exudyn, CasADi and JAX",
        question="What do set-up, motion, equilibrium, modes, sweeps and gradients cost beside a "
        "multibody code in C++, solvers of sparse matrices, CasADi with IDAS, and JAX?",
        run=peers.run,
        source="wanted",
    ),
    Definition(
        name="performance",
        title="What steps, derivatives, sizes and many runs cost",
        question="How fast are a step, its derivatives, large scenes, long runs, the start and "
        "many runs, beside what the project asks of them?",
        run=performance.run,
        source="aim",
    ),
    Definition(
        name="events",
        title="Impacts, locks, ends of runs and free end times",
        question="Are motions with events and their derivatives right where closed forms or "
        "integrations in minimal coordinates say so, and do awkward events end in words?",
        run=events.run,
        source="wanted",
    ),
    Definition(
        name="models",
        title="Which model a gradient needs",
        question="Which of the models that a scene can be simplified to, on which mesh and with "
        "which step, gives a value and its gradient to a tolerance at the least cost, and where "
        "are rigid bodies enough for the value and wrong for the gradient?",
        run=models.run,
        source="ask",
    ),
    Definition(
        name="rods",
        title="Slender rods in contact",
        question="What do a stiff contact and an event cost for the same error of a motion and its "
        "gradient, and how do the experiments of cosseratbench come out beside PyElastica?",
        run=rods.run,
        source="peer",
    ),
)
