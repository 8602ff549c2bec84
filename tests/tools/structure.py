"""The size and the shape of the package's code, as a table.

    python -m tests.tools.structure

Lines of Python and C++, functions and their mean length, files and how many of them only one other
file imports, the border between Python and C++, and what one gradient passes (`call_path`).
"""

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from tests.tools.call_path import ROOT, passed, run

# Files of the kernels that hold neither a formula nor an algorithm.
_BORDER: Final = re.compile(r"(kernels\.cpp|binding\w*\.h|\w*calls\w*\.h|__init__\.py)")


def _lines(paths: Iterable[Path]) -> int:
    return sum(len(path.read_text().splitlines()) for path in paths)


def _imported(module: ast.Module) -> Iterator[str]:
    """Yield the names of the modules of the package that a file imports."""
    for node in ast.walk(module):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ancfdae"):
            yield node.module or ""
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name.startswith("ancfdae"))


def table() -> list[tuple[str, str]]:
    """Return the rows of the table: a name and a number."""
    python = sorted(ROOT.rglob("*.py"))
    kernels = [path for path in ROOT.rglob("*") if path.suffix in (".h", ".cpp")]
    border = [path for path in (ROOT / "kernels").iterdir() if _BORDER.fullmatch(path.name)]
    modules = {path: ast.parse(path.read_text()) for path in python}
    nodes = [node for module in modules.values() for node in ast.walk(module)]
    functions = [x for x in nodes if isinstance(x, ast.FunctionDef | ast.AsyncFunctionDef)]
    lengths = [(x.end_lineno or x.lineno) - x.lineno + 1 for x in functions]
    importers = Counter(name for module in modules.values() for name in set(_imported(module)))
    dotted = (".".join(path.relative_to(ROOT.parent).with_suffix("").parts) for path in python)
    run()
    calls = passed()
    rows: list[tuple[str, object]] = [
        ("lines of Python", _lines(python)),
        ("lines of C++", _lines(kernels)),
        ("of these, border between Python and C++", _lines(border)),
        ("files of Python", len(python)),
        ("of these, imported by one file at most", sum(importers[name] <= 1 for name in dotted)),
        ("classes", sum(isinstance(x, ast.ClassDef) for x in nodes)),
        ("functions", len(functions)),
        ("mean lines of a function, docstring and all", f"{sum(lengths) / len(lengths):.1f}"),
        ("functions that one gradient passes", len(calls)),
        ("files that one gradient passes", len({code.co_filename for code in calls})),
    ]
    return [(what, str(number)) for what, number in rows]


if __name__ == "__main__":
    for what, number in table():
        print(f"{number:>8}  {what}")
