"""Index-reduced forms: residuals, their derivatives, and scales that see no units."""

import numpy as np
import pytest

from ancfdae import Beam, IndexReduction, Material, Pin, PointOnLine, Scene, assemble
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.sundials.index_reduced import ColumnStorage
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum, chain
from tests.support.members import constraint_force, velocity_side

FORMS = list(IndexReduction)
# Imaginary step of the reference derivatives: its square vanishes against any value here.
STEP = 1e-30


def slider():
    """Linear constraints only: the form then leaves terms out."""
    rod = Beam("a", (0, 0), (0.5, 0), 2, Rectangle(0.05, 0.04), Material(4000, 1e6, 0.3))
    joints = [Pin(rod.at_start), PointOnLine(rod.at_end, (1, 0.1))]
    scene = Scene([rod], joints, (0, -9.81), project_start=True)
    return assemble(scene, ["a.height", "a.length", "a.density"])


SYSTEMS = {"chain": chain, "slider": slider, "pendulum": lambda: CartesianPendulum(0.5, 3.0)}
CASES = [(name, form) for name in SYSTEMS for form in FORMS]
IDS = [f"{name}-{form.name}" for name, form in CASES]


class Case:
    """A form at a state off the constraints and off the motion, where no term vanishes."""

    def __init__(self, name, kind, seed=0):
        self.kind, self.system = kind, SYSTEMS[name]()
        self.problem = InitialValueProblem.of(self.system, 1.0).differentiated()
        self.form = kind.form(self.system, self.problem.scales)
        rng = np.random.default_rng(seed)
        y, yp = self.form.start(self.problem.initial)
        self.t = 0.3
        self.y = y + 0.02 * rng.standard_normal(y.shape)
        self.yp = yp + 0.02 * (1 + np.max(np.abs(yp))) * rng.standard_normal(y.shape)
        self.Y = rng.standard_normal((len(y), self.system.n_b))
        self.Yp = rng.standard_normal((len(y), self.system.n_b))

    def jacobian(self, c_j):
        J = np.zeros((self.form.n, self.form.n))
        raw = self.form.jacobian(self.t, self.y, self.yp, c_j)
        np.add.at(J, (self.form.rows, self.form.columns), raw)
        return J

    def residual(self, y, yp, b=None):
        system = self.system if b is None else self.system.with_values(b)
        form = self.kind.form(system, self.problem.scales)
        return form.residual(self.t, y, yp)


def assert_close(ours, reference, within):
    """Row by row: equations differ in size by orders of magnitude."""
    size = np.max(np.abs(reference), axis=1, keepdims=True)
    assert np.all(np.abs(ours - reference) <= within * (size + 1e-12 * np.max(size)))


@pytest.mark.parametrize(("name", "kind"), CASES, ids=IDS)
def test_iteration_matrix_is_the_derivative_of_the_residual(name, kind):
    case, c_j = Case(name, kind), 37.0
    reference = np.stack(
        [
            case.residual(case.y + 1j * STEP * e, case.yp + 1j * STEP * c_j * e).imag / STEP
            for e in np.eye(case.form.n)
        ],
        axis=1,
    )
    assert_close(case.jacobian(c_j), reference, 1e-11)
    # The comparison notices a flipped sign, of any block that the form has.
    for rows in np.array_split(np.arange(case.form.n), 4):
        spoiled = reference.copy()
        spoiled[rows] *= -1
        with pytest.raises(AssertionError):
            assert_close(case.jacobian(c_j), spoiled, 1e-11)


@pytest.mark.parametrize(("name", "kind"), CASES, ids=IDS)
def test_sensitivity_residual_is_the_total_derivative_of_the_residual(name, kind):
    case = Case(name, kind)
    b, scale = case.system.b, case.problem.scales.b
    ours = case.form.residual_b(case.t, case.y, case.yp, case.Y, case.Yp)
    for i, (Y, Yp) in enumerate(zip(case.Y.T, case.Yp.T, strict=True)):
        moved = b.astype(complex)
        moved[i] += 1j * STEP * scale[i]
        reference = case.residual(case.y + 1j * STEP * Y, case.yp + 1j * STEP * Yp, moved)
        error = np.abs(ours[:, i] - reference.imag / STEP)
        assert np.max(error) < 1e-10 * np.max(np.abs(ours[:, i]))
        # Each equation for itself, so that no large one hides a small one.
        assert np.all(error <= 1e-8 * np.abs(ours[:, i]) + 1e-12 * np.max(np.abs(ours[:, i])))


@pytest.mark.parametrize(("name", "kind"), CASES, ids=IDS)
def test_residuals_vanish_at_the_consistent_start(name, kind):
    case = Case(name, kind)
    y, yp = case.form.start(case.problem.initial)
    Y, Yp = case.form.start_b(case.problem.derivative)
    assert np.max(np.abs(case.form.residual(0.0, y, yp))) < 1e-11
    size = np.max(np.abs(Y)) + np.max(np.abs(Yp))
    assert np.max(np.abs(case.form.residual_b(0.0, y, yp, Y, Yp))) < 1e-11 * size
    q, v = case.form.coordinates(y)
    np.testing.assert_allclose(q, case.problem.initial.q, rtol=1e-15)
    np.testing.assert_allclose(v, case.problem.initial.v, rtol=1e-15)
    q_b, v_b = case.form.coordinates_b(Y)
    np.testing.assert_allclose(q_b, case.problem.derivative.q_b, rtol=1e-14)
    np.testing.assert_allclose(v_b, case.problem.derivative.v_b, rtol=1e-14)


def test_the_stabilised_form_contains_the_equations_of_motion_as_they_stand():
    # From the parts of the system, not from the form.
    case = Case("chain", IndexReduction.STABILISED_INDEX_2)
    s, system = case.problem.scales, case.system
    n, m = system.n_q, system.n_lam
    x = case.y * np.concatenate([s.q, s.v, s.lam, s.eta])
    xp = case.yp * np.concatenate([s.q, s.v, s.lam, s.eta])
    q, v = x[:n] + s.place, x[n : 2 * n]
    lam, eta = x[2 * n : 2 * n + m], x[2 * n + m :]
    drift = constraint_force(system, case.t, q, eta) / system.weights
    Phi_q = system.constraint_pattern.csr(system.constraint_q(case.t, q)).toarray()
    force = system.mass_times(q, xp[n : 2 * n]) + Phi_q.T @ lam - system.force(case.t, q, v)
    parts = [
        (xp[:n] - v + drift) / s.v,
        force / s.force,
        (Phi_q @ v - velocity_side(system, case.t, q)) / (s.row * s.speed),
        system.constraint(case.t, q) / (s.row * s.position),
    ]
    expected = np.concatenate(parts)
    np.testing.assert_allclose(case.form.residual(case.t, case.y, case.yp), expected, rtol=1e-12)


@pytest.mark.parametrize("kind", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize(
    ("length", "mass", "time"), [(1e3, 1e-3, 1.0), (1e-6, 1.0, 1.0), (1e6, 1.0, 1e3), (1, 1e-6, 60)]
)
def test_scaled_equations_are_the_same_in_every_system_of_units(kind, length, mass, time):
    forms, states = [], []
    for units in ((1.0, 1.0, 1.0), (length, mass, time)):
        system = chain(*units)
        problem = InitialValueProblem.of(system, 1.0 * units[2]).differentiated()
        forms.append(kind.form(system, problem.scales))
        y, yp = forms[-1].start(problem.initial)
        Y, Yp = forms[-1].start_b(problem.derivative)
        states.append((y, units[2] * yp, Y, units[2] * Yp))
    rng = np.random.default_rng(1)
    here, there = states
    for x, z in zip(here, there, strict=True):
        np.testing.assert_allclose(z, x, atol=1e-9 * np.max(np.abs(x)), rtol=0)
    y, Y = here[0] + 0.01 * rng.standard_normal(here[0].shape), here[2]
    results = []
    for form, unit in zip(forms, (1.0, time), strict=True):
        # What is left of the unit of time is that of t itself.
        yp, Yp, t = here[1] / unit, here[3] / unit, 0.3 * unit
        J = form.jacobian(t, y, yp, 40.0 / unit)
        rows = form.residual(t, y, yp), form.residual_b(t, y, yp, Y, Yp), J
        results.append(rows)
    for x, z in zip(*results, strict=True):
        np.testing.assert_allclose(z, x, atol=1e-9 * np.max(np.abs(x)), rtol=0)


@pytest.mark.parametrize(("name", "kind"), CASES, ids=IDS)
def test_column_storage_holds_the_block_matrix(name, kind):
    case, m = Case(name, kind), 2
    form, n = case.form, case.form.n
    rng = np.random.default_rng(2)
    own, first, second = rng.standard_normal((3, len(form.rows)))
    storage = ColumnStorage(form, m)
    rows, columns = storage.sparsity()
    stored = np.zeros((n * (m + 1), n * (m + 1)))
    stored[rows, columns] = storage.values(own, [first, second])
    # Sorted by columns and without repetition, as compressed columns are.
    assert np.all(np.diff(columns * n * (m + 1) + rows) > 0)

    def dense(values):
        block = np.zeros((n, n))
        np.add.at(block, (form.rows, form.columns), values)
        return block

    zero = np.zeros((n, n))
    expected = np.block(
        [
            [dense(own), zero, zero],
            [dense(first), dense(own), zero],
            [dense(second), zero, dense(own)],
        ]
    )
    np.testing.assert_allclose(stored, expected, atol=1e-14)
    alone = np.zeros((n, n))
    alone[ColumnStorage(form, 0).sparsity()] = ColumnStorage(form, 0).values(own, [])
    np.testing.assert_allclose(alone, dense(own), atol=1e-14)
