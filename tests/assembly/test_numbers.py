"""A system at other values of its design is what an assembly there gives, bit by bit.

Numbers that no changed variable reaches are taken over, the others are made on the structure that
is there: whatever was left out of what a variable reaches shows as a difference here.
"""

import pickle
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    DirectDifferentiation,
    Distance,
    EquilibriumStart,
    InitialVelocity,
    Material,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Revolute,
    RigidBody,
    Scene,
    Terminal,
    Universal,
    Weld,
    assemble,
    gradient,
    simulate,
)
from ancfdae.assembly import closing, inertia
from ancfdae.assembly.assembly import Assembly
from ancfdae.assembly.block import ElementBlock
from ancfdae.assembly.numbers import Numbers
from ancfdae.assembly.system import AncfSystem
from ancfdae.errors import InvalidInputError
from ancfdae.extend import Joint, MaterialPoint
from ancfdae.model.design import design_numbers
from ancfdae.model.joints.axis_joint import AxisJoint
from ancfdae.model.joints.joint import empty_equations
from ancfdae.numerics.threads import in_one_thread
from ancfdae.observables import position
from ancfdae.sections import Rectangle
from tests.support.design_cases import CASES
from tests.support.scenes import SCENES
from validation.performance.mechanisms import flexible_slider_crank

STEEL = Material(7800, 2e11, 0.3)


def given(system, b):
    """What a system at other values is made of."""
    structure = system._structure
    return structure.scene, structure.design, structure.mapping, b


@in_one_thread  # As in `assemble`: sums over several threads round otherwise.
def anew(system):
    """The same system with a structure of its own."""
    return AncfSystem(Numbers.first(*given(system, system.b)))


def values(system, t=0.3):
    """Everything that a run reads, at a state of no special kind."""
    generator = np.random.default_rng(5)
    q = system._reference.q.real + 0.01 * generator.uniform(-1, 1, system.n_q)
    v, a = generator.uniform(-1, 1, (2, system.n_q))
    lam = generator.uniform(-1, 1, system.n_lam)
    states = q[None], v[None], a[None], lam[None]
    time = np.array([t])
    yield system.mass(q)
    yield system.force(t, q, v)
    yield system.constraint(t, q, v, a)
    local = system.linearise(time, *states)
    yield from (local.M, local.f_q, local.f_q if local.f_v is None else local.f_v, local.Phi_q)
    if not np.iscomplexobj(system.b):  # Partials are those of real systems.
        partials = system.design_partials(time, *states)
        yield from (partials.f_b, partials.Phi_b)
    yield from (system.pattern.columns, system.constraint_pattern.columns, system.weights)
    yield from (system.naming.lengths, system._reference.Z)
    yield np.array([system.traits.force_round_off])


def require_equal(system):
    other = anew(system)
    for ours, theirs in zip(values(system), values(other), strict=True):
        assert ours.dtype == theirs.dtype
        assert np.array_equal(ours, theirs)
    assert system.traits == other.traits


@pytest.mark.parametrize("case", CASES)
def test_each_variable_moved_by_itself_gives_what_an_assembly_gives(case):
    scene, design = CASES[case]
    system = assemble(SCENES[scene](), design)
    for i in range(system.n_b):
        b = system.b.copy()
        b[i] = 1.01 * b[i] if b[i] else 0.01
        # The one before stays moved: numbers come from numbers that came from others.
        try:
            system = system.with_values(b)
        except InvalidInputError:  # A cable in space has no section that is wider than high.
            continue
        require_equal(system)
    if system.n_b:
        moved = system.b.astype(complex)
        moved[0] += 1e-40j
        require_equal(system.with_values(moved))
        require_equal(system.with_values(moved).with_values(system.b))


def crank(**settings):
    """A crank and a rod of cables, one degree of freedom, as a mechanism that closes."""
    arm = RigidBody("arm", (0, 0), 1.0, 0.01, centre=(0.1, 0))
    rod = Beam("rod", (0.2, 0), (0.7, 0), 2, Rectangle(0.01, 0.01), STEEL)
    joints = [
        Pin(arm.at(0, 0)),
        Pin(arm.at(0.2, 0), rod.at_start),
        PointOnLine(rod.at_end, direction=(1, 0), name="guide"),
    ]
    return Scene([rod], joints, (0, -9.81), bodies=[arm], **settings)


@pytest.mark.parametrize("settings", [{}, {"assemble": True}, {"project_start": True}])
def test_a_variable_that_moves_no_body_leaves_the_closed_start_as_it_is(settings, monkeypatch):
    system = assemble(crank(**settings), ["rod.youngs_modulus", "arm.mass", "rod.length"])
    start, start_b = system.start(), system.start_b()

    def closed_again(*_):
        raise AssertionError("the start is closed again")

    monkeypatch.setattr(Assembly, "_search", closed_again)
    stiffer = system.with_values(system.b * [1.5, 0.5, 1.0])
    for ours, theirs in zip(
        (*start, *start_b), (*stiffer.start(), *stiffer.start_b()), strict=True
    ):
        assert np.array_equal(ours, theirs)
    with pytest.raises(AssertionError, match="closed again"):
        stiffer.with_values(system.b * [1.0, 1.0, 1.01]).start()


def test_a_run_at_other_values_is_that_of_the_scene_at_these_values():
    names = ["rod.youngs_modulus", "arm.mass"]
    system = assemble(crank(), names)
    moved = system.with_values(system.b * [2.0, 3.0])
    scene = crank().with_values(dict(zip(names, moved.b.tolist(), strict=True)))
    other = assemble(Scene(scene.beams, scene.joints, scene.gravity, bodies=scene.bodies), names)
    method, end = HHT(2.0**-8), Terminal(position(scene.beams[0].at_end, 0))
    ours, theirs = (simulate(x, 0.125, method) for x in (moved, other))
    assert np.array_equal(ours.q, theirs.q)
    ours, theirs = (
        gradient(x, end, 0.125, method, method=DirectDifferentiation()) for x in (moved, other)
    )
    assert np.array_equal(ours.gradient, theirs.gradient)


def test_a_mass_that_comes_to_another_element_and_back():
    rod = Beam("rod", (0, 0), (1.2, 0), 2, Rectangle(0.01, 0.01), STEEL)
    scene = Scene([rod], [Pin(rod.at_start)], bodies=[PointMass(rod.at(0.3), 0.5, name="bob")])
    system = assemble(scene, ["bob.point_fraction", "bob.mass"])
    for fraction in (0.4, 0.7, 0.6, 0.2):
        system = system.with_values(np.array([fraction, 0.5]))
        require_equal(system)
        # A turn about the pin, in closed form: the rod, its sections, and the bob at its place.
        turn = np.zeros((system.n_q // 2, 2))
        turn[::3, 1], turn[1::3, 1], turn[2::3, 0] = (0.0, 0.6, 1.2), 1.0, -1.0
        inertia_of_rod = STEEL.density * 1.2 * (1e-4 * 1.2**2 / 3 + 1e-8 / 12)
        found = turn.ravel() @ system.mass_times(turn.ravel(), turn.ravel())
        assert found == pytest.approx(inertia_of_rod + 0.5 * (1.2 * fraction) ** 2, rel=1e-12)


@dataclass(frozen=True)
class SmoothStep(Joint):
    """A point on a line whose slope is one less the cosine of an angle."""

    point: MaterialPoint
    angle: float

    kind = "ramp"
    design_fields = design_numbers("angle")

    def coefficients(self, p, reference):
        c = empty_equations(1, p, reference)
        c.linear[0, 0] = 1.0 - np.cos(p[0]), 1.0
        return c


def test_a_coefficient_that_appears_makes_another_structure():
    """At an angle of zero the slope vanishes, and its derivative too: no generic step shows it."""
    rod = Beam("rod", (0.0, 0.0), (0.5, 0.0), 2, Rectangle(0.01, 0.01), STEEL)
    joints = [Pin(rod.at_start), SmoothStep(rod.at_end, 0.0, name="ramp")]
    system = assemble(Scene([rod], joints), ["ramp.angle"])
    turned = system.with_values(np.array([0.5]))
    assert turned.constraint_pattern.size == system.constraint_pattern.size + 1
    require_equal(turned)


def closed(scene, design):
    """Start and its derivatives where the design has moved what closes it."""
    system = assemble(scene, design)
    moved = system.with_values(system.b * 1.01 + 1e-3 * (system.b == 0))
    return [*moved.start(), *moved.start_b()]


def stretched():
    """A crank and a rod that are 1 % too short, so that bodies are strained."""
    scene = flexible_slider_crank(2)
    crank, rod = scene.beams
    end = Pin(rod.at_end, ground=(0.552, 0.0))
    joints = [Pin(crank.at_start), Pin(crank.at_end, rod.at_start), end]
    return Scene([crank, rod], joints, project_start=True)


def hinged():
    """Two bodies in space, a hinge between them and a strut; one leads."""
    base = RigidBody("base", (0, 0, 0), 1.0, (0.2, 0.25, 0.3))
    arm = RigidBody("arm", (1, 0, 0), 1.0, (0.2, 0.25, 0.3))
    joints = [
        Revolute(base.at(0, 0, 0), (0, 0, 1)),
        Revolute(arm.at(-0.5, 0, 0), (0, 0.6, 0.8), base.at(0.5, 0, 0)),
        Distance(arm.at(0.5, 0, 0), length=1.0, ground=(1.5, 1.0, 0.0)),
    ]
    return Scene([], joints, (0, -9.81, 0), bodies=[base, arm], lead=["base"])


@pytest.mark.parametrize(
    ("scene", "design"),
    [
        (flexible_slider_crank(2), ["crank.length", "rod.length"]),
        (stretched(), ["crank.length", "rod.length"]),
        (hinged(), ["base.turn_z", "arm.position_x"]),
    ],
    ids=["closes", "strains", "space"],
)
def test_small_mechanisms_close_by_arrays_as_large_ones_do_by_sparse_matrices(
    scene, design, monkeypatch
):
    by_arrays = closed(scene, design)
    equations = assemble(scene, design)._start._assembly.closing
    generator, count = np.random.default_rng(1), len(equations.start(True)[0])
    x, sigma, rho = (generator.uniform(-0.1, 0.1, n) for n in (count, *[equations.rows] * 2))
    none = np.zeros(0)
    small = [equations.matrix_at((x, *rest)) for rest in ((sigma, rho), (none, none))]
    monkeypatch.setattr(closing, "DENSE", 0)
    # Sums of some tens of products of numbers of size one.
    for ours, rest in zip(small, ((sigma, rho), (none, none)), strict=True):
        theirs = replace(equations).matrix_at((x, *rest)).toarray()
        assert ours.shape == theirs.shape
        assert np.max(np.abs(ours - theirs)) <= 1e-13 * np.max(np.abs(theirs))
    # Newton's method goes on until the last correction is round-off of the first.
    for ours, theirs in zip(by_arrays, closed(scene, design), strict=True):
        assert np.max(np.abs(ours - theirs)) <= 1e-11 * np.max(np.abs(theirs), initial=1e-300)


def test_an_equilibrium_is_searched_on_the_structure_that_is_there(monkeypatch):
    """A moved system, of other loads and gravity, has the start of an assembly there."""
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.02, 0.02), Material(1000, 1e7, 0.0))
    pull = PointForce(rod.at_end, (0.0, -0.1), name="pull")
    rest = EquilibriumStart(loads=[pull], gravity=(0.0, -3.0))
    scene = Scene([rod], [Clamp(rod.at_start)], (0, -9.81), start=[rest])
    design = ["rod.youngs_modulus", "rod.length", "pull.force_y", "scene.gravity_y"]
    system = assemble(scene, design)
    system.start()
    b, factors = system.b, [*(1 + 0.1 * np.eye(4)), np.full(4, 1.1)]
    expected = [AncfSystem(Numbers.first(*given(system, b * each))).start()[0] for each in factors]
    monkeypatch.setattr(Numbers, "first", None)
    starts = []
    for each in factors:
        # The one before stays moved.
        system = system.with_values(b * each)
        starts.append(system.start()[0])
    assert all(np.array_equal(*pair) for pair in zip(starts, expected, strict=True))
    # Gravity of the motion moves no equilibrium that has its own; the others do.
    assert len({start.tobytes() for start in starts}) == 5


def test_equal_joints_are_prepared_once_and_have_the_equations_of_each_alone(monkeypatch):
    """Three of six hinges are computed: to ground, between beams, and with another axis."""
    section, counts = Rectangle(0.02, 0.03), []
    beams = [Beam(f"b{k}", (k, 0, 0), (k + 1, 0, 0), 1, section, STEEL) for k in range(12)]
    turned = [Revolute(beams[0].at_start, (0, 0.6, 0.8))]
    axis = (0, 0.6, 0.8)
    for k, (left, right) in enumerate(pairwise(beams)):
        points = left.at_end, right.at_start
        hinge = Revolute(points[0], (0, 0, 1) if k == 7 else axis, points[1])
        others = {2: Weld(*points), 3: Weld(*points), 5: Pin(*points), 6: Pin(*points)}
        others |= {k: Universal(points[0], axis, (0, 0, 1), points[1]) for k in (8, 9)}
        turned.append(others.get(k, hinge))
    coefficients = Revolute.coefficients

    def counted(self, p, reference):
        counts.append(p.dtype.kind)
        return coefficients(self, p, reference)

    monkeypatch.setattr(Revolute, "coefficients", counted)
    system = assemble(Scene(beams, turned, gravity=(0, 0, -9.81)))
    assert counts.count("f") == 3
    shared = system.inputs.joints().slots
    for kind in (AxisJoint, Pin, Weld, Universal):
        monkeypatch.setattr(kind, "by_slopes", False)
    alone = assemble(system._scene).inputs.joints().slots
    # Every beam has a right angle at each end, and no joint repeats that of another.
    assert sum(len(slot.item.dropped) for slot in alone) == 0
    for mine, its in zip(shared, alone, strict=True):
        assert mine.item.dropped == its.item.dropped
        for x, y in zip(mine.item.parts, its.item.parts, strict=True):
            assert np.array_equal(x.linear, y.linear)
            assert np.array_equal(x.bilinear, y.bilinear)
            assert np.array_equal(x.offset, y.offset)


@pytest.mark.parametrize(
    ("name", "value"),
    [("density", -1.0), ("youngs_modulus", 0.0), ("poisson_ratio", 0.5), ("height", -0.1)],
)
def test_a_value_that_a_beam_cannot_take_is_refused_in_the_words_of_the_scene(name, value):
    """Materials are checked without making the beam; the error names the variable either way."""
    system = assemble(crank(), [f"rod.{name}"])
    with pytest.raises(InvalidInputError) as ours:
        system.with_values(np.array([value]))
    with pytest.raises(InvalidInputError) as theirs:
        system._scene.with_values({system._structure.design[0]: value})
    assert str(ours.value) == str(theirs.value)


def test_other_values_make_derivatives_only_when_they_are_asked_for(monkeypatch):
    """A run at other moduli needs no derivative; the first use makes them, as an assembly does."""
    system, made = assemble(crank(), ["rod.youngs_modulus"]), []
    whole = ElementBlock.partials.func
    counted = cached_property(lambda block: (made.append(1), whole(block))[1])
    counted.__set_name__(ElementBlock, "partials")
    monkeypatch.setattr(ElementBlock, "partials", counted)
    moved = system.with_values(2 * system.b)
    simulate(moved, 0.0625, HHT(2.0**-8))
    assert not made
    require_equal(moved)
    assert made


def test_a_point_off_the_axis_must_stay_in_a_section_that_shrinks():
    """Sections alone are checked where all points lie on the axis, the scene where one does not."""
    load = PointForce(MaterialPoint("rod", 0.5, y=0.004), (0.0, -1.0))
    material = Material(1000.0, 1e7, 0.3)
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.01, 0.01), material)
    system = assemble(Scene([rod], [Clamp(rod.at_start)], loads=[load]), ["rod.height"])
    require_equal(system.with_values(np.array([0.0081])))
    with pytest.raises(InvalidInputError, match="section"):
        system.with_values(np.array([0.0079]))
    free = assemble(Scene([rod], [Clamp(rod.at_start)]), ["rod.height"])
    require_equal(free.with_values(np.array([0.0079])))


@pytest.mark.parametrize("asked", [False, True])
def test_a_system_travels_with_the_derivatives_that_nobody_asked_for_yet(asked):
    """Pickled before or after the first use of derivatives, and moved there, it is the same."""
    system = assemble(crank(), ["rod.youngs_modulus", "rod.height", "arm.mass"])
    if asked:
        require_equal(system)
    there = pickle.loads(pickle.dumps(system))
    require_equal(there)
    require_equal(there.with_values(1.01 * system.b))


def rigid_chain():
    """Three rigid beams of different heights, the second of several elements, and a rigid body."""
    beams, joints = [], []
    for k, height in enumerate((0.01, 0.02, 0.03)):
        beam = Beam(
            f"b{k}", (k, 0), (k + 1, 0), 1 + k % 2, Rectangle(height, 0.02), STEEL, rigid=True
        )
        other = {"other": beams[-1].at_end} if beams else {}
        joints.append(Pin(beam.at_start, **other))
        beams.append(beam)
    load = RigidBody("load", (3, 0), 1.0, 0.01)
    return Scene(beams, [*joints, Pin(load.at(0, 0), beams[-1].at_end)], (0, -9.81), bodies=[load])


def test_masses_of_rigid_beams_are_made_again_where_their_numbers_change(monkeypatch):
    """One beam's density leaves the masses of the others as they are, and its own changes."""
    made, whole = [], inertia._of_rigid_beam

    def counted(beam, *rest):
        made.append(beam.name)
        return whole(beam, *rest)

    system = assemble(rigid_chain(), ["b1.density", "b2.height", "load.mass", "b0.length"])
    monkeypatch.setattr(inertia, "_of_rigid_beam", counted)
    for factors in ([1.1, 1, 1, 1], [1.1, 1.2, 1, 1], [1.1, 1.2, 1.3, 1], [1.1, 1.2, 1.3, 1.4]):
        made.clear()
        moved = system.with_values(system.b * factors)
        assert len(made) < 3
        require_equal(moved)
    # Back and forth: what was kept belongs to other values.
    require_equal(moved.with_values(system.b))
    require_equal(system.with_values(system.b * 1.1))


@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_rigid_beams_have_the_mass_of_beams_that_deform(turned):
    """No stiffness is integrated for them; m = sum of W^T m_e W with W of a rigid motion."""
    settings = {"turn": turned, "material": STEEL, "section": Rectangle(0.02, 0.03)}
    motion = InitialVelocity("rod", 0.7, (0, 0), (0.3, -0.2))
    energies = []
    for is_rigid in (True, False):
        beam = Beam("rod", (0, 0), (1, 0.2), 3, rigid=is_rigid, **settings)
        system = assemble(Scene([beam], start=[motion]), ["rod.height"])
        q, v = system.start()
        energies.append(0.5 * v @ system.mass_times(q, v))
    assert energies[0] == pytest.approx(energies[1], rel=1e-13)
