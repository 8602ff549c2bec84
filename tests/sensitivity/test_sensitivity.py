"""Direct differentiation is the exact derivative of the discrete run."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    DesignVariable,
    DirectDifferentiation,
    FiniteDifference,
    InitialVelocity,
    Integral,
    Material,
    NodalState,
    Pin,
    Scene,
    Terminal,
    assemble,
    differentiate,
    distributed_variables,
    gradient,
    simulate,
    taylor_test,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import MaterialPoint
from ancfdae.observables import custom, deflection, position
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum
from validation.scenes import pendulum

# The claim: relative 1e-9 in the norm over time.
EXACT = 1e-9
SECTION, STEEL = Rectangle(0.05, 0.04), Material(4000.0, 1e7, 0.3)
KINDS = ("youngs_modulus", "poisson_ratio", "density", "height", "width", "length")


def assert_same_derivative(scene, design, t_end, integrator, within=EXACT):
    """Compare direct differentiation and complex step for every variable and unknown."""
    direct = differentiate(scene, t_end, integrator, design=design)
    check = differentiate(scene, t_end, integrator, design=design, method=ComplexStep())
    assert direct.outcome.success
    for name, scale in (
        ("q_b", direct.q),
        ("v_b", direct.v),
        ("a_b", direct.a),
        ("lam_b", direct.lam),
    ):
        ours, other = (getattr(run.sensitivities, name) for run in (direct, check))
        if scale.size == 0:
            continue
        for i, value in enumerate(direct.sensitivities.values):
            # A derivative that (nearly) vanishes, as that of a planar motion in the width, is
            # measured against a tenth of the curve per relative change of the variable.
            size = max(np.linalg.norm(other[..., i]), 0.1 * np.linalg.norm(scale) / abs(value))
            error = np.linalg.norm(ours[..., i] - other[..., i]) / size
            assert error < within, (name, direct.sensitivities.names[i], error)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("hht_alpha", [-0.05, -0.3])
def test_every_kind_of_variable_on_the_pendulum(dimension, hht_alpha):
    design = [f"pendulum.{kind}" for kind in KINDS]
    assert_same_derivative(pendulum(dimension), design, 0.5, HHT(2.0**-7, hht_alpha))


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_kind_of_variable_from_a_moving_start(dimension):
    spin = 3.0 if dimension == 2 else (0.5, 0.4, 3.0)
    start = (InitialVelocity("pendulum", spin, (0.0,) * dimension),)
    design = [f"pendulum.{kind}" for kind in KINDS]
    assert_same_derivative(pendulum(dimension, start=start), design, 0.25, HHT(2.0**-7))


def test_shared_and_elementwise_variables_on_two_beams():
    first = Beam("first", (0, 0), (0.5, 0), 2, SECTION, STEEL)
    second = Beam("second", (0.5, 0), (1.1, 0), 3, SECTION, STEEL)
    scene = Scene(
        [first, second],
        [Pin(first.at_start), Pin(first.at_end, second.at_start)],
        gravity=(0, -9.81),
    )
    design = [
        DesignVariable("E", ["first.youngs_modulus", "second.youngs_modulus"]),
        *distributed_variables("second.height", 3),
        "first.width",
    ]
    assert_same_derivative(scene, design, 0.25, HHT(2.0**-7))


def test_length_with_a_pin_between_nodes_and_with_an_offset():
    beam = Beam("beam", (0, 0), (1.0, 0.0), 3, SECTION, STEEL)
    scene = Scene([beam], [Pin(beam.at(0.4, y=0.01)), Pin(beam.at(0.9))], gravity=(0, -9.81))
    assert_same_derivative(scene, ["beam.length", "beam.height"], 0.25, HHT(2.0**-7))


def test_length_of_a_projected_start():
    first = Beam("first", (0, 0), (0.5, 0), 2, SECTION, STEEL)
    second = Beam("second", (0.5, 1e-4), (1.1, 0), 2, SECTION, STEEL)
    scene = Scene(
        [first, second],
        [Pin(first.at_start), Pin(first.at_end, second.at_start)],
        gravity=(0, -9.81),
        start=[InitialVelocity("second", 0.1, (0.5, 0.1))],
        project_start=True,
    )
    design = ["first.length", "first.density", "second.height"]
    assert_same_derivative(scene, design, 0.25, HHT(2.0**-7))


def arc(dimension):
    angles = np.linspace(0, 0.8, 4)
    positions = np.stack([np.sin(angles), 1 - np.cos(angles)], axis=1)
    tangents = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    frames = np.stack([tangents, normals], axis=1)
    if dimension == 3:
        positions = np.pad(positions, ((0, 0), (0, 1)))
        frames = np.pad(frames, ((0, 0), (0, 1), (0, 1)))
        frames[:, 2, 2] = 1
    return CurvedBeam("arc", positions, frames, SECTION, STEEL)


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_kind_of_variable_on_a_clamped_arc(dimension):
    beam = arc(dimension)
    gravity = (0.0, -9.81, 1.0)[:dimension]
    design = [f"arc.{kind}" for kind in KINDS]
    assert_same_derivative(
        Scene([beam], [Clamp(beam.at_start)], gravity), design, 0.25, HHT(2.0**-7)
    )


def test_start_from_given_node_states():
    beam = Beam("beam", (0, 0), (1.0, 0.0), 2, SECTION, STEEL)
    rng = np.random.default_rng(1)
    coordinates = assemble(Scene([beam])).start()[0].reshape(3, 3, 2)
    coordinates = coordinates + 0.01 * rng.standard_normal(coordinates.shape)
    velocities = rng.standard_normal(coordinates.shape)
    scene = Scene([beam], gravity=(0, -9.81), start=[NodalState("beam", coordinates, velocities)])
    design = ["beam.youngs_modulus", "beam.height", "beam.length", "beam.density"]
    assert_same_derivative(scene, design, 2.0**-4, HHT(2.0**-10))


def test_a_system_with_curved_constraints():
    assert_same_derivative(CartesianPendulum(-1.0, 2.0), (), 1.0, HHT(2.0**-6))


@pytest.mark.parametrize("dimension", [2, 3])
def test_modulus_and_density_identities_hold_to_round_off(dimension):
    design = ["pendulum.youngs_modulus", "pendulum.density"]
    run = differentiate(pendulum(dimension), 1.0, HHT(2.0**-7), design=design)
    s = run.sensitivities
    E, rho = s.values
    q_scale, lam_scale = np.max(np.abs(E * s.q_b[..., 0])), np.max(np.abs(run.lam))
    # The identities hold in the discrete scheme; what is left is the Newton tolerance 1e-13,
    # amplified by up to a thousand steps of growing sensitivities.
    assert np.max(np.abs(E * s.q_b[..., 0] + rho * s.q_b[..., 1])) < 1e-11 * q_scale
    force = E * s.lam_b[..., 0] + rho * s.lam_b[..., 1] - run.lam
    assert np.max(np.abs(force)) < 1e-11 * lam_scale


def test_finite_differences_approach_direct_differentiation_at_their_order():
    design = ["pendulum.youngs_modulus", "pendulum.height"]
    integrator = HHT(2.0**-7)
    exact = differentiate(pendulum(), 0.25, integrator, design=design).sensitivities.q_b
    for central, order in ((False, 1), (True, 2)):
        errors = [
            np.linalg.norm(
                differentiate(
                    pendulum(),
                    0.25,
                    integrator,
                    design=design,
                    method=FiniteDifference(size, central),
                ).sensitivities.q_b
                - exact,
                axis=(0, 1),
            )
            for size in (2e-3, 1e-3)
        ]
        observed = np.log2(errors[0] / errors[1])
        # Truncation dominates at these sizes; the next term shifts the order by about the size.
        np.testing.assert_allclose(observed, order, atol=0.05)


TIP = MaterialPoint("pendulum", 1.0)
DEFLECTION = deflection(TIP, frame_at=MaterialPoint("pendulum", 0.0))


@pytest.mark.parametrize("method", [None, DirectDifferentiation(), Adjoint(), ComplexStep()])
@pytest.mark.parametrize(
    "objective", [Integral(DEFLECTION**2), Terminal(DEFLECTION) * Integral(position(TIP, 0))]
)
def test_taylor_remainder_of_an_objective_is_of_second_order(method, objective):
    found = taylor_test(
        pendulum(),
        objective,
        0.25,
        HHT(2.0**-7),
        design=["pendulum.youngs_modulus", "pendulum.height"],
        method=method,
        direction=(1.0, -0.5),
    )
    # The next term is of the size of the perturbations, 1e-3, times factors up to a hundred.
    assert abs(found.order - 2) < 0.1


def test_taylor_remainder_of_a_wrong_gradient_is_of_first_order():
    system = assemble(pendulum(), ["pendulum.youngs_modulus", "pendulum.height"])
    # Forward differences over five per cent are off by some per cent.
    coarse = FiniteDifference(0.05)
    objective = Integral(DEFLECTION**2)
    found = taylor_test(system, objective, 0.25, HHT(2.0**-7), method=coarse, direction=(1.0, -0.5))
    assert found.order < 1.5


def test_a_model_without_design_variables_is_refused():
    run = (0.25, HHT(2.0**-7))
    for model in (pendulum(), assemble(pendulum())):
        for call in (
            lambda model=model: differentiate(model, *run),
            lambda model=model: gradient(model, Integral(DEFLECTION), *run, design=[]),
            lambda model=model: taylor_test(model, Integral(DEFLECTION), *run),
        ):
            with pytest.raises(InvalidInputError, match=r"design: must name .* design=\["):
                call()


def test_unchanged_run_when_sensitivities_are_integrated_along():
    # The matrix kept from the sensitivities changes the Newton path, not its limit.
    alone = simulate(pendulum(), 0.5, HHT(2.0**-7))
    along = differentiate(pendulum(), 0.5, HHT(2.0**-7), design=["pendulum.height"])
    np.testing.assert_allclose(along.q, alone.q, atol=1e-11)


ABSCISSA = Terminal(custom(lambda t, q, v, lam, b: q[:, 0]))


@pytest.mark.parametrize("kind", [IDA, IDAS, DOP853])
def test_complex_step_is_refused_by_integrators_in_real_numbers(kind):
    with pytest.raises(InvalidInputError, match=r"ComplexStep: .*Use HHT"):
        gradient(CartesianPendulum(), ABSCISSA, 1.0, kind(), method=ComplexStep())
    with pytest.raises(InvalidInputError, match=r"ComplexStep: .*Use HHT"):
        differentiate(CartesianPendulum(), 1.0, kind(), method=ComplexStep())


def test_complex_design_values_are_refused_by_integrators_in_real_numbers():
    system = CartesianPendulum(b=np.array([1.0 + 1e-40j, 9.81]))
    with pytest.raises(InvalidInputError, match=r"needs real coordinates.*complex ones"):
        simulate(system, 1.0, DOP853())
