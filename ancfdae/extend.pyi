"""Base classes for joints, loads, laws, sections, systems and integrators of one's own."""

from ancfdae.equations import FormulaSystem, MechanicalSystem, StateDirection, SystemProperties
from ancfdae.integrators.integrator import Integrator
from ancfdae.model.bodies import BodyShape, MaterialPoint
from ancfdae.model.elements import StrainEnergyFunction
from ancfdae.model.joints.joint import Joint
from ancfdae.model.laws.law import Law
from ancfdae.model.loads.load import Load
from ancfdae.model.sections.section import Section
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import Observable

__all__ = [
    "BodyShape",
    "FormulaSystem",
    "Integrator",
    "Joint",
    "Law",
    "Load",
    "MaterialPoint",
    "MechanicalSystem",
    "Objective",
    "Observable",
    "Section",
    "SparsityPattern",
    "StateDirection",
    "StrainEnergyFunction",
    "SystemProperties",
]
