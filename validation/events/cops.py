"""Part (H) of the report on events: the robot arm of COPS, a published problem of least time."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final, final

import numpy as np
import scipy

from ancfdae import Adjoint, ComplexStep, Radau, Responses, Terminal, gradients
from ancfdae.extend import FormulaSystem, positive
from ancfdae.observables import custom
from ancfdae.plotting import Panel, Series
from validation.events.minimal import Array
from validation.report import Agreement, Report

__all__ = ["RobotArm", "asked", "fill", "missed"]

# t_f of Dolan, More & Munson, COPS 3.0, ANL/MCS-TM-273 (2004), to the digits that the issue has.
_PUBLISHED = 9.14
_LENGTH: Final = 5.0
_START: Final = np.array([4.5, 0.0, np.pi / 4])
_TARGET: Final = np.array([4.5, 2 * np.pi / 3, np.pi / 4])
_TIME, _END, _DIFFERENCES, _METHODS = 0.01, 1e-6, 1e-7, 1e-10


@final
class RobotArm(FormulaSystem):
    """Reach, turn and tilt of an arm under three moments; time runs from 0 to 1, in units of T.

    L rho'' = u_1, I_theta theta'' = u_2, I_phi phi'' = u_3 with I_phi = ((L - rho)^3 + rho^3) / 3
    and I_theta = I_phi sin(phi)^2. Moments are straight between their values at equal times.
    """

    n_q, n_lam = 3, 0

    def __init__(self, intervals: int, b: Any) -> None:
        self._intervals = intervals
        moments = (f"u{i + 1}[{k}]" for i in range(3) for k in range(intervals + 1))
        self.design_names = (*moments, "T")
        super().__init__(b)

    def with_values(self, b: Any) -> RobotArm:
        """Return the arm with other moments and another T."""
        return RobotArm(self._intervals, b)

    def start(self) -> tuple[Array, Array]:
        """Return the start at rest."""
        return _START.copy(), np.zeros(3)

    def mass_matrix(self, q: Array) -> Array:
        """Return the unit matrix."""
        return np.eye(3)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Return the accelerations times T^2."""
        s = t * self._intervals - np.arange(self._intervals + 1)
        hats = positive(s + 1) - 2 * positive(s) + positive(s - 1)
        u = self.b[:-1].reshape(3, -1) @ hats
        inertia = ((_LENGTH - q[0]) ** 3 + q[0] ** 3) / 3
        turned = inertia * np.sin(q[2]) ** 2
        return self.b[-1] ** 2 * np.array([u[0] / _LENGTH, u[1] / turned, u[2] / inertia])

    def position_constraint(self, t: Any, q: Array) -> Array:
        """Return no constraint."""
        return np.zeros(0)


def asked() -> dict[str, Terminal]:
    """Return the functions that must vanish at the end: three gaps to the target, three rates."""
    found = dict[str, Terminal]()
    for i in range(3):
        gap = custom(lambda t, q, v, lam, b, i=i: q[:, i] - _TARGET[i])
        found[f"place {i + 1}"] = Terminal(gap)
        found[f"rate {i + 1}"] = Terminal(custom(lambda t, q, v, lam, b, i=i: v[:, i]))
    return found


def missed(b: Array) -> Array:
    """Return places beside the target and rates at the end, in the order of `asked`, by SciPy."""
    u, T, y = b[:-1].reshape(3, -1), b[-1], np.append(_START, np.zeros(3))
    times = np.linspace(0.0, 1.0, u.shape[1])

    def rates(t: float, y: Array) -> Array:
        moments = np.array([np.interp(t, times, row) for row in u])
        cubes = ((_LENGTH - y[0]) ** 3 + y[0] ** 3) / 3
        by = np.array([_LENGTH, cubes * np.sin(y[2]) ** 2, cubes])
        return np.append(y[3:], T**2 * moments / by)

    for begin, end in pairwise(times.tolist()):  # Moments have kinks between.
        run = scipy.integrate.solve_ivp(
            rates, (begin, end), y, method="DOP853", rtol=1e-12, atol=1e-13
        )
        y = run.y[:, -1]
    return np.ravel([y[:3] - _TARGET, y[3:]], order="F")


def fill(report: Report, quick: bool) -> None:
    """Add the table, the plot and the claims."""
    n = 8 if quick else 50
    report.heading("H. Robot arm of COPS")
    report.text(
        "Reach, turn and tilt of an arm, from rest to rest in the least time with moments within 1 "
        "(Dolan, More and Munson, COPS 3.0, problem 8). Variables are the moments at "
        f"{n + 1} equal times, straight between them, and the time T that scales the equations; "
        "Radau takes one step from each of these times to the next. A moment that jumps from limit "
        "to limit needs one of these intervals, so that T falls with their number. End conditions "
        "and their derivatives are compared with an integration by SciPy."
    )
    moments = np.zeros((3, n + 1))
    moments[1] = np.where(np.arange(n + 1) < n / 2, 0.9, -0.9)
    start, ends = np.append(moments.ravel(), 10.0), asked()
    limits = np.ones(start.size - 1)
    responses = Responses(RobotArm(n, start), ends, 1.0, Radau(step=1 / n))
    ahead = np.append(0 * limits, 1.0)
    found = scipy.optimize.minimize(
        lambda x: x[-1],
        start,
        jac=lambda x: ahead,
        bounds=scipy.optimize.Bounds(np.append(-limits, 5.0), np.append(limits, 20.0)),
        constraints=[responses.constraint(name, 0.0, 0.0) for name in ends],
        method="SLSQP",
        options={"maxiter": 3 if quick else 200, "ftol": 1e-10},
    )
    T, left = float(found.x[-1]), np.abs(missed(found.x))
    miss = float(max(np.max(left[::2]), np.max(left[1::2]) / T) / _LENGTH)
    rows: list[list[object]] = [
        ["least time", f"{T:.5f}"],
        ["designs run", str(len(responses.history.rows))],
        ["SLSQP", str(found.message)],
        ["end conditions, by SciPy", f"{miss:.1e} of the length"],
    ]
    report.table(["quantity", "found"], rows)
    report.figure("cops.time", T)
    report.figure("cops.miss", miss)
    report.claim(
        "(H) Least time of the robot arm of COPS", f"{_PUBLISHED} within {_TIME}", f"{T:.4f}",
        _verdict(abs(T - _PUBLISHED) <= _TIME),
    )  # fmt: skip
    report.claim(
        "(H) End conditions of the robot arm of COPS", f"{_END:.0e} of the length",
        f"{miss:.1e}", _verdict(miss <= _END),
    )  # fmt: skip
    _gradients(report, n, found.x)
    if not quick:
        _plot(report, found.x)


def _gradients(report: Report, n: int, b: Array) -> None:
    """Compare derivatives in a moment of each kind and in T with differences of SciPy's runs."""
    few = [n // 3, n + 1 + n // 2, 2 * n + 5, b.size - 1]
    system, functions = RobotArm(n, b), list(asked().values())
    fine = Radau(step=0.25 / n)
    exact, stepped = (
        np.array([x.gradient[few] for x in gradients(system, functions, 1.0, fine, method=m)])
        for m in (Adjoint(), ComplexStep())
    )
    slopes, h = [], 1e-3
    for unit in np.eye(b.size)[few]:
        near, far = (
            (missed(b + s * h * unit) - missed(b - s * h * unit)) / (2 * s * h) for s in (1, 2)
        )
        slopes.append((4 * near - far) / 3)
    size = np.max(np.abs(exact))
    off = float(np.max(np.abs(np.transpose(slopes) - exact)) / size)
    apart = float(np.max(np.abs(stepped - exact)) / size)
    report.figure("cops.differences", off)
    report.figure("cops.methods", apart)
    report.claim(
        "(H) Derivatives of the end conditions in moments and T against differences of SciPy's "
        "runs",
        f"{_DIFFERENCES:.0e}", f"{off:.1e}", _verdict(off <= _DIFFERENCES),
    )  # fmt: skip
    report.claim(
        "(H) robot arm: adjoint and complex step agree", f"{_METHODS:.0e}", f"{apart:.1e}",
        _verdict(apart <= _METHODS),
    )  # fmt: skip


def _plot(report: Report, b: Array) -> None:
    t = np.linspace(0.0, b[-1], (b.size - 1) // 3)
    series = [
        Series(name, t, row)
        for name, row in zip(("reach", "turn", "tilt"), b[:-1].reshape(3, -1), strict=True)
    ]
    report.plot(
        "cops",
        [Panel("Moments of the robot arm", "t [-]", "moment [-]", series)],
        caption="All three moments switch between their limits.",
    )


def _verdict(holds: bool) -> Agreement:
    return Agreement.AGREES if holds else Agreement.DISAGREES
