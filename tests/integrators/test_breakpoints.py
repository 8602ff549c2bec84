"""Ends of the pieces of laws: integrators that choose their steps end one there, and miss none."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    Adjoint,
    DirectDifferentiation,
    Pin,
    PointForce,
    Radau,
    RigidBody,
    RotationDriver,
    Scene,
    Terminal,
    assemble,
    gradient,
    simulate,
)
from ancfdae.equations import SystemProperties
from ancfdae.errors import InvalidInputError
from ancfdae.extend import FormulaSystem, positive
from ancfdae.laws import (
    Constant,
    ConstantAcceleration,
    Harmonic,
    RunUp,
    SmoothStep,
    Spline,
    Transition,
    UserLaw,
)
from ancfdae.numerics.time_grid import next_end
from ancfdae.observables import custom, position, velocity

BLOCK = RigidBody("block", (0, 0), mass=2.0, inertia=0.1)
T_END, BEGIN, FORCE = 1.0, 0.6137, 3.0


def pulse(width):
    """Up to one within the width, and down again within another."""
    return Transition(SmoothStep(0.0, 1.0, width, BEGIN), Constant(0.0), width, BEGIN + width)


def kicked(width):
    """A block that nothing else moves: a step across the kick would not know of it."""
    kick = PointForce(BLOCK.at(0, 0), (FORCE / width, 0.0), law=pulse(width), name="kick")
    return Scene([], bodies=[BLOCK], loads=[kick])


def test_laws_tell_where_their_pieces_end():
    for law, expected in (
        (ConstantAcceleration(2.0), ()),
        (Harmonic(1.0, 2.0), ()),
        (SmoothStep(0.0, 1.0, 0.2, 0.3), (0.3, 0.5)),
        (RunUp(1.0, 0.25, begin=0.5), (0.5, 0.75)),
        (
            Transition(SmoothStep(0, 1, 0.5, 0.25), RunUp(1.0, 0.5), 0.125, 2.0),
            (0.25, 0.75, 0, 0.5, 2, 2.125),
        ),
        (Spline([0.5, 1.0, 2.0], [0.0, 3.0, 1.0]), (0.5, 2.0)),
        (Spline([0.5, 1.0, 2.0], [0.0, 3.0, 1.0], period=2.0), ()),
    ):
        p = np.array(list(law.parameters().values())) * (1 + 1e-30j)
        assert law.breakpoints(p) == pytest.approx(expected)


def test_a_system_knows_those_of_its_joints_and_loads_at_any_design():
    block, arm = kicked(0.25), RigidBody("arm", (0, 0), mass=1.0, inertia=1.0)
    joints = [
        Pin(arm.at(0, 0)),
        RotationDriver(arm.at(0, 0), RunUp(1.0, 0.5, begin=0.25), name="motor"),
    ]
    scene = Scene([], joints, bodies=[BLOCK, arm], loads=block.loads)
    system = assemble(scene, ["motor.duration", "kick.force_x"])
    ends = (0.25, 0.75, BEGIN, BEGIN + 0.25, BEGIN + 0.25, BEGIN + 0.5)
    assert system.traits.breakpoints == pytest.approx(ends)
    moved = system.with_values(system.b + np.array([0.125, 1.0]))
    assert moved.traits.breakpoints == pytest.approx((0.25, 0.875, *ends[2:]))


CONTROLLED = [HHT(rtol=1e-5), Radau(rtol=1e-5), IDA(rtol=1e-7), DOP853(rtol=1e-7)]
KICKS = [(integrator, width) for integrator in CONTROLLED for width in (0.1, 0.003)]


@pytest.mark.parametrize(
    ("integrator", "width"), [*KICKS, pytest.param(IDAS(rtol=1e-6), 0.1, marks=pytest.mark.idas)]
)
def test_no_integrator_steps_over_a_kick(integrator, width):
    """The path J (T - t_c)/m of an impulse J about its middle t_c, and its derivatives."""
    objective, left = Terminal(position(BLOCK.at(0, 0), 0)), T_END - BEGIN - width
    design = ["kick.force_x", "block.mass"]
    method = Adjoint() if isinstance(integrator, IDAS) else DirectDifferentiation()
    found = gradient(kicked(width), objective, T_END, integrator, design=design, method=method)
    path = FORCE * left / 2.0
    # Tolerances hold per step, HHT-I3 errs by ten times its own.
    assert found.value == pytest.approx(path, rel=2e-4)
    assert found.gradient == pytest.approx([path / (FORCE / width), -path / 2.0], rel=2e-4)


@pytest.mark.parametrize("width", [0.1, 0.03, 0.003, 3e-4])
@pytest.mark.parametrize("integrator", CONTROLLED)
def test_no_integrator_steps_over_a_pulse_of_a_users_law(integrator, width):
    """The impulse of A exp(-((t - c)/w)^2) is A w sqrt(pi); the law does not say where it acts."""

    def bump(t, width):
        return np.exp(-np.square((t - BEGIN) / width))

    law = UserLaw(bump, (width,))
    kick = PointForce(BLOCK.at(0, 0), (FORCE / width, 0.0), law=law, name="kick")
    scene = Scene([], bodies=[BLOCK], loads=[kick])
    design = ["kick.force_x", "kick.value[0]"]
    objective = Terminal(velocity(BLOCK.at(0, 0), 0))
    found = gradient(scene, objective, T_END, integrator, design=design)
    speed = FORCE * np.sqrt(np.pi) / 2.0
    assert found.value == pytest.approx(speed, rel=1e-3)
    assert found.gradient == pytest.approx([speed / (FORCE / width), speed / width], rel=1e-3)


def test_laws_that_mark_their_passages_are_not_sampled():
    known = assemble(kicked(0.05))
    assert known.breakpoints(T_END) == known.traits.breakpoints
    inner = Transition(Constant(0.0), UserLaw(np.sin), 0.1, 0.2)
    assert Transition(Constant(0.0), Harmonic(1.0, 2.0), 0.1, 0.2).marked
    assert not inner.marked


def test_steps_end_at_breakpoints():
    for integrator in (HHT(rtol=1e-4), Radau(rtol=1e-4)):
        t = simulate(kicked(0.05), T_END, integrator).t
        for instant in (BEGIN, BEGIN + 0.05, BEGIN + 0.1, T_END):
            assert np.min(np.abs(t - instant)) <= 1e-15
        assert np.all(np.diff(t) > 0)


def test_the_next_end():
    ends = (0.5, 0.25, 0.5, 1.0, 2.0, -1.0)
    assert [next_end(ends, t, 1.5) for t in (0.0, 0.25, 0.5 - 1e-12, 1.0, 1.2)] == [
        0.25, 0.5, 1.0, 1.5, 1.5,
    ]  # fmt: skip
    assert next_end((), 0.3, 1.5) == 1.5


def test_breakpoints_are_numbers():
    with pytest.raises(InvalidInputError, match="breakpoints"):
        SystemProperties(breakpoints=(0.1, np.nan))


class Ramped(FormulaSystem):
    """A mass under a force that begins to rise at a declared time; NumPy calls its formula."""

    n_q, n_lam, design_names = 1, 0, ("m", "F")
    # Time at which the force begins.
    begin = 0.4

    def __init__(self, b=(2.0, 3.0)):
        self.traits = SystemProperties(breakpoints=(self.begin,))
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.zeros(1), np.zeros(1)

    def mass_matrix(self, q):
        return self.b[0] * np.ones((1, 1))

    def force(self, t, q, v):
        if v[0] > 1e9:  # A question that symbols do not answer.
            return 0 * v
        return self.b[1] * positive(t - self.begin) + 0 * v

    def position_constraint(self, t, q):
        return q[:0]


class Clipped(Ramped):
    """A real part has no complex step; it begins long after the start, where nothing shows it."""

    def force(self, t, q, v):
        late = v.real if np.real(t) > 0.7 else 0.0
        return super().force(t, q, v) + late


@pytest.mark.filterwarnings("ignore::ancfdae.errors.NotTracedWarning")
@pytest.mark.parametrize("method", [Radau(rtol=1e-8), Radau(0.1), HHT(rtol=1e-6), DOP853(1e-9)])
def test_a_called_formula_has_derivatives_beside_its_breakpoint(method):
    """x = F (t - begin)^3 / 6 m; the run was refused because a step ends at the breakpoint."""
    end = Terminal(custom(lambda t, q, v, lam, b: q[:, 0], "x"))
    found = gradient(Ramped(), end, 1.0, method)
    exact = 3.0 * 0.6**3 / (6 * 2.0)
    assert found.value == pytest.approx(exact, rel=1e-4)
    np.testing.assert_allclose(found.gradient * [-2.0, 3.0], exact, rtol=1e-4)


@pytest.mark.filterwarnings("ignore::ancfdae.errors.NotTracedWarning")
def test_a_called_formula_that_loses_its_complex_step_in_the_run_is_refused():
    end = Terminal(custom(lambda t, q, v, lam, b: q[:, 0], "x"))
    with pytest.raises(InvalidInputError, match=r"at t = 0\.[789].*must be differentiable"):
        gradient(Clipped(), end, 1.0, Radau(0.1))
