"""What all cases tabulate: convergence with the mesh, and derivatives found in two ways."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ancfdae import (
    Adjoint,
    DesignVariable,
    DirectDifferentiation,
    Scene,
    assemble,
    equilibrium_gradient,
)
from ancfdae.extend import Observable
from ancfdae.numerics.arrays import Array
from validation.report import Report

# Errors below this have no order: they are those of the reference.
_FLOOR: Final = 1e-9


def relative(computed: npt.ArrayLike, exact: npt.ArrayLike) -> Array:
    """Return |found - exact| / |exact|."""
    e = np.asarray(exact, dtype=float)
    return np.abs(np.asarray(computed, dtype=float) - e) / np.abs(e)


def convergence(
    report: Report,
    key: str,
    names: Sequence[str],
    counts: Sequence[int],
    values: npt.ArrayLike,
    exact: npt.ArrayLike,
) -> Array:
    """Add the table of values by number of elements, errors and observed orders.

    The key is the first word of the figures. There are k rising numbers of elements, m names of
    quantities, values of shape (k, m) and exact values of shape (m,). Return relative errors, shape
    (k, m).
    """
    computed, e = np.asarray(values, dtype=float), np.asarray(exact, dtype=float)
    errors = relative(computed, e)
    orders = _orders(counts, errors)
    rows: list[list[object]] = []
    for i, count in enumerate(counts):
        row: list[object] = [count]
        for j in range(len(names)):
            order = "" if not i or np.isnan(orders[i - 1, j]) else f"{orders[i - 1, j]:.2f}"
            row += [f"{computed[i, j]:.9g}", f"{errors[i, j]:.1e}", order]
            report.figure(f"{key}.{_word(names[j])}.n{count}.error", errors[i, j])
        rows.append(row)
    rows.append(["reference", *[x for value in e for x in (f"{value:.9g}", "", "")]])
    header = ["elements", *[x for name in names for x in (name, "error", "order")]]
    report.table(header, rows)
    return errors


def derivative_table(
    report: Report, key: str, rows: Sequence[tuple[str, str, float, float]], ways: tuple[str, str]
) -> float:
    """Add derivatives found in two ways; return the largest relative difference.

    A row names the quantity and the parameter and holds the derivative in both ways, which `ways`
    names; the key is the first word of the figure.
    """
    apart = [float(relative(computed, exact)) for _, _, computed, exact in rows]
    report.table(
        ["derivative of", "in", *ways, "apart"],
        [
            [what, of, f"{computed:.7g}", f"{exact:.7g}", f"{x:.1e}"]
            for (what, of, computed, exact), x in zip(rows, apart, strict=True)
        ],
    )
    return report.figure(f"{key}.derivatives.apart", max(apart))


def logarithmic(
    name: str, symbols: Iterable[str], computed: Array, exact: Array
) -> list[tuple[str, str, float, float]]:
    """Return rows of d ln(quantity)/d ln(parameter), one for each symbol of a parameter."""
    pairs = zip(symbols, computed.tolist(), exact.tolist(), strict=True)
    return [(f"ln {name}", f"ln {symbol}", *values) for symbol, *values in pairs]


def compared_at_rest(
    report: Report,
    key: str,
    scene: Scene,
    quantities: Mapping[str, tuple[Observable, Array]],
    design: Mapping[str, str | DesignVariable],
    ways: tuple[str, str],
) -> float:
    """Add d ln(quantity)/d ln(parameter) of a scene at rest; return the largest difference.

    Quantities have, by name, an observable and its exact derivatives, one for each design variable.
    The design variables have symbols; none may be zero. Key and ways are as for `derivative_table`.
    """
    system, rows, off = assemble(scene, list(design.values())), [], 0.0
    for name, (observable, exact) in quantities.items():
        direct, adjoint = (
            equilibrium_gradient(system, observable, method=method)
            for method in (DirectDifferentiation(), Adjoint())
        )
        off = max(off, float(np.max(relative(adjoint.gradient, direct.gradient))))
        computed = direct.gradient * system.b.real / direct.value
        rows += logarithmic(name, design, computed, exact)
    worst = derivative_table(report, key, rows, ways)
    report.say("adjoint", off=off)
    return worst


def _orders(counts: Sequence[int], errors: Array) -> Array:
    """Return the observed order between neighbouring meshes, NaN at the floor."""
    above = (errors[1:] > _FLOOR) & (errors[:-1] > _FLOOR)
    ratio = np.log(np.divide(counts[1:], counts[:-1]))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        orders: Any = np.log(errors[:-1] / errors[1:]) / ratio
    return np.where(above, orders, np.nan)


def _word(name: str) -> str:
    return "-".join("".join(c if c.isascii() and c.isalnum() else " " for c in name).split())
