"""Solutions as tables of pandas, which is imported when one is asked for."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ancfdae.errors import InvalidInput, require_array, require_kind, require_package
from ancfdae.numerics.arrays import Array


def pandas() -> Any:
    """Return the package, or raise MissingPackage, which says how to install it."""
    return require_package("to_dataframe", "pandas", "pandas")


def states_table(
    t: Array,
    q: Array,
    q_b: Array | None,
    names: list[str],
    variables: tuple[str, ...],
    more: object,
) -> Any:
    """Return coordinates, their derivatives and further columns over time."""
    table = dict(zip(names, q.T, strict=True))
    if q_b is not None:
        for i, variable in enumerate(variables):
            derivative_names = (f"d {name}/d {variable}" for name in names)
            table |= dict(zip(derivative_names, q_b[..., i].T, strict=True))
    more = {} if more is None else more
    require_kind("to_dataframe, columns", more, (Mapping,), "For example {'tip [m]': values}.")
    assert isinstance(more, Mapping)
    for name, values in more.items():
        column = require_array(f"to_dataframe, column {name!r}", values, t.shape)
        if name in table:
            rule, repair = "must have a name of its own", "Rename it."
            raise InvalidInput("to_dataframe, columns", rule, repr(name), repair)
        table[name] = column
    pd = pandas()
    return pd.DataFrame(table, index=pd.Index(t, name="t"))


def sensitivity_table(q_b: Array, names: tuple[str, ...]) -> Any:
    """Return derivatives of all coordinates at all instants, a column for each variable."""
    pd, (n_t, n_q, n_b) = pandas(), q_b.shape
    rows = pd.MultiIndex.from_product(
        [np.arange(n_t), np.arange(n_q)], names=["instant", "coordinate"]
    )
    return pd.DataFrame(q_b.reshape(n_t * n_q, n_b), index=rows, columns=list(names))
