"""Observables over time with bands of what a change of each design variable does to them."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ancfdae.equations import MechanicalSystem, Sensitivities, Solution
from ancfdae.errors.checks import require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.charts import require_label, settings
from ancfdae.plotting.looks import COLOURS
from ancfdae.sensitivity.observables.observable import Observable
from ancfdae.sensitivity.observables.states import states_of

_SIZE = (7.5, 2.7)  # inches, of each observable


def history(
    system: MechanicalSystem,
    solution: Solution,
    observables: Mapping[str, Observable],
    percent: float = 1.0,
) -> Figure:
    """Draw observables over time, with a band for each design variable.

    The band is observable ± |d(observable)/db b| percent/100: what a change of the variable by so
    many per cent does, to first order, with the exact derivative of the computed motion.

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
        If there are no derivatives, the system has other design variables, one of them is zero,
        or an observable does not exist.
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
