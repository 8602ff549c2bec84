"""Gradients of motions in all parameters of a beam, for every section and every strain energy."""

import numpy as np
import pytest

from ancfdae import (
    BEAM_2D,
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    Integral,
    Material,
    Scene,
    gradient,
)
from ancfdae.observables import position
from tests.support.element_kinds import ENERGIES, SECTIONS, all_at_once, moved

CASES = [(3, section, "enhanced") for section in SECTIONS]
CASES += [(2, section, "enhanced") for section in SECTIONS]
CASES += [(2, "rectangle", energy) for energy in ENERGIES]
CASES += [(3, "rectangle", energy) for energy in ENERGIES if "plane" not in energy]


def falling(d, section, energy):
    """Return a cantilever that falls under gravity, oblique so that it twists too."""
    material = Material(1000.0, 1e7, 0.3, 1e-4)
    end = (0.5, 0.1, 0.05)[:d]
    law = {"energy": ENERGIES[energy], "initial_strain": 0.002}
    beam = Beam("rod", (0.0,) * d, end, 2, SECTIONS[section], material, **law)
    gravity = (0.0, -9.81, 5.0)[:d]
    return Scene([beam], [Clamp(beam.at_start)], gravity), beam


@pytest.mark.parametrize(("d", "section", "energy"), CASES)
def test_direct_and_adjoint_are_complex_step_and_differences(d, section, energy):
    scene, beam = falling(d, section, energy)
    design = [f"rod.{name}" for name in beam.parameter_names()]
    if d == 2:  # nothing in the plane depends on these
        idle = {"rod.torsion_moment", "rod.second_moment_z"}
        design = [name for name in design if name not in idle]
    objective = Integral((position(beam.at_end, 1) - 0.1) ** 2 + position(beam.at_end, 0))
    call = (objective, 0.02, HHT(0.002, newton_tolerance=1e-14))
    direct = gradient(scene, *call, design=design, method=DirectDifferentiation())
    b = np.array([scene.with_values({}).element_parameters[0, w] for w in columns(beam, design)])
    b[design.index("rod.length")] = beam.length
    scale = np.max(np.abs(direct.gradient * b))
    adjoint = gradient(scene, *call, design=design, method=Adjoint())
    # Relative to the variable that counts most; the systems have a condition number up to 1e6.
    assert np.max(np.abs(direct.gradient - adjoint.gradient) * np.abs(b)) < 1e-9 * scale
    every, along = all_at_once(design, b)
    steps = gradient(scene, *call, design=[every], method=ComplexStep())
    slope = direct.gradient @ along
    assert abs(slope - steps.gradient[0]) < 1e-9 * scale
    # Central differences of the call, with values given to the scene: h^2 = 1e-8 times the third
    # derivative, and 1e-12/1e-4.
    high, low = (
        gradient(
            moved(scene, design, b + h * along),
            *call,
            design=design[:1],
            method=DirectDifferentiation(),
        ).value
        for h in (1e-4, -1e-4)
    )
    assert abs((high - low) / 2e-4 - slope) < 1e-6 * scale


def columns(beam, design):
    return [beam.parameter_names()[name.removeprefix("rod.")] for name in design]


def test_what_is_tried_covers_every_parameter():
    names = {name for _, s, _ in CASES for name in SECTIONS[s].size_names()}
    assert names >= {"height", "width", "radius", "thickness", "area", "torsion_moment"}
    assert BEAM_2D.default_energy == ENERGIES["enhanced"]
