"""The groups of cases: what is run, and what the error is measured against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from validation.extremes import crank_cases, damped_cases, joint_cases, pendulum_cases, stall_cases
from validation.extremes.rows import Case

__all__ = ["GROUPS", "Group"]


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
        "modulus",
        "Young's modulus",
        f"Pendulum, 128 steps of 2⁻⁷ s. {_NATURAL} {_STIFF}",
        pendulum_cases.moduli,
    ),
    Group(
        "slenderness",
        "Slenderness h/L",
        f"The same at two moduli. {_NATURAL} A thin stiff rod buckles and whips: a "
        "large step may meet configurations that have no solution near; a smaller step does not.",
        pendulum_cases.slenderness,
    ),
    Group(
        "step",
        "Step",
        "Pendulum, E = 1e7 Pa, 100 steps of each size. Error: what half the step changes of "
        "the arm: truncation, at the large steps.",
        pendulum_cases.step_sizes,
    ),
    Group(
        "first-step",
        "First steps of a stiff damped beam",
        "The paper's pendulum with E = 2e11 Pa and a retardation time of 1e-3 s, from rest. Error: "
        "of the middle and the tip, in lengths, to 256 steps. The estimate of the run itself has "
        "to be a fifth at least of any error above 0.02.",
        damped_cases.first_steps,
    ),
    Group(
        "damped-start",
        "Starts of damped mechanisms",
        "An aluminium cantilever of 1 m (2 cm square, E = 7e10 Pa), loaded suddenly, 50 steps, and "
        "the paper's slider-crank; retardation times as given. Error: of the tip (slider) to "
        "sixteen times the steps, relative to its travel. The slow motion of the cantilever has "
        "103 rad/s: steps of 1 ms and below resolve it, those of 10 ms do not unless damping "
        "slows it down.",
        damped_cases.damped_starts,
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
        stall_cases.stalls,
    ),
    Group(
        "alpha", "Both ends of hht_alpha", f"128 steps of 2⁻⁷ s. {_NATURAL}", pendulum_cases.alphas
    ),
    Group(
        "elements",
        "1 to 10,000 elements",
        "Ten steps of 2⁻⁷ s. Error: difference of the arm to 20 elements, discretisation in space "
        "that is.",
        pendulum_cases.elements,
    ),
    Group(
        "ratio",
        "Mass and stiffness of the crank to those of the rod",
        "Planar crank-slider, crank at 0.5 rad, 128 steps of 2⁻⁸ s. Error: largest difference of "
        "the slider's place, in lengths of the rod, to the same mechanism turned by 1 rad.",
        crank_cases.ratios,
    ),
    Group(
        "dead-centre",
        "Dead centres and stretched configurations",
        "Crank-slider, 256 steps of 2⁻⁸ s; error as before. Then joints that hold nothing, or the "
        "same, where they stand.",
        crank_cases.dead_centres,
    ),
    Group(
        "redundant",
        "Redundant constraints",
        "Refused by name before anything is integrated, unless flexible bodies set them apart.",
        joint_cases.redundant,
    ),
    Group(
        "far",
        "Far from the origin",
        "Pendulum, 64 steps of 2⁻⁷ s. Error: difference of the arm to the run at the origin. "
        "Coordinates of 1e6 m carry round-off of 1e-10 m.",
        pendulum_cases.far,
    ),
    Group(
        "length",
        "Rods of 1e-6 m and 1e4 m",
        "E = 1e7 Pa, from rest, 64 steps; a step that fits the rod and one that does not. "
        f"{_NATURAL}",
        pendulum_cases.lengths,
    ),
)
