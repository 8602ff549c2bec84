"""The integrator Radau IIA of order 5 on positions and their constraints, velocities projected."""
