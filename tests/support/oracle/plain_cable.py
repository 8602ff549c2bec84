"""Plain, slow reference for one gradient-deficient cable: the oracle of the tests.

Written from the equations, independently of ``ancfdae``; it must never import it. Functions,
arguments and signs are those of ``plain_ancf``, whose `X_o` and rules are accepted
and not used: a cable is straight. X has the rows [r1, rx1, r2, rx2], r = sum_a s_a X_a.

    U = int 1/2 E h w ((r_x . r_x - 1)/2)^2 + 1/2 E I (a b - c^2)/a^2 dx

with a = r_x . r_x, b = r_xx . r_xx, c = r_x . r_xx: (a b - c^2)/a^2 = |r_x x r_xx|^2/|r_x|^4.
I is w h^3/12 in the plane, in space the mean of that and h w^3/12.
Five Gauss points are exact for the stretch: r_x has degree 2, and the energy is a quartic of it.
Bending takes two.
"""

import numpy as np


def shape(dim, xi, y, z, l):
    """Shape functions s_a, shape (4,)."""
    return np.array(
        [
            1 - 3 * xi**2 + 2 * xi**3,
            l * (xi - 2 * xi**2 + xi**3),
            3 * xi**2 - 2 * xi**3,
            l * (xi**3 - xi**2),
        ]
    )


def shape_gradient(dim, xi, y, z, l):
    """Partials of s_a in x, shape (4, 1)."""
    s_x = [(6 * xi**2 - 6 * xi) / l, 1 - 4 * xi + 3 * xi**2, (6 * xi - 6 * xi**2) / l]
    return np.array([*s_x, 3 * xi**2 - 2 * xi])[:, None]


def shape_curvature(xi, l):
    """Second partials of s_a in x, shape (4,)."""
    return np.array(
        [(12 * xi - 6) / l**2, (6 * xi - 4) / l, (6 - 12 * xi) / l**2, (6 * xi - 2) / l]
    )


def bending(dim, h, w):
    """I over the area."""
    return h**2 / 12 if dim == 2 else (h**2 + w**2) / 24


def points(l, count=5):
    """(xi, weight of dx) of Gauss points."""
    places, weights = np.polynomial.legendre.leggauss(count)
    return [((1 + x) / 2, w * l / 2) for x, w in zip(places, weights, strict=True)]


def quadrature_points(dim, h, w, l, X_o=None, **rule):
    """(s, None, dV) at the Gauss points."""
    return [(shape(2, xi, 0, 0, l), None, h * w * dx) for xi, dx in points(l)]


def energy(X, E, nu, h, w, l, X_o=None, **rule):
    """Elastic energy."""
    U = 0
    for xi, dx in points(l):
        r_x, _ = vectors(X, xi, l)
        U = U + dx * E * h * w * (np.sum(r_x * r_x) - 1) ** 2 / 8
    return U + bending_energy(X, E, h, w, l)


def bending_energy(X, E, h, w, l):
    """The part of curvature."""
    U = 0
    for xi, dx in points(l, 2):
        a, b, c = products(*vectors(X, xi, l))
        U = U + dx * E * h * w * bending(X.shape[1], h, w) * (a * b - c**2) / a**2 / 2
    return U


def vectors(X, xi, l):
    """r_x and r_xx."""
    return shape_gradient(2, xi, 0, 0, l)[:, 0] @ X, shape_curvature(xi, l) @ X


def products(r_x, r_xx):
    return np.sum(r_x * r_x), np.sum(r_xx * r_xx), np.sum(r_x * r_xx)


def force(X, E, nu, h, w, l, X_o=None, **rule):
    """dU/dX."""
    result = 0
    for xi, dx in points(l):
        s_x = shape_gradient(2, xi, 0, 0, l)[:, 0]
        r_x = s_x @ X
        strain = (np.sum(r_x * r_x) - 1) / 2
        result = result + dx * E * h * w * strain * np.outer(s_x, r_x)
    for xi, dx in points(l, 2):
        s_x, s_xx = shape_gradient(2, xi, 0, 0, l)[:, 0], shape_curvature(xi, l)
        r_x, r_xx = vectors(X, xi, l)
        a, b, c = products(r_x, r_xx)
        along = np.outer(s_x, (2 * c**2 / a**3 - b / a**2) * r_x - c / a**2 * r_xx)
        along = along + np.outer(s_xx, r_xx / a - c / a**2 * r_x)
        result = result + dx * E * h * w * bending(X.shape[1], h, w) * along
    return result


def tangent(X, E, nu, h, w, l, X_o=None, **rule):
    """d force / dX by complex steps, shape (4 d, 4 d)."""
    step, columns = 1e-30, []
    for k in range(X.size):
        moved = X.astype(complex)
        moved.flat[k] += 1j * step
        columns.append(force(moved, E, nu, h, w, l).imag.ravel() / step)
    return np.stack(columns, axis=1)


def mass(dim, rho, h, w, l, X_o=None, **rule):
    """Mass matrix, shape (4 d, 4 d)."""
    parts = [rho * dV * np.outer(s, s) for s, _, dV in quadrature_points(2, h, w, l)]
    return np.kron(sum(parts), np.eye(dim))


def gravity_force(g, rho, h, w, l, X_o=None, **rule):
    """Applied force of the acceleration vector g, shape (4, d)."""
    return sum(rho * dV * np.outer(s, np.asarray(g)) for s, _, dV in quadrature_points(2, h, w, l))
