"""Discretisation error of an objective and its gradient, from runs that are refined.

For HHT-I3, of order two, runs at h, h/2 (and h/4) differ by d_1 = x(h/2) - x(h) and
d_2 = x(h/4) - x(h/2). With the order p observed in d_1/d_2 = 2^p, or p = 2 assumed, the
finest run errs by d/(2^p - 1), and adding that at p = 2 is Richardson's extrapolation. The bar
multiplies it by the safety factor of Roache's grid convergence index (J. Fluids Eng. 116, 1994): 3
where the order is assumed, 1.25 where it is observed. An observed order is limited to 1/2 to 2,
so that runs that do not converge yet get wide bars, and d_2 is taken as d_1/4 at least.

Where runs say that their steps do not resolve the waves of the derivatives, differences have no
order, and the bar is a multiple of them (`tolerance.bars.unresolved`).

SUNDIALS and SciPy choose their steps themselves. The refined run has a tenth of the tolerance, the
bar is the whole difference, and no value is extrapolated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors import InvalidInput
from ancfdae.errors.text import columns
from ancfdae.integrators import Integrator
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.direct import Direct
from ancfdae.sensitivity.method import Gradient, GradientMethod
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import differentiable, gradient
from ancfdae.studies.tolerance.bars import unresolved

_GRANTED, _SEEN = 3.0, 1.25
_LOWEST, _ORDER = 0.5, 2.0
# Where the estimated errors of derivatives fall at this order or more, all measured bars held. It
# is 1.996 to 2.03 where steps resolve all waves, 1.9 at most where bars failed
# (docs/reports/error-bars).
_RESOLVED = 1.95


@final
@dataclass(frozen=True)
class ErrorBars:
    """An objective and its gradient with estimates of their discretisation error.

    Attributes
    ----------
    names : tuple of str
        Names of the design variables.
    value : float
    gradient : array, shape (n_b,)
        Of the finest run.
    value_bar : float
    gradient_bar : array, shape (n_b,)
        Estimated bounds of their errors; not proofs: docs/reports/error-bars says how often
        they hold.
    extrapolated_value : float
    extrapolated_gradient : array, shape (n_b,)
        Better values by one order, where runs converge; those of the finest run if the
        integrator has no fixed order.
    orders : array, shape (1 + n_b,)
        Observed orders of the value and the gradient; nan where they cannot be observed.
    runs : tuple of Gradient
        From the coarsest to the finest.
    resolved : bool or None
        Whether the steps resolve the waves of the derivatives: whether their estimated errors
        (`Solution.estimated_errors`) fall at the order of the integrator from the last run but
        one. Where they do not, bars are three to five times what runs differ by. None without such
        an estimate, which only `Direct` with `HHT` provides.
    """

    names: tuple[str, ...]
    value: float
    gradient: Array
    value_bar: float
    gradient_bar: Array
    extrapolated_value: float
    extrapolated_gradient: Array
    orders: Array
    runs: tuple[Gradient, ...]
    resolved: bool | None

    def __repr__(self) -> str:
        """Return value and derivatives with their bars, and how the finest run ended."""
        numbers = zip(
            ("objective", *self.names),
            (self.value, *self.gradient),
            (self.value_bar, *self.gradient_bar),
            (self.extrapolated_value, *self.extrapolated_gradient),
            self.orders,
            strict=True,
        )
        rows = [("", "value", "bar", "extrapolated", "order")]
        for name, x, bar, better, order in numbers:
            seen = "-" if np.isnan(order) else f"{order:.2g}"
            rows.append((name, f"{x:.9g}", f"{bar:.2g}", f"{better:.9g}", seen))
        known = {
            True: "yes",
            False: "no, bars are multiples of what runs differ by",
            None: "not known",
        }
        finest = self.runs[-1].solution.outcome
        end = f"waves resolved: {known[self.resolved]}\nfinest run: {finest}"
        return f"{columns(rows)}\n{end}"


def error_bars(
    model: Scene | MechanicalSystem,
    objective: Objective,
    t_end: float,
    integrator: Integrator,
    *,
    design: Sequence[str | DesignVariable] | None = None,
    method: GradientMethod | None = None,
    levels: int = 2,
    progress: bool = False,
) -> ErrorBars:
    """Estimate the discretisation error of an objective and its gradient.

    Parameters
    ----------
    model, objective, t_end, integrator, design, progress
        As in `gradient`; the integrator is that of the coarsest run.
    method : GradientMethod
        As in `gradient`, but `Direct` by default.
    levels : int
        With `HHT`, two levels cost three times the first run, three levels seven times; three also
        show whether the order is reached.

    Raises
    ------
    InvalidInput, UnfinishedRun, NonFiniteObjective
        As `gradient`.
    """
    if not any(levels is count for count in (2, 3)):
        raise InvalidInput("levels", "must be 2 or 3", repr(levels), "2 is cheaper, 3 is safer.")
    method = Direct() if method is None else method
    system = differentiable(model, design)
    run = partial(gradient, system, objective, t_end, method=method)
    settings, runs = integrator, [run(integrator, progress=progress)]
    while len(runs) < levels:
        settings = settings.refined(runs[-1].solution)
        runs.append(run(settings, progress=progress))
    x = np.array([[run.value, *run.gradient] for run in runs])
    differences, resolved = np.diff(x, axis=0), _resolved(*runs[-2:])
    bars, orders = _bars(differences, integrator.order)
    if resolved is False:
        scale = np.where(system.b == 0, 1.0, np.abs(system.b))
        slopes = unresolved(differences[:, 1:] * scale) / scale
        bars = np.append(unresolved(differences[:, :1]), slopes)
    gain = 0.0 if integrator.order is None else 1 / (2.0**integrator.order - 1)
    better = x[-1] + gain * (x[-1] - x[-2])
    return ErrorBars(
        names=runs[-1].names,
        value=runs[-1].value,
        gradient=runs[-1].gradient,
        value_bar=float(bars[0]),
        gradient_bar=bars[1:],
        extrapolated_value=float(better[0]),
        extrapolated_gradient=better[1:],
        orders=orders,
        runs=tuple(runs),
        resolved=resolved,
    )


def _resolved(coarse: Gradient, fine: Gradient) -> bool | None:
    errors = [run.solution.estimated_errors for run in (coarse, fine)]
    before, after = (None if x is None else x.derivatives for x in errors)
    if before is None or after is None:
        return None
    # A variable without influence has the error nan, which passes; an infinite one does not.
    return not any(
        y > x / 2.0**_RESOLVED or math.inf in (x, y) for x, y in zip(before, after, strict=True)
    )


def _bars(differences: Array, order: int | None) -> tuple[Array, Array]:
    """Bars of the finest run and the orders seen (module description)."""
    size = np.abs(differences)
    unknown = np.full(size.shape[1], np.nan)
    if order is None:
        return size[-1], unknown
    if len(size) == 1:
        return _GRANTED * size[-1] / (2.0**order - 1), unknown
    with np.errstate(divide="ignore", invalid="ignore"):
        orders = np.log2(size[0] / size[1])
    # Two differences of zero: nothing changes, and the bar is zero at any order.
    p = np.clip(np.nan_to_num(orders, nan=_ORDER), _LOWEST, _ORDER)
    # The last difference may be small by chance, where the error changes its sign.
    return _SEEN * np.maximum(size[1], size[0] / 2.0**order) / (2.0**p - 1), orders
