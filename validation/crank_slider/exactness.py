"""Gradients of all methods against each other, energy and constraints."""

import numpy as np

from ancfdae import (
    HHT,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    Integral,
    assemble,
    gradient,
)
from ancfdae.integrators.integrator import Seeds
from ancfdae.observables import reaction
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.crank_slider.case import (
    DESIGN,
    STEP,
    Extent,
    paper_objective,
    relative,
    scaled_gradient,
)
from validation.report import Report
from validation.scenes import crank_slider


def exactness(report: Report, solution: Solution, extent: Extent) -> None:
    """Compare methods that are exact for the discrete motion."""
    report.heading("Are the gradients exact?")
    system, integrator = assemble(crank_slider(), DESIGN), HHT(STEP)
    kinds = {
        "Ψ": paper_objective(),
        "∫ reaction²": Integral(reaction("bearing", 0) ** 2 + reaction("bearing", 1) ** 2),
    }
    rows = []
    for key, (name, objective) in zip(("psi", "reaction"), kinds.items(), strict=True):
        adjoint, direct, check = (
            gradient(system, objective, extent.t_end, integrator, method=method).gradient * system.b
            for method in (Adjoint(), DirectDifferentiation(), ComplexStep())
        )
        first = report.figure(f"exact.{key}.adjoint_direct", relative(adjoint, direct))
        second = report.figure(f"exact.{key}.adjoint_complex_step", relative(adjoint, check))
        rows.append([name, first, second])
    report.table(["objective", "adjoint - direct", "adjoint - complex step"], rows)
    rng, s = np.random.default_rng(0), solution.sensitivities
    assert s is not None
    seeds = [rng.standard_normal(x.shape) for x in (solution.q, solution.v, solution.lam)]
    back = integrator.pull_back(system, solution, Seeds(seeds[0], seeds[1], seeds[2]))
    pairs = list(zip(seeds, (s.q_b, s.v_b, s.lam_b), strict=True))
    forward = sum(np.tensordot(x, y, axes=2) for x, y in pairs)
    size = sum(np.linalg.norm(x) * np.linalg.norm(y, axis=(0, 1)) for x, y in pairs)
    worst = report.figure("exact.dot_product", float(np.max(np.abs(forward - back) / size)))
    report.say("exactness", worst=worst)


def continuous(report: Report, extent: Extent) -> None:
    """Compare the adjoints as the step is halved."""
    report.heading("Continuous against discrete adjoint")
    rows: list[list[object]] = []
    previous = 0.0
    for exponent in extent.exponents:
        exact, ours = (
            scaled_gradient(extent.t_end, HHT(2.0**-exponent), method)
            for method in (Adjoint(), ContinuousAdjoint())
        )
        error = report.figure(f"continuous.2-{exponent}", relative(ours, exact))
        order = float(np.log2(previous / error)) if previous else float("nan")
        rows.append([f"2^-{exponent}", error, f"{order:.2f}" if previous else "-"])
        previous = error
    report.table(["step [s]", "relative difference of dΨ/db", "order"], rows)
    report.say("continuous")


def balance(report: Report, solution: Solution) -> None:
    """Add up energies, and look at the constraints."""
    report.heading("Energy and constraints")
    system = assemble(crank_slider())
    kinetic, strain = system.energies.kinetic(solution.v), system.energies.strain(solution.q)
    gravity = system.energies.gravity(solution.q)
    total = kinetic + strain + gravity - gravity[0]
    drift = [
        np.max(np.abs(system.constraint(t, q))) for q, t in zip(solution.q, solution.t, strict=True)
    ]
    swing = float(np.max(kinetic))
    loss = report.figure("balance.energy", float(np.max(np.abs(total)) / swing))
    worst = report.figure("balance.drift", float(np.max(drift)))
    energies = {"kinetic": kinetic, "strain": strain, "gravity": gravity - gravity[0]}
    series = [Series(name, solution.t, y) for name, y in (energies | {"total": total}).items()]
    axes = "time t [s]", "energy [J]"
    report.plot("energy", [Panel("Energies, undamped scene", *axes, series)])
    report.say("balance", loss=loss, worst=worst)
