"""Power of driven joints and of loads, prepared when it is first asked for."""

from typing import final

from ancfdae.assembly.joint_work import JointWork, at_unit_rate
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.load_work import LoadWork
from ancfdae.assembly.part_inputs import PartInputs
from ancfdae.errors import InvalidInput, named
from ancfdae.model.joints import DrivenJoint
from ancfdae.model.scene import Scene


@final
class Works:
    """What does work in a scene, by name; the layout knows the rows of the joints."""

    def __init__(self, scene: Scene, inputs: PartInputs, layout: Layout, n_b: int) -> None:
        self._scene, self._inputs, self._layout, self._n_b = scene, inputs, layout, n_b
        self._joints: dict[tuple[str, bool], JointWork] = {}
        self._loads: dict[str, LoadWork] = {}

    def of_joint(self, name: str, unit_rate: bool) -> JointWork:
        """Return what gives the power of a driven joint, or at a unit rate its torque or force."""
        key = name, unit_rate
        if key not in self._joints:
            place = self._layout.joint(name)
            joints = [joint for joint in self._scene.joints if joint.name == name]
            if not joints or not isinstance(joints[0], DrivenJoint):
                rule, repair = "must be driven: others do no work", "Name a Drive or a Guide."
                raise InvalidInput(f"work of joint {name!r}", rule, "one that is not", repair)
            item = self._inputs.joint(at_unit_rate(joints[0]) if unit_rate else joints[0])
            self._joints[key] = JointWork(*item, place.first_row)
        return self._joints[key]

    def of_load(self, name: str) -> LoadWork:
        """Return what gives the power of a load, or raise UnknownName."""
        if name not in self._loads:
            load = named("load", name, self._scene.loads)
            self._loads[name] = LoadWork(self._inputs.load(load), self._n_b)
        return self._loads[name]
