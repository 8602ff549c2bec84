"""A whirling beam of given mass that bends least while it is spun up."""

from typing import Any, Final

import numpy as np

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Integral,
    Material,
    Pin,
    RotationDriver,
    Scene,
    Terminal,
    assemble,
    distributed_variables,
    gradients,
    simulate,
)
from ancfdae.extend import MaterialPoint
from ancfdae.laws import UserLaw
from ancfdae.numerics.arrays import Array
from ancfdae.observables import deflection, mass
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Once, Optimisation, constrained, searched

_SPEED, _DURATION, _HEIGHT, _MASS = 6.0, 1.0, 0.02, 0.48
_POLYMER: Final = Material(1200.0, 2e8, 0.35, damping_time=2e-3)


def spin_up(t: Any) -> Any:
    """Angle of the hub: speed (t - sin(2 pi t) / (2 pi)) within one second."""
    return _SPEED * (t * t / 2 + (np.cos(2 * np.pi * t) - 1) / (2 * np.pi) ** 2)


def blade(elements: int) -> Scene:
    """Return the beam, 1 m long, on its hub."""
    beam = Beam("blade", (0, 0), (1, 0), elements, Rectangle(_HEIGHT, 0.02), _POLYMER)
    return Scene([beam], [Pin(beam.at_start), RotationDriver(beam.at_start, UserLaw(spin_up))])


def evaluation(elements: int, steps: int) -> Once:
    """Return ln of the mean-square deflection of the tip, and mass over that of the uniform one.

    Variables: heights of the elements over that of the uniform beam.
    """
    scene = blade(elements)
    beam = scene.beams[0]
    bending = Integral(deflection(beam.at_end, beam.at_start) ** 2)
    asked = [np.log(bending), Terminal(mass("blade")) * (1 / _MASS)]
    system = assemble(scene, distributed_variables("blade.height", elements))

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        moved = system.with_values(_HEIGHT * x)
        results = gradients(moved, asked, _DURATION, HHT(_DURATION / steps), method=Adjoint())
        return np.array([g.value for g in results]), _HEIGHT * np.array(
            [g.gradient for g in results]
        )

    return evaluate


def optimise(elements: int, steps: int, iterations: int) -> Optimisation:
    """Return the optimal heights; an iteration changes them by at most half the uniform one."""
    start, bounds = np.ones(elements), [(0.1, 2.5)] * elements
    return constrained(evaluation(elements, steps), start, bounds, 0.5, iterations, 1e-8)


def whirling_beam(quick: bool) -> Case:
    """Return the case of the whirling beam; coarse and short if `quick`."""
    elements, steps, iterations = (2, 32, 2) if quick else (4, 64, 40)
    found = optimise(elements, steps, iterations)
    search = searched(found.evaluate, found.start, 0.2, 5 if quick else 150, found.bounds)
    best = float(np.exp(found.evaluate(found.optimum)[0][0] / 2))
    uniform = float(np.exp(found.evaluate(found.start)[0][0] / 2))
    return Case(
        key="whirling-beam",
        title="Heights of a whirling beam",
        method="SLSQP in boxes",
        variables=[f"height {k} over that of the uniform beam" for k in range(elements)],
        responses=[
            Response("ln of the mean-square deflection", "-"),
            Response("mass over that of the uniform beam", "-", 1.0),
        ],
        found=found,
        comparisons=[
            Comparison.with_search(
                "rms deflection of the tip [m]",
                found,
                search,
                1e-3,
                lambda ln: float(np.exp(ln / 2)),
            )
        ],
        panels=_panels(found, elements, steps),
        findings=f"At equal mass the tip bends {best / uniform:.3f} times as much as that of the "
        f"uniform beam (rms {best:.4g} m and {uniform:.4g} m).",
        sizes=np.ones(elements),
    )


def _panels(found: Optimisation, elements: int, steps: int) -> list[Panel]:
    system = assemble(blade(elements), distributed_variables("blade.height", elements))
    shapes, heights = [], []
    ends = np.repeat(np.linspace(0, 1, elements + 1), 2)[1:-1]
    for name, x in (("uniform", found.start), ("optimum", found.optimum)):
        solution = simulate(system.with_values(_HEIGHT * x), _DURATION, HHT(_DURATION / steps))
        s = np.linspace(0, 1, 2 * elements + 1)
        places = np.array([solution.position(MaterialPoint("blade", each)) for each in s])
        # Turned back with the hub.
        angle = spin_up(solution.t)
        along = places[..., 0] * np.cos(angle) + places[..., 1] * np.sin(angle)
        across = places[..., 1] * np.cos(angle) - places[..., 0] * np.sin(angle)
        row = int(np.argmax(np.abs(across[-1])))
        shapes.append(Series(name, along[:, row], across[:, row]))
        heights.append(Series(name, ends, np.repeat(1e3 * _HEIGHT * x, 2)))
    return [
        Panel("Shape in the frame of the hub", "along [m]", "across [m]", shapes),
        Panel("Height along the beam", "from the hub [m]", "height [mm]", heights),
    ]
