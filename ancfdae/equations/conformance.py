"""Check of a mechanical system: every member against the values that determine it."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.equations.proof import (
    Probe,
    declarations,
    other_values,
    prove,
    refusals,
    shapes,
    start,
)
from ancfdae.equations.solution_parts import pandas
from ancfdae.equations.system import MechanicalSystem
from ancfdae.errors.checks import require_count, require_index, require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import listed, page

# Value given to design variables that are zero and must not be negative; steps are at most half of
# it.
_AWAY = 0.1


@final
@dataclass(frozen=True)
class Finding:
    """Largest relative error of one method or property of a system, and its tolerance."""

    name: str
    error: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether the error is within its tolerance."""
        return self.error <= self.tolerance

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "WRONG"
        return f"{self.name:<58} {self.error:9.1e} {self.tolerance:9.1e}  {verdict}"


@final
@dataclass(frozen=True)
class SystemCheck:
    """Findings of `check_system` on a system of the class `name`; ``print`` it for a table."""

    name: str
    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Whether the errors of all findings are within their tolerances."""
        return not self.wrong

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """Findings whose error exceeds their tolerance."""
        return tuple(finding for finding in self.findings if not finding.passed)

    def raise_if_wrong(self) -> None:
        """Raise InvalidInputError that names the system's methods with errors above tolerance."""
        if self.wrong:
            names = "; ".join(f"{x.name} (error {x.error:.1e})" for x in self.wrong)
            raise InvalidInputError(
                self.name,
                "must agree with its own values and their differences",
                f"{len(self.wrong)} of {len(self.findings)} that do not: {names}",
                "Correct these methods; print the report for all of them.",
            )

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each finding: name, error, tolerance, passed."""
        rows = [(x.name, x.error, x.tolerance, x.passed) for x in self.findings]
        return pandas().DataFrame(rows, columns=["finding", "error", "tolerance", "passed"])

    def _repr_html_(self) -> str:
        first = sorted(self.findings, key=lambda x: x.passed)
        rows = [(x.name, f"{x.error:.1e}", f"{x.tolerance:.1e}") for x in first]
        return page(repr(self), [("finding", "error", "tolerance"), *rows])

    def __repr__(self) -> str:
        wrong = f"wrong: {listed(x.name for x in self.wrong)}" if self.wrong else "all ok"
        return f"{self.name}: {len(self.findings)} checks, {wrong}"

    def __str__(self) -> str:
        head = f"{self.name:<58} {'error':>9} {'tolerance':>9}"
        lines = [head, "-" * len(head), *(str(finding) for finding in self.findings)]
        wrong = f"{len(self.wrong)} wrong" if self.wrong else "all ok"
        return "\n".join([*lines, f"{len(self.findings)} checks, {wrong}."])


def check_system(system: MechanicalSystem, *, samples: int = 2, seed: int = 0) -> SystemCheck:
    """Check every member of a mechanical system against its values.

    Every member that a system may override is compared with what the base class derives from the
    values, by differences of real numbers, extrapolated to about 1e-10, and the values with each
    other; shapes, declarations and the start are checked. A wrong sign or factor is an error of
    order one. A value that refuses complex numbers is named if other members are complex steps of
    it; where they are accepted, the steps are compared too. States are random, beside the start;
    they need not lie on the constraints.

    Parameters
    ----------
    system : MechanicalSystem
    samples : int
        Number of random states; the largest error of all is reported.
    seed : int
        Seed of the random states.

    Returns
    -------
    SystemCheck
        ``print`` it, read whether it ``passed``, or call ``raise_if_wrong()``.

    Raises
    ------
    InvalidInputError
        If `system` is no MechanicalSystem or its design values are complex.
    """
    require_kind("system", system, (MechanicalSystem,), "Assemble a scene first.")
    require_count("samples", samples, "2 is plenty.")
    require_index("seed", seed, 2**32, "For example 0.")
    if np.asarray(system.b).dtype.kind != "f":
        raise InvalidInputError(
            "system.b", "must be real", system.b.dtype, "Check with real values."
        )
    rng = np.random.default_rng(seed)
    findings, system = dict[str, Finding](), _inside(system)

    def add(name: str, error: float, tolerance: float) -> None:
        before = findings[name].error if name in findings else 0.0
        findings[name] = Finding(name, max(before, float(error)), tolerance)

    with np.errstate(all="ignore"):
        for _ in range(samples):
            probe = Probe(system, rng)
            for check in (shapes, refusals, start, other_values, declarations, prove):
                check(add, probe)
                # With wrong shapes or missing derivatives later checks would be meaningless.
                if check in (shapes, refusals) and not all(x.passed for x in findings.values()):
                    return SystemCheck(type(system).__name__, tuple(findings.values()))
    return SystemCheck(type(system).__name__, tuple(findings.values()))


def _inside(system: MechanicalSystem) -> MechanicalSystem:
    """Return the system at design values away from zero where these must not become negative."""
    b = system.b.copy()
    for i in np.flatnonzero(b == 0):
        less = system.b.copy()
        less[i] = -_AWAY
        try:
            system.with_values(less)
        except InvalidInputError:
            b[i] = _AWAY
    return system if np.array_equal(b, system.b) else system.with_values(b)
