"""Integrators of the equations of motion, and the consistent start that all of them share."""
