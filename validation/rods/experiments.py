"""The experiments of cosseratbench, scored by its metrics, beside PyElastica in the same run."""

import importlib
import importlib.util
from typing import Any

from ancfdae.numerics.timing import stopwatch
from validation.report import Report
from validation.rods.adapter import AncfSolver

_NAMES = ("catenary", "cantilever", "pendulum", "twist", "crossing", "capstan", "pile")
_QUICK = ("cantilever",)
_PACKAGES = ("cosseratbench", "elastica")


def experiments(report: Report, quick: bool) -> None:
    """Fill the section; without the packages it says so."""
    report.say("experiments")
    missing = [name for name in _PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        report.say("experiments.missing", missing=" and ".join(missing))
        return
    rows = []
    for name in _QUICK if quick else _NAMES:
        module = importlib.import_module(f"cosseratbench.experiments.{name}")
        experiment = getattr(module, name)
        for solver in (_own(), _peer()):
            found, seconds = _scored(experiment, solver)
            if isinstance(found, str):
                rows.append([name, solver.name, found, "-"])
                break
            text = ", ".join(f"{key} {value:.1e}" for key, value in found.items())
            rows.append([name, solver.name, text, f"{seconds:.2g}"])
            report.figure(f"{name}.{solver.name}.seconds", seconds)
            report.figures(f"{name}.{solver.name}.{{}}", found, found.values())
    report.table(["experiment", "solver", "metrics", "s"], rows)


def _own() -> AncfSolver:
    capability = importlib.import_module("cosseratbench.solver").Capability
    trajectory = importlib.import_module("cosseratbench.trajectory").Trajectory
    transport = importlib.import_module("cosseratbench.scenario").parallel_transport
    return AncfSolver(frozenset(capability), trajectory, transport)


def _peer() -> Any:
    module = importlib.import_module("cosseratbench.solvers.pyelastica")
    classes = (x for x in vars(module).values() if isinstance(x, type))
    return next(x for x in classes if getattr(x, "name", "") == "pyelastica")()


def _scored(experiment: Any, solver: Any) -> tuple[dict[str, float] | str, float]:
    """Return the metrics of a run, or the reason why it has no result, and its time in s."""
    lacks = experiment.requires - solver.capabilities
    if lacks:
        return f"unsupported: {', '.join(x.value for x in lacks)}", 0.0
    settings = {"n_elements": experiment.n_elements, "n_frames": experiment.n_frames}
    clock = stopwatch(wall=True)
    try:
        trajectory = solver.run(experiment.scenario, **settings)
    except NotImplementedError as error:
        return f"unsupported: {error}", 0.0
    except ArithmeticError as error:
        return f"ended early: {error}"[:160], 0.0
    seconds = clock()
    scores = {key: f(experiment.scenario, trajectory) for key, f in experiment.metrics.items()}
    return scores, seconds
