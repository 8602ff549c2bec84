"""Nets of cables beside Exudyn, frames of beams beside a factorisation by Pardiso or QDLDL."""

import importlib
import importlib.util
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import scipy

from ancfdae import (
    CABLE_3D,
    HHT,
    Beam,
    Clamp,
    Material,
    Scene,
    Spherical,
    Weld,
    assemble,
    equilibrium,
    modes,
    simulate,
)
from ancfdae.equations import MechanicalSystem
from ancfdae.extend import Joint, MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import medians
from ancfdae.plotting import Series
from ancfdae.sections import Circle, Rectangle
from validation.drawing import log_log
from validation.peers.exudyn import Exudyn
from validation.peers.pair import GRAVITY, Model, Pair
from validation.report import Report

_STEP = 2.0**-10
_DIAMETER, _DENSITY, _MODULUS = 0.01, 1000.0, 1e7
# Of HHT-I3 at alpha = -0.3, the default.
_ALPHA = -0.3
_BETA = (1 - _ALPHA) ** 2 / 4
_MODES = 4
# A step may cost as much as this many factorisations by the other library.
_FACTORISATIONS = 3.0
# Diagonal of the scaled multipliers, without which QDLDL finds a pivot of zero.
_LOWERED = 1e-7


@final
@dataclass(frozen=True)
class Net(Pair):
    """A square net of cables hung at its corners; each crossing is a spherical joint."""

    lines: int

    symmetric = True

    @property
    def elements(self) -> int:
        """Number of cable elements."""
        return 2 * self.lines * (self.lines - 1)

    @property
    def title(self) -> str:
        """Name of the model in the tables of the report."""
        return f"net of {self.elements} cables"

    def scene(self) -> Scene:
        """Return the model as a scene of this package."""
        rubber, wire = Material(_DENSITY, _MODULUS, 0.3), Circle(_DIAMETER)
        places, cells = np.linspace(0, 1, self.lines), self.lines - 1
        along = [
            Beam(f"x{k}", (0, s, 0), (1, s, 0), cells, wire, rubber, element=CABLE_3D)
            for k, s in enumerate(places)
        ]
        across = [
            Beam(f"y{k}", (s, 0, 0), (s, 1, 0), cells, wire, rubber, element=CABLE_3D)
            for k, s in enumerate(places)
        ]
        joints: list[Joint] = [
            Spherical(x.at(s), y.at(r))
            for x, r in zip(along, places, strict=True)
            for y, s in zip(across, places, strict=True)
        ]
        corners = [(x, s) for x in (along[0], along[-1]) for s in (0.0, 1.0)]
        joints += [Spherical(x.at(s), name=f"{x.name} {s:g}") for x, s in corners]
        return Scene([*along, *across], joints, gravity=(0, 0, -GRAVITY))

    @property
    def point(self) -> MaterialPoint:
        """The point that is compared: the crossing next to the middle."""
        half = self.lines // 2
        return MaterialPoint(f"x{half}", half / (self.lines - 1))

    def build(self, exu: Any, items: Any, mbs: Any) -> Model:
        """Build the model in Exudyn from ANCF cables in space and spherical joints."""
        area, inertia = math.pi * _DIAMETER**2 / 4, math.pi * _DIAMETER**4 / 64
        length, weight = 1 / (self.lines - 1), [0, 0, -GRAVITY]

        def cable(start: Array, end: Array) -> list[int]:
            nodes = [
                int(mbs.AddNode(items.NodePointSlope1(referenceCoordinates=[*x, *(end - start)])))
                for x in np.linspace(start, end, self.lines)
            ]
            for k in range(self.lines - 1):
                body = mbs.AddObject(
                    items.ObjectANCFCable(
                        length=length,
                        massPerLength=_DENSITY * area,
                        bendingStiffness=_MODULUS * inertia,
                        axialStiffness=_MODULUS * area,
                        nodeNumbers=nodes[k : k + 2],
                    )
                )
                mass = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
                mbs.AddLoad(items.LoadMassProportional(markerNumber=mass, loadVector=weight))
            return nodes

        def joint(*markers: int) -> None:
            mbs.AddObject(items.ObjectJointSpherical(markerNumbers=list(markers)))

        def marker(node: int) -> int:
            return int(mbs.AddMarker(items.MarkerNodePosition(nodeNumber=node)))

        places = np.linspace(0, 1, self.lines)
        along = [cable(np.array([0, s, 0]), np.array([1, s, 0])) for s in places]
        across = [cable(np.array([s, 0, 0]), np.array([s, 1, 0])) for s in places]
        for i, nodes in enumerate(along):
            for k, node in enumerate(nodes):
                joint(marker(node), marker(across[k][i]))
        ground = mbs.AddObject(items.ObjectGround())
        for i, k in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
            corner = [places[k], places[i], 0]
            fixed = items.MarkerBodyPosition(bodyNumber=ground, localPosition=corner)
            joint(int(mbs.AddMarker(fixed)), marker(along[i][k]))
        half = self.lines // 2
        middle, place = along[half][half], exu.OutputVariableType.Position
        return Model(lambda: mbs.GetNodeOutput(middle, place))


def frame(cells: int) -> Scene:
    """Return a plane frame of 2 n^2 + n steel beams, n storeys and n bays, clamped at its feet."""
    steel, section, (width, height) = Material(7850, 2.1e11, 0.3), Rectangle(0.2, 0.2), (4.0, 3.0)
    columns = [
        Beam(f"c{k}", (width * k, 0), (width * k, height * cells), cells, section, steel)
        for k in range(cells + 1)
    ]
    girders = [
        Beam(f"g{k}", (0, height * k), (width * cells, height * k), cells, section, steel)
        for k in range(1, cells + 1)
    ]
    joints: list[Joint] = [Clamp(column.at_start) for column in columns]
    joints += [
        Weld(column.at((k + 1) / cells), girder.at(i / cells))
        for i, column in enumerate(columns)
        for k, girder in enumerate(girders)
    ]
    return Scene([*columns, *girders], joints, gravity=(0, -GRAVITY))


def fill(
    report: Report, nets: Sequence[tuple[int, int]], frames: Sequence[int], repeats: int
) -> None:
    """Add tables of nets, (lines, steps), and of frames, number of cells in either direction."""
    report.say("loops")
    elements, net_ms = _nets(report, nets, repeats)
    beams, frame_ms = _frames(report, frames, repeats)
    growths = []
    for what, sizes, ms in (("nets", elements, net_ms), ("frames", beams, frame_ms)):
        exponent = float(np.polyfit(np.log(sizes), np.log(ms), 1)[0])
        growths.append(report.figure(f"loops.{what}.growth", exponent))
    report.judge("loops", max(growths) <= 1.5, growths=growths)
    series = [
        Series("nets", elements, net_ms, marker=True),
        Series("frames", beams, frame_ms, marker=True),
        Series(
            "n^1.5", elements, [net_ms[0] * (n / elements[0]) ** 1.5 for n in elements], dashed=True
        ),
    ]
    axes = "elements [-]", "time of a step [ms]"
    report.plot("loops", [log_log("Time of a step here", *axes, series)])


def _nets(
    report: Report, cases: Sequence[tuple[int, int]], repeats: int
) -> tuple[list[float], list[float]]:
    found = [_net(report, lines, steps, repeats) for lines, steps in cases]
    rows, ratios, ms = map(list, zip(*found, strict=True))
    report.table(
        ["scene", "steps", "apart, m", "here, ms", "Exudyn, ms", "its setting", "ratio"], rows
    )
    _claim(report, "A step of a net, of Exudyn's time in its best setting", ratios)
    return [float(Net(lines).elements) for lines, _ in cases], ms


def _net(report: Report, lines: int, steps: int, repeats: int) -> tuple[list[object], float, float]:
    """Return the row of a net, the ratio, and the time of a step here; ms."""
    pair = Net(lines)
    exudyn, system = Exudyn(pair), assemble(pair.scene())
    way, hht = exudyn.fastest(_STEP, 4, pair.newton), HHT(_STEP, newton_tolerance=pair.newton)
    ends: dict[str, Array] = {}

    def ours() -> None:
        run = simulate(system, steps * _STEP, hht)
        ends["here"] = run.position(pair.point)[-1]

    def theirs() -> None:
        ends["there"] = exudyn.end(_STEP, steps, pair.newton, way)

    here, there = medians([ours, theirs], repeats)
    name, apart = f"loops.net.{pair.elements}", np.linalg.norm(ends["here"] - ends["there"])
    report.figure(f"{name}.apart", float(apart))
    ratio = report.figure(f"{name}.ratio", here / there)
    ms = report.figure(f"{name}.here_ms", 1e3 * here / steps)
    other = report.figure(f"{name}.exudyn_ms", 1e3 * there / steps)
    row = [pair.title, steps, f"{apart:.0e}", f"{ms:.3g}", f"{other:.3g}", way.title]
    return [*row, f"{ratio:.2f}"], ratio, ms


def _frames(report: Report, cases: Sequence[int], repeats: int) -> tuple[list[float], list[float]]:
    found = [_frame(report, cells, repeats) for cells in cases]
    rows, ratios, step_ms = map(list, zip(*found, strict=True))
    report.table(
        [
            "beams",
            "factorisation, ms",
            "step here, ms: ratio",
            "equilibrium here, ms: ratio",
            "modes here, ms: ratio",
            "modes by ARPACK and the library, ms",
            "modes apart, relative",
        ],
        rows,
    )
    for statement, column in zip(
        (
            "A step of a frame, of three factorisations by Pardiso or QDLDL",
            "Equilibrium of a frame, of three factorisations by them for each of its own",
            "Modes of a frame, of ARPACK with factors of theirs",
        ),
        zip(*ratios, strict=True),
        strict=True,
    ):
        _claim(report, statement, column)
    return [2.0 * n**2 + n for n in cases], step_ms


def _frame(report: Report, cells: int, repeats: int) -> tuple[list[object], list[float], float]:
    """Return the row of a frame, the ratios, and the time of a step here; ms."""
    beams, system = 2 * cells**2 + cells, assemble(frame(cells))
    hht, steps = HHT(_STEP, newton_tolerance=1e-8), 32 if cells < 20 else 8
    K, M, B = _matrices(system)
    library, factorise, solver = _fastest(M / (1 + _ALPHA) + _BETA * _STEP**2 * K, B)
    factorisations = equilibrium(system).solution.statistics.factorisations
    calls: list[Callable[[], object]] = [
        lambda: simulate(system, steps * _STEP, hht),
        factorise,
        lambda: equilibrium(system),
        lambda: modes(system, _MODES),
        lambda: _by_arpack(K, M, B, solver),
    ]
    steps_time, factorisation, rest, own_modes, by_arpack = medians(calls, repeats)
    step, allowed = steps_time / steps, _FACTORISATIONS * factorisation
    here, there = modes(system, _MODES).natural_frequencies, _by_arpack(K, M, B, solver)
    apart = float(np.max(np.abs(here / there - 1)))
    ratios = [step / allowed, rest / (allowed * factorisations), own_modes / by_arpack]
    name = f"loops.frame.{beams}"
    report.figures(f"{name}.{{}}.ratio", ("step", "equilibrium", "modes"), ratios)
    report.figure(f"{name}.step_ms", 1e3 * step)
    report.figure(f"{name}.factorisation_ms", 1e3 * factorisation)
    report.figure(f"{name}.modes.apart", apart)
    times = zip((step, rest, own_modes), ratios, strict=True)
    cells_of_row = [f"{1e3 * x:.3g}: {ratio:.2f}" for x, ratio in times]
    row = [beams, f"{1e3 * factorisation:.3g} ({library})", *cells_of_row]
    return [*row, f"{1e3 * by_arpack:.3g}", f"{apart:.0e}"], ratios, 1e3 * step


def _claim(report: Report, statement: str, ratios: Sequence[float]) -> None:
    found = ", ".join(f"{ratio:.2f}" for ratio in ratios)
    report.claim(f"{statement}, from small to large", "at most 1", found, max(ratios) <= 1)


def _matrices(system: MechanicalSystem) -> tuple[Any, Any, Any]:
    """Return K, M and the Jacobian of the constraints at the start, as sparse matrices."""
    q, v = system.start()
    a, lam = np.zeros((1, system.n_q)), np.zeros((1, system.n_lam))
    at_start = system.linearise(np.zeros(1), q[None], v[None], a, lam)
    K, M = (system.pattern.csr(x) for x in (at_start.f_q[0], system.mass(q)))
    return K, M, system.constraint_pattern.csr(at_start.Phi_q[0])


def _saddle(K: Any, B: Any) -> tuple[Any, Array]:
    """Return [[K, B^T], [B, -eps]], scaled to a diagonal and rows of ones, and the scale."""
    scale = scipy.sparse.diags_array(1 / np.sqrt(K.diagonal()))
    rows = B @ scale
    length = 1 / np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    rows = scipy.sparse.diags_array(length) @ rows
    below = -_LOWERED * scipy.sparse.eye_array(len(length))
    matrix = scipy.sparse.block_array([[scale @ K @ scale, rows.T], [rows, below]]).tocsc()
    return scipy.sparse.csc_matrix(matrix), np.concatenate([scale.diagonal(), length])


def _fastest(
    K: Any, B: Any
) -> tuple[str, Callable[[], object], Callable[[Any, Any], Callable[[Array], Array]]]:
    """Return the library that factorises fastest, a numerical factorisation, and its solver."""
    libraries = {"QDLDL": (_qdldl, _solver_of_qdldl)}
    if importlib.util.find_spec("pypardiso") is not None:
        libraries["Pardiso"] = _pardiso, _solver_of_pardiso
    found = []
    for name, (prepare, solver) in libraries.items():
        factorise = prepare(_saddle(K, B)[0])
        found.append((medians([factorise], 3)[0], name, factorise, solver))
    _, name, factorise, solver = min(found, key=lambda each: each[0])
    return name, factorise, solver


def _qdldl(matrix: Any) -> Callable[[], object]:
    """Return a numerical factorisation by QDLDL; its order of unknowns is found before."""
    solver = importlib.import_module("qdldl").Solver(matrix)
    return lambda: solver.update(matrix)


def _solver_of_qdldl(K: Any, B: Any) -> Callable[[Array], Array]:
    matrix, scale = _saddle(K, B)
    factors = importlib.import_module("qdldl").Solver(matrix)
    return _refined(factors.solve, matrix, scale)


def _pardiso(matrix: Any) -> Callable[[], object]:
    """Return a numerical factorisation, symmetric and indefinite, by Pardiso of Intel's MKL."""
    solver, upper = _analysed(matrix)
    right = np.zeros((matrix.shape[0], 1))

    def factorise() -> None:
        solver.set_phase(22)
        solver._call_pardiso(upper, right)

    return factorise


def _analysed(matrix: Any) -> tuple[Any, Any]:
    upper = scipy.sparse.csr_matrix(scipy.sparse.triu(matrix))
    upper.sort_indices()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solver = importlib.import_module("pypardiso").PyPardisoSolver(mtype=-2)
    solver.factorize(upper)
    return solver, upper


def _solver_of_pardiso(K: Any, B: Any) -> Callable[[Array], Array]:
    matrix, scale = _saddle(K, B)
    solver, upper = _analysed(matrix)
    solver.set_phase(33)
    return _refined(lambda b: solver._call_pardiso(upper, b[:, None]).ravel(), matrix, scale)


def _refined(
    solve: Callable[[Array], Array], matrix: Any, scale: Array
) -> Callable[[Array], Array]:
    """Return a solver of the matrix that is not scaled, whose multipliers have no diagonal."""
    lowered = np.where(np.arange(len(scale)) < np.count_nonzero(matrix.diagonal() > 0), 0.0, -1.0)
    lowered *= _LOWERED

    def solved(right: Array) -> Array:
        b = scale * right
        x = np.asarray(solve(b))
        for _ in range(2):
            x = x + np.asarray(solve(b - matrix @ x + lowered * x))
        return scale * x

    return solved


def _by_arpack(
    K: Any, M: Any, B: Any, solver: Callable[[Any, Any], Callable[[Array], Array]]
) -> Array:
    """Return the lowest natural frequencies by SciPy's ARPACK, inverted by the library; rad/s."""
    n, solve = M.shape[0], solver(K, B)
    none = np.zeros(B.shape[0])
    inverse = scipy.sparse.linalg.LinearOperator(
        (n, n), matvec=lambda x: solve(np.concatenate([np.ravel(x), none]))[:n], dtype=float
    )
    # Starts with a motion that the constraints allow.
    start = inverse @ (M @ np.cos(np.arange(n)))
    values = scipy.sparse.linalg.eigsh(
        K, _MODES, M, sigma=0.0, OPinv=inverse, v0=start, return_eigenvectors=False
    )
    return np.sqrt(np.sort(values))
