"""Series and panels that several reports draw."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ancfdae.plotting import Panel, Series


def dots(label: str, x: npt.ArrayLike, y: npt.ArrayLike) -> Series:
    """Return a series of marks without a line."""
    return Series(label, x, y, line=False, marker=True)


def log_log(title: str, x_label: str, y_label: str, series: Sequence[Series]) -> Panel:
    """Return a panel with logarithmic axes."""
    return Panel(title, x_label, y_label, series, x_scale="log", y_scale="log")


def error_over_work(
    title: str, errors: Mapping[str, Sequence[tuple[float, float]]], what: str
) -> Panel:
    """Return error over processor time from pairs (seconds, error), one series for each name."""
    lines = [(name, np.array(pairs)) for name, pairs in errors.items() if pairs]
    series = [Series(name, line[:, 0], line[:, 1], marker=True) for name, line in lines]
    return log_log(title, "processor time [s]", what, series)
