"""The kernel takes and controls steps of Radau IIA as dense matrices in Python do."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    AdaptiveSteps,
    Beam,
    ComplexStep,
    Material,
    Pin,
    PrescribedSteps,
    Radau,
    RigidBody,
    RigidBox,
    RotationDriver,
    Scene,
    assemble,
    differentiate,
)
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.stages import Control
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Reached
from ancfdae.kernels import judge_step, plan_step
from ancfdae.laws import ConstantAcceleration
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from tests.support.controlled_motions import (
    called_pendulum,
    driven_crank,
    kicked_pendulum,
    soft_pendulum,
)
from tests.support.mechanisms import GuidedDoublePendulum
from tests.support.radau_reference import dense_run


def listed_pendulum():
    return GuidedDoublePendulum(), 0.5


def damped_rope():
    """A rope of rubber, whose forces depend on velocities, driven by nothing."""
    rubber = Material(1100.0, 5e4, 0.3, damping_time=0.1)
    rod = Beam("rod", (0, 0), (1.0, 0.2), 2, Rectangle(0.02, 0.02), rubber)
    scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81), project_start=True)
    return assemble(scene, ["rod.height"]), 0.3


SYSTEMS = [
    soft_pendulum,
    driven_crank,
    kicked_pendulum,
    damped_rope,
    called_pendulum,
    listed_pendulum,
]


@pytest.mark.parametrize("rtol", [1e-2, 1e-3])
@pytest.mark.parametrize("made", SYSTEMS)
def test_the_kernel_takes_the_steps_of_dense_matrices(made, rtol):
    system, t_end = made()
    ours, theirs = (
        run(system, t_end, AdaptiveSteps(rtol))
        for run in (lambda *_: Radau(AdaptiveSteps(rtol)).integrate(system, t_end), dense_run)
    )
    assert ours.outcome.success
    for name in ("steps", "rejected"):
        assert getattr(ours.statistics, name) == getattr(theirs.statistics, name)
    # The round-off of stages is amplified in the estimate of an error, and the filter follows it.
    np.testing.assert_allclose(ours.t, theirs.t, rtol=0, atol=1e-8 * t_end)
    for name, share in (("q", 1e-8), ("v", 1e-7), ("a", 1e-6), ("lam", 1e-6)):
        x, y = getattr(ours, name), getattr(theirs, name)
        np.testing.assert_allclose(x, y, rtol=0, atol=share * np.max(np.abs(y)), err_msg=name)


@pytest.mark.parametrize("made", [kicked_pendulum, driven_crank])
def test_long_known_steps_are_solved_by_way_of_shorter_ones(made):
    """Newton's method alone does not solve a third of the run; derivatives need the solution."""
    system, t_end = made()
    run = differentiate(system, t_end, Radau(t_end / 3))
    assert run.outcome.success
    assert run.statistics.continued >= 1
    assert run.statistics.rejected == 0
    check = differentiate(system, t_end, Radau(t_end / 3), method=ComplexStep())
    assert check.statistics.continued == run.statistics.continued
    for name in ("q_b", "v_b", "a_b", "lam_b"):
        x, y = (getattr(each.sensitivities, name) for each in (run, check))
        np.testing.assert_allclose(x, y, rtol=0, atol=1e-8 * np.max(np.abs(y)), err_msg=name)


def test_the_cost_of_a_step_that_is_not_solved_counts_once():
    system, t_end = listed_pendulum()
    runs = [Radau(step, max_iterations=1) for step in (t_end, t_end / 2)]
    one, two = (run.integrate(system, t_end) for run in runs)
    assert one.outcome.verdict is two.outcome.verdict is Verdict.NO_CONVERGENCE
    # One iteration for the step and each of its parts, 1/4 to 4^-5.
    assert one.statistics.iterations == two.statistics.iterations == 6


def scripted(count):
    """Errors of tries: the step after `count` accepted ones is rejected twice with nearly the same.

    The step before is then repeated, and the one before that; the first happens once more.
    """
    yield from [0.9] * count
    yield from (3.0, 2.9, 0.9, 0.3, 0.9, 3.0, 2.9, 0.3)
    while True:
        yield 0.9


def taken_by_the_filter(controller, numbers, most, errors):
    """Return (size, end) of all tries, and ends of accepted steps, by the calls for one step."""
    ends, tries, n = [0.0], [], 0
    while len(ends) <= most:
        _, h, end = plan_step(numbers, controller.stops, ends[-1])
        tries.append((h, end))
        judged = judge_step(numbers, n, ends[-1], h, next(errors))
        ends = [*ends, end] if judged > n else ends[: judged + 1]
        n = judged
    return tries, ends[1:]


@pytest.mark.parametrize("integrator", [HHT(rtol=1e-2), Radau(rtol=1e-2)], ids=repr)
def test_the_loop_takes_steps_back_as_the_filter_says(integrator):
    """Errors along with the motion are prescribed; errors of the motion itself are far below."""
    system, t_end, most, tries = GuidedDoublePendulum(), 0.05, 24, []
    problem = InitialValueProblem.of(system, t_end)
    recorder = SolutionRecorder(system, 100, integrator.degree)
    stepper = integrator._stepper(problem, t_end, np.zeros(0), recorder)
    controller = integrator.steps.controller(t_end, stepper)
    h = controller.plan(0, 0.0)[0]
    expected, ends = taken_by_the_filter(controller, controller.numbers.copy(), most, scripted(18))
    begin, errors = Reached(0, 0.0, h, stepper.start(h)), scripted(18)
    recorder.record(*stepper.consistent())
    q = recorder.room(integrator.degree * most)[0]
    if isinstance(integrator, Radau):
        control = Control(controller.numbers, controller.stops, np.zeros(0), np.zeros(0))

        def along(h, end):
            tries.append((h, end))
            return next(errors)

        found = stepper._solver.march(begin, control, most, stepper._bounds, None, along)[0]
    else:
        d, scales, tolerance = system.vector_size, problem.scales, stepper._tolerance
        bounds = tolerance.rtol, tolerance.atol * tolerance.sizes, scales.place, d

        def along(node, h):
            tries.append((h, node.t))
            return next(errors)

        begin = begin._replace(now=begin.now[0])
        found = stepper._solver.controlled(begin, controller, bounds, None, most, along)
    np.testing.assert_array_equal(found.ends, ends)
    np.testing.assert_array_equal(tries, expected)
    assert recorder.rejected == len(tries) - most
    known = integrator.with_steps(PrescribedSteps((0.0, *ends))).integrate(system, ends[-1])
    size = np.max(np.abs(known.q - known.q[0]))
    np.testing.assert_allclose(q, known.q[1:], rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("integrator", [HHT(rtol=1e-2), Radau(rtol=1e-2)], ids=repr)
def test_a_step_turns_a_driver_by_one_radian_at_most(integrator):
    """The angle is 30 t^2, so that a step of h to t turns by 60 t h at the largest rate."""
    crank = RigidBody("crank", (0.1, 0), shape=RigidBox(0.2, 0.04, 0.02), density=2700.0)
    law = ConstantAcceleration(0.0, acceleration=60.0)
    joints = [Pin(crank.at(-0.1)), RotationDriver(crank.at(-0.1), law, name="motor")]
    run = integrator.integrate(assemble(Scene([], joints, bodies=[crank])), 1.0)
    assert run.outcome.success
    t = run.t[:: integrator.degree]
    assert np.max(60 * t[1:] * np.diff(t)) <= 1 + 1e-9
