"""Report on the paper's crank-slider: its figures, costs and open question."""
