"""The default energy of an element against its definition in vectors, at random node vectors."""

import numpy as np
import pytest

from ancfdae import BEAM_2D, BEAM_3D, EnhancedContinuum
from ancfdae.assembly.elastic_forces import strain_energy
from ancfdae.model.elements import Batch, ElementParameter
from ancfdae.model.elements.continuum import prepare
from ancfdae.sections import QuadratureSection
from tests.support.element_kinds import arc, kind_of, straight
from tests.support.oracle import plain_strains

E, NU, L = 3.0, 0.3, 0.5
# An L, off its axis, of unequal second moments and with a product moment.
PLACES = np.array([(0.08, 0.02), (0.03, 0.02), (-0.02, 0.05), (-0.02, -0.01), (-0.02, -0.04)])
AREAS = np.array([3e-3, 2e-3, 1e-3, 2e-3, 1e-3])
K_Y, K_Z, J = 0.8, 0.6, 4e-6


@pytest.mark.parametrize("element", [BEAM_2D, BEAM_3D], ids=lambda e: e.name)
@pytest.mark.parametrize("form", ["straight", "curved"])
@pytest.mark.parametrize("assumed", [True, False])
def test_energy_is_that_of_strains_in_vectors(element, form, assumed):
    d = element.d
    section = QuadratureSection(
        places=PLACES, areas=AREAS, shear_factors=(K_Y, K_Z), torsion_constant=J
    )
    kind = kind_of(d, EnhancedContinuum(assumed), section, form == "straight")
    values = np.zeros((1, len(ElementParameter)))
    values[0, :8] = E, NU, 1000.0, L, 0.0, 0.0, 1.0, 1.0
    Y_unit = straight(d) if form == "straight" else arc(d)
    inv = prepare(element, Batch(kind, values, Y_unit))
    Y_o = Y_unit[0].copy()
    Y_o[0] *= L
    centred = PLACES - AREAS @ PLACES / AREAS.sum()
    moments = AREAS @ centred**2
    law = {
        "E": E,
        "nu": NU,
        "assumed": assumed,
        "straight": form == "straight",
        "factors": np.sqrt([K_Y, K_Z, J / moments.sum()]),
        "radii": np.sqrt(np.append(moments, J) / AREAS.sum()),
        "centroid": AREAS @ PLACES / AREAS.sum(),
        "shear_centre": AREAS @ PLACES / AREAS.sum(),
    }
    points = [(*place, area) for place, area in zip(PLACES, AREAS, strict=True)]
    random = np.random.default_rng(3)
    for _ in range(5):
        Y = Y_o + 0.4 * random.standard_normal(Y_o.shape)
        expected = plain_strains.energy(Y, Y_o, L, points, law)
        # Sums of some hundred terms, cancelling by a factor of ten: 1e-13.
        assert strain_energy(inv.A, inv.g_o, Y[None])[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("element", [BEAM_2D, BEAM_3D], ids=lambda e: e.name)
@pytest.mark.parametrize("form", ["straight", "curved"])
def test_partials_of_a_section_off_its_axis_are_complex_steps(element, form):
    Y = straight(element.d) if form == "straight" else arc(element.d)
    section = QuadratureSection(places=PLACES, areas=AREAS)
    kind = kind_of(element.d, EnhancedContinuum(), section, form == "straight")
    values = np.zeros((1, len(ElementParameter)))
    values[0, :8] = E, NU, 1000.0, L, 0.0, 0.0, 1.1, 0.9
    wanted = (ElementParameter.LENGTH, ElementParameter.SIZE_1, ElementParameter.SIZE_2)
    partials = prepare(element, Batch(kind, values, Y)).partials(wanted)
    for which in wanted:
        moved = values.astype(complex)
        moved[0, which] += 1e-40j
        exact = prepare(element, Batch(kind, moved, Y)).A.imag / 1e-40
        # Two evaluations of one derivative: round-off of sums of some hundred terms.
        scale = np.max(np.abs(exact))
        np.testing.assert_allclose(partials[which].A, exact, rtol=0, atol=1e-11 * scale)
