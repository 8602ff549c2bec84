"""Small motions about a configuration: natural frequencies, shapes, damping, derivatives."""
