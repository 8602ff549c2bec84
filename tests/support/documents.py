"""The documents of the checkout and the programs in them."""

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
FENCE = re.compile(
    r"^(?P<indent>[ \t]*)```(?P<language>\w*)[^\n`]*\n(?P<code>.*?)^(?P=indent)```[ \t]*$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    document: str
    line: int
    code: str


def python_blocks(document: str, text: str) -> list[Block]:
    return [
        Block(document, text[: match.start("code")].count("\n") + 1, textwrap.dedent(match["code"]))
        for match in FENCE.finditer(text)
        if match["language"] in ("python", "py")
    ]
