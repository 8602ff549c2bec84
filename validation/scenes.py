"""Scenes of the source paper, as reports and tests use them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ancfdae import (
    Beam,
    Clamp,
    CurvedBeam,
    InitialVelocity,
    Material,
    NodalState,
    Pin,
    PointForce,
    PointOnLine,
    Revolute,
    SaintVenantKirchhoff,
    Scene,
    Spherical,
)
from ancfdae.extend import MaterialPoint
from ancfdae.results import Solution
from ancfdae.sections import Rectangle


def pendulum(
    dimension: int = 2,
    youngs_modulus: float = 1e7,
    elements: int = 5,
    start: Sequence[InitialVelocity | NodalState] = (),
    damping_time: float = 0.0,
) -> Scene:
    """Return the flexible pendulum of section 4.1, planar or spatial.

    L = 1.2 m, h = w = 0.05 m, rho = 4000 kg/m^3, nu = 0.3, pinned at the left end, horizontal
    at the start, under 9.81 m/s^2. The paper has no damping.
    """
    rest = (0.0,) * (dimension - 1)
    beam = Beam(
        "pendulum",
        start=(0.0, *rest),
        end=(1.2, *rest),
        elements=elements,
        section=Rectangle(height=0.05, width=0.05),
        material=Material(4000, youngs_modulus, 0.3, damping_time),
        energy=SaintVenantKirchhoff(),
    )
    gravity = (0.0, -9.81, 0.0)[:dimension]
    return Scene([beam], [Pin(beam.at_start)], gravity=gravity, start=start)


def cantilever(beam: Beam | CurvedBeam, force: Sequence[float]) -> Scene:
    """Return a beam clamped at its start with a dead force, called `load`, at its end."""
    load = PointForce(beam.at_end, tuple(force), name="load")
    return Scene([beam], [Clamp(beam.at_start)], loads=[load])


def pendulum_deflection(solution: Solution) -> npt.NDArray[Any]:
    """Return the deflection of the free end in the pendulum's body frame, shape (n_t,); m.

    The frame sits at the pin with its x axis along the tangent of the centre line; the
    deflection is the y component of the free end. Accepts complex solutions.
    """
    tangent = solution.slope(MaterialPoint("pendulum", 0.0))
    arm = solution.position(MaterialPoint("pendulum", 1.0)) - solution.position(
        MaterialPoint("pendulum", 0.0)
    )
    length = np.sqrt(np.sum(tangent * tangent, axis=1))
    across = tangent[:, 0] * arm[:, 1] - tangent[:, 1] * arm[:, 0]
    return across / length


def crank_slider() -> Scene:
    """Return the crank-slider of section 4.2 with the data of Table 1.

    The paper's Fig. 7 is not legible in our copy. Taken here: the in-plane mechanism, stretched
    out along +x at the start (slider at 2.7 m, so that 1.8 m is the middle of its travel), section
    heights in the plane of motion, gravity along -y, massless slider.
    """
    section = Rectangle(height=0.05, width=0.05)
    paper = SaintVenantKirchhoff()
    stiff, soft = Material(2770, 1e9, 0.3), Material(2770, 1e8, 0.3)
    crank = Beam("crank", (0, 0, 0), (0.9, 0, 0), 2, section, stiff, energy=paper)
    rod = Beam("rod", (0.9, 0, 0), (2.7, 0, 0), 4, section, soft, energy=paper)
    joints = [
        Revolute(crank.at_start, axis=(0, 0, 1), name="bearing"),
        Spherical(crank.at_end, rod.at_start, name="elbow"),
        PointOnLine(rod.at_end, direction=(1, 0, 0), name="slider"),
    ]
    return Scene([crank, rod], joints, gravity=(0, -9.81, 0))
