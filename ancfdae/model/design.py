"""Design variables: named numbers of a scene with respect to which sensitivities are computed."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Self, final

import numpy as np

from ancfdae.errors.checks import (
    require_count,
    require_finite,
    require_sequence,
    require_unique,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.numerics.arrays import Array

# The owner may contain dots: joints are named like pin(rod@0.5) by default.
_TARGET = re.compile(r"(.+)\.([A-Za-z_]\w*)(?:\[(\d+)\])?")

# Components of a symmetric tensor, in the order in which a field holds its six entries.
_TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")


class Designable:
    """Base class of dataclasses with numbers that design variables can drive."""

    # Names of the fields with design numbers, each with the function that checks its value, called
    # with the `where` of error messages and the value. A field holds a number, which is a design
    # target by the name of the field; a vector, by the first word of the name and the axis
    # (``force_vector`` gives ``force_x``, ``force_y``); or another `Designable`, by its targets. It
    # may hold None where that is its default.
    design_fields: ClassVar[tuple[tuple[str, Callable[[str, Any], None]], ...]] = ()
    # The design fields whose numbers are distinguished by an index, each with the word of its
    # targets: ``{"values": "value"}`` gives ``value[0]``, ``value[1]`` ...
    indexed_fields: ClassVar[Mapping[str, str]] = {}
    # Words of targets for vector fields whose first word another field has already.
    vector_words: ClassVar[Mapping[str, str]] = {}

    def parameters(self) -> dict[str, float]:
        """Return the numbers that can be design targets, by name, in a fixed order."""
        design_numbers: dict[str, float] = {}
        for name, _ in self.design_fields:
            design_numbers |= self.numbers_of(name)
        return design_numbers

    def with_parameters(self, changes: Mapping[str, float]) -> Self:
        """Return the same object with some of the numbers of `parameters` changed together.

        Raises UnknownNameError.
        """
        return replace(self, **self.changed_fields(changes))  # type: ignore[type-var]

    def changed_fields(self, changes: Mapping[str, float]) -> dict[str, Any]:
        """Return the new values of the fields that the changed `parameters` belong to, by name.

        Raises UnknownNameError.
        """
        unknown = [parameter for parameter in changes if parameter not in self.parameters()]
        if unknown:
            raise UnknownNameError("design target", unknown[0], self.parameters())
        new: dict[str, Any] = {}
        for name, value in self._design_values():
            design_numbers = self.numbers_of(name)
            changed = {key: changes.get(key, number) for key, number in design_numbers.items()}
            if changed == design_numbers:
                continue
            if isinstance(value, Designable):
                inner = zip(value.parameters(), changed.values(), strict=True)
                new[name] = value.with_parameters(dict(inner))
            else:
                new[name] = changed[name] if np.ndim(value) == 0 else tuple(changed.values())
        return new

    def split(self, p: Array) -> list[Any]:
        """Return the value of each design field out of `p`, real or complex.

        `p` holds the values of `parameters`. A field gives a number, an array, or None if it holds
        None.
        """
        return [None if at is None else p[at] for at in self.design_places[0]]

    @cached_property
    def design_places(self) -> tuple[list[int | slice | None], int]:
        """Index or slice of each design field in the values of `parameters`, and their number.

        The index is None for a field that holds None.
        """
        places, stop = list[int | slice | None](), 0
        for name, value in self._design_values():
            first, stop = stop, stop + len(self.numbers_of(name))
            single = type(value) is float or (
                not isinstance(value, Designable) and np.ndim(value) == 0
            )
            places.append(None if value is None else first if single else slice(first, stop))
        return places, stop

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Return the times between which the object is an analytic function of time; s.

        Parameters
        ----------
        p : array, shape (n_p,)
            Values of all `parameters`, each in its own unit.
        """
        values = zip(self._design_values(), self.split(p), strict=True)
        inner = ((x, its) for (_, x), its in values if isinstance(x, Designable))
        return tuple(t for x, its in inner for t in x.breakpoints(its))

    def over_time(self, p: Array, t: Array, unmarked: bool = False) -> list[Array]:
        """Return the values of the object's laws of time at t, shape (k,): one array per law.

        Parameters
        ----------
        p : array, shape (n_p,)
            Values of all `parameters`, each in its own unit.
        unmarked : bool, optional
            Leave out laws whose `breakpoints` mark all their fast changes (`Law.marked`).
        """
        values = zip(self._design_values(), self.split(p), strict=True)
        inner = ((x, its) for (_, x), its in values if isinstance(x, Designable))
        return [row for x, its in inner for row in x.over_time(its, t, unmarked)]

    def check_fields(self, where: str) -> None:
        """Check the value of each design field by its rule; InvalidInputError if one breaks it."""
        for name, rule in self.design_fields:
            value = getattr(self, name)
            if value is None:
                optional = {each.name for each in fields(self) if each.default is None}  # type: ignore[arg-type]
                if name in optional:
                    continue
            rule(f"{where}, {name}", value)

    def numbers_of(self, name: str) -> dict[str, float]:
        """Return the numbers of the design field `name`, by target name."""
        value = getattr(self, name)
        if type(value) is float:
            return {name: value}
        if value is None:
            return {}
        if isinstance(value, Designable):
            return value.parameters()
        if name in self.indexed_fields:
            return {f"{self.indexed_fields[name]}[{k}]": x for k, x in enumerate(value)}
        if np.ndim(value) == 0:
            return {name: value}
        prefix = self.vector_words.get(name, name.partition("_")[0])
        axes = _TENSOR if len(value) == len(_TENSOR) else "xyz"
        return {f"{prefix}_{axis}": x for axis, x in zip(axes, value, strict=False)}

    def _design_values(self) -> list[tuple[str, Any]]:
        return [(name, getattr(self, name)) for name, _ in self.design_fields]


def require_numbers(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is a non-empty sequence of finite numbers."""
    rule, repair = "must be a sequence of numbers", "Give one number or more in a list."
    given = require_sequence(where, value, rule, repair)
    if isinstance(value, str) or not given:
        raise InvalidInputError(where, rule, repr(value), repair)
    for number in given:
        require_finite(where, number)


def design_numbers(*names: str) -> tuple[tuple[str, Callable[[str, Any], None]], ...]:
    """Return a design field for each of these field names, with any finite number as its value."""
    return tuple((name, require_finite) for name in names)


@final
@dataclass(frozen=True)
class Target:
    """One number of a scene that a design variable sets: owner, parameter and element or index."""

    owner: str  # name of the beam, joint or load
    parameter: str  # name of its parameter, such as ``height``
    # Index of an element of a beam, or of a control value of a law; None for the whole beam, or a
    # parameter without index.
    element: int | None

    @property
    def indexed(self) -> str:
        """Parameter name with its index, such as ``value[2]``, as in `Designable.parameters`."""
        return self.parameter if self.element is None else f"{self.parameter}[{self.element}]"

    def __str__(self) -> str:
        return f"{self.owner}.{self.indexed}"


@final
@dataclass(frozen=True)
class DesignVariable:
    """A design variable that sets one or several targets of a scene.

    Parameters
    ----------
    name : str
    targets : sequence of str, or mapping
        Each ``"beam.parameter"`` or ``"beam.parameter[element]"``. All targets of a sequence hold
        the value of the variable. A mapping gives each target a factor: the first target is its
        factor times the variable, and every further one moves by its factor times the change of the
        variable. So a length that moves two joints reads
        ``{"rod.length": 1, "left.ground_x": -0.5, "right.ground_x": 0.5}``.
    bounds : (float, float), optional
        Admissible range for optimisation, in the unit of the first target.

    Raises
    ------
    InvalidInputError
        If a target cannot be read, a factor is zero, or the bounds are not ordered.
    """

    name: str
    targets: Sequence[str] | Mapping[str, float]
    bounds: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        where = f"design variable {self.name!r}"
        rule = "needs a non-empty sequence of targets"
        repair = 'Write DesignVariable("E", ["rod.youngs_modulus"]).'
        targets = require_sequence(where, self.targets, rule, repair)
        if isinstance(self.targets, str) or not targets:
            raise InvalidInputError(where, rule, repr(self.targets), repair)
        for text in targets:
            parse_target(text)
            require_finite(f"{where}, factor of {text}", self.factor(text))
            if self.factor(text) == 0:
                rule, repair = "a factor must not be zero", "Leave the target out."
                raise InvalidInputError(where, rule, f"0 for {text}", repair)
        if self.bounds is not None:
            require_vector(f"{where}, bounds", self.bounds, (2,))
            if not self.bounds[0] < self.bounds[1]:
                raise InvalidInputError(
                    where,
                    "the lower bound must lie below the upper one",
                    self.bounds,
                    "Swap or widen the bounds.",
                )

    def __hash__(self) -> int:
        """Return a hash of name and targets, so that design variables can be keys of a mapping."""
        return hash((self.name, tuple(self.targets)))

    @property
    def shares(self) -> bool:
        """Whether `targets` gives factors (a mapping); otherwise all targets hold the value."""
        return isinstance(self.targets, Mapping)

    def factor(self, target: str) -> float:
        """Return the derivative of the value of `target` with respect to this design variable."""
        return self.targets[target] if isinstance(self.targets, Mapping) else 1.0


def parse_target(text: str) -> Target:
    """Return the `Target` of ``"beam.parameter"`` or ``"beam.parameter[element]"``.

    InvalidInputError if the text has another form.
    """
    match = _TARGET.fullmatch(str(text))
    if match is None:
        repair = "For example 'pendulum.youngs_modulus' or 'rod.height[2]'."
        if text == "t_end":
            repair = 'gradient and Responses take design=["t_end"]; give bounds to the optimiser.'
        rule = "must read 'beam.parameter' or 'beam.parameter[element]'"
        raise InvalidInputError("design target", rule, repr(text), repair)
    owner, parameter, element = match.groups()
    return Target(owner, parameter, None if element is None else int(element))


def as_design(design: Sequence[str | DesignVariable]) -> tuple[DesignVariable, ...]:
    """Return design variables, one for each plain target name or `DesignVariable`.

    InvalidInputError if two variables share a name or a target.
    """
    if isinstance(design, str):
        raise InvalidInputError("design", "must be a sequence", repr(design), "Put it in a list.")
    variables = tuple(
        item if isinstance(item, DesignVariable) else DesignVariable(item, (item,))
        for item in require_sequence("design", design)
    )
    for kind, names in (
        ("name", [variable.name for variable in variables]),
        ("target", [target for variable in variables for target in variable.targets]),
    ):
        require_unique("design", f"every {kind} may appear once", names, "Remove the duplicates.")
    return variables


def distributed_variables(
    target: str, count: int, bounds: tuple[float, float] | None = None
) -> tuple[DesignVariable, ...]:
    """Return one design variable per element of a beam, or per control value of a law.

    For example a height distribution, or the torque of a motor over time.

    Parameters
    ----------
    target : str
        ``"beam.parameter"`` or ``"motor.value"``.
    count : int
        Number of elements of the beam, or of control values.
    bounds : (float, float), optional
        Admissible range of each variable for optimisation, as of `DesignVariable`.
    """
    parse_target(target)
    where, repair = "distributed_variables, count", "Give the number of elements or control values."
    require_count(where, count, repair)
    names = [f"{target}[{k}]" for k in range(count)]
    return tuple(DesignVariable(name, (name,), bounds) for name in names)
