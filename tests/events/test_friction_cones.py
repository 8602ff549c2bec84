"""Impacts with cones of friction in space: `Impact(sliding=(one, other))`."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    FiniteDifference,
    Impact,
    ImpactLaw,
    InitialVelocity,
    Mode,
    Radau,
    RestModes,
    RigidBody,
    Scene,
    Terminal,
    differentiate,
    gradient,
    load_event_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.events.complementarity import Contacts
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom, design_value, position, velocity

EXACT = (DirectDifferentiation(), Adjoint(), ComplexStep())
R, E = 0.2, 0.6


# -- a sphere with spin: closed form ---------------------------------------------------------------


class Sphere(FormulaSystem):
    """A sphere of radius R without weight: x, y, z, and the integrals of its angular velocity."""

    n_q, n_lam = 6, 0
    design_names = ("mass", "J", "mu", "vx", "vy", "vz", "wx", "wy", "wz")
    gap = custom(lambda t, q, v, lam, b: q[:, 2] - R, "gap")
    along = tuple(
        custom(lambda t, q, v, lam, b, k=k, s=s: v[:, k] + s * R * v[:, 4 - k], "xy"[k])
        for k, s in ((0, -1), (1, 1))
    )

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        zero = 0 * self.b[0]
        return np.array([zero, zero, 1 + zero, zero, zero, zero]), self.b[3:] * 1

    def mass_matrix(self, q):
        return np.diag(np.concatenate([[self.b[0]] * 3, [self.b[1]] * 3]))

    def force(self, t, q, v):
        return np.zeros(6) + 0 * self.b[0]

    def position_constraint(self, t, q):
        return np.zeros(0)

    @classmethod
    def floor(cls, law=ImpactLaw.NEWTON, turned=0.0):
        """The impact, with directions of sliding turned by an angle."""
        (x, y), c, s = cls.along, np.cos(turned), np.sin(turned)
        sliding, mu = (c * x + s * y, c * y - s * x), custom(friction, "mu")
        return Impact(cls.gap, E, "floor", friction=mu, sliding=sliding, law=law)


def friction(t, q, v, lam, b):
    return b[2] + 0 * t


def sphere_by_hand(b, t_end):
    """Position and spin at the end; the branch by the real parts."""
    mass, J, mu, v, spin = *b[:3], b[3:6], b[6:]
    landed = (1 - R) / -v[2]
    P, s = mass * (1 + E) * -v[2], np.array([v[0] - R * spin[1], v[1] + R * spin[0]])
    T = -s / (1 / mass + R**2 / J)
    if np.sqrt(T.real @ T.real) > (mu * P).real:
        T = -mu * P * s / np.sqrt(s @ s)
    after = np.array([v[0] + T[0] / mass, v[1] + T[1] / mass, -E * v[2]])
    place = np.array([0, 0, 1]) + landed * v + (t_end - landed) * after
    return np.append(place, spin + np.array([R * T[1], -R * T[0], 0]) / J)


STICKS = np.array([2.0, 0.03, 0.2, 0.5, -0.3, -4.0, 1.0, 0.5, 2.0])
SLIDES = np.array([2.0, 0.03, 0.2, 3.0, 1.5, -4.0, 5.0, -8.0, 2.0])


@pytest.mark.parametrize("law", ImpactLaw)
@pytest.mark.parametrize("b", [STICKS, SLIDES])
def test_sphere_with_spin_sticks_or_slides_as_its_closed_form(b, law):
    exact = sphere_by_hand(b, 0.6)
    steps = [sphere_by_hand(b + 1e-30j * unit, 0.6).imag / 1e-30 for unit in np.eye(9)]
    numbers = [custom(lambda t, q, v, lam, b, k=k: q[:, k], "place") for k in range(3)]
    numbers += [custom(lambda t, q, v, lam, b, k=k: v[:, k], "spin") for k in range(3, 6)]
    for k, number in enumerate(numbers):
        for integrator, method in product((HHT(0.05), Radau(0.2)), EXACT):
            found = gradient(
                Sphere(b), Terminal(number), 0.6, integrator, method=method,
                events=[Sphere.floor(law)],
            )  # fmt: skip
            assert found.value == pytest.approx(exact[k], abs=1e-12)
            slopes = [step[k] for step in steps]
            np.testing.assert_allclose(found.gradient, slopes, rtol=1e-10, atol=1e-11)


def test_impulse_of_a_cone_is_recorded_in_both_directions(tmp_path):
    run = differentiate(Sphere(SLIDES), 0.6, HHT(0.05), events=[Sphere.floor()])
    event, s = run.events[0], np.array([3.0 + R * 8.0, 1.5 + R * 5.0])
    assert event.impulse == pytest.approx(2 * (1 + E) * 4, rel=1e-12)
    T = -0.2 * event.impulse * s / np.linalg.norm(s)
    np.testing.assert_allclose(event.sliding_impulse, T, rtol=1e-12)
    # dT/ds = -mu P (I - s s^T/|s|^2)/|s|; v_x and v_y are variables 3 and 4.
    across = np.eye(2) - np.outer(s, s) / (s @ s)
    slope = -0.2 * event.impulse * across / np.linalg.norm(s)
    np.testing.assert_allclose(event.sliding_impulse_b[:, 3:5], slope, rtol=1e-11)
    read = load_event_solution(run.save(tmp_path / "run.npz")).events[0]
    np.testing.assert_array_equal(read.sliding_impulse, event.sliding_impulse)
    np.testing.assert_array_equal(read.sliding_impulse_b, event.sliding_impulse_b)


@pytest.mark.parametrize("b", [np.array([2.0, 0.03, 0.3, 0.2, -0.1, -4.0, 1.0, 0.5, 2.0]), SLIDES])
def test_cone_without_restitution_has_the_derivatives_of_a_small_one(b):
    # The restitution is the spin about z, less 2. It is zero, and P is (1 + e) m |v_z|.
    e = custom(lambda t, q, v, lam, b: b[8] - 2.0 + 0 * t, "e")
    floor = replace(Sphere.floor(ImpactLaw.POISSON), restitution=e)
    (event,) = differentiate(Sphere(b), 0.6, HHT(0.05), events=[floor]).events
    s = np.array([b[3] - R * b[7], b[4] + R * b[6]])
    sticks = np.hypot(*s) / (1 / 2.0 + R**2 / 0.03) < b[2] * 8.0
    in_e = np.zeros(2) if sticks else -b[2] * 8.0 * s / np.hypot(*s)
    assert event.impulse_b[8] == pytest.approx(8.0, rel=1e-12)
    assert event.impulse_b[5] == pytest.approx(-2.0, rel=1e-12)
    np.testing.assert_allclose(event.sliding_impulse_b[:, 8], in_e, atol=1e-10)


@pytest.mark.parametrize("b", [STICKS, SLIDES])
def test_motion_does_not_depend_on_the_directions_of_the_cone(b):
    ends = [
        simulate(Sphere(b), 0.6, HHT(0.05), events=[Sphere.floor(turned=turned)]).q[-1]
        for turned in (0.0, 0.5, 2.0)
    ]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-12)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-12)


def test_sphere_between_sticking_and_sliding_has_no_derivative():
    # |s| / (1/m + R^2/J) = mu P
    b, s = STICKS.copy(), np.hypot(0.5 - R * 0.5, -0.3 + R * 1.0)
    b[2] = s / (1 / 2.0 + R**2 / 0.03) / (2 * (1 + E) * 4.0)
    for method in EXACT:
        with pytest.raises(InvalidInputError, match="must stick, slide or open clearly"):
            gradient(
                Sphere(b), Terminal(Sphere.gap), 0.6, HHT(0.05), method=method,
                events=[Sphere.floor()],
            )  # fmt: skip


def sphere_near_sliding(d):
    """A sphere whose friction is 1 + d times the one from which on it sticks, and that impulse."""
    b, s = STICKS.copy(), np.array([0.5 - R * 0.5, -0.3 + R * 1.0])
    T = -s / (1 / 2.0 + R**2 / 0.03)
    b[2] = np.hypot(*T) / (2 * (1 + E) * 4.0) * (1 + d)
    return b, T


@pytest.mark.parametrize("law", ImpactLaw)
@pytest.mark.parametrize("turned", [0.0, 1.0, 2.5])
def test_impulse_is_continuous_between_sticking_and_sliding(turned, law):
    c, s = np.cos(turned), np.sin(turned)
    back = np.array([[c, -s], [s, c]])
    near = [1e-4, 1e-6, 1e-8, 3e-9, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13]
    for d in (*near, *(-x for x in near), 0.0):
        b, T = sphere_near_sliding(d)
        run = simulate(Sphere(b), 0.3, Radau(0.1), events=[Sphere.floor(law, turned)])
        found = back @ run.events[0].sliding_impulse
        np.testing.assert_allclose(found, T * min(1.0, 1 + d), atol=1e-13 * np.hypot(*T))


@pytest.mark.parametrize("turned", [0.0, 1.0])
def test_derivatives_are_right_or_refused_between_sticking_and_sliding(turned):
    c, s = np.cos(turned), np.sin(turned)
    back = np.array([[c, -s], [s, c]])
    for d in (-1e-4, -1e-5, -1e-6, -1e-7, -3e-8, -3e-9, -1e-9, -1e-10, -1e-11, -1e-12):
        b, T = sphere_near_sliding(d)
        n, flexible = T / np.hypot(*T), 1 / 2.0 + R**2 / 0.03
        # T = -mu P s/|s|, with the sliding velocity s before the impact, and ds/dv = I.
        exact = -(1 + d) / flexible * (np.eye(2) - np.outer(n, n))
        events = [Sphere.floor(turned=turned)]
        if d > -2e-8:
            with pytest.raises(InvalidInputError, match="must stick, slide or open clearly"):
                differentiate(Sphere(b), 0.3, Radau(0.1), events=events)
            continue
        run = differentiate(Sphere(b), 0.3, Radau(0.1), events=events)
        slope = back @ run.events[0].sliding_impulse_b[:, 3:5]
        np.testing.assert_allclose(slope, exact, atol=1e-11)


@pytest.mark.parametrize(("b", "name"), [(STICKS, "stays"), (SLIDES, "slides")])
def test_cone_that_stays_closed_names_a_mode_for_all_directions_of_sliding(b, name):
    floor = replace(Sphere.floor(), restitution=0.0, rest=RestModes("stays", "slides"))
    pressed = type("Pressed", (Sphere,), {"force": lambda self, t, q, v: -9.81 * np.eye(6)[2]})
    modes = {"stays": Mode(pressed(b)), "slides": Mode(pressed(b))}
    run = simulate(pressed(b), 0.25, HHT(0.01), events=[floor], modes=modes)
    assert run.events[0].mode == name


# -- several contacts: conditions, and an iteration of another kind --------------------------------


def impulses_by_fixed_point(A, r, mu):
    """P = projection of P - rho (A P + r) on the cones, (m, 3): normal first, by small steps."""
    m = len(mu)
    P, rho = np.zeros((m, 3)), 0.3 / np.linalg.norm(A, 2)
    for _ in range(200_000):
        Z = P - rho * (A @ P.ravel() + r).reshape(m, 3)
        N = np.maximum(Z[:, 0], 0.0)
        length = np.linalg.norm(Z[:, 1:], axis=1)
        share = np.minimum(1.0, mu * N / np.maximum(length, 1e-300))
        new = np.column_stack([N, share[:, None] * Z[:, 1:]])
        if np.max(np.abs(new - P)) < 1e-16:
            break
        P = new
    return P


BOX, MASS = np.array([0.6, 0.4, 0.2]), 3.0
CORNERS = np.array([[0.3, 0.2, -0.1], [-0.3, 0.2, -0.1]])
INERTIAS = MASS / 12 * np.array([0.4**2 + 0.2**2, 0.6**2 + 0.2**2, 0.6**2 + 0.4**2])


def box(v, spin, mu, restitution, law=ImpactLaw.NEWTON):
    """A box whose two lower corners hit the floor at once; it does not turn before."""
    body = RigidBody("box", (0, 0, 0), mass=MASS, inertia=tuple(INERTIAS))
    scene = Scene(bodies=[body], start=[InitialVelocity("box", spin, (0, 0, 0), v)])
    events = []
    for number, corner in enumerate(CORNERS):
        point = body.at(*corner)
        events.append(
            Impact(
                position(point, 2) + 0.1, restitution[number], f"corner {number}",
                friction=mu[number], sliding=(velocity(point, 0), velocity(point, 1)), law=law,
            )
        )  # fmt: skip
    return body, scene, events


@pytest.mark.parametrize(
    ("v", "spin", "mu"),
    [
        ((1.0, 0.6, -2.0), (0.0, 0.0, 3.0), (0.3, 0.5)),  # both slide
        ((1.0, 0.2, -2.0), (-4.0, 0.1, 3.0), (0.1, 0.9)),  # one sticks
        ((0.05, 0.02, -2.0), (-5.0, 0.2, 0.1), (0.8, 0.8)),  # both stick
    ],
)
def test_box_on_two_corners_follows_a_projected_iteration(v, spin, mu):
    # It hits at the start, so that nothing but the impact moves it.
    body, scene, events = box(v, spin, mu, (0.5, 0.3))
    run = simulate(scene, 1e-3, HHT(1e-3), events=events)
    J = np.zeros((2, 3, 6))
    for number, (x, y, z) in enumerate(CORNERS):
        # v + omega x r: rows z, x, y
        J[number] = [[0, 0, 1, y, -x, 0], [1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x]]
    J = J.reshape(6, 6)
    inverse = np.diag(1 / np.append([MASS] * 3, INERTIAS))
    before = np.append(v, spin)
    r = J @ before
    r[[0, 3]] *= 1 + np.array([0.5, 0.3])
    P = impulses_by_fixed_point(J @ inverse @ J.T, r, np.array(mu))
    after = before + inverse @ J.T @ P.ravel()
    np.testing.assert_allclose(run.velocity(body.at(0, 0, 0))[0], after[:3], atol=1e-9)
    for corner in CORNERS:
        point = after[:3] + np.cross(after[3:], corner)
        np.testing.assert_allclose(run.velocity(body.at(*corner))[0], point, atol=1e-9)
    slid = np.linalg.norm(P[:, 1:], axis=1) > (1 - 1e-9) * np.array(mu) * P[:, 0]
    assert sum(slid) == {(0.3, 0.5): 2, (0.1, 0.9): 1, (0.8, 0.8): 0}[mu]


def random_contacts(random, m):
    n = 6 * int(random.integers(1, 3))
    J, L = random.normal(size=(3 * m, n)), random.normal(size=(n, n))
    A = J @ np.linalg.inv(L @ L.T + 0.3 * np.eye(n)) @ J.T
    mu = np.repeat(random.uniform(0, 1, m), 2)
    return Contacts(A, np.repeat(np.arange(m), 2), mu), J @ random.normal(size=n)


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_impulses_of_random_contacts_keep_the_law(m):
    random, solved = np.random.default_rng(m), 0
    for _ in range(60):
        contacts, r = random_contacts(random, m)
        least = np.where(random.random(m) < 0.5, 0.0, random.uniform(0, 0.3, m))
        if np.all(r[:m] > 0) and not np.any(least):
            continue
        solved += 1
        P = contacts.branch(r, least).impulses(contacts, r, least)
        y = contacts.inverse_mass @ P + r
        N, T, s = P[:m], P[m:].reshape(m, 2), y[m:].reshape(m, 2)
        mu, size, fast = contacts.friction[::2], np.max(np.abs(P)), np.max(np.abs(r))
        assert np.all(least - 1e-12 * size <= N)
        assert np.all(y[:m] >= -1e-10 * fast)
        assert np.all((N - least) * y[:m] <= 1e-9 * size * fast)
        assert np.all(np.linalg.norm(T, axis=1) <= mu * N + 1e-10 * size)
        opposite = T * np.linalg.norm(s, axis=1)[:, None] + (mu * N)[:, None] * s
        assert np.all(np.abs(opposite) <= 1e-8 * size * fast)
    assert solved > 30


def test_one_contact_gains_no_energy():
    # By Newton's law where normal and sliding do not see each other, as in a sphere; else by
    # Poisson's law. With A and r the energy changes by P (A P / 2 + r).
    random = np.random.default_rng(11)
    for coupled in (False, True):
        for _ in range(300):
            contacts, r = random_contacts(random, 1)
            A = contacts.inverse_mass if coupled else np.diag(np.diag(contacts.inverse_mass))
            contacts = Contacts(A, contacts.rough, contacts.friction)
            r[0], e, zero = -abs(r[0]), random.uniform(0, 1), np.zeros(1)
            if coupled:
                P = contacts.branch(r, zero).impulses(contacts, r, zero)
                more, middle = e * P[:1], A @ P + r
                P = P + contacts.branch(middle, more).impulses(contacts, middle, more)
            else:
                shifted = r + np.array([e * r[0], 0, 0])
                P = contacts.branch(shifted, zero).impulses(contacts, shifted, zero)
            assert P @ (A @ P / 2 + r) <= 1e-12 * (P @ A @ P)


@pytest.mark.parametrize("law", ImpactLaw)
@pytest.mark.parametrize("mu", [(0.3, 0.5), (0.1, 0.9)])
def test_derivatives_of_two_contacts_are_those_of_differences(mu, law):
    # The box falls by 0.2 m first. Both corners hit at one time at neighbouring designs, too.
    body, scene, events = box((1.0, 0.6, -2.0), (0.0, 0.0, 3.0), mu, (0.5, 0.5), law)
    scene = Scene(
        bodies=[RigidBody("box", (0, 0, 0.2), mass=MASS, inertia=tuple(INERTIAS))],
        start=[InitialVelocity("box", (0.0, 0.0, 3.0), (0, 0, 0.2), (1.0, 0.6, -2.0))],
    )
    design = ["box.mass", "box.velocity_x", "box.velocity_z", "box.angular_velocity_z"]
    end = Terminal(position(body.at(0.1, 0.2, 0.0), 0) + 2 * position(body.at(0, 0, 0), 1))
    settings = {"design": design, "events": events}
    differences = gradient(
        scene, end, 0.15, HHT(1.9e-3), method=FiniteDifference(1e-6, central=True), **settings
    )
    found = [gradient(scene, end, 0.15, HHT(1.9e-3), method=method, **settings) for method in EXACT]
    for each in found:
        assert len(each.event_solution.events) == 2
        np.testing.assert_allclose(each.gradient, found[0].gradient, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(found[0].gradient, differences.gradient, rtol=1e-5, atol=1e-7)


# -- without restitution ---------------------------------------------------------------------------


def tilted_box(mu, law, turned=3.0393089496418813, e=0.0, g=9.81, others=()):
    """A box, turned about y by -1.2, that strikes with two corners at once, and turns about y."""
    place, turn = (0.0, 0.0, 0.5773571169325227), (0.0, -1.2169383485744694, 0.0)
    inertia = (0.0598084955984136, 0.05858885075409173, 0.059060311311549346)
    body = RigidBody("box", place, mass=1.1107915377194104, inertia=inertia, turn=turn)
    v, spin = (1.1986708993900783, 0.07379335958326627, -2.51), (0.0, -2.2264663655975316, 0.0)
    start = [InitialVelocity("box", spin, about=place, velocity=v)]
    events, c, s = [], np.cos(turned), np.sin(turned)
    for name, y in (("left", 0.33378986), ("right", -0.33378986)):
        point = body.at(-0.48114166, y, -0.30597322)
        along, across = velocity(point, 0), velocity(point, 1)
        sliding = (c * along + s * across, c * across - s * along)
        events.append(Impact(position(point, 2), e, name, friction=mu, sliding=sliding, law=law))
    return Scene((), (), (0, 0, -g), bodies=[body, *others], start=start), events


@pytest.mark.parametrize("law", ImpactLaw)
@pytest.mark.parametrize("turned", [3.0393089496418813, 0.0, 1.0])
def test_box_that_stays_on_two_corners_ends_with_the_repair(turned, law):
    # Its rates after the impact are round-off, which left no impulses within the cones.
    for mu, integrator in product((3.0, 0.5), (Radau(2e-3), Radau(5e-3), HHT(1e-3))):
        scene, events = tilted_box(mu, law, turned)
        run = simulate(scene, 0.03, integrator, events=events)
        assert not run.outcome.success
        assert "rest=" in str(run.outcome)
        assert [x.name for x in run.events[:2]] in (["left", "right"], ["right", "left"])


@pytest.mark.parametrize("mu", [3.0, 0.1])
def test_derivative_in_a_restitution_of_zero_is_that_of_a_small_one(mu):
    # Without weight, so that the corners open again. At e = 0 round-off decides whether they do:
    # Radau(3e-3) ends in words there.
    found, bounce = [], design_value("bounce.position_x")
    for e in (0.0, 1e-7):
        scale = RigidBody("bounce", (e, 0, 0), mass=1.0, inertia=(1.0, 1.0, 1.0))
        scene, events = tilted_box(mu, ImpactLaw.POISSON, e=bounce, g=0.0, others=[scale])
        run = differentiate(scene, 9e-3, HHT(1e-3), design=["bounce.position_x"], events=events)
        pair = sorted(run.events[:2], key=lambda x: x.name)
        # Of the friction of two contacts that stick only the sum is unique.
        found.append([
            np.array([*(x.impulse for x in pair), *sum(x.sliding_impulse for x in pair)]),
            np.array([*(x.impulse_b for x in pair), *sum(x.sliding_impulse_b for x in pair)])[:, 0],
        ])  # fmt: skip
    (P, slope), (P_small, slope_small) = found
    np.testing.assert_allclose(slope, (P_small - P) / 1e-7, atol=1e-5)
    np.testing.assert_allclose(slope_small, slope, atol=1e-5)
    np.testing.assert_allclose(slope[:2], P[:2], rtol=1e-9)


def test_impulses_that_break_the_law_of_friction_are_told_from_those_that_keep_it():
    """One contact with A = 1: closing at 2 m/s and sliding at 3 m/s, mu = 0.5: N = 2, T = -1."""
    contacts = Contacts(np.eye(2), np.array([0]), np.array([0.5]))
    r, zero = np.array([-2.0, 3.0]), np.zeros(1)
    assert contacts.keep_law(np.array([2.0, -1.0]), r, zero)
    wrong = {
        "too small a push": (1.9, -0.95),
        "a pull": (-2.0, 0.0),
        "friction along the sliding": (2.0, 1.0),
        "friction outside the cone": (2.0, -3.0),
        "friction below its bound while it slides": (2.0, -0.9),
        "no impulse": (0.0, 0.0),
    }
    for what, P in wrong.items():
        assert not contacts.keep_law(np.array(P), r, zero), what


@pytest.mark.parametrize("law", ImpactLaw)
def test_an_impact_whose_branch_breaks_the_law_of_friction_is_refused(law, monkeypatch):
    """A box slides into the floor with mu = 0.01; a branch that lets it stick is no solution."""
    scene, events = tilted_box(0.01, law, e=0.6, g=0.0)
    assert simulate(scene, 9e-3, Radau(3e-3), events=events).outcome.success
    found = Contacts.branch

    def sticking(self, r, least):
        branch = found(self, r, least)
        return replace(branch, sticks=np.ones_like(branch.sticks), slides=0.0 * branch.slides)

    monkeypatch.setattr(Contacts, "branch", sticking)
    with pytest.raises(InvalidInputError, match="must have impulses within the cones of friction"):
        simulate(scene, 9e-3, Radau(3e-3), events=events)


def test_impulses_are_found_where_friction_is_large():
    # Newton's method converges from no pyramid for the 263rd of these.
    random = np.random.default_rng(5)
    for _ in range(265):
        m = int(random.integers(2, 4))
        J, L = random.normal(size=(3 * m, 12)), random.normal(size=(12, 12))
        A, mu = J @ np.linalg.inv(L @ L.T + 0.3 * np.eye(12)) @ J.T, random.uniform(0, 20, m)
        contacts = Contacts(A, np.repeat(np.arange(m), 2), np.repeat(mu, 2))
        r, zero = J @ random.normal(size=12), np.zeros(m)
        P = contacts.branch(r, zero).impulses(contacts, r, zero)
        assert contacts.keep_law(P, r, zero)
        N, T, s = P[:m], P[m:].reshape(m, 2), (A @ P + r)[m:].reshape(m, 2)
        small = 1e-8 * np.max(np.abs(P))
        assert np.all(np.linalg.norm(T, axis=1) <= mu * N + small)
        speed = np.linalg.norm(s, axis=1)
        slid = speed > 1e-6
        opposite = -(mu * N / np.where(slid, speed, 1.0))[:, None] * s
        np.testing.assert_allclose(T[slid], opposite[slid], atol=1e2 * small)


@pytest.mark.parametrize("step", [1e-3, 5e-4])
def test_gap_that_stays_closed_ends_with_the_repair_where_no_step_converges(step):
    c, s, half = np.cos(0.5), np.sin(0.5), (0.4, 0.5, 0.3)
    corners = [(x * half[0], y * half[1], -half[2]) for x in (1, -1) for y in (1, -1)]
    place = (0.0, 0.0, max(s * x - c * z for x, _, z in corners) + 0.02)
    body = RigidBody("box", place, mass=1.0, inertia=(0.06, 0.07, 0.09), turn=(0.0, 0.5, 0.0))
    start = [InitialVelocity("box", (0.0, 2.2, 0.0), about=place, velocity=(-0.8, 0.1, -2.0))]
    scene = Scene((), (), (0, 0, -10.0), bodies=[body], start=start)
    events = [
        Impact(
            position(point, 2), 0.0, f"corner {i}", friction=0.1,
            sliding=(velocity(point, 0), velocity(point, 1)),
        )
        for i, point in enumerate(body.at(*x) for x in corners)
    ]  # fmt: skip
    run = simulate(scene, 0.03, HHT(step), events=events)
    assert "rest=" in str(run.outcome)
