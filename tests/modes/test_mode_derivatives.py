"""Derivatives of modes: direct, adjoint, complex step and differences of the call agree."""

import numpy as np
import pytest

from ancfdae import (
    Adjoint,
    Beam,
    Clamp,
    DirectDifferentiation,
    Distance,
    DistributedForce,
    FollowerForce,
    InitialVelocity,
    Material,
    Pin,
    PointForce,
    PointOnLine,
    Revolute,
    RotationDriver,
    Scene,
    SpringDamper,
    assemble,
    equilibrium,
    modes,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import FormulaSystem, SystemProperties
from ancfdae.laws import Harmonic
from ancfdae.results import LinearisationPoint
from ancfdae.sections import Rectangle
from ancfdae.statics.equilibrium import find_equilibrium
from tests.support.mechanisms import (
    CartesianPendulum,
    GuidedDoublePendulum,
    HeldDoublePendulum,
    WrittenPendulum,
)
from tests.support.members import constraint_force_rate, force_q_times, force_rate

STEP = 1e-40


def cantilever(damping_time=None, width=0.12):
    """Sags by a tenth of its length."""
    damped = {} if damping_time is None else {"damping_time": damping_time}
    material = Material(1000, 2e7, 0.3, **damped)
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 2, Rectangle(0.1, width), material)
    return Scene([rod], [Clamp(rod.at_start)], (0, -9.81, -3.0))


def linkage(damping_time=None):
    """Two soft rods between a pin, a slider and a rope; curved constraints carry load."""
    damped = {} if damping_time is None else {"damping_time": damping_time}
    material = Material(1000, 2e7, 0.0, **damped)
    a = Beam("a", (0, 0), (1, 0.4), 2, Rectangle(0.05, 0.05), material)
    b = Beam("b", (1, 0.4), (2, 0), 2, Rectangle(0.05, 0.05), material)
    joints = [
        Pin(a.at_start),
        Pin(a.at_end, b.at_start, name="knee"),
        PointOnLine(b.at_end, (1.0, 0.1), name="slide"),
        Distance(a.at(0.5), 1.0, other=b.at(0.5), name="rope"),
    ]
    loads = [PointForce(a.at_end, (1.0, -4.0), name="weight")]
    return Scene([a, b], joints, (0, -9.81), loads=loads, project_start=True)


def pressed(damping_time=None):
    """Follower force and spring-damper: K is not symmetric."""
    damped = {} if damping_time is None else {"damping_time": damping_time}
    rod = Beam("rod", (0, 0), (1, 0), 4, Rectangle(0.05, 0.05), Material(1000, 2e7, 0.0, **damped))
    loads = [
        FollowerForce(rod.at_end, (-9.0, -5.0), name="jet"),
        SpringDamper(rod.at(0.5), 300.0, 2.0 if damped else 0.0, ground=(0.4, -0.5), name="strut"),
        DistributedForce("rod", (0.0, -9.0), name="snow"),
    ]
    return Scene([rod], [Clamp(rod.at_start)], loads=loads)


def driven(damping_time=None, balanced=False):
    """Joints that turn: Phi_qt counts neither in K nor in its derivatives.

    In balance the crank stands where it turns round.
    """
    law = Harmonic(0.5, 4.0, np.pi / 2, -0.5) if balanced else Harmonic(0.5, 4.0)
    damped = {} if damping_time is None else {"damping_time": damping_time}
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.05, 0.05), Material(1000, 2e7, 0.0, **damped))
    joints = [
        Pin(rod.at_start),
        RotationDriver(rod.at(0.5), law, name="drive"),
        Distance(rod.at_end, 1.0, ground=(2, 0), name="rope"),  # Not linear in q.
    ]
    spin = [InitialVelocity("rod", 2.0, (0, 0))]
    return Scene([rod], joints, (0, -9.81), start=spin, project_start=True)


def driven_round(damping_time=None):
    return driven(damping_time, True)


CASES = {
    "cantilever": (cantilever, ["rod.youngs_modulus", "rod.height", "rod.length", "rod.density"]),
    "linkage": (linkage, ["a.length", "b.height", "slide.direction_y", "weight.force_y"]),
    "driven": (driven_round, ["rod.density", "rod.height"]),
    "pressed": (pressed, ["rod.length", "jet.force_x", "strut.stiffness", "rod.youngs_modulus"]),
}


def complex_step(system, at, found, mode, variable):
    """Return z_b and x_b from matrices moved by a complex step of one variable.

    The equilibrium follows by Newton's method in complex numbers; one correction of F(z) x +
    Phi_q^T mu = 0, Phi_q x = 0, x^H M x = 1 by dense matrices gives the mode: the step is so small
    that it is exact.
    """
    b = system.b.astype(complex)
    b[variable] += 1j * STEP
    moved = system.with_values(b)
    state = find_equilibrium(moved, start=(at.q, at.lam))
    real, change = matrices(system, at.q, at.lam), matrices(moved, state.q, state.lam)
    (M, D, K, B), (dM, dD, dK, dB) = real, [x.imag / STEP for x in change]
    x, mu, s = found.shapes[:, mode], found.multipliers[:, mode], found.exponents[mode]
    n, m = len(x), len(mu)
    if np.iscomplexobj(x):
        F, slope, dF = s * s * M + s * D + K, 2 * s * M + D, s * s * dM + s * dD + dK
    else:
        F, slope, dF = K + (s * s).real * M, -M, dK + (s * s).real * dM
    J = np.zeros((n + m + 1, n + m + 1), dtype=F.dtype)
    J[:n, :n], J[:n, n:-1], J[n:-1, :n] = F, B.T, B
    J[:n, -1], J[-1, :n] = slope @ x, 2 * np.conj(x) @ M
    right = np.concatenate([dF @ x + dB.T @ mu, dB @ x, [np.conj(x) @ dM @ x]])
    solution = np.linalg.solve(J, -right)
    return solution[-1], solution[:n]


def matrices(system, q, lam):
    """M, D, K and Phi_q of a system at rest as arrays, real or complex: tangents of loads are real.

    Columns are rates along unit velocities, and of D along unit accelerations.
    """
    rest, units = np.zeros(system.n_q), np.eye(system.n_q)
    K = [constraint_force_rate(system, 0.0, q, e, lam) for e in units]
    turning = constraint_force_rate(system, 0.0, q, rest, lam)
    K = [x - turning - force_q_times(system, 0.0, q, e) for x, e in zip(K, units, strict=True)]
    D = [-force_rate(system, 0.0, q, rest, e) for e in units]
    M, B = system.pattern.dense(system.mass(q)), system.constraint_pattern
    return M, np.array(D).T, np.array(K).T, B.dense(system.constraint_q(0.0, q))


@pytest.mark.parametrize("damping_time", [None, 1e-3])
@pytest.mark.parametrize("case", CASES)
def test_direct_adjoint_and_complex_step_agree(case, damping_time):
    make, names = CASES[case]
    scene = make(damping_time)
    system = assemble(scene, names)
    at = equilibrium(scene)
    assert at.outcome.success
    direct = modes(scene, 4, at=at, design=names, method=DirectDifferentiation())
    back = modes(scene, 4, at=at, design=names, method=Adjoint())
    assert direct.coincide == ()
    s_b = direct.derivatives.exponents_b
    # The issue asks 1e-9: conditioning of K (1e6) times round-off.
    np.testing.assert_allclose(
        back.derivatives.exponents_b, s_b, rtol=1e-9, atol=1e-9 * np.abs(s_b).max()
    )
    sizes = np.abs(s_b).max(axis=0)
    for mode in range(4):
        for i in range(len(names)):
            z_b, x_b = complex_step(system, at, direct, mode, i)
            s = direct.exponents[mode]
            expected = z_b if np.iscomplexobj(direct.shapes) else -z_b / (2 * s)
            assert abs(s_b[mode, i] - expected) < 1e-9 * sizes[i]
            found = direct.shape_b(mode)[:, i]
            if not np.iscomplexobj(direct.shapes):
                assert np.max(np.abs(found - x_b)) < 1e-8 * max(
                    np.max(np.abs(found)), np.max(np.abs(direct.shapes[:, mode])) / system.b[i]
                )


@pytest.mark.parametrize("damping_time", [None, 1e-3])
@pytest.mark.parametrize("balanced", [True, False])
@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_the_limit_of_differences_of_the_call(case, balanced, damping_time):
    make, names = CASES[case]
    make = driven if case == "driven" and not balanced else make
    scene = make(damping_time)

    def call(scene, **more):
        at = equilibrium(scene) if balanced else None
        return modes(scene, 3, at=at, **more)

    found, back = call(scene, design=names), call(scene, design=names, method=Adjoint())
    slopes = found.derivatives.exponents_b
    # As above.
    np.testing.assert_allclose(
        back.derivatives.exponents_b, slopes, rtol=1e-9, atol=1e-9 * np.abs(slopes).max()
    )
    for i, name in enumerate(names):
        value = assemble(scene, [name]).b[0]
        # Unsymmetric modes are iterated to some 1e-11, which a longer step divides.
        step = (1e-4 if case == "pressed" else 1e-5) * (abs(value) or 1.0)
        around = [call(scene.with_values({name: value + k * step})) for k in (1, -1, 2, -2)]

        def slope(of, around=around, step=step):
            one, less, two, least = (of(x) for x in around)
            return (8 * (one - less) - (two - least)) / (12 * step)

        # A length that is 6e-3 too long buckles the rods of the linkage: truncation measured is
        # 4e-8, and falls with the fourth power; round-off is 1e-12 of the values over 1e-5.
        exact = found.derivatives.exponents_b[:, i]
        scale = np.abs(found.exponents) / (abs(value) or 1.0) + np.abs(exact)
        error = np.abs(slope(lambda x: x.exponents) - exact)
        assert np.all(error < 1e-6 * scale), name
        for mode in range(3):
            expected = slope(lambda x, mode=mode: x.shapes[:, mode])
            error = np.max(np.abs(expected - found.shape_b(mode)[:, i]))
            size = np.max(np.abs(found.shapes[:, mode])) / (abs(value) or 1.0)
            size += np.max(np.abs(expected))
            assert error < 1e-5 * size, (name, mode)


@pytest.mark.parametrize("kind", [CartesianPendulum, WrittenPendulum])
def test_derivatives_at_a_start_that_follows_the_design(kind):
    b = np.array([1.3, 9.81])
    direct, back = (
        modes(kind(0.6, b=b), method=x).frequencies_b for x in (DirectDifferentiation(), Adjoint())
    )
    # Held at an angle the tension is m g cos, and with it omega^2 = g cos/L.
    omega = np.sqrt(9.81 * np.cos(0.6) / 1.3)
    np.testing.assert_allclose(direct, [[-omega / 2.6, omega / 19.62]], rtol=1e-11)
    np.testing.assert_allclose(back, direct, rtol=1e-11)


@pytest.mark.parametrize("kind", [CartesianPendulum, WrittenPendulum])
def test_systems_of_ones_own_have_derivatives(kind):
    found = modes(kind(0.0, b=(1.3, 9.81)))
    omega = np.sqrt(9.81 / 1.3)
    # By formula, to round-off.
    np.testing.assert_allclose(found.frequencies_b, [[-omega / 2.6, omega / 19.62]], rtol=1e-12)
    back = modes(kind(0.0, b=(1.3, 9.81)), method=Adjoint())
    np.testing.assert_allclose(back.frequencies_b, found.frequencies_b, rtol=1e-12)


class Shaken(FormulaSystem):
    """m x'' + c x' + k (x - sin 3 t) = 0: what shakes it counts neither in D nor in K."""

    n_q, n_lam = 1, 0
    design_names = ("k", "c", "m")
    traits = SystemProperties(constant_mass=True, linear_constraints=True)

    def with_values(self, b):
        return Shaken(b)

    def start(self):
        return np.zeros(1), np.zeros(1)

    def mass_matrix(self, q):
        return self.b[2] * np.eye(1)

    def force(self, t, q, v):
        return self.b[0] * (np.sin(3 * t) - q) - self.b[1] * v

    def position_constraint(self, t, q):
        return np.zeros(0)


def test_forces_that_change_at_rest_leave_derivatives_alone():
    k, c, m = 7.0, 0.3, 2.0
    s = (-c + 1j * np.sqrt(4 * k * m - c * c)) / (2 * m)
    expected = -np.array([1.0, s, s * s]) / (2 * m * s + c)
    for method in (DirectDifferentiation(), Adjoint()):
        found = modes(Shaken((k, c, m)), 1, method=method)
        # Circles in the complex plane are good to 1e-12.
        np.testing.assert_allclose(found.derivatives.exponents_b[0], expected, atol=1e-11)


class Bead(FormulaSystem):
    """A bead on the wire y = k x^2 that is held at x_0, which is a design variable."""

    n_q, n_lam = 2, 1
    design_names = ("k", "x_0", "m")
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def with_values(self, b):
        return Bead(b)

    def start(self):
        k, x_0, _ = self.b
        return np.array([x_0, k * x_0**2]), np.zeros(2)

    def mass_matrix(self, q):
        return self.b[2] * np.eye(2)

    def force(self, t, q, v):
        return np.array([-3.0 * q[0] ** 3, -9.81 * self.b[2]])

    def position_constraint(self, t, q):
        return np.array([q[1] - self.b[0] * q[0] ** 2])


def test_a_start_that_moves_while_it_is_out_of_balance():
    b = np.array([0.8, 0.4, 1.5])
    direct, back = (
        modes(Bead(b), method=x).frequencies_b for x in (DirectDifferentiation(), Adjoint())
    )
    # Circles in the complex plane are good to 1e-12.
    np.testing.assert_allclose(back, direct, rtol=1e-10)
    for i in range(3):
        step = 1e-4 * np.eye(3)[i]
        up, down = (modes(Bead(b + x)).frequencies for x in (step, -step))
        # Truncation 1e-8 times the third derivative.
        np.testing.assert_allclose(direct[:, i], (up - down) / 2e-4, rtol=1e-6)


@pytest.mark.parametrize("balanced", [True, False])
def test_a_mass_that_depends_on_q_and_damping_have_derivatives(balanced):
    b = np.array([1.5, 1.0, 0.3, 0.1])

    def call(b, method=None):
        system = (HeldDoublePendulum if balanced else GuidedDoublePendulum)(0.0, b)
        return modes(system, at=equilibrium(system) if balanced else None, method=method)

    slopes, back = (
        call(b, x).derivatives.exponents_b for x in (DirectDifferentiation(), Adjoint())
    )
    # Circles in the complex plane are good to 1e-12.
    np.testing.assert_allclose(back, slopes, atol=1e-11)
    along = 1e-4 * np.array([1.0, -0.7, 0.4, 0.2])
    up, down = call(b + along).exponents, call(b - along).exponents
    # Truncation 1e-8 times the third derivative.
    np.testing.assert_allclose(1e4 * slopes @ along, (up - down) / 2e-4, atol=1e-6)


def test_modes_that_coincide_split_by_the_eigenvalues_of_the_reduced_matrix():
    names = ["rod.height", "rod.width", "rod.youngs_modulus"]

    def square(height=0.1, width=0.1, damping_time=None):
        damped = {} if damping_time is None else {"damping_time": damping_time}
        material = Material(1000, 2e7, 0.3, **damped)
        rod = Beam("rod", (0, 0, 0), (1, 0, 0), 3, Rectangle(height, width), material)
        return Scene([rod], [Clamp(rod.at_start)])

    found = modes(square(), 1, design=names)
    assert found.coincide == ((0, 1),)
    step = 1e-6
    for i, name in enumerate(("height", "width")):
        up, down = (
            np.sort(modes(square(**{name: 0.1 + k * step}), 2).frequencies) for k in (1, -1)
        )
        expected = [(up[0] - found.frequencies[0]) / step, (up[1] - found.frequencies[1]) / step]
        # One-sided differences: a step of 1e-5 of the size. Round-off 1e-10 of it over 1e-5.
        np.testing.assert_allclose(found.frequencies_b[:, i], expected, atol=1e-3 * expected[1])
        expected = [
            (found.frequencies[1] - down[1]) / step,
            (found.frequencies[0] - down[0]) / step,
        ]
        np.testing.assert_allclose(found.frequencies_b[:, i], expected, atol=1e-3 * expected[1])
    omega = found.frequencies[0]
    np.testing.assert_allclose(found.frequencies_b[:, 2], omega / 4e7, rtol=1e-8)
    with pytest.raises(InvalidInputError, match="modes 0, 1 that coincide"):
        found.shape_b(0)
    back = modes(square(), 1, design=names, method=Adjoint())
    np.testing.assert_allclose(back.frequencies_b, found.frequencies_b, atol=1e-9 * omega / 0.1)
    # zeta = tau omega/2 with damping proportional to stiffness: s = -tau omega^2/2 + i ...
    damped = modes(square(damping_time=1e-3), 1, design=names)
    assert damped.coincide == ((0, 1),)
    slopes = damped.natural_frequencies_b[np.argsort(damped.natural_frequencies_b[:, 0])]
    np.testing.assert_allclose(slopes[:, 0], found.frequencies_b[:, 0], atol=1e-7 * omega / 0.1)
    ratio_b = 0.5e-3 * np.sort(found.frequencies_b[:, 0])
    np.testing.assert_allclose(np.sort(damped.damping_ratios_b[:, 0]), ratio_b, atol=1e-9)


def test_rigid_modes_stay_rigid():
    rod = Beam("rod", (0, 0), (1, 0), 3, Rectangle(0.1, 0.1), Material(1000, 2e7, 0.3))
    scene = Scene([rod], [Pin(rod.at_start)])
    found = modes(scene, 2, design=["rod.length", "rod.density"])
    np.testing.assert_array_equal(found.frequencies_b[0], 0.0)
    # x^T M x = 1: the shape of a swinging rod goes with rho^-1/2, and with L^-3/2 (its slopes).
    np.testing.assert_allclose(
        found.shape_b(0)[:, 1], -found.shapes[:, 0] / 2000, atol=1e-9 * np.abs(found.shapes).max()
    )


def test_a_hinge_in_space_keeps_its_axis_in_the_derivatives():
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 2, Rectangle(0.1, 0.12), Material(1000, 2e7, 0.3))
    scene = Scene([rod], [Revolute(rod.at_start, axis=(0, 0.3, 1), name="hinge")])
    names = ["rod.length", "hinge.axis_y"]
    found, back = (
        modes(scene, 4, design=names, method=x) for x in (DirectDifferentiation(), Adjoint())
    )
    size = np.abs(found.frequencies_b).max()
    np.testing.assert_allclose(back.frequencies_b, found.frequencies_b, atol=1e-9 * size)
    up, down = (
        modes(scene.with_values({"hinge.axis_y": 0.3 + k}), 4).frequencies for k in (1e-4, -1e-4)
    )
    # Truncation (1e-4)^2 against an axis of the size of one.
    expected = (up - down) / 2e-4
    np.testing.assert_allclose(found.frequencies_b[:, 1], expected, atol=1e-6 * size)


def test_what_cannot_be_differentiated_is_refused():
    scene = cantilever()
    names = ["rod.height"]
    with pytest.raises(InvalidInputError, match="method"):
        modes(scene, design=names, method="adjoint")
    with pytest.raises(InvalidInputError, match="differentiated directly"):
        modes(scene, design=names, method=Adjoint()).shape_b(0)
    part = equilibrium(scene, max_steps=1)
    if not part.outcome.success:
        with pytest.raises(InvalidInputError, match="full load"):
            modes(scene, at=part, design=names)


def test_given_derivatives_of_a_configuration_count():
    scene, names = cantilever(), ["rod.height", "rod.length"]
    at = equilibrium(scene, design=names)
    given = LinearisationPoint(at.q, at.lam, at.q_b, at.lam_b)
    expected = modes(scene, 3, at=at, design=names).frequencies_b
    for method in (DirectDifferentiation(), Adjoint()):
        found = modes(scene, 3, at=given, design=names, method=method).frequencies_b
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    held = modes(scene, 3, at=LinearisationPoint(at.q, at.lam), design=names).frequencies_b
    assert np.max(np.abs(held - expected)) > 1e-3 * np.max(np.abs(expected))


@pytest.mark.parametrize("height", [1e-2, 1e-4])
def test_motions_that_creep_have_the_derivative_of_the_retardation_time(height):
    """s = -1/tau of every motion, soft or stiff: shapes differ, and none is a double root."""
    tau = 0.058 / height * 1e-2
    section, law = Rectangle(height, 2 * height), Material(7800.0, 2e11, 0.3, damping_time=tau)
    strip = Beam("strip", (0, 0), (1, 0), 6, section, law)
    scene = Scene([strip], [Clamp(strip.at_start)])
    found = modes(scene, 4, design=["strip.damping_time", "strip.density"])
    np.testing.assert_allclose(found.exponents, -1 / tau, rtol=1e-6)
    slopes = found.derivatives.exponents_b
    np.testing.assert_allclose(slopes[:, 0], 1 / tau**2, rtol=1e-6)
    np.testing.assert_allclose(slopes[:, 1] * 7800.0 * tau, 0.0, atol=1e-6)
