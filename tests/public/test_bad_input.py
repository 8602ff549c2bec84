"""Bad input is refused with the project's own error, before anything is integrated.

Each case states what the message must name: where, got and, where it matters, the repair.
"""

import warnings

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    Beam,
    Clamp,
    CurvedBeam,
    DesignVariable,
    Distance,
    FiniteDifference,
    InitialVelocity,
    Material,
    NodalState,
    Pin,
    PrescribedSteps,
    Radau,
    RigidBody,
    RotationDriver,
    Scene,
    Terminal,
    TranslationDriver,
    assemble,
    choose_model,
    differentiate,
    modes,
    simulate,
)
from ancfdae.errors import (
    AncfdaeError,
    InconsistentStartError,
    InvalidInputError,
    RedundantConstraintsError,
    StabilityWarning,
    UnknownNameError,
)
from ancfdae.extend import MaterialPoint
from ancfdae.integrators.hht.step import StepSolver
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.observables import position
from ancfdae.sections import Rectangle

NAN, INF = float("nan"), float("inf")
SECTION = Rectangle(height=0.05, width=0.04)
MATERIAL = Material(density=1000.0, youngs_modulus=1e7, poisson_ratio=0.3)
STEP = 1 / 64


def beam(**changes):
    arguments = {
        "name": "rod",
        "start": (0.0, 0.0),
        "end": (1.0, 0.0),
        "elements": 2,
        "section": SECTION,
        "material": MATERIAL,
    }
    return Beam(**(arguments | changes))


def spatial(**changes):
    return beam(**({"start": (0.0, 0.0, 0.0), "end": (1.0, 0.0, 0.0)} | changes))


def curved(**changes):
    arguments = {
        "name": "bow",
        "positions": np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]),
        "frames": np.repeat(np.eye(2)[None], 3, axis=0),
        "section": SECTION,
        "material": MATERIAL,
    }
    return CurvedBeam(**(arguments | changes))


def scene(*joints, **changes):
    rod = beam()
    return Scene(**({"beams": [rod], "joints": joints or [Pin(rod.at_start)]} | changes))


ROD = beam()
NODES = assemble(scene()).start()[0].reshape(3, 3, 2)


def material(**changes):
    arguments = {"density": 1000.0, "youngs_modulus": 1e7, "poisson_ratio": 0.3}
    return Material(**(arguments | changes))


def spoiled(array, value):
    array = np.array(array, dtype=float)
    array.flat[3] = value
    return array


@pytest.fixture(autouse=True)
def _nothing_is_integrated(monkeypatch):
    def refuse(*_):
        raise AssertionError("a step was integrated")

    monkeypatch.setattr(StepSolver, "advance", refuse)
    monkeypatch.setattr(StepSolver, "march", refuse)


def refused(action, where, rule="", got="", repair="", kind=InvalidInputError):
    """Check that the message says where, what is required, what came and what to do."""
    with pytest.raises(kind) as caught:
        action()
    error = caught.value
    assert isinstance(error, AncfdaeError)
    assert where in error.where
    assert rule in error.rule
    assert got in str(error.got)
    assert repair in error.repair
    # The message is made of its parts; a remedy is left out where the rule says it.
    assert all((error.where, error.rule, str(error.got)))
    remedy = f" {error.repair}" if error.repair else ""
    assert str(error) == f"{error.where}: {error.rule}; got {error.got}.{remedy}"
    return error


def test_the_good_input_that_every_case_changes_is_accepted():
    assemble(scene())
    assemble(Scene([spatial()]))
    assemble(Scene([curved()]))
    material()


def test_the_guard_of_this_file_notices_a_step():
    with pytest.raises(AssertionError, match="integrated"):
        simulate(scene(gravity=(0.0, -1.0)), STEP, HHT(STEP))


# ---------------------------------------------------------------- numbers

NOT_POSITIVE = [0.0, -1.0, NAN, INF, -INF, "0.05", None, True, np.True_, 1j, [1.0], 10**400]


@pytest.mark.parametrize("value", NOT_POSITIVE, ids=lambda value: repr(value)[:8])
@pytest.mark.parametrize("name", ["height", "width"])
def test_section_sizes_must_be_positive_numbers(name, value):
    sizes = {"height": 0.05, "width": 0.04} | {name: value}
    refused(lambda: Rectangle(**sizes), f"Rectangle.{name}", got=repr(value)[:8])


@pytest.mark.parametrize("value", NOT_POSITIVE, ids=lambda value: repr(value)[:8])
@pytest.mark.parametrize("name", ["density", "youngs_modulus"])
def test_densities_and_moduli_must_be_positive_numbers(name, value):
    refused(lambda: material(**{name: value}), f"Material.{name}", got=repr(value)[:8])


@pytest.mark.parametrize("value", [-1.0, 0.5, 0.7, -2.0, NAN, INF, "0.3", None, True])
def test_poisson_ratio_must_lie_between_minus_one_and_a_half(value):
    error = refused(lambda: material(poisson_ratio=value), "Material.poisson_ratio")
    assert str(value) in str(error)


@pytest.mark.parametrize("value", [0, -1, 1.5, 2.0, True, False, "2", None, NAN])
def test_element_count_must_be_a_positive_whole_number(value):
    error = refused(
        lambda: beam(elements=value),
        "beam 'rod', elements",
        "must be a positive integer",
        repr(value),
    )
    assert "at least one" in error.repair


def test_admissible_extremes_are_accepted():
    assert material(poisson_ratio=0.499).poisson_ratio == 0.499
    assert material(poisson_ratio=-0.999).poisson_ratio == -0.999
    assert material(poisson_ratio=0).poisson_ratio == 0
    assert beam(elements=np.int64(3)).element_count == 3


# ---------------------------------------------------------------- beams


@pytest.mark.parametrize(
    ("changes", "where", "words"),
    [
        ({"end": (0.0, 0.0)}, "beam 'rod'", "start and end must differ"),
        ({"end": (NAN, 0.0)}, "beam 'rod', end", "nan"),
        ({"start": (INF, 0.0)}, "beam 'rod', start", "inf"),
        ({"start": ("0", 0.0)}, "beam 'rod', start", "'0'"),
        ({"start": "ab"}, "beam 'rod', start", "'a'"),
        ({"start": 0.0}, "beam 'rod', start", "0.0"),
        ({"start": None}, "beam 'rod', start", "None"),
        ({"end": (1.0, 0.0, 0.0)}, "beam 'rod', end", "2 components"),
        ({"start": (0.0,)}, "beam 'rod', start", "2 or 3 components"),
        ({"start": (0.0,) * 4, "end": (1.0,) * 4}, "beam 'rod', start", "2 or 3 components"),
        ({"name": ""}, "Beam.name", "non-empty"),
        ({"name": "a.b"}, "Beam.name", "'a.b'"),
        ({"name": "a[0"}, "Beam.name", "'a[0'"),
        ({"name": 3}, "Beam.name", "3"),
        ({"section": 0.05}, "beam 'rod'", "one Section or a sequence of 2"),
        ({"section": [SECTION]}, "beam 'rod'", "sequence of 2"),
        ({"section": [SECTION] * 3}, "beam 'rod'", "sequence of 2"),
        ({"material": [MATERIAL, SECTION]}, "beam 'rod'", "one Material"),
        ({"material": "steel"}, "beam 'rod'", "one Material"),
        ({"height_axis": (0.0, 1.0)}, "beam 'rod', height_axis", "left out for a planar beam"),
    ],
)
def test_bad_beam_is_refused(changes, where, words):
    assert words in str(refused(lambda: beam(**changes), where))


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        ((1.0, 0.0, 0.0), "parallel"),
        ((-2.0, 0.0, 0.0), "parallel"),
        ((0.0, 0.0, 0.0), "parallel"),
        ((0.0, 1.0), "3 components"),
        ((0.0, NAN, 1.0), "nan"),
        ("abc", "'a'"),
    ],
)
def test_bad_height_axis_is_refused(axis, words):
    error = refused(lambda: spatial(height_axis=axis), "beam 'rod', height_axis")
    assert words in str(error)


FRAMES = np.repeat(np.eye(2)[None], 3, axis=0)


@pytest.mark.parametrize(
    ("changes", "where", "words"),
    [
        ({"positions": spoiled(curved().positions, NAN)}, "beam 'bow'", "finite"),
        ({"frames": spoiled(FRAMES, INF)}, "beam 'bow'", "finite"),
        ({"frames": FRAMES[:, ::-1]}, "beam 'bow', frames", "right-handed"),
        ({"frames": 0 * FRAMES}, "beam 'bow', frames", "right-handed"),
        ({"frames": FRAMES[:2]}, "beam 'bow', frames", "(3, 2, 2)"),
        ({"positions": np.zeros((3, 2))}, "beam 'bow', positions", "must differ"),
        ({"positions": np.zeros((1, 2))}, "beam 'bow', positions", "n >= 1"),
        ({"positions": np.zeros((3, 4))}, "beam 'bow', positions", "(3, 4)"),
        ({"positions": 1.0}, "beam 'bow', positions", "shape"),
        ({"positions": [["a", "b"], ["c", "d"]]}, "beam 'bow', positions", ""),
        ({"positions": [[0.0, 0.0], [1.0]]}, "beam 'bow', positions", ""),
        ({"section": [SECTION] * 3}, "beam 'bow'", "sequence of 2"),
    ],
)
def test_bad_curved_beam_is_refused(changes, where, words):
    assert words in str(refused(lambda: curved(**changes), where))


def test_folded_curved_beam_is_refused_by_name():
    # A quarter turn within 1 m has its centre of curvature 0.64 m away, inside a height of 3 m.
    frames = np.array([[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [-1.0, 0.0]]])
    positions = np.array([[0.0, 0.0], [0.64, 0.64]])
    bow = curved(positions=positions, frames=frames, section=Rectangle(3.0, 0.04))
    error = refused(lambda: assemble(Scene([bow])), "bow", "positive determinant")
    assert "thinner section" in error.repair


# ---------------------------------------------------------------- points and joints


@pytest.mark.parametrize("fraction", [-0.1, 1.1, NAN, INF, "0.5", None])
def test_fraction_along_a_beam_must_lie_between_zero_and_one(fraction):
    refused(lambda: ROD.at(fraction), "point of 'rod'", got=str(fraction))
    if fraction is not None:  # of a rigid body
        refused(lambda: MaterialPoint("rod", fraction), "point of 'rod'", got=str(fraction))


@pytest.mark.parametrize("offset", [{"y": NAN}, {"z": INF}, {"y": "top"}, {"y": None}])
def test_offset_must_be_a_finite_number(offset):
    refused(lambda: ROD.at(0.5, **offset), "point of 'rod'", "finite")


@pytest.mark.parametrize("y", [0.026, -0.026, 1.0])
def test_joint_must_touch_the_section(y):
    refused(lambda: scene(Pin(ROD.at(0.5, y=y))), "joint 'pin(rod@0.5)'", "0.025", str(y), "Move")


def test_joint_must_touch_the_section_of_its_own_element():
    rod = beam(section=[Rectangle(0.1, 0.04), SECTION])
    Scene([rod], [Pin(rod.at(0.4, y=0.05))])
    refused(lambda: Scene([rod], [Pin(rod.at(0.6, y=0.05))]), "joint 'pin(rod@0.6)'", "0.025")


def test_joint_on_the_surface_is_accepted_and_beyond_the_width_refused():
    scene(Pin(ROD.at(0.5, y=0.025)))
    rod = spatial()
    Scene([rod], [Pin(rod.at(0.5, z=-0.02))])
    refused(lambda: Scene([rod], [Pin(rod.at(0.5, z=0.021))]), "pin(rod@0.5)", "0.02", "z = 0.021")


@pytest.mark.parametrize(
    ("joint", "where", "words"),
    [
        (lambda: Pin(ROD.at(0.5, z=0.01)), "pin(rod@0.5)", "z must be 0"),
        (lambda: Pin(ROD.at_start, ground=(0.0,) * 3), "pin(rod@0)", "2 components"),
        (lambda: Pin(ROD.at_start, ground=(NAN, 0.0)), "pin(rod@0)", "nan"),
        (lambda: Pin(ROD.at_start, ground=("0", 0.0)), "pin(rod@0)", "'0'"),
        (lambda: Pin(ROD.at_start, ground=0.0), "pin(rod@0)", "0.0"),
        (lambda: Pin(ROD.at_start, ROD.at_end, ground=(0.0, 0.0)), "pin(rod@0)", "both"),
        (lambda: Pin("rod"), "", "'rod'"),
        (lambda: Clamp("rod"), "", "'rod'"),
        (lambda: Pin("rod", name="p"), "joint 'p'", "'rod'"),
        (lambda: Pin(ROD.at_start, "rod"), "joint 'pin(rod@0)'", "'rod'"),
        (lambda: Clamp(ROD.at_start, ROD.at_end), "joint 'clamp(rod@0)', ground", "use Weld"),
        (lambda: Distance(ROD.at_start, 1.0), "joint 'link(rod@0)'", "neither"),
        (
            lambda: RotationDriver(ROD.at_start, ConstantAcceleration(1.0), (0, 0, 1)),
            "'drive(rod@0)', axis",
            "left out in the plane",
        ),
        (lambda: RotationDriver(ROD.at_start, 2.0), "joint 'drive(rod@0)', angle", "Law"),
        (
            lambda: TranslationDriver(ROD.at_start, (0.0, 0.0), ConstantAcceleration(1.0)),
            "direction",
            "zero",
        ),
        (lambda: "pin", "Scene.joints", "'pin'"),
    ],
)
def test_bad_joint_is_refused(joint, where, words):
    assert words in str(refused(lambda: scene(joint()), where))


# ---------------------------------------------------------------- names


def test_unknown_names_are_refused_with_the_known_ones():
    rods = Scene([beam(), beam(name="crank", start=(0.0, 1.0))], [Pin(ROD.at_start, name="pivot")])
    solution_scene = assemble(rods).naming.layout
    for action, name in (
        (lambda: rods.beam("rood"), "'rood'"),
        (lambda: assemble(rods, ["rood.height"]), "'rood'"),
        (lambda: rods.with_values({"rood.height": 1.0}), "'rood'"),
        (lambda: Scene([beam()], start=[InitialVelocity("rood", 1.0, (0.0, 0.0))]), "'rood'"),
        (lambda: scene(Pin(MaterialPoint("rood", 0.0))), "'rood'"),
        (lambda: scene(Pin(ROD.at_start, MaterialPoint("rood", 0.0))), "'rood'"),
        (lambda: solution_scene.beam("rood"), "'rood'"),
    ):
        error = refused(action, "beam", got=name, repair="rod", kind=UnknownNameError)
        assert "Known names: " in error.repair
    error = refused(
        lambda: solution_scene.joint("pivo"), "joint", got="'pivo'", kind=UnknownNameError
    )
    assert error.repair == "Known names: pivot."
    for action in (
        lambda: assemble(rods, ["rod.hight"]),
        lambda: rods.with_values({"rod.hight": 1.0}),
    ):
        error = refused(action, "design target", got="'rod.hight'", kind=UnknownNameError)
        for known in ("density", "height", "length", "poisson_ratio", "width", "youngs_modulus"):
            assert f"rod.{known}" in error.repair


def test_both_beams_of_a_message_are_sorted():
    rods = Scene([beam(name="b"), beam(name="a")])
    with pytest.raises(UnknownNameError, match=r"Known names: a, b\."):
        rods.beam("c")


def test_duplicate_names_are_refused():
    refused(lambda: Scene([beam(), beam(end=(2.0, 0.0))]), "Scene.beams", "of its own", "rod")
    pins = [Pin(ROD.at_start), Pin(ROD.at_start, ground=(0.0, 0.0))]
    refused(lambda: scene(*pins), "Scene.joints", "of its own", "pin(rod@0)", "Rename")
    clamps = [Clamp(ROD.at_start, name="p"), Pin(ROD.at_end, name="p")]
    refused(lambda: scene(*clamps), "Scene.joints", "of its own", "p")
    # A design target such as rod.height must mean one part.
    refused(lambda: scene(Pin(ROD.at_start, name="rod")), "Scene", "of its own", "rod")


# ---------------------------------------------------------------- scenes


@pytest.mark.parametrize(
    ("arguments", "where", "words"),
    [
        ({"beams": []}, "Scene.beams", "at least one"),
        ({"beams": ["rod"]}, "Scene.beams", "'rod'"),
        ({"beams": [beam(), spatial(name="s")]}, "Scene.beams", "all planar or all spatial"),
        ({"beams": ROD}, "Scene.beams", "sequence"),
        ({"joints": Pin(ROD.at_start)}, "Scene.joints", "sequence"),
        ({"gravity": (0.0, 0.0, -9.81)}, "Scene.gravity", "2 components"),
        ({"gravity": (0.0, NAN)}, "Scene.gravity", "nan"),
        ({"gravity": ("0", "9.81")}, "Scene.gravity", "'0'"),
        ({"gravity": -9.81}, "Scene.gravity", "-9.81"),
        ({"start": InitialVelocity("rod", 1.0, (0.0, 0.0))}, "Scene.start", "sequence"),
        ({"start": ["rest"]}, "Scene.start", "'rest'"),
    ],
)
def test_bad_scene_is_refused(arguments, where, words):
    joints = {"joints": []} if "beams" in arguments else {}
    assert words in str(refused(lambda: scene(**(joints | arguments)), where))


@pytest.mark.parametrize(
    ("motion", "where"),
    [
        (lambda: InitialVelocity("rod", 1.0, (0.0, 0.0, 0.0)), "start of 'rod', about"),
        (lambda: InitialVelocity("rod", 1.0, (0.0, NAN)), "start of 'rod', about"),
        (lambda: InitialVelocity("rod", 1.0, None), "start of 'rod', about"),
        (
            lambda: InitialVelocity("rod", (0.0, 0.0, 1.0), (0.0, 0.0)),
            "start of 'rod', angular_velocity",
        ),
        (lambda: InitialVelocity("rod", NAN, (0.0, 0.0)), "start of 'rod', angular_velocity"),
        (lambda: InitialVelocity("rod", "fast", (0.0, 0.0)), "start of 'rod', angular_velocity"),
        (lambda: InitialVelocity("rod", 1.0, (0.0, 0.0), (1.0,)), "start of 'rod', velocity"),
        (lambda: InitialVelocity("rod", 1.0, (0.0, 0.0), (INF, 0.0)), "start of 'rod', velocity"),
        (lambda: InitialVelocity("rod", 1.0, (0.0, 0.0), 1.0), "start of 'rod', velocity"),
        (lambda: NodalState("rod", NODES[:2]), "start of 'rod', coordinates"),
        (lambda: NodalState("rod", spoiled(NODES, NAN)), "start of 'rod', coordinates"),
        (lambda: NodalState("rod", NODES.astype(str)), "start of 'rod', coordinates"),
        (lambda: NodalState("rod", NODES, NODES[:, :2]), "start of 'rod', velocities"),
        (lambda: NodalState("rod", NODES, spoiled(NODES, INF)), "start of 'rod', velocities"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_bad_start_is_refused(motion, where):
    refused(lambda: scene(start=[motion()]), where)


def test_spatial_spin_needs_three_components():
    motion = InitialVelocity("rod", 1.0, (0.0, 0.0, 0.0))
    refused(lambda: Scene([spatial()], start=[motion]), "angular_velocity", "3 components")


def test_two_starts_of_one_beam_are_refused():
    motions = [InitialVelocity("rod", 1.0, (0.0, 0.0)), NodalState("rod", NODES)]
    refused(lambda: scene(start=motions), "start", got="rod")


def test_node_state_takes_nested_lists():
    # Not an error: `Scene` accepts what has the right shape, so `assemble` must read it.
    system = assemble(scene(start=[NodalState("rod", NODES.tolist(), NODES.tolist())]))
    assert np.array_equal(system.start()[0], NODES.ravel())


# ---------------------------------------------------------------- design variables


@pytest.mark.parametrize(
    ("design", "where", "words"),
    [
        (["rod.height[2]"], "design target rod.height[2]", "elements 0 to 1; got 2"),
        (["rod.height[-1]"], "design target", "'rod.height[-1]'"),
        (["rod.length[0]"], "design target rod.length[0]", "Write rod.length, without an index."),
        (["rod"], "design target", "'rod'"),
        ([DesignVariable("height", ["rod.height"]), "t_end"], "design target", "Responses take"),
        (["rod.height[a]"], "design target", "rod.height[2]"),
        (5, "design", "sequence"),
        ([3], "design target", "3"),
        ("rod.height", "design", "Put it in a list"),
        (["rod.height", "rod.height"], "design", "once"),
        (["rod.height", DesignVariable("h", ["rod.height"])], "design", "once"),
        (["rod.height", "rod.height[1]"], "design", "rod.height and rod.height[1]"),
        (["rod.width[0]", DesignVariable("w", ["rod.width"])], "design", "rod.width[0]"),
    ],
)
def test_bad_design_is_refused(design, where, words):
    for action in (
        lambda: assemble(scene(), design),
        lambda: differentiate(scene(), STEP, HHT(STEP), design=design),
    ):
        assert words in str(refused(action, where))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"targets": []}, "non-empty"),
        ({"targets": "rod.height"}, "non-empty sequence"),
        ({"targets": 5}, "sequence"),
        ({"targets": ["rod height"]}, "'rod height'"),
        ({"bounds": (2.0, 1.0)}, "lower bound"),
        ({"bounds": (1.0, 1.0)}, "lower bound"),
        ({"bounds": (NAN, 1.0)}, "nan"),
        ({"bounds": ("0", 1.0)}, "'0'"),
        ({"bounds": (1.0,)}, "bounds"),
        ({"bounds": 1.0}, "bounds"),
    ],
)
def test_bad_design_variable_is_refused(arguments, words):
    targets = {"targets": ["rod.height"]}
    error = refused(lambda: DesignVariable("h", **(targets | arguments)), "design")
    assert words in str(error)


def test_design_variable_of_different_values_is_refused():
    rod = beam(section=[SECTION, Rectangle(0.07, 0.04)])
    rods = Scene([rod])
    both = DesignVariable("h", ["rod.height[0]", "rod.height[1]"])
    for design in (["rod.height"], [both]):
        error = refused(lambda design=design: assemble(rods, design), "design variable")
        assert error.got == [0.05, 0.07]
        assert "with_values" in error.repair
    mixed = DesignVariable("m", ["rod.height[0]", "rod.width"])
    refused(lambda: assemble(rods, [mixed]), "design variable 'm'", "one and the same value")


@pytest.mark.parametrize("elements", range(1, 30))
def test_equal_lengths_are_one_value_whatever_the_number_of_elements(elements):
    # A length is summed from its elements; its round-off must not make two equal ones differ.
    rods = Scene([beam(name="a", end=(1.2, 0)), beam(name="b", end=(1.2, 0), elements=elements)])
    system = assemble(rods, [DesignVariable("L", ["a.length", "b.length"])])
    assert system.b[0] == pytest.approx(1.2, rel=1e-14)  # 30 additions


@pytest.mark.parametrize(
    ("values", "where"),
    [
        ({"rod.height": -1.0}, "rod.height"),
        ({"rod.height[1]": 0.0}, "rod.height[1]"),
        ({"rod.poisson_ratio": 0.5}, "rod.poisson_ratio"),
        ({"rod.length": 0.0}, "rod.length"),
        ({"rod.length": NAN}, "rod.length"),
        ({"rod.density": "heavy"}, "rod.density"),
        ({"rod.density": None}, "rod.density"),
    ],
)
def test_bad_value_of_a_scene_is_refused_by_the_name_the_user_wrote(values, where):
    refused(lambda: scene().with_values(values), where)


@pytest.mark.parametrize(
    ("target", "value"),
    [
        ("rod.height", -0.05),
        ("rod.height", 0.0),
        ("rod.height", NAN),
        ("rod.density", -1.0),
        ("rod.poisson_ratio", 0.6),
        ("rod.length", -1.0),
        ("rod.youngs_modulus", INF),
    ],
)
def test_bad_value_of_a_system_is_refused_by_the_name_of_the_variable(target, value):
    system = assemble(scene(), [target])
    refused(lambda: system.with_values(np.array([value])), target)
    refused(lambda: system.with_values(np.array([value + 1e-40j])), target)


# ---------------------------------------------------------------- constraints


def run(scene):
    return simulate(scene, STEP, HHT(STEP))


@pytest.mark.parametrize(
    ("joints", "names"),
    [
        ([Pin(ROD.at_start, name="p"), Pin(ROD.at_start, name="q")], ("p", "q")),
        ([Clamp(ROD.at_start, name="c"), Pin(ROD.at_start, name="q")], ("c", "q")),
        ([Pin(ROD.at(0.3), name="p"), Pin(ROD.at(0.3), name="q")], ("p", "q")),
        ([Clamp(ROD.at(0.3), name="c"), Pin(ROD.at(0.3, y=0.01), name="q")], ("c", "q")),
        # Three points on one section: the third follows from the other two.
        (
            [Pin(ROD.at(0.3, y=y), name=f"p{k}") for k, y in enumerate((-0.01, 0.0, 0.01))],
            ("p0", "p1", "p2"),
        ),
        ([Pin(ROD.at_start, ROD.at_start, name="p")], ("p",)),
    ],
)
def test_redundant_constraints_are_refused_by_the_names_of_the_joints(joints, names):
    innocent = Pin(ROD.at_end, name="innocent")
    error = refused(lambda: run(scene(*joints, innocent)), "joint", kind=RedundantConstraintsError)
    for name in names:
        assert repr(name) in error.where
    assert "innocent" not in error.where


def test_neighbouring_joints_are_not_redundant():
    # A pin 1 mm away from another one is stiff but holds something else.
    rods = scene(Pin(ROD.at(0.3)), Pin(ROD.at(0.301)), Clamp(ROD.at_end))
    with pytest.raises(AssertionError, match="integrated"):
        run(rods)


def test_redundancy_is_found_in_loops_of_several_beams():
    rods = [beam(name=name) for name in "ab"]
    a, b = rods
    joints = [
        Pin(a.at_start, name="p"),
        Pin(b.at_start, name="q"),
        Pin(a.at_start, b.at_start, name="r"),
    ]
    error = refused(lambda: run(Scene(rods, joints)), "joints", kind=RedundantConstraintsError)
    assert error.where == "joints 'p', 'q', 'r'"


def test_inconsistent_positions_are_refused_by_the_name_of_the_joint():
    rods = scene(Pin(ROD.at_end), Pin(ROD.at_start, ground=(0.0, 0.1), name="low"))
    error = refused(
        lambda: run(rods),
        "start, joint 'low'",
        "the positions must satisfy the joint",
        "0.1",
        "project_start=True",
        InconsistentStartError,
    )
    assert "pin(rod@1)" not in str(error)


def test_inconsistent_velocities_are_refused_by_the_name_of_the_joint():
    rods = scene(Pin(ROD.at_start, name="pivot"), start=[InitialVelocity("rod", 2.0, (0.25, 0.0))])
    refused(
        lambda: run(rods),
        "start, joint 'pivot'",
        "the velocities must satisfy the joint",
        "0.5",
        "project_start=True",
        InconsistentStartError,
    )


def test_small_inconsistencies_count_and_round_off_does_not():
    # The threshold is 1e-8 of the coordinates in the norm of the mass: 1e-6 m of 1 m is far
    # above it even though a node carries only part of the mass, 1e-14 m is round-off.
    for size, kind in ((1e-6, InconsistentStartError), (1e-14, AssertionError)):
        rods = scene(Pin(ROD.at_start, ground=(0.0, size)))
        with pytest.raises(kind):
            run(rods)


def test_a_drive_from_rest_gives_small_velocities_a_size():
    # A rod of length 1, turned by a law from rest with q'' = A w^2 = 8: speeds of sqrt(8) count.
    # The threshold is 1e-8 of that; a slip of 1e-6 is far above it, one of 1e-11 below.
    for slip, kind in ((1e-6, InconsistentStartError), (1e-11, AssertionError)):
        motor = RotationDriver(
            ROD.at_start, Harmonic(2.0, 2.0, 0.5 * np.pi, offset=-2.0), name="motor"
        )
        start = [InitialVelocity("rod", slip, (0.0, 0.0))]
        with pytest.raises(kind):
            run(scene(Pin(ROD.at_start), motor, start=start))


def test_flat_bodies_and_flat_sections_are_refused_in_any_direction():
    # Round-off puts the moment across a disc, and the determinant of parallel slopes, on either
    # side of zero.
    generator = np.random.default_rng(0)
    for _ in range(20):
        axes, _ = np.linalg.qr(generator.normal(size=(3, 3)))
        J = axes @ np.diag([0.3, 0.7, 1.0]) @ axes.T
        tensor = (J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])
        with pytest.raises(InvalidInputError, match="less than the sum of the other two"):
            RigidBody("disc", (0.0, 0.0, 0.0), mass=1.0, inertia=tensor)
        slope, factor = generator.normal(size=(2, 2))
        nodes = NODES.copy()
        nodes[1, 1:] = slope, slope * factor[0]
        with pytest.raises(InvalidInputError, match="must span the body"):
            scene(start=[NodalState("rod", nodes)])
    # A body of a thickness of a thousandth is one.
    RigidBody("disc", (0.0, 0.0, 0.0), mass=1.0, inertia=(1.0, 1.0, 2.0 - 1e-6, 0.0, 0.0, 0.0))


def test_projected_start_satisfies_the_constraints_to_round_off(monkeypatch):
    monkeypatch.undo()
    rod, crank = beam(), beam(name="crank", start=(1.0, 0.02), end=(1.0, 1.0))
    joints = [
        Pin(rod.at(0.2, y=0.01), ground=(0.2, 0.03)),
        Pin(rod.at_end, crank.at_start),
        # Nearer to the first one than it is on the rod: the bodies cannot but be strained.
        Pin(rod.at(0.8), ground=(0.75, 0.0)),
        # Along the crank, which hangs on a rod that stands.
        TranslationDriver(crank.at_end, (0, 1), ConstantAcceleration(0.5)),
    ]
    motions = [InitialVelocity("rod", 2.0, (0.25, 0.0)), InitialVelocity("crank", -1.0, (0.0, 0.0))]
    rods = Scene([rod, crank], joints, (0.0, -9.81), motions, project_start=True)
    system, solution = assemble(rods), simulate(rods, STEP, HHT(STEP))
    q, v = solution.q[0], solution.v[0]
    # Positions and velocities of size one through a solve whose scaled matrix has a condition
    # of some hundreds: 1e3 eps.
    assert np.max(np.abs(system.constraint(0.0, q))) <= 2e-13
    assert np.max(np.abs(system.constraint(0.0, q, v))) <= 2e-13
    declared_q, declared_v = system.start()
    assert np.max(np.abs(system.constraint(0.0, declared_q))) > 0.01
    assert np.max(np.abs(q - declared_q)) > 0.01
    # It is the nearest state in the norm of M: the change is M^{-1} B^T nu for some nu.
    B = system.constraint_pattern.dense(system.constraint_q(0.0, q))
    for change in (q - declared_q, v - declared_v):
        force = system.mass_times(system.start()[0], change)
        rest = force - B.T @ np.linalg.lstsq(B.T, force)[0]
        assert np.max(np.abs(rest)) <= 1e-12 * np.max(np.abs(force))  # as above, and lstsq's own
    # Unlike this one, a start without projection is refused.
    with pytest.raises(InconsistentStartError):
        run(Scene([rod, crank], joints, (0.0, -9.81), motions))


# ---------------------------------------------------------------- integrator


@pytest.mark.parametrize("step", [0.0, -0.1, NAN, INF, "0.1", True])
def test_step_must_be_a_positive_number(step):
    refused(lambda: HHT(step), "HHT.step", got=repr(step))


@pytest.mark.parametrize("hht_alpha", [0.1, -0.34, -1.0, NAN, INF, "-0.3", None])
def test_hht_alpha_must_lie_between_minus_a_third_and_zero(hht_alpha):
    error = refused(lambda: HHT(0.1, hht_alpha), "HHT.hht_alpha")
    assert str(hht_alpha) in str(error)


def test_limits_of_hht_alpha_are_accepted_and_zero_is_warned_about():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert HHT(0.1, -1 / 3).hht_alpha == -1 / 3
        HHT(0.1, -1e-9)
    with pytest.warns(StabilityWarning, match=r"HHT\.hht_alpha = 0 .*-0\.05") as caught:
        HHT(0.1, 0.0)
    assert caught[0].filename == __file__  # the warning points at the caller's line


@pytest.mark.parametrize("digits", [400, 5000], ids=["no float", "too long to write"])
@pytest.mark.parametrize(
    ("action", "where"),
    [
        (lambda huge: beam(elements=huge), "elements"),
        (lambda huge: beam().with_elements(huge), "elements"),
        (lambda huge: HHT(0.1, max_iterations=huge), "HHT.max_iterations"),
        (lambda huge: DOP853(intervals=huge), "DOP853.intervals"),
        (lambda huge: simulate(scene(), 1.0, HHT(0.1), keep=huge), "keep"),
        (lambda huge: modes(scene(), huge), "count"),
        (lambda huge: Rectangle(huge, 1.0), "Rectangle.height"),
    ],
)
def test_whole_numbers_without_end_are_refused(action, where, digits):
    refused(lambda: action(10**digits), where)


@pytest.mark.parametrize("integrator", [HHT(0.1), HHT(rtol=1e-3), Radau(0.1), Radau(rtol=1e-3)])
@pytest.mark.parametrize("t_end", [1e-320, 5e-324, 1e-300])
def test_a_run_whose_squared_step_is_no_number_is_refused(integrator, t_end):
    refused(lambda: simulate(scene(), t_end, integrator), "t_end", "square", str(t_end))


def test_given_instants_that_are_too_close_are_refused():
    refused(
        lambda: PrescribedSteps([0.0, 1e-200, 1.0]), "PrescribedSteps.times", "square", "1e-200"
    )


@pytest.mark.parametrize("kind", [HHT, Radau])
@pytest.mark.parametrize("value", [2.5, 1e308])
def test_newton_tolerance_must_be_a_part_of_the_motion(kind, value):
    where = f"{kind.__name__}.newton_tolerance"
    refused(lambda: kind(0.1, newton_tolerance=value), where, "at most 0.1", str(value), "1e-14")


def test_the_tolerance_of_a_choice_must_be_a_part_of_what_is_sought():
    sought = Terminal(position(ROD.at_end, 1))
    call = {"objective": sought, "t_end": 1.0, "design": ["rod.height"]}
    refused(lambda: choose_model(scene(), tolerance=1e308, **call), "tolerance", "at most 1")


@pytest.mark.parametrize("value", [0.0, -1e-9, NAN, INF, "1e-9"])
def test_newton_tolerance_must_be_a_positive_number(value):
    refused(lambda: HHT(0.1, newton_tolerance=value), "HHT.newton_tolerance", got=str(value))


@pytest.mark.parametrize("value", [0, -1, 2.5, NAN, "10", True, None])
def test_max_iterations_must_be_a_positive_whole_number(value):
    refused(lambda: HHT(0.1, max_iterations=value), "HHT.max_iterations", got=str(value))


@pytest.mark.parametrize("t_end", [0.0, -1.0, NAN, INF, "1", None, True])
def test_end_time_must_be_a_positive_number(t_end):
    refused(lambda: simulate(scene(), t_end, HHT(0.1)), "t_end", got=repr(t_end))


def test_end_time_must_be_within_countable_steps():
    repair = refused(lambda: simulate(scene(), 1.7e308, HHT(0.1)), "t_end", "within 9e+15").repair
    assert "Use a step above" in repair


def test_round_off_of_the_end_time_is_accepted():
    # 0.1 + 0.2 is 0.30000000000000004: 3 steps to 1e-16.
    assert HHT(0.1).steps.count(0.1 + 0.2) == 3
    assert HHT(1e-3).steps.count(sum([1e-3] * 1000)) == 1000


# ---------------------------------------------------------------- calls


@pytest.mark.parametrize("model", ["scene", None, ROD])
def test_model_must_be_a_scene_or_a_system(model):
    refused(lambda: simulate(model, STEP, HHT(STEP)), "model", "Scene")


@pytest.mark.parametrize("value", [0.1, "HHT", HHT, None])
def test_integrator_must_be_one(value):
    for action in (
        lambda: simulate(scene(), STEP, value),
        lambda: differentiate(scene(), STEP, value, design=["rod.height"]),
    ):
        refused(action, "integrator", "Integrator", repr(value))


@pytest.mark.parametrize("value", ["direct", 0, FiniteDifference])
def test_method_must_be_one(value):
    run, given = (STEP, HHT(STEP)), {"design": ["rod.height"], "method": value}
    refused(lambda: differentiate(scene(), *run, **given), "method", "Method", repr(value))


def test_design_of_a_ready_system_is_refused():
    system = assemble(scene(), ["rod.height"])
    refused(lambda: differentiate(system, STEP, HHT(STEP), design=["rod.width"]), "design")


@pytest.mark.parametrize("value", [0.0, -0.1, 1.0, 2.0, NAN, "0.01"])
def test_relative_step_of_finite_differences_must_lie_between_zero_and_one(value):
    refused(lambda: FiniteDifference(value), "FiniteDifference.relative_step", got=str(value))


def test_relative_perturbation_of_zero_is_refused():
    rubber = beam(material=material(poisson_ratio=0.0))
    run, given = (STEP, HHT(STEP)), {"design": ["rod.poisson_ratio"], "method": FiniteDifference()}
    refused(lambda: differentiate(Scene([rubber]), *run, **given), "rod.poisson_ratio", "zero")


def test_every_error_of_this_package_is_also_a_value_error():
    # So that callers who know nothing of the package catch bad input the usual way.
    with pytest.raises(ValueError, match=r"Rectangle\.height: must be positive; got -1"):
        Rectangle(-1, 1)


@pytest.mark.parametrize("name", ["a.b", "motor.", "m[0]", 3, None])
def test_names_of_joints_and_loads_that_a_target_could_not_have_are_refused(name):
    refused(lambda: Pin(ROD.at_start, name=name), "joint 'pin', name", "must")
    assert Pin(ROD.at(0.5), name="motor 1.5-2").name == "motor 1.5-2"
