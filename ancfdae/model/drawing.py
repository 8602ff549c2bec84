"""How a part is drawn: declared by the part, read by pictures."""

from dataclasses import dataclass
from enum import Enum
from typing import final


@final
@dataclass(frozen=True)
class Sign:
    """The sign of a joint, at its first point."""

    word: str  # what the legend calls it
    marker: str  # a marker of matplotlib, or a symbol of its mathematics between dollar signs
    filled: bool = False
    size: float = 7.0  # points of print


@final
class Stroke(Enum):
    """A line that a part is drawn as, between its points or from its point to `ground`."""

    LINK = "link"
    SPRING = "spring"
