"""Equilibria of mechanical systems under load, and their design derivatives."""
