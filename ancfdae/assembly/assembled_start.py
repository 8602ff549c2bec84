"""The start of a scene: what is declared, bodies following the joints, and its derivatives."""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.assembly import Assembly
from ancfdae.assembly.closing import Closing, Declared
from ancfdae.assembly.constraints import JointConstraints
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.assembly.reference import Reference
from ancfdae.errors.kinds import InconsistentStartError
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern


@final
@dataclass(frozen=True, eq=False)
class AssembledStart:
    """Start of a scene at design values b, of its mechanism as declared or as it closes.

    `displaced` tells whether the design has moved what closes it.
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
        """The start q, v; raises InconsistentStartError where joints stay open that nothing projects."""
        if self._stands:
            q = self.reference.Z.ravel()
            v = self.reference.velocities(q, None)
        else:
            q, v = self._closed()
        self.joints.refuse_opposite(q, 0.0)
        return q, v

    @property
    def _moves(self) -> bool:
        """Whether bodies follow the joints: where asked to, and where the design displaces them."""
        return self.scene.assemble or self.scene.project_start or self.displaced

    @property
    def _stands(self) -> bool:
        """Whether the start is as declared, to the last digit."""
        return not (self._moves or np.iscomplexobj(self.reference.Z) or self.joints.is_complex)

    def _closed(self) -> tuple[Array, Array]:
        assembly = self._assembly
        if not self.scene.project_start:
            assembly.require_closed()
        if not np.iscomplexobj(assembly.q):
            return assembly.q, assembly.v
        # A complex step of the design is a step along its derivative.
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
        """Derivatives of q and v, of the variables that move them."""
        active = sorted({*self.reference.active, *self.joints.active})
        return {i: self._follow(i) for i in active}

    def state_b(self) -> tuple[Array, Array]:
        """Return the partials of q and v, shape (n_q, n_b) each."""
        q_b, v_b = np.zeros((2, self.numbering.n_q, len(self.b)))
        for i, (along_q, along_v) in self.along.items():
            q_b[:, i], v_b[:, i] = along_q, along_v
        return q_b, v_b

    def pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return q_b^T on_q + v_b^T on_v, shape (n_b,)."""
        total = np.zeros(len(self.b))
        for i, (along_q, along_v) in self.along.items():
            total[i] = on_q @ along_q + on_v @ along_v
        return total

    @cached_property
    def _assembly(self) -> Assembly:
        """The start where bodies follow the joints."""
        motions, scene = self.numbering.rigid_motions(), self.scene
        free = np.ones(motions.none.shape, dtype=bool)
        names = [member.name for member in scene.members]
        for name in scene.lead:
            free[names.index(name), self.numbering.d :] = False
        bodies = self.numbering.bodies
        places = self.reference.Z.real[np.concatenate([body.positions for body in bodies])]
        extent = np.linalg.norm(np.ptp(places, axis=0)) + max(body.size for body in bodies)
        # A power of two, so that a small change of the design leaves it as it is.
        size = 2.0 ** np.round(np.log2(extent))
        # Equations of rigid bodies come after those of the joints.
        rows = sum(joint.rows for joint in self.joints.structure.joints[: len(scene.joints)])
        closing = Closing(motions, self._declared(None), self.pattern, rows, free, size)
        return Assembly(closing, self._moves, scene.project_start)

    def _declared(self, i: int | None) -> Declared:
        """Return the declaration, with design variable i (if given) moved by an imaginary step."""
        joints, reference = self.joints, self.reference
        if i is not None:
            joints, reference = joints.moved(i), reference.moved(i)
        return Declared(joints, reference.Z, reference.velocities)

    def _follow(self, i: int) -> tuple[Array, Array]:
        """Differentiate the assembled q and v with respect to design variable i; (n_q,) each.

        Raises InconsistentStartError if rigid motions cannot keep all joints closed, unless
        `project_start` lets bodies strain.
        """
        declared = self._declared(i)
        along = self._assembly.along(declared)
        joint = self._assembly.follows(declared, along[0], float(self.b[i].real))
        if joint is not None and self.scene.project_start:
            return self._assembly.strained_along(declared)
        self._require_followed(joint, self.mapping.names[i])
        return along

    @staticmethod
    def _require_followed(joint: str | None, variable: str) -> None:
        if joint is not None:
            raise InconsistentStartError(
                f"design variable {variable!r}",
                "rigid motions of the bodies must follow it",
                f"joint {joint!r}, which they leave open",
                "Set project_start=True to strain the bodies, or choose another variable.",
            )
