"""An OpenMDAO component; needs the package openmdao (``pip install "ancfdae[openmdao]"``)."""

from typing import Any, final

from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import AncfdaeError, MissingPackageError
from ancfdae.studies.responses import Responses

try:
    import openmdao.api as om
except ImportError as error:
    raise MissingPackageError(
        "ancfdae.studies.openmdao: needs the package openmdao; got none. Install it: "
        'python3 -m pip install "ancfdae[openmdao]".'
    ) from error


@final
class ResponsesComponent(om.ExplicitComponent):  # type: ignore[misc]  # om has no types.
    """Functions of the design of a mechanism, with their exact derivatives.

    The input ``x`` holds the design variables in the order of ``responses.design_names``, divided
    by the scale of the responses; outputs have the names of the functions. A design without values
    raises ``openmdao.api.AnalysisError``, after which drivers that support it step back.

    Parameters
    ----------
    responses : Responses
        Option of the component: ``ResponsesComponent(responses=Responses(...))``. The names of its
        functions must be valid variable names in Python.
    """

    def initialize(self) -> None:
        """Declare the option `responses` of the component."""
        self.options.declare("responses", types=Responses, desc="functions of the design")

    def setup(self) -> None:
        """Add the input ``x``, one output per function, and their partial derivatives."""
        responses = self.options["responses"]
        require_kind("responses", responses, (Responses,), "Give responses=Responses(...).")
        self.add_input("x", responses.start)
        for name in responses.names:
            self.add_output(name)
        self.declare_partials("*", "x")

    def compute(self, inputs: Any, outputs: Any) -> None:
        """Run the design of the inputs and set all outputs."""
        evaluation = self._at(inputs, derivatives=False)
        for name, value in zip(outputs, evaluation.values, strict=True):
            outputs[name] = value

    def compute_partials(self, inputs: Any, partials: Any) -> None:
        """Set the derivatives of all outputs, from the run of the same design."""
        evaluation = self._at(inputs, derivatives=True)
        for name, row in zip(self.options["responses"].names, evaluation.jacobian, strict=True):
            partials[name, "x"] = row

    def _at(self, inputs: Any, derivatives: bool) -> Any:
        try:
            evaluation = self.options["responses"].at(inputs["x"], derivatives=derivatives)
        except AncfdaeError as error:
            raise om.AnalysisError(str(error)) from error
        if evaluation.error is not None:
            raise om.AnalysisError(str(evaluation.error)) from evaluation.error
        return evaluation
