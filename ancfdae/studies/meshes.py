"""A scene with other meshes or simpler models, with equivalent design variables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import final

from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.model.bodies import BeamBody
from ancfdae.model.design import DesignVariable, parse_target
from ancfdae.model.elements import ALL_ELEMENTS, BeamElement
from ancfdae.model.material import Material
from ancfdae.model.scene import Scene


def with_mesh(
    scene: Scene, design: Sequence[DesignVariable], level: int
) -> tuple[Scene, tuple[DesignVariable, ...]]:
    """Return a scene with 2^level times the elements, and the equivalent design variables.

    Raises
    ------
    InvalidInputError
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
    """Return the lowest level, at least -2, at which every beam has whole elements."""
    counts = [beam.element_count for beam in scene.beams if not beam.rigid]
    return min(level for level in (0, -1, -2) if all(n % (1 << -level) == 0 for n in counts))


def _fewer(count: int, level: int) -> int:
    if count % (1 << -level):
        rule, repair = (
            f"must be a multiple of {1 << -level} to be coarsened",
            "Declare a finer mesh.",
        )
        raise InvalidInputError("elements", rule, count, repair)
    return count >> -level


def _variable(variable: DesignVariable, scene: Scene, level: int) -> DesignVariable:
    """Return the design variable with targets for the elements that replace its elements."""
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
        raise InvalidInputError(f"design target {text}", rule, "a coarser mesh", repair)
    first = target.element << level
    return [str(replace(target, element=k)) for k in range(first, first + (1 << level))]


#: Name of the richest model.
DECLARED = "as declared"


@final
@dataclass(frozen=True)
class Kind:
    """A kind of model of a scene, for example with rigid beams.

    Attributes
    ----------
    name : str
    build : callable
        Returns the scene, or raises InvalidInputError if its parts do not fit together.
    lacks : str
        A parameter of beams that the model does not have.
    """

    name: str
    build: Callable[[], Scene]
    lacks: str = ""


def known_design(
    scene: Scene, design: Sequence[DesignVariable], lacks: str = ""
) -> tuple[DesignVariable, ...]:
    """Return the variables with the targets that a scene has, without the parameter `lacks`."""

    def has(text: str) -> bool:
        try:
            return scene.resolve(text).parameter != lacks
        except UnknownNameError:
            return False

    rows = [(x, {text: x.factor(text) for text in x.targets if has(text)}) for x in design]
    return tuple(replace(x, targets=kept if x.shares else tuple(kept)) for x, kept in rows if kept)


def model_kinds(scene: Scene, alternatives: Mapping[str, Scene]) -> Iterator[Kind]:
    """Yield simpler models of a scene, then the models of the user, last the declared scene."""
    soft = [beam for beam in scene.beams if not beam.rigid]
    if soft:
        yield Kind("rigid", partial(_exchanged, scene, soft, _rigid))
    for only in soft if len(soft) > 1 else ():
        others = [beam for beam in soft if beam is not only]
        yield Kind(f"only {only.name} deforms", partial(_exchanged, scene, others, _rigid))
    for element in ALL_ELEMENTS:
        fitting = [beam for beam in soft if beam.dimension == element.d]
        richer = [beam for beam in fitting if beam.element.n_s > element.n_s]
        if richer:
            modelled = partial(_with_element, element=element)
            yield Kind(f"all {element.name}", partial(_exchanged, scene, richer, modelled))
    damped = [beam for beam in soft if any(x.damping_time for x in _materials(beam))]
    if damped:
        yield Kind("undamped", partial(_exchanged, scene, damped, _undamped), "damping_time")
    for name, other in alternatives.items():
        yield Kind(name, partial(replace, other))
    yield Kind(DECLARED, partial(replace, scene))


def _exchanged(
    scene: Scene, beams: Sequence[BeamBody], new: Callable[[BeamBody], BeamBody]
) -> Scene:
    names = [beam.name for beam in beams]
    return replace(scene, beams=[new(x) if x.name in names else x for x in scene.beams])


def _rigid(beam: BeamBody) -> BeamBody:
    return replace(beam, rigid=True, initial_strain=0.0)  # type: ignore[type-var]


def _with_element(beam: BeamBody, element: BeamElement) -> BeamBody:
    kinks = beam.kinks if element.can_kink else ()
    return replace(beam, element=element, energy=element.default_energy, kinks=kinks)  # type: ignore[type-var]


def _undamped(beam: BeamBody) -> BeamBody:
    materials = tuple(replace(each, damping_time=0.0) for each in _materials(beam))
    return replace(beam, material=materials)  # type: ignore[type-var]


def _materials(beam: BeamBody) -> Sequence[Material]:
    given = beam.material
    return [given] * beam.element_count if isinstance(given, Material) else given
