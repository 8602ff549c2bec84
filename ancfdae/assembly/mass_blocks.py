"""What has mass: elements, rigid bodies, rigid beams and point masses, as blocks on vectors.

With vectors X of a body each of them has the kinetic energy 1/2 sum_ij m_ij X_i' . X_j', so that
the mass matrix is the sum of m (x) I_d over all blocks (docs/theory/03-joints-and-loads.md):

    element       m = int rho s s^T dV_o
    rigid body    m = int [1, x] [1, x]^T dm, x the place in the axes of the body
    rigid beam    m = sum over its elements of W^T m_e W, with node vectors W (frame of the body)
    point mass    m = mass w w^T, with position sum_a w_a X_a
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.block import ElementBlock, element_block
from ancfdae.assembly.layout import BeamLayout
from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.model.bodies import BeamBody, Quantity, RigidBody
from ancfdae.model.elements import ElementParameter
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import STEP, Array


@final
@dataclass(frozen=True)
class MassBlocks:
    """Masses of n things of k vectors each, and their design derivatives pair by pair.

    Attributes
    ----------
    vectors : array of int, shape (n, k)
    m : array, shape (n, k, k)
    owners : array of int, shape (n,)
        What each belongs to: place among the bodies of the scene, then its point masses.
    pair_block, pair_variable : array of int, shape (n_pairs,)
    m_b : array, shape (n_pairs, k, k)
        Derivative of the block of each pair in its design variable.
    """

    vectors: Array
    m: Array
    owners: Array
    pair_block: Array
    pair_variable: Array
    m_b: Array

    def chosen(self, owner: int | None) -> Array:
        """One for the blocks of an owner, or for all, shape (n,)."""
        return np.ones(len(self.m)) if owner is None else (self.owners == owner).astype(float)


def element_masses(numbering: Numbering, mapping: ParameterMap, block: ElementBlock) -> MassBlocks:
    """Return the masses of the elements that deform; `mapping` is that of these elements."""
    pairs = block.mass_pairs
    return MassBlocks(
        vectors=numbering.vectors,
        m=block.m,
        owners=numbering.owners,
        pair_block=mapping.elements[pairs],
        pair_variable=mapping.variables[pairs],
        m_b=block.m_b,
    )


def other_masses(
    scene: Scene, naming: SceneNaming, mapping: ParameterMap, b: Array
) -> tuple[MassBlocks, ...]:
    """Return the masses of all that is rigid, and of points."""
    layout, single = naming.layout, list[_Single]()
    for owner, member in enumerate(scene.members):
        vectors = layout.bodies[owner].vectors
        if isinstance(member, RigidBody):
            single.append(_Single(vectors, owner, *_of_body(member, mapping, b)))
        elif member.rigid:
            masses = _of_rigid_beam(member, layout.beam(member.name), mapping, b)
            single.append(_Single(vectors, owner, *masses))
    for owner, mass in enumerate(scene.point_masses, start=len(scene.members)):
        p, p_b = mapping.numbers(mass.name, b)
        at = naming.vector(mass.point, Quantity.POSITION, (p[1:], p_b[1:]))
        w, w_b = at.weights, at.weights_b.T
        # The product rule for p w w^T.
        once = p[0] * w_b[:, :, None] * w
        m_b = p_b[0][:, None, None] * np.outer(w, w) + once + once.transpose(0, 2, 1)
        single.append(_Single(at.vectors, owner, p[0] * np.outer(w, w), m_b))
    sizes = sorted({len(each.vectors) for each in single})
    return tuple(_together([x for x in single if len(x.vectors) == size]) for size in sizes)


@final
@dataclass(frozen=True)
class _Single:
    """One block, with its derivatives with respect to all design variables, shape (n_b, k, k)."""

    vectors: Array
    owner: int
    m: Array
    m_b: Array


def _together(blocks: Sequence[_Single]) -> MassBlocks:
    m_b = np.stack([each.m_b for each in blocks])
    pairs = np.nonzero(np.any(m_b != 0, axis=(2, 3)))
    return MassBlocks(
        vectors=np.stack([each.vectors for each in blocks]),
        m=np.stack([each.m for each in blocks]),
        owners=np.array([each.owner for each in blocks]),
        pair_block=pairs[0],
        pair_variable=pairs[1],
        m_b=m_b[pairs],
    )


def _of_body(body: RigidBody, mapping: ParameterMap, b: Array) -> tuple[Array, Array]:
    """Return m and m_b, a closed form of a few numbers that is differentiated by complex steps."""
    p, p_b = mapping.numbers(body.name, b)
    m = body.moments(p)
    m_b = np.zeros((len(b), *m.shape))
    for i in np.flatnonzero(np.any(p_b, axis=0)):
        m_b[i] = body.moments(p.real + 1j * STEP * p_b[:, i]).imag / STEP
    return m, m_b


def _of_rigid_beam(
    beam: BeamBody, place: BeamLayout, mapping: ParameterMap, b: Array
) -> tuple[Array, Array]:
    """Return m = sum of W^T m_e W and m_b: by m_e, and by the lengths in W."""
    rows = np.arange(place.elements.start, place.elements.stop)
    driven, element, nodes = mapping.only(rows), beam.element, place.rigid
    assert nodes is not None
    block = element_block(element, [beam], driven, driven.values(b))
    lengths = driven.values(b)[:, ElementParameter.LENGTH]
    W = nodes.weights(lengths, element.n_s)
    W_e = np.concatenate([W[:-1], W[1:]], axis=1)  # of the nodes of each element
    m = np.einsum("nai,nab,nbj->ij", W_e, block.m, W_e, optimize=True)
    m_b = np.zeros((len(b), *m.shape), dtype=m.dtype)
    at, variables = driven.elements[block.mass_pairs], driven.variables[block.mass_pairs]
    products = np.einsum("pai,pab,pbj->pij", W_e[at], block.m_b, W_e[at], optimize=True)
    np.add.at(m_b, variables, products)
    moved = nodes.positions_b(driven.lengths_b(len(b)))
    momenta = block.m @ W_e
    for first, node in ((0, slice(None, -1)), (element.n_s, slice(1, None))):
        change = np.einsum("ndb,nj->bdj", moved[node], momenta[:, first])
        m_b[:, 1:] += change
        m_b[:, :, 1:] += change.transpose(0, 2, 1)
    return m, m_b
