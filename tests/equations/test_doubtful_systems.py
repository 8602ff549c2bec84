"""Systems of a user whose derivatives exist in places only: right, or refused in words.

References are runs of SciPy's DOP853 in minimal coordinates, and their differences.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    Distance,
    FiniteDifference,
    Integral,
    Pin,
    PointOnLine,
    Radau,
    Responses,
    RigidBody,
    Scene,
    assemble,
    check_system,
    differentiate,
    gradient,
    modes,
)
from ancfdae.errors import (
    InconsistentStartError,
    InvalidInputError,
    NonFiniteObjectiveError,
    NotTracedWarning,
    StabilityWarning,
)
from ancfdae.extend import FormulaSystem, SystemProperties
from ancfdae.modes.precise import NoModes
from ancfdae.observables import custom

FIRST = Integral(custom(lambda t, q, v, lam, b: q[:, 0]))


class Plain(FormulaSystem):
    """Two coordinates with unit masses on springs, without constraints, released from rest."""

    n_q, n_lam = 2, 0
    design_names = ("k", "c")

    def __init__(self, b=(3.0, 0.2)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.array([0.7, -0.4]) + 0 * self.b[0], np.zeros(2) + 0 * self.b[0]

    def mass_matrix(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return -self.b[0] * q - self.b[1] * v

    def position_constraint(self, t, q):
        return q[:0]


def differences(value, b, h=1e-4):
    """Central differences of a function of design values b."""
    moves = h * np.eye(len(b))
    return np.array([(value(b + e) - value(b - e)) / (2 * h) for e in moves])


def integral(acceleration, start, t_end, **settings):
    """Integral over time of the first coordinate, by SciPy."""
    n = len(start) // 2

    def rate(t, y):
        return np.concatenate([y[n:-1], acceleration(y[:n], y[n:-1]), y[:1]])

    tight = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853"} | settings
    return solve_ivp(rate, (0, t_end), [*start, 0.0], **tight).y[-1, -1]


# ---- complex steps of Radau --------------------------------------------------------------------


class Coupled(Plain):
    design_names = ("m", "k", "c")

    def __init__(self, b=(1.3, 0.7, 0.2)):
        super().__init__(b)

    def start(self):
        return np.array([0.3, -0.2 * self.b[1]]), np.array([self.b[2], 0.5])

    def mass_matrix(self, q):
        m, k, _ = self.b
        c = 0.2 * np.cos(q[0]) * k
        return np.array([[m * (1 + 0.3 * q[1] ** 2), c], [c, 1.0 + k * np.exp(-q[0])]])

    def force(self, t, q, v):
        m, _, c = self.b
        first = -3 * q[0] - c * v[0] ** 2 * v[1] + np.sin(4 * t) * m
        return np.array([first, -2 * q[1] ** 3 + c * v[0] * np.cos(q[1] * t)])


@pytest.mark.parametrize("step", [2**-6, 2**-3])
def test_radau_takes_complex_steps_of_stages_that_are_solved_to_the_last_digit(step):
    # A correction that is exactly zero has no rate of convergence.
    exact = gradient(Coupled(), FIRST, 1.5, Radau(step)).gradient
    stepped = gradient(Coupled(), FIRST, 1.5, Radau(step), method=ComplexStep()).gradient
    assert stepped == pytest.approx(exact, rel=1e-12)


# ---- roots that vanish -------------------------------------------------------------------------


class Drag(Plain):
    """Drag c |v| v: its derivative at rest is zero."""

    def force(self, t, q, v):
        return -self.b[0] * q - self.b[1] * v * np.linalg.norm(v)


class DragByRoot(Drag):
    def force(self, t, q, v):
        return -self.b[0] * q - self.b[1] * v * np.sqrt(v @ v)


class DragByPower(Drag):
    """Drag c |v|^(1/2) v."""

    def force(self, t, q, v):
        return -self.b[0] * q - self.b[1] * v * (v @ v) ** 0.25


DRAGS = {Drag: 1.0, DragByRoot: 1.0, DragByPower: 0.5}


@pytest.mark.parametrize("kind", DRAGS)
@pytest.mark.parametrize(
    ("integrator", "near"),
    [(Radau(2**-6), 1e-4), (HHT(2**-8), 1e-3), (DOP853(1e-9), 1e-5), (IDA(1e-9), 1e-5)],
    ids=["Radau", "HHT", "DOP853", "IDA"],
)
def test_drag_from_rest_has_the_gradient_of_an_independent_run(kind, integrator, near):
    power, start = DRAGS[kind], [0.7, -0.4, 0.0, 0.0]

    def value(b):
        return integral(lambda q, v: -b[0] * q - b[1] * v * np.linalg.norm(v) ** power, start, 1.0)

    expected = differences(value, np.array([3.0, 0.2]))
    methods = [DirectDifferentiation()]
    if isinstance(integrator, Radau | HHT):
        methods += [Adjoint(), ComplexStep(), ContinuousAdjoint()]
    for method in methods:
        slack = 1e-2 if isinstance(method, ContinuousAdjoint) else near
        found = gradient(kind(), FIRST, 1.0, integrator, method=method)
        assert found.gradient == pytest.approx(expected, rel=slack)
    assert check_system(kind()).passed


class Rubbing(Plain):
    """Drag c |v|, which has a kink at rest, where the run starts."""

    def force(self, t, q, v):
        return -self.b[0] * q - self.b[1] * np.linalg.norm(v)


def test_a_kink_at_the_start_is_told_with_its_line():
    with pytest.warns(StabilityWarning, match=r"no derivative.*np.linalg.norm\(v\)`.*eps\*\*2"):
        system = Rubbing()
    # It is left at once: the derivative of the run exists.
    expected = differences(
        lambda b: integral(
            lambda q, v: -b[0] * q - b[1] * np.linalg.norm(v), [0.7, -0.4, 0.0, 0.0], 1.0
        ),
        np.array([3.0, 0.2]),
    )
    for method in (DirectDifferentiation(), Adjoint()):
        found = gradient(system, FIRST, 1.0, Radau(2**-7), method=method).gradient
        assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint()])
def test_no_gradient_that_is_not_finite_is_returned(method, monkeypatch):
    system = Plain()
    monkeypatch.setattr(system, "start_b", lambda: (np.full((2, 2), np.nan), np.zeros((2, 2))))
    with pytest.raises(NonFiniteObjectiveError, match="derivative"):
        gradient(system, FIRST, 0.5, Radau(2**-4), method=method)
    if isinstance(method, DirectDifferentiation):
        with pytest.raises(NonFiniteObjectiveError, match="derivative is not finite at t = 0"):
            differentiate(system, 0.5, Radau(2**-4))


def test_responses_hand_on_the_gradient_of_drag_from_rest():
    responses = Responses(Drag(), {"o": FIRST}, 1.0, Radau(2**-5), method=Adjoint())
    found = responses["o"].gradient(np.array([3.0, 0.2]))
    assert found == pytest.approx(gradient(Drag(), FIRST, 1.0, Radau(2**-5)).gradient, rel=1e-10)


# ---- starts ------------------------------------------------------------------------------------


class OnParabola(Plain):
    """A bead on x = a y^2."""

    n_lam = 1
    design_names = ("k", "a")

    def __init__(self, b=(3.0, 0.7)):
        super().__init__(b)

    def start(self):
        a = self.b[1]
        return np.array([a * 0.25, 0.5 + 0 * a]), np.array([a * 0.3, 0.3 + 0 * a])

    def force(self, t, q, v):
        return np.array([-self.b[0] * q[0], -1.0])

    def position_constraint(self, t, q):
        return np.array([q[0] - self.b[1] * q[1] ** 2])


class FixedPosition(OnParabola):
    def start(self):
        return np.array([0.7 * 0.25, 0.5]) + 0 * self.b[0], super().start()[1]


class FixedVelocity(OnParabola):
    def start(self):
        return super().start()[0], np.array([0.7 * 0.3, 0.3]) + 0 * self.b[0]


METHODS = [DirectDifferentiation(), Adjoint(), ComplexStep(), ContinuousAdjoint()]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("kind", "what", "finding"),
    [
        (FixedPosition, "positions", "start, q_b on the constraints"),
        (FixedVelocity, "velocities", "start, v_b on the constraints"),
    ],
)
def test_a_start_that_is_consistent_at_one_design_only_is_refused(kind, what, finding, method):
    assert [x.name for x in check_system(kind()).wrong] == [finding]
    for integrator in (Radau(2**-5), HHT(2**-5)):
        with pytest.raises(InconsistentStartError, match=f"variable 'a': the {what} must satisfy"):
            gradient(kind(), FIRST, 1.0, integrator, method=method)


def test_a_start_that_follows_the_design_has_the_gradient_of_differences():
    assert check_system(OnParabola()).passed
    runs = [
        gradient(OnParabola(b), FIRST, 1.0, Radau(rtol=1e-10)).value
        for b in ((3.0, 0.7001), (3.0, 0.6999))
    ]
    expected = (runs[0] - runs[1]) / 2e-4
    for method in (DirectDifferentiation(), Adjoint(), ComplexStep()):
        found = gradient(OnParabola(), FIRST, 1.0, Radau(2**-6), method=method).gradient
        assert found[1] == pytest.approx(expected, rel=1e-6)


# ---- functions that are called -----------------------------------------------------------------


class Stop(FormulaSystem):
    """A spring with damping, and a stop at q = -0.3 that pushes back; the start is far from it."""

    n_q, n_lam = 1, 0
    design_names = ("k", "c")

    def __init__(self, b=(30.0, 0.3)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.array([1.0]), np.array([0.0])

    def mass_matrix(self, q):
        return np.eye(1)

    def position_constraint(self, t, q):
        return q[:0]

    def push(self, depth):
        return 60 * abs(depth)

    def force(self, t, q, v):
        pushed = self.push(q[0] + 0.3) if np.real(q[0]) < -0.3 else 0.0
        return -self.b[0] * q - self.b[1] * v + pushed


class AnalyticStop(Stop):
    def push(self, depth):
        return -60 * depth


@pytest.mark.filterwarnings("ignore::ancfdae.errors.NotTracedWarning")
@pytest.mark.parametrize("method", METHODS)
def test_abs_in_a_branch_that_the_start_does_not_reach_is_refused(method):
    with pytest.raises(
        InvalidInputError, match=r"Stop.force, at t = 0\.\d+ s of the run: must be diff"
    ):
        gradient(Stop(), FIRST, 2.0, HHT(2**-8), method=method)
    if isinstance(method, DirectDifferentiation):
        for integrator in (DOP853(1e-8), IDA(1e-8), Radau(2**-6)):
            with pytest.raises(InvalidInputError, match="must be differentiable"):
                gradient(Stop(), FIRST, 2.0, integrator, method=method)
        with pytest.raises(InvalidInputError, match="must be differentiable"):
            gradient(Stop(), FIRST, 2.0, tolerance=1e-3)


def test_a_branch_that_is_analytic_on_both_sides_is_right():
    def value(b):
        return integral(
            lambda q, v: -b[0] * q - b[1] * v - 60 * np.minimum(q + 0.3, 0.0),
            [1.0, 0.0],
            2.0,
            max_step=2e-3,
        )

    with pytest.warns(NotTracedWarning):
        system = AnalyticStop()
    expected = differences(value, np.array([30.0, 0.3]), 1e-3)
    found = gradient(system, FIRST, 2.0, Radau(2**-7)).gradient
    assert found == pytest.approx(expected, abs=4e-3 * np.linalg.norm(expected))
    with pytest.warns(NotTracedWarning):
        stop = Stop()
    # Whole runs need no complex numbers.
    central = FiniteDifference(1e-4, central=True)
    found = gradient(stop, FIRST, 2.0, Radau(2**-7), method=central).gradient
    assert found == pytest.approx(expected, abs=4e-3 * np.linalg.norm(expected))


# ---- singular positions ------------------------------------------------------------------------


class TwoBars(Plain):
    """Bars l1 and l2 whose common end stays on an axis; equal bars can fold at a right angle."""

    n_lam = 1
    design_names = ("l1", "l2")

    def __init__(self, b=(1.0, 1.0)):
        super().__init__(b)

    def start(self):
        l1, l2 = self.b
        return np.zeros(2) + 0 * l1, np.array([1.0, -l1 / l2])

    def force(self, t, q, v):
        return 0 * q

    def position_constraint(self, t, q):
        return np.array([self.b[0] * np.sin(q[0]) + self.b[1] * np.sin(q[1])])


@pytest.mark.parametrize("integrator", [HHT(2**-6), HHT(2**-8), Radau(2**-5), Radau(0.01)])
@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint()])
def test_a_run_through_a_singular_position_is_told(integrator, method):
    with pytest.warns(StabilityWarning, match=r"singular position at t = 1\.570\d* s"):
        gradient(TwoBars(), FIRST, 3.0, integrator, method=method)


@pytest.mark.parametrize(("longer", "t_end"), [(1.001, 3.0), (0.999, 3.0), (1.0, 1.5)])
def test_near_a_singular_position_there_is_a_gradient_and_no_warning(longer, t_end):
    # The long bar stays beside the fold; the short one locks the other and turns back.
    values = [
        gradient(TwoBars((longer, 1.0 + h)), FIRST, t_end, DOP853(1e-11)).value
        for h in (1e-6, -1e-6)
    ]
    found = gradient(TwoBars((longer, 1.0)), FIRST, t_end, HHT(2**-9)).gradient
    assert found[1] == pytest.approx((values[0] - values[1]) / 2e-6, rel=2e-2)


# ---- declarations ------------------------------------------------------------------------------


class Declared(Plain):
    """M follows from q, Q from v, Phi_q from q, and Phi from t and b."""

    n_lam = 1

    def start(self):
        return np.array([0.7, 0.49 * self.b[0]]), np.array([0.0, self.b[0]])

    def mass_matrix(self, q):
        M = np.zeros((2, 2), dtype=q.dtype)
        M[0, 0], M[1, 1] = 1 + q[0] ** 2, 2.0
        return M

    def position_constraint(self, t, q):
        return np.array([q[1] - self.b[0] * (q[0] ** 2 + t)])


@pytest.mark.parametrize(
    ("claim", "told"),
    [
        ({"constant_mass": True}, "constant_mass=True: .* M changes with q"),
        ({"velocity_forces": False}, "velocity_forces=False: .* Q changes with v"),
        ({"linear_constraints": True}, "linear_constraints=True: .* Phi_q changes with q"),
        ({"constant_constraints": True}, "Phi_q changes with q"),
    ],
)
def test_declarations_that_the_formulas_contradict_are_refused(claim, told):
    kind = type("Claiming", (Declared,), {"traits": SystemProperties(**claim)})
    with pytest.raises(InvalidInputError, match=told):
        kind()
    Declared()


class Round(Plain):
    """M is constant, which its list does not show."""

    traits = SystemProperties(constant_mass=True, velocity_forces=True)

    def mass_matrix(self, q):
        return np.eye(2) * (np.cos(q[0]) ** 2 + np.sin(q[0]) ** 2)


class Moving(Plain):
    """Linear constraints that move with time, declared constant."""

    n_lam = 1
    traits = SystemProperties(constant_constraints=True)

    def start(self):
        return np.array([0.7, 0.0]), np.array([0.0, 1.0])

    def position_constraint(self, t, q):
        return np.array([q[1] - t])


def test_declarations_that_hold_are_taken_and_moving_constraints_are_not_constant():
    assert Round().traits.constant_mass
    with pytest.raises(InvalidInputError, match="dPhi/dt at v = 0 is not zero"):
        Moving()


# ---- tables, modes and points ------------------------------------------------------------------


class Pushed(Plain):
    """A force that is a table of time, as docs/own-systems.md writes it."""

    knots = np.linspace(0.0, 1.0, 6)
    pieces = CubicSpline(knots, [0.0, 0.3, 0.8, 0.9, 0.4, 0.0])
    traits = SystemProperties(breakpoints=tuple(knots[1:-1]))

    def table(self, t):
        k = np.clip(np.searchsorted(self.knots, np.real(t)) - 1, 0, len(self.knots) - 2)
        return np.polyval(self.pieces.c[:, k], t - self.knots[k])

    def force(self, t, q, v):
        return -self.b[0] * q - self.b[1] * self.table(t) * np.array([1.0, 2.0])


def test_a_table_is_a_spline_whose_pieces_take_complex_numbers():
    def value(b):
        def rate(t, y):
            push = b[1] * Pushed.pieces(t) * np.array([1.0, 2.0])
            return [*y[2:4], *(-b[0] * y[:2] - push), y[0]]

        start = [0.7, -0.4, 0.0, 0.0, 0.0]
        return solve_ivp(rate, (0, 1), start, rtol=1e-11, atol=1e-12, max_step=0.02).y[-1, -1]

    with pytest.warns(NotTracedWarning):
        system = Pushed()
    found = gradient(system, FIRST, 1.0, Radau(2**-5), method=Adjoint()).gradient
    assert found == pytest.approx(differences(value, np.array([3.0, 0.2])), rel=1e-5)


class Linear(Plain):
    """q'' + D q' + k K q = 0."""

    D, K = np.zeros((2, 2)), np.eye(2)

    def start(self):
        return np.zeros(2) + 0 * self.b[0], np.zeros(2) + 0 * self.b[0]

    def force(self, t, q, v):
        return -self.b[0] / 3.0 * (self.K @ q) - self.D @ v


class Gyroscope(Linear):
    """At the speed at which it just stands: +-i are double roots with one shape."""

    D, K = np.array([[0.0, 2.0], [-2.0, 0.0]]), -np.eye(2)


class Follower(Linear):
    """At the boundary of flutter: one double root of K, with one shape."""

    K = np.array([[3.0, -1.0], [1.0, 1.0]])


def test_double_roots_of_a_system_without_beams_are_told_without_beams():
    with pytest.raises(NoModes, match="a millionth of itself") as caught:
        modes(Gyroscope(), 2)
    for word in ("element", "thick", "creep", "pivot"):
        assert word not in str(caught.value)


def test_a_double_root_with_one_shape_has_infinite_derivatives():
    found = modes(Follower(), 2)
    np.testing.assert_allclose(found.exponents, np.sqrt(2) * 1j, rtol=1e-7)
    assert found.coincide == ((0, 1),)
    assert np.all(np.isinf(found.derivatives.exponents_b))


def test_points_of_rigid_bodies_take_their_coordinates_one_by_one():
    body = RigidBody("wheel", (0.0, 0.0, 0.0), mass=1.0, inertia=(0.4, 0.5, 0.6))
    with pytest.raises(InvalidInputError, match=r"given one by one; got \(0, 0, 0\)"):
        body.at((0, 0, 0))


def test_trees_of_bodies_have_no_loops():
    first, second, third = (RigidBody(f"b{k}", (k, 0), mass=1.0, inertia=0.1) for k in range(3))
    tree = [
        Pin(first.at(-0.5, 0)),
        Pin(first.at(0.5, 0), second.at(-0.5, 0)),
        Pin(first.at(0.2, 0), third.at(-1.8, 0)),
    ]
    bodies = [first, second, third]
    assert not assemble(Scene([], tree, bodies=bodies)).has_loops
    closed = [*tree, Distance(second.at(0.5, 0), 1.0, other=third.at(0.5, 0))]
    assert assemble(Scene([], closed, bodies=bodies)).has_loops
    held = [*tree, PointOnLine(third.at(0.5, 0), direction=(1, 0))]
    assert assemble(Scene([], held, bodies=bodies)).has_loops
