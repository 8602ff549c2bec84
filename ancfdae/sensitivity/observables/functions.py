"""Functions of expressions, evaluated so that complex numbers differentiate them.

For real x and a tiny step eps, Im f(x + i eps) / eps is f'(x) to round-off if f is analytic at x.
NumPy continues some functions to where they are not real, sqrt(-1) = i, and there the quotient is
no derivative. A complex operand therefore stands for a small interval around its real part: where
the function is not finite on all of it, the result is NaN.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.complex_step import FAILURES

# Analytic on the whole real line, or infinite at their poles.
_WHOLE = (
    *(np.add, np.subtract, np.multiply, np.divide, np.negative, np.positive),
    *(np.square, np.reciprocal, np.sin, np.cos, np.tan, np.arctan),
    *(np.sinh, np.cosh, np.tanh, np.arcsinh, np.exp, np.exp2, np.expm1),
)
# Real on a part of the real line only.
_EDGED = (
    *(np.power, np.sqrt, np.log, np.log2, np.log10),
    *(np.arcsin, np.arccos, np.arccosh, np.arctanh),
)
_COMPARE = "Weight with 0.5 * (1 + tanh((x - limit) / eps))."
_STEPS = "Leave it out: it has no derivative where it jumps."
_REPAIRS = {
    "absolute": "Use sqrt(x**2 + eps**2).",
    "fabs": "Use sqrt(x**2 + eps**2).",
    "maximum": "Use 0.5 * (x + y + sqrt((x - y)**2 + eps**2)), or SmoothMaximum over time.",
    "minimum": "Use 0.5 * (x + y - sqrt((x - y)**2 + eps**2)), or SmoothMaximum over time.",
    "sign": "Use tanh(x / eps).",
    "heaviside": "Use 0.5 * (1 + tanh(x / eps)).",
    "arctan2": "Use slope_angle(point), or arctan(y / x).",
    "hypot": "Use sqrt(x**2 + y**2).",
    "cbrt": "Use x**(1 / 3).",
    "log1p": "Use log(1 + x).",
    **dict.fromkeys(("less", "less_equal", "greater", "greater_equal"), _COMPARE),
    **dict.fromkeys(("equal", "not_equal", "isfinite", "isnan", "logical_not"), _COMPARE),
    **dict.fromkeys(("floor", "ceil", "trunc", "rint"), _STEPS),
    **dict.fromkeys(("floor_divide", "remainder", "fmod", "divmod"), _STEPS),
}


@final
@dataclass(frozen=True)
class Function:
    """A function of arrays, element by element.

    `edged` if it may be real on a part of the real line only; `by_user` if a user wrote it, so that
    its derivative is checked.
    """

    name: str
    call: Callable[..., Array]
    edged: bool
    by_user: bool = False

    def __call__(self, operands: Sequence[Array]) -> Array:
        """Return the value; NaN where complex operands meet the edge of the real domain."""
        y: Array = np.asarray(self.call(*operands))
        moving = [k for k, x in enumerate(operands) if np.iscomplexobj(x)]
        if not (self.edged and moving):
            return y
        real = [np.real(x) for x in operands]
        for k in moving:
            for side in (-np.inf, np.inf):
                near = [*real[:k], np.nextafter(real[k], side), *real[k + 1 :]]
                y = np.where(np.isfinite(self.call(*near)), y, complex(np.nan, np.nan))
        return y

    def slope(self, operands: Sequence[Array], k: int) -> Array:
        """Return the partial derivative in operand k at real operands."""
        moved = [x + 1j * STEP if i == k else x for i, x in enumerate(operands)]
        slope: Array = self(moved).imag / STEP
        return slope


_FUNCTIONS = {
    ufunc: Function(ufunc.__name__, ufunc, edged)
    for ufuncs, edged in ((_WHOLE, False), (_EDGED, True))
    for ufunc in ufuncs
}


def analytic(ufunc: np.ufunc, method: str = "__call__", plain: bool = True) -> Function:
    """Return a NumPy function that may be used in an expression.

    Refused are functions that are not analytic, methods such as ``reduce``, and calls that are not
    `plain` but have options such as ``where``.
    """
    name = f"numpy.{ufunc.__name__}"
    if ufunc not in _FUNCTIONS:
        raise InvalidInputError(
            name,
            "must have a derivative and accept complex numbers to stand in an expression",
            "a function that does not",
            _REPAIRS.get(ufunc.__name__, "Use elementary functions, or apply(function, x)."),
        )
    if method != "__call__" or not plain:
        got = f"{ufunc.__name__}.{method}" if method != "__call__" else "options"
        raise InvalidInputError(
            name, "must simply be called on an expression", got, "Write the expression out."
        )
    return _FUNCTIONS[ufunc]


def require_vectorised(where: str, rows: Callable[[slice], Array], count: int) -> None:
    """Refuse a function that does not work instant by instant on whole arrays.

    `rows` gives its values at a slice of the `count` instants.
    """
    repair = "Return one number per instant, from that instant alone."
    try:
        y, last = np.asarray(rows(slice(None))), np.asarray(rows(slice(count - 1, count)))
    except FAILURES as error:
        got = f"{type(error).__name__}: {error}"
        raise InvalidInputError(where, "must work on arrays over time", got, repair) from error
    if y.shape != (count,) or y.dtype.kind not in "iufc":
        got = f"shape {y.shape} and type {y.dtype}"
        raise InvalidInputError(where, f"must return numbers of shape ({count},)", got, repair)
    if last.shape != (1,) or not np.allclose(last[0], y[-1], rtol=1e-9, atol=0, equal_nan=True):
        got = "a value that depends on the other instants"
        raise InvalidInputError(where, "must work instant by instant", got, repair)
