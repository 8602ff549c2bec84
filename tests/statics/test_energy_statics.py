"""Derivatives of equilibria and modes in all parameters, for every section and strain energy."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    Material,
    PointForce,
    Scene,
    equilibrium,
    equilibrium_gradient,
    modes,
)
from ancfdae.observables import position, reaction
from ancfdae.sections import Circle, Tube
from tests.support.element_kinds import ENERGIES, SECTIONS, all_at_once, moved

CASES = [(d, section, "enhanced") for section in SECTIONS for d in (2, 3)]
CASES += [(d, "rectangle", energy) for energy in ENERGIES for d in (2, 3)]
CASES = [(d, s, e) for d, s, e in CASES if d in ENERGIES[e].dimensions]


def loaded(d, section, energy):
    """Return an oblique cantilever bent by about a third of its length, and its variables."""
    end = (0.5, 0.1, 0.05)[:d]
    material = Material(1000.0, 1e7, 0.3)
    law = {"energy": ENERGIES[energy], "initial_strain": 0.02}
    beam = Beam("rod", (0.0,) * d, end, 2, SECTIONS[section], material, **law)
    y, z, dA = beam.section.points(np.array([beam.section.sizes()]), False)
    softest = min(np.sum(dA * y * y), np.sum(dA * z * z))
    force = PointForce(beam.at_end, tuple(1e7 * softest * x for x in (0.5, -4.0, 1.0)[:d]))
    idle = {"density", "damping_time"} | (
        {"torsion_moment", "second_moment_z"} if d == 2 else set()
    )
    design = [f"rod.{name}" for name in beam.parameter_names() if name not in idle]
    return Scene([beam], [Clamp(beam.at_start, name="wall")], loads=[force]), beam, design


def value_of(scene, name):
    beam = scene.beams[0]
    if name == "rod.length":
        return beam.length
    return beam.element_parameters()[0, beam.parameter_names()[name.removeprefix("rod.")]]


@pytest.mark.parametrize(("d", "section", "energy"), CASES)
def test_statics_by_every_method(d, section, energy):
    scene, beam, design = loaded(d, section, energy)
    b = np.array([value_of(scene, name) for name in design])
    every, along = all_at_once(design, b)
    for observable in (position(beam.at_end, 1), reaction("wall", 1)):
        direct, adjoint = (
            equilibrium_gradient(scene, observable, design=design, method=method)
            for method in (DirectDifferentiation(), Adjoint())
        )
        # The reaction is the load: its derivatives vanish, up to round-off of its size.
        scale = max(np.max(np.abs(direct.gradient * b)), abs(direct.value))
        assert np.max(np.abs(direct.gradient - adjoint.gradient) * np.abs(b)) < 1e-9 * scale
        steps = equilibrium_gradient(scene, observable, design=[every], method=ComplexStep())
        assert abs(direct.gradient @ along - steps.gradient[0]) < 1e-9 * scale
    tip = position(beam.at_end, 1)
    slopes = equilibrium_gradient(scene, tip, design=design).gradient
    # Differences of the call, with values given to the scene.
    low, high = (
        equilibrium(moved(scene, design, b + h * along)).solution.position(beam.at_end)[0, 1]
        for h in (-1e-4, 1e-4)
    )
    # Error of central differences: the square of 1e-4 times a third derivative below 100.
    assert abs((high - low) / 2e-4 - slopes @ along) < 1e-6 * np.max(np.abs(slopes * b))


@pytest.mark.parametrize(("d", "section", "energy"), CASES)
def test_modes_about_an_equilibrium_by_both_methods_and_differences(d, section, energy):
    scene, _, design = loaded(d, section, energy)
    b = np.array([value_of(scene, name) for name in design])

    def lowest(scene, **options):
        at = equilibrium(scene, **({"design": design} if options else {}))
        return modes(scene, 2, at=at, **options)

    direct = lowest(scene, design=design, method=DirectDifferentiation())
    adjoint = lowest(scene, design=design, method=Adjoint())
    slopes = direct.frequencies_b * b / direct.frequencies[:, None]
    other = adjoint.frequencies_b * b / adjoint.frequencies[:, None]
    assert np.max(np.abs(slopes - other)) < 1e-9 * np.max(np.abs(slopes))
    _, along = all_at_once(design, b)
    low, high = (lowest(moved(scene, design, b + h * along)).frequencies for h in (-1e-4, 1e-4))
    found = (high - low) / 2e-4 / direct.frequencies
    expected = direct.frequencies_b @ along / direct.frequencies
    # As above; close modes of nearly square sections turn, which multiplies derivatives.
    assert np.max(np.abs(found - expected)) < 1e-5 * np.max(np.abs(slopes))


def test_nearly_incompressible_material_does_not_lock():
    scene, beam, _ = loaded(3, "circle", "enhanced")
    scene = replace(scene, beams=[replace(beam, elements=8, initial_strain=0.0)])
    tip = position(beam.at_end, 1)
    found = [
        equilibrium_gradient(
            scene.with_values({"rod.poisson_ratio": nu}), tip, design=["rod.length"]
        ).value
        for nu in (0.3, 0.4999)
    ]
    # Only the shear modulus changes, and with it shear, h^2/L^2 = 1e-3 of the deflection.
    assert abs(found[1] / found[0] - 1) < 1e-3


@pytest.mark.parametrize("section", [Circle(0.01), Tube(0.01, 0.002)], ids=["circle", "tube"])
def test_round_cantilevers_vibrate_as_theory_says(section):
    # Diameter over length 0.02; asked within 0.5 %. Rotary inertia and shear lower the first
    # bending frequency by 1e-4, linear twist raises that of torsion by (pi/2/16)^2/24 = 4e-4.
    E, nu, rho = 2e11, 0.3, 7850.0
    beam = Beam("rod", (0, 0, 0), (1, 0, 0), 16, section, Material(rho, E, nu))
    y, _, dA = section.points(np.array([section.sizes()]), False)
    A, I = dA.sum(), np.sum(dA * y * y)
    bending = 1.8751040687119611**2 * np.sqrt(E * I / (rho * A))
    torsion = np.pi / 2 * np.sqrt(E / (2 * (1 + nu)) / rho)  # circles do not warp: J = I_y + I_z
    found = modes(Scene([beam], [Clamp(beam.at_start)]), 24).frequencies
    assert np.allclose(found[:2], bending, rtol=1e-3)
    assert np.min(np.abs(found / torsion - 1)) < 1e-3
