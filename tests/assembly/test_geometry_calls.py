"""Geometry targets in every call that takes a design, against differences of that very call."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    Beam,
    ContinuousAdjoint,
    CurvedBeam,
    DesignVariable,
    DirectDifferentiation,
    EquilibriumStart,
    Evaluator,
    Integral,
    Material,
    NodalState,
    Pin,
    PointOnLine,
    RotationDriver,
    Scene,
    Terminal,
    assemble,
    equilibrium,
    equilibrium_gradient,
    error_bars,
    estimate_adjoint_error,
    gradient,
    modes,
    sweep,
    taylor_test,
    work_precision,
)
from ancfdae.errors import InconsistentStartError
from ancfdae.laws import ConstantAcceleration
from ancfdae.model.elements import BEAM_2D, CABLE_2D
from ancfdae.observables import position
from ancfdae.sections import Rectangle

STRIP, SOFT = Rectangle(0.04, 0.03), Material(2000.0, 1e8, 0.3)
DESIGN = ["crank.length", "bearing.ground_y", "slot.through_y", "elbow.other_fraction"]
STEP, END = 2.0**-9, 2.0**-7


def linkage(crank=None, start=(), rate=3.0, element=BEAM_2D):
    """A driven loop in the plane, not closed as declared."""
    crank = crank or Beam("crank", (0.0, 0.0), (0.3, 0.4), 1, STRIP, SOFT, element=element)
    rod = Beam("rod", (0.25, 0.45), (1.2, -0.1), 2, STRIP, SOFT, element=element)
    joints = [
        Pin(crank.at_start, ground=(0.0, 0.0), name="bearing"),
        RotationDriver(crank.at_start, ConstantAcceleration(rate), name="motor"),
        Pin(crank.at_end, rod.at(0.1), name="elbow"),
        PointOnLine(rod.at_end, (1.0, 0.1), (0.0, -0.1), name="slot"),
    ]
    return Scene([crank, rod], joints, (0.0, -9.81), start, assemble=True)


SCENE = linkage()
TIP = position(SCENE.beams[1].at(0.7), 0) + 2 * position(SCENE.beams[1].at(0.7), 1)


def slopes(call, scene=SCENE, design=DESIGN, h=1e-3):
    """Central differences of fourth order of a call at other values, one column a target."""
    columns = []
    for target in design:
        held = scene.value(DesignVariable("x", [target]))
        at = [call(scene.with_values({target: held + k * h})) for k in (-2, -1, 1, 2)]
        columns.append((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h))
    return np.stack(columns, axis=-1)


def value_of(observable, end, integrator):
    """Return the call for the value at the end."""
    own = Evaluator(Terminal(observable), end, integrator)
    return lambda scene: own(scene)["value"]


def agree(found, expected, rtol=1e-7):
    """Compare derivatives with those of the largest."""
    size = np.max(np.abs(expected))
    np.testing.assert_array_less(np.abs(found - expected) / size, rtol)


# (1e-3)^4 of the next derivatives, and round-off of 1e-12 over 1e-3.


def test_frequencies():
    expected = slopes(lambda scene: modes(scene, 3).frequencies)
    for method in (DirectDifferentiation(), Adjoint()):
        agree(modes(SCENE, 3, design=DESIGN, method=method).frequencies_b, expected)


def test_an_equilibrium():
    scene = linkage(rate=0.0)
    found = equilibrium(scene, design=DESIGN)
    agree(found.q_b, slopes(lambda scene: equilibrium(scene).q, scene))
    expected = slopes(lambda s: equilibrium_gradient(s, TIP, design=DESIGN[:1]).value, scene)
    for method in (DirectDifferentiation(), Adjoint()):
        agree(equilibrium_gradient(scene, TIP, design=DESIGN, method=method).gradient, expected)


def test_a_motion_from_rest():
    scene = linkage(start=[EquilibriumStart()], rate=0.0)
    run = (Terminal(TIP), END, HHT(STEP))
    found = gradient(scene, *run, design=DESIGN, method=Adjoint()).gradient
    agree(found, slopes(lambda s: gradient(s, *run, design=DESIGN[:1]).value, scene))


def test_error_bars_and_estimates_of_errors():
    run = (Terminal(TIP), END, HHT(STEP))
    found = error_bars(SCENE, *run, design=DESIGN)

    def value(scene):
        finer = error_bars(scene, *run, design=DESIGN[:1])
        return np.array([finer.value, finer.extrapolated_value])

    agree(np.stack([found.gradient, found.extrapolated_gradient]), slopes(value))
    coarse = gradient(SCENE, *run, design=DESIGN).gradient
    agree(coarse, slopes(lambda scene: estimate_adjoint_error(scene, *run).value))


def test_the_taylor_test_sees_order_two():
    # Along lengths alone; remainders of second order are far above round-off at 1e-3.
    own = taylor_test(SCENE, Terminal(TIP), END, HHT(STEP), design=DESIGN[:1])
    assert own.order == pytest.approx(2.0, abs=0.05)


def test_a_sweep_and_a_tradeoff():
    own = Evaluator(Terminal(TIP), END, HHT(STEP), gradient=True, design=DESIGN)
    shifts = np.array([-2e-3, -1e-3, 0.0, 1e-3, 2e-3])
    rows = sweep(SCENE, [{"crank.length": 0.5 + x} for x in shifts], own)
    values = np.array([row.result["value"] for row in rows.rows])
    slope = (values[0] - 8 * values[1] + 8 * values[3] - values[4]) / 12e-3
    assert rows.rows[2].result["gradient"][0] == pytest.approx(slope, rel=1e-7)
    settings = [HHT(STEP), HHT(STEP / 2)]
    found = work_precision(
        SCENE, Terminal(TIP), END, settings, design=DESIGN, reference=HHT(STEP / 8)
    )
    errors = [own.gradient for own in found.rows]
    assert errors[0] > 1.5 * errors[1] > 0


@pytest.mark.parametrize("integrator", [IDA(1e-9), DOP853(1e-9)], ids=["IDA", "DOP853"])
def test_integrators_of_high_order(integrator):
    design, end = DESIGN[:1], 2.0**-12
    run = (Terminal(TIP), end, integrator)
    found = gradient(SCENE, *run, design=design).gradient
    expected = slopes(value_of(TIP, end, integrator), design=design, h=4e-3)
    # Their tolerance over h.
    agree(found, expected, 1e-6)


def test_the_continuous_adjoint_tends_to_the_derivative():
    goal = Integral(TIP)
    errors = []
    for step in (STEP, STEP / 2):
        run = (SCENE, goal, END, HHT(step))
        exact = gradient(*run, design=DESIGN, method=DirectDifferentiation()).gradient
        own = gradient(*run, design=DESIGN, method=ContinuousAdjoint()).gradient
        errors.append(np.max(np.abs(own - exact)) / np.max(np.abs(exact)))
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] > 1.8


def bent():
    """A crank that is an arc."""
    angles = np.array([0.3, 0.1, -0.2]) + 0.5 * np.pi
    frames = np.array([[[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]] for a in angles])
    places = np.array([[0.0, 0.0], [-0.05, 0.25], [-0.03, 0.52]])
    return linkage(CurvedBeam("crank", places, frames, STRIP, SOFT))


def ropes():
    """Elements without a section."""
    return linkage(element=CABLE_2D)


def deformed():
    """A crank whose nodes are given: stretched, and moving."""
    crank = Beam("crank", (0.0, 0.0), (0.3, 0.4), 1, STRIP, SOFT)
    nodes = np.array(
        [[[0.0, 0.0], [0.6, 0.8], [-0.8, 0.6]], [[0.306, 0.408], [0.6, 0.8], [-0.8, 0.6]]]
    )
    rates = np.zeros_like(nodes)
    rates[1, 0] = 0.2, -0.1
    return linkage(crank, [NodalState("crank", nodes, rates)])


@pytest.mark.parametrize("scene", [bent(), ropes(), deformed()], ids=["arc", "cable", "nodes"])
def test_other_bodies_in_a_loop(scene):
    tip = position(scene.beams[1].at(0.7), 1)
    design = DESIGN[1:] if any(isinstance(s, NodalState) for s in scene.start) else DESIGN
    # A crank that starts stretched by 2 % springs back so fast that a step of STEP ends at the root
    # half a turn off, which is refused.
    integrator = HHT(STEP / 8 if scene.start else STEP)
    run = (Terminal(tip), END, integrator)
    expected = slopes(value_of(tip, END, integrator), scene, design)
    for method in (DirectDifferentiation(), Adjoint()):
        found = gradient(scene, *run, design=design, method=method).gradient
        agree(found, expected)


# ---------------------------------------------------------------- drives that point away


@pytest.mark.parametrize("other", [False, True], ids=["ground", "section"])
def test_a_drive_half_a_turn_off_is_refused(other):
    crank = Beam("crank", (0.0, 0.0), (1.0, 0.0), 1, STRIP, SOFT)
    rod = Beam("rod", (1.0, 0.0), (1.5, 0.0), 1, STRIP, SOFT)
    joints = [
        Pin(crank.at_start, ground=(0.0, 0.0)),
        Pin(crank.at_end, rod.at_start),
        RotationDriver(crank.at_start, ConstantAcceleration(1.0), name="still"),
    ]

    def scene(offset, **more):
        end = {"other": crank.at_end} if other else {}
        motor = RotationDriver(rod.at_start, ConstantAcceleration(2.0, offset), name="motor", **end)
        return Scene([crank, rod], [*joints, motor], **more)

    assemble(scene(0.0)).start()
    for offset in (np.pi, -np.pi):
        with pytest.raises(InconsistentStartError, match=r"motor.*angle of the law"):
            assemble(scene(offset)).start()
    # Where bodies may move they turn the right way, from where the equation tells none too.
    for angle in (0.5 * np.pi, 2.5):
        q = assemble(scene(angle, assemble=True)).start()[0]
        end = [1.0 + 0.5 * np.cos(angle), 0.5 * np.sin(angle)]
        np.testing.assert_allclose(q[-6:-4], end, atol=1e-12)
