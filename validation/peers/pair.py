"""One scene for both codes."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

from ancfdae import Scene, simulate
from ancfdae.extend import Integrator, MaterialPoint
from ancfdae.numerics.arrays import Array

GRAVITY = 9.81


class Model(NamedTuple):
    """What a main system of Exudyn is asked for.

    ``read()`` is where the compared point is, ``vary(i, factor)`` multiplies design variable i.
    """

    read: Callable[[], Any]
    vary: Callable[[int, float], None] = lambda i, factor: None


class Pair(ABC):
    """A scene in this package and in Exudyn, compared where a point of it is.

    `asked` is the largest ratio of this package's time to Exudyn's that is wanted; `symmetric`
    says whether the matrices of the model in Exudyn are symmetric.
    """

    asked: ClassVar[float] = 1.0
    symmetric: ClassVar[bool] = False

    @property
    @abstractmethod
    def title(self) -> str:
        """Name of the model in the tables of the report."""

    @abstractmethod
    def scene(self) -> Scene:
        """Return the model as a scene of this package."""

    @property
    @abstractmethod
    def point(self) -> MaterialPoint:
        """The point that is compared."""

    @abstractmethod
    def build(self, exu: Any, items: Any, mbs: Any) -> Model:
        """Add the items to a main system of Exudyn.

        `exu` is the module ``exudyn``, `items` its ``utilities``.
        """

    @property
    def newton(self) -> float:
        """Tolerance of Newton's method."""
        return 1e-8

    def design(self) -> list[str]:
        """Return the design variables, in the order of `Model.vary`."""
        return []

    def end(self, t_end: float, integrator: Integrator) -> Array:
        """Return where this package finds the point at the end."""
        solution = simulate(self.scene(), t_end, integrator)
        return solution.position(self.point)[-1]
