"""An animation as one HTML file that contains data and viewer and loads no other file.

Places are kept as 16 bit integers over the extent of the film, colours as 8 bit.
"""

import base64
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ancfdae.equations.files import replacing
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.glyphs import Glyphs
from ancfdae.plotting.mechanism import Mechanism
from ancfdae.plotting.painters import CAMERA, EDGE, GROUND, JOINT, LOAD, colour_map
from ancfdae.plotting.symbols import GROUND as GROUND_SIGN

_MARK = "/*DATA*/null"
# What the viewer can paint; other markers are circles there.
_SHAPES = {"^": "ground", "s": "square", "d": "diamond", r"$\circlearrowleft$": "turn"}
# Shade of points without a value, and the largest shade of a value.
_NO_VALUE, _TOP = 255, 254


def write_page(
    shown: Mechanism, file: Path, seconds: float, title: str, camera: tuple[float, float] = CAMERA
) -> None:
    """Write the animation of a mechanism, `seconds` long, as one page of HTML."""
    # No text of the data may end the script that it stands in.
    data = json.dumps(page_data(shown, seconds, title, camera), allow_nan=False).replace(
        "</", "<\\/"
    )
    page = files("ancfdae.plotting").joinpath("viewer.html").read_text(encoding="utf-8")
    with replacing("page", file) as written:
        written.write(page.replace(_MARK, data).encode("utf-8"))


def page_data(
    shown: Mechanism, seconds: float, title: str, camera: tuple[float, float] = CAMERA
) -> dict[str, Any]:
    """Return the data that the program in the page reads, as JSON can hold them."""
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
        # Body by body: in the plane later ones cover earlier ones.
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
    """Return the field as numbers from 0 to 254, or 255 where there is none, shape (k, n)."""
    if shown.field is None:
        return np.full([len(shown.motion.t), sum(x.shape[1] for x in shown.places)], _NO_VALUE)
    values = np.concatenate(shown.values, axis=1)
    low, high = shown.limits
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.where(np.isfinite(values), np.round(_TOP * share), _NO_VALUE)


def _signs(shown: Mechanism) -> tuple[Array, list[dict[str, Any]]]:
    """Return the points of all signs, (k, n, d), and what each is with how many of them."""
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
