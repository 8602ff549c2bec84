"""
4. How far to trust it
======================

Derivatives are exact for the motion *as computed*. How near that is to the true motion depends on
two choices: the number of elements and the step.
"""

import numpy as np

from ancfdae import HHT, Beam, Integral, Material, Pin, Scene, error_bars, gradient, suggest_step
from ancfdae.observables import deflection
from ancfdae.sections import Rectangle
from ancfdae.plotting import Panel, Series, draw, save

rubber = Material(1100, 5e6, 0.45, damping_time=2e-3)  # s: rubber damps its own vibration


def pendulum(elements):
    """Return the scene of step 2 with a number of elements, and the mean deflection of its beam."""
    beam = Beam("beam", (0, 0), (0.4, 0), elements, Rectangle(0.02, 0.02), rubber)
    bent = np.sqrt(Integral(deflection(beam.at_end, beam.at_start) ** 2) / 0.5)
    return Scene([beam], [Pin(beam.at_start)], gravity=(0, -9.81)), bent


# %%
# A step: a vibration needs some twenty steps in its period. `suggest_step` computes the periods
# and the step that follows the lowest ones.

scene, bent = pendulum(4)
suggested = suggest_step(scene, follow=2)
print(f"suggested {suggested.step:.2e} s, periods {suggested.fastest:.2e} s and longer")

# %%
# Is it fine enough? `error_bars` runs at the step and at half of it, and estimates the error
# that is left in the value and in the gradient. Gradients need finer steps than values: a small
# phase error of a wave affects its derivative first.

for step in (2**-7, 2**-9):
    bars = error_bars(scene, bent, 0.5, HHT(step), design=["beam.height"])
    print(
        f"step {step:.4f} s: {bars.value:.6f} +- {bars.value_bar:.1e} m,"
        f" gradient {bars.gradient[0]:.4f} +- {bars.gradient_bar[0]:.1e}"
    )

# %%
# Elements: double them and look.

counts, values, slopes = [1, 2, 3, 4, 6, 8], [], []
for elements in counts:
    scene, bent = pendulum(elements)
    result = gradient(scene, bent, 0.5, HHT(2**-9), design=["beam.height"])
    values.append(result.value)
    slopes.append(result.gradient[0])
    print(f"{elements} elements: {result.value:.6f} m, gradient {result.gradient[0]:.4f}")

lines = [
    Series(name, counts[:-1], np.abs(np.array(x[:-1]) / x[-1] - 1))
    for name, x in (("value", values), ("gradient", slopes))
]
panel = Panel(
    "Difference from 8 elements", "elements", "relative difference", lines, y_scale="log"
)
save(draw([panel]), "step_4")

# %%
# Four elements and 2\ :sup:`-9` s are good for three digits here. :doc:`/howto/elements` and
# :doc:`/howto/step` say more.
