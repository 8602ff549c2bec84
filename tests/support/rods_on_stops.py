"""Pinned rods that fall on a stop, with the scenes in which the stop holds them."""

from ancfdae import Beam, Impact, Material, Mode, Pin, PointMass, PointOnLine, Scene, Switch
from ancfdae.observables import multiplier, position
from ancfdae.sections import Rectangle


def falling_rod(tip=0.0, damping=1e-3):
    """A pinned rod that falls on a stop at y = -0.3, and the same held there."""
    material = Material(1000.0, 2e8, 0.3, damping_time=damping)
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 3, Rectangle(0.03, 0.03), material)
    bodies = [PointMass(rod.at_end, tip)] if tip else []
    hinge = Pin(rod.at_start, name="hinge")
    line = PointOnLine(rod.at_end, (1.0, 0.0), through=(0.0, -0.3), name="stop")
    free, held = (
        Scene([rod], joints, gravity=(0.0, -9.81), bodies=bodies)
        for joints in ([hinge], [hinge, line])
    )
    return rod, free, held


def rod_on_a_stop(height=0.03):
    """A pinned rod that comes to rest on a stop and leaves it, with the events and modes for it."""
    material = Material(1000, 2e8, 0.3, damping_time=1e-3)
    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(height, 0.03), material)
    hinge, gravity = Pin(rod.at_start), (0, -9.81)
    line = PointOnLine(rod.at_end, (1, 0), through=(0, -0.3), name="line")
    stop = Impact(position(rod.at_end, 1) + 0.3, 0.5, "stop", rest="held")
    leave = Switch(-multiplier("line", 0), to="start", direction=-1, name="leave")
    held = Mode(Scene([rod], [hinge, line], gravity=gravity), [leave])
    return rod, Scene([rod], [hinge], gravity=gravity), [stop], {"held": held}
