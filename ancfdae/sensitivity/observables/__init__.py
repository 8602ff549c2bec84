"""Observables: what can be seen of a motion, with exact partial derivatives."""
