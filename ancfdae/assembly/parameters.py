"""Map from design variables to parameters of elements and other parts, with derivatives.

A scene admits limited values for each variable, such as E > 0 (`value_limits`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import DesignVariable
from ancfdae.model.elements import ElementParameter
from ancfdae.model.scene import Scene
from ancfdae.model.scene_design import SCENE
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class ParameterMap:
    """Map from design variables to the element parameters that they drive.

    It has one entry per pair (element, parameter) that a variable drives; the element's parameter
    is `weight` times the variable, plus `offset`.
    """

    base: Array  # (n, 10): parameters of the scene as declared
    elements: Array  # of int, (n_pairs,)
    parameters: Array  # of int, (n_pairs,)
    variables: Array  # of int, (n_pairs,)
    # (n_pairs,): factor and constant part of the target; for a length both are multiplied by the
    # fraction of the element in the length of its beam.
    weights: Array
    offsets: Array  # (n_pairs,)
    # The `Scene.numbers` of all owners, by name; parameters of elements are in `base`.
    declared: dict[str, tuple[float, ...]]
    # By owner, tuples (index among its numbers, design variable, weight, offset).
    slots: dict[str, list[tuple[int, int, float, float]]]
    nominal: Array  # (n_b,): values of the design variables as declared
    names: tuple[str, ...]  # names of the design variables

    def numbers(self, owner: str, b: Array) -> tuple[Array, Array]:
        """Return the numbers p of an owner at b, (n_p,), and their derivatives p_b, (n_p, n_b)."""
        p = np.array(self.declared.get(owner, ()), dtype=complex if b.dtype.kind == "c" else float)
        p_b = np.zeros((len(p), len(b)))
        for place, variable, weight, offset in self.slots.get(owner, ()):
            p[place] = weight * b[variable] + offset
            p_b[place, variable] = weight
        return p, p_b

    def with_scene(self, numbers: Sequence[float], count: int) -> ParameterMap:
        """Return a copy of the map in which `numbers` replace the first `count` of the scene.

        No design variable drives the new numbers.
        """
        moved, kept = len(numbers) - count, (x for x in self.slots.get(SCENE, []) if x[0] >= count)
        slots = [(place + moved, index, weight, offset) for place, index, weight, offset in kept]
        declared = self.declared | {SCENE: (*numbers, *self.declared[SCENE][count:])}
        return replace(self, declared=declared, slots=self.slots | {SCENE: slots})

    def values(self, b: Array) -> Array:
        """Return the element parameters at design values b, shape (n, 10), in the dtype of b."""
        P = self.base.astype(np.result_type(self.base, b))
        P[self.elements, self.parameters] = self.weights * b[self.variables] + self.offsets
        return P

    def only(self, rows: Array) -> ParameterMap:
        """Return the map for the elements `rows` only, in that order."""
        places = np.full(len(self.base), -1)
        places[rows] = np.arange(len(rows))
        chosen = places[self.elements]
        kept = chosen >= 0
        return replace(
            self,
            base=self.base[rows],
            elements=chosen[kept],
            parameters=self.parameters[kept],
            variables=self.variables[kept],
            weights=self.weights[kept],
            offsets=self.offsets[kept],
        )

    def lengths_b(self, n_b: int) -> Array:
        """Return the design derivatives of the element lengths, shape (n, n_b)."""
        partial = np.zeros((len(self.base), n_b))
        chosen = self.pairs(ElementParameter.LENGTH)
        partial[self.elements[chosen], self.variables[chosen]] = self.weights[chosen]
        return partial

    def pairs(self, which: ElementParameter) -> Array:
        """Return the indices of pairs (element, variable) of one element parameter."""
        return np.flatnonzero(self.parameters == which)

    def driven(self) -> tuple[ElementParameter, ...]:
        """Return the element parameters that a design variable drives."""
        return tuple(map(ElementParameter, sorted(set(self.parameters.tolist()))))


def parameter_map(scene: Scene, design: Sequence[DesignVariable]) -> ParameterMap:
    """Return the map for all targets of the design variables.

    Raises UnknownNameError for unknown targets, InvalidInputError for two targets of one number.
    """
    base, none = scene.element_parameters, np.zeros(0, dtype=np.int64)
    pairs = [(none, none, none, np.zeros(0), np.zeros(0))]
    owner: dict[tuple[int, int], str] = {}
    slots: dict[str, list[tuple[int, int, float, float]]] = {}
    for index, variable in enumerate(design):
        for text in variable.targets:
            target = scene.resolve(text)
            factor, offset = variable.factor(text), scene.offset(variable, text)
            if not scene.is_of_elements(target):
                place = list(scene.numbers(target.owner)).index(target.indexed)
                slots.setdefault(target.owner, []).append((place, index, factor, offset))
                continue
            rows = scene.target_elements(target)
            which = scene.beam(target.owner).parameter_names()[target.parameter]
            share = np.ones(len(rows))
            if which is ElementParameter.LENGTH:
                share = base[rows, which] / np.sum(base[rows, which])
            for row in rows.tolist():
                other = owner.setdefault((row, which), text)
                if other != text:
                    raise InvalidInputError(
                        "design",
                        "two targets may not write to the same parameter of an element",
                        f"{other} and {text}",
                        "Remove one of them.",
                    )
            numbers = np.full(len(rows), int(which)), np.full(len(rows), index)
            pairs.append((rows, *numbers, factor * share, offset * share))
    elements, parameters, variables, weights, offsets = map(
        np.concatenate, zip(*pairs, strict=True)
    )
    return ParameterMap(
        base,
        elements,
        parameters,
        variables,
        weights,
        offsets,
        declared={owner: tuple(scene.numbers(owner).values()) for owner in scene.owners()},
        slots=slots,
        nominal=np.array([scene.value(variable) for variable in design], dtype=float),
        names=tuple(variable.name for variable in design),
    )


# Trial values on one side of zero, over the size of a variable. If a sign is required, every value
# is rejected; values rejected for another reason, such as two coinciding points, are isolated.
_BEYOND = (1e-6, 0.37, 1.0, 2.9)
# Limits of Poisson's ratio, outside which a material has no positive moduli.
_POISSON = (-1.0, 0.5)


def value_limits(scene: Scene, design: tuple[DesignVariable, ...], b: Array) -> tuple[Array, Array]:
    """Return lower and upper limits of the values b, shape (n_b,); infinite without a limit.

    A limit holds whatever the other variables are: zero for a positive or non-negative parameter,
    and the limits of Poisson's ratio.
    """
    pairs = zip(design, b.tolist(), strict=True)
    lower, upper = np.transpose([_limits(scene, variable, value) for variable, value in pairs])
    return lower, upper


def _limits(scene: Scene, variable: DesignVariable, value: float) -> tuple[float, float]:
    parameters = {scene.resolve(text).parameter for text in variable.targets}
    if "poisson_ratio" in parameters and not variable.shares:
        return _POISSON
    size = abs(value) or 1.0
    negative, positive = (
        not any(_fits(scene, variable, sign * part * size) for part in _BEYOND) for sign in (-1, 1)
    )
    return (0.0 if negative else -np.inf, 0.0 if positive else np.inf)


def _fits(scene: Scene, variable: DesignVariable, value: float) -> bool:
    try:
        scene.refuse_values({variable: value})
    except InvalidInputError:
        return False
    return True
