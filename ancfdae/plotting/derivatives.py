"""Plots of derivatives: bands about observables over time, bars on the elements of a beam."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ancfdae.equations import MechanicalSystem, Sensitivities, Solution
from ancfdae.errors.checks import require_kind, require_positive, require_text
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.charts import COLOURS, require_label, settings
from ancfdae.plotting.mechanism import Mechanism, mechanism
from ancfdae.plotting.painters import canvas
from ancfdae.plotting.shapes import BeamMesh
from ancfdae.sensitivity.method import Gradient
from ancfdae.sensitivity.observables.observable import Observable, states_of

_SIZE = (7.5, 2.7)  # inches, of the panel of each observable


def history(
    system: MechanicalSystem,
    solution: Solution,
    observables: Mapping[str, Observable],
    percent: float = 1.0,
) -> Figure:
    """Draw observables over time, with a band for each design variable.

    The band is observable ± |d(observable)/db b| percent/100: the effect of changing the variable
    by this percentage, to first order, with the exact derivative of the computed motion.

    Parameters
    ----------
    system : MechanicalSystem
        The system of the solution: ``assemble(scene, design)``.
    solution : Solution
        From `differentiate`.
    observables : mapping of str to Observable
        By label, with its unit if it has one, ``{"tip [m]": position(rod.at_end, 1)}``; a panel
        each.
    percent : float
        Change of each variable that the bands show, relative to its value; per cent.

    Raises
    ------
    InvalidInputError, UnknownNameError
        If there are no derivatives, the system has other design variables, one of them is zero, or
        an observable does not exist.
    """
    require_kind("history, system", system, (MechanicalSystem,), "Call assemble(scene, design).")
    require_kind("history, solution", solution, (Solution,), "Call differentiate.")
    require_kind("history, observables", observables, (Mapping,), "For example {'tip [m]': ...}.")
    require_positive("history, percent", percent)
    _check_observables(system, observables)
    sensitivities, states = _checked_sensitivities(system, solution), states_of(solution)
    with settings():
        figure = Figure(figsize=(_SIZE[0], _SIZE[1] * len(observables) + 0.6), layout="constrained")
        rows = figure.subplots(len(observables), sharex=True, squeeze=False)[:, 0]
        for axes, (label, observable) in zip(rows, observables.items(), strict=True):
            partials = observable.partials(system, states)
            slopes = partials.total(sensitivities.q_b, sensitivities.v_b, sensitivities.lam_b)
            axes.set_ylabel(label)
            axes.plot(solution.t, partials.value, color="black", lw=1.4, label=label, zorder=3)
            widths = np.abs(slopes * system.b) * percent / 100
            _draw_bands(axes, solution.t, partials.value, widths, sensitivities.names)
        rows[-1].set_xlabel("t [s]")
        _name_bands(figure, rows[0], sensitivities.names, percent)
    return figure


def _check_observables(system: MechanicalSystem, observables: Mapping[str, Observable]) -> None:
    if not observables:
        rule, repair = "needs at least one observable", "For example {'tip [m]': ...}."
        raise InvalidInputError("history", rule, "none", repair)
    for label, observable in observables.items():
        require_label("history, observables", label)
        require_kind("history, observable", observable, (Observable,), "For example position(...).")
        observable.check(system)


def _draw_bands(axes: Axes, t: Array, value: Array, widths: Array, names: Sequence[str]) -> None:
    """Draw a band for each variable, the widest first, so that none hides another."""
    for i in np.argsort(-widths.max(axis=0)).tolist():
        low, high = value - widths[:, i], value + widths[:, i]
        colour = COLOURS[i % len(COLOURS)]
        axes.fill_between(t, low, high, label=names[i], color=colour, alpha=0.45, lw=0.5)


def _name_bands(figure: Figure, axes: Axes, names: Sequence[str], percent: float) -> None:
    bands = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(
        [bands[name] for name in names],
        [f"{name} ± {percent:g} %" for name in names],
        loc="outside lower center",
        ncols=min(4, len(names)),
    )


def _checked_sensitivities(system: MechanicalSystem, solution: Solution) -> Sensitivities:
    sensitivities = solution.sensitivities
    if sensitivities is None or not sensitivities.names:
        rule, repair = "must have derivatives", "Call differentiate with a design."
        raise InvalidInputError("history, solution", rule, "none", repair)
    for name in sensitivities.names:
        if name not in system.design_names:
            raise UnknownNameError(
                "history, design variable of the solution", name, system.design_names
            )
    if sensitivities.names != system.design_names or not np.array_equal(
        sensitivities.values, system.b
    ):
        raise InvalidInputError(
            "history, system",
            "must be the system of the solution, with its design variables and their values",
            f"{', '.join(system.design_names)} at {system.b}",
            "Call assemble(scene, design) with the same design.",
        )
    if np.any(system.b == 0):
        at = system.design_names[int(np.argmin(np.abs(system.b)))]
        rule, repair = "a variable at zero has no per cent", "Leave it out of the design."
        raise InvalidInputError(f"history, design variable {at!r}", rule, "0", repair)
    return sensitivities


# -- bars --------------------------------------------------------------------------------------


# Length of the longest bar over the extent of the picture.
_LONGEST = 0.22
_RAISES, _LOWERS = "#b2182b", "#2166ac"


def gradient_bars(
    scene: Scene, gradient: Gradient, target: str, time: float | None = None, title: str = ""
) -> Figure:
    """Draw the derivatives in a distributed variable as bars on the elements of a beam.

    A bar in the direction of the section's height axis means that the objective increases with the
    variable of the element, one in the opposite direction that it decreases; lengths are
    proportional to the derivatives.

    Parameters
    ----------
    scene : Scene
    gradient : Gradient
        In the variables ``target[0]``, ``target[1]`` ... of `distributed_variables`, and others.
    target : str
        For example ``"rod.height"``.
    time : float, optional
        Time of the run at which the beam is drawn; s. By default the scene as declared.
    title : str

    Raises
    ------
    InvalidInputError, UnknownNameError
        If the gradient lacks variables of that target, or the scene has no beam of that name.
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
    """Return the corners of a bar on each element at time index k, shape (n, n_c, d); m.

    Bars stand on the centre line of mesh `number`; the longest is a fixed fraction of `extent`, m.
    """
    mesh = shown.meshes[number]
    assert isinstance(mesh, BeamMesh)
    x, up = (part[0] for part in mesh.axis(shown.motion.q[[k]]))
    longest = float(np.max(np.abs(values))) or 1.0
    tips = x + _LONGEST * extent * (values / longest)[:, None, None] * up
    return np.concatenate([x, tips[:, ::-1]], axis=1)


def _distribution(shown: Mechanism, gradient: Gradient, target: str) -> tuple[int, Array]:
    """Return the number of the beam's mesh, and the derivatives by element, shape (n,)."""
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
