"""Files and functions of the package that one gradient of one pinned beam passes.

    python -m tests.tools.call_path          how many
    python -m tests.tools.call_path --list   which, and how often each is called

Both are counted after import, in the second of two calls: what is made once a process is left out.
"""

import sys
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType

import ancfdae
from ancfdae import HHT, Beam, Material, Pin, Scene, Terminal, gradient
from ancfdae.observables import position
from ancfdae.sections import Rectangle

ROOT = Path(ancfdae.__file__).parent


def run() -> None:
    """One gradient, direct differentiation, of a planar beam on a pin."""
    rod = Beam("rod", (0, 0), (1.2, 0), 2, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3))
    scene = Scene([rod], [Pin(rod.at_start)], gravity=(0, -9.81))
    gradient(scene, Terminal(position(rod.at_end, 1)), 2.0**-4, HHT(2.0**-7), design=["rod.height"])


def passed() -> Counter[CodeType]:
    """Return the functions of the package that `run` calls, with how often."""
    calls = Counter[CodeType]()

    def count(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        # Comprehensions are functions until Python 3.12.
        if event == "call" and "<" not in code.co_name and code.co_filename.startswith(str(ROOT)):
            calls[code] += 1

    sys.setprofile(count)
    try:
        run()
    finally:
        sys.setprofile(None)
    return calls


def main() -> None:
    """Print the counts."""
    run()
    calls = passed()
    files = Counter(code.co_filename for code in calls)
    if "--list" in sys.argv:
        for file, functions in sorted(files.items()):
            print(f"{Path(file).relative_to(ROOT)}: {functions}")
            for code, times in calls.items():
                if code.co_filename == file:
                    print(f"    {code.co_firstlineno:4} {code.co_qualname} {times}")
    print(f"{len(files)} files, {len(calls)} functions")


if __name__ == "__main__":
    main()
