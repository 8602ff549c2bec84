"""Observables: scalar functions of the state of a motion, with exact partial derivatives."""
