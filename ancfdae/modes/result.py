"""Modes: frequencies, damping and shapes of small motions, and their design derivatives."""

from dataclasses import dataclass
from enum import Enum
from typing import Any, final

import numpy as np

from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_index
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText, listed
from ancfdae.modes.linearised import LinearisationPoint
from ancfdae.numerics.arrays import Array


class ModeKind(Enum):
    """Kind of a mode; the value is the text of messages and tables."""

    RIGID = "free to move"
    VIBRATION = "vibrates"
    GROWING = "grows (unstable)"
    DECAYING = "decays"


@final
@dataclass(frozen=True)
class ModeDerivatives:
    """Design derivatives of modes.

    Attributes
    ----------
    names : tuple of str
        Names of the design variables.
    exponents_b : array, shape (count, n_b), complex
        Derivatives of `Modes.exponents`; zero for rigid modes. For coinciding modes: derivatives of
        each mode, in increasing order, along one variable alone; not linear in several variables
        together, and infinite where the shapes coincide too (critical damping).
    shapes_b : tuple of array, shape (n_q, n_b), or None
        Derivatives of the shapes; None for modes that coincide, and by adjoints.
    """

    names: tuple[str, ...]
    exponents_b: Array
    shapes_b: tuple[Array | None, ...]

    def __repr__(self) -> str:
        return f"ModeDerivatives of {len(self.exponents_b)} modes in {listed(self.names)}"


@final
@dataclass(frozen=True, repr=False)
class Modes(PrintedTable):
    """Small motions x e^{st} about a static configuration; returned by `modes`.

    Attributes
    ----------
    exponents : array, shape (count,), complex
        Exponents s with Im s >= 0, in 1/s: i omega for undamped vibrations, zero for rigid modes.
        Of s and -s of a growing motion without damping, the positive one.
    shapes : array, shape (n_q, count)
        Mode shapes x with x^H M x = 1; the largest entry (in the norm of the weights) is real and
        positive. Complex with damping.
    multipliers : array, shape (n_lam, count)
        Multipliers mu of the modes; columns as in `shapes`.
    kinds : tuple of ModeKind
    coincide : tuple of tuple of int
        Indices of modes that round-off does not separate, in groups of two or more.
    cut : tuple of int
        Indices of modes that coincide with modes beyond the requested ones, in a group that would
        add more than eight modes; else empty.
    configuration : LinearisationPoint
    unbalanced : float
        Unbalanced force relative to all forces; zero in an equilibrium.
    free : str
        Description of the rigid modes; empty if there are none.
    derivatives : ModeDerivatives or None
        None without design variables.
    """

    exponents: Array
    shapes: Array
    multipliers: Array
    kinds: tuple[ModeKind, ...]
    coincide: tuple[tuple[int, ...], ...]
    cut: tuple[int, ...]
    configuration: LinearisationPoint
    unbalanced: float
    free: str
    derivatives: ModeDerivatives | None = None

    @property
    def frequencies(self) -> Array:
        """Damped angular frequencies Im s of the modes, shape (count,); rad/s."""
        return self.exponents.imag

    @property
    def natural_frequencies(self) -> Array:
        """Natural angular frequencies |s|, shape (count,); rad/s. `frequencies` if undamped."""
        return np.abs(self.exponents)

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios -Re s / |s|, shape (count,); zero for rigid modes."""
        size = np.abs(self.exponents)
        return np.asarray(0.0 - self.exponents.real / np.where(size == 0, 1.0, size))

    @property
    def frequencies_b(self) -> Array:
        """Design derivatives of `frequencies`, shape (count, n_b).

        Raises
        ------
        InvalidInputError
            If there are no design variables.
        """
        return self._known().exponents_b.imag

    @property
    def natural_frequencies_b(self) -> Array:
        """Design derivatives of `natural_frequencies`, shape (count, n_b).

        In rad/s per unit of the variable. Raises InvalidInputError if there are no design
        variables.
        """
        s, size = self.exponents[:, None], np.abs(self.exponents)[:, None]
        change = np.real(np.conj(s) * self._known().exponents_b)
        return np.asarray(change / np.where(size == 0, 1.0, size))

    @property
    def damping_ratios_b(self) -> Array:
        """Design derivatives of `damping_ratios`, shape (count, n_b).

        Raises InvalidInputError if there are no design variables.
        """
        size = np.abs(self.exponents)[:, None]
        change = self._known().exponents_b.real
        change = change + self.damping_ratios[:, None] * self.natural_frequencies_b
        return np.asarray(-change / np.where(size == 0, 1.0, size))

    def shape_b(self, mode: int) -> Array:
        """Return the design derivative of a mode's shape, shape (n_q, n_b).

        Raises
        ------
        InvalidInputError
            If there are no design variables, the mode coincides with others, or the derivatives
            are adjoint.
        """
        shapes_b = self._known().shapes_b
        require_index("shape_b, mode", mode, len(shapes_b), "They are counted from 0.")
        shape_b = shapes_b[mode]
        if shape_b is not None:
            return shape_b
        where = f"derivative of the shape of mode {mode}"
        others = next((group for group in self.coincide if mode in group), None)
        if others is None and mode not in self.cut:
            raise InvalidInputError(
                where,
                "needs modes that were differentiated directly",
                "modes differentiated by adjoints",
                "Call modes(..., method=DirectDifferentiation()).",
            )
        more = " with others that were not asked for" if mode in self.cut else ""
        raise InvalidInputError(
            where,
            "needs a mode that is alone at its frequency",
            f"modes {', '.join(map(str, others or self.cut))} that coincide{more}",
            "Move the design apart from it, or use the derivatives of their frequencies.",
        )

    def _known(self) -> ModeDerivatives:
        if self.derivatives is None:
            raise InvalidInputError(
                "derivatives of modes",
                "need design variables",
                "none",
                'For a scene call modes(scene, design=["rod.height"]).',
            )
        return self.derivatives

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each mode.

        Columns are ``natural frequency`` (rad/s), ``damping ratio`` and ``kind``; with design
        variables also the derivatives of the natural frequency, ``d/d rod.height``.
        """
        table: dict[str, object] = {
            "natural frequency": self.natural_frequencies,
            "damping ratio": self.damping_ratios,
            "kind": [kind.value for kind in self.kinds],
        }
        if self.derivatives is not None:
            slopes = zip(self.derivatives.names, self.natural_frequencies_b.T, strict=True)
            table |= {f"d/d {name}": slope for name, slope in slopes}
        index = pandas().RangeIndex(len(self.kinds), name="mode")
        return pandas().DataFrame(table, index=index)

    def _printed(self) -> TableText:
        rows = [["mode", "rad/s", "damping ratio", ""]]
        ratios = self.damping_ratios
        for j, kind in enumerate(self.kinds):
            value = self.exponents[j]
            size = abs(value.real) if kind is ModeKind.GROWING and not value.imag else abs(value)
            rows.append([str(j), f"{size:.6g}", f"{ratios[j]:.3g}", kind.value])
        where = "an equilibrium"
        if self.unbalanced > _BALANCED:
            where = (
                "a configuration that is not in balance, and is held there (unbalanced force "
                f"{self.unbalanced:.2g} of all forces; pass at=equilibrium(...) for vibrations "
                "under load)"
            )
        lines = [f"free to move: {self.free}"] if self.free else []
        if self.cut:
            first, last = self.cut[0], self.cut[-1]
            which = (
                f"mode {first} coincides" if first == last else f"modes {first} to {last} coincide"
            )
            lines += [f"{which} to round-off with others, which were not asked for"]
        return f"Modes about {where}", rows, "\n".join(lines)


# Largest relative unbalanced force of a configuration called an equilibrium in messages.
_BALANCED = 1e-6
