"""Base class of loads: forces on vectors of points as functions of these vectors.

A load names vectors U_i of material points and gives the generalised force F_i
on each, delta W = sum_i F_i . delta U_i, as recorded operations (`numerics.operations`), from which
its derivatives follow. A law of time multiplies it. `assembly` maps it to Q = L^T F with tangents
and design derivatives.
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
        Numbers of each copy, which `Load.force_at` receives after the signals; in SI units.
    lengths : mapping of int to tuple
        For columns of `own`, one element per copy (beam name, index from 0) whose length multiplies
        the number of the copy.
    parameters : array of int, shape (n, m), optional
        Indices of parameters of the load that are further numbers of each copy.
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
    #: Whether it is a stiffness rather than a load: a search for equilibrium, which increases the
    #: loads gradually, applies it in full from the start.
    elastic: ClassVar[bool] = False
    #: Design fields that make the force depend on velocities; if all are zero it does not.
    damping_fields: ClassVar[tuple[str, ...]] = ()
    #: Whether the force depends on the reference configuration.
    refers: ClassVar[bool] = False
    #: Whether the force may change abruptly with positions or velocities: error-controlled runs
    #: then check the path of each step for it.
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

        Its gradient in U is minus the force at zero velocity. Raises InvalidInputError unless the
        load `stores` energy.
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
        """Whether the force depends on velocities, if `driven` are the driven parameters."""
        damping = [self.numbers_of(name) for name in self.damping_fields]
        return any(name in driven or x != 0 for numbers in damping for name, x in numbers.items())

    @abc.abstractmethod
    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the generalised forces on the vectors without the law, (..., n_vectors, d).

        U and V, of this shape, are the vectors and their time derivatives: complex arrays with any
        leading axes (time points, perturbations), or `Carried` arrays, for which one is returned. p
        holds the values of `parameters`, as `split` takes them, and U_o, (n_vectors, d), the
        vectors in the reference configuration.
        """

    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return `force` for the values `signals`, (..., n), of laws of time other than `law`.

        By default there are no further laws.
        """
        return self.force(U, V, p, U_o)

    def copies(self, elements: Elements) -> Copies | None:
        """Return the copies of the load, whose `vectors` follow one copy after the other.

        None, the default, for a single load.
        """
        return None

    def gates(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return numbers each of which is 0 where the force vanishes; arguments as in `force_at`.

        Where one is 0, the force is not computed.
        """
        return ()

    def signals(self, p: Array, t: Array, order: int) -> Array | None:
        """Return the laws that `force_at` reads, or a time derivative, at times t, (k, n).

        None, the default, without such laws.
        """
        return None

    def effort_count(self, p: Array) -> int:
        """Return the number of efforts that `efforts_at` returns; 0 by default."""
        return 0

    def efforts_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return torques of a controller, N m, or tensions of a rope, N, (..., 1, 1) each.

        Arguments as in `force_at`.
        """
        return ()

    @final
    def factor(self, p: Array, t: Array, order: int) -> Array:
        """Return the law, or a time derivative of it, at times t, shape of t; 1 without a law."""
        if self.law is None:
            return np.full(t.shape, float(order == 0))
        return self.law.derivative(p[len(p) - len(self.law.parameters()) :], t, order)


class ConstantLoad(Load):
    """A load whose force on its one vector is its first design field."""

    constant = True

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the constant force on the vector, shape of U."""
        return self.split(p)[0] + np.zeros(np.shape(U))


class SectionLoad(Load):
    """A load on sections: on the slopes that span the sections of its points."""

    def vectors(self, elements: Elements) -> Vectors:
        """Return the slopes that span the sections on which the load acts."""
        return section_of(self.points, elements)
