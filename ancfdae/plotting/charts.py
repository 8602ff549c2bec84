"""Line plots for reports: styles of labels, and panels that are drawn and saved.

A plot is declared as data (`Series` in `Panel`), drawn by `draw` and written by `save`. Neither
uses pyplot, so no figure stays open and no backend is chosen for the rest of the process.

A label has one style in the whole figure: series with the same label share colour, line and marker
in every panel and one entry in the legend, which is below the panels and thus never covers data.
Methods have the same style in all figures (`looks`). Later series are drawn thinner and over
earlier ones, so that two curves that coincide show both of their colours; series of points without
lines are drawn over all lines, later ones smaller. Symbols in labels, such as ``rho_1`` and
``2^-7``, are set as mathematics.
"""

import math
import os
import re
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, Literal, final

import matplotlib.style
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from ancfdae.equations.files import replacing, saving
from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import InvalidInputError

__all__ = ["Figure", "Panel", "Scale", "Series", "draw", "save"]

# Okabe and Ito (2008), without the yellow: it is too faint for a line on white.
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#000000", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h")
_DASHES: Final = (None, (5.0, 2.0), (1.2, 1.0), (5.0, 2.5, 1.2, 2.5))


@final
@dataclass(frozen=True)
class Look:
    """Style of a label: colour, marker, dashes (None for a solid line), filled marker or not."""

    colour: str
    marker: str
    dashes: tuple[float, ...] | None
    filled: bool = False


def _look(place: int, dashes: int = 0) -> Look:
    marker = _MARKERS[place % len(_MARKERS)]
    return Look(COLOURS[place % len(COLOURS)], marker, _DASHES[dashes % len(_DASHES)])


# Styles of methods, by the start of a label; the longest matching start counts.
_METHODS: Final[dict[str, Look]] = {
    "HHT": _look(0),
    "HHT controlled": _look(6),
    "HHT, controlled": _look(6),
    "HHT both controlled": _look(2),
    "IDA": _look(1),
    "IDAS": _look(4),
    "DOP853": _look(3),
    "Radau": _look(5),
    "direct differentiation": _look(0),
    "forward difference": _look(1, 1),
    "central difference": _look(5, 2),
    "discrete adjoint": _look(3),
    "continuous adjoint": _look(2),
}
# Markers of second labels of these methods, which are filled and dashed; small markers look filled
# anyway.
_PARTNERS: Final = dict(zip(_MARKERS[:7], (">", "p", "h", "*", "d", "8", "<"), strict=True))
# Ends of labels of a second variant of the same method.
_SECOND: Final = ("alpha = -0.05", "index 1", ", 3 levels", ", adjoint")


def looks(labels: Iterable[str]) -> dict[str, Look]:
    """Return the style of each label of a figure: that of its method, or the next free one."""
    given: dict[str, Look] = {}
    for label in dict.fromkeys(labels):
        known = max((name for name in _METHODS if label.startswith(name)), key=len, default="")
        look = _METHODS[known] if known else _free(given)
        if known and label.endswith(_SECOND):
            look = replace(look, dashes=_DASHES[1], filled=True, marker=_PARTNERS[look.marker])
        if look in given.values():
            look = _free(given)
        given[label] = look
    return given


def _free(given: dict[str, Look]) -> Look:
    """Return a style in a free colour, or in the next colour in turn if all are taken."""
    taken = {look.colour for look in given.values()}
    places = (k for k, colour in enumerate(COLOURS) if colour not in taken)
    place = next(places, len(given))
    return _look(place, place)


_SYMBOL: Final = (
    "hht_alpha|alpha|beta|gamma|delta|eps|epsilon|zeta|eta|theta|kappa|lambda|mu|nu|xi|rho|sigma|"
    "tau|phi|psi|omega|Phi|Psi|Omega"
)
# Symbols with another name in matplotlib.
_OTHERS: Final = {"eps": "varepsilon", "hht_alpha": "alpha"}
# Matches 1e-7; 2^-7; a Greek symbol, or a letter with an index, maybe after the d of a derivative.
_MATHEMATICS: Final = re.compile(
    r"(?<![\w.$\\])(?:"
    r"(?P<digits>\d+(?:\.\d+)?)e(?P<exponent>[+-]?\d+)"
    r"|(?P<base>\d+)\^(?P<power>-?\d+)"
    rf"|(?P<d>d?)(?P<symbol>{_SYMBOL})(?:_(?P<index>\w+))?"
    r"|(?P<d_letter>d?)(?P<letter>[A-Za-z])_(?P<letter_index>\d+|[a-z])"
    r")(?![A-Za-z0-9_])"
)


def set_as_mathematics(text: str) -> str:
    """Return a label with its symbols, powers and exponents in matplotlib's mathematics.

    A text with a dollar sign is returned unchanged.
    """
    return text if "$" in text else _MATHEMATICS.sub(_one, text)


def _one(match: re.Match[str]) -> str:
    parts = match.groupdict()
    if parts["digits"]:
        times = "" if parts["digits"] == "1" else rf"{parts['digits']}\times "
        return rf"${times}10^{{{int(parts['exponent'])}}}$"
    if parts["base"]:
        return rf"${parts['base']}^{{{parts['power']}}}$"
    if parts["letter"]:
        return rf"${parts['d_letter']}{parts['letter']}_{{{parts['letter_index']}}}$"
    index = f"_{{{parts['index']}}}" if parts["index"] else ""
    symbol = _OTHERS.get(parts["symbol"], parts["symbol"])
    return rf"${parts['d']}\{symbol}{index}$"


Scale = Literal["linear", "log"]

_PANEL_SIZE: Final = (6.4, 4.0)  # inches
# Size in inches of panels in three and more columns, which are shown smaller, with larger letters.
_NARROW_SIZE: Final = (4.3, 3.5)
_LARGER: Final = 1.2
_LEGEND_CHARACTER: Final = 0.085  # inches, above the mean at the legend's font size
_LEGEND_HANDLE: Final = 0.75  # inches: line sample and gaps beside each label
_LEGEND_ROW: Final = 0.25  # inches
_MARKERS_ON_LINE: Final = 15
# A quantity, alone or with its unit in brackets.
_LABEL: Final = re.compile(r"[^\[\]]*[^\[\]\s][^\[\]]*(\[[^\[\]]+\])?")
_SETTINGS: Final[dict[str, object]] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "lines.markersize": 5.5,
    "svg.hashsalt": "ancfdae",
}


# Metadata of files by suffix, without dates, so that files do not change from run to run.
_METADATA: Final[dict[str, dict[str, str | None]]] = {
    ".svg": {"Date": None, "Creator": "ancfdae"},
    ".png": {"Software": "ancfdae"},
}
_SIZES: Final = {"font.size": 11.0, "axes.titlesize": 12.0, "legend.fontsize": 10.0}


@dataclass(frozen=True, eq=False)
class Series:
    """One curve or set of points of a panel.

    Raises InvalidInputError if no point is finite, or if the label is not visible in a legend.

    Parameters
    ----------
    label : str
        Name in the legend.
    x, y : array_like, shape (n,)
        A pair with a value that is not finite leaves a gap.
    line, marker : bool
        Whether the points are connected, and marked: at most about 15 of them where there is a
        line, all of them otherwise.
    dashed : bool or None
        Force a dashed (True) or solid (False) line; None chooses by the place of the label in the
        figure.
    """

    label: str
    x: npt.ArrayLike
    y: npt.ArrayLike
    line: bool = True
    marker: bool = False
    dashed: bool | None = None

    def __post_init__(self) -> None:
        if not self.label.strip() or self.label.startswith("_"):
            rule, repair = "must be visible in the legend", "Let it not start with an underscore."
            raise InvalidInputError("Series.label", rule, repr(self.label), repair)
        where = f"Series {self.label!r}"
        if not (self.line or self.marker):
            repair = "Set line=True or marker=True."
            raise InvalidInputError(where, "must have a line or markers", "neither", repair)
        if not np.isfinite(self.points()).all(axis=0).any():
            raise InvalidInputError(
                where, "at least one point must be finite", "none", "Leave the series out."
            )

    def points(self) -> npt.NDArray[np.float64]:
        """Return the coordinates as an array of shape (2, n), rows x and y."""
        x, y = np.asarray(self.x), np.asarray(self.y)
        if x.ndim != 1 or x.shape != y.shape or np.iscomplexobj(x) or np.iscomplexobj(y):
            raise InvalidInputError(
                f"Series {self.label!r}",
                "x and y must be real vectors of equal length",
                f"shapes {x.shape} and {y.shape}, types {x.dtype} and {y.dtype}",
                "Pass one real y for each real x.",
            )
        return np.array([x, y], dtype=np.float64)


@dataclass(frozen=True)
class Panel:
    """One pair of axes with its series.

    Raises InvalidInputError if a series has no visible point.

    Parameters
    ----------
    title : str
    x_label, y_label : str
        Quantity and unit, for example ``"t [s]"``; without a unit the name alone, ``"relative
        error"``.
    series : sequence of Series
        At least one, with distinct labels.
    x_scale, y_scale : {"linear", "log"}
        On a logarithmic axis points that are not positive leave gaps.
    """

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    x_scale: Scale = "linear"
    y_scale: Scale = "linear"

    def __post_init__(self) -> None:
        if not self.title.strip():
            raise InvalidInputError(
                "Panel.title", "must not be empty", repr(self.title), "Say what it shows."
            )
        where = f"Panel {self.title!r}"
        for label in (self.x_label, self.y_label):
            require_label(where, label)
        for scale in (self.x_scale, self.y_scale):
            if scale not in ("linear", "log"):
                raise InvalidInputError(where, "a scale must be 'linear' or 'log'", repr(scale))
        labels = [series.label for series in self.series]
        if not labels or len(set(labels)) < len(labels):
            raise InvalidInputError(
                where,
                "must have at least one series, each label once",
                labels,
                "Leave an empty panel out; rename a repeated label.",
            )
        for series in self.series:
            self._require_visible(series)

    def _require_visible(self, series: Series) -> None:
        x, y = series.points()
        visible = np.isfinite(x) & np.isfinite(y)
        visible &= (x > 0) | (self.x_scale == "linear")
        visible &= (y > 0) | (self.y_scale == "linear")
        if not visible.any():
            raise InvalidInputError(
                f"Panel {self.title!r}, series {series.label!r}",
                "at least one point must be positive on every logarithmic axis",
                "none",
                "Use a linear scale or leave the series out.",
            )


def draw(panels: Sequence[Panel], columns: int = 1, title: str = "") -> Figure:
    """Draw panels row by row, `columns` per row, into one figure with one legend below.

    Raises InvalidInputError without panels, and for a label with different styles in two panels.
    """
    if not panels or columns < 1:
        raise InvalidInputError(
            "draw",
            "there must be at least one panel and one column",
            f"{len(panels)} panels, {columns} columns",
            "Pass a panel; leave columns out to stack the panels.",
        )
    _check_looks(panels)
    styles = looks(series.label for panel in panels for series in panel.series)
    columns = min(columns, len(panels))
    rows = math.ceil(len(panels) / columns)
    many = columns > 2
    width, height = _NARROW_SIZE if many else _PANEL_SIZE
    width, height = width * columns, height * rows
    with settings(_LARGER if many else 1.0):
        figure = Figure(figsize=(width, height), dpi=120, layout="constrained")
        entries: dict[str, Line2D] = {}
        for number, panel in enumerate(panels, start=1):
            axes = figure.add_subplot(rows, columns, number)
            _draw_panel(axes, panel, styles, entries)
            if panel.x_scale == "log":
                # A power of ten is 0.5 inches wide; axes are an inch narrower than their panel.
                count = int((width / columns - 1.0) / 0.65)
                axes.xaxis.set_major_locator(LogLocator(numticks=count))
        _add_legend(figure, {label: entries[label] for label in styles})
        if title:
            figure.suptitle(set_as_mathematics(title))
    return figure


def save(figure: Figure, path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Write a figure to ``motion.png`` or ``motion.svg``, or to both if the name has no suffix.

    The same figure gives the same bytes: an SVG has no date and no random identifiers. Missing
    folders are created. Raises SaveError if the file cannot be written, for example on a full disk;
    existing files are then kept.

    Returns
    -------
    tuple of Path
        The files that were written; of two the SVG first.
    """
    require_kind("save, path", path, (str, os.PathLike), "Give the name of a file.")
    path = Path(path)
    if not path.name:
        raise InvalidInputError(
            "save, path", "must name a file", repr(str(path)), "For example 'figures/motion.png'."
        )
    with saving("folder", path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix in _METADATA:
        files: tuple[Path, ...] = (path,)
    else:
        files = tuple(path.with_name(path.name + suffix) for suffix in _METADATA)
    layout = figure.get_layout_engine()
    with settings():
        # Laid out once for both: it takes as long as drawing.
        if layout is not None:
            layout.execute(figure)
        figure.set_layout_engine(None)
        for file in files:
            with replacing("figure", file) as written:
                figure.savefig(written, format=file.suffix[1:], metadata=_METADATA[file.suffix])
    figure.set_layout_engine(layout)
    return files


def require_label(where: str, label: object) -> None:
    """Raise InvalidInputError unless a label of an axis names a quantity, and then its unit."""
    if not isinstance(label, str) or not _LABEL.fullmatch(label):
        raise InvalidInputError(
            where,
            "an axis label must name a quantity and end with its unit in brackets if it has one",
            repr(label),
            "Write 't [s]', or 'relative error' for a number without unit.",
        )


def settings(larger: float = 1.0) -> AbstractContextManager[None]:
    """Shield a figure from the user's matplotlibrc, and the user's settings from the figure."""
    sizes = {name: larger * size for name, size in _SIZES.items()}
    return matplotlib.style.context(["default", _SETTINGS | sizes])


def _check_looks(panels: Sequence[Panel]) -> None:
    """Raise InvalidInputError for a label with different styles in two panels."""
    asked: dict[str, tuple[bool, bool, bool | None]] = {}
    for panel in panels:
        for series in panel.series:
            look = (series.line, series.marker, series.dashed)
            if asked.setdefault(series.label, look) != look:
                raise InvalidInputError(
                    f"draw, series {series.label!r}",
                    "(line, marker, dashed) must be the same in every panel",
                    f"{asked[series.label]} and {look}",
                    "Make them alike or use another label.",
                )


def _add_legend(figure: Figure, entries: dict[str, Line2D]) -> None:
    """Put the legend below all panels, in as many columns as fit, and enlarge the figure."""
    width, height = figure.get_size_inches()
    entry_width = _LEGEND_HANDLE + _LEGEND_CHARACTER * max(len(label) for label in entries)
    columns = max(1, min(len(entries), int(width / entry_width)))
    figure.set_size_inches(width, height + _LEGEND_ROW * math.ceil(len(entries) / columns))
    labels = [set_as_mathematics(label) for label in entries]
    figure.legend(list(entries.values()), labels, loc="outside lower center", ncols=columns)


def _draw_panel(
    axes: Axes, panel: Panel, styles: dict[str, Look], entries: dict[str, Line2D]
) -> None:
    """Draw one panel; store in `entries` the first line of each label for the legend."""
    texts = {"title": panel.title, "xlabel": panel.x_label, "ylabel": panel.y_label}
    axes.set(**{name: set_as_mathematics(text) for name, text in texts.items()})
    # A logarithmic axis omits values that are not positive, instead of moving them.
    if panel.x_scale == "log":
        axes.set_xscale("log", nonpositive="mask")
        axes.xaxis.set_minor_formatter(partial(_between_powers, axes.xaxis))
    if panel.y_scale == "log":
        axes.set_yscale("log", nonpositive="mask")
        axes.yaxis.set_minor_formatter(partial(_between_powers, axes.yaxis))
    places = {label: place for place, label in enumerate(styles)}
    for series in panel.series:
        line = _draw_series(axes, series, styles[series.label], places[series.label])
        entries.setdefault(series.label, line)
    alone = [series for series in panel.series if not series.line]
    for number, series in enumerate(alone):
        # Points lie over all lines, later series smaller, so that coincident points are visible.
        points = axes.lines[list(panel.series).index(series)]
        points.set(zorder=3.0 + 0.01 * number, markersize=max(4.5, 10.0 - 4.0 * number))
        points.set_markeredgewidth(1.5)
        if np.size(points.get_xdata()) == 1:
            points.set(markersize=max(7.0, 13.0 - 3.0 * number))


def _between_powers(axis: Axis, x: float, _: int | None = None) -> str:
    """Return the label of a tick between powers of ten; empty where labels would overlap."""
    low, high = axis.get_view_interval()
    exponent = math.floor(math.log10(x) + 1e-9)
    digit = round(x / 10.0**exponent)
    beside = isinstance(axis, XAxis) and high > 12 * low  # Labels side by side need more room.
    if high > 100 * low or digit not in ((3,) if beside else (2, 5)):
        return ""
    return rf"$\mathdefault{{{digit}\times10^{{{exponent}}}}}$"


def _draw_series(axes: Axes, series: Series, look: Look, place: int) -> Line2D:
    x, y = series.points()
    dashed = look.dashes is not None if series.dashed is None else series.dashed
    (line,) = axes.plot(
        x,
        y,
        color=look.colour,
        linewidth=max(1.2, 3.0 * 0.85**place),
        linestyle=(0.0, look.dashes or (5.0, 2.0)) if dashed else "solid",
        zorder=2.0 + 0.01 * place,
    )
    if not series.line:
        line.set_linestyle("none")
    if series.marker:
        every = max(1, x.size // _MARKERS_ON_LINE) if series.line else 1
        face = look.colour if look.filled else "white"
        line.set(marker=look.marker, markerfacecolor=face, markevery=every)
    return line
