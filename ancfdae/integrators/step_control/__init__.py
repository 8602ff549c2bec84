"""Control of the step size, separate from the method that takes the steps.

`StepControl` holds the settings, `Controller` decides in a run, `OneStepMethod` is the interface of
a method, and `march` runs both to the end.
"""

from ancfdae.integrators.step_control.contracts import StepControl
from ancfdae.integrators.step_control.steps import AdaptiveSteps, FixedSteps, PrescribedSteps
