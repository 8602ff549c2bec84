"""Laws of time: derivatives, complex parameters, smoothness, what each of them is, refusals.

Derivatives are those of an interpolant of degree 16 at Chebyshev points of 0.5 s (`curves`).
"""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import Beam, Material, Pin, RotationDriver, Scene, assemble, distributed_variables
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.extend import Law
from ancfdae.laws import (
    BSpline,
    Constant,
    ConstantAcceleration,
    Harmonic,
    RunUp,
    SmoothStep,
    Spline,
    Transition,
    UserLaw,
)
from ancfdae.model import laws
from ancfdae.sections import Rectangle
from tests.support.curves import rates_of
from tests.support.examples import LAW_TIME, law_examples, public_classes
from tests.support.members import constraint_b
from tests.support.setting import STEP, concrete_subclasses

LAWS = law_examples()
# Round-off of an interpolant's third derivative, 16 * 16^3 eps/0.25^3 = 1e-9 of the values; laws of
# examples are up to 30 (a cube times tanh), and 2 rad/s makes a third derivative of 8 times that.
CURVE = 2e-8


@pytest.fixture(params=LAWS)
def law(request):
    return LAWS[request.param]


def numbers_of(law):
    return np.array(list(law.parameters().values()))


def test_every_public_law_has_an_example():
    kinds = set(public_classes(laws, Law).values())
    assert kinds == {type(law) for law in LAWS.values()}
    assert kinds == {k for k in concrete_subclasses(Law) if k.__module__.startswith("ancfdae")}


def test_derivatives_of_a_law_are_those_of_its_value(law):
    rates = rates_of(law.at, LAW_TIME)
    ours = np.array(law.derivatives(numbers_of(law), LAW_TIME))
    assert np.max(np.abs(ours - rates) / (1 + np.abs(rates))) <= CURVE
    assert isinstance(law, Constant) or ours[1] != 0


def test_every_parameter_of_a_law_goes_through_as_a_complex_number(law):
    p = numbers_of(law)
    for k in range(len(p)):
        moved = p.astype(complex)
        moved[k] += 1j * STEP
        by_step = np.array([np.imag(x) / STEP for x in law.derivatives(moved, LAW_TIME)])
        # The derivative in p of a time derivative is the time derivative of that in p.
        rates = rates_of(lambda t, m=moved: np.imag(law.derivative(m, t, 0)) / STEP, LAW_TIME)
        assert np.max(np.abs(by_step - rates) / (1 + np.abs(rates))) <= CURVE
        assert np.any(by_step)
        # And it is that of the value, by a central difference: 1e-6 squared, and eps over 1e-6.
        step = 1e-6 * np.eye(len(p))[k]
        value = (
            law.derivative(p + step, LAW_TIME, 0) - law.derivative(p - step, LAW_TIME, 0)
        ) / 2e-6
        assert by_step[0] == pytest.approx(value, rel=1e-7, abs=1e-7)


def test_a_law_works_on_arrays_of_instants(law):
    t = np.array([-0.4, 0.0, 0.3, 1.1, 2.3, 3.7, 9.1])
    for order in range(4):
        rows = np.array([law.derivative(numbers_of(law) + 0j, x, order) for x in t])
        # Sums of a few terms, in another order.
        assert law.derivative(numbers_of(law) + 0j, t, order) == pytest.approx(rows, rel=1e-13)
        assert law.at(t, order).dtype == float


def test_three_derivatives_of_a_law_are_continuous(law):
    # Where pieces meet, and in general places; 1e-9 s change no derivative by more than its rate.
    places = np.array([0.2, 0.7, 1.1, 1.3, 1.6, 1.8, 2.9, 3.7, 4.7, 9.2])
    for order in range(4):
        before, after = law.at(places - 1e-9, order), law.at(places + 1e-9, order)
        steep = np.max(np.abs(law.at(np.linspace(0, 10, 2001), order)))
        assert np.max(np.abs(after - before)) <= 1e-6 * (1 + steep)


def test_every_parameter_is_its_own(law):
    for name, value in law.parameters().items():
        changed = law.with_parameters({name: value + 0.125})
        assert changed.parameters() == law.parameters() | {name: value + 0.125}


# ---------------------------------------------------------------- one by one


def test_laws_are_what_their_formulas_say():
    t = np.linspace(-0.5, 3.0, 9)
    assert np.array_equal(Constant(0.4).at(t), np.full(9, 0.4))
    assert ConstantAcceleration(2.0, 0.3, 1.5).at(t) == pytest.approx(
        0.3 + 2 * t + 0.75 * t * t, rel=1e-14
    )
    expected = 0.1 + 0.4 * np.sin(3 * t + 0.2)
    assert Harmonic(0.4, 3.0, 0.2, 0.1).at(t) == pytest.approx(expected, abs=1e-15)
    assert SmoothStep(2.0, 5.0, 2.0, 1.0).at([0.0, 1.0, 2.0, 3.0, 4.0]).tolist() == [
        2,
        2,
        3.5,
        5,
        5,
    ]


def test_a_run_up_has_the_rate_of_a_ramp_and_holds_it():
    t = np.linspace(-1.0, 5.0, 25)
    run_up, ramp = RunUp(6.0, 2.0, 0.3, 1.0), SmoothStep(0.0, 6.0, 2.0, 1.0)
    for order in range(3):
        assert run_up.at(t, order + 1) == pytest.approx(ramp.at(t, order), abs=1e-13)
    assert run_up.at([0.0, 1.0, 3.0, 4.0]) == pytest.approx([0.3, 0.3, 6.3, 12.3], abs=1e-13)


def test_a_change_is_one_law_before_and_another_after():
    law = Transition(
        Transition(Constant(0.2), ConstantAcceleration(2.0, 0.5), 0.4, 1.0),
        Harmonic(0.3, 5.0),
        0.5,
        2.0,
    )
    for t, piece in (
        (0.7, Constant(0.2)),
        (1.7, ConstantAcceleration(2.0, 0.5)),
        (2.9, Harmonic(0.3, 5.0)),
    ):
        for order in range(4):
            assert law.at(t, order) == pytest.approx(piece.at(t, order), abs=1e-13)
    assert Transition(Constant(2.0), Constant(5.0), 2.0, 1.0).at(2.2) == pytest.approx(
        SmoothStep(2.0, 5.0, 2.0, 1.0).at(2.2), abs=1e-14
    )


def test_both_laws_of_a_change_are_design_targets():
    law = Transition(ConstantAcceleration(2.0), ConstantAcceleration(3.0), 1.0, 1.0)
    names = [
        f"{side}_{x}"
        for side in ("before", "after")
        for x in ConstantAcceleration(2.0).parameters()
    ]
    assert list(law.parameters()) == [*names, "duration", "begin"]
    changed = law.with_parameters({"after_speed": 4.0})
    assert (changed.before, changed.after) == (ConstantAcceleration(2.0), ConstantAcceleration(4.0))
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.05, 0.04), Material(1e3, 1e7, 0.3))
    scene = Scene([rod], [Pin(rod.at_start), RotationDriver(rod.at_start, law, name="motor")])
    assert assemble(scene, ["motor.before_speed"]).b == pytest.approx([2.0])


@pytest.mark.parametrize("count", [2, 3, 8])
def test_a_spline_passes_through_its_values_and_is_constant_outside(count):
    rng = np.random.default_rng(count)
    times = 0.3 + np.cumsum(rng.uniform(0.5, 1.5, count))
    values = rng.uniform(-1, 1, count)
    law = Spline(times.tolist(), values.tolist())
    assert law.at(times) == pytest.approx(values, abs=1e-12)
    outside = np.array([-3.0, times[0], times[-1], times[-1] + 5.0])
    assert law.at(outside) == pytest.approx(values[[0, 0, -1, -1]], abs=1e-12)
    for order in (1, 2, 3):
        assert not np.any(law.at(outside[[0, -1]], order))


def test_a_spline_through_two_values_is_a_ramp():
    t = np.linspace(0, 4, 41)
    spline, ramp = Spline((1.0, 3.0), (2.0, 5.0)), SmoothStep(2.0, 5.0, 2.0, 1.0)
    for order in range(4):
        assert spline.at(t, order) == pytest.approx(ramp.at(t, order), abs=1e-11)


def test_a_periodic_spline_repeats():
    law = replace(LAWS["Spline"], period=4.5)
    t = np.linspace(0.2, 4.7, 31)
    for order in range(4):
        # Third derivatives are 1e2 here.
        assert law.at(t + 9.0, order) == pytest.approx(law.at(t, order), abs=1e-10)
        # Before its first time, too.
        assert law.at(t - 9.0, order) == pytest.approx(law.at(t, order), abs=1e-10)
    assert law.at(law.times) == pytest.approx(law.values, abs=1e-12)


def test_a_spline_at_even_distances_exceeds_its_values_at_most_by_what_is_said():
    for count in range(2, 24):
        basis = [
            Spline(range(count), row).at(np.linspace(0, count - 1, 999)) for row in np.eye(count)
        ]
        assert np.max(np.sum(np.abs(basis), axis=0)) < 2.5


def test_a_b_spline_is_the_sum_of_its_hills():
    # Five convolved boxes of one span each, as a divided difference of truncated fourth powers.
    def hill(s):
        steps = np.maximum(s + 2.5 - np.arange(6.0)[:, None], 0.0) ** 4
        return np.array([1, -5, 10, -10, 5, -1]) @ steps / 24

    values, t = np.array([2.0, -1.0, 0.5, 3.0, 3.5]), np.linspace(0.4, 2.6, 45)
    law = BSpline(0.5, 2.5, values)
    s = (t - 0.5) * 9 / 2 - 2.5
    held = {k: values[min(max(k, 0), 4)] for k in range(-9, 14)}
    expected = sum(x * hill(s - k) for k, x in held.items())
    # Differences of fourth powers of up to 13 spans, 10 * 13^4/24, times the round-off.
    assert law.at(t) == pytest.approx(expected, abs=1e-10)
    for order in (1, 2, 3):
        assert not np.any(law.at([-3.0, 0.5, 2.5, 9.0], order))


def test_a_b_spline_stays_within_its_values():
    rng = np.random.default_rng(4)
    for count in (2, 3, 5, 12):
        values, t = rng.uniform(-1, 1, count), np.linspace(-1, 4, 999)
        x = BSpline(0.0, 3.0, values).at(t)
        assert np.min(values) - 1e-14 <= np.min(x) < np.max(x) <= np.max(values) + 1e-14
    assert BSpline(0.0, 3.0, [0.7, 0.7, 0.7]).at(t) == pytest.approx(0.7, rel=1e-15)


def test_a_law_of_a_users_own_is_its_function():
    law = UserLaw(lambda t, a, w: a * np.sin(w * t) ** 2, (0.4, 3.0))
    t = np.linspace(-1, 1, 7)
    assert law.at(t) == pytest.approx(0.2 * (1 - np.cos(6 * t)), abs=1e-15)
    assert law.at(t, 3) == pytest.approx(-0.2 * 216 * np.sin(6 * t), abs=1e-13)
    assert list(law.parameters()) == ["value[0]", "value[1]"]
    assert not np.any(UserLaw(lambda t, a: a, (3.0,)).at(t, 1))


def test_user_law_divides_by_whole_numbers_and_by_functions():
    t = np.array([0.25, 1.5])
    halved = UserLaw(lambda t: t * t / 2 + 1 / (t + 1))
    assert np.allclose(halved.at(t, 0), t**2 / 2 + 1 / (t + 1), rtol=1e-14)
    # Derivatives of t^2/2 are t, 1, 0; those of 1/(t + 1) are -1, 2 and -6 over its powers.
    for order, expected in ((1, t - (t + 1) ** -2), (2, 1 + 2 * (t + 1) ** -3)):
        assert np.allclose(halved.at(t, order), expected, rtol=1e-14)


def test_rates_of_a_law_are_infinite_where_its_function_has_a_root():
    law = UserLaw(np.sqrt)
    assert law.at(np.array([0.0, 4.0])).tolist() == [0.0, 2.0]
    rates = [law.at(np.array([0.0, 4.0]), order) for order in (1, 2, 3)]
    assert [x[0] for x in np.abs(rates)] == 3 * [np.inf]
    assert np.allclose([x[1] for x in rates], [1 / 4, -1 / 32, 3 / 256], rtol=1e-14)


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda: UserLaw(3.0), "function"),
        (lambda: UserLaw(lambda t: abs(t)), "numpy.absolute"),
        (lambda: UserLaw(lambda t: np.where(t < 1, 0.0, 1.0)), "numpy.less"),
        (lambda: UserLaw(lambda t: np.maximum(t, 0.0)), "numpy.maximum"),
        (lambda: UserLaw(lambda t: float(t)), "derivatives in time"),
        (lambda: UserLaw(lambda t, a: t, ()), "derivatives in time"),
        (lambda: UserLaw(lambda t, a: abs(a) * t, (-2.0,)), "numpy.absolute"),
        (lambda: UserLaw(lambda t, a: np.real(a) * t, (2.0,)), "numpy.real"),
        (lambda: UserLaw(lambda t: t, 3.0), "sequence of numbers"),
        (lambda: UserLaw(lambda t: (t, t)), "derivatives in time"),
        (lambda: BSpline(1.0, 1.0, (1.0, 2.0)), "later than begin"),
        (lambda: BSpline(0.0, 1.0, (1.0,)), "several"),
        (lambda: BSpline(0.0, np.inf, (1.0, 2.0)), "finite"),
        (lambda: BSpline(0.0, 1.0, "ab"), "sequence of numbers"),
        (lambda: Spline((0.0, 1.0), (1.0,)), "1 values at 2 times"),
        (lambda: Spline((0.0, 0.0), (1.0, 2.0)), "ascend"),
        (lambda: Spline((0.0,), (1.0,)), "ascend"),
        (lambda: Spline((0.0, 1.0), "ab"), "sequence of numbers"),
        (lambda: Spline((0.0, float("nan")), (0.0, 1.0)), "finite"),
        (lambda: Spline((0.0, 1.0), (0.0, 1.0), period=1.0), "must exceed"),
        (lambda: SmoothStep(0.0, 1.0, 0.0), "positive"),
        (lambda: Constant("fast"), "finite"),
        (lambda: RunUp(1.0, 0.0), "positive"),
        (lambda: Transition(Constant(1.0), 2.0, 1.0, 0.0), "Law"),
        (lambda: UserLaw(lambda t: np.where(t < 1, 0.0, 1.0)), "joined by Transition"),
    ],
)
def test_what_is_no_law_is_refused(law, words):
    with pytest.raises(InvalidInputError, match=words):
        law()


# ---------------------------------------------------------------- control values as targets


def test_control_values_are_design_targets_by_their_index():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.05, 0.04), Material(1e3, 1e7, 0.3))
    motor = RotationDriver(rod.at_start, Spline((0.0, 1.0, 2.0), (0.1, 0.2, 0.4)), name="motor")
    scene = Scene([rod], [Pin(rod.at_start), motor])
    system = assemble(scene, distributed_variables("motor.value", 3))
    assert system.design_names == ("motor.value[0]", "motor.value[1]", "motor.value[2]")
    assert system.b.tolist() == [0.1, 0.2, 0.4]
    changed = scene.with_values({"motor.value[1]": 0.3})
    assert changed.joints[1].angle.values == (0.1, 0.3, 0.4)
    for target in ("motor.value", "motor.value[3]", "motor.speed"):
        with pytest.raises(UnknownNameError, match=r"motor\.value\[2\]"):
            assemble(scene, [target])
    # The curve at the middle of the first interval depends on all of them.
    Phi_b = constraint_b(system, 0.5, system.start()[0])
    assert np.all(np.max(np.abs(Phi_b), axis=0) > 1e-3)


def test_user_law_that_treats_symbols_unlike_numbers_is_refused():
    def twice(t):
        return t * (1.0 if isinstance(t, np.ndarray) else 2.0)

    with pytest.raises(InvalidInputError, match="same values for numbers and for symbols"):
        UserLaw(twice).check()


def test_user_law_may_grow_beyond_the_largest_derivative():
    """exp(2456 t) is 4e106 at 0.1 s, where the list of operations returns infinity."""
    law = UserLaw(lambda t: np.exp(2456.0 * t))
    assert law.derivative(np.zeros(0), 0.01, 1) == pytest.approx(2456.0 * np.exp(24.56))
