"""Flip the sign of every override of the protocol in turn: does `check_system` see it?

python -m tests.tools.sign_mutation      prints what it sees, and fails if it misses one
"""

import sys
from dataclasses import replace

import numpy as np

from ancfdae import (
    Beam,
    Distance,
    FollowerForce,
    InitialVelocity,
    Material,
    Pin,
    RotationDriver,
    Scene,
    assemble,
    check_system,
)
from ancfdae.equations.derived import members
from ancfdae.extend import FormulaSystem
from ancfdae.laws import Harmonic
from ancfdae.sections import Rectangle
from tests.support.mechanisms import GuidedDoublePendulum

DESIGN = ("a.height", "a.length", "m.frequency", "push.force_x")


def everything(design=DESIGN):
    """An assembled scene in which no member of the protocol vanishes."""
    section, soft = Rectangle(0.05, 0.04), Material(4000.0, 1e6, 0.3, damping_time=1e-3)
    a = Beam("a", (0.0, 0.0), (0.5, 0.0), 1, section, soft)
    joints = [
        Pin(a.at_start),
        RotationDriver(a.at_start, Harmonic(0.5, 4.0), name="m"),
        Distance(a.at_end, 0.8, ground=(1.1, 0.8), name="d"),
    ]
    push = FollowerForce(a.at(0.6), (4.0, 1.0), law=Harmonic(1.0, 3.0, 0.4), name="push")
    start = [InitialVelocity("a", 2.0, (0.0, 0.0))]
    scene = Scene([a], joints, (0.0, -9.81), start, [push], project_start=True)
    return assemble(scene, design)


def negative(value, part=None):
    """Return a result with the other sign, or a tuple with one part of it so."""
    if isinstance(value, tuple):
        return tuple(-x if part in (None, k) else x for k, x in enumerate(value))
    if isinstance(value, np.ndarray):
        return -value
    arrays = {name: array for name, array in vars(value).items() if array is not None}
    return replace(value, **{name: -array for name, array in arrays.items()})


def overrides(kind):
    """Return the names of the members that a class writes itself."""
    return [name for name in members() if name in vars(kind)]


def parts(name):
    """Return what of a result is flipped: each array of a tuple in turn."""
    # Which loads turn nothing else tells: value and partial together may have any sign.
    return (0, 1) if name in ("start", "start_b", "following_load") else (None,)


def flipped(kind, name, part):
    """Return the member with the other sign."""
    right = vars(kind)[name]
    return lambda self, *arguments: negative(right(self, *arguments), part)


def seen(system, kind, name, part):
    """Return the findings that are wrong once the sign of one member of a class is."""
    right = vars(kind)[name]
    setattr(kind, name, flipped(kind, name, part))
    try:
        # Signs in a fresh system: caches know the right ones.
        return check_system(system(), samples=1).wrong
    finally:
        setattr(kind, name, right)


def main():
    missed = []
    for system, kind in (
        (everything, type(everything())),
        (GuidedDoublePendulum, FormulaSystem),
    ):
        for name, part in ((each, part) for each in overrides(kind) for part in parts(each)):
            findings = [finding.name for finding in seen(system, kind, name, part)]
            missed += [] if findings else [f"{kind.__name__}.{name}"]
            print(f"{kind.__name__}.{name}: {', '.join(findings) or 'NOT SEEN'}")
    sys.exit(f"not seen: {', '.join(missed)}" if missed else 0)


if __name__ == "__main__":
    main()
