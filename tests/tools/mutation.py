"""Mutation testing with cosmic-ray (.github/CONTRIBUTING.md): a sample of mutants, and their tests.

python -m tests.tools.mutation sample SESSION NUMBER SEED    keeps NUMBER mutants of every package
python -m tests.tools.mutation baseline                      runs every selection without a mutation
python -m tests.tools.mutation run SESSION                   tests the mutants that have no result
python -m tests.tools.mutation report SESSION                counts, and the mutants that survived
"""

import difflib
import os
import random
import re
import resource
import sys
from collections import defaultdict

# What takes longer to import than most tests run, for the children of `passes`.
import matplotlib.figure  # noqa: F401
import pytest
import scipy.integrate
import scipy.interpolate
import scipy.optimize
import scipy.sparse.csgraph
import scipy.sparse.linalg
import scipy.special  # noqa: F401

PASSES = [
    "tests/sensitivity/test_adjoint.py",
    "-k",
    "dot_product or complex_step_of_the_run or pass",
]
# From the path of a module, without ancfdae/, to the tests that are to kill its mutants: quick
# ones first.
TESTS = {
    "model/elements/": [
        ["tests/model/test_assumed_strains.py"],
        ["tests/model/test_invariants.py", "-k", "complex_step_of_force"],
        ["tests/model/test_cable.py"],
        ["tests/model/test_strain_energies.py"],
        ["tests/model/test_invariants.py", "-k", "not papers"],
        ["tests/sensitivity/test_section_forces.py"],
        ["tests/assembly/test_assembler.py"],
    ],
    "model/joints/": [
        ["tests/model/test_parts.py", "-k", "joint"],
        ["tests/model/test_joints.py"],
        ["tests/assembly/test_assembler.py"],
        ["tests/public/test_bad_input.py"],
    ],
    "model/laws/": [
        ["tests/model/test_laws.py"],
        ["tests/physics/test_load_motions.py"],
        ["tests/model/test_drives.py"],
    ],
    "model/loads/": [
        ["tests/model/test_parts.py", "-k", "load"],
        ["tests/model/test_loads.py"],
        ["tests/assembly/test_assembler.py"],
        ["tests/public/test_bad_input.py"],
    ],
    "integrators/hht/": [
        ["tests/integrators/test_step_error.py"],
        ["tests/integrators/test_newton.py"],
        ["tests/integrators/test_controlled_sensitivities.py", "-k", "frozen_steps or counted"],
        ["tests/studies/test_error_bars.py", "-k", "weighted_estimate_is and end"],
        PASSES,
        ["tests/integrators/test_extremes.py", "-k", "tiny_steps"],
        ["tests/integrators/test_start.py"],
        ["tests/integrators/test_order.py", "-k", "not flexible"],
        ["tests/equations/test_own_systems.py", "-k", "is_the_complex_step or discrete_adjoint"],
    ],
    "sensitivity/adjoint": [
        [
            "tests/sensitivity/test_adjoint.py",
            "-k",
            "time_of or factorise or refused_before or any_mechanical",
        ],
        ["tests/integrators/test_high_order.py", "-k", "refusals or (of_idas and Integral-lam)"],
        ["tests/sensitivity/test_adjoint.py", "-k", "is_complex_step and (pinned or damped-6)"],
    ],
    "sensitivity/continuous": [
        ["tests/sensitivity/test_adjoint_end.py", "-k", "satisfies"],
        ["tests/sensitivity/test_adjoint_end.py", "-k", "gradient"],
        ["tests/equations/test_own_systems.py", "-k", "discrete_adjoint"],
        [
            "tests/sensitivity/test_adjoint.py",
            "-k",
            "continuous or passes or time_of or factorisations",
        ],
    ],
    "sensitivity/observables/": [
        ["tests/sensitivity/test_observables.py"],
        ["tests/sensitivity/test_objectives.py"],
    ],
    "sensitivity/objectives/": [
        ["tests/sensitivity/test_objectives.py"],
        ["tests/sensitivity/test_adjoint.py", "-k", "is_complex_step and (pinned or damped-6)"],
        [
            "tests/integrators/test_integrals.py",
            "-k",
            "relative_to or finite or interrupt or leaves",
        ],
        ["tests/integrators/test_integrals.py", "-k", "panels and (DOP853 or multipliers)"],
        [
            "tests/integrators/test_integrals.py",
            "-k",
            "differences or (idas and (function or multipliers))",
        ],
    ],
}
# Operators that a sign, a factor or a branch written wrongly looks like. The others put a bit
# operation or a modulus where a float stands, which fails whatever the tests are, or an operator
# into an annotation.
SERIOUS = re.compile(
    r"core/(ReplaceBinaryOperator_(Add_Sub|Sub_Add|Add_Mul|Mul_Add|Mul_Div|Div_Mul|Pow_Mul|Pow_Div)"
    r"|ReplaceComparisonOperator_(Eq_NotEq|NotEq_Eq|Lt_(LtE|GtE)|LtE_(Lt|Gt)|Gt_(GtE|LtE)"
    r"|GtE_(Gt|Lt)|Is_IsNot|IsNot_Is)|ReplaceUnaryOperator_(USub_UAdd|Delete_(USub|Not))|AddNot"
    r"|ReplaceTrueWithFalse|ReplaceFalseWithTrue|ReplaceAndWithOr|ReplaceOrWithAnd"
    r"|ReplaceBreakWithContinue|ReplaceContinueWithBreak|NumberReplacer|ZeroIterationForLoop)"
)


def package(path):
    """Key of TESTS of a module."""
    return next(name for name in TESTS if str(path).startswith(f"ancfdae/{name}"))


def sample(session, number, seed):
    from cosmic_ray.work_db import use_db
    from cosmic_ray.work_item import WorkerOutcome, WorkResult

    with use_db(session) as database:
        groups = defaultdict(list)
        for item in database.work_items:
            (mutation,) = item.mutations
            if SERIOUS.fullmatch(mutation.operator_name):
                key = (str(mutation.module_path), mutation.operator_name, mutation.occurrence)
                groups[package(mutation.module_path)].append((*key, item.job_id))
        kept = set()
        for name in TESTS:
            items = sorted(groups[name])
            chosen = random.Random(seed).sample(items, min(int(number), len(items)))
            kept |= {item[-1] for item in chosen}
            print(f"{name}: {len(chosen)} of {len(items)} mutants")
        rest = [item.job_id for item in database.work_items if item.job_id not in kept]
        skipped = WorkResult(worker_outcome=WorkerOutcome.SKIPPED)
        database.set_multiple_results(rest, skipped)


def run(session):
    """Test every mutant of the sample that has no result.

    As `cosmic-ray exec` does, but in a child of this process each, which has imported everything
    that is not mutated: that takes longer than most tests.
    """
    from cosmic_ray import mutating, plugins
    from cosmic_ray.work_db import use_db
    from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkResult

    with use_db(session) as database:
        for item in database.pending_work_items:
            (mutation,) = item.mutations
            path, operator = mutation.module_path, plugins.get_operator(mutation.operator_name)
            operator = operator(**mutation.operator_args)
            with mutating.use_mutation(path, operator, mutation.occurrence) as (old, new):
                outcome = TestOutcome.SURVIVED if passes(path) else TestOutcome.KILLED
            diff = "\n".join(difflib.unified_diff(old.splitlines(), new.splitlines(), n=0))
            result = WorkResult(WorkerOutcome.NORMAL, test_outcome=outcome, diff=diff)
            database.set_result(item.job_id, result)


def baseline():
    """Tell which selections pass without a mutation; where one does not, every mutant dies."""
    for name in TESTS:
        print(f"{name}: {'passes' if passes(f'ancfdae/{name}') else 'FAILS'}", flush=True)


def passes(path):
    """Whether the tests of a module pass, one selection after the other, within two minutes."""
    child = os.fork()
    if child == 0:
        # Processor time, so that a mutant on a busy machine has as much as on an idle one.
        resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
        failed, selections = True, [*TESTS[package(path)], ["tests/public/test_frozen.py"]]
        try:
            failed = any(pytest.main([*options, *x]) for x in selections)
        finally:
            os._exit(failed)
    return os.waitpid(child, 0)[1] == 0


def report(session):
    from cosmic_ray.work_db import use_db
    from cosmic_ray.work_item import TestOutcome, WorkerOutcome

    counts = defaultdict(lambda: [0, 0])
    with use_db(session) as database:
        for item, result in database.completed_work_items:
            if result.worker_outcome is WorkerOutcome.SKIPPED:
                continue
            (mutation,) = item.mutations
            survived = result.test_outcome is TestOutcome.SURVIVED
            count = counts[package(mutation.module_path)]
            count[0] += not survived
            count[1] += 1
            if survived:
                print(f"\n{mutation.module_path}:{mutation.start_pos[0]} {mutation.operator_name}")
                lines = (result.diff or "").splitlines()
                print("\n".join(x for x in lines if re.match(r"[-+](?![-+])", x)))
    for name, (killed, total) in counts.items():
        print(f"{name}: {killed} of {total} killed")
    killed, total = (sum(x) for x in zip(*counts.values(), strict=True))
    print(f"all: {killed} of {total} killed, {100 * killed / total:.1f} %")


if __name__ == "__main__":
    sys.exit(
        {"sample": sample, "baseline": baseline, "run": run, "report": report}[sys.argv[1]](
            *sys.argv[2:]
        )
    )
