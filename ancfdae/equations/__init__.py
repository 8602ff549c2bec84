"""The base class of mechanical systems, and the solution that a run of one returns.

`system` states the contract: eleven values, and all quantities derived from them. `formula_system`
derives everything from a user's formulas for M, Q and Phi; `conformance` compares every
override of a system with the default that it replaces. This package knows no beams and no joints.
"""

from ancfdae.equations.formula_system import FormulaSystem
from ancfdae.equations.naming import Naming
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import ErrorEstimates, Sensitivities, Statistics
from ancfdae.equations.system import (
    DesignPartials,
    LaterSystem,
    Linearisation,
    ListedSystem,
    MechanicalSystem,
    PlannedSystem,
    StateDirection,
    SystemProperties,
    planned,
    reaction,
)
