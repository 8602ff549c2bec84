"""Part (E) of the report on events: a flexible rod that hits a stop."""

from __future__ import annotations

from typing import Any

import numpy as np

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    ComplexStep,
    DirectDifferentiation,
    Impact,
    Material,
    Pin,
    PointMass,
    Scene,
    Terminal,
    assemble,
    gradients,
    simulate,
)
from ancfdae.observables import angular_momentum, kinetic_energy, multiplier, position, velocity
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.observables.observable import States
from validation.report import Agreement, Report

__all__ = ["fill"]

_DESIGN = ["rod.youngs_modulus", "rod.height", "rod.density"]
_SCALE = np.array([2e8, 0.03, 1000.0])
_ORDER = 1.7


def fill(report: Report, quick: bool) -> None:
    """Add the tables and claims."""
    report.heading("E. A flexible rod on a stop")
    report.text(
        "A rod of 1 m, 3 cm square, E = 2e8 Pa, three elements of ANCF, pinned at one end and with "
        "1 kg at its tip, falls on a stop 0.3 m below with restitution 0.5. Position, velocity and "
        "force in the hinge at 0.28 s, and their derivatives in Young's modulus, height and "
        "density, at steps of HHT-I3 that are halved: orders are logarithms of ratios of changes."
    )
    rod, scene, stop = _rod()
    _balance(report, rod, scene, stop)
    objectives = [
        Terminal(position(rod.at_end, 1)),
        Terminal(velocity(rod.at_end, 0)),
        Terminal(multiplier("hinge", 1)),
    ]
    steps = [1e-3 / 2**k for k in range(3)] if quick else [4e-4 / 2**k for k in range(4)]
    values: list[Any] = []
    for step in steps:
        found = gradients(scene, objectives, 0.28, HHT(step=step), design=_DESIGN, events=[stop])
        values.append([[x.value, *(x.gradient * _SCALE)] for x in found])
    changes = [np.max(np.abs(np.diff(np.array(values), axis=0)[..., k]), axis=2) for k in _PARTS]
    rows, least = [], np.inf
    for what, each in zip(("value", "derivatives"), changes, strict=True):
        orders = np.log2(each[-2] / each[-1])
        least = min(least, float(np.min(orders)))
        rows.append([what, *(f"{x:.2f}" for x in orders)])
    report.table(["order of", "q", "v", "lam"], rows)
    report.figure("rod.order", least)
    report.claim(
        "(E) Order of q, v, lam and their derivatives across the impact", "2",
        f"at least {least:.2f}", _verdict(least >= _ORDER),
    )  # fmt: skip
    by_method = [
        gradients(scene, objectives, 0.28, HHT(step=4e-3), design=_DESIGN, events=[stop], method=x)
        for x in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    apart = 0.0
    for direct, *others in zip(*by_method, strict=True):
        size = np.max(np.abs(direct.gradient * _SCALE))
        apart = max(
            apart, *(np.max(np.abs((x.gradient - direct.gradient) * _SCALE)) / size for x in others)
        )
    report.figure("rod.methods", apart)
    report.claim(
        "(E) rod: direct differentiation, adjoint and complex step agree", "1e-10",
        f"{apart:.1e}", _verdict(apart <= 1e-10),
    )  # fmt: skip


_PARTS = (slice(0, 1), slice(1, 4))


def _rod() -> tuple[Beam, Scene, Impact]:
    material = Material(1000.0, 2e8, 0.3, damping_time=1e-3)
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 3, Rectangle(0.03, 0.03), material)
    bodies, joints = [PointMass(rod.at_end, 1.0)], [Pin(rod.at_start, name="hinge")]
    scene = Scene([rod], joints, gravity=(0.0, -9.81), bodies=bodies)
    return rod, scene, Impact(position(rod.at_end, 1) + 0.3, 0.5, "stop")


def _balance(report: Report, rod: Beam, scene: Scene, stop: Impact) -> None:
    """Compare momentum and energy before and after the impact with its impulse."""
    run = simulate(scene, 0.25, HHT(step=1e-3), events=[stop])
    system, (before, after) = assemble(scene), run.phases
    (record,) = run.events
    assert record.impulse is not None  # of an impact

    def at(observable: Any, phase: Any, k: int) -> float:
        states = States(phase.t[[k]], phase.q[[k]], phase.v[[k]], phase.lam[[k]])
        return float(observable.value(system, states)[0])

    def jump(observable: Any) -> float:
        return at(observable, after, 0) - at(observable, before, -1)

    speed = velocity(rod.at_end, 1)
    u, w = at(speed, before, -1), at(speed, after, 0)
    arm = at(position(rod.at_end, 0), before, -1)
    spin = abs(jump(angular_momentum(2)) / (record.impulse * arm) - 1)
    energy = abs(jump(kinetic_energy()) / (record.impulse * (u + w) / 2) - 1)
    law = abs(w / u + 0.5)
    rows = [
        ["restitution: u+ = -e u-", f"{law:.1e}"],
        ["angular momentum gained about the hinge = impulse times arm", f"{spin:.1e}"],
        ["kinetic energy gained = impulse times mean of u+ and u-", f"{energy:.1e}"],
    ]
    report.table(["balance at the impact", "relative error"], rows)
    worst = report.figure("rod.balance", max(law, spin, energy))
    report.claim(
        "(E) Momentum and energy at the impact of the rod", "1e-06", f"{worst:.1e}",
        _verdict(worst <= 1e-6),
    )  # fmt: skip


def _verdict(holds: bool) -> Agreement:
    return Agreement.AGREES if holds else Agreement.DISAGREES
