"""Draws the sketches of the theory beside itself: ``python docs/theory/sketches.py``."""

from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

HERE = Path(__file__).parent
BLUE, RED, GREY, BEAM = "#1f5fa8", "#c0392b", "#666666", "#dbe7f3"
mpl.rcParams.update({"svg.hashsalt": "ancfdae", "font.size": 11, "mathtext.fontset": "stix"})


def canvas(width, height, *limits):
    """A figure without axes whose units are equal in both directions."""
    axes = plt.figure(figsize=(width, height)).add_subplot()
    axes.set_xlim(*limits[:2])
    axes.set_ylim(*limits[2:])
    axes.set_aspect("equal")
    axes.axis("off")
    return axes


def arrow(axes, start, end, colour="black", style="-|>", zorder=3, **more):
    """An arrow from start to end."""
    how = {"arrowstyle": style, "color": colour, "lw": 1.4, "shrinkA": 0, "shrinkB": 0, **more}
    axes.annotate("", end, start, arrowprops=how, zorder=zorder)


def label(axes, place, text, colour="black", **more):
    """Text about a place."""
    axes.text(*place, text, color=colour, ha="center", va="center", **more)


def box(axes, place, text, width=2.5, height=0.8, colour=BEAM):
    """Text in a frame about a place."""
    x, y = place
    patch = mpl.patches.FancyBboxPatch(
        (x - width / 2, y - height / 2), width, height, "round,pad=0.05", fc=colour, ec=GREY
    )
    axes.add_patch(patch)
    label(axes, place, text)


def save(axes, name):
    """Write the figure, the same bytes each time."""
    axes.figure.savefig(HERE / f"{name}.svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(axes.figure)


def hermite(xi, r_1, t_1, r_2, t_2):
    """The axis of an element of length one."""
    s = (1 - 3 * xi**2 + 2 * xi**3, xi - 2 * xi**2 + xi**3, 3 * xi**2 - 2 * xi**3, xi**3 - xi**2)
    return sum(np.outer(f, v) for f, v in zip(s, (r_1, t_1, r_2, t_2), strict=True))


def planar_element(axes):
    """Axis, section and node vectors of a planar element."""
    xi = np.linspace(0, 1, 60)
    r_1, t_1, r_2, t_2 = (np.array(v) for v in ((0.0, 0.0), (5.0, 3.0), (5.2, 1.6), (4.5, -3.0)))
    line = hermite(xi, r_1, t_1, r_2, t_2)
    n_1, n_2 = np.array((-0.5, 0.86)), np.array((0.5, 0.86))
    up = 0.75 * (np.outer(1 - xi, n_1) + np.outer(xi, n_2))
    axes.fill(*np.vstack([line + up, (line - up)[::-1]]).T, color=BEAM)
    axes.plot(*line.T, color=GREY, lw=1, ls="--")
    for place, tangent, section, node in ((r_1, t_1, n_1, "1"), (r_2, t_2, n_2, "2")):
        axes.plot(*place, "ko", ms=5)
        arrow(axes, place, place + 0.33 * tangent, RED)
        arrow(axes, place, place + 1.25 * section, BLUE)
        label(axes, place + 0.33 * tangent + (0.15, 0.28), rf"$r_{{x{node}}}$", RED)
        label(axes, place + 1.25 * section + (0.0, 0.28), rf"$r_{{y{node}}}$", BLUE)
    origin = np.array((-0.8, -2.0))
    arrow(axes, origin, origin + np.array((0.9, 0)), GREY)
    arrow(axes, origin, origin + np.array((0, 0.9)), GREY)
    arrow(axes, origin, r_1 - (0.03, 0.1), GREY)
    label(axes, (-0.75, -0.75), r"$r_1$")
    middle = line[30]
    label(axes, middle + np.array((0.75, -0.4)), r"$\xi = x/l$", GREY)
    point = line[38] + 0.6 * up[38]
    axes.plot(*point, "o", color="black", ms=4)
    arrow(axes, line[38], point, BLUE, lw=1)
    label(axes, point + np.array((-0.9, 1.0)), r"$r(\xi, y) = \sum_a s_a X_a$")
    label(axes, (2.4, -2.3), "planar element")


def spatial_section(axes):
    """A section in space with the three slopes."""
    centre = np.array((9.6, 0.1))
    y, z, x = np.array((0.25, 1.3)), np.array((-1.15, -0.55)), np.array((2.1, -0.25))
    corners = [
        centre + a * 0.75 * y + b * 0.75 * z for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))
    ]
    back = [c - 0.75 * x for c in corners]
    for one, other in zip(back, corners, strict=True):
        axes.plot(*zip(one, other, strict=True), color=GREY, lw=0.8)
    axes.fill(*zip(*back, strict=True), fc="white", ec=GREY, lw=0.8)
    axes.fill(*zip(*corners, strict=True), fc=BEAM, ec=GREY, alpha=0.9)
    for vector, text, colour in (
        (x, "$r_x$", RED),
        (1.3 * y, "$r_y$", BLUE),
        (1.3 * z, "$r_z$", BLUE),
    ):
        arrow(axes, centre, centre + vector, colour)
        label(axes, centre + 1.14 * vector, text, colour)
    axes.plot(*centre, "ko", ms=5)
    label(axes, centre + np.array((0.25, -0.28)), "$r$")
    label(axes, (9.9, -2.3), "section of a spatial element")


def element():
    """Chapter 1."""
    axes = canvas(9.5, 4.0, -1.6, 12.2, -2.6, 3.2)
    planar_element(axes)
    spatial_section(axes)
    save(axes, "element")


def turned(angle):
    """Two axes in the plane, at an angle to those of the picture."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def blob(axes, centre, axis, text):
    """A body with a name."""
    patch = mpl.patches.Ellipse(centre, 4.6, 2.0, angle=np.degrees(axis), fc=BEAM, ec=GREY)
    axes.add_patch(patch)
    label(axes, centre, text)


def joint_frames():
    """Chapter 3."""
    axes = canvas(8, 3.4, -0.6, 10.2, -1.4, 3.3)
    blob(axes, (2.1, 1.0), 0.35, "section of body 1")
    blob(axes, (8.0, 0.8), -0.3, "section of body 2")
    markers = (((4.0, 1.75), 0.35, ""), ((6.0, 1.6), -0.3, "'"))
    for place, angle, prime in markers:
        axes.plot(*place, "ko", ms=5)
        for vector, name, colour in zip(turned(angle), "xy", (RED, BLUE), strict=True):
            tip = np.array(place) + 1.0 * vector
            arrow(axes, place, tip, colour)
            side = (0.12, 0.18) if name == "y" else (0.2, 0.16)
            label(axes, tip + side, rf"$F{prime}e_{name}$", colour)
    arrow(axes, (6.0, 1.6), (4.0, 1.75), GREY, style="<|-|>", lw=1)
    label(axes, (5.05, 1.35), r"$r - r'$", GREY)
    label(axes, (3.9, 1.4), "$r$")
    label(axes, (6.05, 1.25), "$r'$")
    label(
        axes,
        (4.9, -0.8),
        r"pin:  $r - r' = 0$        weld, in addition:  $Fe_i \cdot F'e_j - Fe_j \cdot F'e_i = 0$",
    )
    label(
        axes,
        (4.9, -1.25),
        r"(directions $e$ of the reference, carried along by each section; shear taken out)",
        GREY,
        fontsize=9,
    )
    save(axes, "joint-frames")


def hht_step():
    """Chapter 5."""
    axes = canvas(8.5, 3.0, -1.6, 11.0, -2.0, 2.1)
    arrow(axes, (-1.0, 0), (10.6, 0), GREY)
    label(axes, (10.75, -0.3), "$t$")
    shift = -1.05
    for x, n in ((1.5, "n"), (8.0, "n+1")):
        axes.plot([x, x], [-0.18, 0.18], color="black")
        label(axes, (x, -0.5), rf"$t_{{{n}}}$")
        label(
            axes, (x + 0.15, 1.1), rf"$q_{{{n}}},\ v_{{{n}}},\ \lambda_{{{n}}},\ A_{{{n}}}$", BLUE
        )
        arrow(axes, (x, 0.85), (x, 0.22), BLUE)
        axes.plot(x + shift, 0, "o", color=RED, ms=6)
        label(axes, (x + shift, -1.35), rf"$a_{{{n}}}$", RED)
        arrow(axes, (x + shift, -1.1), (x + shift, -0.12), RED)
        arrow(axes, (x, -0.85), (x + shift, -0.85), GREY, style="<->", lw=0.9)
        label(axes, (x + shift / 2 + 0.1, -1.05), r"$-\alpha h$", GREY, fontsize=9)
    arrow(axes, (1.5, 1.65), (8.0, 1.65), GREY, style="<->", lw=0.9)
    label(axes, (4.75, 1.88), "$h$", GREY)
    label(axes, (4.7, 0.42), r"$a_{n+1} = (1+\alpha)\, A_{n+1} - \alpha A_n$")
    label(
        axes,
        (4.6, -1.75),
        r"$f = 0$ and $\Phi = 0$ at the instants; $a$ approximates $\ddot q$ at $t + \alpha h$",
        GREY,
    )
    save(axes, "hht-step")


def rail(axes, y, names, colour, backward=False):
    """Boxes in a row, with arrows forward or backward in time."""
    places = [0, 3.3, 6.6, 9.9]
    for x, name in zip(places, names, strict=True):
        box(axes, (x, y), name, 2.2, 0.75, colour)
    for one, other in pairwise(places):
        start, end = (one + 1.18, y), (other - 1.18, y)
        arrow(axes, *((end, start) if backward else (start, end)))


def direct_adjoint():
    """Chapters 6 and 8."""
    axes = canvas(9.5, 4.6, -3.4, 14.6, -4.7, 4.0)
    rail(axes, 2.6, ("start", "step 1", "step 2", "step $n$"), BEAM)
    rail(
        axes,
        0.2,
        (
            "$q_b(0), v_b(0)$",
            "$q_b, v_b, \\lambda_b$",
            "$q_b, v_b, \\lambda_b$",
            "$q_b, v_b, \\lambda_b$",
        ),
        "#fbe9e7",
    )
    rail(
        axes,
        -2.9,
        ("of the start", r"$\mu, \zeta$", r"$\mu, \zeta$", r"$\mu, \zeta$"),
        "#e8f3e6",
        True,
    )
    for x in (0, 3.3, 6.6, 9.9):
        arrow(axes, (x, 2.1), (x, 0.72), GREY, lw=1)
        arrow(axes, (x + 0.35, 2.1), (x + 0.35, -2.38), GREY, lw=1, ls=":", zorder=0)
    label(axes, (-2.55, 2.6), "motion")
    label(axes, (-2.55, 0.2), "direct\ndifferentiation", RED)
    label(axes, (-2.55, -2.9), "adjoint", "#2e7d32")
    arrow(axes, (11.15, 0.2), (12.1, 0.2))
    label(axes, (13.3, 0.2), "$\\Psi_b$ of any\nnumber of $\\Psi$")
    arrow(axes, (12.2, -2.9), (11.15, -2.9))
    label(axes, (13.2, -2.9), "$\\Psi_q, \\Psi_v, \\Psi_\\lambda$\nof one $\\Psi$")
    arrow(axes, (-0.0, -3.35), (-0.0, -3.95))
    label(axes, (0.0, -4.3), "$\\Psi_b$")
    label(
        axes,
        (6.6, -1.2),
        "matrices $J$, $f_q$, $f_v$, $\\Phi_q$ at the converged states",
        GREY,
        fontsize=9,
        bbox={"fc": "white", "ec": "none"},
    )
    label(
        axes,
        (6.6, 3.55),
        "one column per design variable (direct), one pass per objective (adjoint)",
        GREY,
        fontsize=9,
    )
    save(axes, "direct-adjoint")


def path(load):
    """Displacement along the path of a load factor, with a limit point at 1.06."""
    return 2.4 * (1 - np.sqrt(1 - load / 1.06))


def static_path():
    """Chapter 11."""
    axes = plt.figure(figsize=(6.5, 3.6)).add_subplot()
    load = np.linspace(0, 1.0599, 400)
    axes.plot(path(load), load, color=GREY, label="solutions")
    axes.plot(4.8 - path(load), load, color=GREY, ls=":")
    axes.plot(path(1.06), 1.06, "s", color="black", ms=5)
    axes.annotate("limit point: a search beyond this load ends here", (2.4, 1.06), (1.6, 1.13))
    axes.axhline(1.0, color=GREY, lw=0.6, ls="--")
    axes.annotate("full load, $s = 1$", (3.6, 1.02), color=GREY)
    points = np.array([0.0, 0.5, 0.85, 1.0])
    axes.plot(path(points), points, "o", color=BLUE, label="accepted after Newton's method")
    for one, other in pairwise(points):
        rate = (path(one + 1e-6) - path(one)) / 1e-6
        guess = path(one) + rate * (other - one)
        arrow(axes, (path(one), one), (guess, other), RED, lw=1)
        arrow(axes, (guess, other), (path(other), other), BLUE, lw=1)
    axes.plot([], [], color=RED, label="predictor (here the tangent)")
    axes.set_xlabel("displacement")
    axes.set_ylabel("load factor $s$")
    axes.set_ylim(0, 1.25)
    axes.set_xlim(0, 4.8)
    axes.legend(loc="lower right", fontsize=8, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    save(axes, "static-path")


if __name__ == "__main__":
    for sketch in (element, joint_frames, hht_step, direct_adjoint, static_path):
        sketch()
