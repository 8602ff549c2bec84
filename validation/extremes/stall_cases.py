"""Cases at which Newton's method stalls from the predicted motion."""

from ancfdae import Beam, Clamp, Material, PointForce, Scene, TranslationDriver
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.sections import Rectangle
from validation.extremes.rows import Case, against_sixteenth
from validation.extremes.scenes import Rod


def _shocked(elements: int) -> Scene:
    """Return a rod whose end is thrown at 0.5 m/s while the other is clamped.

    Rigid motions cannot follow, so the start is projected: a shock of a few nodes.
    """
    rod = Beam("rod", (0, 0), (1, 0), elements, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3))
    up = TranslationDriver(rod.at_start, (0, 1), Harmonic(0.1, 5.0), name="up")
    side = TranslationDriver(rod.at_start, (1, 0), ConstantAcceleration(0.0))
    return Scene([rod], [up, side, Clamp(rod.at_end)], (0, -9.81), project_start=True)


def _loaded(force: float) -> Scene:
    """Return a soft cantilever with a force across its end, all at once."""
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.02, 0.02), Material(2700, 1e8, 0.3))
    return Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at_end, (0, force))])


def stalls(quick: bool) -> list[Case]:
    """Take steps at which Newton's method stalls from the predicted motion."""
    chosen = [
        (f"shock, {n} elements, step 2^-{k} s", _shocked(n), 2.0**-k, 2 ** (k - 3))
        for n, k in ((2, 6), (2, 7), (2, 8), (20, 9), (20, 10), (20, 11))
    ]
    chosen += [
        (f"tip force of {F:g} N, step {h:g} s", _loaded(F), h, 20)
        for F in (1.0, 10.0, 100.0)
        for h in (0.05, 0.01, 0.002)
    ]
    chosen += [
        (f"whip, E = {E:.0e} Pa, {spin:g} rad/s, step 2^-{k} s", rod.scene(), 2.0**-k, 2**k)
        for E, spin in ((1e6, 20.0), (1e7, 30.0))
        for rod in [Rod(modulus=E, spin=spin)]
        for k in (5, 6, 7, 8)
    ]
    chosen += [
        (f"pendulum, step {h:g} s", Rod().scene(), h, round(2 / h)) for h in (0.1, 0.05, 0.02)
    ]
    return [
        # The tip of a shocked rod is clamped.
        against_sixteenth(
            label, scene, scene.beams[0].name, step, steps, 0.5 if "shock" in label else 1.0
        )
        for label, scene, step, steps in (chosen[1::8] if quick else chosen)
    ]
