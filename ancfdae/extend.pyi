"""Base classes for joints, loads, laws, sections, systems and integrators of one's own."""

from ancfdae.equations import FormulaSystem, MechanicalSystem, StateDirection, SystemProperties
from ancfdae.integrators.integrator import AdjointIntegrator, Integrator
from ancfdae.integrators.problem import InitialValueProblem, stacked
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.model.bodies import BodyShape, MaterialPoint
from ancfdae.model.design import design_numbers
from ancfdae.model.elements import BeamElement, StrainEnergyFunction
from ancfdae.model.elements.element import ElementIntegrals, Quantity
from ancfdae.model.joints.joint import FormulaJoint, Joint, JointEquations, empty_equations
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.loads.controller import (
    ControlAxis,
    Controller,
    ControllerInput,
    RotationAxis,
    TranslationAxis,
)
from ancfdae.model.loads.load import LAW_FIELD, Load
from ancfdae.model.sections.section import Section
from ancfdae.numerics.external import ExternalFunction
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.numerics.time_grid import box_rule
from ancfdae.numerics.vector_formulas import concatenate, cross, dot, positive
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import Observable

__all__ = [
    "LAW_FIELD",
    "AdjointIntegrator",
    "BeamElement",
    "BodyShape",
    "ControlAxis",
    "Controller",
    "ControllerInput",
    "ElementIntegrals",
    "ExternalFunction",
    "FormulaJoint",
    "FormulaSystem",
    "InitialValueProblem",
    "Integrator",
    "Joint",
    "JointEquations",
    "Law",
    "Load",
    "MaterialPoint",
    "MechanicalSystem",
    "Objective",
    "Observable",
    "Quantity",
    "RotationAxis",
    "Section",
    "SolutionRecorder",
    "SparsityPattern",
    "StateDirection",
    "StrainEnergyFunction",
    "SystemProperties",
    "TranslationAxis",
    "box_rule",
    "concatenate",
    "cross",
    "design_numbers",
    "dot",
    "empty_equations",
    "positive",
    "require_law",
    "stacked",
]
