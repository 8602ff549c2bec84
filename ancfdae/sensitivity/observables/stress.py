"""Observables of stress: von Mises' at a point of a beam, and its smooth maximum over a beam.

The stress is the second Piola-Kirchhoff one of the beam's law, with the part of internal damping;
it differs from the true one by the order of the strain. Sections say how shear stress of torsion
spreads over them: by Saint-Venant's solution, Bredt's formula for boxes, that of each wall for I
sections. Shear stress of V_y and V_z spreads by Jourawski's formula, with its component along the
force only, and so does the radial stress of curved beams, M/(A R) in the mean; both uniformly for
energies other than `EnhancedContinuum`. In a curved bar in bending the stress errs, against plane
elasticity, by 3.5 % of its largest value where the radius of curvature equals the height, by 1.0 %
and 0.2 % where it is two and five times the height. Cables have the stress of their axial force and
bending moment; in space, where they may lie turned about themselves, the largest that a point so
far from the centroid can have. A strain of 1e-9 is added in squares, E times
1e-9, so that the stress has a derivative where there is none.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_positive, require_text
from ancfdae.model.bodies import MaterialPoint, require_point
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import Named, States, known_scene


def von_mises(point: MaterialPoint) -> Observable:
    """Return von Mises' stress at a point of a beam, ``rod.at(0.3, y=0.01)`` say; Pa."""
    return VonMises(point)


def maximum_von_mises(beam: str, sharpness: float) -> Observable:
    """Return the smooth maximum of von Mises' stress over a beam at every instant; Pa.

    The aggregate of Kreisselmeier and Steinhauser over n points, log(sum exp(k s))/k: it exceeds
    the largest stress s by at most log(n)/k. The points are those of the section's outline where
    stresses of bending and torsion are largest, at both ends and in the middle of every element.

    For the largest over time too, take ``SmoothUpperBound(maximum_von_mises("rod", k), k)``, a
    bound.

    Parameters
    ----------
    beam : str
        Name of the beam.
    sharpness : float
        k, in the inverse unit of a stress; positive. 50 over the stress allowed, say.
    """
    return MaximumStress(beam, sharpness)


@final
@dataclass(frozen=True)
class VonMises(Leaf):
    """Von Mises' stress at a material point."""

    point: MaterialPoint

    def __post_init__(self) -> None:
        require_point("von_mises, point", self.point)

    def check_leaf(self, system: Named) -> None:
        """Refuse a point that does not exist or lies outside the section."""
        sections = known_scene(system).sections
        sections.require_material("von_mises, point", self.point)
        sections.stress_at(self.point)

    def leaf_value(self, system: Named, states: States) -> Array:
        """One stress per instant."""
        return known_scene(system).sections.stress_at(self.point).value(states.q, states.v)[:, 0, 0]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Pull back one stress."""
        points = known_scene(system).sections.stress_at(self.point)
        weights = np.ones((len(states.t), 1, 1))
        return LeafGradient.of(points.partials(states.q, states.v, weights, system.n_b))


@final
@dataclass(frozen=True)
class MaximumStress(Leaf):
    """Kreisselmeier-Steinhauser aggregate of von Mises' stress over a beam."""

    beam: str
    sharpness: float

    def __post_init__(self) -> None:
        require_text("maximum_von_mises, beam", self.beam)
        require_positive("maximum_von_mises, sharpness", self.sharpness)

    def check_leaf(self, system: Named) -> None:
        """Refuse a beam that does not exist or has no stresses."""
        known_scene(system).sections.stress_over(self.beam)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Logarithm of the sum."""
        stress = known_scene(system).sections.stress_over(self.beam).value(states.q, states.v)
        k = self.sharpness
        return np.asarray(scipy.special.logsumexp(k * stress, axis=(1, 2)) / k)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Pull back the mean with the weights exp(k s)."""
        points = known_scene(system).sections.stress_over(self.beam)
        stress = points.value(states.q, states.v)
        weights = scipy.special.softmax(self.sharpness * stress, axis=(1, 2))
        return LeafGradient.of(points.partials(states.q, states.v, weights, system.n_b))
