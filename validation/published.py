"""Numbers that reports compare with, read from `published.toml`, which names their sources."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def published(case: str) -> dict[str, Any]:
    """Return the entries of the table of a case; lists are arrays."""
    return {
        name: np.array(value, dtype=None if name == "columns" else float)
        for name, value in _TABLES[case].items()
    }
