"""Accuracy: sequences of runs, observed orders, extrapolation and estimated error bars."""
