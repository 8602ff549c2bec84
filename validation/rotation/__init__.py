"""Report on steady rotation: blades, whirling shafts, derivatives, a simulation."""
