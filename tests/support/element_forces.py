"""Forces and tangents of elements in their relative node vectors, from the kernels of a scene.

Each element has node vectors of its own, the first of which is zero: the others are then Y.
"""

import numpy as np

from ancfdae import kernels


def coordinates(Y):
    """Node vectors whose relative ones are Y, (..., n, n_y, d) to (..., n (n_y + 1) d)."""
    n_y = Y.shape[-2]
    second = (n_y + 1) // 2
    order = [*range(1, second), 0, *range(second, n_y)]
    first = np.zeros_like(Y[..., :1, :])
    nodes = np.concatenate([first, Y[..., order, :]], axis=-2)
    return nodes.reshape(*Y.shape[:-3], -1)


def own_block(A, g_o, Y, tau=None, bending=None):
    n, n_y, d = Y.shape[-3:]
    vectors = np.arange(n * (n_y + 1)).reshape(n, n_y + 1)
    return kernels.Block(A, g_o, bending, tau, vectors, d, n * (n_y + 1) * d)


def in_Y(Q, Y):
    """Work on Y of forces on the node vectors; the first one has minus that of the second."""
    n, n_y, d = Y.shape[-3:]
    second = (n_y + 1) // 2
    nodes = Q.reshape(*Q.shape[:-1], n, n_y + 1, d)
    assert np.array_equal(nodes[..., 0, :], -nodes[..., second, :])
    slopes = [a for a in range(n_y + 1) if a not in (0, second)]
    return nodes[..., [second, *slopes], :]


def force(A, g_o, Y, V=None, tau=None, bending=None):
    own = own_block(A, g_o, Y, tau, bending)
    return in_Y(own.forces(coordinates(Y), None if V is None else coordinates(V)), Y)


def force_partial(law, partial, Y, V=None, tau=None):
    """Partials of the forces, of a law (A, g_o, bending) in one variable of all elements."""
    A, g_o, bending = law
    n, states = Y.shape[-3], (coordinates(Y), None if V is None else coordinates(V))
    own = own_block(A, g_o, Y, tau, bending)
    rest_b = np.concatenate([partial.g_o, partial.bending], axis=1)
    pairs = np.zeros(0), np.arange(n + 1), np.arange(n), np.zeros(n, dtype=int)
    rows = own.force_partials(*states, None, (partial.A, rest_b, *pairs), 1)
    return in_Y(rows.reshape(states[0].shape), Y)


def force_rate(A, g_o, Y, V, Z, tau=None, bending=None):
    own = own_block(A, g_o, Y, tau, bending)
    q, v, a = map(coordinates, (Y, V, Z))
    if tau is None:
        return in_Y(own.forces_along(q, None, v[None], None)[0], Y)
    return in_Y(own.forces_along(q, v, v[None], a[None])[0], Y)


def tangent(A, g_o, Y, V=None, tau=None, bending=None):
    return _tangent(own_block(A, g_o, Y, tau, bending), Y, V, False)


def damping_tangent(A, Y, tau):
    g_o = np.zeros((len(A), A.shape[1]))
    return _tangent(own_block(A, g_o, Y, tau), Y, None, True)


def _tangent(own, Y, V, damping):
    n, n_y, d = Y.shape[-3:]
    size, second = (n_y + 1) * d, (n_y + 1) // 2
    index = np.arange(n * size**2, dtype=np.int32).reshape(n, -1)
    v = None if V is None else coordinates(V)
    values = own.tangents(coordinates(Y), v, damping, index, index.size)
    nodes = values.reshape(*Y.shape[:-2], n_y + 1, d, n_y + 1, d)
    kept = [second, *(a for a in range(n_y + 1) if a not in (0, second))]
    K = nodes[..., kept, :, :, :][..., kept, :]
    return K.reshape(*Y.shape[:-2], n_y * d, n_y * d)
