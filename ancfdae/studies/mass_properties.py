"""Mass, centre of mass and inertia of a scene at t = 0, with design derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_kind
from ancfdae.errors.text import PrintedTable, TableText, listed
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.mass import centre_of_mass, inertia, mass
from ancfdae.sensitivity.observables.observable import Observable, States
from ancfdae.studies.calls import as_system


@final
@dataclass(frozen=True, repr=False)
class MassProperties(PrintedTable):
    """Mass properties and their total derivatives in n_b design variables.

    Attributes
    ----------
    mass : float
        Total mass; kg.
    centre : array, shape (d,)
        Centre of mass; m.
    inertia : array, shape (3, 3), in the plane (1, 1)
        Tensor of inertia about the centre of mass, in the plane about the axis across it; kg m^2.
    mass_b, centre_b, inertia_b : array
        Design derivatives of the three, with a last axis n_b; per unit of the variable.
    names : tuple of str
        Names of the design variables.
    """

    mass: float
    centre: Array
    inertia: Array
    mass_b: Array
    centre_b: Array
    inertia_b: Array
    names: tuple[str, ...]

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for the mass and each entry of centre and inertia.

        Rows are named ``mass``, ``centre.y`` or ``inertia.xy``. The column ``value`` is in kg, m or
        kg m^2; each design variable has a column of derivatives, ``d/d rod.height``.
        """
        labels, values, derivatives = self._entries()
        columns = zip(self.names, derivatives.T, strict=True)
        table = {"value": values} | {f"d/d {name}": column for name, column in columns}
        return pandas().DataFrame(table, index=pandas().Index(labels, name="quantity"))

    def _entries(self) -> tuple[list[str], Array, Array]:
        """Return names, values, (n,), and derivatives, (n, n_b), of mass, centre and inertia."""
        d, n = len(self.centre), len(self.inertia)
        i, j = np.triu_indices(n)
        axes = "xyz"[-n:]
        labels = ["mass", *(f"centre.{axis}" for axis in "xyz"[:d])]
        labels += [f"inertia.{axes[k]}{axes[l]}" for k, l in zip(i, j, strict=True)]
        values = np.concatenate([[self.mass], self.centre, self.inertia[i, j]])
        return labels, values, np.concatenate([[self.mass_b], self.centre_b, self.inertia_b[i, j]])

    def _printed(self) -> TableText:
        labels, values, _ = self._entries()
        units = (_UNITS[label.split(".")[0]] for label in labels)
        rows = zip(labels, (f"{x:.6g}" for x in values), units, strict=True)
        tail = f"derivatives in {listed(self.names)}" if self.names else ""
        return "MassProperties", [("quantity", "value", "unit"), *rows], tail


_UNITS = {"mass": "kg", "centre": "m", "inertia": "kg m^2"}


def mass_properties(
    model: Scene | AncfSystem,
    beam: str | None = None,
    design: Sequence[str | DesignVariable] = (),
) -> MassProperties:
    """Return mass, centre of mass and inertia of a scene, or of one of its bodies, at t = 0.

    Parameters
    ----------
    model : Scene or AncfSystem
        An assembled system has its own design variables.
    beam : str, optional
        Name of a beam, a body or a point mass; by default the whole scene.
    design : sequence of str or DesignVariable, optional
        Design variables to differentiate in, for a scene.
    """
    require_kind("model", model, (Scene, AncfSystem), "Pass one of them.")
    system = as_system(model, design)
    assert isinstance(system, AncfSystem)
    d = system.naming.layout.d
    axes = (2,) if d == 2 else (0, 1, 2)
    m, m_b = _at_start(system, mass(beam))
    centre = [_at_start(system, centre_of_mass(axis, beam)) for axis in range(d)]
    tensor = [[_at_start(system, inertia(i, j, beam)) for j in axes] for i in axes]
    return MassProperties(
        m,
        np.array([value for value, _ in centre]),
        np.array([[value for value, _ in row] for row in tensor]),
        m_b,
        np.array([slope for _, slope in centre]),
        np.array([[slope for _, slope in row] for row in tensor]),
        tuple(system.design_names),
    )


def _at_start(system: AncfSystem, observable: Observable) -> tuple[float, Array]:
    """Return an observable at t = 0 and its total design derivative, shape (n_b,)."""
    observable.check(system)
    q, v = system.start()
    states = States(np.zeros(1), q[None], v[None], np.zeros((1, system.n_lam)))
    p, (q_b, v_b) = observable.partials(system, states), system.start_b()
    return float(p.value[0]), p.total(q_b[None], v_b[None], None)[0]
