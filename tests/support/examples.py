"""Examples of every public joint, load and law, made from the types of their fields.

A new class is found by its line of export and runs through every test over its kind.
"""

import inspect
from collections.abc import Sequence
from dataclasses import MISSING, fields
from functools import reduce
from importlib import import_module
from itertools import product
from operator import or_
from types import UnionType
from typing import Union, get_args, get_origin, get_type_hints

import numpy as np

from ancfdae import RigidBody, Scene, assemble
from ancfdae.errors import InvalidInputError
from ancfdae.extend import Law, MaterialPoint
from ancfdae.facade import public_names
from ancfdae.laws import BSpline, Harmonic, RunUp
from ancfdae.model import laws
from ancfdae.model.joints.joint import DrivenJoint, JointEquations

#: Oblique and of no special length.
ARROW = (0.6, -0.8, 0.3)
#: Another one, for joints of two axes.
ACROSS = (0.5, 0.7, -0.4)


def coefficients_of(joint, p, reference, t, order=0):
    """Coefficients of a joint at an instant, or their time derivatives: its parts, put together."""
    still = joint.coefficients(p, reference)
    moving, factors = (), ()
    if isinstance(joint, DrivenJoint):
        moving, factors = joint.moving(p, reference), joint.factors(p, np.array([t]), order)[:, 0]
    parts = [(float(order == 0), still), *zip(factors, moving, strict=True)]
    arrays = (
        sum(factor * getattr(part, name) for factor, part in parts)
        for name in ("linear", "bilinear", "offset")
    )
    return JointEquations(*arrays, still.shapes)


def public_classes(module, base):
    """Concrete classes of a kind that modules of a package define, by name; synonyms once."""
    inside = f"{module.__name__}."
    found = (getattr(import_module(home), name) for name, home in public_names().items())
    kinds = (x for x in found if inspect.isclass(x) and issubclass(x, base))
    kinds = (x for x in kinds if x.__module__.startswith(inside))
    return {kind.__name__: kind for kind in kinds if not inspect.isabstract(kind)}


def values_of(hint, name, points, d):
    """Values for a field of this type, the first one for a field that must be given."""
    if get_origin(hint) in (UnionType, Union):
        return [x for part in get_args(hint) for x in values_of(part, name, points, d)]
    if get_origin(hint) is Sequence:
        return [ACROSS[:d] if name == "cross" else ARROW[:d]]
    return {
        MaterialPoint: [points[1 if name == "other" else 0]],
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


def examples(kind, beams, points, bodies=()):
    """Admissible examples of a class on two points, by what they are given beside the rest.

    All fields that must be given take every combination of values of their types. Of those that
    need not be given none, one or all are; where all do not go together, all but one. What a scene
    of the beams refuses is none.
    """
    d, hints = (*beams, *bodies)[0].dimension, get_type_hints(kind)
    needed, optional, count = [{}], {}, 0
    for field in fields(kind):
        if field.name == "name":
            continue
        values = values_of(hints[field.name], field.name, points, d)
        # Numbers of their own, and numbers that need not be given are: their default could hide.
        values = [x + 0.1 * count if isinstance(x, float) else x for x in values]
        count += any(isinstance(x, float) for x in values)
        options = [{field.name: value} for value in values]
        if field.default is MISSING or hints[field.name] is float:
            needed = [a | b for a in needed for b in options]
        else:
            optional[field.name] = options

    def admissible(*sets):
        found = {}
        for first, names in product(needed, sets):
            for given in product(*(optional[name] for name in names)):
                arguments = reduce(or_, given, first)
                try:
                    part = kind(**arguments)
                    assemble(scene_of((*beams, *bodies), part))
                except InvalidInputError:
                    continue
                own = [f.name for f in fields(kind) if f.default is not MISSING]
                extras = [name for name in own if name in arguments]
                found[", ".join([kind.__name__, *extras])] = part
        return found

    every = tuple(optional)
    all_but_one = [tuple(name for name in every if name != left) for left in every]
    few = admissible((), *((name,) for name in every))
    return few | (admissible(every) or admissible(*all_but_one))


def all_examples(module, base, beams, points, bodies=()):
    """Examples of all public classes of a kind."""
    found = {}
    for kind in public_classes(module, base).values():
        found |= examples(kind, beams, points, bodies)
    return found


#: All functions that a user's law may have, and its numbers in other places than those of laws.
def _wave(t, a, b, c, d, e):
    y = a * np.sin(b * t) + np.exp(-c * t) / (1.0 + np.square(t)) - np.tanh(d * t - e) * t**3
    y = y + np.sqrt(1.0 + t * t) * np.cos(t) - np.log(2.0 + t) + np.arctan(t) + np.cosh(0.1 * t)
    return y + np.reciprocal(3.0 + t) + np.sinh(0.2 * t) - np.tan(0.1 * t) + 2.0**t + (1 + t) ** a


#: What the fields of laws hold besides numbers.
_LAW_FIELDS = {
    "times": (0.2, 1.1, 1.8, 2.9, 3.7),
    "values": (0.3, -0.5, 0.8, 0.6, 0.1),
    "period": 4.5,
    "function": _wave,
    "before": Harmonic(0.4, 3.0, 0.2, 0.1),
    "after": RunUp(2.0, 1.0, 0.3, 1.6),
}
#: An instant at which all examples of laws vary, more than 0.3 s from the times of a spline.
LAW_TIME = 2.3


def law_examples():
    """Examples of all public laws, each optional field that is no number given or not."""
    found = {}
    for kind in public_classes(laws, Law).values():
        own = fields(kind)
        given = {f.name: _LAW_FIELDS.get(f.name, 0.7 + 0.3 * k) for k, f in enumerate(own)}
        if kind is BSpline:  # LAW_TIME is where all five hills overlap.
            given |= {"begin": -1.0, "end": 5.6}
        found[kind.__name__] = kind(**given)
        for field in own:
            if field.default is None:
                rest = {name: value for name, value in given.items() if name != field.name}
                found[f"{kind.__name__} without {field.name}"] = kind(**rest)
    return found
