"""Laws (functions of time) that drive joints and scale loads; one family a file."""
