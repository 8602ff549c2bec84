"""The judge of random scenes with bad or extreme events, contacts or controllers.

Every scene must end within a time limit as a run, an outcome in words or an error of the package,
or warn of very many steps or events. A run that reaches its end must have finite states and what
its kind demands. Its gradient, if it has one, must be finite and equal by two methods.
"""

from __future__ import annotations

import abc
import signal
import sys
import warnings
from collections import Counter
from collections.abc import Callable
from types import FrameType
from typing import Any, final

import numpy as np

from ancfdae import (
    Adjoint,
    DirectDifferentiation,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.errors import AncfdaeError, ManyStepsWarning
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.observables import custom
from validation.events.minimal import Array

# Derivatives of a height in m below this are compared with this.
_NOTHING = 1e-6


class RandomRun(abc.ABC):
    """A random scene with its model, design, end time (s) and integrator.

    `given` are the events and modes that `simulate` and `gradient` take; empty without events.
    """

    model: Any
    design: list[str]
    t_end: float
    integrator: Any
    given: dict[str, Any]

    def __init__(self) -> None:
        self.given = {}

    @final
    def run(self) -> Any:
        """Return the run."""
        return simulate(self.model, self.t_end, self.integrator, **self.given)

    @final
    def gradient(self, method: Any) -> Array:
        """Return the gradient of the height of the first point."""
        objective = Terminal(custom(lambda t, q, v, lam, b: q[:, 1], "height"))
        return gradient(
            self.model, objective, self.t_end, self.integrator, design=self.design,
            method=method, **self.given,
        ).gradient  # fmt: skip

    @abc.abstractmethod
    def wrong(self, run: Any) -> str:
        """Return the condition that a finished run violates, in words, or an empty text."""

    @abc.abstractmethod
    def apart(self, run: Any) -> float:
        """Return the largest difference of two methods, relative to the derivatives."""


class _TooLong(Exception):
    """A scene that takes too long."""


def outcome(draw: Callable[[int], RandomRun], seed: int) -> tuple[str, str]:
    """Return how a scene ended, one word or two, and what is wrong with that, or nothing."""
    try:
        scene = draw(seed)
        run = scene.run()
    except AncfdaeError as error:
        return f"refused: {type(error).__name__}", "" if len(str(error)) > 20 else str(error)
    if not run.outcome.success:
        return run.outcome.verdict.name.lower(), ""
    if not (np.all(np.isfinite(run.q)) and np.all(np.isfinite(run.v))):
        return "finished", "states that are not finite"
    if wrong := scene.wrong(run):
        return "finished", wrong
    try:
        direct = scene.gradient(DirectDifferentiation())
        if not isinstance(scene.integrator, SteppedIntegrator):
            return "finished, gradient", "" if np.all(np.isfinite(direct)) else "NaN in a gradient"
        other = scene.gradient(Adjoint())
    except AncfdaeError as error:
        return f"finished, gradient refused: {type(error).__name__}", ""
    apart = np.max(np.abs(direct - other) / np.maximum(np.abs(direct), _NOTHING))
    # NaN is not within the limit.
    right = apart <= scene.apart(run)
    return "finished, gradient", "" if right else f"methods apart by {apart:.1e}"


def _give_up(signum: int, frame: FrameType | None) -> None:
    raise _TooLong


def tally(draw: Callable[[int], RandomRun], patience: float, count: int, first: int = 0) -> int:
    """Run scenes, print what is wrong and how many ended how; return the number of wrong ones.

    `draw` takes a seed. A scene that takes more than `patience`, s of the processor, counts as one
    that hangs. Ctrl-C ends early, with the numbers up to there.
    """
    signal.signal(signal.SIGPROF, _give_up)
    ends, wrong = Counter[str](), 0
    for seed in range(first, first + count):
        signal.setitimer(signal.ITIMER_PROF, patience)
        try:
            with warnings.catch_warnings(record=True) as told, np.errstate(all="ignore"):
                warnings.simplefilter("default")
                end, bad = outcome(draw, seed)
        except KeyboardInterrupt:
            break
        except _TooLong:
            end, bad = "too long", f"no end after {patience} s"
            if any(issubclass(x.category, ManyStepsWarning) for x in told):
                end, bad = "long, with a warning", ""
        except Exception as error:  # noqa: BLE001  # whatever is no error of the package is wrong
            end, bad = "other error", f"{type(error).__name__}: {error}"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        ends[end] += 1
        if bad:
            wrong += 1
            sys.stdout.write(f"seed {seed}: {end}: {bad}\n")
            sys.stdout.flush()
    for end, number in ends.most_common():
        sys.stdout.write(f"{number:6d} {end}\n")
    sys.stdout.write(f"{ends.total()} scenes, {wrong} wrong\n")
    return wrong
