"""Examples of every public joint, load and law, made from the types of their fields.

A new class is found by its line of export and runs through every test over its kind.
"""

import inspect
from collections.abc import Sequence
from dataclasses import MISSING, fields
from types import UnionType
from typing import Union, get_args, get_origin, get_type_hints

from ancfdae import Harmonic, InvalidInput, Point, RigidBody, Scene, assemble
from ancfdae.joints import Law

#: Oblique and of no special length.
ARROW = (0.6, -0.8, 0.3)


def public_classes(module, base):
    """Concrete classes of a kind that a package exports, by name; synonyms once."""
    kinds = (x for x in vars(module).values() if inspect.isclass(x) and issubclass(x, base))
    return {kind.__name__: kind for kind in kinds if not inspect.isabstract(kind)}


def values_of(hint, name, points, d):
    """Values for a field of this type, the first one for a field that must be given."""
    if get_origin(hint) in (UnionType, Union):
        return [x for part in get_args(hint) for x in values_of(part, name, points, d)]
    if get_origin(hint) is Sequence:
        return [ARROW[:d]]
    return {
        Point: [points[1 if name == "other" else 0]],
        Law: [Harmonic(amplitude=0.4, frequency=3.0, phase=0.2, offset=0.1)],
        float: [0.7],
        bool: [True],
        str: [points[0].beam],
    }.get(hint, [])


def scene_of(members, part):
    """A scene of beams or rigid bodies and one joint or load."""
    bodies = [body for body in members if isinstance(body, RigidBody)]
    beams = [beam for beam in members if beam not in bodies]
    return Scene(beams, bodies=bodies, **{f"{part.role}s": [part]})


def examples(kind, beams, points):
    """Admissible examples of a class on two points, by what they are given beside the rest.

    All fields that must be given take every combination of values of their types; each field that
    need not be given is left out or given. What a scene of the beams refuses is none.
    """
    d, hints = beams[0].dimension, get_type_hints(kind)
    choices = [{}]
    for field in fields(kind):
        if field.name == "name":
            continue
        values = values_of(hints[field.name], field.name, points, d)
        options = [{field.name: value} for value in values]
        if field.default is not MISSING:
            # Numbers that need not be given are: their default could hide them.
            options = options if hints[field.name] is float else [{}, *options]
        choices = [a | b for a in choices for b in options]
    found = {}
    for arguments in choices:
        try:
            part = kind(**arguments)
            assemble(scene_of(beams, part))
        except InvalidInput:
            continue
        extras = [f.name for f in fields(kind) if f.default is not MISSING and f.name in arguments]
        found[", ".join([kind.__name__, *extras])] = part
    return found


def all_examples(module, base, beams, points):
    """Examples of all public classes of a kind."""
    found = {}
    for kind in public_classes(module, base).values():
        found |= examples(kind, beams, points)
    return found
