"""The woodpecker toy as a system of absolute coordinates with contact modes, for report `events`.

Sleeve and bird have a height and an angle each; a joint, linearised as in the source, holds them
together. Modes keep the lower or the upper end of the sleeve on the pole by one more constraint;
there friction acts as a force, from the equations of motion, while the contact sticks or slides.
The model, its data and its twin: `woodpecker_twin`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ancfdae import EndEvent, Impact, ImpactLaw, Mode, RestModes, Switch
from ancfdae.extend import FormulaSystem, Observable
from ancfdae.observables import custom
from validation.events.woodpecker_twin import DATA, Toy

__all__ = ["START", "Woodpecker"]

Array = np.ndarray[Any, Any]

#: Friction, restitution of the beak, stiffness, mass of the bird, radius of the pole; then, where
#: the sleeve tilts by -0.05 rad and rises, the angle of the bird, and the rates of the height and
#: the angle of the sleeve and of the angle of the bird: SI units. The last four are close to the
#: limit cycle.
START = (0.3, 0.5, 0.0056, 0.0045, 0.0025, -0.021365, -0.290645, 26.4265, 14.946)
_NAMES = ("mu", "e", "c", "m_S", "r_0", "phi_S", "v", "w_M", "w_S")
_TILT = -0.05
# Signs of the gaps of the lower and of the upper end in the angle of the sleeve.
_ENDS = {"lower": 1.0, "upper": -1.0}
# How a contact slides, and the sign of its sliding velocity.
_WAYS = {"sticks": 0.0, "rises": 1.0, "falls": -1.0}


class Woodpecker(FormulaSystem):
    """The toy in one contact mode: free, or with one end on the pole, which sticks or slides."""

    n_q = 4
    design_names = _NAMES
    gravity = 9.81

    def __init__(self, b: Any = START, end: str | None = None, way: str = "sticks") -> None:
        self.end, self.way = end, way
        self.n_lam = 1 if end is None else 2
        super().__init__(b)

    def with_values(self, b: Array) -> Woodpecker:
        """Return the toy at other values, in the same mode."""
        return Woodpecker(b, self.end, self.way)

    def start(self) -> tuple[Array, Array]:
        """Return the state in which the sleeve tilts by -0.05 rad."""
        l_M, l_G = DATA[9:11]
        phi, v, w_M, w_S = self.b[5:]
        q = np.array([0 * phi, _TILT + 0 * phi, l_M * _TILT + l_G * phi, phi])
        return q, np.array([v, w_M, v + l_M * w_M + l_G * w_S, w_S])

    def mass_matrix(self, q: Array) -> Array:
        """Return masses and inertias."""
        return np.diag([DATA[0], DATA[1], self.b[3], DATA[3]]) + 0 * self.b[3]

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return weights, the torque of the spring, and the friction of the contact."""
        moment = self.b[2] * (q[3] - q[1])
        Q = np.array([-DATA[0] * self.gravity, moment, -self.b[3] * self.gravity, -moment])
        if self.end is not None:
            _, T = contact_forces(q, self.b, _ENDS[self.end], _WAYS[self.way])
            Q = Q + T * np.array([1.0, DATA[7], 0.0, 0.0])
        return Q

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the joint, and the gap that is closed."""
        l_M, l_G = DATA[9:11]
        joint = q[2] - q[0] - l_M * q[1] - l_G * q[3]
        if self.end is None:
            return np.array([joint])
        return np.array([joint, DATA[7] - self.b[4] + _ENDS[self.end] * DATA[8] * q[1]])

    # -- events ------------------------------------------------------------------------------------

    @staticmethod
    def events(law: ImpactLaw = ImpactLaw.NEWTON) -> list[Impact]:
        """Return the three impacts with friction."""
        mu, e = (custom(lambda t, q, v, lam, b, k=k: b[k] + 0 * t, _NAMES[k]) for k in (0, 1))
        l_M, l_G, h_S, l_S = DATA[9:13]
        beak = custom(lambda t, q, v, lam, b: l_M + l_G - l_S - b[4] - h_S * q[:, 3], "beak")
        along = custom(
            lambda t, q, v, lam, b: v[:, 0] + l_M * v[:, 1] + (l_G - l_S) * v[:, 3], "along"
        )
        found = [Impact(beak, e, "beak", friction=mu, sliding=along, law=law)]
        for end, sign in _ENDS.items():
            gap = custom(
                lambda t, q, v, lam, b, sign=sign: DATA[7] - b[4] + sign * DATA[8] * q[:, 1], end
            )
            rest = RestModes(*(f"{end} {way}" for way in _WAYS))
            found.append(Impact(gap, 0.0, end, rest, mu, _sliding(), law))
        return found

    def modes(self) -> dict[str, Mode]:
        """Return the modes in which an end of the sleeve stays on the pole."""
        found = {}
        push = custom(lambda t, q, v, lam, b: -lam[:, 1], "push")
        for end, sign in _ENDS.items():
            for way, side in _WAYS.items():
                leaves = Switch(push, "start", -1, f"{end} leaves")
                if side:
                    events = [
                        leaves,
                        Switch(_sliding(), f"{end} sticks", -int(side), f"{end} stops"),
                    ]
                else:
                    events = [leaves, *(_slips(end, sign, how) for how in ("rises", "falls"))]
                found[f"{end} {way}"] = Mode(Woodpecker(self.b, end, way), events)
        return found

    @staticmethod
    def section() -> EndEvent:
        """Return the end of a cycle, where the sleeve tilts by -0.05 rad and rises."""
        return EndEvent(custom(lambda t, q, v, lam, b: q[:, 1] - _TILT, "tilt"), 1, "section")

    # -- the twin ----------------------------------------------------------------------------------

    @staticmethod
    def twin(b: Array, t_end: float, poisson: bool = False) -> tuple[Array, Array, Toy]:
        """Return minimal coordinates and velocities at the end, and the toy with its events."""
        mu, e, c, m_S, r_0, phi, v, w_M, w_S = b.tolist()
        data = [*DATA]
        data[2], data[4], data[6] = m_S, c, r_0
        toy = Toy(data, mu, (e, 0.0, 0.0), poisson)
        q, u = toy.run(np.array([0.0, _TILT, phi]), np.array([v, w_M, w_S]), t_end)
        return q, u, toy


def _sliding() -> Observable:
    """Return the velocity of both ends of the sleeve along the pole."""
    return custom(lambda t, q, v, lam, b: v[:, 0] + DATA[7] * v[:, 1], "sliding")


def _slips(end: str, sign: float, how: str) -> Switch:
    """Return the switch at which a sticking end begins to slide."""

    def reserve(t: Any, q: Any, v: Any, lam: Any, b: Any) -> Any:
        N, T = contact_forces(q.T, b, sign, 0.0)
        return b[0] * N + _WAYS[how] * T

    return Switch(custom(reserve, "reserve"), f"{end} {how}", -1, f"{end} {how}")


def contact_forces(q: Array, b: Array, sign: float, slides: float) -> tuple[Any, Any]:
    """Return the normal and the friction force of an end that is on the pole.

    With phi_M held the accelerations of height and bird are linear in the friction T. The equation
    of the sleeve then gives N. T is -mu N times the sign of sliding, or it keeps the height.
    """
    m_M, _, _, J_S, _, g, _, r_M, h_M, l_M, l_G, _, _ = DATA
    mu, c, m_S = b[0], b[2], b[3]
    m, J = m_M + m_S, J_S + m_S * l_G**2
    moment = c * (q[1] - q[3])
    bird = moment - m_S * g * l_G
    sleeve = moment + m_S * g * l_M
    if slides == 0:
        turns = bird / J
        T = m * g + m_S * l_G * turns
        return (m_S * l_M * l_G * turns + sleeve - r_M * T) / (sign * h_M), T
    D = m * J - (m_S * l_G) ** 2
    rises = -(J * m * g + m_S * l_G * bird) / D
    lever = l_M - l_M * m_M * J / D - r_M
    N = (l_M * (-m * g - m_M * rises) + sleeve) / (sign * h_M + slides * mu * lever)
    return N, -slides * mu * N
