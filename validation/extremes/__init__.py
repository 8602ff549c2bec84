"""Report on where the numerics end: groups of cases, and the rows that measure them."""
