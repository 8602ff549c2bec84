"""Three mechanisms as formulas of scalars, which this package, CasADi and JAX evaluate alike.

Every function takes the module whose `sin`, `cos` and `sqrt` it calls.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Self, final

import numpy as np
import numpy.typing as npt

from ancfdae import Integral, Terminal
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom
from ancfdae.sensitivity.objectives import Objective

# A sequence of scalars of whatever kind: floats, symbols, tracers.
_Scalars = Any


class Mechanism(NamedTuple):
    """M(q) a + Phi_q^T lam = Q(q, v, b), Phi(q) = 0, and what is differentiated in b.

    ``observed(module, q, v)`` is a scalar, whose integral over the run is the objective, or its
    value at the end.
    """

    title: str
    names: tuple[str, ...]
    b: tuple[float, ...]
    t_end: float
    q_0: tuple[float, ...]
    mass: Callable[[Any, _Scalars, _Scalars], list[list[Any]]]
    force: Callable[[Any, _Scalars, _Scalars, _Scalars], list[Any]]
    closure: Callable[[Any, _Scalars], list[Any]]
    observed: Callable[[_Scalars, _Scalars], Any]
    integral: bool


@final
class Formulated(FormulaSystem):
    """A mechanism as a system of one's own of this package."""

    def __init__(self, mechanism: Mechanism, b: npt.ArrayLike | None = None) -> None:
        self._mechanism = mechanism
        self.n_q, self.design_names = len(mechanism.q_0), mechanism.names
        self.n_lam = len(mechanism.closure(np, mechanism.q_0))
        super().__init__(np.asarray(mechanism.b if b is None else b))

    def with_values(self, b: npt.NDArray[Any]) -> Self:
        """Return the mechanism at other values of its design variables."""
        return type(self)(self._mechanism, b)

    def start(self) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return the configuration at the start, at rest."""
        return np.array(self._mechanism.q_0), np.zeros(self.n_q)

    def mass_matrix(self, q: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the mass matrix M, shape (n_q, n_q)."""
        return np.array(self._mechanism.mass(np, q, self.b))

    def force(self, t: float, q: npt.NDArray[Any], v: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the force Q, shape (n_q,)."""
        return np.array(self._mechanism.force(np, q, v, self.b))

    def position_constraint(self, t: float, q: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the constraints Phi, shape (n_lam,)."""
        return np.array(self._mechanism.closure(np, q))

    def objective(self) -> Objective:
        """Return the objective of the mechanism."""
        observed = self._mechanism.observed

        def along(
            t: npt.NDArray[Any],
            q: npt.NDArray[Any],
            v: npt.NDArray[Any],
            lam: npt.NDArray[Any],
            b: npt.NDArray[Any],
        ) -> npt.NDArray[Any]:
            return observed(q.T, v.T)

        observable = custom(along, self._mechanism.title)
        return Integral(observable) if self._mechanism.integral else Terminal(observable)


def _five_bar() -> Mechanism:
    """Return the five-bar mechanism in natural coordinates, with two springs.

    Y. Zhu, D. Dopico, C. Sandu, A. Sandu: Dynamic response optimization of complex multibody
    systems in a penalty formulation using adjoint sensitivity, J. Comput. Nonlinear Dyn. 10 (2015).
    """
    first, last = (-0.5, 0.0), (0.5, 0.0)
    q_0 = (-1.0, -1.0, 0.0, -2.0, 1.0, -1.0)
    bars, stiffness, gravity = (1.0, 1.5, 1.5, 1.0), 100.0, 9.81

    def points(q: _Scalars) -> list[tuple[Any, Any]]:
        return [first, (q[0], q[1]), (q[2], q[3]), (q[4], q[5]), last]

    def squares(q: _Scalars) -> list[Any]:
        p = points(q)
        return [(p[i + 1][0] - p[i][0]) ** 2 + (p[i + 1][1] - p[i][1]) ** 2 for i in range(4)]

    lengths = squares(q_0)

    def mass(m: Any, q: _Scalars, b: _Scalars) -> list[list[Any]]:
        M = np.zeros((6, 6))
        for i in range(3):
            M[2 * i, 2 * i] = M[2 * i + 1, 2 * i + 1] = (bars[i] + bars[i + 1]) / 3
        for i in range(2):
            for k in range(2):
                M[2 * i + k, 2 * i + 2 + k] = M[2 * i + 2 + k, 2 * i + k] = bars[i + 1] / 6
        return [[float(x) for x in row] for row in M]

    def force(m: Any, q: _Scalars, v: _Scalars, b: _Scalars) -> list[Any]:
        Q: list[Any] = [0 * q[0]] * 6
        for i in range(3):
            Q[2 * i + 1] = -gravity * (bars[i] + bars[i + 1]) / 2 + 0 * q[0]
        for end, free in ((first, b[0]), (last, b[1])):
            x, y = q[2] - end[0], q[3] - end[1]
            length = m.sqrt(x * x + y * y)
            pull = -stiffness * (length - free) / length
            Q[2], Q[3] = Q[2] + pull * x, Q[3] + pull * y
        return Q

    return Mechanism(
        "five-bar, 5 s",
        ("L01", "L02"),
        (2.2360, 2.0615),
        5.0,
        q_0,
        mass,
        force,
        lambda m, q: [s - length for s, length in zip(squares(q), lengths, strict=True)],
        lambda q, v: q[3] ** 2,
        True,
    )


def _slider_crank() -> Mechanism:
    """Return the slider-crank of SUNDIALS (`validation/external/slider_crank.py` says more)."""
    a, inertia, free, push = 0.5, (1.0, 1.0, 2.0), 1.0, 1.0
    angle = float(np.arcsin(-a))

    def force(m: Any, q: _Scalars, v: _Scalars, b: _Scalars) -> list[Any]:
        (turn, x, p), (k, c) = q, b
        N = x * x - x * (m.cos(p) + a * m.cos(turn)) + (1 + a * a) / 4
        N = N + a / 2 * m.cos(p - turn)
        bend = a / 2 * m.sin(p - turn)
        N_q = [a * x * m.sin(turn) + bend, 2 * x - m.cos(p) - a * m.cos(turn), x * m.sin(p) - bend]
        rate = (N_q[0] * v[0] + N_q[1] * v[1] + N_q[2] * v[2]) / (2 * N)
        f = k * (1 - free / m.sqrt(N)) + c * rate
        return [-f * N_q[0] / 2, push - f * N_q[1] / 2, -push * m.sin(p) - f * N_q[2] / 2]

    def closure(m: Any, q: _Scalars) -> list[Any]:
        turn, x, p = q
        return [x - a * m.cos(turn) - m.cos(p), -a * m.sin(turn) - m.sin(p)]

    return Mechanism(
        "slider-crank of SUNDIALS, 10 s",
        ("k", "c"),
        (1.0, 1.0),
        10.0,
        (np.pi / 2, float(np.cos(angle)), angle),
        lambda m, q, b: [[inertia[i] if i == j else 0.0 for j in range(3)] for i in range(3)],
        force,
        closure,
        lambda q, v: (v[0] ** 2 + v[1] ** 2 + 2 * v[2] ** 2) / 2,
        True,
    )


def _squeezer() -> Mechanism:
    """Return Andrews' squeezer (`validation/test_set/squeezer.py` says more)."""
    m1, m2, m3, m4, m5, m6 = 0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706
    xa, ya, xb, yb, xc, yc = -0.06934, -0.00227, -0.03635, 0.03273, 0.014, 0.072
    i1, i2, i3, i4 = 2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7
    i5, i6, i7 = 1.169e-5, 5.667e-7, 1.912e-5
    d, da, e, ea, rr, ra, l0 = 28e-3, 115e-4, 2e-2, 1421e-5, 7e-3, 92e-5, 7785e-5
    ss, sa, sb, sc, sd = 35e-3, 1874e-5, 1043e-5, 18e-3, 2e-2
    ta, tb, u, ua, ub = 2308e-5, 916e-5, 4e-2, 1228e-5, 449e-5
    zf, zt, fa = 2e-2, 4e-2, 1421e-5
    e4, f6 = e - ea, zf - fa

    def mass(m: Any, q: _Scalars, b: _Scalars) -> list[list[Any]]:
        c_th, s_ph, s_om = m.cos(q[1]), m.sin(q[3]), m.sin(q[5])
        none = 0 * c_th
        M: list[list[Any]] = [[none] * 7 for _ in range(7)]
        M[0][0] = m1 * ra**2 + m2 * (rr**2 - 2 * da * rr * c_th + da**2) + i1 + i2
        M[0][1] = M[1][0] = m2 * (da**2 - da * rr * c_th) + i2
        M[1][1] = m2 * da**2 + i2 + none
        M[2][2] = m3 * (sa**2 + sb**2) + i3 + none
        M[3][3] = m4 * e4**2 + i4 + none
        M[3][4] = M[4][3] = m4 * (e4**2 + zt * e4 * s_ph) + i4
        M[4][4] = m4 * (zt**2 + 2 * zt * e4 * s_ph + e4**2) + i4 + m5 * (ta**2 + tb**2) + i5
        M[5][5] = m6 * f6**2 + i6 + none
        M[5][6] = M[6][5] = m6 * (f6**2 - u * f6 * s_om) + i6
        M[6][6] = m6 * (f6**2 - 2 * u * f6 * s_om + u**2) + i6 + b[2] * (ua**2 + ub**2) + i7
        return M

    def force(m: Any, q: _Scalars, v: _Scalars, b: _Scalars) -> list[Any]:
        c, s = m.cos(q[2]), m.sin(q[2])
        arm = sd * c + sc * s, sd * s - sc * c
        x, y = arm[0] + xb - xc, arm[1] + yb - yc
        pull = -b[1] * (1 - l0 / m.sqrt(x * x + y * y))
        two, four, six = m2 * da * rr, m4 * zt * e4, m6 * u * f6
        return [
            b[0] - two * v[1] * (v[1] + 2 * v[0]) * m.sin(q[1]),
            two * v[0] ** 2 * m.sin(q[1]),
            pull * (y * arm[0] - x * arm[1]),
            four * v[4] ** 2 * m.cos(q[3]),
            -four * v[3] * (v[3] + 2 * v[4]) * m.cos(q[3]),
            -six * v[6] ** 2 * m.cos(q[5]),
            six * v[5] * (v[5] + 2 * v[6]) * m.cos(q[5]),
        ]

    def closure(m: Any, q: _Scalars) -> list[Any]:
        be, th, ga, ph, de, om, ep = q
        cos, sin = m.cos, m.sin
        x, y = rr * cos(be) - d * cos(be + th), rr * sin(be) - d * sin(be + th)
        return [
            x - ss * sin(ga) - xb,
            y + ss * cos(ga) - yb,
            x - e * sin(ph + de) - zt * cos(de) - xa,
            y + e * cos(ph + de) - zt * sin(de) - ya,
            x - zf * cos(om + ep) - u * sin(ep) - xa,
            y - zf * sin(om + ep) + u * cos(ep) - ya,
        ]

    q_0 = (
        -0.0617138900142764496358948458001,
        0.0,
        0.455279819163070380255912382449,
        0.222668390165885884674473185609,
        0.487364979543842550225598953530,
        -0.222668390165885884674473185609,
        1.23054744454982119249735015568,
    )
    return Mechanism(
        "Andrews' squeezer, 0.03 s",
        ("mom", "c0", "m7"),
        (0.033, 4530.0, 0.05498),
        0.03,
        q_0,
        mass,
        force,
        closure,
        lambda q, v: q[0],
        False,
    )


MECHANISMS: tuple[Callable[[], Mechanism], ...] = _five_bar, _slider_crank, _squeezer
