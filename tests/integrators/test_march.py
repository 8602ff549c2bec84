"""Steps with equations of the kernel and of Python are the same steps, for every kind of part.

SAME: elastic forces have the round-off eps E A, over the mass of a slope that of accelerations,
2e-16 * 1e2 N / 1e-4 kg = 2e-10 m/s^2 beside 1e1 m/s^2, with a factor of 1e2 for six steps. A term
that is missing or wrong in the kernel shows at 1e-3 and more.
"""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    HHT,
    AdaptiveSteps,
    Adjoint,
    Beam,
    Clamp,
    DirectDifferentiation,
    Distance,
    Integral,
    Material,
    Pin,
    PointForce,
    PointMass,
    PrescribedSteps,
    Radau,
    RigidBody,
    RotationDriver,
    Scene,
    Terminal,
    TranslationDriver,
    assemble,
    differentiate,
    gradient,
    kernels,
    simulate,
)
from ancfdae.equations import reaction
from ancfdae.equations import saddle_points as prepared
from ancfdae.equations import system as equations_of_systems
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.equations.system import called_plan
from ancfdae.errors import InconsistentStartError, RedundantConstraintsError
from ancfdae.extend import MaterialPoint
from ancfdae.integrators.hht import step
from ancfdae.laws import Harmonic, UserLaw
from ancfdae.model import joints, loads
from ancfdae.model.bodies import Quantity
from ancfdae.model.design import design_numbers
from ancfdae.model.joints.joint import Joint
from ancfdae.model.loads.load import LAW_FIELD, Load
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.observables import multiplier, position, velocity
from ancfdae.sections import Rectangle
from tests.support.examples import all_examples, law_examples, public_classes, scene_of
from validation.scenes import crank_slider, pendulum

SAME, STEP, COUNT = 2e-9, 2.0**-9, 6
RUBBER = Material(1100.0, 5e4, 0.3)
SECTION = Rectangle(0.05, 0.04)


def by_python(monkeypatch):
    """Let functions of Python evaluate the equations."""
    monkeypatch.setattr(prepared, "planned", called_plan)


def refuse(*_):
    raise AssertionError("a step was left to Python")


def only_the_kernel(monkeypatch):
    monkeypatch.setattr(equations_of_systems, "called_plan", refuse)
    monkeypatch.setattr(step, "solved", refuse)


def assert_same(system, one, other, tolerance=SAME):
    """Compare runs in the norm of the inertia, multipliers beside the inertia forces too."""
    assert one.outcome.verdict is other.outcome.verdict
    root = np.sqrt(system.weights)
    inertia = np.max(np.abs(other.a * system.weights))
    for name, factor in (("t", 1), ("q", root), ("v", root), ("a", root)):
        x, y = getattr(one, name) * factor, getattr(other, name) * factor
        assert np.max(np.abs(x - y)) <= tolerance * np.max(np.abs(y)), name
    size = max(np.max(np.abs(other.lam), initial=0), inertia)
    assert np.max(np.abs(one.lam - other.lam), initial=0) <= tolerance * size


def compared(scene, integrator=None, t_end=COUNT * STEP, tolerance=SAME):
    system = assemble(scene)
    integrator = integrator or HHT(STEP)
    with pytest.MonkeyPatch.context() as patch:
        only_the_kernel(patch)
        fast = simulate(system, t_end, integrator)
    with pytest.MonkeyPatch.context() as patch:
        by_python(patch)
        slow = simulate(system, t_end, integrator)
    assert_same(system, fast, slow, tolerance)
    # Where round-off decides whether an iteration was the last one may be more.
    more = fast.statistics.iterations - slow.statistics.iterations
    assert abs(more) <= fast.statistics.steps
    return fast


def beams(d, **kind):
    z = (0.2,) * (d - 2)
    rod = Beam("rod", (0.1, 0.2, *z), (0.9, 0.7, *z), 2, SECTION, RUBBER, **kind)
    return rod, Beam("arm", (0.9, 0.7, *z), (1.5, 0.4, *z), 1, SECTION, RUBBER, **kind)


KINDS = {"planar": beams(2), "spatial": beams(3), "cable": beams(2, element=CABLE_2D)}


@pytest.mark.parametrize("kind", KINDS)
def test_every_joint_is_the_same_in_the_kernel(kind):
    members, ran = KINDS[kind], set()
    points = members[1].at(0.4), members[0].at(0.8)
    gravity = (0.0, -9.81, 0.0)[: members[0].dimension]
    for joint in all_examples(joints, Joint, members, points).values():
        scene = replace(scene_of(members, joint), gravity=gravity, project_start=True)
        try:
            compared(scene)
        except (InconsistentStartError, RedundantConstraintsError):
            continue
        ran.add(type(joint).__name__)
    assert len(ran) >= len(public_classes(joints, Joint)) - (9 if kind != "spatial" else 3), ran


@pytest.mark.parametrize("law", law_examples().values(), ids=law_examples())
def test_every_law_is_the_same_in_the_kernel(law):
    rod, arm = KINDS["planar"]
    held = [
        Pin(rod.at_start),
        Pin(rod.at_end, arm.at_start),
        TranslationDriver(arm.at_end, (0.6, 0.8), law),
    ]
    pulled = [PointForce(rod.at_end, (3.0, -2.0), law=law), PointForce(arm.at_end, (1.0, 1.0))]
    compared(Scene([rod, arm], held, (0, -9.81), loads=pulled, project_start=True))


@pytest.mark.parametrize("kind", ["planar", "spatial"])
def test_every_load_is_the_same_in_the_kernel(kind):
    members = KINDS[kind]
    points = members[1].at(0.4), members[0].at(0.8)
    for load in all_examples(loads, Load, members, points).values():
        scene = replace(scene_of(members, load), joints=[Clamp(members[0].at_start)])
        compared(replace(scene, project_start=True), t_end=2 * STEP)


@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("kind", KINDS)
def test_every_element_is_the_same_in_the_kernel(kind, damping):
    rod, arm = (replace(x, material=replace(RUBBER, damping_time=damping)) for x in KINDS[kind])
    masses = [PointMass(arm.at_end, 0.3, name="mass")]
    gravity = (0.0, -9.81, 0.0)[: rod.dimension]
    compared(Scene([rod, arm], [Clamp(rod.at_start)], gravity, bodies=masses))


def test_rigid_bodies_are_the_same_in_the_kernel():
    bodies = [RigidBody(f"b{k}", (0.5 * k, 0.0), 1.0, 0.02, centre=(0.2, 0.1)) for k in range(3)]
    held = [Pin(bodies[0].at(0, 0)), Pin(bodies[0].at(0.5, 0), bodies[1].at(0, 0))]
    held.append(Distance(bodies[1].at(0.5, 0), 0.2, bodies[2].at(0.0, 0.2)))
    compared(Scene([], held, (0, -9.81), bodies=bodies))


def test_small_steps_take_the_increment_of_the_constraints_in_the_kernel():
    # At 1e-9 s round-off of Phi over h^2 is 1e2 m/s^2; quiet constraints leave 1e-9 of the motion,
    # in a run of ten such steps a hundred times that.
    rod, arm = KINDS["planar"]
    joint = [Pin(rod.at_start), Distance(rod.at_end, 0.7, arm.at_end)]
    joint.append(RotationDriver(rod.at_start, Harmonic(0.5, 4.0)))
    scene = Scene([rod, arm], joint, (0, -9.81), project_start=True)
    compared(scene, HHT(1e-9), 1e-8, 1e-6)


def test_small_steps_of_a_drive_take_its_direction_where_it_is():
    # The drive turns the direction that its equation measures by 40 rad/s x 1e-5 s in a step; with
    # the Gauss points of a step exchanged the acceleration would err by a part 3e-5. Quiet
    # constraints leave 1e-9 of the motion in a step, in ten steps a hundred times that at most.
    rod = RigidBody("rod", (0.0, 0.0), 1.0, 0.02, centre=(0.2, 0.1))
    joint = [Pin(rod.at(0, 0)), RotationDriver(rod.at(0, 0), Harmonic(0.5, 40.0))]
    compared(Scene([], joint, (0, -9.81), bodies=[rod], project_start=True), HHT(1e-5), 1e-4, 1e-7)


def test_steps_that_jump_are_the_same_in_the_kernel():
    t = np.cumsum([0.0, STEP, 3 * STEP, STEP / 2, 2 * STEP])
    compared(pendulum(), HHT(PrescribedSteps(tuple(t.tolist()))), float(t[-1]))


def test_the_first_step_is_measured_by_the_forces_at_its_beginning():
    # The load is 1e-5 N at t = 0 and grows to 1e4 N in the first step. Newton's method counts at
    # most a hundred times the forces before and goes on to the digits that these have: 10
    # iterations, in the kernel as in Python up to round-off, and 6 measured by the forces at the
    # end.
    rod = RigidBody("rod", (0.0, 0.0), 1.0, 0.02, centre=(0.2, 0.1))
    law = UserLaw(lambda t: 1e-9 + (t / STEP) ** 4)
    push = PointForce(rod.at(0.5, 0.0), (0.0, 1e4), law=law)
    system, counts = assemble(Scene([], [Pin(rod.at(0, 0))], bodies=[rod], loads=[push])), []
    for patched in (only_the_kernel, by_python):
        with pytest.MonkeyPatch.context() as patch:
            patched(patch)
            counts.append(simulate(system, STEP, HHT(STEP)).statistics.iterations)
    assert abs(counts[0] - counts[1]) <= 1


def test_the_motion_that_a_step_hands_on_is_that_of_its_end():
    # Inertia, reactions and forces in the norms of the description of `motion_size`. Forces are
    # those before the last correction, which is below the root of the tolerance, 1e-7.
    system = assemble(crank_slider())
    replay = HHT(2.0**-7).replay(system, 2.0**-4)
    node, w = replay.start(), system.weights
    for n in range(8):
        _, node = replay.part(node, n, n + 1)
        held = reaction(system, node.t, node.q, node.lam)
        forces = held, system.force(node.t, node.q, node.v)
        size = np.sqrt(np.sum(w * node.a**2)) + sum(np.sqrt(np.sum(x**2 / w)) for x in forces)
        assert node.motion == pytest.approx(size, rel=1e-6)


def test_controlled_steps_are_the_same_in_the_kernel():
    compared(pendulum(), HHT(steps=AdaptiveSteps(1e-4)), 0.1)


def test_more_steps_than_a_packet_are_the_same_in_the_kernel():
    assert compared(pendulum(), HHT(2.0**-12), 300 * 2.0**-12).statistics.steps == 300


def test_a_node_that_is_kept_holds_no_rows_of_its_part():
    # Checkpoints are nodes: views would keep the states of every part in memory.
    replay = HHT(2.0**-7).replay(assemble(pendulum()), 2.0**-3)
    _, node = replay.part(replay.start(), 0, 8)
    assert all(x.base is None for x in (node.q, node.v, node.a, node.lam, node.A))


def test_a_hard_step_in_a_packet_is_taken_by_python(monkeypatch):
    # Four iterations do not solve every step from the guess; continuation does, in both.
    system, integrator = assemble(crank_slider()), HHT(2.0**-6, max_iterations=4)
    fast = simulate(system, 0.25, integrator)
    by_python(monkeypatch)
    slow = simulate(system, 0.25, integrator)
    assert fast.statistics.steps > fast.statistics.continued > 0
    assert_same(system, fast, slow)


def test_threads_march_side_by_side_as_alone():
    systems = [assemble(crank_slider()), assemble(pendulum())] * 2
    alone = [simulate(system, 0.0625, HHT(2.0**-10)).q for system in systems]
    together = [None] * len(systems)

    def run(k):
        together[k] = simulate(systems[k], 0.0625, HHT(2.0**-10)).q

    threads = [threading.Thread(target=run, args=(k,)) for k in range(len(systems))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(x, y) for x, y in zip(alone, together, strict=True))


@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint()], ids=repr)
def test_gradients_in_threads_are_those_alone_to_the_last_bit(method):
    scene, h = crank_slider(), 2.0**-10
    objective = Integral(position(scene.beams[-1].at_end, 0))
    systems = [assemble(scene, [f"{x.name}.height" for x in scene.beams[:k]]) for k in (1, 2, 1, 2)]

    def of(system):
        return gradient(system, objective, 64 * h, HHT(h), method=method).gradient

    alone = [of(system) for system in systems]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(of, systems))
    assert all(np.array_equal(x, y) for x, y in zip(alone, together, strict=True))


# ---------------------------------------------------------------- passes


def assert_same_passes(system, objective, integrator, t_end):
    """Direct and adjoint derivatives, with equations of the kernel and of Python; see SAME."""
    values = []
    for patched in (only_the_kernel, by_python):
        with pytest.MonkeyPatch.context() as patch:
            patched(patch)
            direct = differentiate(system, t_end, integrator).sensitivities
            adjoint = gradient(system, objective, t_end, integrator, method=Adjoint()).gradient
        values.append((direct.q_b, direct.v_b, direct.a_b, direct.lam_b, adjoint))
    for x, y in zip(*values, strict=True):
        assert np.max(np.abs(x - y)) <= SAME * np.max(np.abs(y))


@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("kind", KINDS)
def test_passes_of_every_element_are_the_same_in_the_kernel(kind, damping):
    rod, arm = (replace(x, material=replace(RUBBER, damping_time=damping)) for x in KINDS[kind])
    joined = [Clamp(rod.at_start), Pin(rod.at_end, arm.at_start)]
    gravity = (0.0, -9.81, 0.0)[: rod.dimension]
    design = ["rod.density", "rod.youngs_modulus", "arm.length", "rod.damping_time"]
    system = assemble(Scene([rod, arm], joined, gravity, assemble=True), design)
    objective = Integral(position(arm.at_end, 1))
    assert_same_passes(system, objective, HHT(STEP), COUNT * STEP)
    given = PrescribedSteps((0.0, STEP, 1.5 * STEP, 2.25 * STEP))
    assert_same_passes(system, Terminal(position(arm.at_end, 0)), HHT(given), 2.25 * STEP)


def test_passes_of_driven_joints_are_the_same_in_the_kernel():
    # Phi depends on time and design, and in the distance on products, which have a curvature;
    # objectives have seeds on q, v and lam.
    rod, arm = KINDS["planar"]
    held = [Pin(rod.at_start), RotationDriver(rod.at_start, Harmonic(0.5, 40.0))]
    held.append(Distance(rod.at_end, 0.3, arm.at_end, name="bar"))
    scene = Scene([rod, arm], held, (0, -9.81), project_start=True)
    system = assemble(scene, ["rod.youngs_modulus", "arm.density", "rod.length", "bar.length"])
    for of in (position(arm.at_end, 1), velocity(arm.at_end, 1), multiplier("bar", 0)):
        assert_same_passes(system, Integral(of**2), HHT(STEP), COUNT * STEP)


def test_passes_of_every_load_are_the_same_in_the_kernel():
    members = KINDS["planar"]
    points = members[1].at(0.4), members[0].at(0.8)
    moves, gravity = (
        Integral(position(members[0].at_end, 1)),
        (0.0, -9.81, 0.0)[: members[0].dimension],
    )
    for load in all_examples(loads, Load, members, points).values():
        if load.touches:  # These steps do not resolve it; tests/physics/test_contact.py does.
            continue
        held = {"joints": [Clamp(members[0].at_start)], "gravity": gravity}
        scene = replace(scene_of(members, load), project_start=True, **held)
        system = assemble(scene, ["rod.density", "rod.height"])
        assert_same_passes(system, moves, HHT(STEP), 2 * STEP)


@dataclass(frozen=True)
class Across(Load):
    """A force across the velocity of a point, as on a spinning ball: its Q_v is antisymmetric."""

    point: MaterialPoint
    strength: float

    kind = "across"
    damping_fields = ("strength",)
    design_fields = (*design_numbers("strength"), LAW_FIELD)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION),)

    def force(self, U, V, p, U_o):
        return p[0] * V @ np.array([[0.0, 1.0], [-1.0, 0.0]])


def test_passes_of_a_force_across_the_velocity_are_the_same_in_the_kernel():
    # The force is as large as the inertia forces: 4 kg x 1e2 /s beside 1e3 N s/m in a step of
    # 2e-3 s; that of Q_v for its transpose changes the gradient by its whole size.
    rod, _ = KINDS["planar"]
    spin = Across(rod.at_end, 200.0, name="spin")
    scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81), loads=[spin])
    system = assemble(scene, ["rod.density", "spin.strength"])
    assert_same_passes(system, Integral(position(rod.at_end, 0)), HHT(STEP), 4 * COUNT * STEP)


@pytest.mark.parametrize("integrator", [HHT(STEP), Radau(STEP)], ids=["HHT", "Radau"])
def test_passes_go_on_where_a_matrix_is_not_positive_definite(integrator, monkeypatch):
    # The envelope refuses every matrix, so that the band takes over, in the kernel and in Python.
    def spoilt(self, band):
        layout = layout_of(self, band)
        if layout.envelope is None:  # the coupled matrix of stages
            return layout
        kind, (first, chosen, places, signs, order) = layout.envelope.__reduce__()
        return layout._replace(envelope=kind(first, chosen, places, -signs, order))

    layout_of = SaddlePoint.layout
    system = assemble(pendulum(), ["pendulum.density", "pendulum.height"])
    objective = Integral(position(pendulum().beams[0].at_end, 1))
    known = gradient(system, objective, 4 * STEP, integrator, method=Adjoint()).gradient
    monkeypatch.setattr(SaddlePoint, "layout", spoilt)
    with pytest.MonkeyPatch.context() as patch:
        only_the_kernel(patch)
        direct = gradient(
            system, objective, 4 * STEP, integrator, method=DirectDifferentiation()
        ).gradient
        adjoint = gradient(system, objective, 4 * STEP, integrator, method=Adjoint()).gradient
    np.testing.assert_allclose(direct, known, rtol=1e-9)
    np.testing.assert_allclose(adjoint, known, rtol=1e-9)


# ---------------------------------------------------------------- what kernels refuse


def prepared_arguments():
    system = assemble(pendulum())
    return [system.plan, saddle_point(system, 0.0).layout(band=True), np.ones(17)]


PLAN, LAYOUT, RULES = prepared_arguments()
OTHER = saddle_point(assemble(crank_slider()), 0.0).layout(band=True)
BROKEN = {
    "no plan": ((), LAYOUT, RULES),
    "rules": (PLAN, LAYOUT, RULES[1:]),
    "complex mass": (PLAN._replace(mass=(*PLAN.mass[:2], PLAN.mass[2] + 1j)), LAYOUT, RULES),
    "places": (PLAN._replace(places=PLAN.places + len(PLAN.mass[2])), LAYOUT, RULES),
    "fewer places": (PLAN._replace(places=PLAN.places[:-1]), LAYOUT, RULES),
    "short gravity": (PLAN._replace(gravity=PLAN.gravity[1:]), LAYOUT, RULES),
    "loads": (PLAN._replace(loads=np.zeros((1, 5))), LAYOUT, RULES),
    "weights": (PLAN._replace(weights=np.ones(1)), LAYOUT, RULES),
    "order": (PLAN, LAYOUT._replace(order=LAYOUT.order + 1), RULES),
    "nothing to factorise": (PLAN, LAYOUT._replace(envelope=None, band=None), RULES),
    "band": (PLAN, LAYOUT._replace(band=OTHER.band), RULES),
    "envelope": (PLAN, LAYOUT._replace(envelope=OTHER.envelope), RULES),
    "a band for an envelope": (PLAN, LAYOUT._replace(envelope=LAYOUT.band), RULES),
    "inertia": (PLAN._replace(M=(PLAN.M[0][:-1], *PLAN.M[1:])), LAYOUT, RULES),
}


@pytest.mark.parametrize("arguments", BROKEN.values(), ids=BROKEN)
def test_what_does_not_fit_together_is_no_plan(arguments):
    with pytest.raises((ValueError, TypeError)):
        kernels.Model(*arguments, None)


@pytest.mark.parametrize(
    "spoilt",
    [
        *("h", "q", "v", "lam", "of_joints", "matrices", "right", "z", "on", "mu"),
        *("small", "G", "g", "on_defects"),
    ],
)
def test_passes_take_only_what_fits_their_plan(spoilt):
    n_q, n_lam = len(PLAN.gravity), 2
    model = kernels.Model(PLAN, LAYOUT, RULES, None)
    shapes = {
        "h": (4,),
        "q": (4, n_q),
        "v": (4, n_q),
        "lam": (4, n_lam),
        "of_joints": (1, 1),
        "of_loads": (4, 0),
        "matrices": (4, 6, 4),
        "small": (4,),
        "G": (4, len(PLAN.B[1])),
        "g": (4, n_lam, 3),
        "right": (4, 3, n_q + n_lam),
        "z": (4, 3, n_q),
        "states": (5, 3, 3, n_q),
        "lam_b": (4, 3, n_lam),
        "on": (6, n_q),
        "mu": (4, n_q),
        "zeta": (4, n_lam),
        "on_defects": (4, 3, n_q),
    }

    def call(shapes):
        *steps, small, G, g, right, z, states, lam_b, on, mu, zeta, on_defects = (
            np.ones(x) for x in shapes.values()
        )
        covectors = on, mu, zeta, on_defects
        packet = *steps, None, (small.astype(np.int32), G, g)
        assert model.differentiate_steps(packet, right, z, states, lam_b, 0)[0] == 4
        assert model.pull_back_steps(packet, (None, mu, zeta), covectors, 4)[0] == 0

    call(shapes)
    with pytest.raises(ValueError, match="shapes of a plan"):
        call(shapes | {spoilt: (*shapes[spoilt][:-1], shapes[spoilt][-1] + 1)})


@pytest.mark.parametrize(
    "spoilt",
    ["state", "h", "joints", "loads", "rows", "columns", "arguments", "guess", "limits"],
)
def test_a_march_takes_only_what_fits_its_plan(spoilt):
    n_q, n_lam = len(PLAN.gravity), 2
    zeros = [np.zeros(n) for n in (n_q, n_q, n_q, n_lam, n_q)]
    rows = [np.zeros((4, n)) for n in (n_q, n_q, n_q, n_lam)]
    of = {
        "state": tuple(zeros),
        "motion": np.inf,
        "h": np.full(4, STEP),
        "joints": np.ones((1, 2, 1)),
        "loads": np.zeros((4, 2, 0)),
        "seconds": 1.0,
        "rows": tuple(rows),
        "guess": None,
        "limits": (1e-12, np.inf, 15),
    }
    changes = {
        "guess": {"guess": (zeros[0][1:], zeros[3])},
        "limits": {"limits": (1e-12, np.inf)},
        "arguments": {"more": None},
        "state": {"state": (zeros[0][1:], *zeros[1:])},
        "h": {"h": np.full((4, 1), STEP)},
        "joints": {"joints": np.ones((1, 2, 2))},
        "loads": {"loads": np.zeros((4, 2, 1))},
        "rows": {"rows": tuple(row[1:] for row in rows)},
        "columns": {"rows": tuple(np.asfortranarray(row) for row in rows)},
    }
    model = kernels.Model(PLAN, LAYOUT, RULES, None)
    model.march(*of.values())
    with pytest.raises((ValueError, TypeError)):
        model.march(*(of | changes[spoilt]).values())
