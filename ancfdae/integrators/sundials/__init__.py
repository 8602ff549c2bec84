"""The integrators IDA and IDAS of SUNDIALS, on index-reduced equations of motion."""
