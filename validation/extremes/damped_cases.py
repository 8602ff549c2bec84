"""Cases of damped mechanisms, whose fast modes decay within a step."""

import numpy as np

from ancfdae import HHT, Beam, Clamp, Material, PointForce, Scene, simulate
from ancfdae.extend import MaterialPoint
from ancfdae.results import Solution
from ancfdae.sections import Rectangle
from validation.extremes.rows import Case, against_sixteenth
from validation.scenes import crank_slider, pendulum


def _damped_cantilever(elements: int, time: float, gravity: bool) -> Scene:
    section, material = Rectangle(0.02, 0.02), Material(2700, 7e10, 0.0, time)
    rod = Beam("rod", (0, 0), (1, 0), elements, section, material)
    loads = [] if gravity else [PointForce(rod.at_end, (0, 1.0))]
    return Scene([rod], [Clamp(rod.at_start)], (0, -9.81) if gravity else None, loads=loads)


def damped_starts(quick: bool) -> list[Case]:
    """Start damped mechanisms at steps that are long against the decay of their fast modes."""
    times = (1e-5, 1.0) if quick else (1e-5, 1e-4, 1e-3, 1e-2, 1.0)
    cases = []
    for elements in (2,) if quick else (2, 8):
        for time in times:
            for step in (1e-3,) if quick else (1e-2, 1e-3, 1e-4, 1e-5):
                label = f"{elements} elements, {time:g} s, step {step:g} s"
                scene = _damped_cantilever(elements, time, False)
                cases.append(against_sixteenth(f"tip force, {label}", scene, "rod", step, 50))
                if step == 1e-3:
                    scene = _damped_cantilever(elements, time, True)
                    cases.append(against_sixteenth(f"gravity, {label}", scene, "rod", step, 50))
    crank = crank_slider()
    damping = [f"{beam.name}.damping_time" for beam in crank.beams]
    for time in times[:-1]:
        label = f"slider-crank, {time:g} s, step 2^-7 s"
        scene = crank.with_values(dict.fromkeys(damping, time))
        cases.append(against_sixteenth(label, scene, "rod", 2.0**-7, 8 if quick else 32))
    return cases


def first_steps(quick: bool) -> list[Case]:
    """Release a stiff damped beam, whose short waves the first step has to catch."""
    scene = pendulum(youngs_modulus=2e11, damping_time=1e-3)

    def error(run: Solution) -> float:
        t_end = float(run.t[-1])
        fine = simulate(scene, t_end, HHT(t_end / 256, hht_alpha=-0.05))
        if not fine.outcome.success:
            return np.inf
        apart = [
            run.position(MaterialPoint("pendulum", s))
            - fine.position(MaterialPoint("pendulum", s))[-1]
            for s in (0.5, 1)
        ]
        return float(max(np.max(np.abs(x[-1])) for x in apart)) / 1.2

    chosen = [(7, 1, -0.1), (8, 1, -0.3), (9, 1, -0.3)]
    if not quick:
        chosen += [(6, 1, -0.1), (7, 1, -0.05), (7, 4, -0.1), (8, 4, -0.05), (9, 4, -0.3)]
    return [
        Case(
            f"{steps} step{'s' * (steps > 1)} of 2^-{k} s, hht_alpha = {alpha}",
            lambda: scene,
            2.0**-k,
            steps,
            alpha,
            error,
            in_time=True,
        )
        for k, steps, alpha in sorted(chosen)
    ]
