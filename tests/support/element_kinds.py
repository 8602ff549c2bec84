"""Every section and strain energy, and references of one element: straight and curved."""

import numpy as np

from ancfdae import DesignVariable, EnhancedContinuum, PlaneStress, SaintVenantKirchhoff
from ancfdae.model.elements import ElementType
from ancfdae.sections import (
    Box,
    Circle,
    GeneralSection,
    ISection,
    QuadratureSection,
    Rectangle,
    Tube,
)

PLACES = [(0.006, 0.004), (-0.006, 0.004), (0.006, -0.004), (-0.006, -0.004)]
SECTIONS = {
    "rectangle": Rectangle(0.02, 0.01),
    "circle": Circle(0.01),
    "tube": Tube(0.01, 0.002),
    "box": Box(0.02, 0.03, 0.001, 0.002),
    "I": ISection(0.04, 0.03, 0.002, 0.003),
    "moments": GeneralSection(1e-4, 2e-9, 1e-9, 3e-9),
    "points": QuadratureSection(places=PLACES, areas=[2e-5] * 4, shear_factors=(0.8, 0.9)),
}
ENERGIES = {
    "SVK": SaintVenantKirchhoff(),
    "SVK assumed": SaintVenantKirchhoff(True),
    "plane stress": PlaneStress(),
    "plane stress assumed": PlaneStress(True),
    "enhanced exact strains": EnhancedContinuum(False),
    "enhanced": EnhancedContinuum(),
}


def kind_of(d, energy, section=None, straight=True):
    return ElementType(section or Rectangle(0.06, 0.04), energy, straight)


def arc(d):
    """Relative node vectors of an arc of 0.5 rad, in space a helix."""
    rows = []
    for theta in (0.0, 0.5):
        tangent = np.array([np.cos(theta), np.sin(theta), 0.3]) / np.sqrt(1.09)
        normal = np.array([-np.sin(theta), np.cos(theta), 0.0])
        rows += [tangent, normal, np.cross(tangent, normal)][:d]
    chord = np.array([np.sin(0.5), 1 - np.cos(0.5), 0.15]) / (0.5 * np.sqrt(1.09))
    return np.array([chord, *rows])[None, :, :d]


def straight(d):
    return np.concatenate([np.eye(d)[:1], np.eye(d), np.eye(d)])[None]


def all_at_once(design, b):
    """A variable that moves all targets by random parts of their sizes, and these changes.

    Errors of derivatives cancel along it by chance alone: parts are random numbers, not signs.
    """
    rng = np.random.default_rng(0)
    along = rng.choice([-1, 1], len(b)) * rng.uniform(0.5, 1, len(b)) * b / len(b) ** 0.5
    return DesignVariable("every", dict(zip(design, along.tolist(), strict=True))), along


def moved(scene, design, values):
    """The scene with all of its design values given."""
    return scene.with_values(dict(zip(design, values.tolist(), strict=True)))
