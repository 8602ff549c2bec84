"""Sharp places in the state under a tolerance, against SciPy; bounds of lists against samples."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ancfdae import DOP853, HHT, Integral, SmoothMaximum, error_bars, gradient, simulate
from ancfdae.errors import InvalidInputError
from ancfdae.numerics.enclosures import Interval, enclosed, values
from ancfdae.numerics.operations import Operations, Traced
from ancfdae.observables import custom
from ancfdae.studies.accuracy import places
from ancfdae.studies.accuracy.features import _timeless
from ancfdae.studies.accuracy.places import Seen, Witness
from tests.support.mechanisms import CartesianPendulum, GuidedDoublePendulum
from tests.support.springs import Mass

SQUARE = custom(lambda t, q, v, lam, b: q[:, 0] ** 2)


def by_scipy(f, slope, c, x, x_q, t_end, step):
    """Return the integral of x and its derivatives, with the equations of the derivatives."""

    def rates(t, y):
        q, v, *changes = y[:6]
        rows = [v, -10 * q + f(q) - c * v]
        for j, by_b in enumerate((-10 * q, f(q))):
            dq, dv = changes[2 * j : 2 * j + 2]
            rows += [dv, (slope(q) - 10) * dq - c * dv + by_b]
        return [*rows, x(q), x_q(q) * y[2], x_q(q) * y[4]]

    start = np.zeros(9)
    start[0] = 0.5
    run = solve_ivp(rates, (0, t_end), start, "DOP853", rtol=1e-10, atol=1e-13, max_step=step)
    return run.y[6, -1], run.y[7:, -1]


def require_right(found, value, slopes, tolerance):
    size = np.linalg.norm(slopes)
    assert found.accuracy.reached
    assert abs(found.value - value) < tolerance * max(abs(value), size)
    assert np.linalg.norm(found.gradient - slopes) < tolerance * size


@pytest.mark.parametrize(("width", "tolerance"), [(1e-2, 1e-3), (1e-3, 1e-2), (1e-3, 1e-4)])
def test_a_notch_at_a_place_is_followed(width, tolerance):
    high = 0.2 / width**0.5

    def notch(q):
        return high * np.exp(-(((q - 0.123) / width) ** 2))

    value, slopes = by_scipy(
        notch,
        lambda q: -2 * (q - 0.123) / width**2 * notch(q),
        0.0,
        lambda q: q * q,
        lambda q: 2 * q,
        2.0,
        width / 4,
    )
    found = gradient(Mass(notch), Integral(SQUARE), 2.0, tolerance=tolerance)
    require_right(found, value, slopes, tolerance)


@pytest.mark.parametrize(("width", "tolerance"), [(1e-2, 1e-3), (2e-3, 1e-2), (1e-3, 1e-2)])
def test_a_window_in_the_state_is_followed(width, tolerance):
    def window(q):
        return np.exp(-(((q - 0.123) / width) ** 2)) / width

    value, slopes = by_scipy(
        lambda q: 0 * q,
        lambda q: 0.0,
        0.1,
        window,
        lambda q: -2 * (q - 0.123) / width**2 * window(q),
        2.0,
        width / 4,
    )
    window_of_runs = Integral(custom(lambda t, q, v, lam, b: window(q[:, 0]) + 0 * b[1]))
    found = gradient(Mass(lambda q: 0 * q, 0.1), window_of_runs, 2.0, tolerance=tolerance)
    require_right(found, value, slopes, tolerance)


@pytest.mark.parametrize(
    ("size", "width", "place", "tolerance", "t_end"),
    [(-0.7556, 0.01245, -0.1518, 0.0305, 2.1236), (0.9358, 0.01144, 0.07683, 0.004518, 2.3671)],
)
def test_a_soft_stop_is_followed(size, width, place, tolerance, t_end):
    value, slopes = by_scipy(
        lambda q: size * np.tanh((q - place) / width),
        lambda q: size / width / np.cosh((q - place) / width) ** 2,
        0.0,
        lambda q: q * q,
        lambda q: 2 * q,
        t_end,
        width / 4,
    )
    system = Mass(lambda q: size * np.tanh((q - place) / width))
    require_right(
        gradient(system, Integral(SQUARE), t_end, tolerance=tolerance), value, slopes, tolerance
    )


@pytest.mark.parametrize("sharpness", [1e2, 1e3, 1e4])
def test_a_sharp_smooth_maximum_is_followed(sharpness):
    def by_hand(k):
        w, z = np.sqrt(10 * k - 0.0025), 0.05

        def speed(t):
            return -np.exp(-z * t) * 0.5 * (w + z * z / w) * np.sin(w * t)

        top = (np.pi + np.arctan2(w, z)) / w
        wide = min(12 / np.sqrt(sharpness * speed(top) * w * w), 0.45)
        t = np.linspace(top - wide, top + wide, 200001)
        mean = np.trapezoid(np.exp(sharpness * (speed(t) - speed(top))), t) / 2.0
        return speed(top) + np.log(mean) / sharpness

    most = SmoothMaximum(custom(lambda t, q, v, lam, b: v[:, 0] + 0 * b[1]), sharpness)
    found = gradient(Mass(lambda q: 0 * q, 0.1), most, 2.0, tolerance=1e-3)
    slope = (by_hand(1 + 1e-5) - by_hand(1 - 1e-5)) / 2e-5
    require_right(found, by_hand(1.0), np.array([slope, 0.0]), 1e-3)


def test_values_over_time_follow_a_notch():
    def notch(q):
        return 0.2 / 1e-3**0.5 * np.exp(-(((q - 0.123) / 1e-3) ** 2))

    at = np.linspace(0, 2, 33)
    run = solve_ivp(
        lambda t, y: [y[1], -10 * y[0] + notch(y[0])],
        (0, 2),
        [0.5, 0],
        rtol=1e-10,
        atol=1e-12,
        max_step=3e-4,
        t_eval=at,
    )
    x = custom(lambda t, q, v, lam, b: q[:, 0])
    found = simulate(Mass(notch), 2.0, tolerance=1e-3, observables=[x], at=at)
    assert found.reached
    assert np.linalg.norm(found.values[:, 0] - run.y[0]) < 1e-3 * np.linalg.norm(run.y[0])


def test_a_narrow_window_is_seen_between_the_instants_of_a_run():
    system = Mass(lambda q: 0 * q)
    run = simulate(system, 2.0, HHT(1 / 16))
    for width in (1e-3, 1e-5):
        seen = custom(lambda t, q, v, lam, b, w=width: np.exp(-(((q[:, 0] - 0.123) / w) ** 2)))
        found = Witness(system, (Seen(seen),), 1e-3).of(run, 32)
        crossing = np.arccos(0.123 / 0.5) / np.sqrt(10)
        assert any(
            left < crossing + 0.02 and right > crossing - 0.02 for left, right, _ in found.parts
        )
        assert found.steps > 1 / width
    smooth = custom(lambda t, q, v, lam, b: np.exp(q[:, 0]))
    assert not Witness(system, (Seen(smooth),), 1e-3).of(run, 32).parts


FUNCTIONS = (
    lambda x, y: np.exp(-(x * x)) * y,
    lambda x, y: np.tanh(x) - np.cos(3 * x * y),
    lambda x, y: np.sin(x + y) / (2 + y * y) + np.arctan2(x, 3 + y),
    lambda x, y: np.sqrt(1 + x * x) * np.log(3 + y) + np.cosh(x) - np.sinh(y),
    lambda x, y: np.tan(x / 4) ** 3 - np.arctan(y) + (4 + x) ** 1.5,
)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_bounds_of_a_list_hold_and_shrink(function):
    operations = Operations(2)
    x, y = Traced.array(operations, np.arange(2))
    outputs = Traced.numbers(operations, [function(x, y)])
    rng = np.random.default_rng(1)
    middles = rng.uniform(-1.5, 1.5, (2, 200))
    widths = []
    for half in (0.5, 1e-2, 1e-4):
        boxes = {k: Interval(middles[k] - half, middles[k] + half) for k in range(2)}
        low, high = enclosed(operations, outputs, boxes)
        for _ in range(30):
            point = middles + rng.uniform(-half, half, middles.shape)
            exact = function(*point)
            assert values(operations, outputs, dict(enumerate(point)))[0] == pytest.approx(exact)
            assert np.all(low[0] <= exact + 1e-12)
            assert np.all(exact <= high[0] + 1e-12)
        widths.append(np.max(high - low))
    assert widths[2] < 2e-2 * widths[1]


def test_a_maximum_at_the_start_is_no_raw_error():
    # 0.5 + log(1/(k T) int exp(-25 k t^2) dt)/k; on coarse runs it is round-off.
    first = SmoothMaximum(custom(lambda t, q, v, lam, b: q[:, 0]), 1e5)
    found = gradient(Mass(lambda q: 0 * q, 0.1), first, 2.0, tolerance=1e-2)
    mean = np.sqrt(np.pi / (2.5 * 1e5)) / 2 / 2.0
    assert found.value == pytest.approx(0.5 + np.log(mean) / 1e5, rel=1e-6)


@pytest.mark.filterwarnings("ignore:the errors of this run:ancfdae.errors.StabilityWarning")
def test_one_step_has_no_error_bar():
    with pytest.raises(InvalidInputError, match="steps"):
        error_bars(Mass(lambda q: 0 * q), Integral(SQUARE), 2.0, HHT(2.0))


def test_boxes_hold_the_path():
    path = places._Path.of(simulate(Mass(lambda q: 0 * q), 2.0, HHT(1 / 4)))
    n = np.arange(len(path.t) - 1)
    left, right = np.full(len(n), 0.3), np.full(len(n), 0.9)
    boxes = path.boxes(n, left, right, [0, 1, 2])
    for part in np.linspace(0.3, 0.9, 7):
        here = n, np.full(len(n), part), [0, 1, 2]
        for rows, bounds in zip((path.at(*here), path.rates(*here)), boxes, strict=True):
            for row, (low, high) in zip(rows, bounds, strict=True):
                assert np.all(low <= row + 1e-12)
                assert np.all(row <= high + 1e-12)


def _by_catching(t, pulse):
    try:
        return pulse(t)
    except Exception:  # noqa: BLE001  # the point of the test
        return 0.0


def _by_asking(t, pulse):
    return pulse(t) if isinstance(t, float) else 0.0


def _by_number(t, pulse):
    try:
        return pulse(float(t))
    except TypeError:
        return 0.0


def _never(t, pulse):
    return 0.0


class Pushed(CartesianPendulum):
    """A pendulum pushed by a pulse of 2 ms, by a formula that takes any time for a number."""

    def __init__(self, by, *settings):
        super().__init__(*settings)
        self.by = by

    def with_values(self, b):
        return Pushed(self.by, self.angle, self.spin, b)

    def force(self, t, q, v):
        push = self.by(t, lambda t: 2000.0 * np.exp(-(((t - 0.3) / 1e-3) ** 2)))
        return super().force(0.0, q, v) + np.array([push, 0.0])


@pytest.mark.parametrize("by", [_by_catching, _by_asking, _by_number, _never])
def test_formulas_that_take_anything_for_a_time_do_not_hide_it(by):
    system = Pushed(by)
    assert _timeless(system) == (by is _never)
    found = simulate(system, 0.6, tolerance=1e-4, observables=[custom(lambda t, q, *_: q[:, 0])])

    def slope(t, y):
        c, s = np.cos(y[0]), np.sin(y[0])
        push = by(t, lambda t: 2000.0 * np.exp(-(((t - 0.3) / 1e-3) ** 2)))
        return [y[1], -9.81 * s + push * c]

    start = [-np.pi / 2, 0.0]
    run = solve_ivp(
        slope, (0, 0.6), start, "DOP853", found.t, rtol=1e-10, atol=1e-12, max_step=5e-4
    )
    expected = np.sin(run.y[0])
    assert np.linalg.norm(found.values[:, 0] - expected) < 2e-4 * np.linalg.norm(expected)


def test_a_path_goes_through_the_values_and_slopes_of_its_times():
    """A cubic is determined by both at its ends; its rate is the derivative of its values."""
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.5, 1.5, 5))
    path = places._Path(t, rng.normal(size=(5, 4)), rng.normal(size=(5, 4)), (1, 1))
    n, columns = np.arange(4), [2, 0]
    for end in (0, 1):
        here = n, np.full(4, float(end)), columns
        np.testing.assert_allclose(path.at(*here), path.Y[end : end + 4, columns].T, rtol=1e-13)
        rates = path.slopes[end : end + 4, columns].T
        np.testing.assert_allclose(path.rates(*here), rates, rtol=1e-12)
    moved = path.at(n, np.full(4, 0.3 + 1e-6)) - path.at(n, np.full(4, 0.3 - 1e-6))
    rates = moved / (2e-6 * np.diff(t))
    np.testing.assert_allclose(path.rates(n, np.full(4, 0.3)), rates, rtol=1e-7, atol=1e-9)


class Notched(GuidedDoublePendulum):
    """A force of a thousandth of the travel's width acts on the first angle."""

    def force(self, t, q, v):
        notch = 20.0 * np.exp(-(((q[0] - 0.1) / 1e-3) ** 2))
        return super().force(t, q, v) + notch * np.array([1.0, 0.0])


@pytest.mark.parametrize(("kind", "smooth"), [(GuidedDoublePendulum, True), (Notched, False)])
def test_dense_times_are_samples_enough_where_functions_are_smooth(kind, smooth, monkeypatch):
    """DOP853 gives 1,025 times for some fifty steps; only a notch needs more samples."""
    run = simulate(kind(), 1.5, DOP853(1e-8, intervals=128))
    seen, of = [], places._Chords.of

    def counted(known, t, function):
        seen.append((len(known), len(t)))
        return of(known, t, function)

    monkeypatch.setattr(places._Chords, "of", staticmethod(counted))
    found = Witness(kind(), (), 1e-6).of(run, 50)
    assert bool(found.parts) is not smooth
    assert {known for known, _ in seen} == {1025}
    assert (max(count for _, count in seen) == 1025) is smooth
