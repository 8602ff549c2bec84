"""Rigid chains here beside Exudyn's kinematic tree, at equal accuracy."""

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae import DOP853, HHT, Radau, assemble, simulate
from ancfdae.equations import MechanicalSystem
from ancfdae.extend import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import medians
from validation.peers.exudyn import quiet
from validation.peers.pair import GRAVITY
from validation.peers.rigid import DENSITY, LENGTH, THICKNESS, Chain
from validation.report import Report

_T_END = 0.5
_REFERENCE_STEPS = 4096
_ACCURACIES = (1e-3, 1e-6)
# Half of what was measured when the row was asked for: 3 to 29.
_ASKED = 14.5


class _Setting(NamedTuple):
    """A setting of an integrator by name, and its run, which returns where the end is."""

    title: str
    run: Callable[[], Array]


def fill(report: Report, bodies: Sequence[int], repeats: int) -> None:
    """Add the table, two rows for each number of bodies."""
    report.say("trees")
    rows, ratios = [], []
    for n in bodies:
        tree, chain = _Tree(n), Chain(n, revolute=True)
        exact = tree.end("RK67", _REFERENCE_STEPS)
        system = assemble(chain.scene())
        ours = _settings(system, chain)
        theirs = [
            _Setting(f"{kind}, {2**k} steps", partial(tree.end, kind, 2**k))
            for kind in ("RK44", "RK67")
            for k in range(4, 10)
        ]
        # Settings that meet an accuracy, in this order from rough to fine, are timed.
        errors = [
            [float(np.max(np.abs(each.run() - exact))) / (n * LENGTH) for each in settings]
            for settings in (ours, theirs)
        ]
        for accuracy in _ACCURACIES:
            (here, mine), (there, other) = (
                _cheapest([s for s, e in zip(settings, error, strict=True) if e <= accuracy])
                for settings, error in zip((ours, theirs), errors, strict=True)
            )
            here, there = medians([mine.run, other.run], repeats)
            ratios.append(report.figure(f"tree.{n}.{accuracy:g}.ratio", here / there))
            rows.append(
                [
                    n,
                    f"{accuracy:g}",
                    f"{1e3 * here:.3g}",
                    mine.title,
                    f"{1e3 * there:.3g}",
                    other.title,
                    f"{ratios[-1]:.1f}",
                ]
            )
    report.table(["bodies", "error", "here, ms", "by", "kinematic tree, ms", "by", "ratio"], rows)
    report.judge(
        "trees", max(ratios) <= _ASKED, asked=_ASKED, least=min(ratios), largest=max(ratios)
    )


def _settings(system: MechanicalSystem, chain: Chain) -> list[_Setting]:
    def run(integrator: Integrator) -> Array:
        return simulate(system, _T_END, integrator).position(chain.point)[-1]

    integrators: list[tuple[str, Integrator]] = [
        *((f"HHT, {2**k} steps", HHT(_T_END / 2**k)) for k in range(5, 11)),
        *((f"DOP853, rtol {rtol:g}", DOP853(rtol, intervals=1)) for rtol in (1e-2, 1e-3, 1e-5)),
        *((f"Radau, {2**k} steps", Radau(step=_T_END / 2**k)) for k in range(4, 7)),
    ]
    return [_Setting(title, partial(run, integrator)) for title, integrator in integrators]


def _cheapest(settings: list[_Setting]) -> tuple[float, _Setting]:
    times = medians([each.run for each in settings], 1)
    return min(zip(times, settings, strict=True), key=lambda each: each[0])


@final
class _Tree:
    """The chain on hinges in Exudyn, one angle a body."""

    def __init__(self, bodies: int) -> None:
        self._exu: Any = importlib.import_module("exudyn")
        items = importlib.import_module("exudyn.utilities")
        self._container, self._bodies = self._exu.SystemContainer(), bodies
        self._mbs = self._container.AddSystem()
        bar = items.InertiaCuboid(DENSITY, [LENGTH, THICKNESS, THICKNESS])
        none = [0.0] * bodies
        self._node = self._mbs.AddNode(
            items.NodeGenericODE2(
                referenceCoordinates=none,
                initialCoordinates=none,
                initialCoordinates_t=none,
                numberOfODE2Coordinates=bodies,
            )
        )
        offsets = [[0.0, 0.0, 0.0]] + [[LENGTH, 0.0, 0.0]] * (bodies - 1)
        inertia = np.array(bar.InertiaCOM())
        self._mbs.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=self._node,
                jointTypes=[self._exu.JointType.RevoluteY] * bodies,
                linkParents=[k - 1 for k in range(bodies)],
                jointTransformations=self._exu.Matrix3DList([np.eye(3)] * bodies),
                jointOffsets=self._exu.Vector3DList(offsets),
                linkInertiasCOM=self._exu.Matrix3DList([inertia] * bodies),
                linkCOMs=self._exu.Vector3DList([[LENGTH / 2, 0.0, 0.0]] * bodies),
                linkMasses=[bar.mass] * bodies,
                gravity=[0.0, 0.0, -GRAVITY],
            )
        )
        self._mbs.Assemble()

    def end(self, kind: str, steps: int) -> Array:
        """Integrate with one of Exudyn's explicit methods; return the end of the last bar."""
        asked = quiet(self._exu)
        asked.timeIntegration.numberOfSteps = steps
        asked.timeIntegration.endTime = _T_END
        method = getattr(self._exu.DynamicSolverType, kind)
        try:
            done = self._mbs.SolveDynamic(
                asked, solverType=method, storeSolver=False, autoAssemble=False
            )
        except self._exu.SolverError:
            done = False
        if not done:
            return np.full(3, np.nan)
        angles = self._mbs.GetNodeOutput(self._node, self._exu.OutputVariableType.Coordinates)
        turned = np.cumsum(np.ravel(angles))
        # Turned about y: x goes to -z.
        return LENGTH * np.array([np.cos(turned).sum(), 0.0, -np.sin(turned).sum()])
