"""Report on published beam problems: one file a case, and the reference solutions they need."""
