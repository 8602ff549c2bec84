"""Constraint rows of all joints at once: Phi = B q - c, with design derivatives.

A position or slope vector of a material point is a fixed combination of the
node vectors of its element, so joints that equate such vectors are linear in
q. Away from the nodes the combination depends on the element length, which
gives Phi_b and (Phi_q^T lam)_b.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy import sparse

from ancfdae.joints import Term
from ancfdae.layout import JointLayout, vector_weights
from ancfdae.numerics.arrays import Array
from ancfdae.scene import Scene
from ancfdae.system.numbering import Numbering
from ancfdae.system.reference import StartState


@final
@dataclass(frozen=True)
class LinearConstraints:
    """Rows of Phi = B q - c.

    Attributes
    ----------
    rows, columns : array of int; values : array
        Entries of B.
    c : array, shape (n_lam,)
    c_b : array, shape (n_lam, n_b)
    B_b : sparse array, shape (n_lam n_b, n_q)
        (B x)_b = (B_b x).reshape(n_lam, n_b) with x held.
    B_bT : sparse array, shape (n_q n_b, n_lam)
        (B^T y)_b = (B_bT y).reshape(n_q, n_b) with y held.
    joints : tuple of JointLayout
    """

    rows: Array
    columns: Array
    values: Array
    c: Array
    c_b: Array
    B_b: sparse.csr_array
    B_bT: sparse.csr_array
    joints: tuple[JointLayout, ...]


def linear_constraints(
    scene: Scene, numbering: Numbering, start: StartState, lengths: Array, lengths_b: Array
) -> LinearConstraints:
    """Collect the rows of all joints."""
    d, n_q, n_b = numbering.element.d, numbering.n_q, lengths_b.shape[1]
    entries: list[_Entries] = []
    joints, given, from_reference, row = [], [], [], 0
    for joint in scene.joints:
        first = row
        for equation in joint.equations(d):
            entries += [_term_entries(term, row, numbering, lengths) for term in equation.terms]
            given.append(np.zeros(d) if equation.value is None else np.asarray(equation.value))
            from_reference.append(np.full(d, equation.value is None))
            row += d
        joints.append(JointLayout(joint.name, first, row - first))
    rows, columns, values, values_l, owners = _join(entries, lengths.dtype)
    B = sparse.csr_array((values, (rows, columns)), shape=(row, n_q))
    # Row-major pairs (row, variable) and (column, variable) of the length derivative of B.
    variable = np.tile(np.arange(n_b), len(rows))
    weight = (values_l[:, None] * lengths_b[owners]).ravel()
    keep = weight != 0
    row_b = (np.repeat(rows, n_b) * n_b + variable)[keep]
    column_b = (np.repeat(columns, n_b) * n_b + variable)[keep]
    B_b = sparse.csr_array(
        (weight[keep], (row_b, np.repeat(columns, n_b)[keep])), shape=(row * n_b, n_q)
    )
    B_bT = sparse.csr_array(
        (weight[keep], (column_b, np.repeat(rows, n_b)[keep])), shape=(n_q * n_b, row)
    )
    reference = np.concatenate([*from_reference, np.zeros(0, dtype=bool)])
    c = np.concatenate([*given, np.zeros(0)]).astype(lengths.dtype)
    c = np.where(reference, B @ start.q_reference, c)
    c_reference_b = (B_b @ start.q_reference).reshape(row, n_b) + B @ start.q_reference_b
    c_b = np.where(reference[:, None], c_reference_b, 0.0)
    return LinearConstraints(rows, columns, values, c, c_b, B_b, B_bT, tuple(joints))


@final
@dataclass(frozen=True)
class _Entries:
    rows: Array
    columns: Array
    values: Array
    values_l: Array
    owners: Array


def _term_entries(term: Term, row: int, numbering: Numbering, lengths: Array) -> _Entries:
    d = numbering.element.d
    beam = next(beam for beam in numbering.beams if beam.name == term.point.beam)
    local, xi = beam.locate(term.point.fraction)
    element = beam.first_element + local
    s, s_l = vector_weights(
        numbering.element, term.quantity, xi, term.point.y, term.point.z, lengths[element]
    )
    used = (s != 0) | (s_l != 0)
    columns = numbering.coordinates(numbering.vectors[element][used])
    count = columns.size
    return _Entries(
        rows=np.broadcast_to(row + np.arange(d), columns.shape).ravel(),
        columns=columns.ravel(),
        values=np.repeat(term.coefficient * s[used], d),
        values_l=np.repeat(term.coefficient * s_l[used], d),
        owners=np.full(count, element),
    )


def _join(entries: list[_Entries], dtype: np.dtype) -> tuple[Array, Array, Array, Array, Array]:
    whole, number = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=dtype)
    return (
        np.concatenate([e.rows for e in entries] or [whole]),
        np.concatenate([e.columns for e in entries] or [whole]),
        np.concatenate([e.values for e in entries] or [number]),
        np.concatenate([e.values_l for e in entries] or [number]),
        np.concatenate([e.owners for e in entries] or [whole]),
    )
