"""Pictures of a mechanism at one or several times, and animations of its motion.

An animation may be one HTML file that contains data and viewer and loads no other file: positions
are stored as 16 bit integers over the extent of the animation, colours as 8 bit integers.
"""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, final

import numpy as np
import numpy.typing as npt
from matplotlib import animation
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ancfdae.equations import Solution
from ancfdae.equations.files import replacing, replacing_path, saving
from ancfdae.errors.checks import (
    require_count,
    require_kind,
    require_path,
    require_positive,
    require_text,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError, MissingPackageError
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.charts import settings
from ancfdae.plotting.mechanism import Mechanism, frames_of, mechanism
from ancfdae.plotting.painters import (
    CAMERA,
    EDGE,
    GROUND,
    JOINT,
    LOAD,
    Glyphs,
    Painter,
    canvas,
    colour_map,
)
from ancfdae.plotting.shapes import Field
from ancfdae.plotting.symbols import GROUND as GROUND_SIGN

_MARK = "/*DATA*/null"
# Shapes of the HTML viewer by marker; other markers are circles there.
_SHAPES = {"^": "ground", "s": "square", "d": "diamond", r"$\circlearrowleft$": "turn"}
# 8 bit shade of points without a value, and the largest shade of a value.
_NO_VALUE, _TOP = 255, 254


def write_page(
    shown: Mechanism, file: Path, seconds: float, title: str, camera: tuple[float, float] = CAMERA
) -> None:
    """Write the animation of a mechanism, of duration `seconds`, as one HTML file."""
    # No text in the data may contain the end tag of the script.
    data = json.dumps(page_data(shown, seconds, title, camera), allow_nan=False).replace(
        "</", "<\\/"
    )
    page = files("ancfdae.plotting").joinpath("viewer.html").read_text(encoding="utf-8")
    with replacing("page", file) as written:
        written.write(page.replace(_MARK, data).encode("utf-8"))


def page_data(
    shown: Mechanism, seconds: float, title: str, camera: tuple[float, float] = CAMERA
) -> dict[str, Any]:
    """Return the data of an animation that the script of the HTML page reads, for JSON."""
    low, high = (_spatial(x) for x in shown.bounds)
    span, faces = high - low, shown.faces
    x = _spatial(np.concatenate([*shown.places], axis=1))
    scale = np.where(span, span, 1.0)
    signs, items = _signs(shown)
    return {
        "d": shown.d,
        "title": title,
        "seconds": seconds,
        "camera": camera,
        "t": shown.motion.t.tolist(),
        "low": low.tolist(),
        "span": span.tolist(),
        "points": x.shape[1],
        "places": _packed(np.round(65535 * (x - low) / scale), np.uint16),
        # Triangles in the order of the bodies: in the plane later bodies cover earlier ones.
        "triangles": _packed(faces[:, [0, 1, 2, 0, 2, 3]], np.uint32),
        "shades": _packed(_shades(shown), np.uint8),
        "map": _packed(255 * colour_map(shown)(np.linspace(0, 1, 256)), np.uint8),
        "label": "" if shown.field is None else shown.field.label,
        "limits": shown.limits,
        "signs": _packed(_spatial(signs), np.float32),
        "items": items,
        "legend": "; ".join(Glyphs(shown).labels.values()),
    }


def _packed(array: Array, kind: npt.DTypeLike) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def _spatial(x: Array) -> Array:
    return x if x.shape[-1] == 3 else np.concatenate([x, 0.0 * x[..., :1]], axis=-1)


def _shades(shown: Mechanism) -> Array:
    """Return the field as integers from 0 to 254, or 255 where it does not exist, (k, n)."""
    if shown.field is None:
        return np.full([len(shown.motion.t), sum(x.shape[1] for x in shown.places)], _NO_VALUE)
    values = np.concatenate(shown.values, axis=1)
    low, high = shown.limits
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.where(np.isfinite(values), np.round(_TOP * share), _NO_VALUE)


def _signs(shown: Mechanism) -> tuple[Array, list[dict[str, Any]]]:
    """Return the points of all symbols, (k, n, d), and style and number of points of each."""
    glyphs = Glyphs(shown)
    parts: list[Array] = []
    items: list[dict[str, Any]] = []

    def add(x: Array, **item: Any) -> None:
        parts.append(x)
        items.append({"count": x.shape[1], **item})

    every = range(len(shown.motion.t))
    for line in shown.lines:
        x = np.stack([glyphs.line(line, k) for k in every])
        dashes = {"dash": [10, 3, 2, 3]} if line.kind == "way" else {}
        colour = {"way": GROUND, "spring": LOAD}.get(line.kind, EDGE)
        add(x, sign="line", colour=colour, width=1.5, **dashes)
    for mark in sorted(shown.marks, key=lambda mark: mark.sign is not GROUND_SIGN):
        shape = _SHAPES.get(mark.sign.marker, "circle")
        fill = JOINT if mark.sign.filled else "#ffffff"
        colour = GROUND if mark.sign is GROUND_SIGN else JOINT
        add(mark.places[:, None], sign="mark", shape=shape, colour=colour, fill=fill, width=1.5)
    for arrows in shown.arrows:
        if arrows.kind == "moment":
            x = np.stack([glyphs.arc(arrows, k) for k in every])
            add(x, sign="line", colour=LOAD, width=2)
            continue
        tips = arrows.places + glyphs.arrow(arrows)
        for i in range(tips.shape[1]):
            x = np.stack([arrows.places[:, i], tips[:, i]], axis=1)
            add(x, sign="arrow", colour=LOAD, width=2)
    none = np.zeros((len(shown.motion.t), 0, shown.d))
    return np.concatenate([none, *parts], axis=1), items


# -- pictures and films ------------------------------------------------------------------------


# Default number of times in a picture, and strength of the faintest.
_INSTANTS, _FAINT = 5, 0.22
# Style of the frame in which a notebook shows an HTML page.
_FRAME = "width: 100%; height: 32rem; border: 0"


def snapshots(
    scene: Scene,
    solution: Solution | None = None,
    times: Sequence[float] | None = None,
    colour: Field | None = None,
    title: str = "",
    limits: Sequence[float] | None = None,
    camera: Sequence[float] | None = None,
) -> Figure:
    """Draw a mechanism as declared, or at several times of a motion in one picture.

    Bodies are drawn with their sections, joints and loads with symbols that the legend explains,
    and forces as arrows of proportional length. Earlier times are fainter. The figure is for
    `save`.

    Parameters
    ----------
    scene : Scene
        At the design values of the solution: see `Scene.with_values`.
    solution : Solution, optional
        Without it the scene is drawn as declared, before any assembly: open joints are visible.
    times : sequence of float, optional
        Increasing times; s. By default five equally spaced ones, or the single one of an
        equilibrium.
    colour : Field, optional
        `StrainEnergyDensity()`, `VonMisesStress()`, `AxialForce()`, `BendingMoment()`, `Speed()` or
        `Sensitivity(variable)`. Bodies without the quantity are grey.
    limits : (float, float), optional
        Values of the first and the last colour; by default the least and the largest.
    camera : (float, float), optional
        Elevation above the plane x y and azimuth of the viewpoint in space; degrees. (0, -90) shows
        x to the right and z upwards, (90, -90) x and y.

    Raises
    ------
    InvalidInputError, UnknownNameError
        If the solution belongs to another scene, or lacks data for the colours.
    """
    require_text("snapshots, title", title)
    seen = _camera("snapshots", scene, camera)
    if isinstance(solution, Solution) and times is None and len(solution.t) > 1:
        times = frames_of(solution, _INSTANTS).tolist()
    shown = mechanism(scene, solution, times, colour, limits)
    with settings():
        figure, brush = canvas(shown, title, True, seen)
        for k in range(count := len(shown.motion.t)):
            brush.bodies(k, _FAINT + (1 - _FAINT) * ((k + 1) / count) ** 2)
        brush.symbols(count - 1)
        if count > 1:
            _label_instants(brush, shown)
        brush.settle(figure)
    return figure


@final
@dataclass(frozen=True)
class Film:
    """An animation that `animate` wrote; a notebook shows it as the result of a cell.

    Attributes
    ----------
    path : Path
        The file: ``.gif``, ``.mp4`` or ``.html``.
    """

    path: Path

    def __fspath__(self) -> str:
        """Return the path of the file, so that `open` and `Path` accept the object."""
        return str(self.path)

    def _repr_html_(self) -> str:
        """Return HTML with the animation embedded, so that the notebook needs no other file."""
        if self.path.suffix == ".html":
            text = html.escape(self.path.read_text(encoding="utf-8"))
            return f'<iframe srcdoc="{text}" style="{_FRAME}"></iframe>'
        data = base64.b64encode(self.path.read_bytes()).decode("ascii")
        if self.path.suffix == ".mp4":
            return f'<video controls src="data:video/mp4;base64,{data}"></video>'
        return f'<img src="data:image/gif;base64,{data}">'


def animate(
    scene: Scene,
    solution: Solution,
    path: str | os.PathLike[str],
    colour: Field | None = None,
    frames: int = 80,
    seconds: float = 4.0,
    title: str = "",
    dpi: int = 100,
    limits: Sequence[float] | None = None,
    camera: Sequence[float] | None = None,
    progress: bool = False,
) -> Film:
    """Write an animation of a motion as GIF, MP4 or interactive HTML page, by the path's suffix.

    A notebook shows the animation if the call is the last line of a cell.

    Parameters
    ----------
    scene, solution, colour, title, limits, camera
        As in `snapshots`; a page starts with this camera.
    path : str or path
        Ends with ``.gif``; with ``.mp4``, for which the program ffmpeg must be installed; or with
        ``.html``: a page that loads no other file and needs no network, with play, pause, a slider,
        and in space a view that can be rotated.
    frames, seconds : int, float
        Number of pictures, equally spaced over the motion, and duration of the animation; s.
    dpi, progress : int, bool
        For GIF and MP4: dots per inch (of a width of 7.5 inches), and whether to show a progress
        bar.

    Raises
    ------
    InvalidInputError, MissingPackageError
        As in `snapshots`, and for another suffix; for MP4 without ffmpeg.
    SaveError
        If the file cannot be written, for example on a full disk; an existing file is kept.
    """
    file = checked_path("animate", path, (".gif", ".mp4", ".html"))
    require_count("animate, frames", frames, "For example 80.")
    require_count("animate, dpi", dpi, "For example 100.")
    require_positive("animate, seconds", seconds)
    require_text("animate, title", title)
    if file.suffix == ".mp4":
        _require_ffmpeg()
    seen = _camera("animate", scene, camera)
    shown = mechanism(scene, solution, frames_of(solution, frames).tolist(), colour, limits)
    with saving("folder", file.parent):
        file.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix == ".html":
        write_page(shown, file, seconds, title, seen)
        return Film(file)
    with settings():
        _film(shown, file, frames / seconds, title, dpi, seen, progress)
    return Film(file)


def _require_ffmpeg() -> None:
    if not animation.FFMpegWriter.isAvailable():
        raise MissingPackageError(
            "animate: MP4 needs the program ffmpeg, which is not on the path. Install it (apt "
            "install ffmpeg, brew install ffmpeg), or write a .gif or .html."
        )


def checked_path(where: str, path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    """Return a path that ends with one of `suffixes`; raise InvalidInputError for others."""
    file = require_path(f"{where}, path", path)
    if file.suffix not in suffixes:
        rule = f"must be a path that ends with {' or '.join(suffixes)}"
        raise InvalidInputError(
            f"{where}, path", rule, repr(path), f"For example 'motion{suffixes[0]}'."
        )
    return file


def _camera(where: str, scene: Scene, camera: Sequence[float] | None) -> tuple[float, float]:
    """Return elevation and azimuth, degrees; InvalidInputError if given for a planar scene."""
    if camera is None:
        return CAMERA
    require_vector(f"{where}, camera", camera, (2,))
    require_kind(f"{where}, scene", scene, (Scene,), "Give the Scene that was integrated.")
    if scene.dimension == 2:
        rule = "must be left out for a planar scene"
        raise InvalidInputError(f"{where}, camera", rule, camera)
    elevation, azimuth = map(float, camera)
    return elevation, azimuth


def _film(
    shown: Mechanism,
    file: Path,
    rate: float,
    title: str,
    dpi: int,
    camera: tuple[float, float],
    progress: bool,
) -> None:
    from tqdm import tqdm

    writers: dict[str, Any] = {".gif": animation.PillowWriter, ".mp4": animation.FFMpegWriter}
    figure, brush = canvas(shown, title, True, camera)
    # The layout is computed once: it takes longer than the rest of a frame.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    brush.settle(figure)
    writer = writers[file.suffix](fps=rate)
    with replacing_path("film", file) as written, writer.saving(figure, written, dpi):
        _freeze(figure, brush, dpi)
        clock = figure.text(0.02, 0.98, "", va="top", fontsize=10)
        times = tqdm(shown.motion.t.tolist(), "film", disable=not progress, unit="frame")
        for k, t in enumerate(times):
            clock.set_text(f"t = {t:.3g} s")
            artists = brush.bodies(k) + brush.symbols(k)
            for artist in artists:
                artist.set_clip_on(False)
            writer.grab_frame()
            for artist in artists:
                artist.remove()


def _freeze(figure: Figure, brush: Painter, dpi: int) -> None:
    """Replace all that does not move by an image behind the axes, which is drawn faster."""
    drawing: Any = FigureCanvasAgg(figure)
    figure.set_dpi(dpi)
    drawing.draw()
    image = np.array(drawing.buffer_rgba())
    for artist in figure.get_children():
        artist.set_visible(artist is brush.axes)
    brush.axes.set_axis_off()
    brush.axes.set_title("")
    brush.axes.patch.set_visible(False)
    figure.figimage(image, zorder=-1)


def _label_instants(brush: Painter, drawn: Mechanism) -> None:
    """Write the times beside the point that travels farthest, where labels do not overlap."""
    travel = [np.linalg.norm(np.diff(x, axis=0), axis=-1).sum(axis=0) for x in drawn.places]
    if not any(len(x) for x in travel):
        return
    mesh = int(np.argmax([x.max(initial=-1.0) for x in travel]))
    track: Array = drawn.places[mesh][:, int(np.argmax(travel[mesh]))]
    shown: list[int] = []
    for k in reversed(range(len(track))):
        # Height of a label relative to the extent: about 0.04.
        if not shown or np.linalg.norm(track[k] - track[shown[-1]]) > 0.04 * brush.extent:
            shown.append(k)
    for k in shown:
        x, t = track[k], drawn.motion.t[k]
        offset = (x[:2] - drawn.bounds.mean(axis=0)[:2]) >= 0
        brush.axes.text(
            *x,
            f" {t:.3g} s ",
            fontsize=8,
            color="#444444",
            zorder=10,
            ha="left" if offset[0] else "right",
            va="bottom" if offset[1] else "top",
        )
