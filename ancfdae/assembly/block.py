"""Invariants of all elements of a scene, computed once per distinct element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.assembly.parameters import ParameterMap
from ancfdae.model.bodies import BeamBody
from ancfdae.model.elements import Batch, BeamElement, ElementParameter, ElementType
from ancfdae.model.elements.continuum import joined, prepare, relative_places, widened
from ancfdae.model.elements.element import Invariants
from ancfdae.numerics.arrays import Array


@final
class _PairPartials(NamedTuple):
    """Derivatives of invariants in the design variable of each pair, times its weight.

    A pair is an element with a design variable that drives one of its parameters.
    """

    A_b: Array  # (n_stiffness_pairs, ...)
    rest_b: Array  # (n_stiffness_pairs, n_g + 2): derivatives of g_o and `bending`
    c_b: Array  # (n_stiffness_pairs, ...)
    m_b: Array  # (n_mass_pairs, n_a, n_a)


@final
@dataclass(frozen=True)
class ElementBlock:
    """Invariants of the elements of a scene, and their derivatives per pair.

    A pair is an element with a design variable that drives one of its parameters.
    """

    A: Array  # (n, ...) or (1, ...) when all elements are alike
    g_o: Array  # (n, ...) or (1, ...) when all elements are alike
    bending: Array | None  # (n or 1, 2), as g_o: E I and length of cables; None without cables
    m: Array  # (n, n_a, n_a)
    # (n,): retardation times, s; None if no element is damped and no design variable drives
    # damping.
    tau: Array | None
    # of int: pairs of the `ParameterMap` whose parameter enters A and g_o; then tau; then m.
    stiffness_pairs: Array
    damping_pairs: Array  # of int
    mass_pairs: Array  # of int
    mapping: ParameterMap
    # Invariants of distinct elements, and the index of each element among them, (n,).
    distinct: Invariants
    index: Array

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes to pickle: derivatives instead of the closures that make them."""
        return {**vars(self), "partials": self.partials, "distinct": None}

    @cached_property
    def partials(self) -> _PairPartials:
        """Derivatives of the invariants in the variables of all pairs; computed on first use."""
        mapping, distinct, index = self.mapping, self.distinct, self.index
        stiffness, mass, dtype = self.stiffness_pairs, self.mass_pairs, distinct.A.dtype
        A_b = np.zeros((len(stiffness), *distinct.A.shape[1:]), dtype=dtype)
        c_b = np.zeros((len(stiffness), distinct.A.shape[1]), dtype=dtype)
        rest_b = np.zeros((len(c_b), c_b.shape[1] + 2), dtype=dtype)
        m_b = np.zeros((len(mass), *distinct.m.shape[1:]), dtype=dtype)
        driven = (x for x in mapping.driven() if x is not ElementParameter.DAMPING_TIME)
        for which, its in distinct.partials(driven).items():
            at = mapping.parameters[stiffness] == which
            source = index[mapping.elements[stiffness][at]]
            weight = mapping.weights[stiffness][at]
            A_b[at] = its.A[source] * weight[:, None, None]
            c_b[at] = its.c[source] * weight[:, None]
            rest_b[at, :-2] = its.g_o[source] * weight[:, None]
            rest_b[at, -2:] = its.bending[source] * weight[:, None]
            at = mapping.parameters[mass] == which
            source = index[mapping.elements[mass][at]]
            m_b[at] = its.m[source] * mapping.weights[mass][at][:, None, None]
        return _PairPartials(A_b, rest_b, c_b, m_b)


_COLUMNS = np.arange(len(ElementParameter))
#: Whether the mass is independent of a parameter, by column of `ElementParameter`.
WEIGHTLESS = np.isin(
    _COLUMNS,
    (
        ElementParameter.YOUNGS_MODULUS,
        ElementParameter.POISSON_RATIO,
        ElementParameter.DAMPING_TIME,
        ElementParameter.INITIAL_STRAIN,
    ),
)
# Whether the stiffness is independent of a parameter.
_LIMP = np.isin(_COLUMNS, (ElementParameter.DENSITY, ElementParameter.DAMPING_TIME))


@final
@dataclass(frozen=True, eq=False)
class ElementForms:
    """Data of the elements of some beams that do not depend on design values.

    `element` has the node vectors of all the beams' elements, whose arrays are widened to its size.
    `kind`, (n,), is the index of each element's type in `kinds`; `Y_unit`, (n, n_y, d), are the
    relative node vectors of the reference. `stiffness` and `masses` are the pairs of the `mapping`
    that enter the stiffness and the masses.
    """

    element: BeamElement
    mapping: ParameterMap
    kinds: list[tuple[BeamElement, ElementType]]
    kind: Array
    Y_unit: Array
    owners: Array
    stiffness: Array
    masses: Array

    @staticmethod
    def of(element: BeamElement, beams: Sequence[BeamBody], mapping: ParameterMap) -> ElementForms:
        """Return the forms of the elements of `beams`, in the order of the mapping."""
        kinds, kind = element_kinds(beams)
        Y_unit = np.zeros((len(mapping.base), element.n_y, element.d))
        first = np.cumsum([0, *(beam.element_count for beam in beams)])
        for beam, start, stop in zip(beams, first[:-1], first[1:], strict=True):
            Y_unit[start:stop, relative_places(beam.element, element)] = unit_vectors(beam)
        names = [np.repeat(f"beam {x.name!r}", x.element_count) for x in beams]
        owners = np.concatenate([np.zeros(0, dtype=str), *names])
        stiffness = np.flatnonzero(~_LIMP[mapping.parameters])
        masses = np.flatnonzero(~WEIGHTLESS[mapping.parameters])
        return ElementForms(element, mapping, kinds, kind, Y_unit, owners, stiffness, masses)

    def at(self, b: Array) -> ElementBlock:
        """Prepare the invariants of the elements at design values b."""
        mapping, parameters = self.mapping, self.mapping.values(b)
        damped = ElementParameter.DAMPING_TIME
        distinct, index = self._distinct(parameters)
        # If all elements are equal, arrays have one row; if all differ, they are not copied.
        whole = slice(None) if len(distinct.A) in (1, len(index)) else index
        tau = parameters[:, damped]
        is_damped = bool(np.any(tau != 0)) or damped in mapping.driven()
        return ElementBlock(
            A=distinct.A[whole],
            g_o=distinct.g_o[whole],
            bending=None if distinct.bending is None else distinct.bending[whole],
            m=distinct.m[index],
            tau=tau if is_damped else None,
            stiffness_pairs=self.stiffness,
            damping_pairs=mapping.pairs(damped),
            mass_pairs=self.masses,
            mapping=mapping,
            distinct=distinct,
            index=index,
        )

    def _distinct(self, parameters: Array) -> tuple[Invariants, Array]:
        """Return invariants of elements without duplicates, and each element's index in them."""
        element, kind, Y_unit = self.element, self.kind, self.Y_unit
        if not self.kinds:
            n_g, dtype = element.n_y * (element.n_y + 1) // 2, parameters.dtype
            A, m = np.zeros((0, n_g, n_g), dtype), np.zeros((0, element.n_a, element.n_a), dtype)
            none = Invariants(A, A[:, 0], m, None, lambda _: {})
            return none, np.zeros(0, dtype=np.int64)
        numbers = [parameters.real, parameters.imag, Y_unit.reshape(len(Y_unit), -1), kind[:, None]]
        key = np.concatenate(numbers, axis=1)
        kept, index = np.zeros(1, dtype=np.int64), np.zeros(len(key), dtype=np.int64)
        if np.any(key != key[0]):
            # In their order, so that no array is copied where all elements differ.
            first = dict[bytes, int]()
            rows = [row.tobytes() for row in key]
            for k, row in enumerate(rows):
                first.setdefault(row, k)
            place = dict(zip(first, range(len(first)), strict=True))
            kept, index = np.array(list(first.values())), np.array([place[row] for row in rows])
        order, parts = [], []
        for number, (its, each) in enumerate(self.kinds):
            members = kept[kind[kept] == number]
            order.append(np.flatnonzero(kind[kept] == number))
            same, Y = its.quantities == element.quantities, Y_unit[members]
            Y = Y if same else Y[:, relative_places(its, element)]
            its_own = prepare(its, Batch(each, parameters[members], Y), self.owners[members])
            parts.append(its_own if same else widened(its_own, its, element))
        back = np.argsort(np.concatenate(order)) if len(parts) > 1 else None
        return joined(parts, back), index


def element_kinds(beams: Sequence[BeamBody]) -> tuple[list[tuple[BeamElement, ElementType]], Array]:
    """Return the distinct types of elements, and the index of each element's type, (n,)."""
    kinds: dict[tuple[object, ...], tuple[BeamElement, ElementType]] = {}
    places = []
    for beam in beams:
        kind = beam.element_type()
        key = (beam.element, kind.section.form(), kind.energy, kind.straight)
        kinds.setdefault(key, (beam.element, kind))
        places.append(np.full(beam.element_count, list(kinds).index(key)))
    return list(kinds.values()), np.concatenate([np.zeros(0, dtype=np.int64), *places])


def unit_vectors(beam: BeamBody) -> Array:
    """Return the reference relative node vectors of a beam, (n, n_y, d), chord per unit length.

    The material is isotropic, so a straight element of any orientation has the invariants of an
    element along the x axis; using those makes equal elements equal bit by bit.
    """
    element, shape, n = beam.element, beam.reference(), beam.element_count
    slopes = slice(0, element.n_s - 1)
    if not shape.straight:
        frames = shape.slopes[:, slopes]
        return np.concatenate([shape.chords[:, None], frames[:-1], frames[1:]], axis=1)
    canonical = np.zeros((element.n_y, element.d))
    canonical[0, 0] = 1.0
    canonical[1 : element.n_s] = canonical[element.n_s :] = np.eye(element.d)[slopes]
    return np.repeat(canonical[None], n, axis=0)
