"""The package beside Exudyn, and beside the paper's pendulum written by hand in JAX."""
