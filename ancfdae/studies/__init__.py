"""The public calls that take a scene or a mechanical system."""
