"""Scenes in a turning frame: contract, equilibrium, modes and their derivatives, refusals."""

import numpy as np
import pytest
import scipy
from numpy.polynomial.legendre import Legendre, leggauss

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    EquilibriumStart,
    Material,
    NodalState,
    Pin,
    PointMass,
    RigidBody,
    RigidCylinder,
    RotatingFrame,
    RotationDriver,
    Scene,
    Terminal,
    Weld,
    assemble,
    campbell,
    check_system,
    equilibrium,
    equilibrium_gradient,
    gradient,
    modes,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.laws import ConstantAcceleration
from ancfdae.observables import position, reaction
from ancfdae.sections import Circle, Rectangle
from tests.support.scenes import rotor

DESIGN = [
    "scene.rate",
    "scene.axis_x",
    "scene.through_y",
    "blade.height",
    "blade.length",
    "tip.mass",
    "mid.mass",
]


def tilted(retardation=0.0):
    soft = Material(1000.0, 1e7, 0.3, retardation)
    blade = Beam("blade", (0.3, 0, 0), (1.3, 0.1, 0.05), 1, Rectangle(0.05, 0.03), soft)
    tip = RigidBody("tip", (1.3, 0.1, 0.05), mass=0.7, inertia=(0.01, 0.012, 0.015))
    return Scene(
        [blade],
        [Clamp(blade.at_start, name="root"), Weld(blade.at_end, tip.at(0, 0, 0))],
        bodies=[tip, PointMass(blade.at(0.5), 0.2, name="mid")],
        frame=RotatingFrame(5.0, axis=(1, 2, 4), through=(0.1, 0.2, -0.1)),
    )


def planar(rate=6.0, hub=0.3, n=4):
    material = Material(1000.0, 1e7, 0.0)
    blade = Beam("blade", (hub, 0), (hub + 1.0, 0), n, Rectangle(0.05, 0.03), material)
    return Scene([blade], [Clamp(blade.at_start)], frame=RotatingFrame(rate))


def test_every_member_of_the_system_is_what_its_values_say():
    check_system(assemble(tilted(1e-3), DESIGN), samples=1).raise_if_wrong()


def test_a_rate_turns_centrifugal_force_out():
    # Without bending stiffness between them: N = m w^2 r at the root of a rigid arm.
    arm = Beam("arm", (0, 0), (2, 0), 1, Rectangle(0.1, 0.1), Material(500.0, 1e9, 0.3), rigid=True)
    frame = RotatingFrame(3.0, through=(-1.0, 0.0))
    at = equilibrium(Scene([arm], [Clamp(arm.at_start, name="root")], frame=frame))
    pull = at.solution.reaction("root")[0][:2]
    mass = 500.0 * 0.1 * 0.1 * 2
    np.testing.assert_allclose(pull, [-mass * 9.0 * 2.0, 0.0], atol=1e-9)


def test_steady_rotation_in_a_frame_at_rest_is_the_equilibrium():
    rate = 6.0
    scene = planar(rate, hub=0.0)
    at = equilibrium(scene)
    nodes = at.solution.nodes("blade")[0]
    turned = rate * nodes @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    blade = scene.beams[0]
    joints = [Pin(blade.at_start), RotationDriver(blade.at_start, ConstantAcceleration(rate))]
    start = [NodalState("blade", nodes, turned)]
    run = simulate(Scene([blade], joints, start=start), 0.1, HHT(1e-3))
    c, s = np.cos(rate * 0.1), np.sin(rate * 0.1)
    # HHT-I3 errs by (rate h)^2/12 = 3e-6 of the angle in turning; stretch is 5e-5 and would vary.
    expected = nodes[-1, 0] @ np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(run.position(blade.at_end)[-1], expected, atol=1e-5)
    lengths = np.linalg.norm(run.position(blade.at_end), axis=1)
    np.testing.assert_allclose(lengths - 1, nodes[-1, 0, 0] - 1, rtol=1e-2)


def test_static_gradients_agree():
    scene = tilted()
    value = position(scene.beams[0].at_end, 0) + 1e-3 * reaction("root", 0)
    given = [
        equilibrium_gradient(scene, value, design=DESIGN, method=method)
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    for other in given[1:]:
        np.testing.assert_allclose(other.gradient, given[0].gradient, rtol=1e-10)


def test_gradients_of_motions_in_the_frame_agree():
    scene, end = tilted(1e-3), Terminal(position(tilted().beams[0].at_end, 2))
    direct, adjoint, complex_step = (
        gradient(scene, end, 0.05, HHT(0.01), design=DESIGN, method=method).gradient
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    )
    np.testing.assert_allclose(adjoint, direct, rtol=1e-10)
    np.testing.assert_allclose(complex_step, direct, rtol=1e-10)


def test_derivatives_of_frequencies_are_those_of_the_call():
    scene = tilted()
    at = equilibrium(scene)
    direct = modes(scene, 4, at=at, design=DESIGN).frequencies_b
    adjoint = modes(scene, 4, at=at, design=DESIGN, method=Adjoint()).frequencies_b
    np.testing.assert_allclose(adjoint, direct, rtol=1e-8, atol=1e-10 * np.max(np.abs(direct)))
    values = assemble(scene, DESIGN).b
    for k, name in enumerate(DESIGN):
        h, ends = 1e-4 * abs(values[k]), []
        for sign in (1, -1):
            moved = scene.with_values({name: values[k] + sign * h})
            ends.append(modes(moved, 4, at=equilibrium(moved)).frequencies)
        # h^2 of the relative change, and round-off 1e-11 over h of the largest frequency, 430.
        difference = (ends[0] - ends[1]) / (2 * h)
        size = np.max(np.abs(difference))
        np.testing.assert_allclose(direct[:, k], difference, atol=2e-6 * size)


def ritz(speed, hub, degree=20):
    """Flap and lead-lag of the Euler beam over sqrt(E I/(rho A L^4)); polynomials that clamp."""
    points, weights = leggauss(2 * degree)
    x, w = (points + 1) / 2, weights / 2
    clamp = Legendre.fromroots([0.0, 0.0], domain=[0, 1])
    shapes = [clamp * Legendre.basis(k, domain=[0, 1]) for k in range(degree)]
    V, V_1, V_2 = (np.array([s.deriv(m)(x) if m else s(x) for s in shapes]).T for m in (0, 1, 2))
    M = (V.T * w) @ V
    tension = hub * (1 - x) + (1 - x**2) / 2
    K = (V_2.T * w) @ V_2 + speed**2 * (V_1.T * (w * tension)) @ V_1
    flap = scipy.linalg.eigh(K, M, eigvals_only=True, subset_by_index=[0, 1])
    return np.sqrt(flap), np.sqrt(flap - speed**2)


@pytest.mark.parametrize(("hub", "speed"), [(0.0, 12.0), (5.0, 6.0)])
def test_flap_and_lead_lag_are_those_of_the_rotating_euler_beam(hub, speed):
    size, rho, E = 0.004, 1000.0, 1e9
    unit = np.sqrt(E * size**2 / (12 * rho))
    blade = Beam("blade", (0, 0, 0), (1, 0, 0), 8, Rectangle(size, size), Material(rho, E, 0.0))
    frame = RotatingFrame(speed * unit, through=(-hub, 0, 0))
    scene = Scene([blade], [Clamp(blade.at_start)], frame=frame)
    flap, lag = ritz(speed, hub)
    expected = np.sort([*flap, *lag])
    # Stretch (speed^2 size^2/12) and rotary inertia change frequencies by 1e-4.
    found = modes(scene, 4, at=equilibrium(scene)).frequencies / unit
    np.testing.assert_allclose(found, expected, rtol=4e-4)


def shaft(n=4):
    rod = Beam("shaft", (0, 0, 0), (0, 0, 1), n, Circle(0.005), Material(7850.0, 2.1e11, 0.3))
    disc = RigidBody("disc", (0, 0, 1), shape=RigidCylinder(0.1, 0.01), density=7850.0)
    joints = [Clamp(rod.at_start), Weld(rod.at_end, disc.at(0, 0, 0))]
    return Scene([rod], joints, bodies=[disc], frame=RotatingFrame(0.0))


def whirl_determinant(speed, rate):
    """Determinant of the Euler-Bernoulli shaft of `shaft`, clamped, a disc at its end."""
    A, I, rho, E = np.pi * 0.005**2, np.pi * 0.005**4 / 4, 7850.0, 2.1e11
    m = rho * np.pi * 0.1**2 * 0.01
    across, polar = m * (0.1**2 / 4 + 0.01**2 / 12), m * 0.1**2 / 2
    k = (rho * A * speed**2 / (E * I)) ** 0.25
    C, S, c, s = np.cosh(k), np.sinh(k), np.cos(k), np.sin(k)
    u, u_1 = np.array([C - c, S - s]), k * np.array([S + s, C - c])
    u_2, u_3 = k**2 * np.array([C + c, S + s]), k**3 * np.array([S - s, C + c])
    tilt = across * speed**2 - polar * rate * speed
    return np.linalg.det([E * I * u_2 - tilt * u_1, E * I * u_3 + m * speed**2 * u]) / k**4


def test_forward_and_backward_whirl_are_those_of_the_shaft_with_a_disc():
    rates = [0.0, 50.0, 100.0, 150.0, 200.0]
    diagram = campbell(shaft(), rates, 5)
    speeds = diagram.whirl_speeds[-1]
    bending = np.abs(diagram.whirl[-1]) > 0.99
    assert np.sum(bending) == 4
    for speed in speeds[bending]:
        ends = [speed * (1 - 2e-3), speed * (1 + 2e-3)]
        assert whirl_determinant(ends[0], 200.0) * whirl_determinant(ends[1], 200.0) < 0
    assert np.sum(speeds[bending] > 0) == 2
    # At rest pairs part by what gyroscopic forces do first.
    at_rest = diagram.frequencies_b[0, :2, 0]
    np.testing.assert_allclose(at_rest, -at_rest[::-1], rtol=1e-6)
    assert np.abs(at_rest[0]) > 0.9


def test_torsion_keeps_its_frequency_at_rest_and_signs_do_not_jump():
    """Rates change neither GI_p nor the polar inertia: omega = (pi/2 L) sqrt(G/rho)."""
    E, rho = 2e11, 7800.0
    bar = Beam("bar", (0, 0, 0), (1, 0, 0), 4, Circle(0.025), Material(rho, E, 0.3))
    scene = Scene([bar], [Clamp(bar.at_start)], frame=RotatingFrame(0.0, axis=(1, 0, 0)))
    diagram = campbell(scene, [0.0, 100.0, 600.0], 8)
    speeds, torsion = diagram.whirl_speeds, np.pi / 2 * np.sqrt(E / 2.6 / rho)
    column = np.argmin(np.abs(speeds[0] - torsion))
    # Linear in each of four elements: (pi/2/4)^2 / 24 of the frequency; cubic ones are better.
    np.testing.assert_allclose(speeds[:, column], torsion, rtol=7e-3)
    np.testing.assert_allclose(speeds[:, column], speeds[0, column], rtol=1e-3)
    circles = np.abs(diagram.whirl) > 0.99
    assert np.all(circles == circles[0])
    # Gyroscopic forces on a thin shaft change speeds of bending by 1 % here; a jump is a sign.
    turned = speeds[:, circles[0]]
    np.testing.assert_allclose(turned, np.tile(turned[0], (3, 1)), rtol=0.02)
    assert sorted(np.sign(turned[0])) == [-1.0] * 4 + [1.0] * 4


def test_energy_in_a_turning_frame_counts_the_centrifugal_potential_once():
    """A mass m at a distance r from the axis has -m w^2 r^2 / 2 there, by hand."""
    body = RigidBody("bead", (0.6, 0.0), mass=2.0, inertia=0.5)
    turning, still = (
        assemble(Scene([], bodies=[body], frame=RotatingFrame(rate, through=(0.1, 0.0))))
        for rate in (5.0, 0.0)
    )
    q = turning.start()[0]
    rest = np.zeros((1, turning.n_q))
    left = turning.energies.total(q[None], rest) - still.energies.total(q[None], rest)
    # A plane body that turns has its inertia about the axis: m r^2 + J.
    np.testing.assert_allclose(left, -0.5 * 25.0 * (2.0 * 0.5**2 + 0.5), rtol=1e-12)


def test_lines_of_a_campbell_diagram_are_smooth_where_they_cross():
    diagram = campbell(shaft(), np.linspace(50.0, 200.0, 7), 5)
    w, w_b, h = diagram.frequencies, diagram.frequencies_b[:, :, 0], 25.0
    order = np.argsort(w, axis=1)
    assert np.any(order[0] != order[-1])
    # Trapezia of the slopes: what is left is h^3/12 of the third derivative.
    np.testing.assert_allclose(np.diff(w, axis=0), h * (w_b[1:] + w_b[:-1]) / 2, atol=0.05)


def test_a_start_at_rest_under_other_gravity_keeps_the_numbers_of_the_frame():
    blade = spatial()
    scene = Scene(
        [blade],
        [Clamp(blade.at_start)],
        start=[EquilibriumStart(gravity=(0, 0, -9.81))],
        frame=RotatingFrame(5.0),
    )

    def end(rate):
        run = simulate(scene.with_values({"scene.rate": rate}), 0.01, HHT(0.01))
        return run.position(blade.at_end)[0]

    system = assemble(scene, ["scene.rate"])
    moved = system.start_b()[0][system.naming.layout.body("blade").positions[-1] * 3, 0]
    difference = (end(5.01) - end(4.99)) / 0.02
    np.testing.assert_allclose(moved, difference[0], rtol=1e-4)


def spatial():
    material = Material(1000.0, 1e7, 0.3)
    return Beam("blade", (0, 0, 0), (1, 0, 0), 2, Rectangle(0.05, 0.03), material)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gravity": (0, -9.81, 0)}, "along the axis of the rotating frame"),
        ({"frame": RotatingFrame(1.0, through=(0, 0))}, "must have 3 components"),
        ({"frame": 3.0}, "RotatingFrame"),
    ],
)
def test_what_does_not_turn_steadily_is_refused(change, said):
    blade = spatial()
    with pytest.raises(InvalidInputError, match=said):
        Scene([blade], [Clamp(blade.at_start)], **({"frame": RotatingFrame(1.0)} | change))


def test_the_plane_has_no_other_axis_and_its_gravity_turns():
    blade = planar().beams[0]
    for more in ({"frame": RotatingFrame(1.0, axis=(0, 0, 1))}, {"gravity": (0, -9.81)}):
        with pytest.raises(InvalidInputError, match=r"rotat|turn"):
            Scene([blade], [Clamp(blade.at_start)], **({"frame": RotatingFrame(1.0)} | more))


def test_a_joint_that_is_driven_in_the_frame_is_refused():
    blade = planar().beams[0]
    joints = [Pin(blade.at_start), RotationDriver(blade.at_start, ConstantAcceleration(2.0))]
    with pytest.raises(InvalidInputError, match="RotatingFrame"):
        equilibrium(Scene([blade], joints, frame=RotatingFrame(1.0)))


def test_campbell_diagrams_refuse_a_scene_at_rest_and_rates_out_of_order():
    scene = planar()
    with pytest.raises(InvalidInputError, match="ascend"):
        campbell(scene, [1.0, 1.0], 2)
    with pytest.raises(InvalidInputError, match="RotatingFrame"):
        campbell(Scene(scene.beams, scene.joints), [1.0], 2)


def test_round_off_that_grows_takes_no_place_of_a_mode():
    # LAPACK leaves +3e-7 of real part to some of these, more than the noise of a sharpened one.
    for length in (0.9999, 1.0001):
        scene = shaft().with_values({"scene.rate": 150.0, "shaft.length": length})
        found = modes(scene, 4, at=equilibrium(scene)).frequencies
        np.testing.assert_allclose(found, [65.7, 80.2, 138.4, 160.1], rtol=1e-3)


def test_a_conservative_shaft_has_no_exponent_that_grows():
    # K is symmetric and D gyroscopic. Inverse iteration left +2e-8 to one in three of these.
    for radius in 0.005 * (1 + 1e-4 * np.arange(-4, 5)):
        scene = shaft(8).with_values({"scene.rate": 150.0, "shaft.radius": radius})
        exponents = modes(scene, 4, at=equilibrium(scene)).exponents
        np.testing.assert_allclose(exponents.imag, [65.7, 80.2, 138.4, 160.1], rtol=3e-3)
        assert np.all(exponents.real == 0)


def test_frequencies_of_a_shaft_are_smooth_in_its_radius():
    # Round-off of 1e-11 of the frequencies; 1e-7 before what solves leave in the constraints was
    # taken out of the quotient. The part of third order of 1e-4 is 1e-12.
    changes, found = np.linspace(-1, 1, 9), []
    for change in changes:
        scene = shaft(8).with_values({"scene.rate": 150.0, "shaft.radius": 0.005 + 5e-7 * change})
        found.append(modes(scene, 4, at=equilibrium(scene)).frequencies)
    curve = np.polynomial.polynomial.polyfit(changes, found, 2)
    apart = np.polynomial.polynomial.polyval(changes, curve).T - found
    assert np.max(np.abs(apart) / found) < 1e-9


@pytest.mark.parametrize("rate", [8.0, 14.0, 100.0])
def test_an_unbalanced_shaft_centres_itself_above_its_critical_speed(rate):
    scene = shaft()
    extra = PointMass(scene.bodies[0].at(0.08, 0, 0), 0.01, name="extra")
    joints, bodies = scene.joints, [*scene.bodies, extra]
    at = equilibrium(Scene(scene.beams, joints, bodies=bodies, frame=RotatingFrame(rate)))
    assert at.outcome.success
    assert (at.outcome.stable_to is None) == (rate < 10.85)
    # It turns already: the outcome speaks of gyroscopic forces, not of what would be if it turned.
    assert ("unless gyroscopic forces hold it" in str(at.outcome)) == (rate > 10.85)
    assert "buckled" not in str(at.outcome)
    x = at.solution.position(scene.beams[0].at_end)[0, 0]
    # One mass on a spring: e w^2/(w_1^2 - w^2), e = 0.01 * 0.08 / mass; the shaft has a tenth of
    # the mass of the disc, and the disc tilts.
    e = 0.01 * 0.08 / (7850 * np.pi * 0.1**2 * 0.01)
    np.testing.assert_allclose(x, e * rate**2 / (10.85**2 - rate**2), rtol=0.15)


@pytest.mark.parametrize("damping", [0.0, 0.4])
@pytest.mark.parametrize("first", [0.25, 10.75])
def test_a_shaft_that_is_not_round_has_its_unstable_speeds(first, damping):
    # A point of mass m in springs k_x, k_y and dampers c that turn (Jeffcott):
    # (m s^2 + c s + k_x - m w^2)(m s^2 + c s + k_y - m w^2) + 4 m^2 w^2 s^2 = 0
    m, k, rates = 2.0, np.array([200.0, 288.0]), np.arange(first, 16.0, 0.5)
    diagram = campbell(rotor(damping=damping), rates, 2)
    for rate, found in zip(rates, diagram.exponents, strict=True):
        x, y = (np.array([m, damping, each - m * rate**2]) for each in k)
        roots = np.roots(np.polyadd(np.polymul(x, y), [4 * m**2 * rate**2, 0, 0]))
        vibrate = sorted(roots[roots.imag > 1e-9], key=lambda s: s.imag)
        still = roots[abs(roots.imag) <= 1e-9].real
        expected = vibrate if len(vibrate) == 2 else [np.max(still), *vibrate]
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)
    lower = diagram.exponents[:, 0]
    between = (rates > 10.0) & (rates < 12.0) if not damping else np.abs(rates - 11.0) < 0.6
    assert np.all(lower[between].real > 0.1)
    assert not np.any(lower[between].imag)
    # Lines do not jump.
    assert np.max(np.abs(np.diff(diagram.exponents**2, axis=0))) < 70.0
    assert np.max(np.abs(np.diff(diagram.exponents[:, 1]))) < 1.5


def test_a_pair_that_coincides_at_the_first_rate_is_not_cut():
    # Which of the two a line followed was left to round-off.
    diagram = campbell(shaft(), [0.0, 50.0], 4)
    assert diagram.exponents.shape == (2, 5)
    bending = diagram.whirl_speeds[1, np.abs(diagram.whirl[1]) > 0.9]
    assert np.sum(bending > 0) == np.sum(bending < 0) == 2


@pytest.mark.parametrize("rate", [3.0, 9.9, 10.5, 13.0, 40.0])
def test_a_rotor_out_of_balance_turns_about_its_axis_of_inertia_above_its_critical_speed(rate):
    # Nothing stiffens this one: along the path of growing loads it moves without bound at 10 rad/s.
    e = 1e-3
    expected = e * rate**2 / (100.0 - rate**2)
    found = equilibrium(rotor(rate, e))
    assert found.outcome.success
    np.testing.assert_allclose(found.q[:3], [expected, 0.0, 0.0], rtol=1e-10, atol=1e-15)
    below = equilibrium(rotor(9.0, e))
    again = equilibrium(rotor(rate, e), start=below)
    np.testing.assert_allclose(again.q, found.q, rtol=1e-10, atol=1e-15)
