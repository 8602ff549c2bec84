"""Truth of outcomes: random scenes at rest, each success checked by what the search does not know.

    python -m validation.outcomes 500
    python -m validation.outcomes 300 100 odd

draw 500 scenes from seeds 0, 1, ..., or 300 odd ones from seed 100 on, and print those whose
outcome does not hold. Odd scenes have soft parts beside stiff ones, fine meshes, other units, a
distant place or joints that repeat others. A success
must have forces in balance as NumPy's long doubles form them from the stationarity of the energy,
no element turned inside out, and as many negative eigenvalues of the stiffness, on the motions that
keep the constraints, as the outcome says: none if it is stable, one at least if not.
"""

import sys
import warnings
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from ancfdae import (
    BEAM_2D,
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    Beam,
    Clamp,
    Distance,
    FollowerForce,
    Material,
    Moment,
    Pin,
    PointForce,
    Scene,
    SpringDamper,
    assemble,
    equilibrium,
)
from ancfdae.errors import InvalidInputError
from ancfdae.numerics.arrays import Array
from ancfdae.results import Equilibrium
from ancfdae.sections import Circle, Rectangle

_MATERIALS = (
    Material(7850.0, 2.1e11, 0.3),
    Material(2700.0, 7e10, 0.33),
    Material(1100.0, 1e6, 0.4),
    Material(1000.0, 1e8, 0.3),
)

# Density, Young's modulus and Poisson's ratio in SI; metre, kilogram and second in other units.
_SOFT_AND_STIFF = (
    (7850.0, 2.1e11, 0.3),
    (1100.0, 1e5, 0.45),
    (1000.0, 1e7, 0.3),
    (2700.0, 7e10, 0.33),
    (50.0, 1e4, 0.2),
)
_UNITS = ((1.0, 1.0, 1.0), (1e3, 1e-3, 1.0), (1e3, 1e3, 1e3), (1e-3, 1e-9, 1e-3))

# Searches that have not ended by then are counted as failures.
_MOST_STEPS = 100


def random_scene(seed: int) -> Scene:
    """Return a chain of one to three beams with joints, springs and loads, drawn from a seed."""
    rng = np.random.default_rng([34, seed])
    d = int(rng.integers(2, 4))
    scale = 10.0 ** rng.uniform(-1, 1)
    place = rng.choice([0.0, 0.0, 100.0 * scale]) * np.ones(d)
    beams: list[Beam] = []
    for k in range(int(rng.integers(1, 4))):
        length = scale * rng.uniform(0.3, 1.0)
        along = rng.standard_normal(d)
        end = place + length * along / np.linalg.norm(along)
        size = length * 10.0 ** rng.uniform(-3, -1)
        element = ((CABLE_2D, BEAM_2D) if d == 2 else (CABLE_3D, BEAM_3D))[rng.integers(2)]
        section = Circle(size) if d == 3 else Rectangle(size, size)
        material = _MATERIALS[rng.integers(len(_MATERIALS))]
        rigid = bool(rng.random() < 0.2) and element in (BEAM_2D, BEAM_3D)
        n = int(rng.integers(1, 6))
        ends = tuple(place.tolist()), tuple(end.tolist())
        beams.append(Beam(f"b{k}", *ends, n, section, material, element=element, rigid=rigid))
        place = end
    joints: list[object] = [(Clamp if rng.random() < 0.6 else Pin)(beams[0].at_start)]
    joints += [Pin(a.at_end, b.at_start) for a, b in pairwise(beams)]
    last = beams[-1].at_end
    draw = rng.random()
    if draw < 0.4:
        # Supports that are too near or too far by up to a tenth.
        off = scale * rng.choice([0.0, 0.03, 0.1]) * rng.standard_normal(d)
        joints.append(Pin(last, ground=tuple((place + off).tolist())))
    elif draw < 0.5:
        above = place + scale * np.eye(d)[1]
        joints.append(Distance(last, scale, ground=tuple(above.tolist())))
    weight = float(sum(_weight(beam) for beam in beams))
    loads: list[object] = []
    for k in range(int(rng.integers(0, 3))):
        beam = beams[rng.integers(len(beams))]
        size = weight * 10.0 ** rng.uniform(-1, 1)
        point = beam.at(float(rng.choice([0.5, 1.0])))
        vector = tuple((size * rng.standard_normal(d)).tolist())
        kind = rng.integers(4)
        if kind == 0:
            loads.append(PointForce(point, vector, name=f"load{k}"))
        elif kind == 1 and beam.element in (BEAM_2D, BEAM_3D):
            loads.append(FollowerForce(point, vector, name=f"load{k}"))
        elif kind == 2 and beam.element is BEAM_2D:
            loads.append(Moment(point, size * scale, name=f"load{k}"))
        else:
            ground = tuple((place + scale * rng.standard_normal(d)).tolist())
            stiffness = size / scale
            name = f"load{k}"
            loads.append(SpringDamper(point, stiffness, 0.0, scale, ground=ground, name=name))
    gravity = tuple((-9.81 * np.eye(d)[1]).tolist())
    return Scene(beams, joints, gravity, loads=loads)  # type: ignore[arg-type]


def odd_scene(seed: int) -> Scene:
    """Return a chain of beams that `random_scene` does not draw, from a seed; see the module."""
    rng = np.random.default_rng([35, seed])
    d = int(rng.integers(2, 4))
    length, mass, time = _UNITS[rng.integers(len(_UNITS))]
    away, scale = float(rng.choice([0.0, 0.0, 1e3])), 10.0 ** rng.uniform(-1, 1)
    place, beams, weight = away * scale * np.ones(d), list[Beam](), 0.0
    gravity = 9.81 * length / time**2

    def in_units(x: Array) -> tuple[float, ...]:
        return tuple((length * x).tolist())

    for k in range(int(rng.integers(1, 4))):
        l, along = scale * rng.uniform(0.3, 1.0), rng.standard_normal(d)
        end = place + l * along / np.linalg.norm(along)
        size = length * l * 10.0 ** rng.uniform(-3, -0.7)
        element = ((CABLE_2D, BEAM_2D) if d == 2 else (CABLE_3D, BEAM_3D))[rng.integers(2)]
        section = Circle(size) if d == 3 else Rectangle(size, size)
        density, modulus, ratio = _SOFT_AND_STIFF[rng.integers(len(_SOFT_AND_STIFF))]
        pressure = mass / length / time**2
        material = Material(density * mass / length**3, modulus * pressure, ratio)
        rigid = bool(rng.random() < 0.2) and element in (BEAM_2D, BEAM_3D)
        n = 1 if rigid else int(rng.choice([1, 2, 3, 8, 24, 60]))
        ends = in_units(place), in_units(end)
        beams.append(Beam(f"b{k}", *ends, n, section, material, element=element, rigid=rigid))
        weight, place = weight + gravity / 9.81 * _weight(beams[-1]), end
    joints: list[object] = [(Clamp if rng.random() < 0.7 else Pin)(beams[0].at_start)]
    joints += [Pin(a.at_end, b.at_start) for a, b in pairwise(beams)]
    draw = rng.random()
    if draw < 0.1:
        joints.append(Pin(beams[0].at_start, name="again"))
    elif draw < 0.2:
        joints += [Pin(beams[-1].at_end), Pin(beams[-1].at_end, name="again")]
    elif draw < 0.4:
        joints.append(Pin(beams[-1].at_end))
    loads: list[object] = []
    for k in range(int(rng.integers(0, 3))):
        beam = beams[rng.integers(len(beams))]
        size, point = weight * 10.0 ** rng.uniform(-1, 1.5), beam.at(float(rng.choice([0.3, 1.0])))
        vector, kind = tuple((size * rng.standard_normal(d)).tolist()), rng.integers(3)
        if kind == 0:
            loads.append(PointForce(point, vector, name=f"load{k}"))
        elif kind == 1 and beam.element in (BEAM_2D, BEAM_3D):
            loads.append(FollowerForce(point, vector, name=f"load{k}"))
        else:
            ground = in_units(place + scale * rng.standard_normal(d))
            free, stiffness = scale * length, size / (scale * length) * 10 ** rng.uniform(0, 4)
            name = f"load{k}"
            loads.append(SpringDamper(point, stiffness, 0.0, free, ground=ground, name=name))
    down = tuple((-gravity * np.eye(d)[1]).tolist())
    return Scene(beams, joints, down, loads=loads)  # type: ignore[arg-type]


def _weight(beam: Beam) -> float:
    section, material = beam.section, beam.material
    assert isinstance(section, Circle | Rectangle)
    assert isinstance(material, Material)
    area = np.pi * section.radius**2 if isinstance(section, Circle) else section.height**2
    length = float(np.sum(beam.reference().lengths))
    return 9.81 * float(material.density) * float(area) * length


@dataclass(frozen=True)
class Truth:
    """What does not hold of an outcome, in words; empty if it is true. `kind` counts outcomes."""

    kind: str
    wrong: str = ""


def checked(scene: Scene) -> Truth:
    """Search for the equilibrium of a scene, and check what is said of it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = equilibrium(scene, max_steps=_MOST_STEPS)
    except InvalidInputError as refused:
        return Truth(type(refused).__name__)
    if not found.outcome.success:
        return Truth(found.outcome.verdict.name)
    kind = "stable" if found.outcome.stable_to is None else "unstable"
    wrong = [unbalanced(scene, found), folded(scene, found), of_stability(scene, found)]
    return Truth(kind, "; ".join(text for text in wrong if text))


def unbalanced(scene: Scene, found: Equilibrium) -> str:
    """Say whether forces are not in balance, beyond what a rounding of coordinates changes.

    The forces of elements are formed in extended precision from their strains.
    """
    system = assemble(scene)
    q, lam = found.q, found.lam
    K = np.asarray(system.linearise(*_state(q, lam)).f_q[0])
    R = exact_forces(system, q) - _reaction(system, q, lam)
    blur = system.pattern.dot(np.abs(K), np.abs(q))
    forces = np.abs(system.force(0.0, q, 0 * q)) + np.abs(_reaction(system, q, lam))
    # A rounding of each coordinate, and of a place a hundred times as far; sums of 64 terms.
    noise = np.finfo(float).eps * (8 * np.max(blur) + 64 * np.max(forces))
    noise += 64 * system.traits.force_round_off * np.sqrt(np.max(system.weights))
    left = float(np.max(np.abs(R)))
    return "" if left <= noise else f"unbalanced by {left:.2g}, {left / noise:.2g} of round-off"


def exact_forces(system: object, q: Array) -> Array:
    """Return Q with the forces of elements in long doubles: -dU/dY with U a form in Delta g."""
    elastic = system._elastic  # type: ignore[attr-defined]
    block, vectors, d = elastic._block, elastic._places.vectors, elastic._places.d
    others = system.force(0.0, q, 0 * q) + elastic.internal(q, 0 * q)  # type: ignore[attr-defined]
    total = np.asarray(others, dtype=np.longdouble)
    X = np.asarray(q, dtype=np.longdouble).reshape(-1, d)[vectors]
    n_s = X.shape[1] // 2
    Y = np.concatenate([X[:, n_s : n_s + 1] - X[:, :1], X[:, 1:n_s], X[:, n_s + 1 :]], axis=1)
    rows, columns = np.triu_indices(Y.shape[1])
    for e in range(len(vectors)):
        k = 0 if len(block.A) == 1 else e
        g = np.sum(Y[e][rows] * Y[e][columns], axis=1)
        p = block.A[k].astype(np.longdouble) @ (g - block.g_o[0 if len(block.g_o) == 1 else e])
        on_Y = np.zeros_like(Y[e])
        for i, j, stress in zip(rows, columns, p, strict=True):
            on_Y[i] += stress * Y[e][j]
            on_Y[j] += stress * Y[e][i]
        if block.bending is not None:
            stiffness, length = block.bending[0 if len(block.bending) == 1 else e]
            on_Y += _bending_force(stiffness, length, Y[e])
        on_X = np.concatenate([-on_Y[:1], on_Y[1:n_s], on_Y[:1], on_Y[n_s:]])
        for vector, force in zip(vectors[e], on_X, strict=True):
            total[d * vector : d * vector + d] -= force
    return np.asarray(total)


def _bending_force(stiffness: float, length: float, Y: Array) -> Array:
    """Return dU/dY of a cable's bending, shape (n_y, d), from kappa^2 = (b/a - c^2/a^2)/l^2.

    a = t.t, b = h.h and c = t.h with t = r_x and h = l r_xx at the two Gauss points.
    """
    force = np.zeros_like(Y)
    if stiffness == 0:
        return force
    l, rows = np.longdouble(length), [0, 1, (Y.shape[0] + 1) // 2]
    for side in (-1, 1):
        x = (1 + side / np.sqrt(np.longdouble(3))) / 2
        of_t = np.array([6 * x * (1 - x) / l, (1 - x) * (1 - 3 * x), x * (3 * x - 2)])
        of_h = np.array([(6 - 12 * x) / l, 6 * x - 4, 6 * x - 2])
        t, h = of_t @ Y[rows], of_h @ Y[rows]
        a, b, c = t @ t, h @ h, t @ h
        # Half of each weight 1/2: U = E I/(2 l) times the mean of l^2 kappa^2.
        on_t = (-2 * b / a**2 + 4 * c**2 / a**3) * t - 2 * c / a**2 * h
        on_h = 2 / a * h - 2 * c / a**2 * t
        force[rows] += stiffness / (4 * l) * (np.outer(of_t, on_t) + np.outer(of_h, on_h))
    return force


def folded(scene: Scene, found: Equilibrium) -> str:
    """Say whether a section is inside out, or a tangent against the chord, at 33 places."""
    xi = np.linspace(0.0, 1.0, 33)
    for beam in scene.beams:
        if beam.rigid:
            continue
        ends, n_s = found.solution.ends(beam.name)[0], beam.element.n_s
        l = beam.reference().lengths[:, None, None]
        w = 6 * xi * (1 - xi), (1 - xi) * (1 - 3 * xi), xi * (3 * xi - 2)
        chord = (ends[:, 1, 0] - ends[:, 0, 0])[:, None] / l
        r_x = w[0][:, None] * chord
        r_x = r_x + w[1][:, None] * ends[:, 0, 1][:, None] + w[2][:, None] * ends[:, 1, 1][:, None]
        bad = np.sum(r_x**2, axis=-1) <= 0.33
        if n_s == beam.dimension + 1:
            across = [
                (1 - xi)[:, None] * ends[:, 0, s][:, None] + xi[:, None] * ends[:, 1, s][:, None]
                for s in range(2, n_s)
            ]
            bad |= np.linalg.det(np.stack([r_x, *across], axis=-2)) <= 0
        else:
            bad |= np.sum(r_x * chord, axis=-1) <= 0
        if np.any(bad):
            return f"{beam.name} is folded"
    return ""


def of_stability(scene: Scene, found: Equilibrium) -> str:
    """Count negative eigenvalues of the stiffness on the null space of the constraints."""
    system = assemble(scene)
    K = system.pattern.dense(system.linearise(*_state(found.q, found.lam)).f_q[0])
    B = system.constraint_pattern.dense(system.constraint_q(0.0, found.q))
    scaling = 1 / np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-12 * np.max(np.abs(K))))
    N = scipy.linalg.null_space(B * scaling) if len(B) else np.eye(len(K))
    if not N.shape[1]:
        return ""
    S = N.T @ (scaling[:, None] * K * scaling) @ N
    # Follower loads are not symmetric: a motion meets x^T K x.
    values = np.linalg.eigvalsh(0.5 * (S + S.T))
    most = float(np.max(np.abs(values)))
    # Round-off of eigenvalues, n eps of the largest, with a margin.
    noise = 1e3 * len(values) * np.finfo(float).eps * most
    negative = int(np.sum(values < -noise))
    if found.outcome.stable_to is None and negative and np.allclose(S, S.T, atol=1e-9 * most):
        return f"said to be stable with {negative} negative, {np.min(values) / most:.2g}"
    if found.outcome.stable_to is not None and np.min(values) > noise:
        return f"said to be unstable; the least is {np.min(values) / most:.2g}"
    return ""


def _state(q: Array, lam: Array) -> tuple[Array, Array, Array, Array, Array]:
    rest = np.zeros((1, len(q)))
    return np.zeros(1), q[None], rest, rest, lam[None]


def _reaction(system: object, q: Array, lam: Array) -> Array:
    pattern = system.constraint_pattern  # type: ignore[attr-defined]
    B = system.constraint_q(0.0, q)  # type: ignore[attr-defined]
    return np.asarray(pattern.dot_transposed(B, lam))


def main(count: int, first: int = 0, kind: str = "") -> int:
    """Check scenes and print what is wrong; return how many."""
    kinds: Counter[str] = Counter()
    wrong, draw = 0, odd_scene if kind == "odd" else random_scene
    for seed in range(first, first + count):
        truth = checked(draw(seed))
        kinds[truth.kind] += 1
        if truth.wrong:
            wrong += 1
            sys.stdout.write(f"seed {seed}: {truth.wrong}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{count} scenes: {dict(kinds)}; {wrong} outcomes that do not hold\n")
    return wrong


if __name__ == "__main__":
    count, first = (int(x) for x in [*sys.argv[1:3], "0"][:2])
    sys.exit(main(count, first, "odd" if "odd" in sys.argv else "") > 0)
