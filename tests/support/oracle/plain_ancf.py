"""Plain, slow reference for one ANCF beam element: the oracle of the tests.

Written from the equations, independently of ``ancfdae``; it must never import it.

Elements (all quantities of ONE element)
    dim = 2: planar shear-deformable beam, 12 dof, nodal vectors r, r_x, r_y; plane strain,
        thickness w.
    dim = 3: spatial fully parameterised beam, 24 dof, nodal vectors r, r_x, r_y, r_z.
Nodal coordinates
    X of shape (n_a, dim), n_a = 6 or 8, rows [r1, rx1, ry1(, rz1), r2, rx2, ry2(, rz2)], so that
    r = sum_a s_a X_a. The flat vector e of the paper is X.ravel(): index a * dim + c;
    N = n_a * dim.
Section
    y in [-h/2, h/2], z in [-w/2, w/2].
Material
    isotropic St. Venant-Kirchhoff; lam is Lame's constant (the paper's kappa), G the shear modulus.
Reference
    X_o, shape (n_a, dim); None is the straight element of length l along the first axis, built from
    l itself, so that a complex l reaches it. With an X_o of your own, give it the part of l (and of
    any other parameter) that it depends on.
Signs
    force is dU/dX = -Q_s, tangent is d force/dX; gravity_force is the applied force Q_e, with g the
    acceleration vector.
Quadrature
    Gauss-Legendre, n_xi x n_y x n_z points. For a straight uniform reference dr_o/dx is constant,
    r_x has degree 2 in xi and 1 in y and z, r_y and r_z degree 1 in xi, and the energy is a quartic
    of them: degree 8 in xi, 4 in y and z. So (5, 3, 3) points, exact to degree (9, 5, 5), integrate
    everything here exactly. For a curved reference the elastic integrand is rational: the result
    depends on the rule, and two codes agree to round-off only with the same points. (The mass of a
    curved spatial element is a polynomial of degree 10 in xi: six points; planar 9: five points.)

Complex numbers pass through X, X_o and every parameter: only + - * / and integer powers are used.
"""

import numpy as np

# ---------------------------------------------------------------- shape functions


def shape(dim, xi, y, z, l):
    """Shape functions s_a, shape (n_a,), in the order of the rows of X; z is ignored if dim = 2."""
    s1 = 1 - 3 * xi**2 + 2 * xi**3
    s2 = l * (xi - 2 * xi**2 + xi**3)
    s3 = y * (1 - xi)
    s4 = z * (1 - xi)
    s5 = 3 * xi**2 - 2 * xi**3
    s6 = l * (-(xi**2) + xi**3)
    s7 = y * xi
    s8 = z * xi
    if dim == 2:
        return np.array([s1, s2, s3, s5, s6, s7])
    return np.array([s1, s2, s3, s4, s5, s6, s7, s8])


def shape_gradient(dim, xi, y, z, l):
    """Partials of s_a in x, y(, z), shape (n_a, dim), with x = xi * l."""
    s1 = [(-6 * xi + 6 * xi**2) / l, 0, 0]
    s2 = [1 - 4 * xi + 3 * xi**2, 0, 0]
    s3 = [-y / l, 1 - xi, 0]
    s4 = [-z / l, 0, 1 - xi]
    s5 = [(6 * xi - 6 * xi**2) / l, 0, 0]
    s6 = [-2 * xi + 3 * xi**2, 0, 0]
    s7 = [y / l, xi, 0]
    s8 = [z / l, 0, xi]
    if dim == 2:
        return np.array([s1, s2, s3, s5, s6, s7])[:, :2]
    return np.array([s1, s2, s3, s4, s5, s6, s7, s8])


# ---------------------------------------------------------------- reference, material, quadrature


def straight_reference(dim, l):
    """Nodal vectors of the straight element of length l from the origin along the first axis."""
    if dim == 2:
        return np.array([[0, 0], [1, 0], [0, 1], [l, 0], [1, 0], [0, 1]]) * 1.0
    frame = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    return np.array([[0, 0, 0], *frame, [l, 0, 0], *frame]) * 1.0


def lame(E, nu):
    """Lame's constant (the paper's kappa) and the shear modulus."""
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


def determinant(A):
    """Determinant of a 2 x 2 or 3 x 3 matrix, written out (numpy's goes through abs and log)."""
    if len(A) == 2:
        return A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    return (
        A[0, 0] * (A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1])
        - A[0, 1] * (A[1, 0] * A[2, 2] - A[1, 2] * A[2, 0])
        + A[0, 2] * (A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0])
    )


def inverse(A):
    """Inverse of a 2 x 2 or 3 x 3 matrix by cofactors."""
    if len(A) == 2:
        return np.array([[A[1, 1], -A[0, 1]], [-A[1, 0], A[0, 0]]]) / determinant(A)
    cofactors = np.empty((3, 3), dtype=A.dtype)
    for i in range(3):
        for j in range(3):
            # Cyclic indices carry the sign of the cofactor.
            i1, i2, j1, j2 = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            cofactors[i, j] = A[i1, j1] * A[i2, j2] - A[i1, j2] * A[i2, j1]
    return cofactors.T / determinant(A)


def quadrature_points(dim, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """List of (s, g, dV) at the Gauss points.

    s : (n_a,) shape functions.
    g : (n_a, dim) partials of s_a in the reference position r_o: g[a, j] = sum_p s_{a, x_p} d x_p /
    d r_oj, eq. (16). dV : weight times volume element det(d r_o / d x) dx dy dz; planar: thickness
    w.
    """
    if X_o is None:
        X_o = straight_reference(dim, l)
    x_points, x_weights = np.polynomial.legendre.leggauss(n_xi)
    y_points, y_weights = np.polynomial.legendre.leggauss(n_y)
    z_points, z_weights = np.polynomial.legendre.leggauss(n_z) if dim == 3 else ([0.0], [2.0])
    points = []
    for x_hat, x_weight in zip(x_points, x_weights, strict=True):
        for y_hat, y_weight in zip(y_points, y_weights, strict=True):
            for z_hat, z_weight in zip(z_points, z_weights, strict=True):
                xi, y, z = (1 + x_hat) / 2, y_hat * h / 2, z_hat * w / 2
                s_x = shape_gradient(dim, xi, y, z, l)
                dr_o_dx = X_o.T @ s_x  # [c, p] = d r_oc / d x_p
                g = s_x @ inverse(dr_o_dx)
                dV = (
                    determinant(dr_o_dx)
                    * (x_weight * l / 2)
                    * (y_weight * h / 2)
                    * (z_weight * w / 2)
                )
                points.append((shape(dim, xi, y, z, l), g, dV))
    return points


# ---------------------------------------------------------------- elastic energy, force, tangent


def strain(X, g):
    """Deformation gradient F[c, j] = d r_c / d r_oj and Green-Lagrange strain (F^T F - I) / 2."""
    F = X.T @ g
    return F, (F.T @ F - np.eye(X.shape[1])) / 2


def second_piola_kirchhoff(strain_matrix, lam, G):
    """Stress lam tr(strain) I + 2 G strain; planar: its in-plane part in plane strain."""
    return lam * np.trace(strain_matrix) * np.eye(len(strain_matrix)) + 2 * G * strain_matrix


def energy(X, E, nu, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """Elastic energy U = int lam/2 tr(strain)^2 + G strain : strain dV."""
    lam, G = lame(E, nu)
    U = 0
    for _, g, dV in quadrature_points(X.shape[1], h, w, l, X_o, n_xi, n_y, n_z):
        _, strain_matrix = strain(X, g)
        U = U + dV * (
            lam / 2 * np.trace(strain_matrix) ** 2 + G * np.sum(strain_matrix * strain_matrix)
        )
    return U


def force(X, E, nu, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """Weak form dU/dX, shape (n_a, dim); the paper's Q_s is minus this.

    force[a, c] = int F[c, k] S[k, j] g[a, j] dV.
    """
    lam, G = lame(E, nu)
    result = 0
    for _, g, dV in quadrature_points(X.shape[1], h, w, l, X_o, n_xi, n_y, n_z):
        F, strain_matrix = strain(X, g)
        S = second_piola_kirchhoff(strain_matrix, lam, G)
        result = result + dV * (g @ S @ F.T)
    return result


def tangent(X, E, nu, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """d force / dX, shape (N, N), by linearising F and the stress at every quadrature point.

    Moving X[b, c] changes F by dF[c, :] = g[b, :], the strain by sym(F^T dF), and the stress
    linearly with the strain.
    """
    lam, G = lame(E, nu)
    n_a, dim = X.shape
    result = 0
    for _, g, dV in quadrature_points(dim, h, w, l, X_o, n_xi, n_y, n_z):
        F, strain_matrix = strain(X, g)
        S = second_piola_kirchhoff(strain_matrix, lam, G)
        columns = []
        for b in range(n_a):
            for c in range(dim):
                dF = np.zeros_like(F)
                dF[c, :] = g[b, :]
                dstrain = (F.T @ dF + dF.T @ F) / 2
                dS = second_piola_kirchhoff(dstrain, lam, G)
                columns.append((g @ S @ dF.T + g @ dS @ F.T).ravel())
        result = result + dV * np.array(columns).T
    return result


# ---------------------------------------------------------------- inertia and gravity


def mass(dim, rho, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """Mass matrix of eq. (10), shape (N, N): (int rho s s^T dV) kron I."""
    scalar = 0
    for s, _, dV in quadrature_points(dim, h, w, l, X_o, n_xi, n_y, n_z):
        scalar = scalar + rho * dV * np.outer(s, s)
    return np.kron(scalar, np.eye(dim))


def gravity_force(g, rho, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """Applied force of the acceleration vector g, shape (n_a, dim): int rho s_a g dV.

    Eq. (12) is g = (0, -g) and a straight element.
    """
    g = np.asarray(g)
    result = 0
    for s, _, dV in quadrature_points(len(g), h, w, l, X_o, n_xi, n_y, n_z):
        result = result + rho * dV * np.outer(s, g)
    return result


# ------------------------------------------------ the paper's invariant matrices, eqs. (13)-(19)
#
# With r_j = S_{,j} e (column j of F), C_ij = r_i . r_j and d = dim, the energy density is
#     lam/8 (tr C - d)^2 + G/4 (C : C - 2 tr C + d),
# and its derivative in e is
#     [lam/2 (tr C - d) - G] sum_i S_{,i}^T r_i  +  G sum_ij C_ij S_{,i}^T r_j.
# The part without C is K_1 e with the coefficient -(d lam + 2 G)/2:
#     d = 2: -(kappa + G), eq. (15);      d = 3: -(3 kappa + 2 G)/2.
# The part with C is K_2 e:
#     i = j: kappa/2 + G = (kappa + 2 G)/2 times S_{,i}^T r_i (r_i . r_i);
#     every pair i < j: kappa/2 [S_{,i}^T r_i (r_j . r_j) + S_{,j}^T r_j (r_i . r_i)]
#                       + G (r_i . r_j) [S_{,i}^T r_j + S_{,j}^T r_i],
# which is eq. (14) with one more direction and two more pairs.


def paper_S(g):
    """List of the matrices S_{,j} of eq. (16), each (dim, N): S_{,j}[c, a * dim + c] = g[a, j]."""
    dim = g.shape[1]
    return [np.kron(g[:, j], np.eye(dim)) for j in range(dim)]


def paper_tensors(dim, E, nu, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """K_1 of eq. (15), shape (N, N), and C_K2 of eq. (18), shape (N, N, N, N), indexed [i, j, m,
    n].

    In eq. (18) (A)_i is row i of A, so (A)_i^T (B)_j is the N x N matrix A[i, m] B[j, n].
    """
    kappa, G = lame(E, nu)
    K_1 = 0
    C_K2 = 0

    def product(A, B):
        return np.einsum("im,jn->ijmn", A, B)

    for _, g, dV in quadrature_points(dim, h, w, l, X_o, n_xi, n_y, n_z):
        S = paper_S(g)
        for j in range(dim):
            S_jj = S[j].T @ S[j]
            K_1 = K_1 - dV * (dim * kappa + 2 * G) / 2 * S_jj
            C_K2 = C_K2 + dV * (kappa + 2 * G) / 2 * product(S_jj, S_jj)
        for p in range(dim):
            for q in range(p + 1, dim):
                S_pp, S_qq = S[p].T @ S[p], S[q].T @ S[q]
                S_pq, S_qp = S[p].T @ S[q], S[q].T @ S[p]
                C_K2 = C_K2 + dV * kappa / 2 * (product(S_pp, S_qq) + product(S_qq, S_pp))
                C_K2 = C_K2 + dV * G * (product(S_pq, S_qp) + product(S_qp, S_pq))
    return K_1, C_K2


def paper_K_2(X, C_K2):
    """K_2 by eq. (17): K_2[i, j] = e^T C_K2[i, j] e."""
    e = X.ravel()
    return np.einsum("m,ijmn,n->ij", e, C_K2, e)


def paper_K_2_eq14(X, E, nu, h, w, l, X_o=None, n_xi=5, n_y=3, n_z=3):
    """K_2 by eq. (14).

    Not the matrix of eqs. (17) and (18), whose last product differs; K_2 e is the same.
    """
    kappa, G = lame(E, nu)
    dim = X.shape[1]
    ee = np.outer(X.ravel(), X.ravel())
    K_2 = 0
    for _, g, dV in quadrature_points(dim, h, w, l, X_o, n_xi, n_y, n_z):
        S = paper_S(g)
        for j in range(dim):
            S_jj = S[j].T @ S[j]
            K_2 = K_2 + dV * (kappa + 2 * G) / 2 * (S_jj @ ee @ S_jj)
        for p in range(dim):
            for q in range(p + 1, dim):
                S_pp, S_qq = S[p].T @ S[p], S[q].T @ S[q]
                S_pq, S_qp = S[p].T @ S[q], S[q].T @ S[p]
                K_2 = K_2 + dV * kappa / 2 * (S_pp @ ee @ S_qq + S_qq @ ee @ S_pp)
                K_2 = K_2 + dV * G * (S_pq @ ee @ S_qp + S_qp @ ee @ S_pq)
    return K_2


def paper_force(X, K_1, C_K2):
    """(K_2 + K_1) e of eq. (13) with eq. (17), shape of X; minus the paper's Q_s."""
    return ((paper_K_2(X, C_K2) + K_1) @ X.ravel()).reshape(X.shape)


def paper_tangent(X, K_1, C_K2):
    """Minus the right-hand side of eq. (19), shape (N, N): d[(K_2 + K_1) e]_i / d e_k."""
    e = X.ravel()
    last = np.einsum("m,ijmk,j->ik", e, C_K2, e) + np.einsum("m,ijkm,j->ik", e, C_K2, e)
    return paper_K_2(X, C_K2) + K_1 + last


# ---------------------------------------------------------------- states


def random_rotation(dim, rng):
    """Proper rotation: a random angle, in space about a random axis (Rodrigues)."""
    angle = rng.uniform(-np.pi, np.pi)
    if dim == 2:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    axis = rng.standard_normal(3)
    axis = axis / np.sqrt(np.sum(axis * axis))
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def random_state(dim, rng, l, X_o=None, distortion=0.1):
    """Reference rotated and shifted by up to l, then distorted at random.

    Slopes move by up to distortion, positions by up to distortion * l.
    """
    if X_o is None:
        X_o = straight_reference(dim, l)
    X = X_o @ random_rotation(dim, rng).T
    X[[0, len(X) // 2]] += rng.uniform(-l, l, dim)
    scale = np.full((len(X), 1), distortion)
    scale[[0, len(X) // 2]] *= l
    return X + scale * rng.uniform(-1, 1, X.shape)
