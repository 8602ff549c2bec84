"""Gradients of objectives: discrete adjoint, direct differentiation and complex step agree."""

import time
from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    HHT,
    IDAS,
    Adjoint,
    AtTimes,
    Beam,
    Clamp,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    Distance,
    DistributedForce,
    EnhancedContinuum,
    FiniteDifference,
    FollowerForce,
    InitialVelocity,
    Integral,
    Material,
    Pin,
    PointForce,
    PointOnLine,
    Revolute,
    RotationDriver,
    Scene,
    SmoothMaximum,
    Spherical,
    SpringDamper,
    Terminal,
    TranslationDriver,
    assemble,
    differentiate,
    gradient,
    gradients,
    taylor_test,
)
from ancfdae.errors import (
    InvalidInputError,
    NonFiniteObjectiveError,
    UnfinishedRunError,
    UnknownNameError,
)
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import PassFailed
from ancfdae.extend import MaterialPoint
from ancfdae.integrators.integrator import Seeds
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.observables import (
    custom,
    kinetic_energy,
    position,
    reaction,
    slope_angle,
    strain_energy,
    velocity,
)
from ancfdae.results import Verdict
from ancfdae.sections import Rectangle
from ancfdae.studies.calls import cheapest
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import crank_slider, pendulum

SECTION, SOFT = Rectangle(0.05, 0.04), Material(4000.0, 1e7, 0.3)
DAMPED = Material(4000.0, 1e7, 0.3, damping_time=1e-3)
PLANE, SPACE = (0.0, -9.81), (0.0, -9.81, 2.0)


def beams(dimension=2, material=SOFT):
    rest = (0.0,) * (dimension - 1)
    first = Beam("a", (0.0, *rest), (0.5, *rest), 2, SECTION, material)
    return first, Beam("b", (0.5, *rest), (1.1, *rest), 2, SECTION, material)


def pinned_pair():
    a, b = beams()
    pins = [Pin(a.at_start, ground=(0, 0), name="p"), Pin(a.at_end, b.at_start)]
    return Scene([a, b], pins, PLANE), ["p.ground_x", "p.ground_y", "b.height"]


def slider():
    a, b = beams()
    line = PointOnLine(b.at_end, (1, 0.1), name="l")
    scene = Scene([a, b], [Pin(a.at_start), Pin(a.at_end, b.at_start), line], PLANE)
    return scene, ["a.height", "l.direction_x", "l.direction_y", "b.density"]


def link():
    a, _ = beams()
    rod = Distance(a.at_end, 0.5, ground=(0.8, 0.4), name="d")
    return Scene([a], [Pin(a.at_start), rod], PLANE), ["a.height", "d.length", "d.ground_x"]


def driven_with_spring():
    a, b = beams()
    motor = RotationDriver(a.at_start, ConstantAcceleration(2.0, acceleration=1.0), name="m")
    spring = SpringDamper(a.at_end, 300.0, 5.0, 0.2, other=b.at(0.6), name="s")
    start = [InitialVelocity("a", 2.0, (0, 0)), InitialVelocity("b", 2.0, (0, 0))]
    joints = [Pin(a.at_start, name="p"), motor, Pin(a.at_end, b.at_start)]
    design = ["m.speed", "m.acceleration", "s.stiffness", "s.damping", "s.free_length", "b.height"]
    return Scene([a, b], joints, PLANE, start, [spring], project_start=True), design


def guided():
    # The start is projected: a shock of one node, through which assumed strains need small steps.
    a = replace(beams()[0], energy=EnhancedContinuum(assumed_strains=False))
    up = TranslationDriver(a.at_start, (0, 1), Harmonic(0.1, 5.0), name="up")
    scene = Scene(
        [a],
        [up, TranslationDriver(a.at_start, (1, 0), ConstantAcceleration(0.0))],
        PLANE,
        project_start=True,
    )
    return scene, ["up.amplitude", "up.frequency", "a.height"]


def loaded():
    a, _ = beams()
    loads = [
        PointForce(a.at(0.7, y=0.01), (3.0, 5.0), name="f"),
        DistributedForce("a", (1.0, -20.0), name="w"),
        FollowerForce(a.at_end, (2.0, 10.0), name="o"),
        SpringDamper(a.at(0.3), 300.0, 5.0, 0.2, ground=(0.5, 0.5), name="s"),
    ]
    design = ["a.length", "f.force_y", "w.force_y", "o.force_y", "s.ground_y", "a.height"]
    return Scene([a], [Clamp(a.at_start)], PLANE, loads=loads), design


def damped():
    a, _ = beams(material=DAMPED)
    scene = Scene([a], [Pin(a.at_start)], PLANE, [InitialVelocity("a", 1.0, (0, 0))])
    return scene, ["a.damping_time", "a.length", "a.height", "a.youngs_modulus"]


def hinged():
    a, b = beams(3)
    joints = [
        Revolute(a.at_start, (0, 0, 1)),
        Revolute(a.at_end, (0, 0.2, 1), other=b.at_start, name="r"),
    ]
    start = [InitialVelocity(name, (0, 0, 1.0), (0, 0, 0)) for name in "ab"]
    return Scene([a, b], joints, SPACE, start), ["a.height", "r.axis_x", "r.axis_y", "b.width"]


def driven_in_space():
    a, b = beams(3)
    joints = [
        Revolute(a.at_start, (0, 0, 1), name="r"),
        RotationDriver(a.at_start, Harmonic(0.5, 4.0), name="m"),
        Spherical(a.at_end, b.at_start),
        PointOnLine(b.at_end, (1, 0, 0)),
    ]
    scene = Scene([a, b], joints, SPACE, project_start=True)
    return scene, ["a.height", "m.frequency", "b.poisson_ratio", "b.youngs_modulus"]


SCENES = [
    pinned_pair,
    slider,
    link,
    driven_with_spring,
    guided,
    loaded,
    damped,
    hinged,
    driven_in_space,
]


@pytest.mark.parametrize("build", SCENES, ids=lambda build: build.__name__)
def test_transposed_operator_satisfies_the_dot_product_identity(build):
    scene, design = build()
    integrator, system = HHT(2.0**-7), assemble(scene, design)
    run = differentiate(scene, 0.25, integrator, design=design)
    assert run.outcome.success
    rng, s = np.random.default_rng(0), run.sensitivities
    seeds = [rng.standard_normal(x.shape) for x in (run.q, run.v, run.lam)]
    back = integrator.pull_back(system, run, Seeds(*seeds))
    for i in range(system.n_b):
        columns = s.q_b[..., i], s.v_b[..., i], s.lam_b[..., i]
        forward = sum(np.sum(x * y) for x, y in zip(seeds, columns, strict=True))
        size = sum(
            np.linalg.norm(x) * np.linalg.norm(y) for x, y in zip(seeds, columns, strict=True)
        )
        # The claim.
        # At the start accelerations do not depend on a rigid motion of the scene: their derivative
        # is round-off of the stiffness times that motion alone, up to 1e4 eps of the others.
        assert abs(forward - back[i]) < 1e-11 * size, (design[i], forward, back[i])


@pytest.mark.parametrize("build", SCENES, ids=lambda build: build.__name__)
def test_direct_differentiation_is_the_complex_step_of_the_run(build):
    scene, design = build()
    direct = differentiate(scene, 0.25, HHT(2.0**-7), design=design)
    check = differentiate(scene, 0.25, HHT(2.0**-7), design=design, method=ComplexStep())
    for name, curve in (("q_b", direct.q), ("v_b", direct.v), ("lam_b", direct.lam)):
        ours, other = (getattr(run.sensitivities, name) for run in (direct, check))
        for i, value in enumerate(direct.sensitivities.values):
            relative = np.linalg.norm(curve) / max(abs(value), 1e-9)
            size = max(np.linalg.norm(other[..., i]), 0.1 * relative)
            assert np.linalg.norm(ours[..., i] - other[..., i]) < 1e-9 * size, (name, design[i])


@pytest.mark.parametrize("build", SCENES, ids=lambda build: build.__name__)
def test_constraints_hold_to_round_off(build):
    scene, design = build()
    run = differentiate(scene, 0.25, HHT(2.0**-7), design=design)
    system = assemble(scene, design)
    drift = [np.max(np.abs(system.constraint(t, q))) for q, t in zip(run.q, run.t, strict=True)]
    # Coordinates of order one carry round-off of 1e-16 in each of a few terms.
    assert max(drift) < 1e-14


def objectives(scene):
    """Every kind of objective, of q, q', lam, energies and b."""
    last = scene.beams[-1].at(0.7)
    x, y = position(last, 0), position(last, 1)
    joint = next(joint.name for joint in scene.joints if joint.holds_position)
    force = reaction(joint, 0) ** 2 + reaction(joint, 1) ** 2
    return {
        "integral of q": Integral((x - 0.8) ** 2 + np.sin(y)),
        "integral of q'": Integral(velocity(last, 1) ** 2),
        "integral of lam": Integral(force),
        "terminal": Terminal(x * y),
        "terminal lam": Terminal(reaction(joint, 1)),
        "at times": AtTimes(y, [0.0625, 0.1, 0.2]),
        "smooth maximum": SmoothMaximum(y, 20.0),
        "energies": Integral(strain_energy() + kinetic_energy(scene.beams[-1].name)),
        "angle": Terminal(slope_angle(MaterialPoint(scene.beams[0].name, 0.5))),
        "function": Integral(x**2) / (1.0 + Integral(y**2)) + np.sqrt(1.0 + Terminal(y) ** 2),
    }


GRADIENT_CASES = [
    (build, exponent)
    for build, exponents in (
        (driven_with_spring, (6, 7, 8, 10)),
        (damped, (6, 8, 10)),
        (driven_in_space, (7,)),
        (pinned_pair, (7,)),
    )
    for exponent in exponents
]


@pytest.mark.parametrize(
    ("build", "exponent"), GRADIENT_CASES, ids=lambda case: getattr(case, "__name__", str(case))
)
def test_adjoint_is_direct_differentiation_is_complex_step(build, exponent):
    scene, design = build()
    kinds, integrator = objectives(scene), HHT(2.0**-exponent)
    results = [
        gradients(scene, list(kinds.values()), 0.25, integrator, design=design, method=method)
        for method in (Adjoint(), DirectDifferentiation(), ComplexStep())
    ]
    scale = np.abs(assemble(scene, design).b)
    for name, adjoint, direct, check in zip(kinds, *results, strict=True):
        assert adjoint.value == pytest.approx(direct.value, rel=1e-12)
        reference = check.gradient * scale
        # The claim: 1e-10 relative in the norm, of derivatives per relative change of b.
        for other in (adjoint, direct):
            error = np.linalg.norm(other.gradient * scale - reference)
            assert error < 1e-10 * np.linalg.norm(reference), (name, other.method)


def test_crank_slider_gradients_agree_at_every_step_size():
    scene = crank_slider()
    design = [f"{beam}.{p}" for beam in ("crank", "rod") for p in ("height", "density")]
    design += ["crank.youngs_modulus", "rod.youngs_modulus"]
    x = position(scene.beams[1].at_end, 0)
    kinds = [Integral((x - 1.8) ** 2), Integral(reaction("bearing", 1) ** 2)]
    scale = assemble(scene, design).b
    for exponent in (6, 7, 8, 9, 10):
        both = [
            gradients(scene, kinds, 0.25, HHT(2.0**-exponent), design=design, method=method)
            for method in (Adjoint(), DirectDifferentiation())
        ]
        for adjoint, direct in zip(*both, strict=True):
            error = np.linalg.norm((adjoint.gradient - direct.gradient) * scale)
            assert error < 1e-10 * np.linalg.norm(direct.gradient * scale)


# Steps that resolve the section's waves, so that a multiplier is a smooth function of time.
@pytest.mark.parametrize(("kind", "exponents"), [("q", (13, 14, 15)), ("lam", (16, 17, 18))])
def test_continuous_adjoint_converges_to_the_discrete_one_with_order_two(kind, exponents):
    scene = pendulum()
    design = [f"pendulum.{name}" for name in ("youngs_modulus", "height", "density", "length")]
    pin = scene.joints[0].name
    objective = {
        "q": Integral(position(scene.beams[0].at_end, 1) ** 2),
        "lam": Integral(reaction(pin, 0) ** 2 + reaction(pin, 1) ** 2),
    }[kind]
    errors = []
    for exponent in exponents:
        ours, exact = (
            gradient(scene, objective, 2.0**-6, HHT(2.0**-exponent), design=design, method=method)
            for method in (ContinuousAdjoint(), Adjoint())
        )
        scale = assemble(scene, design).b
        difference = np.linalg.norm((ours.gradient - exact.gradient) * scale)
        errors.append(difference / np.linalg.norm(exact.gradient * scale))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    # The claim: at least 1.8.
    assert np.all(orders > 1.8), orders


@pytest.mark.parametrize("build", [driven_with_spring, loaded, damped, hinged, pinned_pair])
def test_continuous_adjoint_is_near_the_discrete_one_in_every_kind_of_scene(build):
    scene, design = build()
    last = scene.beams[-1].at_end
    objective = Integral((position(last, 1) + 0.3) ** 2)
    scale = np.abs(assemble(scene, design).b)
    errors = []
    for exponent in (9, 10, 11):
        ours, exact = (
            gradient(
                scene, objective, 0.25, HHT(2.0**-exponent), design=design, method=method
            ).gradient
            * scale
            for method in (ContinuousAdjoint(), Adjoint())
        )
        errors.append(np.linalg.norm(ours - exact) / np.linalg.norm(exact))
    # Unresolved waves make single halvings irregular; a wrong term leaves an error that stays.
    assert errors[-1] < 1e-4 or (errors[-1] < 2e-3 and errors[-1] < 0.4 * errors[0]), errors


def test_continuous_adjoint_keeps_order_two_on_a_curved_constraint():
    # Multipliers of HHT carry transients of O(h^2) here; taken as they are, the order is one.
    objective = Integral(custom(lambda t, q, v, lam, b: lam[:, 0] ** 2, "lam"))
    errors = []
    for exponent in (7, 8, 9):
        ours, exact = (
            gradient(
                CartesianPendulum(), objective, 1.0, HHT(2.0**-exponent), method=method
            ).gradient
            for method in (ContinuousAdjoint(), Adjoint())
        )
        errors.append(np.linalg.norm(ours - exact))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.8), orders


def test_every_pass_back_counts_its_factorisations_as_direct_differentiation_does():
    objectives = [Integral(custom(lambda t, q, v, lam, b, k=k: q[:, k], "q")) for k in range(2)]
    run = HHT(2.0**-6).integrate(CartesianPendulum(), 1.0).statistics
    methods = [
        gradients(CartesianPendulum(), objectives, 1.0, HHT(2.0**-6), method=method)
        for method in (Adjoint(), DirectDifferentiation(), ContinuousAdjoint())
    ]
    # One per step; a pass back for each objective. The continuous adjoint has one more per step
    # for smooth multipliers and one for its end.
    for results, passed in zip(methods, (64, 64, 129), strict=True):
        for result in results:
            assert result.solution.statistics.factorisations == run.factorisations + passed


@pytest.mark.idas
def test_a_pass_back_of_idas_factorises_nothing_of_hht():
    objective = Terminal(custom(lambda t, q, v, lam, b: q[:, 0] ** 2))
    # As many parts: a gradient of a value at the end reports few times between.
    integrator = IDAS(1e-6, intervals=16)
    run = integrator.integrate(CartesianPendulum(), 1.0).statistics
    found = gradient(CartesianPendulum(), objective, 1.0, integrator, method=Adjoint())
    assert found.solution.statistics.factorisations == run.factorisations


@pytest.mark.parametrize("method", [Adjoint(), DirectDifferentiation(), ContinuousAdjoint()])
def test_the_time_of_a_gradient_is_that_of_run_and_pass(method):
    objective, started = Integral(custom(lambda t, q, v, lam, b: q[:, 0])), time.perf_counter()
    found = gradient(CartesianPendulum(), objective, 1.0, HHT(2.0**-6), method=method)
    assert 0 < found.solution.statistics.wall_seconds < time.perf_counter() - started


def test_any_mechanical_system_has_gradients_too():
    system = CartesianPendulum(-1.0, 2.0)
    objective = Integral(custom(lambda t, q, v, lam, b: q[:, 0] ** 2 + lam[:, 0] * v[:, 1], "H"))
    results = [
        gradient(system, objective, 1.0, HHT(2.0**-6), method=method).gradient
        for method in (Adjoint(), DirectDifferentiation(), ComplexStep())
    ]
    for other in results[:2]:
        np.testing.assert_allclose(other, results[2], rtol=1e-10)


def test_finite_differences_of_an_objective_approach_the_gradient():
    scene, design = pinned_pair()
    objective = Integral(position(scene.beams[-1].at_end, 1) ** 2)
    exact = gradient(scene, objective, 0.25, HHT(2.0**-7), design=["b.height"]).gradient
    near = gradient(
        scene,
        objective,
        0.25,
        HHT(2.0**-7),
        design=["b.height"],
        method=FiniteDifference(1e-5, central=True),
    ).gradient
    np.testing.assert_allclose(near, exact, rtol=1e-6)
    assert design


def test_the_cheaper_method_is_taken_when_none_is_named():
    assert isinstance(cheapest(1, 1), DirectDifferentiation)
    assert isinstance(cheapest(100, 3), Adjoint)
    scene, design = driven_with_spring()
    objective = Integral(position(scene.beams[-1].at_end, 1))
    assert isinstance(gradient(scene, objective, 0.25, HHT(2.0**-6), design=design).method, Adjoint)
    assert isinstance(
        gradient(scene, objective, 0.25, HHT(2.0**-6), design=design[:1]).method,
        DirectDifferentiation,
    )


def test_taylor_remainder_of_a_driven_scene_is_of_second_order():
    scene, design = driven_with_spring()
    system = assemble(scene, design)
    place = Terminal(position(MaterialPoint("b", 1.0), 1))
    # A remainder of third order is a tenth of that of second order at the largest.
    sizes = (1e-4, 5e-5, 2.5e-5)
    result = taylor_test(system, place, 0.25, HHT(2.0**-7), method=Adjoint(), sizes=sizes)
    assert abs(result.order - 2) < 0.1


def test_what_a_gradient_cannot_be_taken_of_is_refused_before_the_run():
    scene, design = pinned_pair()
    y = position(scene.beams[-1].at_end, 1)
    run, own = (0.25, HHT(2.0**-7)), {"design": design}
    with pytest.raises(UnknownNameError, match="nobody"):
        gradient(scene, Integral(position(MaterialPoint("nobody", 1.0), 0)), *run, **own)
    with pytest.raises(UnknownNameError, match="no joint"):
        gradient(scene, Integral(reaction("no joint", 0)), *run, **own)
    with pytest.raises(InvalidInputError, match="Objective"):
        gradient(scene, y, *run, **own)
    with pytest.raises(InvalidInputError, match="time integrals"):
        gradient(scene, Terminal(y), *run, **own, method=ContinuousAdjoint())
    with pytest.raises(InvalidInputError, match="method"):
        gradient(scene, Integral(y), *run, **own, method="adjoint")


def test_an_objective_that_is_not_finite_names_the_time():
    scene, design = pinned_pair()
    y = position(scene.beams[-1].at_end, 1)
    with pytest.raises(NonFiniteObjectiveError, match="t = ") as caught:
        gradient(scene, Integral(np.log(y + 0.02)), 0.25, HHT(2.0**-7), design=design)
    assert 0 < caught.value.time < 0.25


def test_a_run_that_ends_early_keeps_its_results_in_the_error():
    scene, design = pinned_pair()
    y = position(scene.beams[-1].at_end, 1)
    with pytest.raises(UnfinishedRunError, match="did not converge") as caught:
        gradient(scene, Integral(y), 0.25, HHT(2.0**-7, max_iterations=1), design=design)
    assert len(caught.value.solution.t) >= 1


@pytest.mark.parametrize(
    ("raised", "verdict"),
    [
        (PassFailed(Verdict.STEP_LIMIT), Verdict.STEP_LIMIT),
        (SingularMatrix("zero pivot"), Verdict.SINGULAR),
    ],
)
def test_a_pass_back_that_breaks_off_says_why(monkeypatch, raised, verdict):
    def broken(*_):
        raise raised

    monkeypatch.setattr(HHT, "pull_back", broken)
    x = Terminal(custom(lambda t, q, v, lam, b: q[:, 0], "x"))
    with pytest.raises(UnfinishedRunError, match="no gradient") as caught:
        gradient(CartesianPendulum(), x, 0.5, HHT(2.0**-5), method=Adjoint())
    assert caught.value.solution.outcome.verdict is verdict
    assert len(caught.value.solution.t) == 17
