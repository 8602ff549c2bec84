"""Units of scenes with contact, and the check of their gradients."""

import numpy as np
import pytest

from ancfdae import (
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    assemble,
    gradient,
)

#: Around the origin in SI, and in millimetres and tonnes a thousand lengths away.
UNITS = {"m": (1.0, 1.0, 0.0), "mm": (1e3, 1e-3, 1e5)}


def agree(scene, objective, t_end, design, integrators, difference=True):
    """Check direct, adjoint and complex step against each other, and differences of the call.

    By unit changes of variables, to 1e-10 of each and to round-off of the largest.
    """
    values = assemble(scene, design).b
    unit = np.where(values == 0, 1.0, np.abs(values))
    for integrator in integrators:
        ways = DirectDifferentiation(), Adjoint(), ComplexStep()
        call = objective, t_end, integrator
        found = [gradient(scene, *call, design=design, method=way).gradient * unit for way in ways]
        first, largest = found[0], np.abs(found[0]).max()
        assert largest > 0
        for other in found[1:]:
            np.testing.assert_allclose(other, first, rtol=1e-10, atol=1e-13 * largest)
    for k, name in enumerate(design if difference else ()):
        moved = [
            gradient(scene.with_values({name: values[k] + x * unit[k]}), *call, design=[name]).value
            for x in (-2e-6, -1e-6, 1e-6, 2e-6)
        ]
        fine, wide = (moved[2] - moved[1]) / 2e-6, (moved[3] - moved[0]) / 4e-6
        # Powers of 3/2 make second derivatives jump where contact begins, between two time points.
        assert first[k] == pytest.approx((4 * fine - wide) / 3, rel=1e-6, abs=3e-7 * largest)
