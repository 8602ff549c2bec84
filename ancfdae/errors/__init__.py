"""Errors, warnings and outcomes of runs, with their messages.

It knows no mechanics: rules for arguments, the kinds of errors, outcomes, and the wording of lists.
"""

from ancfdae.errors.checks import (
    named,
    require_array,
    require_axial,
    require_count,
    require_direction,
    require_each,
    require_finite,
    require_flag,
    require_folder,
    require_function,
    require_index,
    require_kind,
    require_name,
    require_not_negative,
    require_package,
    require_path,
    require_positive,
    require_sequence,
    require_text,
    require_unique,
    require_vector,
)
from ancfdae.errors.kinds import (
    AncfdaeError,
    CoarseMeshWarning,
    FailedDesignWarning,
    InconsistentStartError,
    InvalidInputError,
    LargeStrainWarning,
    ManyStepsWarning,
    MissingPackageError,
    NotTracedWarning,
    RedundantConstraintsError,
    SingularMatrix,
    StabilityWarning,
    ToleranceWarning,
    UnknownNameError,
    UnlikelyValueWarning,
)
from ancfdae.errors.outcomes import (
    Interrupted,
    PassFailed,
    RunOutcome,
    Verdict,
    uninterrupted,
)
