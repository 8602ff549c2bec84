"""Scenes with other meshes, and design variables that mean the same there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ancfdae.errors import InvalidInput
from ancfdae.model.design import DesignVariable, parse_target
from ancfdae.model.scene import Scene


def with_mesh(
    scene: Scene, design: Sequence[DesignVariable], level: int
) -> tuple[Scene, tuple[DesignVariable, ...]]:
    """Return a scene with 2^level times the elements, and the same design variables.

    Raises
    ------
    InvalidInput
        If a beam cannot have this mesh: its elements differ or are too few, its nodes are given,
        or a start is given node by node.
    """
    counts = {
        beam.name: beam.element_count << level if level >= 0 else _fewer(beam.element_count, level)
        for beam in scene.beams
    }
    if level == 0:
        return scene, tuple(design)
    beams = [beam if beam.rigid else beam.with_elements(counts[beam.name]) for beam in scene.beams]
    return replace(scene, beams=beams), tuple(_variable(x, scene, level) for x in design)


def coarsest(scene: Scene) -> int:
    """Return the lowest level, -2 at least, at which every mesh is still a whole one."""
    counts = [beam.element_count for beam in scene.beams if not beam.rigid]
    return min(level for level in (0, -1, -2) if all(n % (1 << -level) == 0 for n in counts))


def _fewer(count: int, level: int) -> int:
    if count % (1 << -level):
        rule, repair = f"must be a multiple of {1 << -level} to be coarsened", "Declare more."
        raise InvalidInput("elements", rule, count, repair)
    return count >> -level


def _variable(variable: DesignVariable, scene: Scene, level: int) -> DesignVariable:
    """Return the variable with targets that name the elements where theirs were."""
    factors = {
        new: variable.factor(text)
        for text in variable.targets
        for new in _targets(text, scene, level)
    }
    return replace(variable, targets=factors if variable.shares else tuple(factors))


def _targets(text: str, scene: Scene, level: int) -> list[str]:
    target = parse_target(text)
    if target.element is None or not scene.is_of_elements(target):
        return [text]
    if scene.beam(target.owner).rigid:
        return [text]
    if level < 0:
        rule, repair = "an element of its own", "Leave it out, or take finer meshes only."
        raise InvalidInput(f"design target {text}", rule, "a coarser mesh", repair)
    first = target.element << level
    return [str(replace(target, element=k)) for k in range(first, first + (1 << level))]
