"""What a reader adds in one file outside the package does all that its own parts do.

Each part stands in its file in `extending`, as `docs/howto/own-parts.md` tells to write it.
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    Moment,
    PointForce,
    RigidBody,
    Scene,
    Terminal,
    assemble,
    check_system,
    equilibrium,
    gradient,
    simulate,
)
from ancfdae.plotting import snapshots
from ancfdae.plotting.symbols import Symbols
from ancfdae.sensitivity.observables.observable import observe
from tests.support.extending import controller, element, integrator, joint, law, load, section

MODULES = (joint, load, controller, law, section, element, integrator)


#: The magnets on two bodies that nothing else pulls, one of them heavy.
BAR = RigidBody("reed", (0.3, 0.0), mass=0.5, inertia=1e-3)
BAR_COIL = load.Magnet(BAR.at(0.0, 0.0), load.yoke.at(0.0, 0.01), 1e-3, 0.05, name="coil")
SOFTLY = PointForce(section.mast.at_end, (1e-5, 1e-5, 0.0))


@pytest.fixture(scope="module", params=MODULES, ids=lambda module: module.__name__)
def part(request):
    return request.param


def end_of(part, scene):
    """The observable at the end of a run."""
    run = simulate(scene, part.END, part.INTEGRATOR)
    return observe(part.OBSERVABLE, run, assemble(scene))[-1]


def test_derivatives_by_every_method_are_those_of_the_call(part):
    objective = Terminal(part.OBSERVABLE)
    call = part.SCENE, objective, part.END, part.INTEGRATOR
    direct, adjoint, steps = (
        gradient(*call, design=part.DESIGN, method=method)
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    )
    b = assemble(part.SCENE, part.DESIGN).b
    size = np.max(np.abs(direct.gradient * b))
    assert np.all(direct.gradient != 0)
    # Newton's method of HHT leaves 1e-12 of the motion.
    for other in (adjoint, steps):
        assert np.max(np.abs(direct.gradient - other.gradient) * b) < 1e-9 * size
    for name, value, slope in zip(part.DESIGN, b, direct.gradient, strict=True):
        ends = [
            end_of(part, part.SCENE.with_values({name: value * x})) for x in (1 - 1e-4, 1 + 1e-4)
        ]
        # The square of 1e-4 times a third derivative below 100; 1e-12 of Newton's method over it.
        assert abs((ends[1] - ends[0]) / 2e-4 - slope * value) < 1e-6 * size, name


@pytest.mark.parametrize("part", MODULES[:-1], ids=lambda module: module.__name__)
def test_a_system_with_the_part_passes_every_check(part):
    report = check_system(assemble(part.SCENE, part.DESIGN), samples=1)
    assert report.passed, str(report)


def test_scene_and_run_are_pickled(part):
    scene, integrator = pickle.loads(pickle.dumps((part.SCENE, part.INTEGRATOR)))
    run = simulate(part.SCENE, part.END, part.INTEGRATOR)
    assert run.outcome.success
    again = simulate(scene, part.END, integrator)
    assert np.array_equal(again.q, run.q)
    assert np.array_equal(pickle.loads(pickle.dumps(run)).q, run.q)


def test_the_part_is_drawn(part, tmp_path):
    run = simulate(part.SCENE, part.END, part.INTEGRATOR)
    snapshots(part.SCENE, run).savefig(tmp_path / "part.png")
    # More than an empty picture.
    assert (tmp_path / "part.png").stat().st_size > 5000


def symbols_of(part):
    run = simulate(part.SCENE, part.END, part.INTEGRATOR)
    system = assemble(part.SCENE)
    return run, Symbols(part.SCENE, system.naming, system.start()[0])


# ---------------------------------------------------------------- what each of them means


def test_the_joint_holds_and_has_a_mark():
    run, symbols = symbols_of(joint)
    moved = [place - place[0] for place in map(run.position, joint.copier.points)]
    # Newton's method, of positions of 1 m.
    assert np.max(np.abs(moved[1] - 1.5 * moved[0])) < 1e-12
    assert np.max(np.abs(moved[0])) > 0.01
    assert [mark.name for mark in symbols.marks(run) if mark.kind == "pantograph"] == ["copier"]


def test_the_load_does_the_work_of_its_energy_and_has_arrows():
    scene = replace(load.SCENE, beams=[], joints=[], bodies=[load.yoke, BAR], loads=[BAR_COIL])
    run = simulate(scene, 0.1, HHT(2.0**-10))
    e = run.position(BAR_COIL.point) - run.position(BAR_COIL.other)
    kinetic = assemble(scene).energies.kinetic(run.v)
    # U = -k/2 / (e^2 + gap^2), of which the force is minus the gradient. They swing with 20 rad/s:
    # of second order in 20 h.
    energy = kinetic - 1e-3 / 2 / (np.sum(e * e, axis=1) + 0.05**2)
    assert np.ptp(energy) < 1e-3 * np.max(kinetic)
    assert np.max(kinetic) > 0.01
    run, symbols = symbols_of(load)
    arrows = [each for each in symbols.arrows(run) if each.name == "coil"]
    assert len(arrows) == 2
    assert np.array_equal(arrows[0].vectors, -arrows[1].vectors)
    assert np.all(np.any(arrows[0].vectors != 0, axis=-1))


def test_the_law_gives_the_momentum_of_its_integral():
    run = simulate(law.SCENE, law.END, law.INTEGRATOR)
    start, end = (erf((t - 0.1) / 0.04) for t in (0.0, 0.2))
    momentum = 1.5 * 0.04 * np.pi**0.5 / 2 * (end - start) * np.array([3.0, 1.0])
    # Of second order: (h/width)^2 = 6e-3, of which the smooth ends of the gust leave little.
    pushed = 2.0 * (run.velocity(law.wind.point)[-1] + [0.0, 9.81 * 0.2])
    assert pushed == pytest.approx(momentum, rel=1e-4)


def test_the_section_bends_as_an_ellipse_and_is_drawn_as_one():
    scene = replace(section.SCENE, gravity=None, loads=[SOFTLY])
    tip = equilibrium(scene).solution.position(SOFTLY.point)[0]
    E, a, b = 7e8, 0.015, 0.01
    G, factor = E / 2.6, 6 * 1.3 / (7 + 6 * 0.3)
    for shift, I in zip(tip[:2], (np.pi / 4 * a**3 * b, np.pi / 4 * a * b**3), strict=True):
        expected = 1e-5 * (1 / (3 * E * I) + 1 / (factor * G * np.pi * a * b))
        assert shift == pytest.approx(expected, rel=1e-5)
    twisted = replace(scene, loads=[Moment(section.mast.at_end, (0.0, 0.0, 1e-6))])
    run = equilibrium(twisted).solution
    was, now = section.mast.reference().slopes[-1, 1], run.slope(section.mast.at_end, 1)[0]
    J = np.pi * a**3 * b**3 / (a**2 + b**2)
    # An ellipse shears in its plane as it twists: the mean of both axes.
    was_z, now_z = section.mast.reference().slopes[-1, 2], run.slope(section.mast.at_end, 2)[0]
    turns = [np.cross(x, y)[2] for x, y in ((was, now), (was_z, now_z))]
    assert np.mean(turns) == pytest.approx(1e-6 / (G * J), rel=1e-3)


def test_the_element_bends_a_quarter_as_stiffly():
    form = element.rope.section, element.rope.material
    straight = Beam("rope", (0, 0), (1, 0), 2, *form, element=element.STRAND)
    tip = PointForce(straight.at_end, (0.0, 1e-6))
    scene = Scene([straight], [Clamp(straight.at_start)], loads=[tip])
    shift = equilibrium(scene).solution.position(tip.point)[0, 1]
    # Cubic polynomials are exact.
    assert shift == pytest.approx(1e-6 / (3 * 1e8 * 0.02**4 / 12 / 4), rel=1e-6)


def test_the_integrator_is_of_first_order():
    scene, tip = integrator.SCENE, integrator.rod.at_end
    methods = (HHT(rtol=1e-8), integrator.SymplecticEuler(64), integrator.SymplecticEuler(128))
    exact, *ends = (simulate(scene, integrator.END, x).position(tip)[-1] for x in methods)
    errors = [np.linalg.norm(end - exact) for end in ends]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
