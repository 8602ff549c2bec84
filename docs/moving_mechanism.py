"""Draw the film at the top of README.md: a mechanism that moves, and its gradient.

``python docs/moving_mechanism.py`` writes docs/moving-mechanism.gif.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import animation
from matplotlib.collections import PolyCollection

from ancfdae import (
    HHT,
    Beam,
    Integral,
    Material,
    Pin,
    PointMass,
    PointOnLine,
    RotationDriver,
    Scene,
    distributed_variables,
    gradient,
)
from ancfdae.laws import SmoothStep
from ancfdae.observables import strain_energy
from ancfdae.results import Gradient
from ancfdae.sections import Rectangle
from ancfdae.plotting import BendingMoment
from ancfdae.plotting.derivatives import bar_places
from ancfdae.plotting.charts import settings
from ancfdae.plotting.mechanism import frames_of, mechanism
from ancfdae.plotting.painters import canvas

ELEMENTS, T_END, STEP = 8, 0.75, 1 / 512
FRAMES, DOTS, SECONDS = 45, 72, 4.0
RAISES, LOWERS = "#b2182b", "#2166ac"


def scene() -> Scene:
    """Return a slider-crank whose rod bends."""
    rubber = Material(1200, 6e7, 0.4, damping_time=1e-3)
    crank = Beam("crank", (0, 0), (0, 0.15), 2, Rectangle(0.03, 0.02), rubber, rigid=True)
    rod = Beam("rod", crank.at_end, (0.5, -0.15), ELEMENTS, Rectangle(0.016, 0.02), rubber)
    return Scene(
        [crank, rod],
        bodies=[PointMass(rod.at_end, 0.02)],
        joints=[
            Pin(crank.at_start),
            RotationDriver(crank.at_start, angle=SmoothStep(0.0, -4 * np.pi, duration=T_END)),
            Pin(crank.at_end, rod.at_start),
            PointOnLine(rod.at_end, (1, 0)),
        ],
        gravity=(0, -9.81),
    )


def derivatives(t_end: float = T_END) -> Gradient:
    """Return the run, and what the height of each element does to the work that bends the rod."""
    objective = Integral(strain_energy("rod"))
    return gradient(
        scene(),
        objective,
        t_end,
        HHT(step=STEP),
        design=distributed_variables("rod.height", ELEMENTS),
    )


def film(path: Path, run: Gradient, frames: int = FRAMES) -> Path:
    """Write the film: the rod in the colours of its bending moment, with the gradient on it."""
    times = frames_of(run.solution, frames)
    own = mechanism(scene(), run.solution, times, BendingMoment())
    with settings():
        figure, brush = canvas(own, "A slider-crank with a soft rod, and a gradient over it")
        low, high = brush.axes.get_ylim()
        brush.axes.set_ylim(low - 0.12, high)
        brush.axes.text(
            0.5,
            0.02,
            "Bars: what the height of each element does to the strain energy over time.\n"
            "Blue: where the rod is higher it stores less; red: it stores more.",
            transform=brush.axes.transAxes,
            ha="center",
            fontsize=8.5,
        )
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        writer = animation.PillowWriter(fps=frames / SECONDS)
        colours = [RAISES if x > 0 else LOWERS for x in run.gradient.tolist()]
        with writer.saving(figure, path, DOTS):
            for k in range(frames):
                bars = bar_places(own, 1, run.gradient, brush.extent, k)
                shape = PolyCollection(list(bars), facecolors=colours, edgecolors="#222", lw=0.5)
                shape.set(alpha=0.8, zorder=2)
                artists = [*brush.bodies(k), *brush.symbols(k), brush.axes.add_collection(shape)]
                writer.grab_frame()
                for artist in artists:
                    artist.remove()
    return path


if __name__ == "__main__":
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    film(place / "moving-mechanism.gif", derivatives())
