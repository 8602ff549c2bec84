"""The compiled check of sides of sections and tangents, and checks of beams that are alike."""

import numpy as np
import pytest

from ancfdae import BEAM_3D, CABLE_3D, Beam, Clamp, Material, Scene, assemble
from ancfdae.assembly import folds
from ancfdae.kernels import keeps_sides
from ancfdae.sections import Circle, Rectangle
from validation.peers.cables import FlexibleSlider
from validation.peers.loops import Net, frame
from validation.peers.rigid import Chain, RigidSlider

RUBBER = Material(1000, 1e7, 0.3)


def mixed():
    strip = Beam("strip", (0, 0, 0), (1, 0, 0), 5, Rectangle(0.1, 0.02), RUBBER, element=BEAM_3D)
    wire = Beam("wire", (1, 0, 0), (1, 1, 1), 4, Circle(0.02), RUBBER, element=CABLE_3D)
    return Scene([strip, wire], [Clamp(strip.at_start)])


SCENES = {
    "frame": lambda: frame(2),
    "net": lambda: Net(4).scene(),
    "slider of cables": lambda: FlexibleSlider(4).scene(),
    "rigid slider": lambda: RigidSlider().scene(),
    "chain": lambda: Chain(3, True).scene(),
    "strip and wire": mixed,
}


@pytest.mark.parametrize("name", SCENES)
def test_states_that_the_kernel_lets_pass_are_those_of_the_search_in_words(monkeypatch, name):
    """States that are mirrored or crushed fail the kernel's check, and small moves pass it."""
    system, random = assemble(SCENES[name]()), np.random.default_rng(0)
    q = system.start()[0]
    found = passed = 0
    for size in (1e-3, 0.03, 0.1, 0.3, 1.0):
        for _ in range(12):
            states = np.stack([q, q + size * random.standard_normal(len(q))])
            verdicts = []

            def slowly(*args, to=verdicts):
                to.append(keeps_sides(*args))
                return False

            monkeypatch.setattr(folds, "keeps_sides", slowly)
            in_words = system.mirrored(states)
            monkeypatch.setattr(folds, "keeps_sides", keeps_sides)
            assert system.mirrored(states) == in_words
            assert in_words is None or not all(verdicts)
            found += in_words is not None
            passed += all(verdicts)
            assert size > 1e-3 or all(verdicts)
    assert found > 5
    assert passed >= 12


def test_a_mirrored_section_of_one_element_is_seen_in_any_state():
    """det [r_x r_y] of unit slopes, one turned round: its sign says it."""
    ends, lengths, least = np.arange(6)[None], np.ones(1), np.full(1, 1 / 3)
    straight = np.array([[0, 0], [1, 0], [0, 1], [1, 0], [1, 0], [0, 1]], dtype=float)
    turned = straight.copy()
    turned[5] = 0, -1
    for states, kept in (((straight, straight), True), ((straight, turned), False)):
        q = np.array(states).reshape(len(states), -1)
        assert keeps_sides(q, ends, 2, lengths, least) is kept
    # All states keep the sign of a mirrored start.
    mirrored = straight * [1, -1]
    q = np.array([mirrored, 1.1 * mirrored]).reshape(2, -1)
    assert keeps_sides(q, ends, 2, lengths, least)
    # An axis of stretch 0.57 is crushed, of 0.58 it is not.
    for stretch, kept in ((0.57, False), (0.58, True)):
        axis = straight * [stretch, 1.0]
        assert (
            keeps_sides(np.array([straight, axis]).reshape(2, -1), ends, 2, lengths, least) is kept
        )
    with pytest.raises(ValueError, match="vectors"):
        keeps_sides(straight.reshape(1, -1), ends + 1, 2, lengths, least)


def test_each_beam_of_a_scene_is_judged_as_it_is_alone():
    """Beams of one type are checked together; other beams beside them change nothing."""

    def beam(name, y, height, elements, element):
        section = Rectangle(height, 0.02) if element is BEAM_3D else Circle(height)
        return Beam(name, (0, y, 0), (1, y, 0), elements, section, RUBBER, element=element)

    beams = [
        beam("a", 0, 0.1, 4, BEAM_3D),
        beam("b", 1, 0.01, 3, CABLE_3D),
        beam("c", 2, 0.05, 7, BEAM_3D),
        beam("d", 3, 0.02, 2, CABLE_3D),
    ]
    whole, random = assemble(Scene(beams, [Clamp(x.at_start) for x in beams])), np.random
    random = random.default_rng(1)
    alone = [assemble(Scene([x], [Clamp(x.at_start)])) for x in beams]
    sizes = np.cumsum([0] + [each.n_q for each in alone])
    seen = np.zeros(3, dtype=int)
    for size in (0.01, 0.05, 0.1, 0.4):
        for _ in range(10):
            parts = [x.start()[0] + size * random.standard_normal(x.n_q) for x in alone]
            q = np.concatenate(parts)
            assert sizes[-1] == whole.n_q
            texts = [x.folded(part) for x, part in zip(alone, parts, strict=True)]
            assert whole.folded(q) == "; ".join(filter(None, texts))
            for k, which in enumerate(("coarse", "strained")):
                apart = {}
                more = (False,) if which == "coarse" else ()
                for x, part in zip(alone, parts, strict=True):
                    apart |= getattr(x, which)(part[None] if more else part, *more)
                together = getattr(whole, which)(q[None] if more else q, *more)
                assert together == pytest.approx(apart, rel=1e-12)
                seen[k] += len(apart)
            seen[2] += any(texts)
    assert np.all(seen > 3)


def test_a_section_that_is_folded_at_its_corner_only_is_folded():
    """A twist of half a turn between the ends of a deep, short element turns its corner inside out.

    The least determinant is at a corner of the outline: on the axis all is well.
    """
    beam = Beam("deep", (0, 0), (0.1, 0), 1, Rectangle(0.4, 0.1), RUBBER)
    other = Beam("slender", (0, 1), (0.1, 1), 1, Rectangle(0.002, 0.1), RUBBER)
    system = assemble(Scene([beam, other], [Clamp(beam.at_start), Clamp(other.at_start)]))
    q = system.start()[0].reshape(2, -1, 2)
    # Both ends of each turn towards each other: r_xy of the section shortens one side.
    for vectors in q:
        vectors[2] = np.sin(0.3), np.cos(0.3)
        vectors[5] = -np.sin(0.3), np.cos(0.3)
    words = system.folded(q.ravel())
    assert "'deep'" in words
    assert "'slender'" not in words
