"""Solution of a run: trajectories, sensitivities, statistics and how it ended."""

from __future__ import annotations

import json
import os
import uuid
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from ancfdae.bodies import Point, Quantity, require_point
from ancfdae.errors import InvalidInput, Outcome, UnknownName, Verdict
from ancfdae.naming import BeamLayout, JointLayout, Layout, Naming
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import TimeGrid

_FORMAT = "ancfdae solution 4"
# What reading a file that is no archive, or a damaged one, ends in.
_DAMAGED = (EOFError, zipfile.BadZipFile, zlib.error, RuntimeError)
# Imaginary perturbation of observables: any value whose square underflows against one is exact.
_STEP = 1e-40


@final
@dataclass(frozen=True)
class Statistics:
    """What a run cost.

    Attributes
    ----------
    steps : int
        Accepted steps.
    iterations : int
        Newton iterations.
    factorisations : int
        Factorised iteration matrices.
    residuals : int
        Evaluations of the residual.
    round_off_steps : int
        Steps of `HHT` whose Newton corrections stopped shrinking, at round-off, above the
        tolerance, or that round-off of the elastic forces leaves less than seven digits.
    wall_seconds : float
        Elapsed time of the integration.
    rejected : int
        Steps of `HHT` repeated with a smaller size; SUNDIALS and SciPy do not tell.
    """

    steps: int
    iterations: int
    factorisations: int
    residuals: int
    round_off_steps: int
    wall_seconds: float
    rejected: int = 0


@final
@dataclass(frozen=True)
class EstimatedErrors:
    """Discretisation errors as a run of HHT-I3 itself tells them (docs/theory.md, section 5).

    The errors of all steps, added up. Against the true ones they are right within a factor of
    three (motion) and ten (derivatives) on undamped scenes, waves that the steps do not resolve
    included; strong damping, which removes errors again, makes them too large
    (docs/reports/error-bars). For an objective and its gradient see `error_bars`.

    Attributes
    ----------
    motion : float
        Of q, relative to the size of the coordinates.
    derivatives : tuple of float, or None
        Of q_b, one per design variable, relative to the largest size of that derivative in the
        run; nan where the variable has no influence above round-off, inf where the run blew up.
        None unless it was differentiated by `Direct` or `HHT(control_sensitivities=True)`.
    """

    motion: float
    derivatives: tuple[float, ...] | None = None


@final
@dataclass(frozen=True)
class Sensitivities:
    """Total derivatives of a trajectory in the design variables.

    Attributes
    ----------
    names : tuple of str
    values : array, shape (n_b,)
        Design variables and their values.
    q_b, v_b, a_b : array, shape (n_t, n_q, n_b)
    lam_b : array, shape (n_t, n_lam, n_b)
    """

    names: tuple[str, ...]
    values: Array
    q_b: Array
    v_b: Array
    a_b: Array
    lam_b: Array


@final
@dataclass(frozen=True)
class Solution:
    """Trajectory of a mechanical system.

    Attributes
    ----------
    t : array, shape (n_t,)
        Times; a run that failed holds what was reached.
    q, v, a : array, shape (n_t, n_q)
        Coordinates, velocities and accelerations at these times.
    lam : array, shape (n_t, n_lam)
        Multipliers.
    statistics : Statistics
    outcome : Outcome
    naming : Naming or None
        Names of points and joints; None for a system that is not an ANCF scene.
    sensitivities : Sensitivities or None
    degree : int
        Degree of the polynomials between the instants: 1 for HHT, whose instants are its steps,
        8 for Gauss-Lobatto instants (`ancfdae.numerics.time_grid`).
    estimated_errors : EstimatedErrors or None
        Of HHT only; the others keep their tolerances to themselves.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    lam: Array
    statistics: Statistics
    outcome: Outcome
    naming: Naming | None
    sensitivities: Sensitivities | None = None
    degree: int = 1
    estimated_errors: EstimatedErrors | None = None

    # -- named access --------------------------------------------------------------------------

    def nodes(self, beam: str) -> Array:
        """Node vectors of a beam, shape (n_t, n_nodes, n_s, d): position, then slopes."""
        return self._nodes(self.q, beam)

    def position(self, beam: str, fraction: float, y: float = 0.0, z: float = 0.0) -> Array:
        """Position of a material point, shape (n_t, d).

        Parameters
        ----------
        beam : str
        fraction : float
            Arc-length fraction along the beam, 0 to 1.
        y, z : float
            Offset along the section's axes; m.

        Raises
        ------
        UnknownName
            If there is no such beam.
        InvalidInput
            If the fraction lies outside [0, 1], or z is not zero in the plane.
        """
        return self._vector(self.q, Point(beam, fraction, y, z), Quantity.POSITION)

    def velocity(self, beam: str, fraction: float, y: float = 0.0, z: float = 0.0) -> Array:
        """Velocity of a material point, shape (n_t, d); arguments as in `position`."""
        return self._vector(self.v, Point(beam, fraction, y, z), Quantity.POSITION)

    def acceleration(self, beam: str, fraction: float, y: float = 0.0, z: float = 0.0) -> Array:
        """Acceleration of a material point, shape (n_t, d); arguments as in `position`."""
        return self._vector(self.a, Point(beam, fraction, y, z), Quantity.POSITION)

    def slope(
        self, beam: str, fraction: float, axis: int = 0, y: float = 0.0, z: float = 0.0
    ) -> Array:
        """Slope vector along a section axis (0: along the beam), shape (n_t, d)."""
        d = self._known_naming().layout.d
        if axis not in range(d):
            raise InvalidInput(
                "slope, axis", f"must lie in 0 to {d - 1}", repr(axis), "0 is along the beam."
            )
        return self._vector(self.q, Point(beam, fraction, y, z), Quantity(axis + 1))

    def multipliers(self, joint: str) -> Array:
        """Multipliers of a joint, shape (n_t, rows), in the order of its equations."""
        place = self._known_naming().layout.joint(joint)
        return self.lam[:, place.first_row : place.first_row + place.rows]

    def reaction(self, joint: str) -> Array:
        """Force of a joint on its first point, shape (n_t, d).

        For joints whose first d equations equate positions: the force is minus their
        multipliers (eq. 1).

        Raises
        ------
        InvalidInput
            If the joint is of another kind; see `multipliers`.
        """
        layout = self._known_naming().layout
        if not layout.joint(joint).holds_position:
            raise InvalidInput(
                f"reaction of {joint!r}",
                "is defined for joints that hold a point in all directions",
                "a joint of another kind",
                "Use `multipliers` and the equations in the joint's documentation.",
            )
        return -self.multipliers(joint)[:, : layout.d]

    def derivative(self, observable: Callable[[Solution], Array]) -> Array:
        """Total design derivative of anything computed from a solution.

        Parameters
        ----------
        observable : callable
            Takes a solution and returns an array, shape (n_t, ...); written with operations
            that accept complex numbers (no abs, norm or comparison). It is evaluated at
            q + i eps q_b, which is exact to round-off.

        Returns
        -------
        array, shape (n_t, ..., n_b)

        Raises
        ------
        InvalidInput
            If the solution has no sensitivities, or the observable drops the imaginary part.
        """
        s, naming = self._known_sensitivities(), self.naming
        if not s.names:
            return np.zeros((*np.shape(observable(self)), 0))
        columns = []
        for i in range(len(s.names)):
            if naming is not None and self.naming is not None:
                lengths = self.naming.lengths + 1j * _STEP * naming.lengths_b[:, i]
                naming = replace(self.naming, lengths=lengths)
            shifted = replace(
                self,
                q=self.q + 1j * _STEP * s.q_b[..., i],
                v=self.v + 1j * _STEP * s.v_b[..., i],
                a=self.a + 1j * _STEP * s.a_b[..., i],
                lam=self.lam + 1j * _STEP * s.lam_b[..., i],
                naming=naming,
                sensitivities=None,
            )
            value = np.asarray(observable(shifted))
            if value.dtype.kind != "c":
                raise InvalidInput(
                    "observable",
                    "must keep the imaginary part of its input",
                    f"a result of type {value.dtype}",
                    "Replace abs, norm and comparisons by complex-safe operations.",
                )
            columns.append(value.imag / _STEP)
        return np.stack(columns, axis=-1)

    def at(self, times: Sequence[float]) -> Solution:
        """Return the solution at asked times, by interpolation of the order of its integrator.

        Between the steps of HHT: coordinates by the cubic through q and v at both ends, velocities
        by that through v and a, accelerations and multipliers linearly. Between Gauss-Lobatto
        instants: the polynomial of a panel. Derivatives are interpolated alike. Statistics,
        outcome and estimated errors stay those of the run.

        Parameters
        ----------
        times : sequence of float
            Increasing, within the run; s.

        Raises
        ------
        InvalidInput
            If they are not.
        """
        asked = np.array(times, dtype=float, ndmin=1)
        good = asked.ndim == 1 and len(asked) > 0 and bool(np.all(np.diff(asked) > 0))
        if not good or not (self.t[0] <= asked[0] and asked[-1] <= self.t[-1]):
            raise InvalidInput(
                "times",
                f"must increase and lie in [0, {self.t[-1]:.6g}]",
                repr(times),
                "For example np.linspace(0, solution.t[-1], 101).",
            )
        own = self.sensitivities
        if own is not None:
            q_b, v_b, a_b, lam_b = self._sampled(asked, own.q_b, own.v_b, own.a_b, own.lam_b)
            own = replace(own, q_b=q_b, v_b=v_b, a_b=a_b, lam_b=lam_b)
        q, v, a, lam = self._sampled(asked, self.q, self.v, self.a, self.lam)
        return replace(self, t=asked, q=q, v=v, a=a, lam=lam, sensitivities=own, degree=1)

    def _sampled(self, times: Array, q: Array, v: Array, a: Array, lam: Array) -> list[Array]:
        if self.degree == 1 and len(self.t) > 1:
            smooth = (CubicHermiteSpline(self.t, x, rate)(times) for x, rate in ((q, v), (v, a)))
            return [*smooth, *(make_interp_spline(self.t, x, k=1)(times) for x in (a, lam))]
        grid = TimeGrid(self.t, self.degree)
        shares = [grid.interpolation(time) for time in times]
        return [
            np.stack([np.tensordot(share, x[rows], 1) for rows, share in shares])
            for x in (q, v, a, lam)
        ]

    def design_index(self, name: str) -> int:
        """Return the place of a design variable in the last axis of every sensitivity.

        Raises
        ------
        UnknownName
        """
        names = self._known_sensitivities().names
        if name not in names:
            raise UnknownName("design variable", name, names)
        return names.index(name)

    def _vector(self, states: Array, point: Point, quantity: Quantity) -> Array:
        naming = self._known_naming()
        require_point(f"point of {point.beam!r}", point, naming.layout.d)
        return naming.vector(point, quantity).of(states, naming.layout.d)

    def _nodes(self, states: Array, beam: str) -> Array:
        layout = self._known_naming().layout
        place, per_node = layout.beam(beam), layout.d * layout.element.n_s
        first, count = place.first_node * per_node, (place.element_count + 1) * per_node
        part = states[:, first : first + count]
        return part.reshape(len(states), -1, layout.element.n_s, layout.d)

    def _known_naming(self) -> Naming:
        if self.naming is None:
            raise InvalidInput(
                "named access",
                "needs the solution of an ANCF scene",
                "a system of another kind",
                "Use the arrays q, v, a and lam.",
            )
        return self.naming

    def _known_sensitivities(self) -> Sensitivities:
        if self.sensitivities is None:
            raise InvalidInput(
                "sensitivities",
                "must have been computed",
                "a solution of `simulate`",
                "Call `differentiate` instead.",
            )
        return self.sensitivities

    def with_sensitivities(
        self, own: Sensitivities, verdict: Verdict, steps: int, seconds: float
    ) -> Solution:
        """Return the solution with derivatives, cut to the steps that have them.

        Parameters
        ----------
        own : Sensitivities
        verdict : Verdict
            How the pass ended; the outcome of the run stays if it finished.
        steps : int
            Steps with derivatives.
        seconds : float
            Time of the pass, added to the statistics.
        """
        outcome = self.outcome
        if verdict is not Verdict.FINISHED:
            outcome = Outcome(verdict, float(self.t[steps]), steps, 0.0)
        rows = slice(steps + 1)
        statistics = replace(
            self.statistics,
            factorisations=self.statistics.factorisations + steps,
            wall_seconds=self.statistics.wall_seconds + seconds,
        )
        return replace(
            self,
            t=self.t[rows],
            q=self.q[rows],
            v=self.v[rows],
            a=self.a[rows],
            lam=self.lam[rows],
            statistics=statistics,
            outcome=outcome,
            sensitivities=own,
        )

    # -- files ---------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the solution to one file, complete or not at all.

        The file is a NumPy archive without pickled objects; it is written beside its final
        name and moved there when it is complete.

        Parameters
        ----------
        path : path-like
            By convention with the ending ``.npz``.
        """
        path = Path(path)
        arrays = {name: getattr(self, name) for name in ("t", "q", "v", "a", "lam")}
        meta: dict[str, Any] = {
            "format": _FORMAT,
            "statistics": asdict(self.statistics),
            "outcome": {**asdict(self.outcome), "verdict": self.outcome.verdict.name},
            "degree": self.degree,
            "estimated_errors": self.estimated_errors and asdict(self.estimated_errors),
            "layout": None,
            "names": None,
        }
        if self.naming is not None:
            meta["layout"] = asdict(self.naming.layout)
            arrays["lengths"] = self.naming.lengths
            arrays["lengths_b"] = self.naming.lengths_b
        if self.sensitivities is not None:
            s = self.sensitivities
            meta["names"] = list(s.names)
            for name in ("values", "q_b", "v_b", "a_b", "lam_b"):
                arrays[f"sensitivity_{name}"] = getattr(s, name)
        # Settings may be numbers of NumPy, which JSON does not know.
        arrays["meta"] = np.array(json.dumps(meta, default=np.generic.item))
        # Not a file of `tempfile`: those are readable by their owner only, and would stay so.
        temporary = path.parent / f"{path.name}.{uuid.uuid4().hex}.part"
        try:
            with temporary.open("xb") as file:
                np.savez(file, allow_pickle=False, **arrays)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        return path

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Solution:
        """Read a solution written by `save`.

        Raises
        ------
        InvalidInput
            If the file is not such a solution.
        """
        try:
            # Opened here, because np.load leaves a file open that is no whole archive.
            with Path(path).open("rb") as raw, np.load(raw, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            meta = json.loads(str(arrays["meta"]))
            if meta["format"] != _FORMAT:
                raise ValueError(f"the format {meta['format']!r}")
            return _rebuild(arrays, meta)
        except FileNotFoundError:
            raise
        except (OSError, KeyError, ValueError, TypeError, *_DAMAGED) as error:
            raise InvalidInput(
                f"solution file {os.fspath(path)!r}",
                f"must be a file written by Solution.save ({_FORMAT})",
                f"{type(error).__name__}: {error}",
                "Choose another file.",
            ) from error


def _rebuild(arrays: dict[str, Array], meta: dict[str, Any]) -> Solution:
    outcome = {**meta["outcome"], "verdict": Verdict[meta["outcome"]["verdict"]]}
    naming = None
    if meta["layout"] is not None:
        beams = tuple(
            BeamLayout(**{**beam, "fractions": tuple(beam["fractions"])})
            for beam in meta["layout"]["beams"]
        )
        joints = tuple(JointLayout(**joint) for joint in meta["layout"]["joints"])
        layout = Layout(meta["layout"]["element_name"], beams, joints)
        naming = Naming(layout, arrays["lengths"], arrays["lengths_b"])
    sensitivities = None
    if meta["names"] is not None:
        parts = ("values", "q_b", "v_b", "a_b", "lam_b")
        sensitivities = Sensitivities(
            tuple(meta["names"]), *(arrays[f"sensitivity_{name}"] for name in parts)
        )
    errors = None
    if meta["estimated_errors"] is not None:
        motion, derivatives = (meta["estimated_errors"][x] for x in ("motion", "derivatives"))
        errors = EstimatedErrors(motion, None if derivatives is None else tuple(derivatives))
    return Solution(
        **{name: arrays[name] for name in ("t", "q", "v", "a", "lam")},
        statistics=Statistics(**meta["statistics"]),
        outcome=Outcome(**outcome),
        naming=naming,
        sensitivities=sensitivities,
        degree=int(meta["degree"]),
        estimated_errors=errors,
    )
