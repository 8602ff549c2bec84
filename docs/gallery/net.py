"""
A net that catches a ball
=========================

Seven ropes by seven, taut between the sides of a frame; a ball of 5 kg lies in the middle. Where
the net hangs is an equilibrium of 112 cables, with exact derivatives.
"""

import numpy as np

from ancfdae import (
    CABLE_3D, Beam, Material, Pin, PointMass, Scene, Spherical, equilibrium, equilibrium_gradient,
)
from ancfdae.observables import axial_force, position
from ancfdae.plotting import AxialForce, save, snapshots
from ancfdae.sections import Circle

n, side = 8, 2.0
nylon, rope = Material(1150, 2e9, 0.4), Circle(0.003)
knots = np.linspace(0.0, side, n + 1)
ropes, joints, at = [], [], {}
for axis in (0, 1):
    for row in range(1, n):
        for k in range(n):
            ends = np.zeros((2, 3))
            ends[:, axis], ends[:, 1 - axis] = knots[k : k + 2], knots[row]
            name = f"{'xy'[axis]}{row}{k}"
            ropes.append(Beam(name, *ends, 1, rope, nylon, element=CABLE_3D, initial_strain=1e-3))
            for point, end in zip((ropes[-1].at_start, ropes[-1].at_end), ends, strict=True):
                knot = tuple(end.round(6))
                on_frame = not np.all((end[:2] > 0) & (end[:2] < side))
                if on_frame or knot in at:
                    joint = Pin(point) if on_frame else Spherical(point, at[knot])
                    joints.append(joint)
                at.setdefault(knot, point)
middle = at[side / 2, side / 2, 0.0]
scene = Scene(ropes, joints, (0, 0, -9.81), bodies=[PointMass(middle, 5.0, name="ball")])

# %%
# Where it hangs, and how hard the ropes beside the ball pull.

rest = equilibrium(scene)
print(rest)
print(f"the ball hangs {-rest.solution.position(middle)[0, 2]:.4f} m deep")
pull = axial_force(ropes[n * (n // 2 - 1) + n // 2].at(0.5))
print(equilibrium_gradient(scene, pull, design=["ball.mass"]))
deep = equilibrium_gradient(scene, position(middle, 2), design=["ball.mass"])
print(f"{1e3 * deep.gradient[0]:.2f} mm for each kg more")
save(snapshots(scene, rest.solution, colour=AxialForce(), title="A net and a ball"), "net.png")
