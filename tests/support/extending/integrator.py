"""An integrator: the symplectic Euler method, with direct differentiation and its adjoint."""

from dataclasses import dataclass, replace

import numpy as np

from ancfdae import Beam, Material, Pin, RigidBody, RotationDriver, Scene, SpringDamper
from ancfdae.extend import AdjointIntegrator, InitialValueProblem, SolutionRecorder, stacked
from ancfdae.laws import Harmonic
from ancfdae.observables import position
from ancfdae.results import RunOutcome, Verdict
from ancfdae.sections import Rectangle

TINY = 1e-40


@dataclass(frozen=True)
class SymplecticEuler(AdjointIntegrator):
    """v moves by h a(t, q, v), then q by h v; for short runs: nothing keeps q on the joints."""

    steps: int

    order = 1

    def refined(self, solution):
        return replace(self, steps=2 * self.steps)

    def integrate(self, system, t_end, *, sensitivities=False, progress=False):
        problem, h, n = InitialValueProblem.of(system, t_end), t_end / self.steps, system.n_q
        recorder = SolutionRecorder(system, self.steps + 1, sensitivities=sensitivities)
        q, v = stacked(problem.initial.q, problem.initial.v)
        if sensitivities:
            slopes = problem.differentiated().derivative
            q, v = stacked(q[0], v[0], slopes.q_b, slopes.v_b)
        # Below the state its design derivatives, which move by the same rule.
        for k in range(self.steps + 1):
            x = problem.accelerations.rows(k * h, q, v)
            rows = q, v, x[:, :n], x[:, n:]
            slopes = tuple(row[1:].T for row in rows) if sensitivities else ()
            recorder.record(k * h, *(row[0] for row in rows), slopes)
            v = v + h * x[:, :n]
            q = q + h * v
        return recorder.solution(RunOutcome(Verdict.FINISHED, t_end, self.steps, 0.0))

    def pull_back(self, system, solution, seeds, progress=False):
        problem = InitialValueProblem.of(system, solution.t[-1]).differentiated()
        h, gradient = solution.t[-1] / self.steps, np.zeros(system.n_b)
        on_q, on_v = np.zeros((2, system.n_q))
        seed_q, seed_v, seed_lam = (
            np.zeros_like(states) if seed is None else seed
            for seed, states in (
                (seeds.q, solution.q),
                (seeds.v, solution.v),
                (seeds.lam, solution.lam),
            )
        )
        for k in reversed(range(self.steps + 1)):
            on_v = on_v + h * on_q
            on_x = np.concatenate([h * on_v, seed_lam[k]])
            by_q, by_v, by_b = partials(problem, k * h, solution.q[k], solution.v[k])
            on_q = on_q + on_x @ by_q + seed_q[k]
            on_v = on_v + on_x @ by_v + seed_v[k]
            gradient += on_x @ by_b
        return gradient + on_q @ problem.derivative.q_b + on_v @ problem.derivative.v_b


def partials(problem, t, q, v):
    """Partials of (a, lam) in q and v, by complex steps, and in b."""
    steps = 1j * TINY * np.eye(len(q))
    solve = problem.accelerations.solve
    by_q = [np.concatenate(solve(t, q + step, v)).imag / TINY for step in steps]
    by_v = [np.concatenate(solve(t, q, v + step)).imag / TINY for step in steps]
    still = np.zeros((len(q), problem.system.n_b))
    return (
        np.transpose(by_q),
        np.transpose(by_v),
        problem.accelerations.rows(t, *stacked(q, v, still, still))[1:].T,
    )


rod = Beam("rod", (0, 0), (0.6, 0.2), 1, Rectangle(0.05, 0.05), Material(2000, 1e5, 0.3))
wheel = RigidBody("wheel", (0, 0), mass=1.0, inertia=0.05)
joints = [
    Pin(wheel.at(0, 0), name="axle"),
    Pin(rod.at_start, wheel.at(0, 0), name="hinge"),
    RotationDriver(wheel.at(0, 0), Harmonic(0.3, 5.0), name="motor"),
]
spring = SpringDamper(rod.at(0.6), 40.0, 2.0, 0.3, wheel.at(0.0, 0.2), name="spring")
SCENE = Scene([rod], joints, (0, -9.81), loads=[spring], bodies=[wheel], project_start=True)
DESIGN = ["rod.density", "rod.length", "motor.amplitude", "spring.damping", "spring.stiffness"]
OBSERVABLE, END, INTEGRATOR = position(rod.at_end, 1), 0.02, SymplecticEuler(64)
