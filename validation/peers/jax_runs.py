"""The paper's pendulum here and in JAX."""

from collections.abc import Callable
from functools import partial

import numpy as np

from ancfdae import HHT, Adjoint, Terminal, assemble, gradient, simulate
from ancfdae.numerics.timing import medians, timed
from ancfdae.observables import position
from validation.peers.jax_pendulum import compiled
from validation.report import Report
from validation.scenes import pendulum

_STEP, _ELEMENTS = 2.0**-10, 6
_FIELDS = ("youngs_modulus", "height", "density")


def fill(report: Report, steps: int, repeats: int) -> None:
    """Add times of motion and gradient in three variables, here and in JAX, and its compilation."""
    report.heading("The paper's pendulum in JAX")
    scene = pendulum(elements=_ELEMENTS)
    system = assemble(scene, [f"pendulum.{field}" for field in _FIELDS])
    end, b, t_end = scene.beams[0].at_end, system.b.copy(), steps * _STEP
    hht, objective = HHT(step=_STEP), Terminal(position(end, 1))
    compilation, (height, forward, backward) = timed(
        partial(compiled, _ELEMENTS, _STEP, steps, b), wall=True
    )
    here = gradient(system, objective, t_end, hht)
    apart = float(np.max(np.abs(np.asarray(forward(b)) / here.gradient - 1)))
    calls: list[Callable[[], object]] = [
        lambda: simulate(system, t_end, hht),
        lambda: height(b).block_until_ready(),
        lambda: gradient(system, objective, t_end, hht),
        lambda: gradient(system, objective, t_end, hht, method=Adjoint()),
        lambda: forward(b).block_until_ready(),
        lambda: backward(b).block_until_ready(),
    ]
    motion, motion_jax, direct, adjoint, forward_jax, backward_jax = medians(calls, repeats)
    rows = [
        ["compilation, s", 0.0, compilation],
        ["motion, us a step", 1e6 * motion / steps, 1e6 * motion_jax / steps],
        ["gradient, forward, us a step", 1e6 * direct / steps, 1e6 * forward_jax / steps],
        ["gradient, backward, us a step", 1e6 * adjoint / steps, 1e6 * backward_jax / steps],
    ]
    report.say("jax-runs", apart=apart)
    report.table(["", "here", "JAX"], rows)
    report.figure("jax.apart", apart)
    report.figure("jax.compilation_s", compilation)
    ratios = motion / motion_jax, min(direct, adjoint) / min(forward_jax, backward_jax)
    report.figures("jax.{}.ratio", ("motion", "gradient"), ratios)
    report.judge("jax-runs", max(ratios) < 1, ratios=", ".join(f"{ratio:.2f}" for ratio in ratios))
