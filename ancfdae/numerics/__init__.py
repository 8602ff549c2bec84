"""Numerical tools: complex steps, operation lists, sparsity, linear solvers, time grids."""
