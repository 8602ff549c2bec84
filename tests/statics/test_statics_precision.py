"""Equilibria and their derivatives to the last digit: thin beams, short elements, stalls."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    DirectDifferentiation,
    Material,
    PointForce,
    PointOnLine,
    Revolute,
    RigidBody,
    RotationDriver,
    Scene,
    SpringDamper,
    Weld,
    equilibrium,
    equilibrium_gradient,
    modes,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.extend import FormulaSystem, MaterialPoint, SystemProperties
from ancfdae.laws import ConstantAcceleration, SmoothStep
from ancfdae.observables import position
from ancfdae.results import LinearisationPoint, Verdict
from ancfdae.sections import Rectangle

E, NU, G = 1e9, 0.3, 9.81


pytestmark = pytest.mark.rounding


def thin(slenderness, deflection, elements=4, along=(1.0, 0.0), length=1.0):
    """A cantilever of square section whose tip moves by the given part of its length."""
    h, along = slenderness * length, np.array(along)
    end, across = length * along, np.array([-along[1], along[0]])
    rod = Beam("rod", (0, 0), tuple(end), elements, Rectangle(h, h), Material(1000.0, E, NU))
    force = 3 * deflection * E * h**4 / 12 / length**2
    tip = PointForce(rod.at_end, tuple(force * across), name="tip")
    return Scene([rod], [Clamp(rod.at_start)], loads=[tip]), rod


@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint()])
@pytest.mark.parametrize(
    ("slenderness", "sizes"), [(1e-4, {}), (1e-5, {}), (1e-5, {"along": (0.8, 0.6), "length": 1.2})]
)
def test_the_deflection_of_a_thin_cantilever_grows_as_its_length_cubed(slenderness, sizes, method):
    # v = F L^3 / (3 E I): shear counts (h/L)^2, large rotations (v/L)^2. A round-off of the nodes
    # leaves the axial force eps EA, which is 1e-5 of E I / L^2 here.
    elements = 7 if sizes else 4
    scene, rod = thin(slenderness, 1e-8, elements, **sizes)
    names = ["rod.length", "rod.height", "rod.youngs_modulus"]
    found = equilibrium_gradient(scene, position(rod.at_end, 1), design=names, method=method)
    x, y = sizes.get("along", (1.0, 0.0))
    length = sizes.get("length", 1.0)
    across = 1e-8 * length * x
    assert found.value == pytest.approx(y * length + across, rel=1e-14)
    # Along the beam a length moves the tip by itself.
    slope = (found.gradient * [length, slenderness * length, E] - [y * length, 0, 0]) / across
    # Round-off of the tip of an inclined beam, 1e-16 of 1e8 deflections, among others.
    np.testing.assert_allclose(slope, [3, -3, -1], rtol=1e-6)


@pytest.mark.parametrize("elements", [4, 500])
def test_halves_welded_of_very_short_elements_bend_as_timoshenko_says(elements):
    # Elements of a fiftieth of their height, and loads that their round-off almost hides.
    h, force = 0.05, 1e-3
    section, steel = Rectangle(h, h), Material(1000.0, E, NU)
    near = Beam("near", (0, 0), (0.5, 0), elements, section, steel)
    far = Beam("far", (0.5, 0), (1, 0), elements, section, steel)
    tip = PointForce(far.at_end, (0, force))
    scene = Scene([near, far], [Clamp(near.at_start), Weld(near.at_end, far.at_start)], loads=[tip])
    found = equilibrium(scene)
    assert found.outcome.success
    shear_factor = 10 * (1 + NU) / (12 + 11 * NU)
    exact = 1 + h**2 / 4 * 2 * (1 + NU) / shear_factor
    moved = found.solution.position(far.at_end)[0, 1] / (force / (3 * E * h**4 / 12))
    # Round-off of strains, 1e-16, over those of the load, 1e-6 at the clamp.
    assert moved == pytest.approx(exact, rel=1e-10)


class Jump(FormulaSystem):
    """A spring whose force jumps where it would vanish: there is no equilibrium."""

    n_q, n_lam, design_names = 1, 0, ()
    traits = SystemProperties(constant_mass=True, linear_constraints=True, velocity_forces=False)

    def with_values(self, b):
        return Jump(b)

    def start(self):
        return np.array([2.0]), np.zeros(1)

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return 1.0 - q + np.where(q.real < 1.0, 1e-8, -1e-8)

    def position_constraint(self, t, q):
        return np.zeros(0)


@pytest.mark.filterwarnings("ignore::ancfdae.errors.NotTracedWarning")
def test_an_iteration_that_stalls_is_no_equilibrium():
    # Corrections of 2e-8 to and fro, that leave 1e-8 of the spring's force.
    found = equilibrium(Jump(()))
    assert not found.outcome.success
    assert found.outcome.verdict is Verdict.NO_CONVERGENCE


def test_the_last_correction_of_an_equilibrium_is_round_off_and_told():
    scene, _ = thin(1e-2, 0.1)
    found = equilibrium(scene)
    assert found.outcome.success
    # Coordinates round to eps; K^-1 magnifies what that leaves by (L/h)^2 at most, 1e4.
    assert 0 < found.outcome.residual < 1e4 * np.finfo(float).eps


def blade(law):
    """A blade on a hub that turns about z, in space."""
    steel = Material(1000.0, 1e9, 0.0)
    rod = Beam("blade", (0, 0, 0), (1, 0, 0), 2, Rectangle(0.02, 0.02), steel)
    return Scene([rod], [Revolute(rod.at_start, axis=(0, 0, 1)), RotationDriver(rod.at_start, law)])


def test_what_a_joint_drives_is_not_at_rest():
    with pytest.raises(InvalidInputError, match=r"drive\(blade@0\).*steady rotation"):
        equilibrium(blade(ConstantAcceleration(3.0)))
    with pytest.raises(InvalidInputError, match="steady rotation"):
        equilibrium_gradient(
            blade(ConstantAcceleration(3.0)),
            position(MaterialPoint("blade", 1), 0),
            design=["blade.length"],
        )
    # An angle that stays, and one that only starts to move.
    for law in (ConstantAcceleration(0.0), ConstantAcceleration(0.0, 0.0, 5.0)):
        assert equilibrium(blade(law)).outcome.success


def test_a_turning_blade_has_no_modes_at_rest():
    # Lead-lag of a blade at Omega: modes of its instant lack -Omega^2 M and Coriolis forces.
    scene = blade(SmoothStep(0.0, 1.0, 0.1))
    run = simulate(scene, 0.05, HHT(0.01))
    with pytest.raises(InvalidInputError, match=r"state at rest.*centrifugal"):
        modes(scene, at=LinearisationPoint.of(run))


def test_a_force_without_balance_is_told_down_to_round_off():
    scene, _ = thin(1e-2, 0.1)
    found = equilibrium(scene)
    for part in (0.0, 1e-3):
        at = LinearisationPoint(found.q, (1 + part) * found.lam)
        # Reactions exceed what they balance by a thousandth, of both together half of that.
        told = modes(scene, 1, at=at).unbalanced
        assert told == (0.0 if part == 0.0 else pytest.approx(part / 2, rel=0.5))


def test_a_column_is_unstable_just_above_the_load_of_euler():
    h = 0.002
    rod = Beam("rod", (0, 0), (1, 0), 16, Rectangle(h, h), Material(1000.0, E, 0.0))
    critical = np.pi**2 / 4 * E * h**4 / 12
    # Shear and shortening change the load of Euler by (pi h)^2, the mesh by 1e-6. The softest
    # motion meets -2e-3 (h/L)^2 of the diagonal and less: clear of round-off, 5e-16.
    for share, stable in ((0.998, True), (1.002, False)):
        push = PointForce(rod.at_end, (-share * critical, 0))
        found = equilibrium(Scene([rod], [Clamp(rod.at_start)], loads=[push]))
        assert (found.outcome.stable_to is None) is stable


@pytest.mark.parametrize("origin", [0.0, 1e-9, 1.0, 1e3])
@pytest.mark.parametrize("stiffness", [1.0, 1e3, 1e7])
def test_a_mass_on_a_spring_hangs_wherever_it_stands(origin, stiffness):
    # At the origin coordinates are as small as the sag, and only the spring knows where it hangs.
    for mass, long in ((1e-3, 1.0), (1.0, 1.0), (1e3, 1.0), (1.0, 1e4)):
        box = RigidBody("box", (origin, origin), mass=mass, inertia=0.1 * mass)
        above = (origin, origin + long)
        spring = SpringDamper(box.origin, stiffness, free_length=long, ground=above)
        rail = [
            PointOnLine(box.at(0.0, y), (0.0, 1.0), through=(origin, origin)) for y in (0.0, 1.0)
        ]
        scene = Scene(bodies=[box], joints=rail, gravity=(0.0, -G), loads=[spring])
        found = equilibrium(scene)
        assert found.outcome.success
        sag = mass * G / stiffness
        # Places carry eps of themselves, and lengths of the spring as much.
        noise = 8 * np.finfo(float).eps * (long + origin + sag)
        assert found.q[1] == pytest.approx(origin - sag, abs=noise)
