"""The reports that can be run, as an explicit list.

To add one, write a module with a function that fills a `Report`, a Markdown file with its words
(`validation.prose`) beside it, and enter both in `CATALOGUE`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from validation import elements, error_bars, external_dae, integrators, work_precision
from validation.crank_slider import report as crank_slider
from validation.design import report as design
from validation.events import report as events
from validation.extremes import report as extremes
from validation.literature import report as literature
from validation.models import report as models
from validation.peers import report as peers
from validation.pendulum import report as pendulum
from validation.performance import report as performance
from validation.prose import Prose
from validation.report import Report
from validation.rods import report as rods
from validation.rotation import report as rotation
from validation.test_set import report as test_set
from validation.tolerance import report as tolerance


@dataclass(frozen=True)
class Definition:
    """A report that can be run.

    Parameters
    ----------
    name : str
        Name on the command line and of the output folder.
    prose : Prose
        Title, question and words of the report.
    run : callable
        ``run(report, quick)`` fills the report; `quick` asks for coarse settings that exercise
        every part of it without giving figures worth quoting.
    """

    name: str
    prose: Prose
    run: Callable[[Report, bool], None]


def _report(name: str, words: str, run: Callable[[Report, bool], None]) -> Definition:
    return Definition(name, Prose.read(Path(__file__).parent / words), run)


CATALOGUE: tuple[Definition, ...] = (
    _report("pendulum", "pendulum/report.md", pendulum.run),
    _report("elements", "elements.md", elements.run),
    _report("crank-slider", "crank_slider/report.md", crank_slider.run),
    _report("external-dae", "external_dae.md", external_dae.run),
    _report("integrators", "integrators.md", integrators.run),
    _report("error-bars", "error_bars.md", error_bars.run),
    _report("extremes", "extremes/report.md", extremes.run),
    _report("work-precision", "work_precision.md", work_precision.run),
    _report("tolerance", "tolerance/report.md", tolerance.run),
    _report("literature", "literature/report.md", literature.run),
    _report("rotation", "rotation/report.md", rotation.run),
    _report("design", "design/report.md", design.run),
    _report("test-set", "test_set/report.md", test_set.run),
    _report("peers", "peers/report.md", peers.run),
    _report("performance", "performance/report.md", performance.run),
    _report("events", "events/report.md", events.run),
    _report("models", "models/report.md", models.run),
    _report("rods", "rods/report.md", rods.run),
)
