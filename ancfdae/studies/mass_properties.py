"""Mass, centre of mass and inertia of a scene as it starts, with design derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.system import AncfSystem
from ancfdae.errors.checks import require_kind
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.mass import centre_of_mass, inertia, mass
from ancfdae.sensitivity.observables.observable import Observable, States
from ancfdae.studies.calls import as_system


@final
@dataclass(frozen=True)
class MassProperties:
    """Mass properties and their total derivatives in n_b design variables.

    Attributes
    ----------
    mass : float
        kg.
    centre : array, shape (d,)
        Centre of mass; m.
    inertia : array, shape (3, 3), in the plane (1, 1)
        Tensor of inertia about the centre of mass, in the plane about the axis across it; kg m^2.
    mass_b, centre_b, inertia_b : array
        Design derivatives of the three, with a last axis n_b; per unit of the variable.
    """

    mass: float
    centre: Array
    inertia: Array
    mass_b: Array
    centre_b: Array
    inertia_b: Array


def mass_properties(
    model: Scene | AncfSystem,
    beam: str | None = None,
    design: Sequence[str | DesignVariable] = (),
) -> MassProperties:
    """Return mass, centre and inertia of a scene, or of one of its bodies, as it starts.

    Parameters
    ----------
    model : Scene or AncfSystem
        An assembled system has its own design variables.
    beam : str, optional
        Name of a beam, a body or a point mass; by default the whole scene.
    design : sequence of str or DesignVariable, optional
        What to differentiate in, for a scene.
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
    )


def _at_start(system: AncfSystem, observable: Observable) -> tuple[float, Array]:
    """Value at the start and total derivative."""
    observable.check(system)
    q, v = system.start()
    states = States(np.zeros(1), q[None], v[None], np.zeros((1, system.n_lam)))
    p, (q_b, v_b) = observable.partials(system, states), system.start_b()
    return float(p.value[0]), p.total(q_b[None], v_b[None], None)[0]
