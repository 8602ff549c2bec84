"""The class `Solution`: trajectory of a run, design derivatives, cost, and how the run ended."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ancfdae.equations.naming import Naming
from ancfdae.equations.solution_parts import (
    ErrorEstimates,
    Sensitivities,
    Statistics,
    states_table,
)
from ancfdae.errors.checks import (
    require_array,
    require_flag,
    require_path,
    require_text,
)
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.errors.text import listed, page
from ancfdae.numerics.arrays import STEP, Array, Numbers
from ancfdae.numerics.time_grid import TimeGrid

# Size of an error-controlled step over the longest step before, below which it met an abrupt
# change.
_SHARP = 1 / 30


@final
@dataclass(frozen=True)
class Solution:
    """Trajectory of a mechanical system.

    Attributes
    ----------
    t : array, shape (n_t,)
        Times; for a run that failed up to the time that it reached; s.
    q, v, a : array, shape (n_t, n_q)
        Coordinates, velocities and accelerations; m, m/s and m/s^2, slopes without m.
    lam : array, shape (n_t, n_lam)
        Lagrange multipliers; J per unit of the constraint, so N for a constraint in m.
    statistics : Statistics
    outcome : RunOutcome
    naming : Naming or None
        Names of points and joints; None for a system that is not an ANCF scene.
    sensitivities : Sensitivities or None
    degree : int
        Degree of the polynomials between time points: 1 for HHT, whose time points are its steps,
        3 for Radau, which adds the stages of its steps, 8 for Gauss-Lobatto points
        (`ancfdae.numerics.time_grid`).
    estimated_errors : ErrorEstimates or None
        Estimated discretisation errors, for HHT only. The printed solution says where
        error-controlled steps fell to a thirtieth; after that errors may exceed the estimates.
    control : tuple of float
        State of the step control at the last time, with which ``simulate(..., after=solution)``
        continues; empty for prescribed steps.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    lam: Array
    statistics: Statistics
    outcome: RunOutcome
    naming: Naming | None
    sensitivities: Sensitivities | None = None
    degree: int = 1
    estimated_errors: ErrorEstimates | None = None
    control: tuple[float, ...] = ()

    # -- named access --------------------------------------------------------------------------

    def nodes(self, beam: str) -> Array:
        """Return the node vectors of a beam, (n_t, n_nodes, n_s, d): position, m, then slopes.

        At a kink (`Beam`) the slope along the beam is the slope of the element which begins there;
        `ends` has both. A rigid body has one frame, shape (n_t, 1, d + 1, d).
        """
        return self._known_naming().nodes(self.q, beam)

    def ends(self, beam: str) -> Array:
        """Return the node vectors of both ends of every element of a beam, (n_t, n, 2, n_s, d)."""
        return self._known_naming().ends(self.q, beam)

    def position(self, point: Any) -> Array:
        """Return the position of a point such as ``rod.at(0.3)``, shape (n_t, d); m.

        UnknownNameError if the scene has no body of that name, InvalidInputError if z is not zero
        in the plane.
        """
        return self._known_naming().position(self.q, point)

    def velocity(self, point: Any) -> Array:
        """Return the velocity of a material point, shape (n_t, d), m/s; errors as in `position`."""
        return self._known_naming().position(self.v, point)

    def acceleration(self, point: Any) -> Array:
        """Return the acceleration of a material point, (n_t, d), m/s^2; errors as in `position`."""
        return self._known_naming().position(self.a, point)

    def slope(self, point: Any, along: int = 0) -> Array:
        """Return the slope vector of a point along a section axis (0: along the beam), (n_t, d)."""
        return self._known_naming().slope(self.q, point, along)

    def multipliers(self, joint: str) -> Array:
        """Return the multipliers of a joint, shape (n_t, rows), in the order of its equations."""
        return self.lam[:, self._known_naming().rows(joint)]

    def reaction(self, joint: str) -> Array:
        """Return the force of a joint on its first point, (n_t, d), N: minus multipliers (eq. 1).

        InvalidInputError if the first equations of the joint do not equate positions; see
        `multipliers`.
        """
        return self._known_naming().reaction(self.lam, joint)

    def derivative(
        self, of: Callable[[Solution], Array] | object, variable: str | None = None
    ) -> Array:
        """Return the design derivative of a position, or of any function of a solution.

        Parameters
        ----------
        of : MaterialPoint or function
            A point such as ``rod.at_end``, whose position is differentiated; or a function that
            takes a solution and returns an array, shape (n_t, ...), by operations that accept
            complex numbers (no abs, norm or comparison): it is evaluated at q + i eps q_b, which is
            exact to round-off.
        variable : str, optional
            Name of one design variable.

        Returns
        -------
        array, shape (n_t, ...) for one variable, (n_t, ..., n_b) for all
            Design derivative; for a position in m per unit of the variable.

        Raises
        ------
        InvalidInputError, UnknownNameError
            If the solution has no sensitivities, none in the variable, or the function drops the
            imaginary part.
        """
        if not callable(of):
            point = of
            return self.derivative(lambda solution: solution.position(point), variable)
        if variable is not None:
            return np.asarray(self.derivative(of)[..., self.design_index(variable)])
        function, s = of, self._known_sensitivities()
        if not s.names:
            return np.zeros((*np.shape(function(self)), 0))
        columns, states_b = [], {"q": s.q_b, "v": s.v_b, "a": s.a_b, "lam": s.lam_b}
        for i in range(len(s.names)):
            shifted = replace(
                self,
                **{x: getattr(self, x) + 1j * STEP * x_b[..., i] for x, x_b in states_b.items()},
                naming=None if self.naming is None else self.naming.stepped(i, 1j * STEP),
                sensitivities=None,
            )
            value = np.asarray(function(shifted))
            if value.dtype.kind != "c":
                raise InvalidInputError(
                    "function of a solution",
                    "must keep the imaginary part of its input",
                    f"a result of type {value.dtype}",
                    "Replace abs, norm and comparisons by complex-safe operations.",
                )
            columns.append(value.imag / STEP)
        return np.stack(columns, axis=-1)

    def at(self, times: Numbers) -> Solution:
        """Return the solution interpolated at given times, with the order of its integrator.

        The times increase and lie within the run; s. Between the steps of HHT coordinates follow
        the cubic through q and v at both ends, velocities the cubic through v and a; accelerations
        and multipliers are linear. For Radau and Gauss-Lobatto points the polynomial of a panel is
        used. Design derivatives are interpolated in the same way. `statistics`, `outcome` and
        `estimated_errors` are copied from the run unchanged.
        """
        asked = np.atleast_1d(require_array("times", times))
        good = asked.ndim == 1 and len(asked) > 0 and bool(np.all(np.diff(asked) > 0))
        if not good or not (self.t[0] <= asked[0] and asked[-1] <= self.t[-1]):
            early = "" if self.outcome.success else f", where the run ended early: {self.outcome}"
            raise InvalidInputError(
                "times",
                f"must increase and lie in [0, {self.t[-1]:.6g}]{early.rstrip('.')}",
                repr(times),
                "For example np.linspace(0, solution.t[-1], 101).",
            )
        sensitivities = self.sensitivities
        if sensitivities is not None:
            q_b, v_b, a_b, lam_b = self._sampled(
                asked, sensitivities.q_b, sensitivities.v_b, sensitivities.a_b, sensitivities.lam_b
            )
            sensitivities = replace(sensitivities, q_b=q_b, v_b=v_b, a_b=a_b, lam_b=lam_b)
        q, v, a, lam = self._sampled(asked, self.q, self.v, self.a, self.lam)
        full = replace(self, sensitivities=sensitivities, degree=1, control=())
        return replace(full, t=asked, q=q, v=v, a=a, lam=lam)

    def _sampled(self, times: Array, q: Array, v: Array, a: Array, lam: Array) -> list[Array]:
        if self.degree == 1 and len(self.t) > 1:
            smooth = (
                scipy.interpolate.CubicHermiteSpline(self.t, x, rate)(times)
                for x, rate in ((q, v), (v, a))
            )
            return [
                *smooth,
                *(scipy.interpolate.make_interp_spline(self.t, x, k=1)(times) for x in (a, lam)),
            ]
        grid = TimeGrid(self.t, self.degree)
        shares = [grid.interpolation(time) for time in times]
        return [
            np.stack([np.tensordot(share, x[rows], 1) for rows, share in shares])
            for x in (q, v, a, lam)
        ]

    def design_index(self, name: str) -> int:
        """Return the index of a design variable in the last axis of every sensitivity."""
        names = self._known_sensitivities().names
        require_text("design variable", name)
        if name not in names:
            raise UnknownNameError("design variable", name, names)
        return names.index(name)

    def _known_naming(self) -> Naming:
        if self.naming is None:
            raise InvalidInputError(
                "solution",
                "positions and reactions by name need the solution of a scene",
                "the solution of a mechanical system, whose coordinates have no names",
                "Use the arrays q, v, a and lam.",
            )
        return self.naming

    def _known_sensitivities(self) -> Sensitivities:
        if self.sensitivities is None:
            raise InvalidInputError(
                "sensitivities",
                "must have been computed",
                "a solution of `simulate`",
                "Call `differentiate`, which returns a solution with design derivatives.",
            )
        return self.sensitivities

    def with_sensitivities(
        self, sensitivities: Sensitivities, verdict: Verdict, seconds: float
    ) -> Solution:
        """Return the solution with derivatives, cut to the times that have derivatives.

        `verdict` is how the computation of derivatives ended; its `seconds` are added to the
        statistics.
        """
        rows, outcome = len(sensitivities.q_b), self.outcome
        steps = (rows - 1) // self.degree
        if verdict is not Verdict.FINISHED:
            outcome = RunOutcome(verdict, float(self.t[rows - 1]), steps, 0.0)
        kept = {x: getattr(self, x)[:rows] for x in ("t", "q", "v", "a", "lam")}
        full = self.with_pass(steps, seconds)
        control = self.control if rows == len(self.t) else ()
        return replace(full, **kept, outcome=outcome, sensitivities=sensitivities, control=control)

    def with_pass(self, factorisations: int, seconds: float) -> Solution:
        """Return the solution with the cost of a further pass of the integrator in `statistics`."""
        statistics = replace(
            self.statistics,
            factorisations=self.statistics.factorisations + factorisations,
            wall_seconds=self.statistics.wall_seconds + seconds,
        )
        return replace(self, statistics=statistics)

    # -- files and text ------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the solution to one file, complete or not at all; return its path.

        A name that ends in ``.h5`` or ``.hdf5`` makes a compressed HDF5 file, which needs h5py
        (``pip install "ancfdae[hdf5]"``); any other name an archive of NumPy (``.npz``).
        docs/results.md describes the format; `load_solution` reads the file.
        """
        from ancfdae.equations import solution_file

        return solution_file.write(require_path("path of a solution", path), vars(self))

    def to_dataframe(
        self, columns: Mapping[str, ArrayLike] | None = None, *, derivatives: bool = False
    ) -> Any:
        """Return the coordinates over time as a table of pandas, with t as its index.

        Columns are named ``rod[2].y`` (node 2, counted from 0), ``rod[2].slope_x.y``, ``box.y`` or
        ``box.axis_1.y``; ``q[3]`` where a system has no names.

        Parameters
        ----------
        columns : mapping of str to array, shape (n_t,)
            Further columns: ``{"tip [m]": observe(position(rod.at_end, 1), solution)}``.
        derivatives : bool
            Whether to add columns for the derivatives of each coordinate in each design variable,
            ``d rod[2].y/d rod.height``.

        Raises
        ------
        MissingPackageError
            If pandas is not installed (``pip install "ancfdae[pandas]"``).
        InvalidInputError
            If a column is not as long as the solution or repeats a name, or there are no
            derivatives.
        """
        require_flag("to_dataframe, derivatives", derivatives)
        sensitivities = self._known_sensitivities() if derivatives else None
        q_b, variables = (
            (None, ()) if sensitivities is None else (sensitivities.q_b, sensitivities.names)
        )
        if self.naming is None:
            names = [f"q[{k}]" for k in range(self.q.shape[1])]
        else:
            names = self.naming.coordinate_names()
        return states_table(self.t, self.q, q_b, names, variables, columns)

    def __repr__(self) -> str:
        sensitivities, errors = self.sensitivities, self.estimated_errors
        span = f"{len(self.t)} instants from t = {self.t[0]:.6g} to {self.t[-1]:.6g}"
        sizes = f"{self.q.shape[1]} coordinates, {self.lam.shape[1]} multipliers"
        lines = [f"Solution: {span}, {sizes}", str(self.outcome)]
        lines += [] if sensitivities is None else [f"derivatives in {listed(sensitivities.names)}"]
        lines += [] if errors is None else [f"{errors!r}{self._doubt}"]
        return "\n".join(lines)

    @property
    def _doubt(self) -> str:
        """Remark in the printed text on a time at which error-controlled steps fell sharply."""
        h = np.diff(self.t)[:-1]
        if not self.control or not h.size:
            return ""
        fall = h / np.maximum.accumulate(h)
        k = int(np.argmin(fall))
        if fall[k] > _SHARP:
            return ""
        return (
            f" (steps fell to 1/{1 / fall[k]:.0f} at t = {self.t[k]:.3g}: errors that grow behind "
            "a kink or a pulse are not part of these; see error_bars)"
        )

    def _repr_html_(self) -> str:
        """Return the sizes of the run and how it ended, as HTML for notebooks."""
        spans = (("instants", self.t), ("coordinates", self.q[0]), ("multipliers", self.lam[0]))
        rows = [("Solution", ""), *((name, str(len(x))) for name, x in spans)]
        rows += [("from, to", f"{self.t[0]:.6g} s, {self.t[-1]:.6g} s")]
        sensitivities, errors = self.sensitivities, self.estimated_errors
        rows += [] if errors is None else [("estimated error", f"{errors.motion:.3g}")]
        told = page("", rows, str(self.outcome))
        return told if sensitivities is None else told + sensitivities._repr_html_()
