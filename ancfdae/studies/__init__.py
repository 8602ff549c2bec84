"""Calls that take a scene or a mechanical system: what a user of the package calls."""
