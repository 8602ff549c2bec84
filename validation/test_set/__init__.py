"""Problems of differential-algebraic equations with published answers, and their sensitivities."""
