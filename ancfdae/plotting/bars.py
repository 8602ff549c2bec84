"""A gradient over the elements of a beam as bars on its shape."""

from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ancfdae.errors.checks import require_kind, require_text
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.charts import settings
from ancfdae.plotting.mechanism import Mechanism, mechanism
from ancfdae.plotting.painters import canvas
from ancfdae.plotting.shapes import BeamMesh
from ancfdae.sensitivity.method import Gradient

# Of the extent of the picture: the longest bar.
_LONGEST = 0.22
_RAISES, _LOWERS = "#b2182b", "#2166ac"


def gradient_bars(
    scene: Scene, gradient: Gradient, target: str, time: float | None = None, title: str = ""
) -> Figure:
    """Draw the derivatives with respect to a distribution as bars on the elements of a beam.

    A bar on the side of the section's height axis says that the objective rises with the variable
    of the element, one on the other side that it falls; lengths are in proportion.

    Parameters
    ----------
    scene : Scene
    gradient : Gradient
        In the variables ``target[0]``, ``target[1]`` ... of `distributed_variables`, and maybe
        others.
    target : str
        ``"rod.height"``, say.
    time : float, optional
        Instant of the run that the beam is drawn at; s. By default the scene as declared.
    title : str

    Raises
    ------
    InvalidInputError, UnknownNameError
        If the gradient has no distribution of that target, or the scene has no beam of that name.
    """
    require_kind("gradient_bars, gradient", gradient, (Gradient,), "Call gradient.")
    require_text("gradient_bars, target", target)
    if time is None:
        shown = mechanism(scene, None, None, None)
    else:
        shown = mechanism(scene, gradient.solution, [time], None)
    number, values = _distribution(shown, gradient, target)
    with settings():
        figure, brush = canvas(shown, title or f"Derivatives in {target} by element")
        brush.bodies(0, 0.5)
        bars = bar_places(shown, number, values, brush.extent)
        colours = [_RAISES if value > 0 else _LOWERS for value in values.tolist()]
        style: dict[str, Any] = {"facecolors": colours, "edgecolors": "black", "linewidths": 0.5}
        if shown.d == 2:
            brush.axes.add_collection(PolyCollection(list(bars), zorder=8, alpha=0.85, **style))
        else:
            brush.axes.add_collection3d(Poly3DCollection(list(bars), alpha=0.85, **style))
        _include(brush.axes, bars, shown.d)
        largest = f"{np.max(np.abs(values)):.3g} per unit of {target}"
        entries = [Patch(color=_RAISES, label="raises the objective")]
        entries.append(Patch(color=_LOWERS, label="lowers it"))
        entries.append(Patch(color="none", label=f"longest bar: {largest}"))
        figure.legend(handles=entries, loc="outside lower center", ncols=3)
        brush.settle(figure)
    return figure


def bar_places(shown: Mechanism, number: int, values: Array, extent: float, k: int = 0) -> Array:
    """Return the corners of a bar on each element at instant k, shape (n, n_c, d).

    They stand on the centre line of the mesh of this number; the longest is a share of the extent.
    """
    mesh = shown.meshes[number]
    assert isinstance(mesh, BeamMesh)
    x, up = (part[0] for part in mesh.axis(shown.motion.q[[k]]))
    longest = float(np.max(np.abs(values))) or 1.0
    tips = x + _LONGEST * extent * (values / longest)[:, None, None] * up
    return np.concatenate([x, tips[:, ::-1]], axis=1)


def _distribution(shown: Mechanism, gradient: Gradient, target: str) -> tuple[int, Array]:
    """Return the number of the mesh, and the derivative by element."""
    beam = target.partition(".")[0]
    names = [mesh.name for mesh in shown.meshes if isinstance(mesh, BeamMesh)]
    if beam not in names:
        raise UnknownNameError("gradient_bars, beam", beam, names)
    number = [mesh.name for mesh in shown.meshes].index(beam)
    mesh, known = shown.meshes[number], dict(zip(gradient.names, gradient.gradient, strict=True))
    assert isinstance(mesh, BeamMesh)
    wanted = [f"{target}[{k}]" for k in range(mesh.body.element_count)]
    missing = [name for name in wanted if name not in known]
    if missing:
        raise InvalidInputError(
            "gradient_bars, gradient",
            f"must have a derivative for each of the {len(wanted)} elements",
            f"none for {missing[0]}",
            f"Differentiate with design=distributed_variables({target!r}, {len(wanted)}).",
        )
    return number, np.array([known[name] for name in wanted], dtype=float)


def _include(axes: Any, bars: Array, d: int) -> None:
    low, high = bars.reshape(-1, d).min(axis=0), bars.reshape(-1, d).max(axis=0)
    for axis, a, b in zip("xyz", low.tolist(), high.tolist(), strict=False):
        left, right = getattr(axes, f"get_{axis}lim")()
        room = 0.02 * (right - left)
        getattr(axes, f"set_{axis}lim")(min(left, a - room), max(right, b + room))
    if d == 3:
        axes.set_box_aspect([np.ptp(getattr(axes, f"get_{axis}lim")()) for axis in "xyz"], zoom=1.0)
