"""Exudyn: settings, runs, and the time that they take."""

import importlib
import importlib.util
import itertools
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.errors import MissingPackageError
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch
from validation.peers.pair import Pair

_PEERS = ("exudyn", "jax", "diffrax", "casadi", "qdldl")

# Of generalised-alpha with the numerical damping of HHT at alpha = -0.3: (1 + alpha)/(1 - alpha).
SPECTRAL_RADIUS = 0.7 / 1.3


class Way(NamedTuple):
    """What may be chosen: the linear solver, and how often the matrix is made new."""

    linear_solver: str
    modified_newton: bool

    @property
    def title(self) -> str:
        """Name of the model in the tables of the report."""
        return f"{self.linear_solver}, {'modified' if self.modified_newton else 'full'} Newton"


# Unknowns up to which a dense matrix may be the faster one.
_DENSE = 500


def require_peers() -> None:
    """Raise MissingPackageError unless all packages of the extra ``peers`` are installed."""
    missing = [name for name in _PEERS if importlib.util.find_spec(name) is None]
    if missing:
        names, install = ", ".join(missing), ".venv/bin/python -m pip install -e '.[peers]'"
        raise MissingPackageError(f"Report peers needs {names}: {install}")


@final
class Exudyn:
    """A pair's model in Exudyn."""

    def __init__(self, pair: Pair) -> None:
        require_peers()
        # Asked for before the import: the version without checks of ranges, which is faster.
        sys.exudynFast = True  # type: ignore[attr-defined]
        self._exu: Any = importlib.import_module("exudyn")
        self._container = self._exu.SystemContainer()
        self._mbs = self._container.AddSystem()
        self._symmetric = pair.symmetric
        self._model = pair.build(self._exu, importlib.import_module("exudyn.utilities"), self._mbs)
        self._mbs.Assemble()

    def end(self, step: float, steps: int, newton: float, way: Way) -> Array:
        """Integrate; return where the point is at the end, NaN if the run fails."""
        asked = quiet(self._exu)
        asked.linearSolver.solverType = getattr(self._exu.LinearSolverType, way.linear_solver)
        integration = asked.timeIntegration
        integration.numberOfSteps, integration.endTime = steps, steps * step
        integration.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
        # Forces of these scenes are of the order of 1 N; round-off of those of fine cables is not
        # far below 1e-10 N, the value by default.
        integration.newton.relativeTolerance = integration.newton.absoluteTolerance = newton
        integration.newton.useModifiedNewton = way.modified_newton
        # Equal steps on both sides; a way that does not converge with them has failed.
        integration.adaptiveStep = False
        try:
            done = self._mbs.SolveDynamic(asked, storeSolver=False, autoAssemble=False)
        except self._exu.SolverError:
            done = False
        return np.asarray(self._model.read()) if done else np.full(3, np.nan)

    def fastest(self, step: float, steps: int, newton: float) -> Way:
        """Return the way whose run is fastest."""

        def seconds(way: Way) -> float:
            self.end(step, steps, newton, way)  # The first run takes memory.
            clock = stopwatch()
            done = np.all(np.isfinite(self.end(step, steps, newton, way)))
            return clock() if done else np.inf

        solvers = ["EXUdense"] * (self._mbs.systemData.ODE2Size() <= _DENSE)
        solvers += ["EigenSparse"] + ["EigenSparseSymmetric"] * self._symmetric
        ways = itertools.product(solvers, (True, False))
        return min(itertools.starmap(Way, ways), key=seconds)

    def at_rest(self, load_steps: int) -> Array:
        """Solve for equilibrium; return where the point is, NaN if that fails."""
        asked = quiet(self._exu)
        asked.linearSolver.solverType = self._exu.LinearSolverType.EigenSparse
        asked.staticSolver.numberOfLoadSteps = load_steps
        asked.staticSolver.newton.relativeTolerance = 1e-8
        try:
            done = self._mbs.SolveStatic(asked, storeSolver=False, autoAssemble=False)
        except self._exu.SolverError:
            done = False
        return np.asarray(self._model.read()) if done else np.full(3, np.nan)

    def differences(self, run: Callable[[], Array], number: int, step: float) -> Array:
        """Return central differences of what a run returns in the logarithms of variables.

        Shape (number, d), at factors 1 + step and 1 - step.
        """
        rows = []
        for i in range(number):
            ends = []
            for factor in (1 + step, 1 - step):
                self._model.vary(i, factor)
                ends.append(run())
            self._model.vary(i, 1.0)
            rows.append((ends[0] - ends[1]) / (2 * step))
        return np.array(rows)

    def frequencies(self, number: int, held: Sequence[int], sparse: bool) -> Array:
        """Return the lowest natural frequencies, rad/s, where some coordinates are fixed.

        By Exudyn's sparse solver (ARPACK) or by its dense one (LAPACK, all eigenvalues).
        """
        asked = quiet(self._exu)
        if sparse:
            asked.linearSolver.solverType = self._exu.LinearSolverType.EigenSparse
        values, _ = self._mbs.ComputeODE2Eigenvalues(
            asked,
            useSparseSolver=sparse,
            numberOfEigenvalues=number if sparse else 0,
            constrainedCoordinates=list(held),
            ignoreAlgebraicEquations=True,
            autoAssemble=False,
        )
        return np.sqrt(np.abs(np.asarray(values)[:number]))


def quiet(exu: Any) -> Any:
    """Return settings of Exudyn with one thread, without files, sensors and messages."""
    asked = exu.SimulationSettings()
    asked.solution.file.write = False
    asked.solution.sensors.writePeriod = 1e10
    asked.timeIntegration.verboseMode = asked.staticSolver.verboseMode = 0
    asked.parallel.numberOfThreads = 1
    return asked
