"""Design variables: named numbers of a scene that sensitivities are taken for."""

from __future__ import annotations

import abc
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self, final

from ancfdae.errors import InvalidInput, require_sequence, require_vector

# The owner may contain dots: joints are named like pin(rod@0.5) by default.
_TARGET = re.compile(r"(.+)\.([a-z_]+)(?:\[(\d+)\])?")


class Parametrised(abc.ABC):
    """A named part of a scene with numbers that design variables can drive.

    Attributes
    ----------
    name : str
        Unique in a scene.
    """

    name: str

    @abc.abstractmethod
    def parameters(self) -> dict[str, float]:
        """Return the numbers that can be design targets, by name; the order is fixed."""

    @abc.abstractmethod
    def with_parameter(self, parameter: str, value: float) -> Self:
        """Return the same part with one of its `parameters` changed."""


def vector_parameters(prefix: str, vector: Sequence[float] | None) -> dict[str, float]:
    """Name the components of a vector ``prefix_x``, ``prefix_y``(, ``prefix_z``)."""
    if vector is None:
        return {}
    return {f"{prefix}_{axis}": value for axis, value in zip("xyz", vector, strict=False)}


def replaced_component(
    prefix: str, vector: Sequence[float], parameter: str, value: float
) -> tuple[float, ...]:
    """Return the vector with the component that `parameter` names replaced."""
    place = "xyz".index(parameter.removeprefix(f"{prefix}_"))
    return (*vector[:place], value, *vector[place + 1 :])


@final
@dataclass(frozen=True)
class Target:
    """One place of a scene that a design variable writes to.

    Parameters
    ----------
    owner : str
        Name of the beam, joint or load.
    parameter : str
        Name of its parameter, such as ``height``.
    element : int or None
        Element index, or None for the whole beam.
    """

    owner: str
    parameter: str
    element: int | None

    def __str__(self) -> str:
        """Return the target as the user writes it."""
        index = "" if self.element is None else f"[{self.element}]"
        return f"{self.owner}.{self.parameter}{index}"


@final
@dataclass(frozen=True)
class DesignVariable:
    """A design variable that drives one or several targets with one value.

    Parameters
    ----------
    name : str
    targets : sequence of str
        Each ``"beam.parameter"`` or ``"beam.parameter[element]"``.
    bounds : (float, float), optional
        Admissible range for optimisation.

    Raises
    ------
    InvalidInput
        If a target cannot be read or the bounds are not ordered.
    """

    name: str
    targets: Sequence[str]
    bounds: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Validate."""
        where = f"design variable {self.name!r}"
        rule = "needs a non-empty sequence of targets"
        repair = 'Write DesignVariable("E", ["rod.youngs_modulus"]).'
        targets = require_sequence(where, self.targets, rule, repair)
        if isinstance(self.targets, str) or not targets:
            raise InvalidInput(where, rule, repr(self.targets), repair)
        for text in targets:
            parse_target(text)
        if self.bounds is not None:
            require_vector(f"{where}, bounds", self.bounds, (2,))
            if not self.bounds[0] < self.bounds[1]:
                raise InvalidInput(
                    where,
                    "the lower bound must lie below the upper one",
                    self.bounds,
                    "Swap or widen the bounds.",
                )


def parse_target(text: str) -> Target:
    """Read ``"beam.parameter"`` or ``"beam.parameter[element]"``.

    Raises
    ------
    InvalidInput
        If the text has another form.
    """
    match = _TARGET.fullmatch(str(text))
    if match is None:
        raise InvalidInput(
            "design target",
            "must read 'beam.parameter' or 'beam.parameter[element]'",
            repr(text),
            "For example 'pendulum.youngs_modulus' or 'rod.height[2]'.",
        )
    owner, parameter, element = match.groups()
    return Target(owner, parameter, None if element is None else int(element))


def as_design(design: Sequence[str | DesignVariable]) -> tuple[DesignVariable, ...]:
    """Turn plain target names into design variables and refuse duplicate names.

    Raises
    ------
    InvalidInput
        If two variables share a name or a target.
    """
    if isinstance(design, str):
        raise InvalidInput("design", "must be a sequence", repr(design), "Put it in a list.")
    variables = tuple(
        item if isinstance(item, DesignVariable) else DesignVariable(item, (item,))
        for item in require_sequence("design", design)
    )
    for kind, names in (
        ("name", [variable.name for variable in variables]),
        ("target", [target for variable in variables for target in variable.targets]),
    ):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidInput(
                "design", f"every {kind} may appear once", twice, "Remove the duplicates."
            )
    return variables


def distribution(target: str, count: int) -> tuple[DesignVariable, ...]:
    """One design variable per element of a beam, e.g. a height distribution.

    Parameters
    ----------
    target : str
        ``"beam.parameter"``.
    count : int
        Number of elements of the beam.
    """
    parse_target(target)
    names = [f"{target}[{k}]" for k in range(count)]
    return tuple(DesignVariable(name, (name,)) for name in names)
