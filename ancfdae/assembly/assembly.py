"""The start of a scene: rigid motions of bodies close the joints; with design derivatives.

If design variables move joints, lengths or angles, the bodies as declared no longer meet the
joints. Each body then moves rigidly, x = (u, g), so that

    Phi(q(x)) = 0, the rotations sum |g|^2 are smallest, then the displacements sum |u|^2.

With J = Phi_q q_x, its parts J_u and J_g, and multipliers sigma and rho, that is F = 0 with

    F_1 = (0, g) + J^T sigma,   F_2 = J^T Phi,   F_3 = u + J_u^T rho.

If no rigid motion closes the joints, and the consistent start may strain the bodies, they come as
near to the joints as they can: |Phi|^2 + delta |x|^2 is minimal with a small delta, F = J^T Phi +
delta x. Either F is smooth, so that the design derivatives of the start follow from one more step
of Newton's method along each variable (docs/theory/04-start.md).

Velocities likewise: a rigid motion of every body is added to the declared velocities, with the
smallest angular velocities, so that Phi_q v = nu.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.closing import SOFT, Closing, Declared, LeastNorm, Matrix, Unknowns
from ancfdae.assembly.constraints import JointConstraints
from ancfdae.assembly.geometry import Reference
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.errors.kinds import InconsistentStartError
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern

_ITERATIONS = 60
# Newton steps that rotate a body by more than this, in rad, are shortened, so that they converge to
# the assembly near the declared one and not to another branch.
_LONGEST_TURN = 0.3
# Number of random starts tried if the declared one does not close the joints, largest component of
# their Gibbs vectors (rotations up to 90 degrees about each axis), and number of damped steps
# before Newton's method.
_RESTARTS, _FARTHEST, _DAMPED_STEPS = 12, 2.0, 15
# Largest part of a motion in the null space, by round-off, with which the motion counts as
# determined.
_FREE = 1e-6
# Gap over the size of the mechanism up to which joints count as closed: far above the round-off of
# Newton's method, far below the gaps that a declared start may have.
_CLOSED = 1e-11
# Round-off of a derivative times the value of the variable, dimensionless.
_NOISE = 1e-12
# Limits beyond which rigid motions do not close the rates of joints: remaining rate over
# velocities, and rate of a motion over the rate it closes. Neighbouring designs lie on the same
# side of each.
_OPEN_RATE, _FAST = 1e-3, 10.0


@final
@dataclass(frozen=True, eq=False)
class Assembly:
    """The assembled start of a scene: positions and velocities that close the joints.

    If `moves`, bodies move rigidly to close them; otherwise the start is as declared, and open
    joints are found elsewhere. Joints may stay open if the consistent start `strains` the bodies.
    """

    closing: Closing
    moves: bool
    strains: bool

    @cached_property
    def _rates(self) -> Closing:
        """Equations of velocities, in which bodies that lead may also have angular velocities."""
        return replace(self.closing, free=np.ones(self.closing.motions.none.shape, dtype=bool))

    # -- the start -----------------------------------------------------------------------------

    @cached_property
    def q(self) -> Array:
        """Coordinates of the assembled start, shape (n_q,); m, slopes dimensionless."""
        if self._stands:
            return self.closing.declared.Z.ravel()
        return self.closing.placed(self.closing.declared, self._positions[0])

    @cached_property
    def v(self) -> Array:
        """Velocities of the assembled start, shape (n_q,); m/s, slopes 1/s."""
        if self._stands:
            return self.closing.declared.velocities(self.q, self.closing.motions.none)
        motion = self.closing.motion(self._positions[0])
        return self._moving(self.closing.declared, motion, self.q, self._velocities[0])

    def along(self, moved: Declared) -> tuple[Array, Array]:
        """Return design derivatives of q and v, (n_q,) each, from the imaginary step in `moved`."""
        inverses = self._position_inverse, self._velocity_inverse
        return self._followed(moved, self._positions, self._velocities, inverses)

    def strained_along(self, moved: Declared) -> tuple[Array, Array]:
        """Return the derivatives of q and v as `along` does, if no rigid motion follows `moved`.

        At neighbouring values bodies come as near to the joints as they can, and are strained.
        """
        none = np.zeros(0)
        y = self._positions[0].real, none, none
        x, sigma, rho = self._velocities
        inverses = LeastNorm(self.closing.matrix_at(y)), self._velocity_inverse
        return self._followed(moved, y, (x.real, sigma.real, rho.real), inverses)

    def _followed(
        self,
        moved: Declared,
        y: Unknowns,
        rates: Unknowns,
        inverses: tuple[LeastNorm, LeastNorm],
    ) -> tuple[Array, Array]:
        """Return the design derivatives of q and v by one more Newton step for each."""
        x = y[0] - 1j * inverses[0].solve(self.closing.at(moved, y).imag)[: len(y[0])]
        q, motion = self.closing.placed(moved, x), self.closing.motion(x)
        F = self._velocity_equations(moved, q, self._moving(moved, motion, q, rates[0]), rates)
        s = rates[0] - 1j * inverses[1].solve(F.imag)[: len(rates[0])]
        return q.imag / STEP, self._moving(moved, motion, q, s).imag / STEP

    # -- positions -----------------------------------------------------------------------------

    @cached_property
    def _positions(self) -> Unknowns:
        """Unknowns (x, sigma, rho) of the positions by Newton's method.

        A complex step of the declaration needs two more iterations.
        """
        y = self.closing.start(self._soft)
        if self._stands:
            return y
        if not self.moves:
            # The real part stays as declared; only the imaginary perturbation is solved for.
            F = self.closing.at(self.closing.declared, y)
            return _plus(y, -1j * LeastNorm(self.closing.matrix_at(y)).solve(F.imag))
        nearest = self._search(True) if self._soft else self._nearest
        if nearest is not None and (self._soft or self._fits(nearest)):
            return nearest
        closed = [] if self._soft else self._from_elsewhere()
        if closed:
            return min(closed, key=self._turned)
        if nearest is not None:
            return nearest
        joint, gap = self._widest(self.closing.start(False)[0])
        raise InconsistentStartError(
            "assembly",
            "rigid motions of the bodies must close all joints",
            f"no convergence in {_ITERATIONS} iterations, nor from {_RESTARTS} random starts; as "
            f"declared, joint {joint!r} is open by {gap:.3g} of the size of the mechanism",
            "The joints may not close at that position. Change the design less, or rotate a body "
            "with turn=..., so that joints nearly meet.",
        )

    def _from_elsewhere(self) -> list[Unknowns]:
        """Return the solutions from random rotations of the bodies that close all joints.

        The random numbers are the same each time.
        """
        generator, unknowns = np.random.default_rng(0), []
        turns = ~self.closing.shift
        for _ in range(_RESTARTS):
            x, sigma, rho = self.closing.start(False)
            x[turns] = generator.uniform(-_FARTHEST, _FARTHEST, np.sum(turns))
            unknowns.append(self._search(False, (self._nearer(x), sigma, rho)))
        return [y for y in unknowns if y is not None and self._fits(y)]

    def _nearer(self, x: Array) -> Array:
        """Return x after damped Gauss-Newton steps towards closed joints, far from a solution."""
        none, Z = np.zeros(0), self.closing.declared.Z.real
        for _ in range(_DAMPED_STEPS):
            motion = self.closing.motion(x)
            q, T = (
                self.closing.motions.place(Z, motion).ravel(),
                self.closing.motions.tangent(Z, motion),
            )
            matrix = self.closing.matrix(self.closing.jacobian(q, T), [self.closing.flat])
            F = self.closing.at(self.closing.declared, (x, none, none)).real
            dx = -LeastNorm(matrix).solve(F - SOFT * x)
            turn = np.max(np.abs(dx[~self.closing.shift]), initial=0.0)
            x = x + dx * min(1.0, _LONGEST_TURN / max(turn, _LONGEST_TURN))
        return x

    def _fits(self, y: Unknowns) -> bool:
        """Whether joints are closed, and no driven angle is off by half a turn."""
        q = self.closing.placed(self.closing.declared, y[0])
        return (
            self._open(y[0]) <= _CLOSED
            and self.closing.declared.constraints.opposite(q, 0.0) is None
        )

    def _turned(self, y: Unknowns) -> float:
        return float(np.sum(y[0].real[~self.closing.shift] ** 2))

    @property
    def _stands(self) -> bool:
        """Whether the start is exactly as declared."""
        declared = self.closing.declared
        moved = np.iscomplexobj(declared.Z) or declared.constraints.is_complex
        return not (moved or self.moves)

    @cached_property
    def _soft(self) -> bool:
        """Whether rigid motions cannot close the joints and only come as near as they can."""
        if not (self.moves and self.strains):
            return False
        return self._nearest is None or self._open(self._nearest[0]) > _CLOSED

    @cached_property
    def _nearest(self) -> Unknowns | None:
        """Unknowns that Newton's method converges to from the declared start; None if it fails."""
        return self._search(False)

    def _search(self, soft: bool, start: Unknowns | None = None) -> Unknowns | None:
        """Return the unknowns that Newton's method converges to; None if it does not converge."""
        y, settled = self.closing.start(soft) if start is None else start, 0
        for _ in range(_ITERATIONS):
            F = self.closing.at(self.closing.declared, y)
            dy = -LeastNorm(self.closing.matrix_at(y)).solve(F)
            dx = np.abs(dy[: len(y[0])].real)
            size, turn = np.max(dx, initial=0.0), np.max(dx[~self.closing.shift], initial=0.0)
            dy = dy * min(1.0, _LONGEST_TURN / max(turn, _LONGEST_TURN))
            y = _plus(y, dy)
            # The remaining error is the square of the last step.
            settled += size <= 1e-8
            if settled == 3 or (settled and F.dtype.kind != "c"):
                return y
        return None

    @cached_property
    def _position_inverse(self) -> LeastNorm:
        inverse = LeastNorm(self.closing.matrix_at(self._positions))
        if np.any(inverse.leaves_open(len(self._positions[0])) > _FREE):
            raise InconsistentStartError(
                "assembly",
                "must be the only one nearby",
                "a mechanism at a point where it branches",
                "Start from another position, or let a body lead: Scene(lead=...).",
            )
        return inverse

    # -- velocities ----------------------------------------------------------------------------

    @cached_property
    def _velocities(self) -> Unknowns:
        y = self._rates.start(self._soft_rates)
        declared, motion, q = self.closing.declared, self.closing.motion(self._positions[0]), self.q
        if self._stands:
            return y
        for _ in range(3 if q.dtype.kind == "c" else 1):
            F = self._velocity_equations(declared, q, self._moving(declared, motion, q, y[0]), y)
            y = _plus(y, -self._velocity_inverse.solve(F if self.moves else 1j * F.imag))
        return y

    def _velocity_equations(self, declared: Declared, q: Array, v: Array, y: Unknowns) -> Array:
        rate = self._rates.left(declared, q, v)
        return self._rates.equations(declared, q, self._rigid(q), y, rate)

    @cached_property
    def _soft_rates(self) -> bool:
        """Whether rigid motions cannot close the rates of joints and only come near to them.

        So it is if they leave rates open, and if bodies that are strained would have to move fast
        to close them, as at a dead centre.
        """
        if not (self.moves and self.strains):
            return False
        constraints, x = self.closing.declared.constraints, self._positions[0].real
        q, none = self.q.real, self._rates.start(False)
        v = self._moving(self.closing.declared, self.closing.motion(x), q, none[0]).real
        rate = self._rates.left(self.closing.declared, q, v).real
        F = self._rates.equations(self.closing.declared, q, self._rigid(q), none, rate).real
        s = -LeastNorm(self._velocity_matrix(3)).solve(F)[: len(none[0])]
        J = self._rates.jacobian(q, self._rigid(q))
        B = np.abs(constraints.constraint_q(0.0, q).real)
        terms = self._rates.weights * constraints.structure.pattern.dot(B, np.abs(v))
        terms = terms[: self._rates.rows]
        most = np.max(np.abs(rate), initial=0.0)
        left = np.max(np.abs(rate + J @ s), initial=0.0)
        is_open = left > _OPEN_RATE * (most + np.max(terms, initial=0.0))
        return bool(is_open or (self._soft and np.max(np.abs(s), initial=0.0) > _FAST * most))

    @cached_property
    def _velocity_inverse(self) -> LeastNorm:
        return LeastNorm(self._velocity_matrix(1 if self._soft_rates else 3))

    def _velocity_matrix(self, count: int) -> Matrix:
        """Return the matrix of all three velocity equations, or of one if joint rates stay open."""
        q = self.q.real
        J = self._rates.jacobian(q, self._rigid(q))
        return self._rates.matrix(J, [self._rates.flat] * count)

    def _moving(self, declared: Declared, motion: Array, q: Array, s: Array) -> Array:
        """Return the declared velocities plus rigid motions of the bodies at rates s, (n_q,)."""
        v = declared.velocities(q, motion)
        return v + self.closing.motions.velocities(self._rigid(q), self._rates.motion(s))

    def _rigid(self, q: Array) -> Array:
        """Return the velocities of unit rigid motions of all bodies at q."""
        return self.closing.motions.tangent(
            q.reshape(self.closing.declared.Z.shape), self.closing.motions.none
        )

    # -- what stays open -----------------------------------------------------------------------

    def _gaps(self, x: Array) -> Array:
        """Return each joint equation's residual over the size of the bodies, after motions x."""
        q = self.closing.placed(self.closing.declared, x)
        return np.asarray(np.abs(self.closing.all_left(self.closing.declared, q).real))

    def _open(self, x: Array) -> float:
        return float(np.max(self._gaps(x), initial=0.0))

    def _widest(self, x: Array) -> tuple[str, float]:
        """Return the joint with the largest gap after rigid motions x, and this gap."""
        gaps = self._gaps(x)
        return self.names[int(np.argmax(gaps))], float(np.max(gaps))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints of all constraint equations, one per equation."""
        joints = self.closing.declared.constraints.structure.joints
        return tuple(joint.name for joint in joints for _ in range(joint.rows))

    def require_closed(self) -> None:
        """Raise InconsistentStartError if rigid motions leave a joint open."""
        if self.moves and self._open(self._positions[0]) > _CLOSED:
            joint, gap = self._widest(self._positions[0])
            raise InconsistentStartError(
                "assembly",
                "rigid motions of the bodies must close all joints",
                f"joint {joint!r} that stays open by {gap:.3g} of the size of the mechanism",
                f"No start of {_RESTARTS} random ones closes it: the joints may not close at that "
                "position. Rotate a body with turn=..., correct the design, or set "
                "project_start=True to strain bodies.",
            )

    def follows(self, moved: Declared, q_b: Array, value: float) -> str | None:
        """Return a joint that a variable opens although bodies follow it rigidly, or None.

        `q_b` is the derivative of the start along the declaration `moved`, `value` the value of the
        variable.
        """
        declared = self.closing.placed(moved, self._positions[0])
        held = np.max(np.abs(self.closing.all_left(moved, declared).imag), initial=0.0) / STEP
        left = np.abs(self.closing.all_left(moved, self.q.real + 1j * STEP * q_b).imag) / STEP
        # Round-off is relative to terms that cancel, and to moving coordinates. Coefficients that
        # change are measured along an arbitrary direction.
        q = self.q.real
        along = np.cos(np.arange(len(q))) * np.max(np.abs(q))
        terms = self.closing.weights * moved.constraints.constraint(0.0, q, along).imag / STEP
        size = held + np.max(np.abs(terms), initial=0.0)
        size += np.max(np.abs(declared.imag), initial=0.0) / STEP / self.closing.size
        # A variable that moves nothing leaves round-off relative to its own value.
        noise = _NOISE / abs(value) if value else 0.0
        if np.max(left, initial=0.0) <= _FREE * size + noise:
            return None
        return self.names[int(np.argmax(left))]


def _plus(y: Unknowns, dy: Array) -> Unknowns:
    n, m = len(y[0]), len(y[1])
    return y[0] + dy[:n], y[1] + dy[n : n + m], y[2] + dy[n + m :]


@final
@dataclass(frozen=True, eq=False)
class AssembledStart:
    """Start of a scene at design values b: as declared, or assembled by rigid motions.

    `displaced` is whether the design has moved anything that closes joints.
    """

    scene: Scene
    numbering: Numbering
    mapping: ParameterMap
    reference: Reference
    joints: JointConstraints
    pattern: SparsityPattern
    b: Array
    displaced: bool

    @cached_property
    def state(self) -> tuple[Array, Array]:
        """Coordinates q and velocities v of the start, shape (n_q,) each: as declared, or closed.

        Raises InconsistentStartError if joints stay open that `project_start` does not close, or if
        a driven section starts half a turn off its angle, where the driver's equation holds, too.
        """
        Z, joints = self.reference.Z, self.joints
        if self._moves or np.iscomplexobj(Z) or joints.is_complex:
            q, v = self._closed()
        else:
            q = Z.ravel()
            v = self.reference.velocities(q, None)
        opposite = joints.opposite(q, 0.0)
        if opposite is not None:
            raise InconsistentStartError(
                f"joint {opposite!r}",
                "the section must start at the angle of the law",
                "one that points the other way",
                "Add pi to the offset of the law, or declare the body turned to that angle.",
            )
        return q, v

    @property
    def _moves(self) -> bool:
        """Whether bodies move to close joints: if asked to, or if the design displaces them."""
        return self.scene.assemble or self.scene.project_start or self.displaced

    def _closed(self) -> tuple[Array, Array]:
        assembly = self._assembly
        if not self.scene.project_start:
            assembly.require_closed()
        if not np.iscomplexobj(assembly.q):
            return assembly.q, assembly.v
        # A complex step of the design perturbs the start along its derivative.
        declared = self._declared(None)
        joint = assembly.follows(declared, assembly.q.imag / STEP, 1.0)
        if joint is not None and self.scene.project_start:
            along_q, along_v = assembly.strained_along(declared)
            return assembly.q.real + 1j * STEP * along_q, assembly.v.real + 1j * STEP * along_v
        moved = [x for x, b in zip(self.mapping.names, self.b, strict=True) if b.imag]
        self._require_followed(joint, ", ".join(moved))
        return assembly.q, assembly.v

    @cached_property
    def along(self) -> dict[int, tuple[Array, Array]]:
        """Derivatives of the assembled q and v, (n_q,) each, by index of the moving variables.

        Raises InconsistentStartError if rigid motions cannot keep all joints closed, unless
        `project_start` lets bodies strain.
        """
        derivatives = {}
        for i in sorted({*self.reference.active, *self.joints.active}):
            declared = self._declared(i)
            along = self._assembly.along(declared)
            joint = self._assembly.follows(declared, along[0], float(self.b[i].real))
            if joint is not None and self.scene.project_start:
                along = self._assembly.strained_along(declared)
            else:
                self._require_followed(joint, self.mapping.names[i])
            derivatives[i] = along
        return derivatives

    def state_b(self) -> tuple[Array, Array]:
        """Return the design derivatives of q and v, shape (n_q, n_b) each."""
        q_b, v_b = np.zeros((2, self.numbering.n_q, len(self.b)))
        for i, (along_q, along_v) in self.along.items():
            q_b[:, i], v_b[:, i] = along_q, along_v
        return q_b, v_b

    def pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return q_b^T on_q + v_b^T on_v of the assembled start, shape (n_b,)."""
        total = np.zeros(len(self.b))
        for i, (along_q, along_v) in self.along.items():
            total[i] = on_q @ along_q + on_v @ along_v
        return total

    @cached_property
    def _assembly(self) -> Assembly:
        """Assembly of the scene, in which bodies close the joints by rigid motions."""
        motions, scene = self.numbering.rigid_motions(), self.scene
        free = np.ones(motions.none.shape, dtype=bool)
        names = [member.name for member in scene.members]
        for name in scene.lead:
            free[names.index(name), self.numbering.d :] = False
        bodies = self.numbering.bodies
        places = self.reference.Z.real[np.concatenate([body.positions for body in bodies])]
        extent = np.linalg.norm(np.ptp(places, axis=0)) + max(body.size for body in bodies)
        # A power of two, so that a small change of the design does not change it.
        size = 2.0 ** np.round(np.log2(extent))
        # Equations of rigid bodies come after those of the joints.
        rows = sum(joint.rows for joint in self.joints.structure.joints[: len(scene.joints)])
        closing = Closing(motions, self._declared(None), self.pattern, rows, free, size)
        return Assembly(closing, self._moves, scene.project_start)

    def _declared(self, i: int | None) -> Declared:
        """Return the declared start before assembly; variable i, if any, has an imaginary step."""
        joints, reference = self.joints, self.reference
        if i is not None:
            joints, reference = joints.moved(i), reference.moved(i)
        return Declared(joints, reference.Z, reference.velocities)

    @staticmethod
    def _require_followed(joint: str | None, variable: str) -> None:
        if joint is not None:
            raise InconsistentStartError(
                f"design variable {variable!r}",
                "rigid motions of the bodies must follow it",
                f"joint {joint!r}, which they leave open",
                "Set project_start=True to strain the bodies, or choose another variable.",
            )
