"""A part of a reader's own that is declared wrongly is refused in the package's words."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from ancfdae import Beam, Material, RigidBody, Scene, assemble
from ancfdae.errors import InvalidInputError
from ancfdae.extend import Joint, Load, MaterialPoint
from ancfdae.model.design import design_numbers
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.joint import JointEquations, empty_equations
from ancfdae.model.loads.load import LAW_FIELD
from ancfdae.sections import Rectangle
from tests.support.extending.element import Strand

BODY = RigidBody("box", (0, 0), mass=1.0, inertia=0.1)


@dataclass(frozen=True)
class Hold(Joint):
    """Holds the height of a point."""

    point: MaterialPoint
    name: str = field(default="hold", kw_only=True)

    kind = "hold"

    def coefficients(self, p, reference):
        c = empty_equations(1, p, reference)
        c.linear[0, 0, 1] = 1.0
        return c


@dataclass(frozen=True)
class Drag(Load):
    """Drag of a point, in proportion to its velocity."""

    point: MaterialPoint
    drag: float = 1.0
    name: str = field(default="drag", kw_only=True)

    kind = "drag"
    design_fields = (*design_numbers("drag"), LAW_FIELD)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION),)

    def force(self, U, V, p, U_o):
        return -p[0] * V


def with_element(**members):
    element = type("Wrong", (Strand,), members)()
    section, material = Rectangle(0.02, 0.02), Material(3000, 1e8, 0.3)
    rope = Beam("rope", (0, 0), (1, 0), 2, section, material, element=element)
    return assemble(Scene([rope], [], (0, -9.81)))


def with_joint(**members):
    return assemble(Scene([], [type("Wrong", (Hold,), members)(BODY.at(0, 0))], bodies=[BODY]))


def with_load(**members):
    load = type("Wrong", (Drag,), members)(BODY.at(0, 0))
    return assemble(Scene([], [], bodies=[BODY], loads=[load]))


def answering(value):
    return lambda *_: value


FLAT = JointEquations(np.zeros((1, 1)), np.zeros((1, 1, 1)), np.zeros(1))
WRONG = {
    "an element without a name": (with_element, {"name": None}, "element.*rope.*name"),
    "an element without slopes": (
        with_element,
        {"quantities": (Quantity.POSITION,)},
        "quantities: must begin with a position and the slope",
    ),
    "no weights": (with_element, {"vector_weights": answering(None)}, "vector_weights.*None"),
    "too few weights": (
        with_element,
        {"vector_weights": answering((np.ones(3), np.zeros(3)))},
        r"vector_weights: .*\(4,\) each; got \[\(3,\), \(3,\)\]",
    ),
    "no integrals": (with_element, {"integrals": answering(3)}, "integrals of the element STRAND"),
    "no coefficients": (with_joint, {"coefficients": answering(None)}, "coefficients.*'hold'"),
    "flat coefficients": (with_joint, {"coefficients": answering(FLAT)}, r"need \(1, 1, 2\)"),
    "no vectors": (with_joint, {"vectors": answering(())}, "vectors of joint 'hold'"),
    "vectors of text": (with_load, {"vectors": answering("abc")}, "vectors of load 'drag'"),
    "a pair of points": (
        with_load,
        {"vectors": answering(((BODY.at(0, 0), BODY.at(1, 0)),))},
        "vectors of load 'drag'",
    ),
    "a field of the design that is none": (
        with_load,
        {"design_fields": design_numbers("mass")},
        "load of class Wrong.*no field 'mass'",
    ),
    "no force": (with_load, {"force": answering(None)}, r"force of load 'drag': .*\(1, 2\)"),
    "too long a force": (with_load, {"force": answering(np.ones(5))}, "force of load 'drag'"),
}


@pytest.mark.parametrize(("scene", "members", "words"), WRONG.values(), ids=WRONG)
def test_what_is_declared_wrongly_is_refused_by_name(scene, members, words):
    scene()  # Right without the change.
    with pytest.raises(InvalidInputError, match=words):
        scene(**members)


def test_a_load_whose_design_has_no_law_is_told_to_have_one():
    @dataclass(frozen=True)
    class Lawless(Load):
        point: MaterialPoint

        kind = "lawless"
        vectors, force = Drag.vectors, Drag.force

    with pytest.raises(InvalidInputError, match=r"Lawless, design_fields.*LAW_FIELD"):
        Lawless(BODY.at(0, 0))
