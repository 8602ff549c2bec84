"""The cases of the report `extremes`, in groups; each row of a table is one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    Distance,
    Guide,
    Harmonic,
    Material,
    Pin,
    Point,
    PointForce,
    PointOnLine,
    Rectangle,
    Revolute,
    Scene,
    Solution,
    Uniform,
    simulate,
)
from validation.extremes_rows import Case
from validation.extremes_scenes import Crank, Rod
from validation.scenes import crank_slider, pendulum

__all__ = ["GROUPS", "Group"]

_STEP = 2.0**-7


@dataclass(frozen=True)
class Group:
    """Cases of one kind.

    Parameters
    ----------
    name : str
        Of the figures.
    title : str
    text : str
        What is run and what the error is measured against.
    cases : callable
        ``cases(quick)`` returns them.
    """

    name: str
    title: str
    text: str
    cases: Callable[[bool], Sequence[Case]]


def _against_natural(rod: Rod, step: float, steps: int, alpha: float = -0.3) -> Case:
    """Case of a rod whose error is the difference to the run in natural units."""

    def error(run: Solution) -> float:
        units = rod.natural()
        h = step * units.time
        other = simulate(rod.scene(units), h * steps, HHT(h, hht_alpha=alpha))
        if not other.outcome.success:
            return np.inf
        return float(np.max(np.abs(rod.arm(run) - rod.arm(other, units))))

    return Case("", rod.scene, step, steps, alpha, error)


def _named(label: str, case: Case) -> Case:
    return Case(label, case.make, case.step, case.steps, case.alpha, case.error)


def _against_half_step(label: str, rod: Rod, step: float, steps: int) -> Case:
    def error(run: Solution) -> float:
        fine = simulate(rod.scene(), step * steps, HHT(step / 2))
        if not fine.outcome.success:
            return np.inf
        return float(np.max(np.abs(rod.arm(run) - rod.arm(fine)[::2])))

    return Case(label, rod.scene, step, steps, error=error)


def _moduli(quick: bool) -> list[Case]:
    exponents = (3, 7, 13) if quick else (*range(3, 14), 16)
    steps = 16 if quick else 128
    return [
        _named(f"E = 1e{k} Pa", _against_natural(Rod(modulus=10.0**k), _STEP, steps))
        for k in exponents
    ]


def _slenderness(quick: bool) -> list[Case]:
    steps = 16 if quick else 128
    cases = []
    for ratio in (0.2, 1e-4) if quick else (0.2, 0.1, 0.03, 1e-2, 1e-3, 1e-4):
        for E in (1e7, 2e11):
            rod = Rod(modulus=E, slenderness=ratio)
            label = f"h/L = {ratio:g}, E = {E:.0e} Pa"
            cases.append(_named(label, _against_natural(rod, _STEP, steps)))
    if not quick:
        thin = Rod(modulus=2e11, slenderness=1e-4)
        label = "the last with the step 2^-11 s"
        cases.append(_named(label, _against_natural(thin, 2.0**-11, 1024)))
    return cases


def _steps(quick: bool) -> list[Case]:
    exponents = (1, 4, 8) if quick else range(1, 9)
    return [
        _against_half_step(f"step 1e-{k} s", Rod(), 10.0**-k, 10 if quick else 100)
        for k in exponents
    ]


def _damped_cantilever(elements: int, time: float, gravity: bool) -> Scene:
    section, material = Rectangle(0.02, 0.02), Material(2700, 7e10, 0.0, time)
    rod = Beam("rod", (0, 0), (1, 0), elements, section, material)
    loads = [] if gravity else [PointForce(rod.at_end, (0, 1.0))]
    return Scene([rod], [Clamp(rod.at_start)], (0, -9.81) if gravity else None, loads=loads)


def _damped_crank(time: float) -> Scene:
    scene = crank_slider()
    return scene.with_values({f"{beam.name}.damping_time": time for beam in scene.beams})


def _against_sixteenth(
    label: str, scene: Scene, beam: str, step: float, steps: int, at: float = 1.0
) -> Case:
    """Case whose error is that of a point, relative to its travel, to sixteen times the steps."""

    def error(run: Solution) -> float:
        fine = simulate(scene, step * steps, HHT(step / 16))
        if not fine.outcome.success:
            return np.inf
        place, exact = (x.position(Point(beam, at)) for x in (run, fine))
        return float(np.max(np.abs(place - exact[::16])) / np.max(np.abs(exact - exact[0])))

    return Case(label, lambda: scene, step, steps, error=error)


def _damped_starts(quick: bool) -> list[Case]:
    """Start damped mechanisms at steps that are long against the decay of their fast modes."""
    times = (1e-5, 1.0) if quick else (1e-5, 1e-4, 1e-3, 1e-2, 1.0)
    cases = []
    for elements in (2,) if quick else (2, 8):
        for time in times:
            for step in (1e-3,) if quick else (1e-2, 1e-3, 1e-4, 1e-5):
                label = f"{elements} elements, {time:g} s, step {step:g} s"
                scene = _damped_cantilever(elements, time, False)
                cases.append(_against_sixteenth(f"tip force, {label}", scene, "rod", step, 50))
                if step == 1e-3:
                    scene = _damped_cantilever(elements, time, True)
                    cases.append(_against_sixteenth(f"gravity, {label}", scene, "rod", step, 50))
    for time in times[:-1]:
        label = f"slider-crank, {time:g} s, step 2^-7 s"
        cases.append(
            _against_sixteenth(label, _damped_crank(time), "rod", 2.0**-7, 8 if quick else 32)
        )
    return cases


def _shocked(elements: int) -> Scene:
    """Return a rod whose end is thrown at 0.5 m/s while the other is clamped.

    Rigid motions cannot follow, so the start is projected: a shock of a few nodes.
    """
    rod = Beam("rod", (0, 0), (1, 0), elements, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3))
    up = Guide(rod.at_start, (0, 1), Harmonic(0.1, 5.0), name="up")
    side = Guide(rod.at_start, (1, 0), Uniform(0.0))
    return Scene([rod], [up, side, Clamp(rod.at_end)], (0, -9.81), project_start=True)


def _loaded(force: float) -> Scene:
    """Return a soft cantilever with a force across its end, all at once."""
    rod = Beam("rod", (0, 0), (1, 0), 8, Rectangle(0.02, 0.02), Material(2700, 1e8, 0.3))
    return Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at_end, (0, force))])


def _stalls(quick: bool) -> list[Case]:
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
        _against_sixteenth(
            label, scene, scene.beams[0].name, step, steps, 0.5 if "shock" in label else 1.0
        )
        for label, scene, step, steps in (chosen[1::8] if quick else chosen)
    ]


def _first_steps(quick: bool) -> list[Case]:
    """Release a stiff damped beam, whose short waves the first step has to catch."""
    scene = pendulum(youngs_modulus=2e11, damping_time=1e-3)

    def error(run: Solution) -> float:
        t_end = float(run.t[-1])
        fine = simulate(scene, t_end, HHT(t_end / 256, hht_alpha=-0.05))
        if not fine.outcome.success:
            return np.inf
        apart = [
            run.position(Point("pendulum", s)) - fine.position(Point("pendulum", s))[-1]
            for s in (0.5, 1)
        ]
        return float(max(np.max(np.abs(x[-1])) for x in apart)) / 1.2

    chosen = [(7, 1, -0.1), (8, 1, -0.3), (9, 1, -0.3)]
    if not quick:
        chosen += [(6, 1, -0.1), (7, 1, -0.05), (7, 4, -0.1), (8, 4, -0.05), (9, 4, -0.3)]
    return [
        Case(
            f"{steps} step{'s' * (steps > 1)} of 2^-{k} s, hht_alpha = {alpha}",
            lambda: scene,
            2.0**-k,
            steps,
            alpha,
            error,
            in_time=True,
        )
        for k, steps, alpha in sorted(chosen)
    ]


def _alphas(quick: bool) -> list[Case]:
    steps = 16 if quick else 128
    rod = Rod()
    cases = [
        _named(f"hht_alpha = {name}", _against_natural(rod, _STEP, steps, alpha))
        for name, alpha in (("-1/3", -1 / 3), ("-1e-6", -1e-6), ("0", 0.0))
    ]
    refused = [Case(f"hht_alpha = {a}", rod.scene, _STEP, steps, a) for a in (-0.34, 1e-3)]
    return cases + refused


def _elements(quick: bool) -> list[Case]:
    steps, reference = 10, Rod(elements=20)

    def error(run: Solution) -> float:
        other = simulate(reference.scene(), _STEP * steps, HHT(_STEP))
        return float(np.max(np.abs(reference.arm(run) - reference.arm(other))))

    counts = (1, 100) if quick else (1, 10, 100, 1000, 10000)
    return [
        Case(
            f"{n} element{'s' if n > 1 else ''}",
            Rod(elements=n).scene,
            _STEP,
            steps,
            error=error,
        )
        for n in counts
    ]


def _ratios(quick: bool) -> list[Case]:
    exponents = (-6, 6) if quick else (-6, -4, -2, 0, 2, 4, 6)
    steps = 16 if quick else 128
    return [
        _crank(f"{what} 1e{k}", Crank(angle=0.5, **{f"{key}_ratio": 10.0**k}), steps)  # type: ignore[arg-type]  # numbers
        for what, key in (("mass", "mass"), ("stiffness", "stiffness"))
        for k in exponents
    ]


def _crank(label: str, crank: Crank, steps: int, step: float = 2.0**-8) -> Case:
    """Case of a crank-slider whose error is the difference to the mechanism turned by 1 rad."""

    def error(run: Solution) -> float:
        turned = crank.with_turn(crank.turned + 1.0)
        other = simulate(turned.scene(), step * steps, HHT(step))
        if not other.outcome.success:
            return np.inf
        return float(np.max(np.abs(crank.reach(run) - turned.reach(other))) / crank.rod)

    return Case(label, crank.scene, step, steps, error=error)


def _dead_centres(quick: bool) -> list[Case]:
    steps, spun = 16 if quick else 256, Crank(spin=10.0)
    return [
        _crank("stretched out, at rest", Crank(), steps),
        _crank("stretched out, crank turning at 10 rad/s, step 2^-9 s", spun, steps, 2.0**-9),
        _crank("the same turned by 1 rad, step 2^-8 s", spun.with_turn(1.0), steps),
        _crank("folded, at rest", Crank(angle=np.pi), steps),
        _crank(
            "crank as long as rod, folded: slider in the bearing", Crank(rod=0.9, angle=3.1), steps
        ),
        Case("rod on a line and a link, in one line: no second direction", _dead_link, _STEP, 16),
        Case("distance joint of length zero", _no_length, _STEP, 16),
        Case("distance joint shorter than the gap", _short_link, _STEP, 16),
    ]


def _redundant(quick: bool) -> list[Case]:
    return [
        Case("pin twice at one point", _two_pins, _STEP, 16),
        Case("clamp and pin at one point", _clamped_pin, _STEP, 16),
        Case("clamped at both ends", _two_clamps, _STEP, 16),
        Case("spatial four-bar of four revolutes", _four_bar, _STEP, 16),
        Case("the same, one revolute a spherical joint", _free_four_bar, _STEP, 16),
    ]


def _far(quick: bool) -> list[Case]:
    steps, near = 16 if quick else 64, Rod()

    def error(run: Solution) -> float:
        other = simulate(near.scene(), _STEP * steps, HHT(_STEP))
        return float(np.max(np.abs(near.arm(run) - near.arm(other))))

    distances = (1e6,) if quick else (1.0, 1e3, 1e6, 1e9, 1e12)
    return [
        Case(f"{at:g} m from the origin", Rod(at=at).scene, _STEP, steps, error=error)
        for at in distances
    ]


def _lengths(quick: bool) -> list[Case]:
    steps, cases = 16 if quick else 64, []
    for length in (1e-6, 1e4):
        rod = Rod(length=length, spin=0.0)
        fitting = _STEP * np.sqrt(length)
        label = f"L = {length:g} m, step {fitting:.1e} s"
        cases.append(_named(label, _against_natural(rod, fitting, steps)))
        label = f"L = {length:g} m, step {_STEP:.1e} s"
        cases.append(_named(label, _against_natural(rod, _STEP, steps)))
    return cases


_SECTION, _SOFT = Rectangle(0.05, 0.05), Material(2770.0, 1e8, 0.3)


def _bar(
    name: str = "bar", end: tuple[float, ...] = (1.0, 0.0), **where: tuple[float, ...]
) -> Beam:
    start = where.get("start", (0.0,) * len(end))
    return Beam(name, start, end, 2, _SECTION, _SOFT)


def _dead_link() -> Scene:
    bar = _bar()
    joints = [
        Pin(bar.at_start),
        PointOnLine(bar.at_end, (0, 1), name="line"),
        Distance(bar.at_end, 0.5, ground=(1.5, 0.0), name="link"),
    ]
    return Scene([bar], joints, (0, -9.81))


def _no_length() -> Scene:
    bar = _bar()
    return Scene([bar], [Distance(bar.at_end, 1e-9, ground=(1.0, 0.0))], project_start=True)


def _short_link() -> Scene:
    bar = _bar()
    joints = [Pin(bar.at_start), Distance(bar.at_end, 0.4, ground=(1.5, 0.0), name="link")]
    return Scene([bar], joints, (0, -9.81))


def _two_pins() -> Scene:
    bar = _bar()
    return Scene([bar], [Pin(bar.at_start, name="first"), Pin(bar.at_start, name="second")])


def _clamped_pin() -> Scene:
    bar = _bar()
    return Scene([bar], [Clamp(bar.at_start, name="clamp"), Pin(bar.at_start, name="pin")])


def _two_clamps() -> Scene:
    bar = _bar()
    return Scene([bar], [Clamp(bar.at_start), Clamp(bar.at_end)], (0, -9.81))


def _four_bar(last: type[Pin] | None = None) -> Scene:
    corners = [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0)]
    a, b, c = (_bar(n, corners[i + 1], start=corners[i]) for i, n in enumerate("abc"))
    axis = (0, 0, 1)
    joints = [
        Revolute(a.at_start, axis, name="A"),
        Revolute(a.at_end, axis, b.at_start, name="B"),
        Revolute(b.at_end, axis, c.at_start, name="C"),
        Pin(c.at_end, name="D") if last else Revolute(c.at_end, axis, name="D"),
    ]
    return Scene([a, b, c], joints, (0, -9.81, 0))


def _free_four_bar() -> Scene:
    return _four_bar(Pin)


_NATURAL = (
    "Error: largest difference of the arm from pin to tip, in lengths of the rod, to the same "
    "scene in units in which length, density and Young's modulus are 1."
)

_STIFF = (
    "From 1e11 Pa on the round-off of the elastic forces leaves less than seven digits of the "
    "motion, and such steps are counted; at 1e16 Pa Newton's method ends at it."
)

GROUPS: tuple[Group, ...] = (
    Group(
        "modulus", "Young's modulus", f"Pendulum, 128 steps of 2⁻⁷ s. {_NATURAL} {_STIFF}", _moduli
    ),
    Group(
        "slenderness",
        "Slenderness h/L",
        f"The same at two moduli. {_NATURAL} A thin stiff rod buckles and whips: a "
        "large step may meet configurations that have no solution near; a smaller step does not.",
        _slenderness,
    ),
    Group(
        "step",
        "Step",
        "Pendulum, E = 1e7 Pa, 100 steps of each size. Error: what half the step changes of "
        "the arm: truncation, at the large steps.",
        _steps,
    ),
    Group(
        "first-step",
        "First steps of a stiff damped beam",
        "The paper's pendulum with E = 2e11 Pa and a retardation time of 1e-3 s, from rest. Error: "
        "of the middle and the tip, in lengths, to 256 steps. The estimate of the run itself has "
        "to be a fifth at least of any error above 0.02.",
        _first_steps,
    ),
    Group(
        "damped-start",
        "Starts of damped mechanisms",
        "An aluminium cantilever of 1 m (2 cm square, E = 7e10 Pa), loaded suddenly, 50 steps, and "
        "the paper's slider-crank; retardation times as given. Error: of the tip (slider) to "
        "sixteen times the steps, relative to its travel. The slow motion of the cantilever has "
        "103 rad/s: steps of 1 ms and below resolve it, those of 10 ms do not unless damping "
        "slows it down.",
        _damped_starts,
    ),
    Group(
        "stall",
        "Shocks, sudden loads, whips and large steps",
        "Steps at which Newton's method stalls from the predicted motion. Shock: one end of a rod "
        "of 1 m (5 cm square, E = 1e7 Pa), clamped at the other, is thrown at 0.5 m/s; twenty "
        "elements are as long as high. Force: across the end of a cantilever of 1 m (2 cm square, "
        "E = 1e8 Pa), at once. "
        "Whip: the pendulum turns fast. Error: of the tip, of a shocked rod of its middle, to "
        "sixteen times the steps, relative to its travel: that the equations are solved does not "
        "make a step small enough. Where they are not, the outcome names the step up to which "
        "they have a solution that belongs to the motion.",
        _stalls,
    ),
    Group("alpha", "Both ends of hht_alpha", f"128 steps of 2⁻⁷ s. {_NATURAL}", _alphas),
    Group(
        "elements",
        "1 to 10,000 elements",
        "Ten steps of 2⁻⁷ s. Error: difference of the arm to 20 elements, discretisation in space "
        "that is.",
        _elements,
    ),
    Group(
        "ratio",
        "Mass and stiffness of the crank to those of the rod",
        "Planar crank-slider, crank at 0.5 rad, 128 steps of 2⁻⁸ s. Error: largest difference of "
        "the slider's place, in lengths of the rod, to the same mechanism turned by 1 rad.",
        _ratios,
    ),
    Group(
        "dead-centre",
        "Dead centres and stretched configurations",
        "Crank-slider, 256 steps of 2⁻⁸ s; error as before. Then joints that hold nothing, or the "
        "same, where they stand.",
        _dead_centres,
    ),
    Group(
        "redundant",
        "Redundant constraints",
        "Refused by name before anything is integrated, unless flexible bodies set them apart.",
        _redundant,
    ),
    Group(
        "far",
        "Far from the origin",
        "Pendulum, 64 steps of 2⁻⁷ s. Error: difference of the arm to the run at the origin. "
        "Coordinates of 1e6 m carry round-off of 1e-10 m.",
        _far,
    ),
    Group(
        "length",
        "Rods of 1e-6 m and 1e4 m",
        "E = 1e7 Pa, from rest, 64 steps; a step that fits the rod and one that does not. "
        f"{_NATURAL}",
        _lengths,
    ),
)
