"""Report on gradients to a tolerance."""
