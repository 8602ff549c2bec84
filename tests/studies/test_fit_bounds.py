"""Fits know between which values a part can take a design variable."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from ancfdae import (
    Beam,
    Clamp,
    DesignVariable,
    FrequencyMisfit,
    Material,
    PointForce,
    PointMass,
    Scene,
    SpringDamper,
    StaticMisfit,
    modes,
)
from ancfdae.observables import position
from ancfdae.sections import Tube

BAR = Tube(radius=0.5, thickness=0.02)
ROD = Beam("rod", (1, 0), (3, 0), 2, BAR, Material(1000, 1e7, 0.3, damping_time=0.0))
LOADS = [
    PointForce(ROD.at_end, (0, -5), name="load"),
    SpringDamper(ROD.at_end, 50.0, 0.2, ground=(3, 1), name="spring"),
]
MASS = PointMass(ROD.at_end, 2, name="m")
SCENE = Scene([ROD], [Clamp(ROD.at_start)], (0, -9.81), loads=LOADS, bodies=[MASS])
SHARED = DesignVariable("E and rho", {"rod.youngs_modulus": 1e4, "rod.density": 1.0})
POSITIVE, FREE = (0.0, np.inf), (-np.inf, np.inf)


@pytest.mark.parametrize(
    ("variable", "limits"),
    [
        ("rod.youngs_modulus", POSITIVE),
        ("rod.density", POSITIVE),
        ("rod.poisson_ratio", (-1.0, 0.5)),
        ("rod.damping_time", POSITIVE),
        ("rod.thickness", POSITIVE),  # below the radius at this radius only
        ("rod.radius", POSITIVE),  # above the thickness at this thickness only
        ("rod.length", POSITIVE),
        ("rod.start_x", FREE),  # at 3 the beam has no length
        ("spring.stiffness", FREE),  # springs may push
        ("spring.damping", POSITIVE),
        ("spring.ground_y", FREE),
        ("load.force_y", FREE),
        ("scene.gravity_y", FREE),
        ("m.mass", POSITIVE),
        (DesignVariable("E", ["rod.youngs_modulus"], bounds=(1e6, 1e8)), (1e6, 1e8)),
        (DesignVariable("t", ["rod.thickness"], bounds=(-1.0, 0.1)), (0.0, 0.1)),
        (SHARED, POSITIVE),
    ],
    ids=str,
)
def test_bounds_of_one_variable(variable, limits):
    fit = StaticMisfit([position(ROD.at_end, 1)], [0.0]).fit(SCENE, design=[variable])
    assert tuple(np.ravel(fit.bounds)) == limits


def test_a_fit_that_would_leave_what_a_modulus_can_be_stays_within():
    """Frequencies go with the root of E: from 200 times E the first step of Gauss-Newton is < 0."""
    free = Scene([ROD], [Clamp(ROD.at_start)])
    seen = modes(free, 1).natural_frequencies
    stiff = free.with_values({"rod.youngs_modulus": 200 * 1e7})
    fit = FrequencyMisfit(seen).fit(stiff, design=["rod.youngs_modulus"])
    step = fit.residuals(fit.start)[0] / fit.jacobian(fit.start)[0, 0]
    assert fit.start[0] - step < 0
    found = least_squares(
        fit.residuals, fit.start, fit.jacobian, fit.bounds, x_scale="jac", gtol=None
    )
    np.testing.assert_allclose(found.x, 1e7, rtol=1e-6)
