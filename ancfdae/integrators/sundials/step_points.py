"""Points between the steps of SUNDIALS, for integrals beside the motion.

Within a step of length h, from its ends and with s = (t - t_n) / h,

    q = q_n + H (q_n+1 - q_n) + h (G_0 v_n + G_1 v_n+1) + h^2 (F_0 a_n + F_1 a_n+1),
    v = dq/dt,

the quintic polynomials that take q, v and a at both ends: of order six, above that of the solver
(five). Asking the solver for states within every step would cost as much as its steps.
"""

from collections.abc import Iterator
from typing import final

import numpy as np

from ancfdae.integrators.integrand import Points
from ancfdae.integrators.quadrature import KRONROD, SHARES, Quadrature, Trajectory
from ancfdae.integrators.sundials.index_reduced import IndexReduced
from ancfdae.numerics.arrays import Array

# Coefficients of H, G_0, G_1, F_0 and F_1 of s^0 to s^5.
_QUINTIC = np.array(
    [
        [0, 0, 0, 10, -15, 6],
        [0, 1, 0, -6, 8, -3],
        [0, 0, 0, -4, 7, -3],
        [0, 0, 0.5, -1.5, 1.5, -0.5],
        [0, 0, 0, 0.5, -1, 0.5],
    ]
)
_QUINTIC_SLOPE = _QUINTIC[:, 1:] * np.arange(1, 6)
# Panels per step: where high-frequency modes limit the step and the integrand is smooth, one panel
# over many steps is enough. One panel in every step sees none of the kinks between the quintics.
_PANELS_PER_STEP = (1 / 8, 1, 4, 8)
# Steps that are taken in together, and numbers that their points may take.
_STEPS, _NUMBERS = 128, 5_000_000


@final
class StepPoints:
    """Collects steps, with m sensitivities, and hands their points to the integrals."""

    def __init__(self, form: IndexReduced, quadrature: Quadrature, m: int) -> None:
        self._form, self._quadrature, self._m = form, quadrature, m
        per_step = 4 * form.n * (m + 1) * len(SHARES) * _PANELS_PER_STEP[-1]
        self._most = int(np.clip(_NUMBERS / per_step, 1, _STEPS))
        self._t: list[float] = []
        self._y: list[Array] = []
        self._yp: list[Array] = []

    @property
    def wanted(self) -> bool:
        """Whether steps are to be added."""
        return self._quadrature.wanted

    def add(self, t: float, y: Array, yp: Array) -> None:
        """Take in a step, or the start; the arrays, shape ((m + 1) n,), are kept."""
        self._t.append(t)
        self._y.append(y)
        self._yp.append(yp)
        if len(self._t) > self._most:
            self.finish()

    def finish(self) -> None:
        """Hand over what was collected; its end is the next start."""
        if len(self._t) > 1:
            t, y, yp = np.array(self._t), self._unscaled(self._y), self._unscaled(self._yp)
            y[0][:, 0] += self._form.place
            steps = self._motion(t, *y)._replace(a=yp[1][:, 0])
            self._quadrature.add(self._choices(t, y, yp[1]), steps)
        for kept in (self._t, self._y, self._yp):
            del kept[:-1]

    def _choices(self, t: Array, y: tuple[Array, Array], a: Array) -> Iterator[Points]:
        q, v = y
        data = (np.diff(q, axis=0), v[:-1], v[1:], a[:-1], a[1:])
        for density in _PANELS_PER_STEP:
            ends = _panels(t, density)
            h = np.diff(ends)
            times = ends[:-1, None] + np.outer(h, SHARES)
            times[:, -1] = ends[1:]
            step = np.clip(np.searchsorted(t, times.ravel(), side="right") - 1, 0, len(t) - 2)
            within = _between(times.ravel(), t, step, q, data)
            yield Points(KRONROD, h, *self._motion(times.ravel(), *within))

    def _unscaled(self, rows: list[Array]) -> tuple[Array, Array]:
        """Return q - p and v, or their rates, and sensitivities, shape (steps, m + 1, n_q)."""
        return self._form.unscaled(np.array(rows).reshape(len(rows), self._m + 1, -1))

    def _motion(self, t: Array, q: Array, v: Array) -> Trajectory:
        derivatives = (self._form.per_design(x[:, 1:]) for x in ((q, v) if self._m else ()))
        return Trajectory(t, q[:, 0], v[:, 0], *derivatives)


def _panels(t: Array, per_step: float) -> Array:
    """Return ends of panels of several steps, or of parts of steps."""
    if per_step < 1:
        return np.append(t[: -1 : round(1 / per_step)], t[-1])
    share = np.arange(round(per_step)) / per_step
    return np.append((t[:-1, None] + np.outer(np.diff(t), share)).ravel(), t[-1])


def _between(
    times: Array, t: Array, step: Array, q: Array, data: tuple[Array, ...]
) -> tuple[Array, Array]:
    """Return coordinates and velocities at times within steps, by quintics."""
    h = np.diff(t)[step]
    powers = ((times - t[step]) / h)[:, None] ** np.arange(6)
    units = np.stack([np.ones_like(h), h, h, h**2, h**2])
    values, slopes = _QUINTIC @ powers.T * units, _QUINTIC_SLOPE @ powers[:, :5].T * units / h
    x, xp = q[step], np.zeros((len(times), *q.shape[1:]))
    for array, value, slope in zip(data, values, slopes, strict=True):
        taken = array[step]
        x += value[:, None, None] * taken
        xp += slope[:, None, None] * taken
    return x, xp
