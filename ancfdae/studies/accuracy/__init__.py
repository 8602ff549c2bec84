"""Accuracy studies: sequences of runs, observed orders, extrapolation and error bars."""
