"""Command line of the validation reports: ``python -m validation list`` and ``... run NAME``."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ancfdae.errors import AncfdaeError
from validation.catalogue import CATALOGUE, Definition
from validation.report import Report


def main(
    arguments: Sequence[str] | None = None, catalogue: Sequence[Definition] = CATALOGUE
) -> int:
    """Carry out one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after ``python -m validation``; by default those of the process.
    catalogue : sequence of Definition
        Reports to choose from.

    Returns
    -------
    int
        Exit code: 0 done, 1 the report could not be made, 2 no report has this name. Wrong usage
        leaves through ``SystemExit`` with code 2, as argparse does it.
    """
    chosen = _parser().parse_args(arguments)
    if chosen.command == "list":
        for definition in catalogue:
            print(f"{definition.name}: {definition.prose.title}\n    {definition.prose.question}")
        return 0
    for definition in catalogue:
        if definition.name == chosen.name:
            directory = chosen.out or Path("out") / definition.name
            return _run(definition, directory, chosen.quick)
    known = ", ".join(definition.name for definition in catalogue)
    print(f"validation run: no report is called {chosen.name!r}. Known: {known}.", file=sys.stderr)
    return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="name the reports and the question of each")
    run = commands.add_parser("run", help="make one report")
    run.add_argument("name", help="which one; `list` tells the names")
    run.add_argument(
        "--quick", action="store_true", help="coarse settings: a smoke test, not a result"
    )
    run.add_argument("--out", type=Path, metavar="DIR", help="where to write; default out/NAME")
    return parser


def _run(definition: Definition, directory: Path, quick: bool) -> int:
    # Without the folder: it belongs to the machine, not to the result.
    command = f"python -m validation run {definition.name}" + " --quick" * quick
    report = Report(definition.prose, directory, command)
    if quick:
        report.text("**Made with `--quick`: the figures below are not results.**")
    try:
        definition.run(report, quick)
    except AncfdaeError as error:
        print(f"validation run: {definition.name} failed: {error}", file=sys.stderr)
        return 1
    print(f"Report written to {report.write()}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
