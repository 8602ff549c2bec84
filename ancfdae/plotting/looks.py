"""How labels look: colour, dashes and marker of each, and symbols as mathematics."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, final

# Okabe and Ito (2008), without the yellow: it is too faint for a line on white.
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#000000", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h")
_DASHES: Final = (None, (5.0, 2.0), (1.2, 1.0), (5.0, 2.5, 1.2, 2.5))


@final
@dataclass(frozen=True)
class Look:
    """Colour, marker, dashes (None for a solid line), and whether the marker is filled."""

    colour: str
    marker: str
    dashes: tuple[float, ...] | None
    filled: bool = False


def _look(place: int, dashes: int = 0) -> Look:
    marker = _MARKERS[place % len(_MARKERS)]
    return Look(COLOURS[place % len(COLOURS)], marker, _DASHES[dashes % len(_DASHES)])


# By how a label begins, the longest that fits.
_METHODS: Final[dict[str, Look]] = {
    "HHT": _look(0),
    "HHT controlled": _look(6),
    "HHT, controlled": _look(6),
    "HHT both controlled": _look(2),
    "IDA": _look(1),
    "IDAS": _look(4),
    "DOP853": _look(3),
    "Radau": _look(5),
    "direct differentiation": _look(0),
    "forward difference": _look(1, 1),
    "central difference": _look(5, 2),
    "discrete adjoint": _look(3),
    "continuous adjoint": _look(2),
}
# Of these: filled and dashed, with a marker of their own, since small ones look filled anyway.
_PARTNERS: Final = dict(zip(_MARKERS[:7], (">", "p", "h", "*", "d", "8", "<"), strict=True))
# How labels end that stand beside another one of the same method.
_SECOND: Final = ("alpha = -0.05", "index 1", ", 3 levels", ", adjoint")


def looks(labels: Iterable[str]) -> dict[str, Look]:
    """Return the look of each label of a figure: that of its method, or the first one free."""
    given: dict[str, Look] = {}
    for label in dict.fromkeys(labels):
        known = max((name for name in _METHODS if label.startswith(name)), key=len, default="")
        look = _METHODS[known] if known else _free(given)
        if known and label.endswith(_SECOND):
            look = replace(look, dashes=_DASHES[1], filled=True, marker=_PARTNERS[look.marker])
        if look in given.values():
            look = _free(given)
        given[label] = look
    return given


def _free(given: dict[str, Look]) -> Look:
    """Return a look of a colour that is free, or of the next in their round."""
    taken = {look.colour for look in given.values()}
    places = (k for k, colour in enumerate(COLOURS) if colour not in taken)
    place = next(places, len(given))
    return _look(place, place)


_SYMBOL: Final = (
    "hht_alpha|alpha|beta|gamma|delta|eps|epsilon|zeta|eta|theta|kappa|lambda|mu|nu|xi|rho|sigma|"
    "tau|phi|psi|omega|Phi|Psi|Omega"
)
# Symbols that matplotlib has under another name.
_OTHERS: Final = {"eps": "varepsilon", "hht_alpha": "alpha"}
# 1e-7; 2^-7; a symbol, Greek or one letter with an index, maybe after the d of a derivative.
_MATHEMATICS: Final = re.compile(
    r"(?<![\w.$\\])(?:"
    r"(?P<digits>\d+(?:\.\d+)?)e(?P<exponent>[+-]?\d+)"
    r"|(?P<base>\d+)\^(?P<power>-?\d+)"
    rf"|(?P<d>d?)(?P<symbol>{_SYMBOL})(?:_(?P<index>\w+))?"
    r"|(?P<d_letter>d?)(?P<letter>[A-Za-z])_(?P<letter_index>\d+|[a-z])"
    r")(?![A-Za-z0-9_])"
)


def set_as_mathematics(text: str) -> str:
    """Return a label with its symbols, powers and exponents in matplotlib's mathematics.

    A text that holds a dollar sign is left as it is.
    """
    return text if "$" in text else _MATHEMATICS.sub(_one, text)


def _one(match: re.Match[str]) -> str:
    parts = match.groupdict()
    if parts["digits"]:
        times = "" if parts["digits"] == "1" else rf"{parts['digits']}\times "
        return rf"${times}10^{{{int(parts['exponent'])}}}$"
    if parts["base"]:
        return rf"${parts['base']}^{{{parts['power']}}}$"
    if parts["letter"]:
        return rf"${parts['d_letter']}{parts['letter']}_{{{parts['letter_index']}}}$"
    index = f"_{{{parts['index']}}}" if parts["index"] else ""
    symbol = _OTHERS.get(parts["symbol"], parts["symbol"])
    return rf"${parts['d']}\{symbol}{index}$"
