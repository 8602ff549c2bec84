"""Base class of loads: forces on vectors of points as functions of these vectors.

A load names vectors U_i of material points and gives the generalised force F_i
that works on each, delta W = sum_i F_i . delta U_i, in operations that are listed
(`numerics.operations`), so that its derivatives follow. A law of time multiplies it. The assembler
lifts it to Q = L^T F with tangents and design derivatives.
"""

import abc
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_not_negative
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.loads.sections import section_of
from ancfdae.model.parts import Elements, Part, Vectors
from ancfdae.numerics.arrays import Array

#: The last design field of every load.
LAW_FIELD = ("law", require_law)


def require_damping(where: str, value: object) -> None:
    """Raise InvalidInputError unless a damping is a finite number from zero on."""
    require_not_negative(where, value, "Zero is undamped; a negative value would feed energy in.")


@final
@dataclass(frozen=True)
class Copies:
    """Copies of a load: the same formula on other vectors, with numbers of each copy.

    Parameters
    ----------
    own : array, shape (n, n_own)
        Numbers of each copy, which `Load.force_at` gets behind the signals; in SI units.
    lengths : mapping of int to tuple
        For columns of `own` the elements, as the name of a beam and a number counted from 0 on,
        whose lengths multiply the numbers of the copies.
    parameters : array of int, shape (n, m), optional
        Places of parameters of the load that are further own numbers of each copy.
    """

    own: Array
    lengths: Mapping[int, tuple[tuple[str, int], ...]] = field(default_factory=dict)
    parameters: Array | None = None


@dataclass(frozen=True)
class Load(Part):
    """A load on points of beams; fields and names as in `Part`.

    Parameters
    ----------
    law : Law, optional
        Factor of the force over time; its parameters are design targets, too.
    """

    role = "load"
    #: Whether the force depends neither on positions nor on velocities.
    constant: ClassVar[bool] = False
    #: Whether it is a stiffness rather than a load: a search for an equilibrium, which brings up
    #: the loads, leaves it as it is.
    elastic: ClassVar[bool] = False
    #: Design fields without which the force does not depend on velocities.
    damping_fields: ClassVar[tuple[str, ...]] = ()
    #: Whether the force depends on the reference configuration.
    refers: ClassVar[bool] = False
    #: Whether the force may change more suddenly with positions or velocities than they change: a
    #: run within a tolerance then looks for such places along its path.
    sharp: ClassVar[bool] = True

    #: Whether the force acts during short contacts, which the steps of a run must not pass over.
    touches: ClassVar[bool] = False
    #: Whether it stores elastic energy, which `energy` returns.
    stores: ClassVar[bool] = False

    #: Whether it has `efforts_at`: torques of a controller, or tensions of a rope.
    has_efforts: ClassVar[bool] = False

    law: Law | None = field(default=None, kw_only=True)

    def energy(self, U: Any, p: Array, U_o: Array) -> Any:
        """Return the elastic energy of states U, (..., n_vectors, d), shape (...); J.

        Its gradient in U is minus the force at rest. Raises InvalidInputError unless the load
        `stores` energy.
        """
        raise InvalidInputError(
            f"spring_energy of {self.name!r}",
            "must be a spring, which stores energy",
            f"a load of class {type(self).__name__}",
            "Name a SpringDamper, TorsionalSpringDamper or Bushing.",
        )

    def _check_declared(self) -> None:
        super()._check_declared()
        if self.design_fields[-1:] != (LAW_FIELD,):
            where, rule = f"load of class {type(self).__name__}", "must have LAW_FIELD at the end"
            names = [name for name, _ in self.design_fields]
            raise InvalidInputError(
                f"{where}, design_fields", rule, names, "Write (..., LAW_FIELD)."
            )

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Whether the force depends on velocities, given the parameters that are design targets."""
        damping = [self.numbers_of(name) for name in self.damping_fields]
        return any(name in driven or x != 0 for numbers in damping for name, x in numbers.items())

    @abc.abstractmethod
    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the generalised forces on the vectors without the law, (..., n_vectors, d).

        U and V, of the same shape, are the vectors and their time derivatives: complex arrays
        with any leading axes (time points, perturbations), or `Carried` ones, of which one is
        returned. p has the values of `parameters`, as `split` takes them, and U_o, (n_vectors, d),
        the vectors in the reference configuration.
        """

    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return `force` where laws of time other than `law` have the values `signals`, (..., n).

        By default it reads no laws.
        """
        return self.force(U, V, p, U_o)

    def copies(self, elements: Elements) -> Copies | None:
        """Return the copies of a load; its `vectors` belong to one copy after the other.

        None for a load that stands once.
        """
        return None

    def gates(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return numbers of which each says by 0 that there is no force; arguments as `force_at`.

        What the force takes beside them is then not computed.
        """
        return ()

    def signals(self, p: Array, t: Array, order: int) -> Array | None:
        """Return the laws that `force_at` reads, or their time derivative, at times t, (k, n).

        None without such laws.
        """
        return None

    def effort_count(self, p: Array) -> int:
        """Return the number of `efforts_at`."""
        return 0

    def efforts_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return torques of a controller, or tensions of a rope, (..., 1, 1) each.

        Arguments as in `force_at`.
        """
        return ()

    @final
    def factor(self, p: Array, t: Array, order: int) -> Array:
        """Return the law, or its time derivative, at instants; shape as t."""
        if self.law is None:
            return np.full(t.shape, float(order == 0))
        return self.law.derivative(p[len(p) - len(self.law.parameters()) :], t, order)


class ConstantLoad(Load):
    """A load of constant force on one vector, its first design field."""

    constant = True

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the force p on every vector, F = p."""
        return self.split(p)[0] + np.zeros(np.shape(U))


class SectionLoad(Load):
    """A load on the sections of its points, on the slopes that span them."""

    def vectors(self, elements: Elements) -> Vectors:
        """Return the slopes that span the sections on which the load acts."""
        return section_of(self.points, elements)
