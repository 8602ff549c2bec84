"""Contact between bodies as a load: between many spheres, and of a beam with a beam or itself."""

import abc
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeGuard, final

import numpy as np

from ancfdae.errors.checks import (
    require_count,
    require_each,
    require_not_negative,
    require_positive,
    require_text,
    require_unique,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.design import require_numbers
from ancfdae.model.loads.contact import FORCE_FIELDS, ContactLoad, longest
from ancfdae.model.loads.contact_law import moving_with, on_body
from ancfdae.model.loads.load import LAW_FIELD, Copies, Load
from ancfdae.model.loads.obstacles import CENTRE
from ancfdae.model.parts import Elements, FrameDirection, LineVector, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import box_rule
from ancfdae.numerics.vector_formulas import concatenate, dot, positive

# Newton iterations for the closest point of a cubic, and how far xi may leave [0, 1] in them.
_ITERATIONS, _BEYOND = 6, 0.3
# How often the reach is doubled until a pair is found.
_DOUBLINGS = 64
# Half of the zone in which contact passes from an element to the next one, as a fraction of length.
_ZONE = 0.1
# Largest weight of a slope, over the element length, for xi up to _BEYOND outside [0, 1].
_SLOPES = 0.51


def _apart(e: Any, size: Any) -> tuple[Any, Any]:
    """Return length and direction of a vector e, both differentiable at e = 0."""
    l = np.sqrt(dot(e, e) + (CENTRE * size) ** 2)
    return l, e / l


def _within(ends: Array, others: Array, reach: float | None) -> Array:
    """Return the index pairs, (k, 2), of balls whose gap is at most `reach`.

    Balls are rows of position and radius, (n, d + 1); all pairs if `reach` is None.
    """
    if reach is None:
        return np.argwhere(np.ones((len(ends), len(others)), dtype=bool))
    from scipy.spatial import cKDTree

    trees = [cKDTree(x[:, :-1]) for x in (ends, others)]
    far = reach + ends[:, -1].max() + others[:, -1].max()
    found = trees[0].sparse_distance_matrix(trees[1], far, output_type="ndarray")
    i, j = found["i"], found["j"]
    gaps = found["v"] - ends[i, -1] - others[j, -1]
    order = np.lexsort((j, i))
    return np.stack([i, j], axis=1)[order][gaps[order] <= reach]


def without(pairs: Array, others: Array) -> Array:
    """Return the rows of `pairs`, (n, 2), that are not among the `others`, (m, 2)."""
    base = 1 + max(pairs.max(initial=0), others.max(initial=0))
    rows, known = (x[:, 0] * base + x[:, 1] for x in (pairs, others))
    return pairs[~np.isin(rows, known)]


@dataclass(frozen=True)
class PairContact(ContactLoad):
    """Base class of contact between bodies of a scene, some pairs of which may be left out."""

    reach: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.reach is not None:
            require_positive(f"load {self.name!r}, reach", self.reach)

    @final
    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Raise TypeError: contact needs the numbers of each pair, which `force_at` takes."""
        raise TypeError("force_at has the own numbers of the pair")

    @abc.abstractmethod
    def within(self, places: Sequence[Array], reach: float | None) -> Array:
        """Return the pairs, (n, 2), whose gaps are at most `reach`, for nodes at `places`.

        `places` are arrays (n_nodes, d), m, of the `whole_beams`, or of the `whole_bodies`. All
        pairs if `reach` is None.
        """

    def adjoining(self, places: Sequence[Array]) -> Array:
        """Return the pairs, (n, 2), that never touch because they are parts of one line.

        `places` are the positions of nodes in the reference configuration, as in `within`.
        """
        return np.zeros((0, 2), dtype=int)

    @final
    def places(self, elements: Elements) -> list[Array]:
        """Return the node positions of each body in the reference configuration, (n, d); m."""
        places = []
        for name in (*self.whole_beams, *self.whole_bodies):
            at = np.linspace(0.0, 1.0, elements.counts.get(name, 0) + 1).tolist()
            points = [MaterialPoint(name, x if name in elements.counts else None) for x in at]
            places.append(np.array([elements.place_of(point) for point in points]))
        return places

    @final
    def pairs(self, elements: Elements) -> Array:
        """Return the pairs that may touch, (n, 2), at least one.

        They are the `elements.pairs`, or the pairs within `reach` in the reference configuration.
        Raises InvalidInputError if no pair may touch at any reach.
        """
        if self.name in elements.pairs:
            return elements.pairs[self.name]
        places, reach = self.places(elements), self.reach
        never = self.adjoining(places)
        for _ in range(1 if reach is None else _DOUBLINGS):
            found = without(self.within(places, reach), never)
            if len(found):
                return found
            reach = None if reach is None else 2 * reach
        rule = "must have a pair of bodies, or of elements that do not adjoin each other"
        repair = "Divide the beam into more elements."
        raise InvalidInputError(f"load {self.name!r}", rule, "none", repair)


def leaves_out(load: Load) -> TypeGuard[PairContact]:
    """Whether a load leaves out pairs that are far from each other."""
    return isinstance(load, PairContact) and load.reach is not None


@final
@dataclass(frozen=True)
class SphereContacts(PairContact):
    """Contact of rigid bodies with each other, each a sphere around its reference point.

    All pairs may touch, or the pairs that `reach` leaves. Forces follow the law of `Contact`.
    Design targets: ``stiffness``, ``radius[0]``, ``radius[1]`` ... in the order of the bodies,
    ``restitution``, ``impact_speed``, ``friction`` and ``slip_speed``.

    Parameters
    ----------
    bodies : sequence of str
        Names of rigid bodies.
    radii : sequence of float
        Radius of the sphere of each body; m.
    stiffness, exponent, restitution, impact_speed, friction, slip_speed
        As in `Contact`.
    reach : float, optional
        Pairs whose gap is larger are left out; m. Runs of HHT and Radau search for neighbours again
        where such a pair comes close; other runs end there with a message. All pairs may touch by
        default.
    """

    bodies: Sequence[str]
    radii: Sequence[float]

    kind = "contacts"
    design_fields = (
        *(x for x in FORCE_FIELDS if x[0] != "radius"),
        ("radii", require_numbers),
        LAW_FIELD,
    )
    indexed_fields: ClassVar = {"radii": "radius"}

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"load {self.name!r}"
        require_each(f"{where}, bodies", self.bodies, (str,), "Give names of rigid bodies.")
        require_unique(f"{where}, bodies", "must differ", list(self.bodies), "Name each once.")
        if self.radius is not None or len(self.radii) != len(self.bodies) or len(self.bodies) < 2:
            rule, repair = "must have two bodies or more, and a radius for each", "Give `radii`."
            raise InvalidInputError(where, rule, f"{len(self.radii)} radii", repair)
        for radius in self.radii:
            require_positive(f"{where}, radii", radius)

    @property
    def whole_bodies(self) -> tuple[str, ...]:
        """Names of the rigid bodies in contact."""
        return tuple(self.bodies)

    def within(self, places: Sequence[Array], reach: float | None) -> Array:
        """Return the pairs of bodies whose gap is at most `reach`, (n, 2), in ascending order."""
        balls = np.column_stack([np.concatenate(places), np.asarray(self.radii, float)])
        found = _within(balls, balls, reach)
        return found[found[:, 0] < found[:, 1]]

    def vectors(self, elements: Elements) -> Vectors:
        """Return, for each pair, positions of both bodies, and their axes if there is friction."""
        count = 1 if self.friction is None else elements.d + 1
        return tuple(
            FrameDirection(self.bodies[body], k)
            for pair in self.pairs(elements).tolist()
            for body in pair
            for k in range(count)
        )

    def copies(self, elements: Elements) -> Copies:
        """Return one copy of the load for each pair, with the indices of its two radii."""
        pairs, (places, _) = self.pairs(elements), self.design_places
        first = places[[name for name, _ in self.design_fields].index("radii")]
        assert isinstance(first, slice)
        return Copies(np.zeros((len(pairs), 0)), parameters=first.start + pairs)

    def _touched(self, U: Any, signals: Any, n: int) -> tuple[Any, Any]:
        """Return penetration depth of a pair, negative if apart, and normal; U of the pair."""
        radii = signals[..., -2:-1, None], signals[..., -1:, None]
        l, normal = _apart(U[..., :1, :] - U[..., n : n + 1, :], radii[0] + radii[1])
        return radii[0] + radii[1] - l, normal

    def depth(self, U: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return the penetration depth of the two spheres of a pair, shape (..., 1, 1); m."""
        return np.asarray(self._touched(U, signals, len(U_o) // 2)[0])

    def closing(self, U: Array, M: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return the path of one centre relative to the other, a bound, (..., 1, 1); m."""
        n = len(U_o) // 2
        return longest(M[..., :1, :] - M[..., n : n + 1, :])

    def gates(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return max(depth, 0), a factor with which the contact force vanishes."""
        return (positive(self._touched(U, signals, len(U_o) // 2)[0]),)

    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return N n + T at the surface of the first body, and the opposite on the second; N."""
        n = len(U_o) // 2
        depth, normal = self._touched(U, signals, n)
        depth = positive(depth)
        stiffness, restitution, impact_speed, friction, slip_speed, _, _ = self.split(p)
        arm = -signals[..., -2:-1, None] * normal
        parts, w = moving_with(U[..., :n, :], V[..., :n, :], arm)
        reach = U[..., :1, :] + arm - U[..., n : n + 1, :]
        others, along = moving_with(U[..., n:, :], V[..., n:, :], reach)
        values = stiffness, None, restitution, impact_speed, friction, slip_speed
        F = self.pressed(values, depth, normal, w - along)
        return concatenate([on_body(F, parts), on_body(-F, others)])


@final
@dataclass(frozen=True)
class BeamPairContact(PairContact):
    """Contact of two beams or cables, centre lines with radii, or of one with itself.

    Gauss points along `beam` are in contact with the closest points of the other centre line. The
    force per unit of reference length of `beam` follows the law of `Contact`. Where beams cross the
    contact is short: there the Gauss points must lie closer than the radii. Design targets:
    ``stiffness``, ``radius``, ``other_radius``, ``restitution``, ``impact_speed``, ``friction`` and
    ``slip_speed``.

    If both names are the same the beam touches itself: coils, loops, a heap. Each pair of elements
    counts once, with the Gauss points of the first one. Elements that share a node, or have less
    than a diameter of line between them, do not touch each other. So the line must turn by less
    than a right angle in them: nine elements or more in a turn. InvalidInputError if it does not at
    the start of a run; a run ends with a message where it no longer does.

    Parameters
    ----------
    beam, other_beam : str
        Names of two beams, or twice the same; `other_beam` must have no kinks.
    stiffness : float
        k, positive; N/m^(m+1).
    radius, other_radius : float
        Distances from the centre lines to the surfaces; m. A beam that touches itself has one.
    points_per_element : int, optional
        Gauss points in each element of `beam`, 4 by default.
    exponent, restitution, impact_speed, friction, slip_speed
        As in `Contact`.
    reach : float, optional
        As in `SphereContacts`, for elements; m.
    """

    beam: str
    other_beam: str
    points_per_element: int = 4
    other_radius: float | None = field(default=None, kw_only=True)

    design_fields = (*FORCE_FIELDS, ("other_radius", require_not_negative), LAW_FIELD)

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"load {self.name!r}"
        require_text(f"{where}, other_beam", self.other_beam)
        repair = "Give the number of points."
        require_count(f"{where}, points_per_element", self.points_per_element, repair, 64)
        if self.radius is None:
            rule, repair = "must be given", "Give the radius of the first beam."
            raise InvalidInputError(f"{where}, radius", rule, None, repair)
        if (self.other_radius is None) != (self.beam == self.other_beam):
            rule = "must be given for two beams, and left out for a beam that touches itself"
            repair = "Give one radius for each beam."
            raise InvalidInputError(f"{where}, other_radius", rule, self.other_radius, repair)

    @property
    def whole_beams(self) -> tuple[str, ...]:
        """Names of the two beams in contact, or of the one that touches itself."""
        return (self.beam,) if self.other_radius is None else (self.beam, self.other_beam)

    def within(self, places: Sequence[Array], reach: float | None) -> Array:
        """Return the element pairs, (n, 2), whose bounding balls are at most `reach` apart."""
        balls = []
        radii = [self.radius or 0.0, self.other_radius or 0.0][: len(places)]
        for nodes, radius in zip(places, radii, strict=True):
            halves = np.diff(nodes, axis=0) / 2
            # Balls around chords are a fifth larger, for elements that are bent.
            sizes = 1.2 * np.linalg.norm(halves, axis=1) + radius
            balls.append(np.column_stack([nodes[:-1] + halves, sizes]))
        found = _within(balls[0], balls[-1], reach)
        return found if len(balls) == 2 else found[found[:, 0] < found[:, 1]]

    def adjoining(self, places: Sequence[Array]) -> Array:
        """Return the pairs of elements with less than a diameter of one line between them, (n, 2).

        They include neighbours and are ordered, k <= j. For two beams the array is empty.
        """
        if len(places) == 2:
            return super().adjoining(places)
        arc = np.cumsum(np.linalg.norm(np.diff(places[0], axis=0, prepend=places[0][:1]), axis=1))
        count = len(arc) - 1
        free = np.searchsorted(arc, arc[1:] + 2 * (self.radius or 0.0))
        ends = np.clip(free, np.arange(count) + 2, count)
        return np.array([(k, j) for k, end in enumerate(ends.tolist()) for j in range(k, end)])

    def vectors(self, elements: Elements) -> Vectors:
        """Return, per Gauss point and element, the point, its axes, and the element's vectors."""
        names = self.beam, self.other_beam
        both = [self.turning(MaterialPoint(x, 0.0), elements) for x in names]
        points = box_rule((self.points_per_element,))[0][:, 0].tolist()
        found: list[Any] = []
        for k, j in self.pairs(elements).tolist():
            line = (Quantity.POSITION, Quantity.SLOPE_X)
            at = [(xi, x) for x in line for xi in (0.0, 1.0)]
            at += [(xi, x) for xi in (0.0, 1.0) for x in both[1]]
            ends = [LineVector(self.other_beam, j, *each) for each in at]
            for xi in points:
                own = (Quantity.POSITION, *both[0])
                found += [LineVector(self.beam, k, xi, x) for x in own]
                found += ends
        return tuple(found)

    def copies(self, elements: Elements) -> Copies:
        """Return one copy per Gauss point of `beam` and element of the other beam.

        Its own numbers are the length that the point represents, whether the element is the first
        or the last one, and the lengths of the element and of its neighbours before and behind.
        """
        pairs, weights = self.pairs(elements), box_rule((self.points_per_element,))[1]
        last = elements.counts[self.other_beam] - 1
        k, j = np.repeat(pairs, len(weights), axis=0).T
        own = np.ones((len(k), 6))
        own[:, 0], own[:, 1], own[:, 2] = np.tile(weights, len(pairs)), j == 0, j == last
        at = (k, j, np.maximum(j - 1, 0), np.minimum(j + 1, last))
        beams = self.beam, *[self.other_beam] * 3
        lengths = {
            column: tuple((beam, int(x)) for x in which)
            for column, beam, which in zip((0, 3, 4, 5), beams, at, strict=True)
        }
        return Copies(own, lengths)

    def _split(self, U: Any) -> tuple[Any, Any, Any]:
        """Return position and axes of the Gauss point, node vectors, and axes at both nodes."""
        n, d = U.shape[-2:]
        # Each beam has d - 1 section slopes among the vectors, or none.
        turning = (n - 5) // (d - 1)
        own = 1 + (turning % 2) * (d - 1)
        return U[..., :own, :], U[..., own : own + 4, :], U[..., own + 4 :, :]

    def _near(self, U: Any, signals: Any, p: Array) -> Any:
        """Return max(size^2 - |e|^2, 0): 0 where the point is too far from the element to touch."""
        size, e = self._ball(U, signals, p)
        return positive(size * size - dot(e, e))

    def _ball(self, U: Any, signals: Any, p: Array) -> tuple[Any, Any]:
        """Return the radius of a ball around the element, and the point relative to its centre.

        The centre is the middle of the nodes, and the ball contains the Bezier points of the cubic.
        Both beam radii are added.
        """
        values, l = self.split(p), signals[..., 3:4, None]
        point, X, _ = self._split(U)
        half, slopes = (X[..., 1:2, :] - X[..., :1, :]) / 2, X[..., 2:, :]
        size = np.sqrt(dot(half, half)) + l / 3 * np.sqrt(
            dot(slopes, slopes).sum(axis=-2, keepdims=True)
        )
        e = point[..., :1, :] - X[..., :1, :] - half
        return size + _radii(values), e

    def depth(self, U: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return the depth of the point in the element, or in its ball if far, (..., 1, 1); m."""
        size, e = self._ball(U, signals, p)
        depth = np.asarray(size - np.sqrt(dot(e, e)))
        near = depth[..., 0, 0] > 0
        signals = np.broadcast_to(signals, (*near.shape, signals.shape[-1]))
        depth[near] = self._touched(U[near], signals[near], p)[0]
        return depth

    def closing(self, U: Array, M: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return a bound of the path of the point relative to the element, (..., 1, 1); m."""
        point, X, _ = self._split(M)
        ways, slopes = longest(point[..., :1, :] - X[..., :2, :]), longest(X[..., 2:, :])
        beside = _SLOPES * signals[..., 3:4, None] * slopes.sum(axis=-2, keepdims=True)
        return np.asarray(ways.max(axis=-2, keepdims=True) + beside)

    def _touched(self, U: Any, signals: Any, p: Array) -> tuple[Any, Any, Any, Any]:
        """Return depth, negative if apart, normal, xi of the closest point, and its weight.

        The weight passes smoothly from element to element: of all elements it sums to one.
        """
        values, l = self.split(p), signals[..., 3:4, None]
        point, X, _ = self._split(U)
        c, size, chord = point[..., :1, :], _radii(values), X[..., 1:2, :] - X[..., :1, :]
        xi = _clamped(dot(c - X[..., :1, :], chord) / dot(chord, chord), 0.0)
        for _ in range(_ITERATIONS):
            r, r_1, r_2 = (_weighted(w, X) for w in _hermite(xi, l))
            slope = dot(r_1, r_1) - dot(c - r, r_2)
            xi = _clamped(xi + dot(c - r, r_1) / slope, _BEYOND)
        first, last = signals[..., 1:2, None], signals[..., 2:3, None]
        before, behind = (
            x * l / (x + l) for x in (signals[..., 4:5, None], signals[..., 5:6, None])
        )
        share = (first + (1 - first) * _passed(xi * l / before)) * (
            last + (1 - last) * _passed((1 - xi) * l / behind)
        )
        # Beyond its ends a beam has a hemispherical cap.
        xi = xi + first * positive(-xi) - last * positive(xi - 1)
        distance, n = _apart(c - _weighted(_hermite(xi, l)[0], X), size)
        return size - distance, n, xi, share

    def gates(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return `_near` and max(depth, 0), two factors with which the contact force vanishes."""
        near = self._near(U, signals, p)
        return near, positive(self._touched(U, signals, p)[0])

    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return N n + T on the point, and the opposite on the element, times a length; N."""
        depth, n, xi, share = self._touched(U, signals, p)
        depth = positive(depth)
        *values, _, _ = self.split(p)
        (point, X, axes), (rates, X_1, axes_1) = self._split(U), self._split(V)
        weights = _hermite(xi, signals[..., 3:4, None])[0]
        half = axes.shape[-2] // 2
        line, line_1 = (
            concatenate([_weighted(weights, x), *_between(y, xi, half)])
            for x, y in ((X, axes), (X_1, axes_1))
        )
        arm = -values[1] * n
        parts, w = moving_with(point, rates, arm)
        others, along = moving_with(line, line_1, point[..., :1, :] + arm - line[..., :1, :])
        F = self.pressed(values, depth, n, w - along) * (share * signals[..., :1, None])
        result = [on_body(F, parts), *(-weight * F for weight in weights)]
        if others is not None:
            result += [-(1 - xi) * others * F, -xi * others * F]
        return concatenate(result)


def _radii(values: Sequence[Any]) -> Any:
    """Return the sum of both radii of a `BeamPairContact`, or the diameter of its one beam."""
    return values[1] + (values[1] if values[6] is None else values[6])


def _clamped(xi: Any, beyond: float) -> Any:
    """Return xi limited to [-beyond, 1 + beyond]."""
    return positive(xi + beyond) - positive(xi - 1 - beyond) - beyond


def _passed(x: Any) -> Any:
    """Return a smooth step s(x) from 0 to 1 over |x| < _ZONE, with s(x) + s(-x) = 1."""
    y = positive(x / (2 * _ZONE) + 0.5)
    y = y - positive(y - 1)
    return y * y * y * (10 - 15 * y + 6 * y * y)


def _hermite(xi: Any, l: Any) -> tuple[tuple[Any, ...], ...]:
    """Return the Hermite weights of positions and slopes at xi, and two derivatives in xi."""
    x2 = xi * xi
    h = x2 * (3 - 2 * xi)
    h_1, h_2 = 6 * xi * (1 - xi), 6 - 12 * xi
    value = 1 - h, h, l * xi * (1 - xi) * (1 - xi), l * x2 * (xi - 1)
    first = -h_1, h_1, l * (1 - 4 * xi + 3 * x2), l * (3 * x2 - 2 * xi)
    second = -h_2, h_2, l * (6 * xi - 4), l * (6 * xi - 2)
    return value, first, second


def _weighted(weights: tuple[Any, ...], X: Any) -> Any:
    """Return the weighted sum of the four vectors X, (..., 4, d), shape (..., 1, d)."""
    terms = [w * X[..., k : k + 1, :] for k, w in enumerate(weights)]
    return terms[0] + terms[1] + terms[2] + terms[3]


def _between(axes: Any, xi: Any, half: int) -> tuple[Any, ...]:
    """Return axes at xi, interpolated between the axes of both nodes; () without axes."""
    return ((1 - xi) * axes[..., :half, :] + xi * axes[..., half:, :],) if half else ()
