"""Impacts with Coulomb's friction, by Newton's and Poisson's laws, and their derivatives."""

from itertools import product

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Impact,
    ImpactLaw,
    Radau,
    Terminal,
    differentiate,
    gradient,
    gradients,
    load_event_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.events.complementarity import Contacts
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom

EXACT = (DirectDifferentiation(), Adjoint(), ComplexStep())


# -- a disc: normal and sliding impulses do not see each other -------------------------------------


class Disc(FormulaSystem):
    """A disc of radius R, mass 2 and inertia J above a floor: x, y and angle."""

    n_q, n_lam = 3, 0
    design_names = ("vx", "spin", "mu", "e", "R", "J")
    gap = custom(lambda t, q, v, lam, b: q[:, 1] - b[4], "gap")
    sliding = custom(lambda t, q, v, lam, b: v[:, 0] + b[4] * v[:, 2], "sliding")
    g = 9.81

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        vx, spin, _, _, R, _ = self.b
        return np.array([0 * R, 1.2 + R, 0 * R]), np.array([vx, -0.5 + 0 * R, spin])

    def mass_matrix(self, q):
        return np.diag([2.0, 2.0, self.b[5]]) + 0 * self.b[5]

    def force(self, t, q, v):
        return np.array([0.0, -2 * self.g, 0.0]) + 0 * self.b[5]

    def position_constraint(self, t, q):
        return np.zeros(0)

    @classmethod
    def impact(cls, law):
        e, mu = (custom(lambda t, q, v, lam, b, k=k: b[k] + 0 * t, f"b{k}") for k in (3, 2))
        return Impact(cls.gap, e, "floor", friction=mu, sliding=cls.sliding, law=law)


def disc_by_hand(b, t_end, g=9.81):
    """Speed and spin at t_end, after one impact, whose branch follows from the real parts."""
    vx, spin, mu, e, R, J = b
    down = np.sqrt(0.25 + 2 * g * 1.2)
    P, sliding = (1 + e) * 2.0 * down, vx + R * spin
    T = -sliding / (1 / 2.0 + R * R / J)
    if abs(T.real) > (mu * P).real:
        T = -mu * P * np.sign(sliding.real)
    return vx + T / 2.0, spin + R * T / J


STICKS, FORWARD, BACKWARD = (
    (0.8, 1.0, 0.3, 0.6, 0.2, 0.03),
    (6.0, 1.0, 0.1, 0.6, 0.2, 0.03),
    (-2.0, -9.0, 0.1, 0.6, 0.2, 0.03),
)


@pytest.mark.parametrize("law", ImpactLaw)
@pytest.mark.parametrize("b", [STICKS, FORWARD, BACKWARD])
def test_disc_sticks_or_slides_as_its_closed_form(b, law):
    b, t_end = np.array(b), 0.6
    speeds = [Terminal(custom(lambda t, q, v, lam, b, k=k: v[:, k], f"speed {k}")) for k in (0, 2)]
    steps = np.array([disc_by_hand(b + 1e-30j * x, t_end) for x in np.eye(6)])
    slopes = np.imag(steps).T / 1e-30
    for integrator, method in product((HHT(0.05), Radau(0.2)), EXACT):
        found = gradients(
            Disc(b), speeds, t_end, integrator, method=method, events=[Disc.impact(law)]
        )
        for each, exact, slope in zip(found, disc_by_hand(b, t_end), slopes, strict=True):
            assert each.value == pytest.approx(exact, abs=1e-12)
            np.testing.assert_allclose(each.gradient, slope, rtol=1e-10, atol=1e-11)


class FloatingDisc(Disc):
    """A disc without weight, which does not fall again after an impact without restitution."""

    g = 0.0


@pytest.mark.parametrize("law", ImpactLaw)
@pytest.mark.parametrize("b", [(0.2, *STICKS[1:]), FORWARD, BACKWARD])
@pytest.mark.parametrize("e", [0.0, 1e-12])
def test_derivatives_without_restitution_are_those_of_a_small_one(b, law, e):
    b = np.array(b)
    b[3] = e
    steps = np.array([impulses_of_floating_disc(b + 1e-30j * x) for x in np.eye(6)])
    slopes = steps.imag.T / 1e-30
    (event,) = differentiate(FloatingDisc(b), 2.5, Radau(0.5), events=[Disc.impact(law)]).events
    np.testing.assert_allclose(event.impulse_b, slopes[0], atol=1e-10)
    np.testing.assert_allclose(event.sliding_impulse_b, slopes[1], atol=1e-10)


def impulses_of_floating_disc(b):
    """P and T of the impact with 0.5 by hand."""
    vx, spin, mu, e, R, J = b
    P, sliding = (1 + e) * 2.0 * 0.5, vx + R * spin
    T = -sliding / (1 / 2.0 + R * R / J)
    return P, T if abs(T.real) <= (mu * P).real else -mu * P * np.sign(sliding.real)


def test_impulses_of_friction_and_their_derivatives_are_recorded(tmp_path):
    for b, ratio in ((FORWARD, -0.1), (BACKWARD, 0.1)):
        run = differentiate(Disc(b), 0.6, HHT(0.05), events=[Disc.impact(ImpactLaw.NEWTON)])
        (event,) = run.events
        assert event.sliding_impulse == pytest.approx(ratio * event.impulse, rel=1e-13)
        expected = ratio * event.impulse_b
        expected[2] = np.sign(ratio) * event.impulse
        np.testing.assert_allclose(event.sliding_impulse_b, expected, atol=1e-12)
        (read,) = load_event_solution(run.save(tmp_path / "run.npz")).events
        assert read.sliding_impulse == event.sliding_impulse
        np.testing.assert_array_equal(read.sliding_impulse_b, event.sliding_impulse_b)


# -- a rod whose end strikes: the impulses see each other ------------------------------------------


class FlyingRod(FormulaSystem):
    """A rod of mass 1 and inertia 0.1 in free flight, whose end at -0.5 strikes a floor."""

    n_q, n_lam, t_end = 3, 0, 0.45
    design_names = ("mu", "e", "angle", "spin", "vx")
    a, J = 0.5, 0.1
    gap = custom(lambda t, q, v, lam, b: q[:, 1] - 0.5 * np.sin(q[:, 2]), "gap")
    sliding = custom(lambda t, q, v, lam, b: v[:, 0] + 0.5 * np.sin(q[:, 2]) * v[:, 2], "sliding")
    momentum = custom(
        lambda t, q, v, lam, b: v[:, 0] + 0.3 * v[:, 1] + q[:, 2] * v[:, 2] + q[:, 0], "momentum"
    )

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        _, _, angle, spin, vx = self.b
        q = np.array([0 * angle, 0.2 + self.a * np.sin(angle), angle])
        return q, np.array([vx, -1.0 + 0 * angle, spin])

    def mass_matrix(self, q):
        return np.diag([1.0, 1.0, self.J]) + 0 * self.b[0]

    def force(self, t, q, v):
        return 0 * q * self.b[0]

    def position_constraint(self, t, q):
        return np.zeros(0)

    @classmethod
    def impact(cls, law):
        mu, e = (custom(lambda t, q, v, lam, b, k=k: b[k] + 0 * t, f"b{k}") for k in (0, 1))
        return Impact(cls.gap, e, "floor", friction=mu, sliding=cls.sliding, law=law)

    def by_hand(self, law, b):
        """`momentum` at the end, and what the stages of the impact do: stick, slide + or -."""
        mu, e, angle, spin, vx = b
        t = 0.2 + 0 * angle
        for _ in range(40):
            place = 0.2 + self.a * np.sin(angle) - t - self.a * np.sin(angle + spin * t)
            t = t - place / (-1.0 - self.a * spin * np.cos(angle + spin * t))
        turned = angle + spin * t
        W = np.array([[0, 1, -self.a * np.cos(turned)], [1, 0, self.a * np.sin(turned)]])
        v, stages = np.array([vx, -1.0 + 0 * angle, spin]), ""
        inverse = np.diag([1.0, 1.0, 1 / self.J])
        A, closing = W @ inverse @ W.T, (W @ v)[0]
        goals = [(-e * closing, None)]
        if law is ImpactLaw.POISSON:
            goals = [(0.0, None), (None, e)]
        N = 0.0
        for goal, part in goals:
            N, T, how = one_contact(A, W @ v, mu, goal, None if part is None else part * N)
            v, stages = v + inverse @ W.T @ np.array([N, T]), stages + how
        left = self.t_end - t
        end = turned + left * v[2]
        return v[0] + 0.3 * v[1] + end * v[2] + vx * t + left * v[0], stages


def one_contact(A, rates, mu, goal, given):
    """Impulses N and T up to a rate `goal`, or with N given, and whether the contact slides."""
    for side, how in ((0, "0"), (1, "+"), (-1, "-")):
        if side:
            ratio = -side * mu
            N = (goal - rates[0]) / (A[0, 0] + ratio * A[0, 1]) if given is None else given
            T = ratio * N
        elif given is None:
            N, T = np.linalg.solve(A, np.array([goal, 0.0]) - rates)
        else:
            N, T = given, -(rates[1] + A[1, 0] * given) / A[1, 1]
        after = rates + A @ np.array([N, T])
        fits = abs(T.real) <= (mu * N).real if not side else after[1].real * side > 0
        if fits and N.real > 0 and after[0].real >= -1e-12:
            return N, T, how
    raise AssertionError


# mu, e, angle, spin, speed; and how the stages of Poisson's law slide.
STRIKES = [
    ((0.2, 0.5, 0.8, 0.3, 4.0), "++"),
    ((0.2, 0.5, 0.4, 0.3, -4.0), "--"),
    ((0.2, 0.5, 0.4, 0.3, 0.5), "+-"),
    ((0.2, 0.5, -0.8, -0.5, -0.9), "-+"),
    ((0.45, 0.5, 1.2, 0.3, -0.5), "00"),
    ((0.45, 0.5, 0.8, 0.3, 0.9), "+0"),
    ((0.45, 0.5, -0.8, 0.3, -0.9), "-0"),
    ((0.2, 0.5, 0.4, 0.3, 0.25), "0-"),
    ((0.45, 0.5, -0.8, 0.3, -0.5), "0+"),
]


@pytest.mark.parametrize("law", ImpactLaw)
@pytest.mark.parametrize(("b", "stages"), STRIKES)
def test_rod_that_strikes_with_an_end_follows_its_impulses_by_hand(law, b, stages):
    rod = FlyingRod(b)
    exact, taken = rod.by_hand(law, np.array(b))
    slopes = [
        np.imag(rod.by_hand(law, np.array(b) + 1e-30j * x)[0]) / 1e-30 for x in np.eye(len(b))
    ]
    assert law is ImpactLaw.NEWTON or taken == stages
    for method in EXACT:
        found = gradient(
            rod, Terminal(FlyingRod.momentum), rod.t_end, Radau(0.05), method=method,
            events=[rod.impact(law)],
        )  # fmt: skip
        assert found.value == pytest.approx(exact, rel=1e-12)
        np.testing.assert_allclose(found.gradient, slopes, rtol=1e-9, atol=1e-9)


# -- several contacts ------------------------------------------------------------------------------


def branches_of(A, rates, mu, least):
    """All solutions of the problem of impulses, by trial of all branches of all contacts."""
    m, found = len(mu), []
    for branch in product(product((True, False), ("stick", "+", "-")), repeat=m):
        K, side = np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
        for i, (pushes, how) in enumerate(branch):
            K[i], side[i] = (A[i], -rates[i]) if pushes else (np.eye(2 * m)[i], least[i])
            K[m + i], side[m + i] = A[m + i], -rates[m + i]
            if how != "stick":
                K[m + i], side[m + i] = np.eye(2 * m)[m + i], 0.0
                K[m + i, i] = mu[i] * (1 if how == "+" else -1)
        if np.linalg.matrix_rank(K) < 2 * m:
            continue
        P = np.linalg.solve(K, side)
        (N, T), (g, s) = np.split(P, 2), np.split(A @ P + rates, 2)
        small = 1e-9 * np.max(np.abs(rates))
        fits = [
            N[i] >= least[i] - small if pushes else g[i] >= -small
            for i, (pushes, _) in enumerate(branch)
        ]
        fits += [
            abs(T[i]) <= mu[i] * N[i] + small if how == "stick" else s[i] * int(how + "1") >= -small
            for i, (_, how) in enumerate(branch)
        ]
        if all(fits):
            found.append(P)
    return found


@pytest.mark.parametrize("count", [1, 2, 3])
def test_impulses_are_a_solution_that_trial_of_all_branches_finds(count):
    rng = np.random.default_rng(count)
    for number in range({1: 200, 2: 60, 3: 6}[count]):
        W = rng.normal(size=(2 * count, 2 * count + 1))
        A, rates = W @ W.T, W @ rng.normal(size=2 * count + 1)
        mu, least = rng.uniform(0.05, 1.0, count), np.zeros(count)
        if number % 2:
            least = rng.uniform(0.0, 0.3, count)
        contacts = Contacts(A, np.arange(count), mu)
        branch = contacts.branch(rates, least)
        P = branch.impulses(contacts, rates, least)
        known = branches_of(A, rates, mu, least)
        assert min(np.max(np.abs(P - x)) for x in known) <= 1e-9 * np.max(np.abs(rates))


def test_poissons_law_gains_no_energy_where_newtons_may():
    """Newton's law with friction may gain energy (Kane's pendulum), Poisson's not for e <= 1."""
    rng, gains = np.random.default_rng(7), dict.fromkeys(ImpactLaw, 0)
    for _ in range(100):
        mu, e = rng.uniform(0.1, 1.0), rng.uniform(0.3, 1.0)
        b = (mu, e, *rng.uniform(-1.2, 1.2, 2), rng.normal())
        for law in ImpactLaw:
            rod = FlyingRod(b)
            try:
                run = simulate(rod, 0.6, Radau(0.2), events=[rod.impact(law)])
            except InvalidInputError:
                continue  # The gap is negative at the start.
            first, *others = (x @ rod.mass_matrix(None) @ x for x in (y.v[0] for y in run.phases))
            gains[law] += any(x > first * (1 + 1e-12) for x in others)
    assert gains[ImpactLaw.POISSON] == 0
    assert gains[ImpactLaw.NEWTON] > 0


def test_tie_between_sticking_and_sliding_has_no_derivative():
    # The disc sticks with |T| = mu P exactly: T = -s / (1/m + R^2/J) and P = (1 + e) m u.
    b = np.array(STICKS)
    P = (1 + b[3]) * 2.0 * np.sqrt(0.25 + 2 * 9.81 * 1.2)
    b[2] = (b[0] + b[4] * b[1]) / (1 / 2.0 + b[4] ** 2 / b[5]) / P
    events = [Disc.impact(ImpactLaw.NEWTON)]
    assert simulate(Disc(b), 0.6, HHT(0.05), events=events).outcome.success
    objective = Terminal(custom(lambda t, q, v, lam, b: v[:, 0], "speed"))
    for method in EXACT:
        with pytest.raises(InvalidInputError, match="must stick, slide or open clearly"):
            gradient(Disc(b), objective, 0.6, HHT(0.05), method=method, events=events)


def test_bad_friction_is_refused_in_words():
    gap, sliding = Disc.gap, Disc.sliding
    with pytest.raises(InvalidInputError, match=r"Impact\.sliding: must be given together"):
        Impact(gap, friction=0.3)
    with pytest.raises(InvalidInputError, match=r"Impact\.sliding: must be given together"):
        Impact(gap, sliding=sliding)
    with pytest.raises(InvalidInputError, match="must not be negative"):
        Impact(gap, friction=-0.3, sliding=sliding)
    with pytest.raises(InvalidInputError, match="must be one observable or two"):
        Impact(gap, friction=0.3, sliding=(sliding,) * 3)
    with pytest.raises(InvalidInputError, match=r"ImpactLaw\.NEWTON or POISSON"):
        Impact(gap, law="poisson")
    squared = Impact(gap, friction=0.3, sliding=sliding**2)
    with pytest.raises(InvalidInputError, match="must be linear in velocities"):
        simulate(Disc(STICKS), 0.6, HHT(0.05), events=[squared])
    both = [
        Impact(gap, 0.5, "one", friction=0.3, sliding=sliding),
        Impact(
            custom(lambda t, q, v, lam, b: q[:, 1] - b[4] + 0.3 * (q[:, 0] - b[0] * t), "slope"),
            0.5, "slope", law=ImpactLaw.POISSON,
        ),
    ]  # fmt: skip
    with pytest.raises(InvalidInputError, match="must follow one law"):
        simulate(Disc(STICKS), 0.6, HHT(0.05), events=both)


class Anvil(FormulaSystem):
    """A mass that touches the ground without weight, and a hammer that strikes it."""

    n_q, n_lam = 2, 0
    design_names = ("speed", "e", "e_ground", "hammer")
    gaps = (
        custom(lambda t, q, v, lam, b: q[:, 0], "ground"),
        custom(lambda t, q, v, lam, b: q[:, 1] - q[:, 0] - 1.0, "head"),
    )

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        speed = self.b[0]
        return np.array([0 * speed, 1.5 + 0 * speed]), np.array([0 * speed, -speed])

    def mass_matrix(self, q):
        return np.diag([5.0, 1.0]) * np.array([[1.0, 1.0], [1.0, self.b[3]]])

    def force(self, t, q, v):
        return 0 * q * self.b[0]

    def position_constraint(self, t, q):
        return np.zeros(0)

    @classmethod
    def impacts(cls):
        e, e_ground = (custom(lambda t, q, v, lam, b, k=k: b[k] + 0 * t, f"b{k}") for k in (1, 2))
        ground, head = cls.gaps
        return [
            Impact(head, e, "head", law=ImpactLaw.POISSON),
            Impact(ground, e_ground, "ground", law=ImpactLaw.POISSON),
        ]


def test_poissons_law_loads_a_contact_that_does_not_close():
    """Compression stops both: P = m u at head and ground; expansion adds e P and e_ground P."""
    b = np.array([2.0, 0.4, 0.9, 0.5])
    speed, e, e_ground, hammer = b
    place = custom(lambda t, q, v, lam, b: 3 * v[:, 0] + v[:, 1], "both")
    up = (e_ground - e) * hammer * speed / 5.0
    slopes = [
        3 * up / speed + e,
        -3 * hammer * speed / 5.0 + speed,
        3 * hammer * speed / 5.0,
        3 * up / hammer,
    ]
    for method in EXACT:
        found = gradient(
            Anvil(b), Terminal(place), 0.6, HHT(0.05), method=method, events=Anvil.impacts()
        )
        assert found.value == pytest.approx(3 * up + e * speed, rel=1e-12)
        np.testing.assert_allclose(found.gradient, slopes, rtol=1e-10)
    head, ground = found.event_solution.events
    assert head.impulse == pytest.approx((1 + e) * hammer * speed, rel=1e-12)
    assert ground.impulse == pytest.approx((1 + e_ground) * hammer * speed, rel=1e-12)


class Block(FormulaSystem):
    """A block of 0.4 m by 0.2 m that falls flat on both corners: x, y and angle."""

    n_q, n_lam = 3, 0
    design_names = ("vx", "mu", "e", "mass")

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        vx = self.b[0]
        return np.array([0 * vx, 0.6 + 0 * vx, 0 * vx]), np.array([vx, -1.0 + 0 * vx, 0 * vx])

    def mass_matrix(self, q):
        return np.diag([1.0, 1.0, 0.02]) * self.b[3]

    def force(self, t, q, v):
        return 0 * q * self.b[0]

    def position_constraint(self, t, q):
        return np.zeros(0)

    @staticmethod
    def impacts(law):
        mu, e = (custom(lambda t, q, v, lam, b, k=k: b[k] + 0 * t, f"b{k}") for k in (1, 2))
        found = []
        for name, x in (("left", -0.2), ("right", 0.2)):

            def gap(t, q, v, lam, b, x=x):
                return q[:, 1] + x * np.sin(q[:, 2]) - 0.1 * np.cos(q[:, 2])

            def sliding(t, q, v, lam, b, x=x):
                return v[:, 0] - (x * np.sin(q[:, 2]) - 0.1 * np.cos(q[:, 2])) * v[:, 2]

            found.append(Impact(custom(gap, name), e, name, None, mu, custom(sliding, name), law))
        return found


@pytest.mark.parametrize(
    ("law", "vx"),
    # Where it sticks, expansion by Poisson's law turns the block.
    [*((law, vx) for law in ImpactLaw for vx in (3.0, -3.0)), (ImpactLaw.NEWTON, 0.2)],
)
def test_block_on_two_corners_slides_or_sticks(law, vx):
    """Both corners push, so that it does not turn: it slides on with |v| - mu (1 + e), or stops."""
    b = np.array([vx, 0.3, 0.5, 2.0])
    speed = custom(lambda t, q, v, lam, b: v[:, 0] + 0.1 * v[:, 1] + v[:, 2], "speed")
    sign, slides = np.sign(vx), abs(vx) > 1
    exact = (vx - sign * 0.3 * 1.5 if slides else 0.0) + 0.05
    slopes = [1.0, -1.5 * sign, 0.1 - 0.3 * sign, 0.0] if slides else [0.0, 0.0, 0.1, 0.0]
    for method in EXACT:
        found = gradient(
            Block(b), Terminal(speed), 0.8, HHT(0.05), method=method, events=Block.impacts(law)
        )
        assert found.value == pytest.approx(exact, rel=1e-12)
        np.testing.assert_allclose(found.gradient, slopes, atol=1e-10)
