"""Whatever public constructors are given, they make an object or refuse it in their own words.

A constructor is found by its line of export. It is given values of the types of its fields, one
or two of them spoiled; what it accepts must be of those types, and finite.
"""

import inspect
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

import ancfdae
from ancfdae import HHT, Material, Pin, PointForce, RigidBox, Terminal, distributed_variables
from ancfdae.errors import AncfdaeError
from ancfdae.extend import (
    BodyShape,
    Integrator,
    Law,
    Load,
    MaterialPoint,
    Objective,
    Observable,
    Section,
)
from ancfdae.facade import public_names
from ancfdae.laws import Harmonic
from ancfdae.model.joints.joint import Joint
from ancfdae.sections import Rectangle
from tests.support.junk import INF, JUNK, ROD, TIP

#: What the fields of each type are given.
GOOD = {
    float: [0.3, 1.0, 2.5],
    int: [0, 1, 2],
    bool: [True, False],
    str: ["rod"],
    NoneType: [None],
    Any: [0.3],
    MaterialPoint: [ROD.at_end, ROD.at(0.5)],
    Law: [Harmonic(amplitude=0.4, frequency=3.0)],
    Section: [Rectangle(0.05, 0.04)],
    Material: [Material(1e3, 1e7, 0.3)],
    BodyShape: [RigidBox(0.3, 0.2, 0.1)],
    Observable: [TIP],
    Objective: [Terminal(TIP)],
    Integrator: [HHT(0.1)],
    Load: [PointForce(ROD.at_end, (0.0, 1.0))],
    Joint: [Pin(ROD.at_start)],
}


def kinds() -> list[Callable[..., Any]]:
    """Public constructors and functions whose fields all have a type that is known here."""
    found = [getattr(import_module(home), name) for name, home in public_names().items()]
    # Functions that formulas of a user call get arrays or symbols from the package.
    inside = [getattr(ancfdae.extend, name) for name in ancfdae.extend.__all__]
    found = [x for x in found if inspect.isclass(x) or not any(x is y for y in inside)]
    return [
        make
        for make in found
        if callable(make)
        and not inspect.isabstract(make)
        and not (inspect.isclass(make) and issubclass(make, BaseException))
        and (not inspect.isclass(make) or "Array" not in str(inspect.signature(make)))
        and all(p.default is not p.empty or good(h) for p, h in arguments(make).values())
        and arguments(make)
    ]


def arguments(make: Callable[..., Any]) -> dict[str, tuple[inspect.Parameter, Any]]:
    """Parameters of a constructor with their types; none if they are not all stated."""
    try:
        parameters = inspect.signature(make).parameters
        # Of a dataclass the fields tell, which are resolved where each is written.
        hints = get_type_hints(make)
        if not parameters.keys() <= hints.keys():
            hints = get_type_hints(make.__init__)  # type: ignore[misc]
        return {name: (p, hints[name]) for name, p in parameters.items()}
    except (KeyError, NameError, ValueError, TypeError):
        return {}


def good(hint: Any) -> list[Any]:
    """Values of a type."""
    if get_origin(hint) in (UnionType, Union):
        return [x for part in get_args(hint) for x in good(part)]
    if get_origin(hint) is Sequence:
        each = good(get_args(hint)[0])
        return [tuple((each * 3)[:count]) for count in (2, 3, 1)] if each else []
    return GOOD.get(hint, [])


def fits(hint: Any, value: Any) -> bool:
    """Whether a value is of a type and, a number, finite; types that are not known here pass."""
    if get_origin(hint) in (UnionType, Union):
        return any(fits(part, value) for part in get_args(hint))
    if get_origin(hint) is Sequence:
        items = isinstance(value, Sequence | np.ndarray | Mapping)
        return items and all(fits(get_args(hint)[0], x) for x in value)
    if hint is float:
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        return number and not isinstance(value, complex) and abs(value) < INF
    if hint is int:
        return isinstance(value, int | np.integer) and not isinstance(value, bool)
    if hint is bool:
        return isinstance(value, bool | np.bool_)
    return hint not in GOOD or hint is Any or isinstance(value, hint)


@st.composite
def calls(draw: st.DrawFn) -> tuple[Callable[..., Any], dict[str, Any]]:
    make = draw(st.sampled_from(KINDS))
    given = {
        name: draw(st.sampled_from(good(hint)))
        for name, (p, hint) in arguments(make).items()
        if good(hint) and (p.default is p.empty or draw(st.booleans()))
    }
    for name in draw(st.lists(st.sampled_from(sorted(arguments(make))), max_size=2)):
        given[name] = draw(st.sampled_from(JUNK))
    return make, given


#: What the package makes, not its users.
RESULTS = {"ErrorEstimates", "MeasuredSetting", "Statistics", "StepSuggestion"}
KINDS = [make for make in kinds() if make.__name__ not in RESULTS]


def test_constructors_of_every_kind_are_found() -> None:
    names = {make.__name__ for make in KINDS}
    assert {
        "Beam",
        "Pin",
        "RotationDriver",
        "PointForce",
        "Rectangle",
        "Scene",
        "HHT",
        "position",
    } <= names
    assert len(names) > 80


# The profile of conftest.py is derandomised; FUZZ asks for a longer search.
@settings(max_examples=int(os.environ.get("FUZZ", "400")))
@given(calls())
@example((distributed_variables, {"target": "rod.height", "count": "3"}))
@example((distributed_variables, {"target": "rod.height", "count": -2}))
@example((ancfdae.Scene, {"beams": (ROD,), "project_start": "no"}))
@example((ancfdae.Scene, {"beams": (ROD,), "assemble": "no"}))
@example((ancfdae.extend.MaterialPoint, {"beam": ROD}))
@example((ancfdae.InitialVelocity, {"body": ROD, "angular_velocity": 1.0, "about": (0.0, 0.0)}))
@example((ancfdae.DistributedForce, {"beam": ROD, "force_per_length": (0.0, 1.0)}))
@example((ancfdae.FiniteDifference, {"central": "yes"}))
@example((ancfdae.Moment, {"point": ROD.at_end, "moment": 1.0, "follower": "no"}))
@example((ancfdae.Weld, {"point": ROD.at_end, "other": None}))
@example((ancfdae.observables.mass, {"beam": ROD}))
@example((ancfdae.observables.strain_energy, {"beam": ROD}))
@example((ancfdae.observables.design_value, {"name": 3}))
@example((ancfdae.observables.driver_torque, {"joint": Pin(ROD.at_end)}))
@example((ancfdae.observables.load_power, {"load": 3}))
@example((ancfdae.observables.multiplier, {"joint": "pin", "row": ""}))
@example((ancfdae.observables.maximum_von_mises, {"beam": ROD, "sharpness": 5.0}))
def test_input_makes_an_object_or_is_refused(
    call: tuple[Callable[..., Any], dict[str, Any]],
) -> None:
    make, given = call
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ancfdae.errors.StabilityWarning)
            repr(make(**given))
    except AncfdaeError:
        return
    except TypeError as error:
        # Python's own word on arguments that are missing.
        if "required" in str(error):
            return
        raise
    wrong = [
        name
        for name, (_, hint) in arguments(make).items()
        if name in given and not fits(hint, given[name])
    ]
    assert not wrong, f"{make.__name__} accepted {given}"
