"""The protocol of mechanical systems, and the solution that a run of one returns.

`system` states the contract: eleven values, and all that follows from them. `formula_system`
takes derivatives of a system that a user writes by M, Q and Phi; `conformance` and `proof` compare
every override of a system with what it overrides. It knows no beam and no joint.
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
    require_no_controllers,
)
