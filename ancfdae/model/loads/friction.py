"""Friction curve that can be differentiated."""

from typing import Any

import numpy as np

from ancfdae.errors import InvalidInput, require_positive
from ancfdae.model.design import numbers

#: Design fields of the levels, in the order that `friction` takes them, and those that damp.
LEVELS = (
    *numbers("coulomb"),
    ("smooth_speed", require_positive),
    *numbers("viscous", "breakaway"),
    ("stribeck_speed", require_positive),
)
DAMPING = ("coulomb", "viscous", "breakaway")


def friction(speed: Any, levels: tuple[Any, ...]) -> Any:
    """Return the resistance at a relative speed w, with the sign of the speed.

    R = (c + (b - c) exp(-(w/w_s)^2)) tanh(w/w_0) + d w: Coulomb's level c is reached from the
    breakaway level b at speeds above w_s (Stribeck), and both are smooth below w_0. `levels` are
    c, w_0, d, b and w_s, the last two None without breakaway.
    """
    coulomb, smooth_speed, viscous, breakaway, stribeck_speed = levels
    level = coulomb
    if breakaway is not None:
        level = coulomb + (breakaway - coulomb) * np.exp(-np.square(speed / stribeck_speed))
    return level * np.tanh(speed / smooth_speed) + viscous * speed


def require_stribeck(where: str, breakaway: object, stribeck_speed: object) -> None:
    """Refuse a breakaway level without a speed, and the other way round."""
    if (breakaway is None) != (stribeck_speed is None):
        got = "one of them"
        rule, repair = "breakaway and stribeck_speed belong together", "Give both, or none."
        raise InvalidInput(where, rule, got, repair)
