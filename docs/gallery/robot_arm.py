"""
A robot arm that swings a payload
=================================

In space: a turntable that turns, an upper arm and a forearm of thin tube, a motor in the elbow, and
a payload. Colours show how far one design variable moves each point.
"""

from ancfdae import (
    HHT, Beam, Material, PointMass, Revolute, RigidBody, RigidCylinder, RotationDriver, Scene, Weld,
    assemble, differentiate,
)
from ancfdae.laws import SmoothStep
from ancfdae.observables import driver_torque, observe
from ancfdae.sections import Tube
from ancfdae.plotting import Sensitivity, VonMisesStress, animate, save, snapshots

alloy = Material(density=2700, youngs_modulus=7e10, poisson_ratio=0.33, damping_time=1e-4)
tube = Tube(radius=0.012, thickness=0.001)
table = RigidBody("table", (0, 0, 0), shape=RigidCylinder(0.1, 0.04), density=2700)
upper = Beam("upper", (0, 0, 0), (0, 0, 0.6), 3, tube, alloy)
fore = Beam("fore", (0, 0, 0.6), (0.6, 0, 0.6), 3, tube, alloy)
turn, bend = SmoothStep(0.0, 1.5, duration=0.4), SmoothStep(0.0, 0.9, duration=0.4)  # rad, s
joints = [
    Revolute(table.at(0, 0, 0), axis=(0, 0, 1), ground=(0, 0, 0), name="bearing"),
    RotationDriver(table.at(0, 0, 0), turn, axis=(0, 0, 1), name="base_motor"),
    Weld(upper.at_start, table.at(0, 0, 0), name="foot"),
    Revolute(fore.at_start, axis=(0, 1, 0), other=upper.at_end, name="elbow"),
    RotationDriver(fore.at_start, bend, axis=(0, 1, 0), other=upper.at_end, name="elbow_motor"),
]
payload = PointMass(fore.at_end, 0.5, name="payload")
scene = Scene([upper, fore], joints, (0, 0, -9.81), bodies=[table, payload])

# %%
# One run with the derivatives with respect to the thickness of the wall and the payload.

solution = differentiate(scene, 0.5, HHT(2**-9), design=["fore.thickness", "payload.mass"])
print(solution.outcome)
times = [0.0, 0.2, 0.4]  # s
save(snapshots(scene, solution, times, VonMisesStress(), "Stress"), "arm_stress")
moved = Sensitivity("payload.mass")
save(snapshots(scene, solution, times, moved, "What a heavier payload moves"), "arm_payload")

# %%
# What the motors must do.

system = assemble(scene, ["fore.thickness", "payload.mass"])
for motor in ("base_motor", "elbow_motor"):
    torque = observe(driver_torque(motor), solution, system)
    print(f"{motor}: up to {abs(torque).max():.2f} N m")

# %%
# Turn it, and stop it where you like.

animate(scene, solution, "robot_arm.html", VonMisesStress())
