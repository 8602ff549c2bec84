"""Functions that a user brings: of observables, or of the bare states."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_function, require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.complex_step import require_derivative
from ancfdae.sensitivity.observables.functions import Function, require_vectorised
from ancfdae.sensitivity.observables.observable import Columns, Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import Named, States, known_system


def apply(function: Callable[..., Array], *observables: Observable) -> Observable:
    """Return a function of your own of observables.

    Parameters
    ----------
    function : callable
        Takes one array (k,) per observable and returns an array (k,), element by element and
        with operations that accept complex numbers: its derivative is taken by a complex step.
    *observables : Observable
        At least one.

    Raises
    ------
    InvalidInputError
        If the function mixes instants, fails on complex numbers, or its complex step disagrees
        with finite differences. It is tried on a few numbers now and on a few instants of every
        run that is differentiated.
    """
    require_function("apply, function", function)
    name = getattr(function, "__name__", repr(function))
    if not observables or not all(isinstance(x, Observable) for x in observables):
        raise InvalidInputError(
            f"apply({name})", "needs observables", observables, "Pass one or more, and no numbers."
        )
    checked = Function(name, function, edged=True, by_user=True)
    base = np.array([-1.7, -0.6, 0.3, 0.9, 2.3])
    tried = [np.roll(base, j) * (1 + 0.1 * j) for j in range(len(observables))]
    with np.errstate(all="ignore"):
        require_vectorised(name, lambda rows: function(*(x[rows] for x in tried)), len(base))
        require_derivative(name, function, tried, [np.ones_like(x) for x in tried])
    return observables[0].combined(checked, observables)


def custom(function: Callable[..., Array], name: str = "custom") -> Observable:
    """Return a function H(t, q, v, lam, b) of your own, for any mechanical system.

    It takes t (k,), q (k, n_q), v (k, n_q), lam (k, n_lam) and b (n_b,) and returns an array (k,),
    instant by instant and with operations that accept complex numbers. Its partials take one
    evaluation per coordinate, velocity, multiplier and design variable. Messages use the name.
    """
    require_function("custom, function", function)
    require_kind("custom, name", name, (str,), "Messages name the function by it.")
    return Custom(function, name)


@final
@dataclass(frozen=True)
class Custom(Leaf):
    """A user's function of time, states and design variables."""

    names_time: ClassVar[bool] = True

    function: Callable[..., Array]
    name: str

    def check_leaf(self, system: Named) -> None:
        """Try the function around the start, and refuse it as `apply` does."""
        system = known_system(self.name, system)
        q, v = system.start()
        # Near the start, but not at it, where velocities and multipliers may be zero.
        spread = 1e-3 * np.arange(1.0, 4.0)[:, None]
        states = States(
            t=np.array([0.0, 0.1, 0.2]),
            q=q.real + spread * np.cos(np.arange(system.n_q)),
            v=v.real + spread * np.sin(1.0 + np.arange(system.n_q)),
            lam=1.0 + spread * np.cos(2.0 + np.arange(system.n_lam)),
        )
        with np.errstate(all="ignore"):
            require_vectorised(self.name, lambda rows: self._call(states.rows(rows), system.b), 3)
        self._require_derivative(states, system.b.real)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the values H of the function, shape (n_t,)."""
        return np.asarray(self._call(states, known_system(self.name, system).b))

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Differentiate H by a complex step in one column after the other."""
        self._require_derivative(states.rows([0, len(states.t) // 2, -1]), system.b)
        q, v, lam = (x.astype(complex) for x in (states.q, states.v, states.lam))
        complex_states = States(states.t, q, v, lam, states.degree)
        b = system.b.astype(complex)
        parts = []
        for moved in (complex_states.q, complex_states.v, complex_states.lam, b):
            partial = np.zeros((len(states.t), moved.shape[-1]))
            for i in range(moved.shape[-1]):
                moved[..., i] += 1j * STEP
                partial[:, i] = np.imag(self._call(complex_states, b)) / STEP
                moved[..., i] = moved[..., i].real
            parts.append(partial)
        on_q, on_v, on_lam = (Columns(slice(None), partial) for partial in parts[:3])
        return LeafGradient(on_q, on_v, on_lam, parts[3])

    def _call(self, states: States, b: Array) -> Array:
        return self.function(states.t, states.q, states.v, states.lam, b)

    def _require_derivative(self, states: States, b: Array) -> None:
        x = (states.q, states.v, states.lam, b)
        # A direction without symmetry, of the size of the arguments.
        dx = [
            np.where(a == 0, 1.0, a) * np.cos(0.7 * j + 1.3 * np.arange(a.shape[-1]))
            for j, a in enumerate(x)
        ]
        require_derivative(self.name, lambda *moved: self.function(states.t, *moved), x, dx)
