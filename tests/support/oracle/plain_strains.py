"""Strain energy of one element as docs/theory/02-strain-energy.md, defines it in vectors.

Nothing is packed, scaled or precomputed: the strains are those of the position field at each point
in metres, for node vectors Y = [r_2 - r_1, slopes of node 1, slopes of node 2].
"""

import numpy as np


def curve(Y, xi, l):
    """Return r_x and r_xx of the axis."""
    d = Y.shape[1]
    chord, t_1, t_2 = Y[0], Y[1], Y[1 + d]
    r_x = 6 * xi * (1 - xi) / l * chord + (1 - xi) * (1 - 3 * xi) * t_1 + xi * (3 * xi - 2) * t_2
    r_xx = ((6 - 12 * xi) / l * chord + (6 * xi - 4) * t_1 + (6 * xi - 2) * t_2) / l
    return r_x, r_xx


def section_slopes(Y, xi, l):
    """Return the section slopes and their derivatives, one row per axis of the section."""
    d = Y.shape[1]
    first, second = Y[2 : 1 + d], Y[2 + d :]
    return (1 - xi) * first + xi * second, (second - first) / l


def products(Y, xi, l, assumed, waves, fade):
    """Return r_x.r_x, b_i.r_x, b_i.b_j, c_i.r_x, c_i.b_j, c_i.c_j and the squared turns."""
    d = Y.shape[1]
    r_x, r_xx = curve(Y, xi, l)
    c, b = section_slopes(Y, xi, l)
    bending, shear, slopes, thickness, turns = b @ r_x, c @ r_x, c @ b.T, c @ c.T, np.zeros(0)
    if assumed:
        ends = [(section_slopes(Y, x, l)[0], curve(Y, x, l)[0]) for x in (0.0, 1.0)]
        S = [slopes @ tangent for slopes, tangent in ends]
        t = [slopes @ slopes.T for slopes, _ in ends]
        shear, thickness = (1 - xi) * S[0] + xi * S[1], (1 - xi) * t[0] + xi * t[1]
        middle, c_m = curve(Y, 0.5, l)[1], section_slopes(Y, 0.5, l)[0]
        mean = b @ Y[0] / l
        turned = (c - c_m) @ middle
        bending = mean + waves * ((S[1] - S[0]) / l - c @ r_xx + turned - mean) - fade * turned
        slopes = 0.5 * ((t[1] - t[0]) / l + c @ b.T - b @ c.T)
        bent = middle @ middle
        if d == 2:
            turns = np.array([0.5 * (bent + b[0] @ b[0])])
        else:
            y_turn, z_turn = b[0] @ b[0], b[1] @ b[1]
            turns = 0.5 * np.array(
                [bent + y_turn - z_turn, bent - y_turn + z_turn, y_turn + z_turn - bent]
            )
    return r_x @ r_x, bending, b @ b.T, shear, slopes, thickness, turns


def section_axes(J):
    """Rows: normal of the section, r_y, what is across both."""
    r_y = J[:, 1] / np.linalg.norm(J[:, 1])
    if len(J) == 2:
        return np.array([[r_y[1], -r_y[0]], r_y])
    normal = np.cross(r_y, J[:, 2])
    normal /= np.linalg.norm(normal)
    return np.array([normal, r_y, np.cross(normal, r_y)])


def gradient(Y, xi, y, z, l):
    """Position gradient dr/dx, one column per coordinate."""
    c, b = section_slopes(Y, xi, l)
    columns = [curve(Y, xi, l)[0] + (y, z)[: len(b)] @ b, *c]
    return np.stack(columns, axis=1)


def energy(Y, Y_o, l, points, law):
    """Strain energy of one element; `law` holds E, nu, factors, radii and three choices."""
    d = Y.shape[1]
    G = law["E"] / (2 * (1 + law["nu"]))
    plain = np.diag([law["E"]] * d + [G] * (d * (d - 1) // 2))
    full = lame(d, law["E"], law["nu"])
    nodes, weights = np.polynomial.legendre.leggauss(5 if law["straight"] else 12)
    U = 0.0
    for x, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        for y, z, dA in points:
            eps, turns, det_J = strain(Y, Y_o, x, y, z, l, law)
            U += 0.5 * weight * dA * l * det_J * (eps @ plain @ eps)
            share = 1.0 if law["straight"] else 7 / 8
            stiff = share * np.array([law["E"] / 6] * (d - 1) + [G / 3] * (d - 2))
            U += 0.5 * weight * dA * l * det_J * (turns @ (stiff[: len(turns)] * turns))
    area = sum(dA for _, _, dA in points)
    y_c, z_c = (sum(point[k] * point[2] for point in points) / area for k in (0, 1))
    for x in (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)):
        eps, _, det_J = strain(Y, Y_o, x, y_c, z_c, l, law)
        U += 0.25 * area * l * det_J * (eps @ (full - plain) @ eps)
    return U


def lame(d, E, nu):
    """Hooke's law, in the plane without stress across it."""
    kappa = E * nu / ((1 + nu) * (1 - 2 * nu)) if d == 3 else E * nu / (1 - nu**2)
    G = E / (2 * (1 + nu))
    C = np.diag([2 * G] * d + [G] * (d * (d - 1) // 2))
    C[:d, :d] += kappa
    return C


def strain(Y, Y_o, xi, y, z, l, law):
    """Return strains with engineering shears in the axes of the section, turns and det J_o."""
    d = Y.shape[1]
    offset, m = np.array([y, z])[: d - 1], d - 1
    shears = np.asarray(law["factors"][:m])
    waves, given = np.ones(m), 1.0
    fade = 1 / (1 + (np.asarray(law["radii"])[:m] / l) ** 4)
    if law["assumed"]:
        # A hundredth of the compliance of shear acts between chord and tangents.
        given, E_G = 0.99, 2 * (1 + law["nu"])
        waves /= np.sqrt(1 + 0.12 * E_G * (np.asarray(law["radii"])[:m] / l / shears) ** 2)
    (stretch, bending, squares, shear, slopes, thick, turns), at_rest = (
        products(X, xi, l, law["assumed"], waves, fade) for X in (Y, Y_o)
    )
    stretch_o, bending_o, squares_o, shear_o, slopes_o, thick_o, turns_o = at_rest
    J = gradient(Y_o, xi, y, z, l)
    J = section_axes(J) @ J if not law["straight"] else np.eye(d)
    # Components of r_ox and the b_oj along the normal, r_oy(, r_oz): what the reference has across
    # the normal moves with r_y(, r_z) as strains vanish.
    c_o, b_o = section_slopes(Y_o, xi, l)
    frame = np.column_stack([section_axes(gradient(Y_o, xi, 0, 0, l))[0], *c_o])
    r_across = np.linalg.solve(frame, curve(Y_o, xi, l)[0])[1:]
    b_across = np.linalg.solve(frame, b_o.T)[1:].T
    if law["straight"]:
        r_across, b_across = 0 * r_across, 0 * b_across
    g = shear - shear_o - (thick - thick_o) @ r_across
    G = slopes - slopes_o - (thick - thick_o) @ b_across.T
    change = np.zeros((d, d))
    change[0, 0] = stretch - stretch_o + 2 * offset @ (bending - bending_o)
    change[0, 0] += offset @ (squares - squares_o) @ offset
    change[1:, 1:] = thick - thick_o
    radii = np.asarray(law["radii"])
    if law["straight"] and len(turns):
        short = 1 + (radii[:m] / l) ** 4
        change[0, 0] -= 3 * radii[:m] ** 2 / short @ (turns - turns_o)[:m]
    greens = []
    for power in (1, 2):
        k = np.asarray(law["factors"]) ** power
        twist = np.where(np.eye(m) == 1, 1.0, k[2])
        centre, shear_centre = (np.asarray(law[name])[:m] for name in ("centroid", "shear_centre"))
        shear = k[:m] / given ** (power / 2)
        h = shear * (g + G @ shear_centre) + (twist * G) @ (offset - centre)
        # The metric of which the fibre has these shears.
        change[0, 1:] = change[1:, 0] = h + change[1:, 1:] @ (r_across + offset @ b_across)
        inverse = np.linalg.inv(J)
        greens.append(0.5 * inverse.T @ change @ inverse)
    green = greens[0]
    green[0, 0] = greens[1][0, 0]
    shears = [(0, 1)] if d == 2 else [(1, 2), (0, 2), (0, 1)]
    eps = np.append(np.diag(green), [2 * green[i, j] for i, j in shears])
    return eps, l * radii[: len(turns)] * (turns - turns_o), np.linalg.det(J)
