"""Strain energies of elements, batched over elements and times.

With the invariant A and the packed Gram matrix g of the relative node vectors Y
(docs/theory/02-strain-energy.md):

    U = 1/2 dg^T A dg,   dg = g(Y) - g_o,
    force   = W(p) Y,    p = A (dg + tau g'),   g' = dg/dt     (eqs. 13, 17)
    tangent = W(p) (x) I_d + G(Y)^T A (G(Y) + tau G(V))        (eq. 19)
    damping tangent = tau G(Y)^T A G(Y),        G(Y) = dg/dY

Forces and tangents are computed in `ancfdae.kernels`. tau is the retardation time of Kelvin-Voigt
damping, stress = C (E + tau E').

Y and V have shape (..., n, n_y, d): leading axes are times. A has shape (n, n_g, n_g), or (1, n_g,
n_g) when all elements share it. Cables have bending energy in addition, whose stress and second
partials in g are added to p and A (`cable`).
"""

import math

import numpy as np

from ancfdae.kernels import strain
from ancfdae.model.elements import cable
from ancfdae.numerics.arrays import Array


def apply_invariant(A: Array, x: Array) -> Array:
    """Return A x for each element: A of shape (n or 1, n_g, n_g), x of shape (..., n, n_g)."""
    product: Array
    if x.dtype.kind == "c" and A.dtype.kind != "c":
        # One after the other, so that A is not copied.
        product = apply_invariant(A, x.real) + 1j * apply_invariant(A, x.imag)
    elif len(A) == 1:
        product = x @ A[0]
    elif x.ndim == 2:
        product = np.matmul(A, x[..., None])[..., 0]
    else:
        # A is symmetric; one product per element for all times instead of one for each.
        instants = x.reshape(math.prod(x.shape[:-2]), *x.shape[-2:]).swapaxes(0, 1)
        product = np.matmul(instants, A).swapaxes(0, 1).reshape(x.shape)
    return product


def energy(A: Array, g_o: Array, Y: Array, bending: Array | None = None) -> Array:
    """Return the strain energy of each element, (..., n), J, from invariants A and g_o."""
    dg = strain(g_o, Y, None, None)
    U = np.asarray(np.sum(dg * (0.5 * apply_invariant(A, dg)), axis=-1))
    return U if bending is None else U + cable.energy(bending, Y)
