"""Radau IIA: orders, exact gradients both ways, stiff beams, error control, failures."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    IDA,
    AdaptiveSteps,
    Adjoint,
    AtTimes,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    Distance,
    Evaluator,
    FiniteDifference,
    FixedSteps,
    Integral,
    Material,
    Misfit,
    Pin,
    PointOnLine,
    PrescribedSteps,
    Radau,
    Responses,
    RotationDriver,
    Scene,
    Terminal,
    TranslationDriver,
    assemble,
    differentiate,
    error_bars,
    estimate_adjoint_error,
    gradient,
    record_observables,
    simulate,
    sweep,
    taylor_test,
    work_precision,
)
from ancfdae.equations import saddle_points as prepared
from ancfdae.equations import system as equations_of_systems
from ancfdae.equations.system import called_plan
from ancfdae.errors import InvalidInputError
from ancfdae.extend import FormulaSystem, MaterialPoint
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.stages import BUTCHER, EMBEDDED, GAMMA, PLACES, Control
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Reached
from ancfdae.laws import Harmonic
from ancfdae.model import loads
from ancfdae.model.loads.load import Load
from ancfdae.observables import custom, position, velocity
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.method import UnfinishedRunError
from ancfdae.sensitivity.observables.quantities import multiplier as link_force
from tests.support.examples import all_examples
from tests.support.mechanisms import CartesianPendulum
from tests.support.radau_reference import DenseRadau
from validation.external.slider_crank import SliderCrank
from validation.scenes import crank_slider, pendulum

STATES = ("q", "v", "a", "lam")
OF_B = ("q_b", "v_b", "a_b", "lam_b")
NAN = float("nan")


def states(run):
    """States and their derivatives by name."""
    own = run.sensitivities
    return {x: getattr(run, x) for x in STATES} | {x: getattr(own, x) for x in OF_B if own}


def assert_close(run, reference, share, rows=slice(None)):
    """Compare all states and derivatives, relative to the largest of each."""
    theirs = states(reference)
    for name, x in states(run).items():
        bound = share * np.max(np.abs(theirs[name]))
        np.testing.assert_allclose(x[rows], theirs[name][rows], rtol=0, atol=bound, err_msg=name)


END = slice(-1, None)


def everything(t, q, v, lam, b):
    return q[:, 0] ** 2 + 0.1 * v[:, 1] * lam[:, 0] + b[0] * q[:, 1]


def multiplier(t, q, v, lam, b):
    return lam[:, 0]


def speed(t, q, v, lam, b):
    return v[:, 0]


OBJECTIVE = (
    Integral(custom(everything, "all"))
    + Terminal(custom(multiplier, "lam"))
    + AtTimes(custom(speed, "v_x"), (0.37, 0.5))
)


# ---------------------------------------------------------------- the tableau


def test_coefficients_meet_the_order_conditions():
    c, b = PLACES[:, 0], BUTCHER[2]
    for k in range(1, 6):  # B(5), C(3): collocation at the Radau points.
        assert b @ c ** (k - 1) == pytest.approx(1 / k, rel=1e-14)
    for k in range(1, 4):
        np.testing.assert_allclose(BUTCHER @ c ** (k - 1), c**k / k, rtol=1e-13)
    np.testing.assert_allclose(EMBEDDED @ c, [-1.0], rtol=1e-13)
    # Of order 3: what is estimated vanishes for q up to t^3, with q' at the start.
    for k in (2, 3):
        assert EMBEDDED[0] @ c**k == pytest.approx(0.0, abs=1e-13)


def test_the_real_eigenvalue():
    assert pytest.approx(3.637834252744496, rel=1e-14) == GAMMA  # Hairer & Wanner, IV.8


class Pushed(FormulaSystem):
    """A mass with x'' = c + k (t^2 - t/2)."""

    n_q, n_lam, design_names = 1, 0, ("c", "k")

    def with_values(self, b):
        return type(self)(b)

    def position_constraint(self, t, q):
        return np.zeros(0)

    def mass_matrix(self, q):
        return np.array([[2.0]])

    def force(self, t, q, v):
        return np.array([2 * (self.b[0] + self.b[1] * (t**2 - t / 2))])

    def start(self):
        return np.array([0.3]), np.array([0.7])


@pytest.mark.parametrize("k", [0.0, 1.0])
def test_velocities_that_are_cubics_are_guessed_exactly(k):
    """One correction is round-off, also where the step changes.

    In the first step the guess is the acceleration at the start.
    """
    steps = PrescribedSteps((0, 0.1, 0.2, 0.35, 0.4, 0.7))
    run = Radau(steps, newton_tolerance=1e-9).integrate(Pushed((1.0, k)), 0.7)
    assert run.statistics.iterations == 5 + (k > 0)
    t = run.t[::3]
    exact = 0.3 + 0.7 * t + t**2 / 2 + k * (t**4 / 12 - t**3 / 12)
    np.testing.assert_allclose(run.q[::3, 0], exact, rtol=1e-13)


# ---------------------------------------------------------------- orders


def orders(runs, read):
    values = [read(run) for run in runs]
    changes = [np.max(np.abs(x - y[::2])) for x, y in itertools.pairwise(values)]
    return np.log2(np.divide(changes[:-1], changes[1:]))


@pytest.mark.parametrize(
    ("system", "first"), [(CartesianPendulum(-1.0, 2.0), 4), (SliderCrank(), 3)]
)
def test_order_five_in_all_states_and_their_derivatives(system, first):
    """At the ends of steps; without the projection v has order 3, a and lam 2."""
    runs = [differentiate(system, 1.0, Radau(2.0**-k)) for k in range(first, first + 3)]
    for name in (*STATES, *OF_B):
        observed = orders(runs, lambda run, name=name: states(run)[name][::3])
        assert abs(observed[-1] - 5) < 0.05, (name, observed)


def test_integrals_have_order_five_and_what_lies_between_instants_four():
    """The stages are a quadrature of order 5; a cubic through them interpolates."""
    system = CartesianPendulum(-1.0, 2.0)
    for objective, order in (
        (Integral(custom(everything, "all")), 5),
        (Terminal(custom(multiplier, "lam")), 5),
        (AtTimes(custom(speed, "v_x"), 1 / 3), 4),
    ):
        found = [gradient(system, objective, 1.0, Radau(2.0**-k)) for k in (4, 5, 6)]
        values = np.array([[each.value, *each.gradient] for each in found])
        changes = np.abs(np.diff(values, axis=0))
        assert np.all(np.log2(changes[0] / changes[1]) > order - 0.25), objective


def test_a_shorter_run_has_shorter_steps_of_the_same_order():
    runs = [simulate(CartesianPendulum(-1.0, 2.0), 0.9, Radau(2.0**-k)) for k in (4, 5, 6)]
    assert [len(run.t[::3]) - 1 for run in runs] == [15, 29, 58]
    exact = simulate(CartesianPendulum(-1.0, 2.0), 0.9, Radau(0.9 / 256))
    errors = [np.abs(run.lam[-1] - exact.lam[-1])[0] * len(run.t) ** 5 for run in runs]
    assert max(errors) < 1.3 * min(errors)


# ---------------------------------------------------------------- against other integrators


def test_it_agrees_with_the_explicit_integrator():
    system = SliderCrank()
    run = differentiate(system, 1.0, Radau(2.0**-6))
    # Of h^5 are left 4e-13 in states and 3e-12 in derivatives; the reference errs by 1e-10.
    assert_close(run, differentiate(system, 1.0, DOP853(1e-11)), 1e-9, END)


def test_it_agrees_with_ida_on_a_beam():
    scene = pendulum(elements=1, youngs_modulus=1e6)
    ours = simulate(scene, 0.1, Radau(0.1 / 256))
    theirs = simulate(scene, 0.1, IDA(1e-10))
    np.testing.assert_allclose(ours.q[-1], theirs.q[-1], rtol=0, atol=1e-8)  # 4e-10 seen.


def stiff(elements=2):
    scene = pendulum(elements=elements, youngs_modulus=2e11, damping_time=1e-3)
    return assemble(scene, ("pendulum.height", "pendulum.density"))


def test_stiff_damped_beams_take_large_steps():
    """Axial waves last 1e-5 s and decay in 1e-3 s: 32 steps a second reach 1e-4."""
    system, tip = stiff(), position(MaterialPoint("pendulum", 1.0), 1)
    found = [gradient(system, Integral(tip**2), 1.0, Radau(2.0**-k)).gradient[0] for k in (5, 6, 9)]
    coarse, fine = (abs(x / found[2] - 1) for x in found[:2])
    assert coarse < 1e-4
    assert fine < 4e-6


def test_orders_fall_where_waves_are_much_faster_than_the_step():
    """Stage orders, 3 of q and 2 of forces, show; axial waves of 2e-5 s, steps of 3e-2 s."""
    system = assemble(pendulum(elements=1, youngs_modulus=2e11, damping_time=1e-3))
    runs = [simulate(system, 0.5, Radau(2.0**-k)) for k in (5, 6, 7, 11)]
    errors = [
        (np.max(np.abs(run.q[-1] - runs[-1].q[-1])), np.max(np.abs(run.lam[-1] - runs[-1].lam[-1])))
        for run in runs[:3]
    ]
    in_q, in_lam = np.log2(np.divide(errors[0], errors[2])) / 2
    assert 3.0 < in_q < 4.5  # Measured 3.6.
    assert 1.7 < in_lam < 2.7  # Measured 2.2.


# ---------------------------------------------------------------- gradients


@pytest.mark.parametrize("steps", [FixedSteps(1 / 16), PrescribedSteps((0.0, 0.1, 0.4, 0.45, 1.0))])
@pytest.mark.parametrize("system", [CartesianPendulum(-1.0, 2.0), SliderCrank()])
def test_direct_adjoint_and_complex_step_agree(system, steps):
    methods = DirectDifferentiation(), Adjoint(), ComplexStep()
    found = [gradient(system, OBJECTIVE, 1.0, Radau(steps), method=each) for each in methods]
    for each in found[1:]:
        np.testing.assert_allclose(each.gradient, found[0].gradient, rtol=1e-11)
        assert each.value == pytest.approx(found[0].value, rel=1e-13)


def test_they_agree_on_a_mechanism_of_beams():
    names = ("rod.height", "rod.density", "rod.youngs_modulus")
    system = assemble(crank_slider(), names)
    objective = Terminal(velocity(MaterialPoint("rod", 0.5), 1)) + Integral(
        position(MaterialPoint("rod", 1.0), 0)
    )
    found = [
        gradient(system, objective, 2.0**-5, Radau(2.0**-8), method=each).gradient * system.b
        for each in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    # Round-off of stiff beams: 1e-16 of strains of order one in strains of 1e-5.
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=0, atol=1e-11 * max(abs(found[0])))


def test_they_agree_where_the_design_moves_joints_that_act_on_velocities():
    """(Phi')_b = n_b . v of a slot's direction; (Phi'')_b of a link's length contains |v|^2."""
    crank = Beam("crank", (0, 0), (0.2, 0), 1, Rectangle(0.02, 0.02), RUBBER, rigid=True)
    rod = Beam("rod", (0.2, -0.3), (0.5, -0.4), 1, Rectangle(0.02, 0.02), RUBBER, rigid=True)
    motor = RotationDriver(crank.at_start, Harmonic(0.4, 9.0), name="motor")
    link = Distance(crank.at_end, 0.3, rod.at_start, name="link")
    slot = PointOnLine(rod.at_start, (0.3, 1.0), name="slot")
    joints = [Pin(crank.at_start), motor, link, slot]
    scene = Scene([crank, rod], joints, (0, -9.81), project_start=True)
    system = assemble(scene, ["motor.frequency", "slot.direction_x", "link.length", "rod.length"])
    objective = Terminal(velocity(rod.at_end, 1)) + Integral(link_force("link", 0) ** 2)
    found = [
        gradient(system, objective, 0.5, Radau(0.05), method=each).gradient
        for each in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-10)


def test_a_gradient_is_the_limit_of_differences():
    system, integrator = CartesianPendulum(-1.0, 2.0), Radau(0.07)
    ours = gradient(system, OBJECTIVE, 1.0, integrator).gradient
    central = FiniteDifference(1e-5, central=True)
    check = gradient(system, OBJECTIVE, 1.0, integrator, method=central).gradient
    # Differences err by 1e-10 times the third derivative, and by round-off of 1e-13 / 1e-5.
    np.testing.assert_allclose(ours, check, rtol=1e-7)


def test_every_state_has_the_derivative_of_the_complex_step():
    system = CartesianPendulum(-1.0, 2.0)
    check = differentiate(system, 1.0, Radau(0.1), method=ComplexStep())
    assert_close(differentiate(system, 1.0, Radau(0.1)), check, 1e-11)


def test_a_rough_tolerance_leaves_little_of_the_imaginary_part():
    # The step is long and its matrix old: two iterations with it would leave 2e-9 of accelerations,
    # with the matrix of the solution they leave what the tolerance leaves of the real part, 5e-10.
    beam = pendulum().beams[0]
    system = assemble(pendulum(), [f"{beam.name}.height"])
    integrator = Radau(0.125, newton_tolerance=1e-10)
    ours, check = (
        differentiate(system, 0.25, integrator, method=method).sensitivities.a_b
        for method in (DirectDifferentiation(), ComplexStep())
    )
    assert np.max(np.abs(ours - check)) < 1e-9 * np.max(np.abs(ours))


# ---------------------------------------------------------------- the kernel


def assert_same_by_the_kernel(scene, t_end=2.0**-8, **settings):
    """Stages with equations of the kernel and of Python; round-off of elastic forces."""
    system, integrator = assemble(scene), Radau(**(settings or {"step": 2.0**-9}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(equations_of_systems, "called_plan", None)
        fast = simulate(system, t_end, integrator)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prepared, "planned", called_plan)
        slow = simulate(system, t_end, integrator)
    assert fast.outcome.verdict is slow.outcome.verdict is Verdict.FINISHED
    root, inertia = np.sqrt(system.weights), np.max(np.abs(slow.a * system.weights))
    assert abs(fast.statistics.iterations - slow.statistics.iterations) <= len(fast.t)
    for name, factor in (("t", 1), ("q", root), ("v", root), ("a", root)):
        x, y = (getattr(run, name) * factor for run in (fast, slow))
        assert np.max(np.abs(x - y)) <= 2e-9 * np.max(np.abs(y)), name
    assert np.max(np.abs(fast.lam - slow.lam)) <= 2e-9 * max(inertia, np.max(np.abs(slow.lam)))


# So much damping that a wrong f_v does not converge.
RUBBER = Material(1100.0, 5e4, 0.3, damping_time=0.1)


def rods(d):
    """Two rods in the plane or in space."""
    z, section = (0.2,) * (d - 2), Rectangle(0.05, 0.04)
    rod = Beam("rod", (0.1, 0.2, *z), (0.9, 0.7, *z), 2, section, RUBBER)
    return rod, Beam("arm", (0.9, 0.7, *z), (1.5, 0.4, *z), 1, section, RUBBER)


@pytest.mark.parametrize("d", [2, 3])
def test_every_load_is_the_same_in_the_kernel(d):
    members = rods(d)
    points = members[1].at(0.4), members[0].at(0.8)
    for load in all_examples(loads, Load, members, points).values():
        # Gravity moves what a load leaves at rest.
        gravity = (0.0, -9.81, 0.0)[:d]
        scene = Scene(members, [Clamp(members[0].at_start)], gravity, loads=[load])
        assert_same_by_the_kernel(replace(scene, project_start=True))


def test_joints_that_move_are_the_same_in_the_kernel():
    rod, arm = rods(2)
    held = [
        Pin(rod.at_start),
        Pin(rod.at_end, arm.at_start),
        RotationDriver(rod.at_start, Harmonic(0.5, 4)),
    ]
    held.append(TranslationDriver(arm.at_end, (0.6, 0.8), Harmonic(0.01, 9)))
    assert_same_by_the_kernel(Scene([rod, arm], held, (0, -9.81), project_start=True))


def test_controlled_steps_of_a_closed_loop_are_the_same_in_the_kernel():
    assert_same_by_the_kernel(crank_slider(), 2.0**-6, rtol=1e-3)


# ---------------------------------------------------------------- error control


@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-7])
def test_the_tolerance_bounds_the_error(rtol):
    system = CartesianPendulum(-1.0, 2.0)
    run = simulate(system, 1.0, Radau(rtol=rtol))
    exact = simulate(system, 1.0, DOP853(1e-13))
    for name in ("q", "v"):
        error = np.max(np.abs(getattr(run, name)[-1] - getattr(exact, name)[-1]))
        assert 1e-3 * rtol < error / np.max(np.abs(getattr(exact, name))) < 3 * rtol


def test_derivatives_under_control():
    system, steps = CartesianPendulum(-1.0, 2.0), AdaptiveSteps(1e-4, sensitivities=True)
    run = differentiate(system, 1.0, Radau(steps))
    frozen = Radau(steps).frozen(run)
    check = differentiate(system, 1.0, frozen, method=ComplexStep())
    np.testing.assert_array_equal(run.t, check.t)
    assert_close(run, check, 1e-10)
    assert_close(run, differentiate(system, 1.0, DOP853(1e-10)), 3e-4, END)


@pytest.mark.parametrize("atol", [1e-9, 1e-7])
def test_the_error_of_derivatives_is_relative_to_their_own_sizes(atol):
    """e = 2 max_j rms_i(delta_ij / (0.05 (rtol |x_ij| + atol X_i S_j)^(4/5))), of q_b and of v_b.

    Of a pendulum of 1 kg m in 0.1 s sizes of q_b and v_b differ by factors of ten.
    """
    system, t_end, S = CartesianPendulum(-1.0, 2.0), 2.0, np.array([3.0, 0.5, 2.0, 1.0])
    problem, rtol = InitialValueProblem.of(system, t_end).differentiated(), 1e-7
    integrator = Radau(AdaptiveSteps(rtol, atol=atol, sensitivities=True))
    S = S[: system.n_b]
    stepper = integrator._stepper(problem, t_end, S, SolutionRecorder(system, 9, 3, True))
    h, reference = 0.1, DenseRadau(system, t_end, rtol, None)
    before, step, none = stepper.start(h), np.array([h]), np.zeros(0)
    begin, control = Reached(0, 0.0, h, before), Control(none, none, step, step)
    found, e = stepper._controlled(begin, control, 1)
    after, middle = found.states(1), [x[2] for x in found.states(1).rows]

    def defects(q, v, a):
        x = (q[1:] - q[0] - h * PLACES * v[0]) / h**2
        return reference.defects(h, middle, v, a[0], x)

    own, of_b = defects(*after.rows[1:4]), [[], []]
    for j in range(system.n_b):
        for to, defect in zip(
            of_b, defects(*(x[..., j] for x in after.derivatives[:3])), strict=True
        ):
            to.append(defect)
    parts = []
    for k, scale in enumerate((problem.scales.q, problem.scales.v)):
        share = 0.05 * np.array([rtol, atol]) ** 0.8
        size = np.maximum(*np.abs(after.rows[1 + k][[0, -1]]))
        motion = own[k] / (share[0] * size + share[1] * scale)
        size_b = np.abs(after.derivatives[k][-1])
        derivatives = np.array(of_b[k]).T / (share[0] * size_b + share[1] * np.outer(scale, S))
        parts += [np.sqrt(np.mean(motion**2)), 2 * np.sqrt(np.max(np.mean(derivatives**2, 0)))]
    # Round-off that is added to the tolerance: 1e-16 / (0.05 (1e-7)^(4/5)) = 1e-9 of it, and the
    # tenfold where it is divided by h.
    assert e == pytest.approx(max(parts), rel=1e-6)
    assert max(parts) in parts[1::2]  # Derivatives decide here.


def test_round_off_is_allowed_beside_the_tolerance():
    """The round-off of positions, eps (|q| + Q), and of velocities, the same over h, is allowed.

    The scale Q is made so large that this decides.
    """
    system, t_end, h = CartesianPendulum(-1.0, 2.0), 2.0, 0.1
    problem, steps = InitialValueProblem.of(system, t_end), AdaptiveSteps(1e-7)
    stepper = Radau(steps)._stepper(problem, t_end, np.zeros(0), SolutionRecorder(system, 9, 3))
    *bounds, _, d = stepper._bounds
    stepper.__dict__["_bounds"] = *bounds, np.full(system.n_q, 1e10), d
    step, none, begin = np.array([h]), np.zeros(0), Reached(0, 0.0, h, stepper.start(h))
    found, e = stepper._controlled(begin, Control(none, none, step, step), 1)
    t, q, v, a, lam = found.states(1).rows
    x, middle = (q[1:] - q[0] - h * PLACES * v[0]) / h**2, (t[2], q[2], v[2], a[2], lam[2])
    defects = DenseRadau(system, t_end, 1e-7, None).defects(h, middle, v, a[0], x)
    share, eps, parts = 0.05 * 1e-7**0.8, np.finfo(float).eps, []
    for k, (states, scale) in enumerate(((q, problem.scales.q), (v, problem.scales.v))):
        size = np.maximum(*np.abs(states[[0, -1]] - (problem.scales.place if k == 0 else 0.0)))
        blur = eps * (np.abs(q[-1]) + 1e10) / h**k
        parts.append(np.sqrt(np.mean((defects[k] / (share * (size + scale) + blur)) ** 2)))
        assert np.min(blur) > 10 * np.max(share * (size + scale))
    assert e == pytest.approx(max(parts), rel=1e-6)


def test_frozen_steps_repeat_a_controlled_run():
    system, integrator = CartesianPendulum(-1.0, 2.0), Radau(rtol=1e-4)
    run = simulate(system, 1.0, integrator)
    again = simulate(system, 1.0, integrator.frozen(run))
    np.testing.assert_array_equal(run.t, again.t)
    np.testing.assert_allclose(run.q, again.q, rtol=1e-12)
    assert len(simulate(system, 1.0, integrator.refined(run)).t) == 2 * len(run.t) - 1


@pytest.mark.parametrize(("integrator", "share"), [(Radau(0.1), 1e-12), (Radau(rtol=1e-4), 1e-3)])
def test_a_run_goes_on_as_in_one_go(integrator, share):
    system = CartesianPendulum(-1.0, 2.0)
    first = simulate(system, 0.5, integrator)
    both = simulate(system, 1.0, integrator, after=first)
    np.testing.assert_array_equal(both.q[: len(first.t)], first.q)
    # Controlled steps change with the end time.
    assert_close(both, simulate(system, 1.0, integrator), share, END)


# ---------------------------------------------------------------- small steps, other units


def test_round_off_of_small_steps():
    """Positions know their constraints to 1e-16, accelerations to that over h^2: none is kept."""
    system = CartesianPendulum(-1.0, 2.0)
    run, exact = (simulate(system, 1e-4, x) for x in (Radau(1e-6), DOP853(1e-12)))
    # Round-off of 100 steps, 1e-16 each.
    assert_close(run, exact, 1e-12, END)


# ---------------------------------------------------------------- failures


def test_forces_that_are_no_number_are_an_outcome():
    class Breaking(CartesianPendulum):
        def force(self, t, q, v):
            return super().force(t, q, v) * (NAN if t > 0.3 else 1.0)

    run = simulate(Breaking(-1.0, 2.0), 1.0, Radau(0.1))
    assert run.outcome.verdict is Verdict.NOT_FINITE
    assert "not finite" in str(run.outcome)
    assert run.t[-1] == pytest.approx(0.3) or run.t[-1] == pytest.approx(0.2)
    assert len(run.t) == 3 * run.statistics.steps + 1
    with pytest.raises(UnfinishedRunError, match="not finite"):
        gradient(Breaking(-1.0, 2.0), Terminal(custom(speed, "v_x")), 1.0, Radau(0.1))


def test_a_singular_configuration_is_an_outcome():
    class DeadPoint(CartesianPendulum):
        """The row of the constraint vanishes from t = 0.3 on."""

        def constraint_q(self, t, *motion):
            return super().constraint_q(t, *motion) * (0.0 if t > 0.3 else 1.0)

    run = simulate(DeadPoint(-1.0, 2.0), 1.0, Radau(0.1))
    assert run.outcome.verdict in (Verdict.SINGULAR, Verdict.NO_CONVERGENCE)
    assert not run.outcome.success


def test_steps_that_newtons_method_does_not_solve_are_an_outcome():
    run = simulate(stiff(1), 4.0, Radau(2.0, max_iterations=3))
    assert run.outcome.verdict is Verdict.NO_CONVERGENCE
    assert "did not converge" in str(run.outcome)


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda: Radau(), "Radau"),
        (lambda: Radau(0.1, rtol=1e-3), "Radau"),
        (lambda: Radau(step=-1.0), "Radau.step"),
        (lambda: Radau(rtol=NAN), "Radau.rtol"),
        (lambda: Radau(0.1, newton_tolerance=0.0), "Radau.newton_tolerance"),
        (lambda: Radau(0.1, max_iterations=0), "Radau.max_iterations"),
        (lambda: simulate(CartesianPendulum(-1.0, 2.0), NAN, Radau(0.1)), "t_end"),
    ],
)
def test_bad_settings_are_refused(make, where):
    with pytest.raises(InvalidInputError) as caught:
        make()
    assert where in caught.value.where


def test_statistics_count_what_was_done():
    run = simulate(CartesianPendulum(-1.0, 2.0), 1.0, Radau(0.1))
    told = run.statistics
    assert told.steps == 10
    assert told.residuals == 3 * told.iterations
    # One of all stages, and one at each stage for its completion.
    assert told.factorisations >= 4 * told.steps
    assert told.rejected == told.continued == 0


# ---------------------------------------------------------------- in other calls


def test_bars_of_three_levels_see_order_five():
    system, objective = CartesianPendulum(-1.0, 2.0), Terminal(custom(speed, "v_x"))
    bars = error_bars(system, objective, 1.0, Radau(0.1), levels=3)
    exact = gradient(system, objective, 1.0, DOP853(1e-11))
    np.testing.assert_allclose(bars.orders, 5.0, atol=0.05)
    assert np.all(np.abs(bars.gradient - exact.gradient) < bars.gradient_bar)


KNOWN = FixedSteps(1 / 32), PrescribedSteps(tuple(np.linspace(0, 1, 33) ** 1.3))


@pytest.mark.parametrize("steps", KNOWN)
@pytest.mark.parametrize(("memory", "repeats"), [("3 kB", True), ("1 MB", False)])
def test_the_adjoint_within_a_limit_of_memory(steps, memory, repeats):
    system, integrator = CartesianPendulum(-1.0, 2.0), Radau(steps)
    all_kept = gradient(system, OBJECTIVE, 1.0, integrator, method=Adjoint())
    in_parts = gradient(system, OBJECTIVE, 1.0, integrator, method=Adjoint(memory=memory))
    np.testing.assert_allclose(in_parts.gradient, all_kept.gradient, rtol=1e-13)
    assert in_parts.value == pytest.approx(all_kept.value, rel=1e-14)
    assert (in_parts.solution.statistics.steps > 32) == repeats


def test_some_instants_are_kept():
    system, integrator = CartesianPendulum(-1.0, 2.0), Radau(1 / 32)
    run = simulate(system, 1.0, integrator)
    kept = simulate(system, 1.0, integrator, keep=10)
    rows = [0, 30, 60, 90, 96]  # Ends of every tenth step, and of the last.
    for name in ("t", *STATES):
        np.testing.assert_array_equal(getattr(kept, name), getattr(run, name)[rows])
    assert kept.statistics.steps == 32
    times = (0.3, 0.5, 0.77)
    between = simulate(system, 1.0, integrator, keep=times)
    np.testing.assert_array_equal(between.lam, run.at(times).lam)


@pytest.mark.parametrize("integrator", [Radau(0.05), Radau(rtol=1e-5)])
def test_it_stands_in_every_call(integrator):
    system, times = CartesianPendulum(-1.0, 2.0), (0.25, 1.0)
    objective, x = Terminal(custom(speed, "v_x")), custom(lambda t, q, v, lam, b: q[:, 0], "x")
    exact = gradient(system, objective, 1.0, integrator)
    run = exact.solution
    (row,) = sweep(system, [{}], Evaluator(objective, 1.0, integrator)).results
    assert row["value"] == pytest.approx(exact.value, rel=1e-12)
    assert Responses(system, {"v": objective}, 1.0, integrator)["v"](system.b) == exact.value
    # Along L alone: v is proportional to s where L and g both are.
    assert taylor_test(system, objective, 1.0, integrator, direction=(1.0, 0.0)).order > 1.9
    misfit = Misfit([x], times, np.zeros((1, 2)))
    residuals = misfit.fit(system, 1.0, integrator).residuals(system.b)
    np.testing.assert_allclose(residuals, run.at(times).q[:, 0], rtol=1e-12)
    bars = error_bars(system, objective, 1.0, integrator)
    assert abs(bars.value - exact.value) < 1e-3
    (setting,) = work_precision(system, objective, 1.0, [integrator], reference=DOP853(1e-9)).rows
    assert setting.error("gradient") < 1e-2
    frozen = integrator.frozen(run)
    seen = record_observables(system, [x], 1.0, frozen, keep=times)
    np.testing.assert_allclose(seen.values[:, 0], run.at(times).q[:, 0], rtol=1e-9)
    memory = gradient(system, objective, 1.0, frozen, method=Adjoint(memory="1 MB"))
    np.testing.assert_allclose(memory.gradient, exact.gradient, rtol=1e-11)


def test_what_it_cannot_is_refused_in_words():
    system, controlled = CartesianPendulum(-1.0, 2.0), Radau(rtol=1e-4)
    with pytest.raises(InvalidInputError, match="known before the run"):
        gradient(system, OBJECTIVE, 1.0, controlled, method=Adjoint(memory="1 MB"))
    with pytest.raises(InvalidInputError, match="known before the run"):
        simulate(system, 1.0, controlled, keep=2)
    with pytest.raises(InvalidInputError, match="defects of its steps"):
        estimate_adjoint_error(system, OBJECTIVE, 1.0, Radau(0.1))


# ---------------------------------------------------------------- units


def in_units(metre, kilogram, second):
    """A damped rod of steel that swings, in these parts of the units."""
    density, modulus = kilogram / metre**3, kilogram / metre / second**2
    steel = Material(7800.0 * density, 2e9 * modulus, 0.3, damping_time=1e-3 * second)
    rectangle = Rectangle(0.02 * metre, 0.01 * metre)
    rod = Beam("rod", (0.0, 0.0), (metre, 0.0), 2, rectangle, steel)
    return Scene([rod], [Pin(rod.at_start)], (0, -9.81 * metre / second**2))


def test_other_units_give_the_same_digits():
    metre, second = 1e3, 2.0**10
    runs = []
    for units in ((1.0, 1.0, 1.0), (metre, 1e-3, second)):
        run = simulate(in_units(*units), 0.2 * units[2], Radau(rtol=1e-4))
        tip = run.position(MaterialPoint("rod", 1.0))
        runs.append((run.t / units[2], tip / units[0], run.statistics))
    (t, tip, told), (t_scaled, tip_scaled, told_scaled) = runs
    assert told.steps == told_scaled.steps
    np.testing.assert_allclose(t, t_scaled, rtol=1e-9)
    np.testing.assert_allclose(tip, tip_scaled, rtol=0, atol=1e-9)


class AtRest(FormulaSystem):
    """Two masses on a spring, the first one moved by t^4: nothing acts at t = 0."""

    n_q, n_lam, design_names = 2, 1, ("stiffness",)

    def mass_matrix(self, q):
        return 2.0 * np.eye(2)

    def force(self, t, q, v):
        pull = self.b[0] * (q[1] - q[0])
        return np.array([pull, -pull])

    def position_constraint(self, t, q):
        return np.array([q[0] - t**4])

    def start(self):
        return np.zeros(2), np.zeros(2)

    def with_values(self, b):
        return type(self)(b)


@pytest.mark.parametrize("by_list", [True, False])
@pytest.mark.parametrize("stiffness", [1.0, 1e-200])
def test_a_system_starts_at_which_nothing_acts(stiffness, by_list):
    """x'' = k (t^4 - x) from rest: x = k t^6/30 - k^2 t^8/1680 + k^3 t^10/151200."""
    system = AtRest((stiffness if by_list else stiffness + 0j,))
    run = Radau(step=0.1).integrate(system, 1.0)
    assert run.outcome.success
    k, t = stiffness / 2, 1.0
    exact = k * t**6 / 30 - k**2 * t**8 / 1680 + k**3 * t**10 / 151200
    assert run.q[-1].real == pytest.approx([1.0, exact], rel=1e-6)
