"""Mechanisms of report `events` as systems of absolute coordinates, and their twins."""

from __future__ import annotations

from typing import Any

import numpy as np

from ancfdae import Impact, Mode, Switch
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom
from validation.events.minimal import Array, Linkage

__all__ = ["Ball", "Box", "DoublePendulum", "FiveBar", "SliderCrank"]


def design(number: int) -> Any:
    """Return a design value as an observable."""
    return custom(lambda t, q, v, lam, b: b[number] + 0 * t, f"b{number}")


class _System(FormulaSystem):
    """A system with values that can be moved."""

    def with_values(self, b: Array) -> Any:
        """Return the system at other values."""
        return type(self)(b)


class Ball(_System):
    """A ball above a floor: z'' = -g."""

    n_q, n_lam = 1, 0
    design_names = ("z0", "v0", "g", "restitution")
    height = custom(lambda t, q, v, lam, b: q[:, 0], "height")
    floor = Impact(height, design(3), "floor")

    def __init__(self, b: Any = (5.0, -0.1, 10.0, 0.8)) -> None:
        super().__init__(b)

    def start(self) -> tuple[Array, Array]:
        """Return height and speed at the start."""
        return self.b[:1] * 1, self.b[1:2] * 1

    def mass_matrix(self, q: Array) -> Array:
        """Return one: the mass does not matter."""
        return np.eye(1)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the weight."""
        return -self.b[2:3]

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return none."""
        return np.zeros(0)


class Box(_System):
    """A box that slides on a floor, against friction mu g, until it stands."""

    n_q, n_lam = 1, 0
    design_names = ("x0", "v0", "mu")
    place = custom(lambda t, q, v, lam, b: q[:, 0], "place")
    speed = custom(lambda t, q, v, lam, b: v[:, 0], "speed")
    stands = Switch(speed, "standing", -1, "stands")

    def __init__(self, b: Any = (0.0, 1.0, 0.1), friction: float = 10.0) -> None:
        self.friction = friction
        super().__init__(b)

    def with_values(self, b: Array) -> Box:
        """Return the box at other values."""
        return Box(b, self.friction)

    def start(self) -> tuple[Array, Array]:
        """Return place and speed at the start."""
        return self.b[:1] * 1, self.b[1:2] * 1

    def mass_matrix(self, q: Array) -> Array:
        """Return one: the mass does not matter."""
        return np.eye(1)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the friction; none where the box stands."""
        return -self.friction * self.b[2:3] + 0 * q

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return none."""
        return np.zeros(0)

    def modes(self) -> dict[str, Mode]:
        """Return the mode in which the box stands: no friction acts, and its speed is zero."""
        return {"standing": Mode(Box(self.b, 0.0))}


class FiveBar(_System):
    """A five-bar linkage of massless bars with masses at its joints, above a floor.

    Pivots at 0 and (d, 0), cranks of length 1, couplers of length L and 1.3; the joint of both
    couplers strikes the floor.
    """

    n_q, n_lam = 6, 4
    design_names = ("m3", "L", "floor", "restitution")
    tip = custom(lambda t, q, v, lam, b: q[:, 5] + 0.3 * q[:, 4] * v[:, 5], "tip")
    impact = Impact(custom(lambda t, q, v, lam, b: q[:, 5] - b[2], "gap"), design(3), name="floor")
    second, d, t_end = 1.3, 1.2, 1.2
    cranks = (0.9, 2.0)

    def __init__(self, b: Any = (1.4, 1.2, 0.6, 0.7)) -> None:
        super().__init__(b)

    def start(self) -> tuple[Array, Array]:
        """Return the joints at rest; the coupler joint is the upper intersection of circles."""
        first, second = (
            np.array([x + np.cos(a), np.sin(a)])
            for x, a in zip((0.0, self.d), self.cranks, strict=True)
        )
        L, R = self.b[1], self.second
        apart = second - first
        D = np.sqrt(apart @ apart)
        along = (L * L - R * R + D * D) / (2 * D)
        up = np.sqrt(L * L - along * along)
        third = first + (along * apart + up * np.array([-apart[1], apart[0]])) / D
        return np.concatenate([first, second, third]), np.zeros(6) * self.b[0]

    def mass_matrix(self, q: Array) -> Array:
        """Return the masses of the joints."""
        m = self.b[0]
        return np.diag([1.0, 1.0, 0.8, 0.8, m, m])

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the weights."""
        return np.array([0.0, -9.81, 0.0, -9.81 * 0.8, 0.0, -9.81 * self.b[0]])

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the lengths of the four bars."""
        one, two = q[2] - self.d, q[3]
        f, s = q[4:] - q[:2], q[4:] - q[2:4]
        return np.array([
            (q[:2] @ q[:2] - 1) / 2, (one * one + two * two - 1) / 2,
            (f @ f - self.b[1] ** 2) / 2, (s @ s - self.second**2) / 2,
        ])  # fmt: skip

    def twin(self, b: Array) -> Linkage:
        """Return the linkage in the angles of its cranks."""
        m3, L, floor, e = b
        q, _ = type(self)(b).start()
        z = q[::2] + 1j * q[1::2]
        phi = np.angle([z[0], z[1] - self.d, (z[2] - z[0]), (z[2] - z[1])])
        # e = (crank 1, crank 2, coupler 1, coupler 2); offsets do not matter to motion.
        B = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1, 0, L, 0]], dtype=complex)
        alpha = -1j * np.array([1, 0, L, 0], dtype=complex)
        return Linkage(
            B, np.array([1.0, 0.8, m3]), np.zeros(4), -9.81j, [(alpha, -floor)], e, phi,
            np.zeros(2), np.array([1, -1, L, -self.second], dtype=complex), self.d, 2,
        )  # fmt: skip

    def by_twin(self, b: Array) -> float:
        """Return `tip` at the end by the twin."""
        phi, rates = (twin := self.twin(b)).run(self.t_end)
        e = np.exp(1j * phi)
        z, w = twin.B[2] @ e, twin.B[2] @ (1j * e * rates)
        return float(z.imag + 0.3 * z.real * w.imag)


class SliderCrank(_System):
    """A slider-crank whose slider has clearance in its guide (Flores, Leine and Glocker 2010).

    Three bodies (x, y, angle); the four corners of the slider strike the guide, with friction.
    """

    n_q, n_lam = 9, 6
    design_names = ("crank", "clearance", "restitution", "mass", "mu")
    slider = custom(lambda t, q, v, lam, b: q[:, 6] + 1e-2 * v[:, 7], "slider")
    rod, a, h, t_end = 0.306, 0.05, 0.025, 0.0082
    m, J = (0.038, 0.038), (7.4e-5, 5.9e-4, 7e-5)
    omega, tilt = (150.0, -75.0), 0.008

    def __init__(self, b: Any = (0.153, 1e-3, 0.4, 0.076, 0.01)) -> None:
        super().__init__(b)

    def start(self) -> tuple[Array, Array]:
        """Return crank and rod stretched along the guide, and their speeds."""
        L, (w1, w2) = self.b[0], self.omega
        x = np.array([L / 2, L + self.rod / 2, L + self.rod])
        q = np.array([x[0], 0, 0, x[1], 0, 0, x[2], 0, self.tilt]) + 0 * L
        speeds = np.array([L / 2 * w1, L * w1 + self.rod / 2 * w2, L * w1 + self.rod * w2])
        return q, np.array([0, speeds[0], w1, 0, speeds[1], w2, 0, speeds[2], 0])

    def mass_matrix(self, q: Array) -> Array:
        """Return masses and inertias."""
        m, (J1, J2, J3) = self.b[3], self.J
        return np.diag([self.m[0], self.m[0], J1, self.m[1], self.m[1], J2, m, m, J3])

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return none: there is no gravity."""
        return 0 * q

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the pins: ground and crank, crank and rod, rod and slider."""
        L, R = self.b[0], self.rod
        c1, s1, c2, s2 = np.cos(q[2]), np.sin(q[2]), np.cos(q[5]), np.sin(q[5])
        return np.array([
            q[0] - L / 2 * c1, q[1] - L / 2 * s1,
            q[3] - q[0] - L / 2 * c1 - R / 2 * c2, q[4] - q[1] - L / 2 * s1 - R / 2 * s2,
            q[6] - q[3] - R / 2 * c2, q[7] - q[4] - R / 2 * s2,
        ])  # fmt: skip

    def impacts(self) -> list[Impact]:
        """Return the impacts of the four corners."""
        found = []
        for side in (1, -1):
            for end in (1, -1):

                def gap(
                    t: Any, q: Any, v: Any, lam: Any, b: Any, side: int = side, end: int = end
                ) -> Any:
                    angle = q[:, 8]
                    lift = end * self.a / 2 * np.sin(angle)
                    corner = q[:, 7] + lift + side * self.h / 2 * np.cos(angle)
                    return self.h / 2 + b[1] - side * corner

                def sliding(
                    t: Any, q: Any, v: Any, lam: Any, b: Any, side: int = side, end: int = end
                ) -> Any:
                    c, s = np.cos(q[:, 8]), np.sin(q[:, 8])
                    return v[:, 6] - (end * self.a / 2 * s + side * self.h / 2 * c) * v[:, 8]

                name = f"{'top' if side > 0 else 'bottom'} {'right' if end > 0 else 'left'}"
                along = custom(sliding, f"along {name}")
                found.append(Impact(custom(gap, name), design(2), name, None, design(4), along))
        return found

    def twin(self, b: Array) -> Linkage:
        """Return the chain of three bodies in its angles."""
        L, c, e, m, mu = b
        B = np.array([[L / 2, 0, 0], [L, self.rod / 2, 0], [L, self.rod, 0]], dtype=complex)
        gaps, corners = [], []
        for side in (1, -1):
            for end in (1, -1):
                # The height of z is Re(-i z); corners are at (end a/2 + i side h/2) e_3.
                place = end * self.a / 2 + 1j * side * self.h / 2
                corners.append(np.array([L, self.rod, place]))
                gaps.append((side * 1j * corners[-1], self.h / 2 + c))
        masses, inertias = np.array([*self.m, m]), np.array(self.J)
        speed = np.array([*self.omega, 0.0])
        start = np.array([0, 0, self.tilt])
        return Linkage(
            B, masses, inertias, 0j, gaps, e, start, speed, mu=mu, beta=corners
        )  # fmt: skip

    def by_twin(self, b: Array) -> float:
        """Return `slider` at the end by the twin."""
        phi, rates = (twin := self.twin(b)).run(self.t_end)
        e = np.exp(1j * phi)
        return float((twin.B[2] @ e).real + 1e-2 * (twin.B[2] @ (1j * e * rates)).imag)


class DoublePendulum(_System):
    """Two masses on massless rods, whose elbow locks at a right angle."""

    n_q, n_lam = 4, 2
    design_names = ("m2", "L1", "spin")
    elbow = custom(
        lambda t, q, v, lam, b: q[:, 0] * (q[:, 2] - q[:, 0]) + q[:, 1] * (q[:, 3] - q[:, 1]),
        "elbow",
    )
    tip = custom(lambda t, q, v, lam, b: q[:, 3] + 2 * q[:, 0] * v[:, 3], "tip")
    lock = Switch(elbow, "locked", -1, "lock")
    second, t_end = 0.8, 1.0

    def __init__(self, b: Any = (1.5, 1.0, 5.0)) -> None:
        super().__init__(b)

    def start(self) -> tuple[Array, Array]:
        """Return the first rod hanging and swinging, the second one beside it."""
        L = self.b[1]
        p = L * np.array([0.0, -1.0])
        v = L * self.b[2] * np.array([1.0, 0.0])
        q = np.concatenate([p, p + self.second * np.array([np.sin(-0.7), -np.cos(0.7)])])
        return q, np.concatenate([v, v])

    def mass_matrix(self, q: Array) -> Array:
        """Return the masses."""
        m = self.b[0]
        return np.diag([1.0, 1.0, m, m])

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the weights."""
        return np.array([0.0, -9.81, 0.0, -9.81 * self.b[0]])

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the lengths of the rods."""
        d = q[2:] - q[:2]
        return np.array([(q[:2] @ q[:2] - self.b[1] ** 2) / 2, (d @ d - self.second**2) / 2])

    def modes(self) -> dict[str, Mode]:
        """Return the mode with a locked elbow."""
        return {"locked": Mode(_Locked(self.b))}

    def by_twin(self, b: Array) -> float:
        """Return `tip` at the end in angles: a chain of two rods, then one rigid body."""
        m2, L, spin = b
        B = np.array([[L, 0], [L, self.second]], dtype=complex)
        start = np.array([-np.pi / 2, -np.pi / 2 - 0.7])
        # cos(phi_2 - phi_1) falls through zero: not linear in e, so the angle is a coordinate.
        chain = _Chain(
            B, np.array([1.0, m2]), np.zeros(2), -9.81j, [(np.zeros(2), 0.0)], 0.0, start,
            np.array([spin, 0.0]),
        )  # fmt: skip
        phi, rates = chain.run(self.t_end)
        e = np.exp(1j * phi)
        z, w = B @ e, B @ (1j * e * rates)
        return float(z[1].imag + 2 * z[0].real * w[1].imag)


class _Locked(DoublePendulum):
    """The pendulum with its elbow locked."""

    n_lam = 3

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the lengths of the rods, and the right angle."""
        d = q[2:] - q[:2]
        rods = (q[:2] @ q[:2] - self.b[1] ** 2) / 2, (d @ d - self.second**2) / 2
        return np.array([*rods, q[:2] @ d])


class _Chain(Linkage):
    """Two rods whose difference of angles is held once it is a right angle."""

    locked = False

    def gap(self, n: int, theta: Array) -> float:
        """Return the cosine of the elbow; after the lock, one."""
        return 1.0 if self.locked else float(np.cos(theta[1] - theta[0]))

    def struck(self, n: int, theta: Array, speed: Array) -> tuple[Array, float]:
        """Return the common speed after the lock, and nothing for the impulse."""
        M, _ = self.dynamics(theta, speed)
        self.locked = True
        one = np.ones(2)
        return one * (one @ M @ speed) / (one @ M @ one), 0.0

    def dynamics(self, theta: Array, speed: Array) -> tuple[Array, Array]:
        """Return M and the accelerations, which are equal after the lock."""
        M, a = super().dynamics(theta, speed)
        if self.locked:
            one = np.ones(2)
            a = one * (one @ M @ a) / (one @ M @ one)
        return M, a
