"""Report on the paper's flexible pendulum (section 4.1, Figs. 4 to 6), and beyond it."""
