"""Control of the step, apart from the method that takes it.

`StepControl` holds the settings, `Controller` decides in a run, `OneStepMethod` is what a method
offers for it, and `march` brings both to the end.
"""

from ancfdae.integrators.step_control.contracts import StepControl
from ancfdae.integrators.step_control.steps import AdaptiveSteps, FixedSteps, PrescribedSteps
