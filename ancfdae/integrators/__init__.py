"""Integrators, and the consistent start that all of them share."""
