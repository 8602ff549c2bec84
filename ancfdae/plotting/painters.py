"""Painters of a mechanism at one time into axes of matplotlib, in the plane and in space.

Forces are arrows; springs, axes of motion and moments are drawn as polylines.
"""

import abc
from collections.abc import Sequence
from typing import Any, Final, final

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from ancfdae.model.parts import Sign
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.mechanism import Mechanism
from ancfdae.plotting.shapes import BeamMesh
from ancfdae.plotting.symbols import GROUND as GROUND_SIGN
from ancfdae.plotting.symbols import Arrows, Line

# Relative to the extent of the picture: longest arrow, radius of arcs of moments, half a way.
_ARROW, _ARC, _WAY = 0.16, 0.05, 0.12
_TURNS: Final = 7  # of a spring
_UNITS: Final = {"force": "N", "force per length": "N/m", "moment": "N m"}


@final
class Glyphs:
    """Shapes of the symbols of a mechanism, scaled with the extent of its picture, m.

    `labels` holds for each kind of arrow a text with its largest magnitude, shown by the longest
    arrow.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.extent = float(np.max(np.ptp(mechanism.bounds, axis=0))) or 1.0
        self._largest = _largest(mechanism.arrows)
        self.labels = {
            kind: f"{kind}, largest {size:.3g} {_UNITS[kind]}"
            for kind, size in self._largest.items()
        }

    def line(self, line: Line, k: int) -> Array:
        """Return the points of a link, spring or way at time index k, shape (n, d); m."""
        ends: Array = line.ends[k]
        if line.kind == "spring":
            return _zigzag(ends)
        if line.kind == "way":
            half = _WAY * self.extent * (ends[1] - ends[0])
            return np.array([ends[0] - half, ends[0] + half])
        return ends

    def arrow(self, arrows: Arrows) -> Array:
        """Return the arrow vectors of forces, scaled to the picture, shape (k, n, d); m."""
        return np.asarray(_ARROW * self.extent / self._largest[arrows.kind] * arrows.vectors)

    def arc(self, arrows: Arrows, k: int) -> Array:
        """Return an arc with an arrowhead about a moment at time index k, shape (n, d); m.

        All points coincide where the moment vanishes.
        """
        centre, M, radius = arrows.places[k, 0], arrows.vectors[k, 0], _ARC * self.extent
        size = np.linalg.norm(M)
        if len(M) == 1:
            turn = _circle_arrow(-1.0 if M[0] < 0 else 1.0)
            return np.asarray(centre + radius * abs(np.sign(M[0])) * turn)
        axis = M / (size or 1.0)
        first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        first = first / (np.linalg.norm(first) or 1.0)
        plane = np.stack([first, np.cross(axis, first)])
        return np.asarray(centre + 1.6 * radius * (_circle_arrow(1.0) @ plane))


def _largest(arrows: Sequence[Arrows]) -> dict[str, float]:
    """Return the largest magnitude of each kind of arrow over all times."""
    sizes: dict[str, float] = {}
    for each in arrows:
        size = float(np.max(np.linalg.norm(each.vectors, axis=-1)))
        sizes[each.kind] = max(size, sizes.get(each.kind, 0.0))
    return {kind: size or 1.0 for kind, size in sizes.items()}


def _zigzag(ends: Array) -> Array:
    """Return the points of a spring between two ends; in space it lies in one plane."""
    e = ends[1] - ends[0]
    length = float(np.linalg.norm(e))
    if len(e) == 2:
        normal = np.array([-e[1], e[0]])
    else:
        normal = np.cross(e, np.eye(3)[int(np.argmin(np.abs(e)))])
    along = np.concatenate([[0.0], np.linspace(0.15, 0.85, 2 * _TURNS), [1.0]])
    side = np.concatenate([[0.0], 0.06 * (-1.0) ** np.arange(2 * _TURNS), [0.0]])
    side[[1, -2]] = 0.0
    across = normal * (length / (float(np.linalg.norm(normal)) or 1.0))
    return np.asarray(ends[0] + along[:, None] * e + side[:, None] * across)


def _circle_arrow(sense: float) -> Array:
    """Return three quarters of a unit circle in one sense, with an arrowhead; (n, 2)."""
    angle = sense * np.linspace(-0.5 * np.pi, np.pi, 30)
    arc = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    tip, along = arc[-1], arc[-1] - arc[-4]
    normal = np.array([-along[1], along[0]])
    head = np.stack([tip - 1.3 * along + 0.8 * normal, tip, tip - 1.3 * along - 0.8 * normal])
    return np.concatenate([arc, head])


# -- painters ----------------------------------------------------------------------------------


#: Colours of bodies, outlines, joints, loads and ground.
BODY, EDGE, JOINT, LOAD, GROUND = "#9db4c8", "#33404d", "#111111", "#c1272d", "#7a7a7a"
#: Colour maps of fields whose sign matters, and of other fields.
SIGNED, PLAIN = "RdBu_r", "viridis"
_WIDTH: Final = 7.5  # inches
_EDGE: Final = 0.08  # inches, around a picture of space
_NARROW, _WIDE = 0.15, 1.1  # height of the axes over their width
# Relative to the extent of the picture: height up to which a beam is thin, and margin.
_THIN, _MARGIN = 0.008, 0.12
#: Elevation and azimuth from which space is seen; degrees.
CAMERA: Final = (22.0, -60.0)
_LIGHT: Final = np.array([-0.35, -0.55, 0.75])


class Painter(abc.ABC):
    """Axes with equal scales that paint a mechanism at any of its times."""

    def __init__(
        self, figure: Figure, mechanism: Mechanism, camera: tuple[float, float] = CAMERA
    ) -> None:
        self.mechanism, self._bounds, self._camera = mechanism, mechanism.bounds, camera
        self.glyphs = Glyphs(mechanism)
        self.extent = self.glyphs.extent
        self.colours = ScalarMappable(Normalize(*mechanism.limits), colour_map(mechanism))
        self.axes = self._make_axes(figure)

    @abc.abstractmethod
    def _make_axes(self, figure: Figure) -> Any:
        """Return axes with equal scales that contain the mechanism at all times."""

    @abc.abstractmethod
    def bodies(self, k: int, strength: float = 1.0) -> list[Artist]:
        """Paint all bodies at time index k, mixed with white if `strength` is below 1."""

    @abc.abstractmethod
    def settle(self, figure: Figure) -> None:
        """Fit the axes into the space that title, legend and colour bar leave."""

    @abc.abstractmethod
    def _mark(self, sign: Sign, x: Array) -> list[Artist]:
        """Paint a marker of a joint or load at the place x; return its artists."""

    @abc.abstractmethod
    def _quiver(self, x: Array, F: Array) -> Artist:
        """Paint forces F as arrows that start at the points x, (n, d) each; m."""

    @final
    def symbols(self, k: int) -> list[Artist]:
        """Paint joints, point masses and loads at time index k; return the artists."""
        shown, artists = self.mechanism, list[Artist]()
        for line in shown.lines:
            artists += self._line(self.glyphs.line(line, k), line.kind)
        for mark in sorted(shown.marks, key=lambda mark: mark.sign is not GROUND_SIGN):
            artists += self._mark(mark.sign, mark.places[k])
        for arrows in shown.arrows:
            if arrows.kind == "moment":
                artists += self._line(self.glyphs.arc(arrows, k), "moment")
            else:
                artists.append(self._quiver(arrows.places[k], self.glyphs.arrow(arrows)[k]))
        return artists

    @final
    def _line(self, x: Array, kind: str) -> list[Artist]:
        style = {
            "way": {"color": GROUND, "linestyle": (0, (6, 2, 1, 2)), "linewidth": 1.0},
            "moment": {"color": LOAD, "linewidth": 1.6},
            "spring": {"color": LOAD, "linewidth": 1.2},
        }.get(kind, {"color": EDGE, "linewidth": 1.8})
        return list(self.axes.plot(*x.T, zorder=6, **style))

    @final
    def _marker(self, sign: Sign) -> dict[str, object]:
        turning, ground = sign.marker.startswith("$"), sign is GROUND_SIGN
        return {
            "marker": sign.marker,
            "markersize": sign.size,
            "markerfacecolor": GROUND if ground else JOINT if sign.filled else "white",
            "markeredgecolor": GROUND if ground else JOINT,
            "markeredgewidth": 0.4 if turning else 1.2,
            "linestyle": "none",
            "zorder": 7 if ground else 9 if turning else 8,
        }

    @final
    def legend(self) -> list[Line2D]:
        """Return a legend entry for each kind of marker and of arrow in the picture."""
        signs = dict.fromkeys(mark.sign for mark in self.mechanism.marks)
        entries = [
            Line2D([], [], label=sign.word, **self._marker(sign))  # type: ignore[arg-type]
            for sign in signs
        ]
        arrows = dict(self.glyphs.labels)
        if any(line.kind == "spring" for line in self.mechanism.lines):
            arrows["spring"] = "spring and damper"
        entries += [
            Line2D([], [], label=label, color=LOAD, linewidth=1.6) for label in arrows.values()
        ]
        return entries

    @final
    def _face_colours(self, mesh: int, k: int) -> Array:
        """Return the colours of faces, (n_faces, 4), from the mean field over their points."""
        faces = self.mechanism.meshes[mesh].faces
        if self.mechanism.field is None:
            return np.tile(to_rgba(BODY), (len(faces), 1))
        return self._coloured(self.mechanism.values[mesh][k][faces].mean(axis=1))

    @final
    def _coloured(self, values: Array) -> Array:
        return self.colours.to_rgba(np.ma.masked_invalid(values))


@final
class PlanePainter(Painter):
    """Painter of a mechanism in the plane."""

    def _make_axes(self, figure: Figure) -> Any:
        axes = figure.add_subplot(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        margin = _MARGIN * self.extent
        (left, bottom), (right, top) = self._bounds
        axes.set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin))
        return axes

    def bodies(self, k: int, strength: float = 1.0) -> list[Artist]:
        """Paint areas of the bodies with their outlines; thin beams as coloured lines."""
        artists: list[Artist] = []
        for number, (mesh, x) in enumerate(
            zip(self.mechanism.meshes, self.mechanism.places, strict=True)
        ):
            if not len(mesh.faces):
                continue
            colours = faded(self._face_colours(number, k), strength)
            # Edges hide the seams between faces.
            areas = PolyCollection(
                x[k][mesh.faces], facecolors=colours, edgecolors=colours, linewidths=0.3
            )
            areas.set_zorder(3)
            artists.append(self.axes.add_collection(areas))
            loop = np.append(mesh.loop, mesh.loop[0])
            edge = faded(np.array([to_rgba(EDGE)]), strength)[0]
            artists += self.axes.plot(*x[k][loop].T, color=edge, lw=0.8, zorder=3)
            thin = _THIN / 2 * self.extent
            if isinstance(mesh, BeamMesh) and np.max(mesh.y) < thin:
                artists.append(self.axes.add_collection(self._stroke(number, k, strength)))
        return artists

    def settle(self, figure: Figure) -> None:
        """Do nothing: the layout of Matplotlib leaves room for title, legend and colour bar."""

    def _stroke(self, number: int, k: int, strength: float) -> LineCollection:
        """Return a line along a thin beam, in the colour of the largest value over the height."""
        mesh = self.mechanism.meshes[number]
        assert isinstance(mesh, BeamMesh)
        x = mesh.axis(self.mechanism.motion.q[[k]])[0].reshape(-1, self.mechanism.d)
        if self.mechanism.field is None:
            colours = np.array([to_rgba(BODY)])
        else:
            values = self.mechanism.values[number][k].reshape(-1, mesh.shape[2])
            chosen = np.argmax(np.abs(np.nan_to_num(values)), axis=1)
            along = values[np.arange(len(values)), chosen]
            colours = self._coloured((along[1:] + along[:-1]) / 2)
        pieces = np.stack([x[:-1], x[1:]], axis=1)
        line = LineCollection(list(pieces), colors=faded(colours, strength), linewidths=3.0)
        line.set_zorder(3)
        return line

    def _mark(self, sign: Sign, x: Array) -> list[Artist]:
        if sign is not GROUND_SIGN:
            return list(self.axes.plot(*x[:, None], **self._marker(sign)))
        # A triangle below the point x, and hatching.
        s = 0.03 * self.extent
        shape = s * np.array([[0.0, 0.0], [-0.7, -1.0], [0.7, -1.0], [0.0, 0.0]])
        hatch = s * np.array(
            [[[a, -1.0], [a - 0.3, -1.35]] for a in np.linspace(-0.9, 1.1, 6).tolist()]
        )
        outline = list(self.axes.plot(*(x + shape).T, color=GROUND, lw=1.0, zorder=5))
        lines = LineCollection(list(x + hatch), colors=GROUND, linewidths=0.8)
        lines.set_zorder(5)
        return [*outline, self.axes.add_collection(lines)]

    def _quiver(self, x: Array, F: Array) -> Artist:
        settings = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.006}
        return self.axes.quiver(*x.T, *F.T, color=LOAD, zorder=7, **settings)


@final
class SpacePainter(Painter):
    """Painter of a mechanism in space, with faces lit from above."""

    def _make_axes(self, figure: Figure) -> Any:
        axes = figure.add_subplot(projection="3d")
        low, high = self._bounds
        middle, half = (low + high) / 2, np.maximum((high - low) / 2, 0.2 * self.extent)
        half = half + 0.4 * _MARGIN * self.extent
        for axis, m, h in zip("xyz", middle, half, strict=True):
            axes.set(**{f"{axis}lim": (m - h, m + h), f"{axis}label": f"{axis} [m]"})
            ticks = max(1, round(5 * h / half.max()))
            getattr(axes, f"{axis}axis").set_major_locator(MaxNLocator(ticks))
        axes.set_box_aspect(half, zoom=1.0)
        axes.view_init(*self._camera)
        return axes

    def settle(self, figure: Figure) -> None:
        """Scale the cube of the axes and its labels to the free space of the figure.

        Nothing is clipped. The layout engine treats the axes as a rectangle, which the cube fills
        badly and exceeds.
        """
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        pixels, (width, height) = figure.dpi_scale_trans.inverted(), figure.get_size_inches()
        left, right, bottom, top = _EDGE, width - _EDGE, _EDGE, height - _EDGE
        for other in figure.axes:
            if other is not self.axes:
                right = min(right, other.bbox.transformed(pixels).x0 - 2 * _EDGE)
        for legend in figure.legends:
            bottom = max(bottom, legend.get_window_extent().transformed(pixels).y1 + _EDGE)
        if figure.get_suptitle():
            top -= 0.3
        # Labels do not scale with the axes; after three iterations changes are small.
        for _ in range(3):
            box = self._seen().transformed(pixels)
            grow = min((right - left) / box.width, (top - bottom) / box.height)
            at = self.axes.get_position()
            middle = np.array(
                [
                    at.x0 + at.width / 2 - (box.x0 + box.x1) / 2 / width,
                    at.y0 + at.height / 2 - (box.y0 + box.y1) / 2 / height,
                ]
            )
            room = np.array([(left + right) / 2 / width, (bottom + top) / 2 / height])
            x, y = room + grow * middle
            w, h = grow * at.width, grow * at.height
            self.axes.set_position((x - w / 2, y - h / 2, w, h))
        for artist in self.axes.get_children():
            artist.set_clip_on(False)

    def _seen(self) -> Bbox:
        """Return the bounding box of the cube of the axes and of its labels; pixels."""
        axes = self.axes
        limits = [getattr(axes, f"get_{axis}lim")() for axis in "xyz"]
        corners = np.stack(np.meshgrid(*limits), axis=-1).reshape(-1, 3)
        x, y, _ = proj_transform(*corners.T, axes.get_proj())
        cube = Bbox.null()
        cube.update_from_data_xy(axes.transData.transform(np.stack([x, y], axis=1)))
        labels = [axis.get_tightbbox() for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
        return Bbox.union([cube, *(box for box in labels if box is not None)])

    def bodies(self, k: int, strength: float = 1.0) -> list[Artist]:
        """Paint all faces as one collection, so that nearer faces hide others."""
        faces, colours = [], []
        for number, (mesh, x) in enumerate(
            zip(self.mechanism.meshes, self.mechanism.places, strict=True)
        ):
            corners = x[k][mesh.faces]
            faces.append(corners)
            colours.append(lit(self._face_colours(number, k), corners))
        if not sum(map(len, faces)):
            return []
        fills = faded(np.concatenate(colours), strength)
        surface = Poly3DCollection(
            np.concatenate(faces), facecolors=fills, edgecolors=fills, linewidths=0.2
        )
        return [self.axes.add_collection3d(surface)]

    def _mark(self, sign: Sign, x: Array) -> list[Artist]:
        return list(self.axes.plot(*x[:, None], **self._marker(sign)))

    def _quiver(self, x: Array, F: Array) -> Artist:
        return self.axes.quiver(*x.T, *F.T, color=LOAD, arrow_length_ratio=0.25, lw=1.6)


def colour_map(mechanism: Mechanism) -> Colormap:
    """Return the colour map of the field; parts without a value get the colour of bodies."""
    signed = mechanism.field is not None and mechanism.field.signed
    return colormaps[SIGNED if signed else PLAIN].with_extremes(bad=BODY)


def canvas(
    shown: Mechanism, title: str, signs: bool = False, camera: tuple[float, float] = CAMERA
) -> tuple[Figure, Painter]:
    """Return a figure of the height that the mechanism needs, and its painter.

    It has a colour bar for a field and, with `signs`, a legend.
    """
    span = np.ptp(shown.bounds, axis=0) + 0.24 * np.ptp(shown.bounds, axis=0).max()
    ratio = 0.65 if shown.d == 3 else span[1] / span[0]
    height = _WIDTH * float(np.clip(0.9 * ratio, _NARROW, _WIDE)) + 1.2
    figure = Figure(figsize=(_WIDTH, height), layout="constrained")
    kind = PlanePainter if shown.d == 2 else SpacePainter
    brush = kind(figure, shown, camera)
    if shown.d == 2:
        brush.axes.set_title(title)
    elif title:
        figure.suptitle(title, fontsize="large")
    entries = brush.legend() if signs else []
    if entries:
        figure.legend(handles=entries, loc="outside lower center", ncols=min(4, len(entries)))
    if shown.field is not None:
        bar = figure.colorbar(
            brush.colours, ax=brush.axes, shrink=0.8, pad=0.03, extend=_extend(shown)
        )
        bar.set_label(shown.field.label)
    return figure, brush


def _extend(shown: Mechanism) -> str:
    """Return which ends of the colour bar are pointed because values lie beyond its limits."""
    values = np.concatenate([x[np.isfinite(x)] for x in shown.values])
    low, high = shown.limits
    below, above = bool(np.any(values < low)), bool(np.any(values > high))
    return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[below, above]


def lit(colours: Array, corners: Array) -> Array:
    """Return colours (n, 4) of faces, (n, 4, 3), darker where normals point away from the light."""
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normals, axis=1)
    across = np.abs(normals @ _LIGHT) / (np.linalg.norm(_LIGHT) * np.where(length, length, 1.0))
    shaded = colours.copy()
    shaded[:, :3] *= (0.6 + 0.4 * across)[:, None]
    return shaded


def faded(colours: Array, strength: float) -> Array:
    """Return colours (n, 4) mixed with white; opaque, so that overlapping faces do not add up."""
    pale = colours.copy()
    pale[:, :3] = 1.0 - strength * (1.0 - pale[:, :3])
    return pale
