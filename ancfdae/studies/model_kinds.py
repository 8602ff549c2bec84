"""Simpler models of a scene, made by exchanging parts of it.

Those that cost less: bodies that do not deform, elements with fewer coordinates, no damping.
Another strain energy costs the same and is no rung. What needs other parts is given by the
user: a planar scene for a spatial one, masses at points for a beam.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import final

from ancfdae.errors import UnknownName
from ancfdae.model.bodies import BeamBody
from ancfdae.model.design import DesignVariable
from ancfdae.model.elements import ALL_ELEMENTS, BeamElement
from ancfdae.model.material import Material
from ancfdae.model.scene import Scene

#: Name of the richest model.
DECLARED = "as declared"


@final
@dataclass(frozen=True)
class Kind:
    """A simpler model of a scene.

    Attributes
    ----------
    name : str
    build : callable
        Returns the scene, or raises InvalidInput where parts do not go with each other.
    lacks : str
        A parameter of beams that it leaves out.
    """

    name: str
    build: Callable[[], Scene]
    lacks: str = ""


def known_design(
    scene: Scene, design: Sequence[DesignVariable], lacks: str = ""
) -> tuple[DesignVariable, ...]:
    """Return the variables with those of their targets that a scene has, but one parameter."""

    def has(text: str) -> bool:
        try:
            return scene.resolve(text).parameter != lacks
        except UnknownName:
            return False

    rows = [(x, {text: x.factor(text) for text in x.targets if has(text)}) for x in design]
    return tuple(replace(x, targets=kept if x.shares else tuple(kept)) for x, kept in rows if kept)


def model_kinds(scene: Scene, alternatives: Mapping[str, Scene]) -> Iterator[Kind]:
    """Yield simpler models of a scene, then those of the user, last the scene as declared."""
    soft = [beam for beam in scene.beams if not beam.rigid]
    if soft:
        yield Kind("rigid", partial(_exchanged, scene, soft, _rigid))
    for only in soft if len(soft) > 1 else ():
        others = [beam for beam in soft if beam is not only]
        yield Kind(f"only {only.name} deforms", partial(_exchanged, scene, others, _rigid))
    for element in ALL_ELEMENTS:
        richer = [beam for beam in soft if _simplifies(element, beam)]
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


def _simplifies(element: BeamElement, beam: BeamBody) -> bool:
    return element.d == beam.dimension and element.n_s < beam.element.n_s


def _with_element(beam: BeamBody, element: BeamElement) -> BeamBody:
    kinks = beam.kinks if element.can_kink else ()
    return replace(beam, element=element, energy=element.default_energy, kinks=kinks)  # type: ignore[type-var]


def _undamped(beam: BeamBody) -> BeamBody:
    materials = tuple(replace(each, damping_time=0.0) for each in _materials(beam))
    return replace(beam, material=materials)  # type: ignore[type-var]


def _materials(beam: BeamBody) -> Sequence[Material]:
    given = beam.material
    return [given] * beam.element_count if isinstance(given, Material) else given
