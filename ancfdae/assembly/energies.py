"""Energies, momenta and powers of a scene and of its parts; rows are time points.

A joint exerts -Phi_q^T lam, and Phi_q v = -Phi_t: its power is lam . Phi_t. A law x(t) enters by
its rate, Phi_t = Phi_x x', so that lam . Phi_x, the power at x' = 1, is the force or torque on x.
The power of a load is F . V, the forces on its vectors times their rates. Evaluators are prepared
on first use.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, final

import numpy as np

from ancfdae.assembly.constraints import JointConstraints
from ancfdae.assembly.elastic_forces import ElasticForces
from ancfdae.assembly.geometry import PartInputs
from ancfdae.assembly.inertia import Inertia
from ancfdae.assembly.joint_input import JointInput
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.load_forces import LoadInput
from ancfdae.assembly.naming import Vectors
from ancfdae.assembly.numbering import Numbering
from ancfdae.errors.checks import named, require_index
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.joints.joint import FormulaJoint, Joint
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern


@final
class JointWork:
    """Evaluator of the power of one driven joint, for its own law or `at_unit_rate`."""

    def __init__(self, item: JointInput, vectors: Vectors, first_row: int) -> None:
        # The last equations keep right angles of sections and do not depend on time.
        c = item.joint.coefficients(item.p, item.reference)
        moving = len(c.offset) - len(c.shapes)
        alone = replace(item, dropped=tuple(range(moving, len(c.offset))))
        structure = JointStructure.of([alone], vectors)
        pattern = SparsityPattern((vectors.n_q, vectors.n_q), *structure.couplings)
        curved = pattern.index(*structure.couplings)
        self._constraints = JointConstraints(structure, curved, pattern.size, vectors.n_b)
        self.rows = slice(first_row, first_row + moving)

    def value(self, t: Array, q: Array, lam: Array) -> Array:
        """Return the power lam . Phi_t, W, or lam . Phi_x, shape (k,); lam of all joints."""
        return self._constraints.works(q, lam[:, self.rows], t)

    def partials(self, t: Array, q: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Return the power's partials in q, in multipliers of `rows`, and in b; (k, n) each."""
        return self._constraints.works_partials(q, lam[:, self.rows], t)


@final
@dataclass(frozen=True)
class _UnitRate(Law):
    """A law with the values of another law and a rate of one at all times."""

    law: Law

    design_fields = (("law", require_law),)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the value of the law, or 1, 0, 0 for its time derivatives of order 1, 2, 3."""
        x = self.law.derivative(p, t, 0)
        return x if order == 0 else np.full_like(x, float(order == 1))


def at_unit_rate(joint: Joint) -> Joint:
    """Return the joint with all its laws at a rate of one."""
    values = {each.name: getattr(joint, each.name) for each in fields(joint)}
    laws = {name: _UnitRate(law) for name, law in values.items() if isinstance(law, Law)}
    return replace(joint, **laws)  # type: ignore[arg-type]


@final
@dataclass(frozen=True, eq=False)
class LoadFunction:
    """A function of the state of one load, such as its power, with partials by complex steps.

    `of` takes the load, its vectors U and V, and its law and signals at k times, (k, 1 + n).
    """

    item: LoadInput
    n_b: int
    of: Callable[[LoadInput, Array, Array, Array], Array]

    def value(self, t: Array, q: Array, v: Array) -> Array:
        """Return the load's power or energy in k states, shape (k,)."""
        return self._value(self.item, t, q, v)

    def partials(self, t: Array, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return partials of the load's power or energy in q, v and b; shape (k, n) each."""
        item, b = self.item, np.zeros((len(t), self.n_b))
        U, V, factors = item.vectors.of(q), item.vectors.of(v), item.factors(t, 0)
        shape = U.shape[1:]
        # All directions at once, in a leading axis.
        step = 1j * STEP * np.eye(U[0].size).reshape(-1, 1, *shape)
        on_U, on_V = (
            np.moveaxis(self.of(item, *moved, factors).imag / STEP, 0, -1).reshape(len(t), *shape)
            for moved in ((U + step, V + 0 * step), (U + 0 * step, V + step))
        )
        for i in item.active:
            b[:, i] = self._value(item.moved(i), t, q, v).imag / STEP
        return item.vectors.lift(on_U), item.vectors.lift(on_V), b

    def _value(self, item: LoadInput, t: Array, q: Array, v: Array) -> Array:
        return self.of(item, item.vectors.of(q), item.vectors.of(v), item.factors(t, 0))


def power(item: LoadInput, U: Array, V: Array, factors: Array) -> Array:
    """Return the power F . V of a load, shape of the leading axes, without its states; W."""
    n = U.shape[-2] - len(item.masses)
    factor = np.broadcast_to(factors[:, 0], U.shape[:-2])
    F = item.forces(U, V, factors[:, 1:])
    return np.asarray(factor * np.sum((F * V)[..., :n, :], axis=(-2, -1)))


def stored(item: LoadInput, U: Array, V: Array, factors: Array) -> Array:
    """Return the elastic energy of a load, shape of the leading axes of U; J."""
    energy = item.load.energy(U, item.p, item.reference)
    return np.asarray(np.broadcast_to(factors[:, 0], U.shape[:-2]) * energy)


@final
class Works:
    """Evaluators of the power of driven joints and loads and the energy of springs, by name."""

    def __init__(self, scene: Scene, inputs: PartInputs, layout: Layout, n_b: int) -> None:
        self._scene, self._inputs, self._layout, self._n_b = scene, inputs, layout, n_b
        self._joints: dict[tuple[str, bool], JointWork] = {}
        self._loads: dict[tuple[str, int | None], LoadFunction] = {}
        self._springs: dict[str, LoadFunction] = {}

    def of_joint(self, name: str, unit_rate: bool) -> JointWork:
        """Return the evaluator of the power of a driven joint, or, at unit rate, of its force.

        Raises InvalidInputError for a joint without a driver.
        """
        key = name, unit_rate
        if key not in self._joints:
            place = self._layout.joint(name)
            joints = [joint for joint in self._scene.joints if joint.name == name]
            if not joints or not joints[0].driven:
                rule, repair = (
                    "must be driven: others do no work",
                    "Name a RotationDriver, a TranslationDriver or a FormulaJoint with a law.",
                )
                raise InvalidInputError(f"work of joint {name!r}", rule, "one that is not", repair)
            joint = at_unit_rate(joints[0]) if unit_rate else joints[0]
            if unit_rate and isinstance(joint, FormulaJoint) and len(joint.laws) > 1:
                rule, repair = (
                    "must have one law, on which it works",
                    "Use joint_power, which is the power of all laws.",
                )
                raise InvalidInputError(f"force of joint {name!r}", rule, len(joint.laws), repair)
            item = self._inputs.joint(joint)
            self._joints[key] = JointWork(*item, place.first_row)
        return self._joints[key]

    def of_load(self, name: str) -> LoadFunction:
        """Return the evaluator of the power of a load; UnknownNameError if it is missing."""
        if (name, None) not in self._loads:
            load = named("load", name, self._scene.loads)
            self._loads[name, None] = LoadFunction(
                self._inputs.in_all_states(load), self._n_b, power
            )
        return self._loads[name, None]

    def of_springs(self, name: str | None) -> list[LoadFunction]:
        """Return the evaluators of the energy of one load, or of all loads that store energy.

        Raises UnknownNameError, and InvalidInputError for a load that stores no energy.
        """
        its = [named("load", name, self._scene.loads)] if name is not None else self._scene.loads
        for load in its:
            if load.name not in self._springs and (load.stores or name is not None):
                item = self._inputs.load(load)
                load.energy(item.reference, item.p, item.reference)  # raises if it stores none
                self._springs[load.name] = LoadFunction(item, self._n_b, stored)
        return [self._springs[x.name] for x in its if x.name in self._springs]

    def of_effort(self, name: str, axis: int) -> LoadFunction:
        """Return the evaluator of an effort of a controller, or of a tension of a rope.

        Raises UnknownNameError, and InvalidInputError for an axis or span that does not exist.
        """
        if (name, axis) not in self._loads:
            able = [load for load in self._scene.loads if load.has_efforts]
            item = self._inputs.load(named("controller or rope", name, able))
            load, rule = item.load, "Axes and spans are counted from 0 on."
            require_index(f"effort of {name!r}", axis, load.effort_count(item.p), rule)

            def effort(item: LoadInput, U: Array, V: Array, factors: Array) -> Array:
                at = U, V, factors[:, 1:], item.p, item.reference
                shape, its = U.shape[:-2], load.efforts_at(*at)[axis]
                return np.broadcast_to(np.reshape(its, np.shape(its)[:-2]), shape)

            self._loads[name, axis] = LoadFunction(item, self._n_b, effort)
        return self._loads[name, axis]


@final
class Energies:
    """Strain, kinetic and potential energies of a scene, or of one beam, body or point mass.

    `places`, shape (n_q / d,), is one for vectors that are positions, zero for slopes.
    `centrifugal` is the potential of a rotating frame.
    """

    def __init__(
        self,
        elastic: ElasticForces,
        inertia: Inertia,
        numbering: Numbering,
        layout: Layout,
        centrifugal: Callable[[Array], Array] | None = None,
    ) -> None:
        self._centrifugal, self._of_states = centrifugal, numbering.d * numbering.controlled
        self._elastic, self._inertia = elastic, inertia
        self._owners, self._layout, self.places = numbering.owners, layout, inertia.positions

    def strain(self, q: Array, owner: str | None = None) -> Array:
        """Return the strain energy of the scene or of an owner, shape (k,); J."""
        return self._elastic.energies(q) @ self._chosen(owner)

    def strain_q(self, q: Array, owner: str | None = None) -> Array:
        """Return the gradient of the strain energy in q, shape (k, n_q)."""
        return self._elastic.energy_q(q, self._chosen(owner))

    def strain_b(self, q: Array, owner: str | None = None) -> Array:
        """Return the design partial of the strain energy, shape (k, n_b)."""
        return self._elastic.energy_b(q, self._chosen(owner))

    def kinetic(self, v: Array, owner: str | None = None) -> Array:
        """Return the kinetic energy (eq. 9) of the scene or of an owner, shape (k,); J."""
        return 0.5 * np.sum(v * self.momenta(v, owner), axis=1)

    def momenta(self, v: Array, owner: str | None = None) -> Array:
        """Return M v of the scene or of an owner, the gradient of `kinetic`, shape (k, n_q)."""
        if owner is None:
            p = self._inertia.times(v.T).T
            p[:, len(p.T) - self._of_states :] = 0.0  # Masses of states are no masses of bodies.
            return p
        return self._inertia.owner_times(v, self._layout.owner(owner))

    def kinetic_b(self, v: Array, owner: str | None = None) -> Array:
        """Return the design partial of the kinetic energy, shape (k, n_b)."""
        number = None if owner is None else self._layout.owner(owner)
        return 0.5 * self._inertia.quadratic_b(v, number)

    def gravity(self, q: Array) -> Array:
        """Return the potential energy of gravity, zero at q = 0, shape (k,); J."""
        return -np.asarray(q @ self._inertia.gravity)

    def gravity_b(self, q: Array) -> Array:
        """Return the design derivatives of the potential energy of gravity, shape (k, n_b)."""
        return -np.asarray(q @ self._inertia.gravity_b)

    def total(self, q: Array, v: Array) -> Array:
        """Return the sum of kinetic, strain and potential energies, shape (k,); J."""
        total = self.kinetic(v) + self.strain(q) + self.gravity(q)
        return total if self._centrifugal is None else total + self._centrifugal(q)

    def _chosen(self, owner: str | None) -> Array:
        """Return one for the flexible elements of an owner, or of the scene, else 0, shape (n,)."""
        if owner is None:
            return np.ones(len(self._owners))
        return np.asarray(self._owners == self._layout.owner(owner), dtype=float)
