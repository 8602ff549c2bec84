"""Design variables: named numbers of a scene that sensitivities are taken for."""

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

# Entries of a symmetric tensor, in the order of a field that holds one.
_TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")


class Designable:
    """A dataclass with numbers that design variables can drive."""

    # The fields that hold them, each with the rule that its value must obey, called with the place
    # for the error and the value. A field holds a number, which is a design target by the name of
    # the field; a vector, by the first word of the name and the axis (``force_vector`` gives
    # ``force_x``, ``force_y``); or another `Designable`, by its targets. It may hold None where
    # that is its default.
    design_fields: ClassVar[tuple[tuple[str, Callable[[str, Any], None]], ...]] = ()
    # Those of them that hold numbers told apart by an index, each with the word that targets have:
    # ``{"values": "value"}`` gives ``value[0]``, ``value[1]`` ...
    indexed_fields: ClassVar[Mapping[str, str]] = {}
    # The words for vectors whose first word would be that of another.
    vector_words: ClassVar[Mapping[str, str]] = {}

    def parameters(self) -> dict[str, float]:
        """Return the numbers that can be design targets, by name; the order is fixed."""
        design_numbers: dict[str, float] = {}
        for name, _ in self.design_fields:
            design_numbers |= self.numbers_of(name)
        return design_numbers

    def with_parameters(self, changes: Mapping[str, float]) -> Self:
        """Return the same object with some of its `parameters` changed together.

        Raises UnknownNameError.
        """
        return replace(self, **self.changed_fields(changes))  # type: ignore[type-var]

    def changed_fields(self, changes: Mapping[str, float]) -> dict[str, Any]:
        """Return the design fields that change with some of the `parameters`.

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
        """Return the values of the design fields out of those of `parameters`, real or complex.

        For every field a number, an array, or None where it holds None.
        """
        return [None if at is None else p[at] for at in self.design_places[0]]

    @cached_property
    def design_places(self) -> tuple[list[int | slice | None], int]:
        """Return the places of the design fields among all `parameters`, and their count."""
        places, stop = list[int | slice | None](), 0
        for name, value in self._design_values():
            first, stop = stop, stop + len(self.numbers_of(name))
            single = type(value) is float or (
                not isinstance(value, Designable) and np.ndim(value) == 0
            )
            places.append(None if value is None else first if single else slice(first, stop))
        return places, stop

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Return the instants between which it is an analytic function of time; s.

        Parameters
        ----------
        p : array, shape (n_p,)
            Values of all `parameters`, each in its own unit.
        """
        values = zip(self._design_values(), self.split(p), strict=True)
        inner = ((x, its) for (_, x), its in values if isinstance(x, Designable))
        return tuple(t for x, its in inner for t in x.breakpoints(its))

    def over_time(self, p: Array, t: Array, unmarked: bool = False) -> list[Array]:
        """Return the values of its laws of time at t, shape (k,): one array (k,) for each law.

        Parameters
        ----------
        p : array, shape (n_p,)
            Values of all `parameters`, each in its own unit.
        unmarked : bool, optional
            Leave out laws whose `breakpoints` mark all that is fast in them (`Law.marked`).
        """
        values = zip(self._design_values(), self.split(p), strict=True)
        inner = ((x, its) for (_, x), its in values if isinstance(x, Designable))
        return [row for x, its in inner for row in x.over_time(its, t, unmarked)]

    def check_fields(self, where: str) -> None:
        """Refuse values of design fields that break their rules."""
        for name, rule in self.design_fields:
            value = getattr(self, name)
            if value is None:
                optional = {each.name for each in fields(self) if each.default is None}  # type: ignore[arg-type]
                if name in optional:
                    continue
            rule(f"{where}, {name}", value)

    def numbers_of(self, name: str) -> dict[str, float]:
        """Return the numbers of one design field by target name."""
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
    """Raise InvalidInputError for anything but one finite number or more in a sequence."""
    rule, repair = "must be a sequence of numbers", "Give one number or more in a list."
    given = require_sequence(where, value, rule, repair)
    if isinstance(value, str) or not given:
        raise InvalidInputError(where, rule, repr(value), repair)
    for number in given:
        require_finite(where, number)


def design_numbers(*names: str) -> tuple[tuple[str, Callable[[str, Any], None]], ...]:
    """Return design fields that hold any finite number."""
    return tuple((name, require_finite) for name in names)


@final
@dataclass(frozen=True)
class Target:
    """One place of a scene that a design variable writes to."""

    owner: str  # name of the beam, joint or load
    parameter: str  # name of its parameter, such as ``height``
    # Index of an element of a beam, or of a control value of a law; None for the whole beam, or a
    # parameter without index.
    element: int | None

    @property
    def indexed(self) -> str:
        """The parameter with its index, as among the `parameters` of a joint or load."""
        return self.parameter if self.element is None else f"{self.parameter}[{self.element}]"

    def __str__(self) -> str:
        return f"{self.owner}.{self.indexed}"


@final
@dataclass(frozen=True)
class DesignVariable:
    """A design variable that drives one or several targets.

    Parameters
    ----------
    name : str
    targets : sequence of str, or mapping
        Each ``"beam.parameter"`` or ``"beam.parameter[element]"``. All targets of a sequence hold
        the value of the variable. A mapping gives each a factor: the first target is its factor
        times the variable, and the others move by theirs times its change; so a length that moves
        two joints reads ``{"rod.length": 1, "left.ground_x": -0.5, "right.ground_x": 0.5}``.
    bounds : (float, float), optional
        Admissible range for optimisation.

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
        """Return a hash, so that variables can be keys of values."""
        return hash((self.name, tuple(self.targets)))

    @property
    def shares(self) -> bool:
        """Whether targets move by factors, instead of all holding the value."""
        return isinstance(self.targets, Mapping)

    def factor(self, target: str) -> float:
        """Return by how much a target moves with the variable."""
        return self.targets[target] if isinstance(self.targets, Mapping) else 1.0


def parse_target(text: str) -> Target:
    """Read ``"beam.parameter"`` or ``"beam.parameter[element]"``.

    InvalidInputError if the text has another form.
    """
    match = _TARGET.fullmatch(str(text))
    if match is None:
        raise InvalidInputError(
            "design target",
            "must read 'beam.parameter' or 'beam.parameter[element]'",
            repr(text),
            "For example 'pendulum.youngs_modulus' or 'rod.height[2]'.",
        )
    owner, parameter, element = match.groups()
    return Target(owner, parameter, None if element is None else int(element))


def as_design(design: Sequence[str | DesignVariable]) -> tuple[DesignVariable, ...]:
    """Turn plain target names into design variables and refuse duplicate names.

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
    """One design variable per element of a beam, or per control value of a law.

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
