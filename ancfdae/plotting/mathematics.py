"""Symbols in plain labels as mathematics: rho_1, 2^-7, 1e7."""

import re
from typing import Final

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
