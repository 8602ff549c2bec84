"""Reading a solution, or a run with events, from its file, with the names of its scene."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ancfdae.assembly.layout import (
    BeamLayout,
    BodyLayout,
    JointLayout,
    Layout,
    RigidNodes,
    StatesLayout,
)
from ancfdae.assembly.naming import SceneNaming
from ancfdae.equations import Solution, solution_file
from ancfdae.equations.event_solution import EventRecord, EventSolution
from ancfdae.errors.checks import named, require_each, require_path
from ancfdae.model.elements import ALL_ELEMENTS, BeamElement
from ancfdae.numerics.arrays import Array

_ELEMENT = "element of a solution file"


def load_solution(
    path: str | os.PathLike[str], *, elements: Sequence[BeamElement] = ()
) -> Solution:
    """Return the solution in a file written by `Solution.save`.

    A file holds the names of its elements; pass user-defined elements in `elements`.
    InvalidInputError if the file holds no solution.
    """
    file = require_path("path of a solution", path)
    return Solution(**solution_file.read(file, _naming("load_solution", elements)))


def load_event_solution(
    path: str | os.PathLike[str], *, elements: Sequence[BeamElement] = ()
) -> EventSolution:
    """Return the run with events in a file written by `EventSolution.save`.

    A file holds the names of its elements; pass user-defined elements in `elements`.
    InvalidInputError if the file holds no run with events.
    """
    file, naming = (
        require_path("path of a solution", path),
        _naming("load_event_solution", elements),
    )
    phases, records, outcome = solution_file.read_phases(file, naming)
    events = tuple(EventRecord(**record) for record in records)
    return EventSolution(tuple(Solution(**fields) for fields in phases), events, outcome)


def _naming(call: str, elements: Sequence[BeamElement]) -> solution_file.Unpack:
    """Return a function that makes the naming of a scene from the data in a file."""
    repair = "For example elements=[MY_ELEMENT]."
    known = require_each(f"{call}, elements", elements, (BeamElement,), repair)

    def naming(arrays: Mapping[str, Array], meta: Mapping[str, Any]) -> SceneNaming:
        layout = _layout(meta, (*known, *ALL_ELEMENTS))
        _require_fits(layout, arrays)
        return SceneNaming(layout, arrays["lengths"], arrays["lengths_b"])

    return naming


def _require_fits(layout: Layout, arrays: Mapping[str, Array]) -> None:
    """Raise ValueError unless the states have the coordinates and multipliers of the layout."""
    n_elements, n_vectors = sum(beam.element_count for beam in layout.beams), 0
    for body in layout.bodies:
        if body.first_vector != n_vectors or body.count < len(body.kinks) + body.stride:
            raise ValueError(f"the vectors of {body.name!r}")
        n_vectors += body.count
    for owner in (*layout.sliders, *layout.controllers):
        if owner.first_vector != n_vectors:
            raise ValueError(f"the states of {owner.name!r}")
        n_vectors += len(owner.states)
    first = 0
    for beam in layout.beams:
        fractions, count = np.array(beam.fractions), layout.body(beam.name).count
        good = np.all(np.diff(fractions) > 0) and tuple(fractions[[0, -1]]) == (0, 1)
        nodes = 1 if beam.rigid else beam.element_count + 1
        if not good or beam.first_element != first or count < nodes:
            raise ValueError(f"the elements of {beam.name!r}")
        first += beam.element_count
    rows = max((joint.first_row + joint.rows for joint in layout.joints), default=0)
    lengths, lengths_b = arrays["lengths"], arrays["lengths_b"]
    if len(layout.coordinate_names()) != arrays["q"].shape[1] or n_vectors * layout.d != len(
        layout.coordinate_names()
    ):
        raise ValueError(f"{arrays['q'].shape[1]} coordinates, not those of the layout")
    if rows > arrays["lam"].shape[1]:
        raise ValueError(f"{arrays['lam'].shape[1]} multipliers, not {rows} of the joints")
    if lengths.shape != (n_elements,) or lengths_b.ndim != 2 or len(lengths_b) != n_elements:
        raise ValueError(f"lengths of shape {lengths.shape} for {n_elements} elements")


def _layout(meta: Mapping[str, Any], elements: Sequence[BeamElement]) -> Layout:
    common = meta.get("element_name")
    known = [_element({"element": common} | x, elements) for x in meta["beams"]]
    return Layout(
        d=meta["d"] if common is None else named(_ELEMENT, common, elements).d,
        bodies=tuple(_body(x) for x in meta["bodies"]),
        beams=tuple(_beam(x) for x in known),
        masses=tuple(meta["masses"]),
        joints=tuple(JointLayout(**x) for x in meta["joints"]),
        controllers=tuple(_states(x) for x in meta.get("controllers", ())),
        sliders=tuple(_states(x) for x in meta.get("sliders", ())),
    )


def _element(meta: Mapping[str, Any], elements: Sequence[BeamElement]) -> dict[str, Any]:
    return {**meta, "element": named(_ELEMENT, meta["element"], elements)}


def _body(meta: Mapping[str, Any]) -> BodyLayout:
    return BodyLayout(**{**meta, "kinks": tuple(meta.get("kinks", ()))})


def _states(meta: Mapping[str, Any]) -> StatesLayout:
    return StatesLayout(**{**meta, "states": tuple(meta["states"])})


def _beam(meta: Mapping[str, Any]) -> BeamLayout:
    rigid = meta["rigid"] and RigidNodes(**{x: _tuples(y) for x, y in meta["rigid"].items()})
    return BeamLayout(**{**meta, "fractions": tuple(meta["fractions"]), "rigid": rigid})


def _tuples(nested: Any) -> Any:
    return tuple(map(_tuples, nested)) if isinstance(nested, list) else nested
