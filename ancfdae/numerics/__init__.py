"""Complex-safe array helpers, quadrature, sparsity patterns and linear solvers."""
