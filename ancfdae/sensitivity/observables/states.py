"""Arguments of observables: states over time, and a system that knows names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, final

import numpy as np

from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem, Naming, Solution
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import TimeGrid


class Named(Protocol):
    """Anything that knows named points and joints: a mechanical system or a solution."""

    @property
    def naming(self) -> Naming | None:
        """Names of points and joints."""


@final
@dataclass(frozen=True)
class States:
    """States of a system at a sequence of instants, as rows, real or complex.

    `degree` is that of the polynomials between the instants (`TimeGrid`). Of a part of a run `past`
    holds, by leaf, the values at its first instant of leaves that remember.
    """

    t: Array
    q: Array
    v: Array
    lam: Array
    degree: int = 1
    past: Mapping[object, float] = field(default_factory=dict)

    @property
    def grid(self) -> TimeGrid:
        """The instants, for integrals and values between them."""
        return TimeGrid(self.t, self.degree)

    def rows(self, which: slice | list[int]) -> States:
        """Return the states at some of the instants."""
        return States(self.t[which], self.q[which], self.v[which], self.lam[which])


def states_of(solution: Solution) -> States:
    """Return the states of a solution."""
    return States(solution.t, solution.q, solution.v, solution.lam, solution.degree)


def known_naming(system: Named) -> SceneNaming:
    """Return the names of an ANCF scene; refuse a system that has none."""
    if not isinstance(system.naming, SceneNaming):
        raise InvalidInputError(
            "observable of a named point or joint",
            "needs an assembled scene",
            "a system of another kind",
            "Use custom(function, name) for a system of your own.",
        )
    return system.naming


def require_index(where: str, index: int, count: int = 3) -> None:
    """Raise InvalidInputError unless `index` is an integer from 0 to count - 1."""
    given: object = index
    whole = isinstance(given, int | np.integer) and not isinstance(given, bool)
    if not whole or not 0 <= index < count:
        raise InvalidInputError(
            where,
            f"must be an integer from 0 to {count - 1}",
            repr(index),
            "Counting starts at 0, so that axes 0, 1 and 2 are x, y and z.",
        )


def known_system(name: str, system: Named) -> MechanicalSystem:
    """Return the system; refuse a solution, which cannot replace it."""
    if not isinstance(system, MechanicalSystem):
        raise InvalidInputError(
            f"observable {name!r}",
            "needs the mechanical system, not its solution alone",
            type(system).__name__,
            "Pass the system, for a scene assemble(scene, design).",
        )
    return system


def known_scene(system: Named) -> AncfSystem:
    """Return `system` as an assembled scene; raise InvalidInputError for any other system."""
    if not isinstance(system, AncfSystem):
        rule, repair = "needs the assembled scene", "Pass assemble(scene, design)."
        raise InvalidInputError("observable of beams", rule, type(system).__name__, repair)
    return system
