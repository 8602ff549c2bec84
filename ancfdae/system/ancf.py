"""The ANCF assembler: the only place where a scene becomes M, Q, Phi and their partials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from scipy import sparse

from ancfdae.design import DesignVariable, as_design
from ancfdae.elements import ElementParameter, elastic
from ancfdae.errors import InvalidInput
from ancfdae.layout import Layout, Naming
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern
from ancfdae.scene import Scene
from ancfdae.system.block import element_block
from ancfdae.system.constraints import linear_constraints
from ancfdae.system.contract import MechanicalSystem
from ancfdae.system.numbering import number
from ancfdae.system.parameters import parameter_map
from ancfdae.system.reference import length_partials, start_state


def assemble(scene: Scene, design: Sequence[str | DesignVariable] = ()) -> AncfSystem:
    """Turn a scene into a mechanical system with the given design variables.

    Parameters
    ----------
    scene : Scene
    design : sequence of str or DesignVariable
        Design variables, in the order of the last axis of every sensitivity.

    Raises
    ------
    InvalidInput, UnknownName
        If a design variable does not fit the scene.
    """
    variables = as_design(design)
    mapping = parameter_map(scene, variables)  # refuses unknown targets before values are read
    del mapping
    values = np.array([scene.value(variable) for variable in variables], dtype=float)
    return AncfSystem(scene, variables, values)


@final
class AncfSystem(MechanicalSystem):
    """A scene at given values of its design variables.

    Parameters
    ----------
    scene : Scene
    design : tuple of DesignVariable
    b : array, shape (n_b,)
        Values of the design variables, real or complex. Everything that depends on them is
        computed in their dtype.

    Attributes
    ----------
    lengths : array, shape (n,)
        Element lengths; `lengths_b`, shape (n, n_b), their design partials.
    """

    linear_constraints = True
    velocity_forces = False

    def __init__(self, scene: Scene, design: tuple[DesignVariable, ...], b: Array) -> None:
        self._scene, self._design, self.b = scene, design, np.asarray(b)
        self.n_b = len(design)
        self.design_names = tuple(variable.name for variable in design)
        self.project_start = scene.project_start
        mapping = parameter_map(scene, design)
        parameters = mapping.values(self.b)
        self._numbering = number(scene)
        self.element = self._numbering.element
        self.n_q = self._numbering.n_q
        self.lengths = parameters[:, ElementParameter.LENGTH]
        self.lengths_b = length_partials(mapping, self.n_b)
        self._start = start_state(scene, self.lengths, self.lengths_b)
        self._block = element_block(scene, mapping, parameters)
        self._pair_element = mapping.elements[self._block.stiffness_pairs]
        pair_variable = mapping.variables[self._block.stiffness_pairs]
        self._place_elements(pair_variable)
        self._place_mass(
            mapping.elements[self._block.mass_pairs], mapping.variables[self._block.mass_pairs]
        )
        self._place_constraints()
        self._place_gravity()

    # -- preparation ---------------------------------------------------------------------------

    def _place_elements(self, pair_variable: Array) -> None:
        """Constant maps between q, the relative node vectors and the assembled tangent."""
        numbering, (n_y, d) = self._numbering, (self.element.n_y, self.element.d)
        R = numbering.relative()
        self._R = LinearMap(R)
        absolute = numbering.coordinates(numbering.vectors).reshape(len(numbering.vectors), -1)
        rows, columns = np.broadcast_arrays(absolute[:, :, None], absolute[:, None, :])
        self.pattern = Pattern((self.n_q, self.n_q), rows.ravel(), columns.ravel())
        self._tangent_map = self._tangent_gather()
        # Q_b[:, i] = -sum over pairs of variable i of R^T F_pair.
        size = n_y * d
        pair_rows = (self._pair_element[:, None] * size + np.arange(size)).ravel()
        picked = R[pair_rows].tocoo() if len(pair_rows) else sparse.coo_array((0, self.n_q))
        variable = np.repeat(pair_variable, size)[picked.row]
        shape = (self.n_q * self.n_b, len(pair_rows))
        self._pair_map = LinearMap.of(
            picked.col * self.n_b + variable, picked.row, -picked.data, shape
        )
        self._pair_g_o = self._block.g_o
        if len(self._block.g_o) > 1:
            self._pair_g_o = self._block.g_o[self._pair_element]

    def _tangent_gather(self) -> LinearMap:
        """Constant matrix from the element tangents in Y to -Q_q on the pattern."""
        numbering = self._numbering
        n, size = len(numbering.vectors), self.element.n_y * self.element.d
        rows, columns, signs = numbering.relative_entries()
        by_row = np.argsort(rows, kind="stable")
        rows, columns, signs = rows[by_row], columns[by_row], signs[by_row]
        element, local = rows // size, rows % size
        per_element = len(rows) // n
        i, j = (x.ravel() for x in np.indices((per_element, per_element)))
        offset = np.arange(n)[:, None] * per_element
        I, J = (offset + i).ravel(), (offset + j).ravel()
        raw = element[I] * size * size + local[I] * size + local[J]
        at_i, at_j, sign = columns[I], columns[J], signs[I] * signs[J]
        index = self.pattern.index(at_i, at_j)
        return LinearMap.of(index, raw, sign, (self.pattern.size, n * size * size))

    def _place_mass(self, pair_element: Array, pair_variable: Array) -> None:
        """Assemble M and the stacked M_b."""
        d, n_q, n_b = self.element.d, self.n_q, self.n_b
        rows, columns, values = self._mass_entries(self._block.m, self._numbering.vectors)
        self._mass = np.asarray(self.pattern.gather(rows, columns) @ values)
        self._mass_matrix = LinearMap(self.pattern.csr(self._mass))
        diagonal = self.pattern.index(np.arange(n_q), np.arange(n_q))
        self.weights = self._mass[diagonal].real
        vectors = self._numbering.vectors[pair_element]
        rows, columns, values = self._mass_entries(self._block.m_b, vectors)
        per_pair = d * self.element.n_a**2
        variable = np.repeat(pair_variable, per_pair)
        self._mass_b = LinearMap.of(rows * n_b + variable, columns, values, (n_q * n_b, n_q))

    def _mass_entries(self, m: Array, vectors: Array) -> tuple[Array, Array, Array]:
        """Rows, columns and values of m (x) I_d for every element."""
        coordinates = self._numbering.coordinates(vectors)
        rows, columns, values = np.broadcast_arrays(
            coordinates[:, :, None, :], coordinates[:, None, :, :], m[..., None]
        )
        return rows.ravel(), columns.ravel(), values.ravel()

    def _place_constraints(self) -> None:
        rows = linear_constraints(
            self._scene, self._numbering, self._start, self.lengths, self.lengths_b
        )
        self.n_lam = len(rows.c)
        self.constraint_pattern = Pattern((self.n_lam, self.n_q), rows.rows, rows.columns)
        gather = self.constraint_pattern.gather(rows.rows, rows.columns)
        self._B_values = np.asarray(gather @ rows.values)
        self._B = LinearMap(self.constraint_pattern.csr(self._B_values))
        self._B_b, self._B_bT = LinearMap(rows.B_b), LinearMap(rows.B_bT)
        self._c, self._c_b = rows.c, rows.c_b
        layout = Layout(self.element.d, self._numbering.beams, rows.joints)
        self.naming = Naming(layout, self.lengths, self.lengths_b)
        self.constraint_names = tuple(
            joint.name for joint in rows.joints for _ in range(joint.rows)
        )

    def _place_gravity(self) -> None:
        """Q_e = M (field of unit translations times g): eq. (12) without its own integral."""
        self._gravity = np.zeros(self.n_q, dtype=self._mass.dtype)
        self._gravity_b = np.zeros((self.n_q, self.n_b), dtype=self._mass.dtype)
        if self._scene.gravity is None:
            return
        field = np.zeros((self.n_q // self.element.d, self.element.d))
        field[:: self.element.n_s] = self._scene.gravity
        self._gravity = self.mass_times(field.ravel())
        self._gravity_b = self.mass_b_times(field.ravel())

    # -- the protocol --------------------------------------------------------------------------

    def with_values(self, b: Array) -> AncfSystem:
        """Return the same scene at other design values, real or complex.

        Raises
        ------
        InvalidInput
            If there are not n_b values.
        """
        b = np.asarray(b)
        if b.shape != (self.n_b,):
            raise InvalidInput(
                "design values", f"must have shape ({self.n_b},)", b.shape, "One per variable."
            )
        return AncfSystem(self._scene, self._design, b)

    def start(self) -> tuple[Array, Array]:
        """Return the declared start."""
        return self._start.q, self._start.v

    def start_b(self) -> tuple[Array, Array]:
        """Return the partials of the declared start."""
        return self._start.q_b, self._start.v_b

    def mass(self) -> Array:
        """M (eq. 10)."""
        return self._mass

    def mass_times(self, x: Array) -> Array:
        """M x."""
        return self._mass_matrix(x)

    def mass_b_times(self, a: Array) -> Array:
        """(M a)_b."""
        return self._mass_b(a).reshape(self.n_q, self.n_b)

    def force(self, q: Array, v: Array, t: float) -> Array:
        """Q = gravity - elastic force (eqs. 12, 13)."""
        F = elastic.force(self._block.A, self._block.g_o, self._relative(q))
        return self._gravity - self._R.transposed(F.ravel())

    def force_q(self, q: Array, v: Array, t: float) -> Array:
        """Q_q (eq. 19)."""
        K = elastic.tangent(self._block.A, self._block.g_o, self._relative(q))
        return -self._tangent_map(K.ravel())

    def force_v(self, q: Array, v: Array, t: float) -> Array:
        """No force of an ANCF scene depends on v yet."""
        return np.zeros(self.pattern.size)

    def force_b(self, q: Array, v: Array, t: float) -> Array:
        """Q_b (eqs. 24, 25)."""
        Y = self._relative(q)[self._pair_element]
        F = elastic.force_partial(self._block.A_b, self._block.c_b, self._pair_g_o, Y)
        return self._gravity_b + self._scatter_pairs(F)

    def force_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Q_q v."""
        block, Y, U = self._block, self._relative(q), self._relative(v)
        return -self._R.transposed(elastic.force_direction(block.A, block.g_o, Y, U).ravel())

    def force_rate_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Q_qq[v, q_b] + Q_q v_b + Q_qb v."""
        block, Y, U = self._block, self._relative(q), self._relative(v)
        pairs = self._pair_element
        F = elastic.force_partial_direction(
            block.A_b, block.c_b, self._pair_g_o, Y[pairs], U[pairs]
        )
        total = self._scatter_pairs(F)
        for i in range(self.n_b):
            Y_i, U_i = self._relative(q_b[:, i]), self._relative(v_b[:, i])
            F = elastic.force_second_direction(block.A, Y, U, Y_i)
            F = F + elastic.force_direction(block.A, block.g_o, Y, U_i)
            total[:, i] -= self._R.transposed(F.ravel())
        return total

    def constraint(self, q: Array, t: float) -> Array:
        """Phi = B q - c."""
        return self._B(q) - self._c

    def constraint_q(self, q: Array, t: float) -> Array:
        """Phi_q = B."""
        return self._B_values

    def constraint_b(self, q: Array, t: float) -> Array:
        """Phi_b = B_b q - c_b."""
        return self._B_b(q).reshape(self.n_lam, self.n_b) - self._c_b

    def constraint_force(self, q: Array, lam: Array, t: float) -> Array:
        """B^T lam."""
        return self._B.transposed(lam)

    def constraint_force_q(self, q: Array, lam: Array, t: float) -> Array:
        """Zero: the constraints are linear."""
        return np.zeros(self.pattern.size)

    def constraint_force_b(self, q: Array, lam: Array, t: float) -> Array:
        """(B^T lam)_b."""
        return self._B_bT(lam).reshape(self.n_q, self.n_b)

    def constraint_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """B_b x."""
        return self._B_b(x).reshape(self.n_lam, self.n_b)

    def velocity_side(self, q: Array, t: float) -> Array:
        """Zero: no joint is driven."""
        return np.zeros(self.n_lam)

    def velocity_side_total(self, q: Array, t: float, q_b: Array) -> Array:
        """Zero."""
        return np.zeros((self.n_lam, self.n_b))

    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """Zero."""
        return np.zeros(self.n_lam)

    def acceleration_side_total(
        self, q: Array, v: Array, t: float, q_b: Array, v_b: Array
    ) -> Array:
        """Zero."""
        return np.zeros((self.n_lam, self.n_b))

    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Zero."""
        return np.zeros(self.n_lam)

    def jerk_side_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Zero."""
        return np.zeros((self.n_lam, self.n_b))

    def constraint_force_rate(self, q: Array, v: Array, lam: Array, t: float) -> Array:
        """Zero: B is constant."""
        return np.zeros(self.n_q)

    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Zero."""
        return np.zeros((self.n_q, self.n_b))

    # -- energies ------------------------------------------------------------------------------

    def strain_energy(self, q: Array) -> Array:
        """Return the strain energy of every element, shape (n,)."""
        return elastic.energy(self._block.A, self._block.g_o, self._relative(q))

    def kinetic_energy(self, v: Array) -> Array:
        """Return 1/2 v^T M v (eq. 9)."""
        return 0.5 * np.asarray(v @ self.mass_times(v))

    def gravity_potential(self, q: Array) -> Array:
        """Return the potential of gravity, zero at q = 0."""
        return -np.asarray(self._gravity @ q)

    def _relative(self, q: Array) -> Array:
        """Relative node vectors Y of all elements, shape (n, n_y, d)."""
        return self._R(q).reshape(-1, self.element.n_y, self.element.d)

    def _scatter_pairs(self, F: Array) -> Array:
        """Sum -F of all pairs into an array (n_q, n_b)."""
        return self._pair_map(F.ravel()).reshape(self.n_q, self.n_b)
